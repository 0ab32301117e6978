use std::collections::BTreeMap;

use cdcr_controller::plant::{Flaws, Preset, true_robot};
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::counted;
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

/// Which part of a command the robot's driver follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Interface {
    #[default]
    Velocity,
    Position,
}

/// Which process measures the tip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TipSensor {
    /// The driver, if any.
    #[default]
    Driver,
    /// One that measures nothing else.
    Separate,
}

table! {
    /// Where measurements come from and commands go to.
    pub struct LinkConfig {
        /// "simulated": a robot inside the daemon. "driver": a process that publishes measurements and follows commands.
        kind: LinkKind = LinkKind::Simulated;
        /// Which simulated robot. "ideal": exactly its model. "laboratory": built well, motors with a lag of 20 ms, encoders and
        /// motors with an offset of 0.1 mm, noise evenly spread within 30 µm. "sloppy": worn, with play, delay, a load, and a geometry that is not
        /// its model's. "slow": motors with a lag of 100 ms after 30 ms. "blind": as laboratory, but only its tip is measured,
        /// with 0.3 mm of noise.
        simulated: Preset = Preset::Ideal;
        /// Seed of its noise, {range}.
        simulated_seed: u32 = 1, in 0.0..=4_294_967_295.0;
        /// Whether the position of its tip is measured beside its cables, with 0.3 mm of noise; not of the ideal robot, which is exactly its
        /// model, and of "blind" anyway.
        simulated_tip: bool = false;
        /// What else is wrong with it, or otherwise than with the preset: name = number. Of the motors delay_s, time_constant_s,
        /// play_m, motor_speed_max_m_s and droop_m; of the cables stretch (of 1), slack_m, broken_cable (its number, 1 is the first) and
        /// friction_m_per_rad; of the encoders offset_m, noise_m (evenly spread within it), tick_m, cable_delay_s, cable_interval_s and cable_dropout (of 1); of the sensor of
        /// the tip tip_noise_m (standard deviation), tip_tick_m, tip_bias_x_m, tip_bias_y_m, tip_bias_z_m, tip_delay_s, tip_interval_s and tip_dropout; of the geometry length_error, cable_radius_error (of 1) and cable_angle_error_rad; of a load
        /// payload_u_rad and payload_v_rad; of the base base_x_m, base_y_m, base_z_m, base_turn_x_rad, base_turn_y_rad and
        /// base_turn_z_rad. Not of the ideal robot.
        simulated_flaws: BTreeMap<String, f64> = BTreeMap::new();
        /// What its sections are in truth, to try a configuration that is wrong: length in m, radius of the cables in m and angle of the
        /// first in rad, three numbers for each section; empty: those of [robot], and what the preset makes of them. Not of the ideal robot.
        simulated_geometry: Vec<[f64; 3]> = Vec::new();
        /// Which part of a command the robot follows: "velocity", the speeds, or "position", the
        /// positions. A driver reports which it follows, and is refused where that differs. The simulated robot can do both.
        interface: Interface = Interface::Velocity;
        /// Which process measures the tip. "driver": the driver, if any. "separate": a process of its own, a camera for
        /// example, beside a driver that measures bends or cables.
        tip_sensor: TipSensor = TipSensor::Driver;
        /// Bend vectors (u, v) at the start in rad, one pair for each section; empty: straight.
        initial_bend_rad: Vec<[f64; 2]> = Vec::new();
        /// A driver's measurement older than this is lost, and the robot faults, {range}. A tip sensor that is silent for so long,
        /// and for at least a second, may be replaced by another one.
        measurement_timeout_ms: f64 = 50.0, in 1.0..=10_000.0;
        /// How long after its release a robot follows a command without a newer one before it holds, {range}; 0: three
        /// periods.
        command_valid_ms: f64 = 0.0, in 0.0..=10_000.0;
    }
}

const FLAWS_KEY: &str = "link.simulated_flaws";

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

    /// What is wrong with the simulated robot.
    pub(super) fn flaws(&self, origins: &Origins) -> Result<Flaws, ConfigError> {
        let mut given = self.simulated_flaws.iter();
        let preset = self.simulated.flaws();
        let flaws = given.try_fold(preset, |flaws, (name, value)| flaws.with(name, *value));
        flaws.map_err(|error| origins.error(&[FLAWS_KEY], &error.to_string()))
    }

    /// The robot that the simulated one is in truth, where that is given.
    pub(super) fn truth(
        &self,
        robot: &Robot,
        origins: &Origins,
    ) -> Result<Option<Robot>, ConfigError> {
        let (given, key) = (&self.simulated_geometry, "link.simulated_geometry");
        let is_refused = |message: &str| origins.error(&[key, "link.simulated"], message);
        let is_changed =
            !given.is_empty() || self.simulated_tip || !self.simulated_flaws.is_empty();
        if self.is_ideal() && is_changed {
            return Err(origins.error(
                &["link.simulated_tip", key, FLAWS_KEY, "link.simulated"],
                "the ideal robot is exactly its model: simulated_geometry, simulated_flaws and simulated_tip need another \
                 link.simulated, for example \"laboratory\"",
            ));
        }
        if given.is_empty() {
            return Ok(None);
        }
        if given.len() != robot.section_count() {
            let (is, should) = (counted(given.len(), "section"), robot.section_count());
            let message = format!("{is} given, but the robot has {should}");
            return Err(is_refused(&message));
        }
        let truth = true_robot(robot, given).map_err(|error| is_refused(&error.to_string()));
        truth.map(Some)
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
            let is = counted(given.len(), "pair");
            let should = counted(robot.section_count(), "section");
            let message = format!("{is} given, but the robot has {should}");
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
