use serde::{Deserialize, Serialize};

use crate::estimator::Actuator;

/// In what a robot differs from the one that the controller computes with. The default is none of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flaws {
    /// How the motors follow: position motors come to rest at their goal like this, velocity motors reach their speed. Encoders are on the
    /// motors, before the play.
    pub actuator: Actuator,
    /// No motor runs faster (m/s).
    pub motor_speed_max_m_s: f64,
    /// The motor of the second cable of each section stands so far beside where it was sent, as under a load (m). A
    /// speed has none.
    pub droop_m: f64,
    /// The encoder of the first cable of each section counts from so far beside its zero (m).
    pub offset_m: f64,
    /// A measured cable length is off by at most this, evenly spread (m).
    pub noise_m: f64,
    /// Cable length of one count of an encoder (m); 0: as fine as numbers are.
    pub tick_m: f64,
    /// A measured coordinate of the tip is off by this: standard deviation (m).
    pub tip_noise_m: f64,
    /// Each section is longer than its model by this part.
    pub length_error: f64,
    /// The cables are farther from the backbone than in the model by this part.
    pub cable_radius_error: f64,
    /// The first cable of each section stands at a larger angle than in the model by this (rad).
    pub cable_angle_error_rad: f64,
    /// A load bends each section by this much more (u, v), times 1 + its bend in radians (rad).
    pub payload_rad: [f64; 2],
}

impl Default for Flaws {
    fn default() -> Self {
        Self {
            actuator: Actuator::IDEAL,
            motor_speed_max_m_s: f64::INFINITY,
            droop_m: 0.0,
            offset_m: 0.0,
            noise_m: 0.0,
            tick_m: 0.0,
            tip_noise_m: 0.0,
            length_error: 0.0,
            cable_radius_error: 0.0,
            cable_angle_error_rad: 0.0,
            payload_rad: [0.0; 2],
        }
    }
}

/// Simulated robots by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Exactly its model.
    #[default]
    Ideal,
    /// Built well: motors with a lag of 20 ms, encoders and motors 0.1 mm beside, noise of 30 µm (three counts of an encoder with 4096 on
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

impl Preset {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Ideal,
        Self::Laboratory,
        Self::Sloppy,
        Self::Slow,
        Self::Blind,
    ];

    /// Its name, as in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ideal => "ideal",
            Self::Laboratory => "laboratory",
            Self::Sloppy => "sloppy",
            Self::Slow => "slow",
            Self::Blind => "blind",
        }
    }

    /// What is wrong with it.
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

    /// Whether its tip is measured, and not its cables.
    pub fn measures_tip(self) -> bool {
        self == Self::Blind
    }
}
