use std::collections::BTreeMap;

use cdcr_controller::plant::{Flaws, RobotPreset, true_robot};
use cdcr_controller::robot::{Configuration, Robot};
use cdcr_shared_types::counted;
use serde::{Deserialize, Serialize};

use super::Origins;
use super::error::Result;

/// Which robot is controlled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LinkKind {
    /// A simulated robot inside the daemon.
    Simulated,
    /// A driver process on the measurement and command services.
    Driver,
}

/// Which part of a command the robot's driver follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Interface {
    Velocity,
    Position,
}

/// Which process measures the tip.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TipSensor {
    /// The driver, if any.
    Driver,
    /// One that measures nothing else.
    Separate,
}

table! {
    /// Source of measurements and receiver of commands.
    pub struct LinkConfig {
        /// "simulated": a robot inside the daemon. "driver": a process that publishes measurements and follows commands.
        kind: LinkKind = LinkKind::Simulated;
        /// Preset of the simulated robot. "ideal": exactly its model. "laboratory": well built, motors with a lag of 20 ms, encoders and
        /// motors with an offset of 0.1 mm, uniform noise within 30 µm. "sloppy": worn, with play, delay, a load and a geometry that differs
        /// from the model. "slow": motors with a delay of 30 ms and a lag of 100 ms. "blind": "laboratory", but only the tip is measured,
        /// with 0.3 mm of noise.
        simulated: RobotPreset = RobotPreset::Ideal;
        /// Seed of the simulated noise, {range}.
        simulated_seed: u32 = 1, in 0.0..=4_294_967_295.0;
        /// Whether the tip position is measured in addition to the cables, with 0.3 mm of noise. Not allowed for the ideal robot, always on
        /// for "blind".
        simulated_tip: bool = false;
        /// Flaws in addition to the preset or in place of its values: name = number. Motors: delay_s, time_constant_s,
        /// play_m, motor_speed_max_m_s, droop_m. Cables: stretch (fraction), slack_m, broken_cable (number, from 1),
        /// friction_m_per_rad. Encoders: offset_m, noise_m (uniform within it), tick_m, cable_delay_s, cable_interval_s, cable_dropout (fraction). Tip
        /// sensor: tip_noise_m (standard deviation), tip_tick_m, tip_bias_x_m, tip_bias_y_m, tip_bias_z_m, tip_delay_s, tip_interval_s, tip_dropout. Geometry: length_error, cable_radius_error (fractions), cable_angle_error_rad. Load:
        /// payload_u_rad, payload_v_rad. Base: base_x_m, base_y_m, base_z_m, base_turn_x_rad, base_turn_y_rad,
        /// base_turn_z_rad. Not allowed for the ideal robot.
        simulated_flaws: BTreeMap<String, f64> = BTreeMap::new();
        /// True geometry of the simulated sections, to test a wrong configuration: length in m, cable radius in m and angle of the
        /// first cable in rad per section; empty: that of [robot], changed by the preset. Not allowed for the ideal robot.
        simulated_geometry: Vec<[f64; 3]> = Vec::new();
        /// Part of a command that the robot follows: "velocity" (speeds) or "position"
        /// (positions). A driver that reports the other one is rejected. The simulated robot supports both.
        interface: Interface = Interface::Velocity;
        /// Process that measures the tip. "driver": the driver, if it does. "separate": another process, for example a
        /// camera, beside a driver that measures bends or cables.
        tip_sensor: TipSensor = TipSensor::Driver;
        /// Initial bend vectors (u, v) in rad, one pair per section; empty: straight.
        initial_bend_rad: Vec<[f64; 2]> = Vec::new();
        /// Age at which the driver's measurement is lost, a fault, {range}. A tip sensor silent for this time
        /// and at least 1 s can be replaced by another one.
        measurement_timeout_ms: f64 = 50.0, in 1.0..=10_000.0;
        /// Largest age at its arrival of a tip that is measured beside bends or cables, {range}, and at most 120 periods less
        /// actuator.delay_ms; 0: link.measurement_timeout_ms. For a camera whose evaluation takes longer than that.
        tip_age_max_ms: f64 = 0.0, in 0.0..=500.0, "at most 120 times cycle.period_ms, less actuator.delay_ms";
        /// Validity of a command after its release, {range}; then the robot holds unless a newer one has arrived; 0: three
        /// periods.
        command_valid_ms: f64 = 0.0, in 0.0..=10_000.0;
    }
}

impl LinkConfig {
    /// The robot is exactly its model.
    pub fn is_ideal(&self) -> bool {
        self.kind == LinkKind::Simulated && self.simulated == RobotPreset::Ideal
    }

    /// Flaws of the simulated robot.
    pub(super) fn flaws(&self, origins: &Origins) -> Result<Flaws> {
        let mut given = self.simulated_flaws.iter();
        let preset = self.simulated.flaws();
        let flaws = given.try_fold(preset, |flaws, (name, value)| flaws.with(name, *value));
        flaws.map_err(|error| origins.error(&["link.simulated_flaws"], error))
    }

    /// True geometry of the simulated robot, if configured.
    pub(super) fn truth(&self, robot: &Robot, origins: &Origins) -> Result<Option<Robot>> {
        let (given, key) = (&self.simulated_geometry, "link.simulated_geometry");
        let is_changed =
            !given.is_empty() || self.simulated_tip || !self.simulated_flaws.is_empty();
        if self.is_ideal() && is_changed {
            let keys = [
                "link.simulated_tip",
                key,
                "link.simulated_flaws",
                "link.simulated",
            ];
            let message = "the ideal robot is exactly its model: simulated_geometry, simulated_flaws and simulated_tip \
                           need another link.simulated, for example \"laboratory\"";
            return Err(origins.error(&keys, message));
        }
        let (is, should) = (counted(given.len(), "section"), robot.section_count());
        let truth = match given.len() {
            0 => return Ok(None),
            count if count == should => true_robot(robot, given).map_err(|error| error.to_string()),
            _ => Err(format!("{is} given, but the robot has {should}")),
        };
        let refused = |message| origins.error(&[key, "link.simulated"], message);
        truth.map(Some).map_err(refused)
    }

    /// Initial configuration of the simulation of `robot`, or of its estimate.
    pub(super) fn initial(&self, robot: &Robot, origins: &Origins) -> Result<Configuration> {
        let (given, key) = (&self.initial_bend_rad, "link.initial_bend_rad");
        if given.is_empty() {
            return Ok(Configuration::straight(robot.section_count()));
        }
        let is = counted(given.len(), "pair");
        let should = counted(robot.section_count(), "section");
        let message = format_args!("{is} given, but the robot has {should}");
        let initial = Configuration::from_slice(given.as_flattened());
        let initial = initial.filter(|initial| initial.section_count() == robot.section_count());
        let initial = initial.ok_or_else(|| origins.error(&[key], message))?;
        for ((number, pair), section) in (1..).zip(given).zip(robot.sections()) {
            let (bend_rad, most) = (pair[0].hypot(pair[1]), section.bend_max_rad);
            if !(0.0..=most).contains(&bend_rad) {
                let key = format!("{key}[{}]", number - 1);
                let message = format_args!(
                    "section {number}: a bend of {bend_rad} rad is out of range: allowed is 0 to {most}"
                );
                return Err(origins.error(&[&key], message));
            }
        }
        Ok(initial)
    }
}
