use core::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::estimator::Actuator;
use crate::robot::CABLES_MAX;

/// Timing of a sensor. By default it measures without delay, whenever it is read.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sampling {
    /// Age of a measurement, which the sensor does not report (s); to a millisecond.
    pub delay_s: f64,
    /// Interval between measurements (s); 0: one for each read.
    pub interval_s: f64,
    /// Share of the measurements that is lost.
    pub dropout: f64,
}

/// Differences between a robot and the controller's model of it. By default there are none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flaws {
    /// Dynamics of the motors, towards their goal (position) or their speed (velocity). Encoders are on the motors,
    /// before the play.
    pub actuator: Actuator,
    /// Largest speed of each motor (m/s).
    pub motor_speed_max_m_s: f64,
    /// Share of its pull by which a pulled cable stretches: the bends are less than its motor's position implies.
    pub stretch: f64,
    /// Excess length of every cable over its motor's position (m). Cables pull and do not push, so each section springs
    /// back towards straight as far as the slack allows.
    pub slack_m: f64,
    /// Number of a broken cable, which does not pull: 1 is the first of the base section; 0: none. The fraction is
    /// ignored. Encoders do not detect it.
    pub broken_cable: f64,
    /// Coulomb friction: a cable lags behind its motor by this much per radian of bend up to the end of its section
    /// (m/rad). The lag is on the side that the cable was moved from. Unlike play, it grows with the bends.
    pub friction_m_per_rad: f64,
    /// Deviation of the motor of each section's second cable from its goal, as under a load (m). It has no effect on
    /// speeds.
    pub droop_m: f64,
    /// Zero offset of the encoder of each section's first cable (m).
    pub offset_m: f64,
    /// Largest error of a measured cable length, uniformly distributed (m). Its standard deviation is this divided by
    /// √3.
    pub noise_m: f64,
    /// Cable length of one encoder count (m); 0: no quantisation.
    pub tick_m: f64,
    /// Timing of the encoders.
    pub cables: Sampling,
    /// Standard deviation of the noise in a measured tip coordinate (m).
    pub tip_noise_m: f64,
    /// Quantisation step of a measured tip coordinate (m); 0: none.
    pub tip_tick_m: f64,
    /// Bias of the tip sensor (x, y, z) (m).
    pub tip_bias_m: [f64; 3],
    /// Timing of the tip sensor.
    pub tip: Sampling,
    /// Relative excess length of each section over its model.
    pub length_error: f64,
    /// Relative excess distance of the cables from the backbone over the model.
    pub cable_radius_error: f64,
    /// Excess angle of each section's first cable over the model (rad).
    pub cable_angle_error_rad: f64,
    /// Additional bend of each section by a load (u, v), times 1 + its bend in radians (rad).
    pub payload_rad: [f64; 2],
    /// Offset of the base in the frame of references and obstacles (x, y, z) (m).
    pub base_m: [f64; 3],
    /// Rotation of the base in that frame: axis times angle (x, y, z) (rad).
    pub base_turn_rad: [f64; 3],
}

impl Default for Flaws {
    fn default() -> Self {
        Self {
            actuator: Actuator::IDEAL,
            motor_speed_max_m_s: f64::INFINITY,
            stretch: 0.0,
            slack_m: 0.0,
            broken_cable: 0.0,
            friction_m_per_rad: 0.0,
            droop_m: 0.0,
            offset_m: 0.0,
            noise_m: 0.0,
            tick_m: 0.0,
            cables: Sampling::default(),
            tip_noise_m: 0.0,
            tip_tick_m: 0.0,
            tip_bias_m: [0.0; 3],
            tip: Sampling::default(),
            length_error: 0.0,
            cable_radius_error: 0.0,
            cable_angle_error_rad: 0.0,
            payload_rad: [0.0; 2],
            base_m: [0.0; 3],
            base_turn_rad: [0.0; 3],
        }
    }
}

/// Number of named flaws.
pub const FLAWS: usize = 34;

/// Reason why a flaw cannot be set.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FlawError {
    /// No flaw has this name.
    #[error("unknown flaw {0:?}: known are {names}", names = Flaws::names().join(", "))]
    Unknown(String),
    /// The value is out of range or not a number.
    #[error("{name} = {value} is out of range: allowed is {} to {}", allowed.start(), allowed.end())]
    OutOfRange {
        /// Name of the flaw.
        name: String,
        /// Value given.
        value: f64,
        /// Allowed values.
        allowed: RangeInclusive<f64>,
    },
}

impl Flaws {
    /// Each flaw with its name and its allowed range. Lists have a name for each axis.
    pub fn named(&mut self) -> [(&'static str, &mut f64, RangeInclusive<f64>); FLAWS] {
        const MOTOR_S: RangeInclusive<f64> = 0.0..=Actuator::TIME_MAX_S;
        const PLAY_M: RangeInclusive<f64> = 0.0..=Actuator::PLAY_MAX_M;
        const DELAY_S: RangeInclusive<f64> = 0.0..=0.3;
        const INTERVAL_S: RangeInclusive<f64> = 0.0..=1.0;
        const LENGTH_M: RangeInclusive<f64> = -0.1..=0.1;
        const PART: RangeInclusive<f64> = -0.2..=0.2;
        const TURN_RAD: RangeInclusive<f64> = -0.5..=0.5;
        const SMALL_M: RangeInclusive<f64> = 0.0..=0.01;
        const DROPOUT: RangeInclusive<f64> = 0.0..=0.9;
        let (actuator, cables, tip) = (&mut self.actuator, &mut self.cables, &mut self.tip);
        let ([bias_x, bias_y, bias_z], [payload_u, payload_v]) =
            (&mut self.tip_bias_m, &mut self.payload_rad);
        let ([base_x, base_y, base_z], [turn_x, turn_y, turn_z]) =
            (&mut self.base_m, &mut self.base_turn_rad);
        [
            ("delay_s", &mut actuator.delay_s, MOTOR_S),
            ("time_constant_s", &mut actuator.time_constant_s, MOTOR_S),
            ("play_m", &mut actuator.play_m, PLAY_M),
            (
                "motor_speed_max_m_s",
                &mut self.motor_speed_max_m_s,
                1e-3..=10.0,
            ),
            ("stretch", &mut self.stretch, 0.0..=0.2),
            ("slack_m", &mut self.slack_m, SMALL_M),
            (
                "broken_cable",
                &mut self.broken_cable,
                0.0..=CABLES_MAX as f64,
            ),
            ("friction_m_per_rad", &mut self.friction_m_per_rad, SMALL_M),
            ("droop_m", &mut self.droop_m, LENGTH_M),
            ("offset_m", &mut self.offset_m, LENGTH_M),
            ("noise_m", &mut self.noise_m, SMALL_M),
            ("tick_m", &mut self.tick_m, SMALL_M),
            ("cable_delay_s", &mut cables.delay_s, DELAY_S),
            ("cable_interval_s", &mut cables.interval_s, INTERVAL_S),
            ("cable_dropout", &mut cables.dropout, DROPOUT),
            ("tip_noise_m", &mut self.tip_noise_m, SMALL_M),
            ("tip_tick_m", &mut self.tip_tick_m, SMALL_M),
            ("tip_bias_x_m", bias_x, LENGTH_M),
            ("tip_bias_y_m", bias_y, LENGTH_M),
            ("tip_bias_z_m", bias_z, LENGTH_M),
            ("tip_delay_s", &mut tip.delay_s, DELAY_S),
            ("tip_interval_s", &mut tip.interval_s, INTERVAL_S),
            ("tip_dropout", &mut tip.dropout, DROPOUT),
            ("length_error", &mut self.length_error, PART),
            ("cable_radius_error", &mut self.cable_radius_error, PART),
            (
                "cable_angle_error_rad",
                &mut self.cable_angle_error_rad,
                TURN_RAD,
            ),
            ("payload_u_rad", payload_u, TURN_RAD),
            ("payload_v_rad", payload_v, TURN_RAD),
            ("base_x_m", base_x, LENGTH_M),
            ("base_y_m", base_y, LENGTH_M),
            ("base_z_m", base_z, LENGTH_M),
            ("base_turn_x_rad", turn_x, TURN_RAD),
            ("base_turn_y_rad", turn_y, TURN_RAD),
            ("base_turn_z_rad", turn_z, TURN_RAD),
        ]
    }

    /// Names of all flaws.
    pub fn names() -> [&'static str; FLAWS] {
        Self::default().named().map(|(name, ..)| name)
    }

    /// The flaws with one of them set by its name.
    ///
    /// # Errors
    /// [`FlawError`].
    pub fn with(mut self, name: &str, value: f64) -> Result<Self, FlawError> {
        let named = self.named().into_iter();
        let found = named.filter(|(known, ..)| *known == name).last();
        let Some((_, place, allowed)) = found else {
            return Err(FlawError::Unknown(name.to_owned()));
        };
        if !allowed.contains(&value) {
            let name = name.to_owned();
            return Err(FlawError::OutOfRange {
                name,
                value,
                allowed,
            });
        }
        *place = value;
        Ok(self)
    }
}

/// Simulated robots by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum RobotPreset {
    /// Exactly its model.
    #[default]
    Ideal,
    /// Built well: motors with a lag of 20 ms, encoders and motors 0.1 mm beside, noise evenly spread within 30 µm (three counts of an encoder with 4096 on
    /// a 10 mm spool), 0.3 mm at the tip.
    Laboratory,
    /// Built once and used for years: a lag of 40 ms after 10 ms, 0.3 mm beside, play of 0.3 mm, sections 3 % longer, cables 2 % nearer, a
    /// load at the tip.
    Sloppy,
    /// Motors with a lag of 100 ms after a delay of 30 ms.
    Slow,
    /// As `Laboratory`, and no encoders: the tip is measured.
    Blind,
}

impl RobotPreset {
    /// All presets.
    pub const ALL: [Self; 5] = [
        Self::Ideal,
        Self::Laboratory,
        Self::Sloppy,
        Self::Slow,
        Self::Blind,
    ];

    /// Name of the preset in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ideal => "ideal",
            Self::Laboratory => "laboratory",
            Self::Sloppy => "sloppy",
            Self::Slow => "slow",
            Self::Blind => "blind",
        }
    }

    /// Flaws of the preset.
    pub fn flaws(self) -> Flaws {
        let laboratory = Flaws {
            actuator: Actuator {
                time_constant_s: 0.02,
                ..Actuator::IDEAL
            },
            offset_m: 1e-4,
            droop_m: 1e-4,
            noise_m: 3e-5,
            tip_noise_m: 3e-4,
            ..Flaws::default()
        };
        match self {
            Self::Ideal => Flaws::default(),
            Self::Laboratory | Self::Blind => laboratory,
            Self::Sloppy => Flaws {
                actuator: Actuator {
                    delay_s: 0.01,
                    time_constant_s: 0.04,
                    play_m: 3e-4,
                },
                offset_m: 3e-4,
                droop_m: 3e-4,
                length_error: 0.03,
                cable_radius_error: -0.02,
                cable_angle_error_rad: 0.02,
                payload_rad: [0.01, 0.0],
                ..laboratory
            },
            Self::Slow => Flaws {
                actuator: Actuator {
                    delay_s: 0.03,
                    time_constant_s: 0.1,
                    play_m: 0.0,
                },
                ..laboratory
            },
        }
    }

    /// True if the tip is measured instead of the cables.
    pub fn measures_tip(self) -> bool {
        self == Self::Blind
    }
}
