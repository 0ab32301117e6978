use cdcr_controller::plant::Preset;
use cdcr_controller::robot::{Configuration, Robot};
use serde::{Deserialize, Serialize};

use super::{ConfigError, Origins, ns};

/// Which robot is controlled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LinkKind {
    /// A simulated robot inside the daemon.
    #[default]
    Simulated,
    /// A driver process on the measurement and command services.
    Driver,
}

/// What of a command the robot's driver obeys.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Interface {
    /// The speeds.
    #[default]
    Velocity,
    /// The positions.
    Position,
}

/// Where measurements come from and commands go to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct LinkConfig {
    /// Which robot.
    pub kind: LinkKind,
    /// Which simulated robot, where it is one.
    pub simulated: Preset,
    /// Of its noise.
    pub simulated_seed: u32,
    /// What of a command the robot obeys. Its driver says so, too, and is refused where it says otherwise.
    pub interface: Interface,
    /// Bend vectors at the start \[rad\], one pair for each section; empty: straight.
    pub initial_bend_rad: Vec<[f64; 2]>,
    /// A driver's measurement older than this is lost \[ms\].
    pub measurement_timeout_ms: f64,
    /// How long after its release a robot follows a command when no newer one comes \[ms\]; then it holds. 0: three
    /// periods.
    pub command_valid_ms: f64,
}

impl Default for LinkConfig {
    fn default() -> Self {
        Self {
            kind: LinkKind::Simulated,
            simulated: Preset::Ideal,
            simulated_seed: 1,
            interface: Interface::Velocity,
            initial_bend_rad: Vec::new(),
            measurement_timeout_ms: 50.0,
            command_valid_ms: 0.0,
        }
    }
}

impl LinkConfig {
    /// Whether the robot is exactly its model.
    pub fn is_ideal(&self) -> bool {
        self.kind == LinkKind::Simulated && self.simulated == Preset::Ideal
    }

    /// How long after its release a command is valid \[ns\].
    pub fn command_valid_ns(&self, period_ns: u64) -> u64 {
        match ns(self.command_valid_ms) {
            0 => 3 * period_ns,
            valid_ns => valid_ns,
        }
    }

    /// Where the simulation of `robot`, or its estimate, begins.
    pub(super) fn initial(
        &self,
        robot: &Robot,
        origins: &Origins,
    ) -> Result<Configuration, ConfigError> {
        let (given, key) = (&self.initial_bend_rad, "link.initial_bend_rad");
        if given.is_empty() {
            return Ok(Configuration::straight(robot.section_count()));
        }
        if given.len() != robot.section_count() {
            let (is, should) = (given.len(), robot.section_count());
            let message = format!("{is} pairs are given, but the robot has {should} sections");
            return Err(origins.error(&[key], &message));
        }
        for (index, (pair, section)) in given.iter().zip(robot.sections()).enumerate() {
            let bend_rad = pair[0].hypot(pair[1]);
            if !(0.0..=section.bend_max_rad).contains(&bend_rad) {
                let message = format!(
                    "section {}: a bend of {bend_rad} rad is out of range: allowed is 0 to {}",
                    index + 1,
                    section.bend_max_rad
                );
                return Err(origins.error(&[&format!("{key}[{index}]")], &message));
            }
        }
        let flat: Vec<f64> = given.iter().flatten().copied().collect();
        Configuration::from_slice(&flat).ok_or_else(|| origins.error(&[key], "too many sections"))
    }
}
