//! Scenarios: robots, what the controller knows of them, and the controllers compared on them.

use cdcr_controller::closed_loop::{Driven, FigureEight, Part, Sensor};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::plant::{Flaws, Preset};
use serde_json::Value;

use crate::chart::{BLUE, GREEN, GREY, ORANGE, PURPLE, RGBColor, SKY};
use crate::named::named;

/// Mean distance of the second half of the spiral from the nearest point that a tip with 5 % shorter sections
/// reaches \[mm\]: see the test below.
const OUT_OF_REACH_MM: f64 = 34.22;

/// Default time constant of a daemon's estimate \[s\].
const TIME_CONSTANT_S: f64 = 0.18;

named! {
    pub(super) enum Control {
        /// All parts of a daemon's controller.
        Full = "full",
        /// The motors are modelled as ideal.
        NoActuator = "no actuator model",
        /// Measurements are used unfiltered.
        NoFilter = "no filter",
        /// The change of the tip offset along its path is not estimated.
        NoSlope = "no offset along the way",
        /// Rates cost nothing.
        NoRateWeight = "no weight on rates",
        /// No clearance margin where the tip is measured in addition to the bends.
        NoMargin = "no margin",
        /// Unfiltered measurements, ideal motors, rates without cost.
        First = "first version",
        /// The tip sensor is not used.
        NoTip = "no tip",
        /// Nothing is measured.
        OpenLoop = "open loop",
    }
}

impl Control {
    /// Whether the results at rest are reported with this controller.
    pub(super) fn rests(self) -> bool {
        matches!(self, Self::Full | Self::NoRateWeight | Self::First)
    }

    /// The figure eight with the solver settings of this controller.
    pub(super) fn eight(self, eight: FigureEight) -> FigureEight {
        match self {
            Self::NoRateWeight | Self::First => eight.with_settings(NmpcSettings {
                rate_weight: 0.0.into(),
                ..NmpcSettings::default()
            }),
            _ => eight,
        }
    }

    pub(super) fn colour(self) -> RGBColor {
        match self {
            Self::Full => BLUE,
            Self::NoActuator => GREEN,
            Self::NoTip | Self::NoRateWeight => PURPLE,
            Self::NoFilter | Self::NoSlope | Self::NoMargin => SKY,
            Self::First => ORANGE,
            Self::OpenLoop => GREY,
        }
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Way {
    /// The common figure eight of three sections.
    Eight,
    /// The figure eight of this many sections through the tip of the straight robot.
    ThroughStraight(usize),
    /// The paper's spiral, lowered by this distance \[m\].
    Spiral { lower_m: f64 },
}

#[derive(Debug, Clone)]
pub(super) struct Scenario {
    pub(super) name: &'static str,
    pub(super) flaws: Flaws,
    /// The controller's model of the motors.
    actuator: Actuator,
    sensor: Sensor,
    pub(super) way: Way,
    /// Centre of a ball at the path (m).
    pub(super) ball_x_m: Option<f64>,
    /// The robot is also sent to a position at which it must stay.
    pub(super) rests: bool,
    /// Numbers and their bounds; in addition, every command must be within its limits.
    targets: Vec<(Figure, f64)>,
}

/// A number with a target: its key in a row, its name, its unit.
type Figure = (&'static str, &'static str, &'static str);
const MEAN: Figure = ("mean_error_mm", "mean", "mm");
const RMS: Figure = ("rms_error_mm", "rms", "mm");
/// Mean error of the second half.
const SETTLED: Figure = ("settled_error_mm", "settled", "mm");
const MAX: Figure = ("max_error_mm", "max", "mm");
/// Largest error of a robot at a position at which it must stay.
const AT_REST: Figure = ("rest_error_mm", "at rest", "mm");
/// Root mean square of the rate changes, over that of the ideal robot.
const RATE_CHANGE: Figure = ("rate_change_rms", "rate change", "× ideal");
/// Of the true body; the only number with a lower bound.
const CLEARANCE: Figure = ("min_clearance_mm", "clearance", "mm");

impl Scenario {
    /// The motors are known; the cable lengths are measured.
    fn new(name: &'static str, flaws: Flaws) -> Self {
        Self {
            name,
            actuator: flaws.actuator,
            flaws,
            sensor: Sensor::Cables,
            way: Way::Eight,
            ball_x_m: None,
            rests: false,
            targets: Vec::new(),
        }
    }

    fn sensor(self, sensor: Sensor) -> Self {
        Self { sensor, ..self }
    }

    fn wants(self, targets: &[(Figure, f64)]) -> Self {
        let targets = targets.to_vec();
        Self { targets, ..self }
    }

    /// Whether a row reaches all targets; targets that were not measured count as reached. `ideal_change`:
    /// `rate_change_rms` of the ideal robot.
    pub(super) fn is_reached(&self, row: &Value, ideal_change: Option<f64>) -> bool {
        let mut targets = self.targets.iter();
        targets.all(|&(figure, bound)| {
            let unit = if figure == RATE_CHANGE {
                ideal_change
            } else {
                Some(1.0)
            };
            let found = row[figure.0].as_f64().zip(unit);
            let found = found.map(|(found, unit)| found / unit);
            found.is_none_or(|found| {
                if figure == CLEARANCE {
                    found >= bound
                } else {
                    found <= bound
                }
            })
        })
    }

    pub(super) fn wanted(&self) -> String {
        let targets = self.targets.iter().map(|&(figure, bound)| {
            let sign = if figure == CLEARANCE { '≥' } else { '≤' };
            format!("{} {sign} {bound} {}", figure.1, figure.2)
        });
        match self.targets.len() {
            0 => "within limits".to_owned(),
            _ => targets.collect::<Vec<_>>().join(", "),
        }
    }

    /// In the order of the tables.
    pub(super) fn all() -> Vec<Self> {
        let known = motors(0.015, 0.03);
        let lagging = |name, actuator| Self {
            actuator: known,
            ..Self::new(name, with(|f| f.actuator = actuator)).wants(&[(MEAN, 0.5), (MAX, 2.0)])
        };
        let noisy = |name, noise_m| {
            Self::new(name, with(|f| f.noise_m = noise_m)).wants(&[(RMS, 0.15), (RATE_CHANGE, 2.0)])
        };
        let noisy_tip = |name, noise_m| {
            Self::new(name, with(|f| f.tip_noise_m = noise_m)).sensor(Sensor::Tip { every: 1 })
        };
        let straight = |sections, name, noise_m| Self {
            way: Way::ThroughStraight(sections),
            ..noisy_tip(name, noise_m)
        };
        let wrong_model = |name, length_error, way| Self {
            way,
            ..Self::new(
                name,
                with(|f| {
                    f.length_error = length_error;
                    f.payload_rad = [0.015, 0.0];
                    f.tip_noise_m = 3e-4;
                }),
            )
            .sensor(Sensor::CablesAndTip { every: 2 })
        };
        let [spiral, lower] = [0.0, 0.06].map(|lower_m| Way::Spiral { lower_m });
        let settled = [(SETTLED, 0.2)];
        let play = with(|f| {
            f.actuator.play_m = 5e-4;
            f.noise_m = 3e-5;
            f.tip_noise_m = 3e-4;
        });
        let mean = |mean_mm| [(MEAN, mean_mm)];
        let tip = |every| Sensor::CablesAndTip { every };
        let with_play = |name, play_m| Self {
            actuator: Actuator {
                play_m,
                ..Actuator::IDEAL
            },
            rests: true,
            ..Self::new(name, play)
                .sensor(tip(1))
                .wants(&[(AT_REST, 0.3)])
        };
        // With and without play, to separate a limit cycle at rest from noise.
        let behind_lag = |name, play_m, wanted: &[_]| {
            let actuator = Actuator {
                play_m,
                ..motors(0.0, 0.02)
            };
            Self {
                rests: true,
                ..Self::new(name, Flaws { actuator, ..play })
                    .sensor(tip(2))
                    .wants(wanted)
            }
        };
        vec![
            Self::new("ideal", Flaws::default()),
            noisy("30 µm of noise", 3e-5),
            // Uniform within ± √3 σ.
            noisy("30 µm of noise, standard deviation", 3e-5 * 3_f64.sqrt()),
            lagging("lag 30 ms, delay 15 ms", known),
            lagging("lag 21 ms, delay 10 ms", motors(0.01, 0.021)),
            lagging("lag 39 ms, delay 20 ms", motors(0.02, 0.039)),
            wrong_model("wrong model", 0.05, Way::Eight).wants(&settled),
            wrong_model("wrong model, 5 % shorter", -0.05, Way::Eight).wants(&settled),
            wrong_model("wrong model, spiral", 0.05, spiral).wants(&settled),
            wrong_model("wrong model, 5 % shorter, lower spiral", -0.05, lower).wants(&settled),
            wrong_model("wrong model, 5 % shorter, spiral", -0.05, spiral)
                .wants(&[(SETTLED, OUT_OF_REACH_MM + 0.2)]),
            with_play("play of 0.5 mm", 5e-4),
            with_play("play of 0.5 mm, known as 0.4", 4e-4),
            with_play("play of 0.5 mm, taken for 0.6", 6e-4),
            behind_lag("lag 20 ms, tip at 100 Hz", 0.0, &[]),
            behind_lag(
                "lag 20 ms, tip at 100 Hz, play of 0.5 mm",
                5e-4,
                &[(AT_REST, 0.3)],
            ),
            noisy_tip("tip alone, 0.1 mm", 1e-4).wants(&mean(0.1)),
            noisy_tip("tip alone, 0.5 mm", 5e-4).wants(&mean(0.25)),
            straight(1, "tip alone, 0.1 mm, 1 section, through straight", 1e-4).wants(&mean(0.1)),
            straight(1, "tip alone, 0.5 mm, 1 section, through straight", 5e-4).wants(&mean(0.25)),
            straight(2, "tip alone, 0.1 mm, 2 sections, through straight", 1e-4).wants(&mean(0.1)),
            straight(2, "tip alone, 0.5 mm, 2 sections, through straight", 5e-4).wants(&mean(0.25)),
            straight(3, "tip alone, 0.1 mm, 3 sections, through straight", 1e-4).wants(&mean(0.1)),
            straight(3, "tip alone, 0.5 mm, 3 sections, through straight", 5e-4).wants(&mean(0.25)),
        ]
        .into_iter()
        .chain(Self::longer_and_presets())
        .collect()
    }

    /// A robot that would collide with the ball, and the presets of `link.simulated`.
    fn longer_and_presets() -> Vec<Self> {
        let of_preset = |name, preset: Preset| Self::new(name, preset.flaws());
        let tip = |every| Sensor::CablesAndTip { every };
        let longer = with(|f| {
            f.length_error = 0.05;
            f.noise_m = 3e-5;
            f.tip_noise_m = 3e-4;
        });
        vec![
            Self {
                ball_x_m: Some(0.33),
                ..Self::new("5 % longer, ball", longer)
                    .sensor(tip(2))
                    .wants(&[(CLEARANCE, 9.9)])
            },
            Self {
                rests: true,
                ..of_preset("laboratory", Preset::Laboratory)
            },
            Self {
                // At the turn, 5 mm nearer to the tip than the safe distance.
                ball_x_m: Some(0.37),
                ..of_preset("laboratory, ball", Preset::Laboratory)
            },
            of_preset("sloppy, with tip", Preset::Sloppy).sensor(tip(2)),
            of_preset("slow", Preset::Slow),
            of_preset("blind", Preset::Blind).sensor(Sensor::Tip { every: 1 }),
        ]
    }

    pub(super) fn is_ideal(&self) -> bool {
        self.flaws == Flaws::default()
    }

    /// The preset of `link.simulated`, if the robot is one.
    pub(super) fn plant(&self) -> &'static str {
        let preset = Preset::ALL
            .into_iter()
            .find(|preset| preset.flaws() == self.flaws);
        match preset {
            Some(Preset::Laboratory) if matches!(self.sensor, Sensor::Tip { .. }) => {
                Preset::Blind.name()
            }
            Some(preset) => preset.name(),
            None => "of its own",
        }
    }

    /// The controllers to compare on this scenario. A part is only switched off on one or two robots that
    /// show its effect alone.
    pub(super) fn controls(&self) -> impl Iterator<Item = Control> {
        let name = self.name;
        let has_tip = matches!(self.sensor, Sensor::CablesAndTip { .. });
        let lags = self.actuator != Actuator::IDEAL;
        Control::ALL
            .into_iter()
            .filter(move |control| match control {
                Control::Full | Control::OpenLoop | Control::First => true,
                Control::NoActuator => lags,
                Control::NoFilter => name == "30 µm of noise" || name.starts_with("tip alone"),
                Control::NoSlope => name.starts_with("wrong model"),
                Control::NoRateWeight => name == "laboratory",
                Control::NoMargin => name == "5 % longer, ball",
                Control::NoTip => has_tip,
            })
    }

    pub(super) fn driven(&self, control: Control, obeys_positions: bool, seed: u64) -> Driven {
        let mut driven = Driven {
            flaws: self.flaws,
            actuator: self.actuator,
            time_constant_s: TIME_CONSTANT_S,
            obeys_positions,
            sensor: self.sensor,
            without: None,
            seed,
        };
        match control {
            Control::Full | Control::NoRateWeight => {}
            Control::NoActuator => driven.actuator = Actuator::IDEAL,
            Control::NoFilter => {
                (driven.time_constant_s, driven.without) = (0.0, Some(Part::Filter));
            }
            Control::NoSlope => driven.without = Some(Part::Slope),
            Control::NoMargin => driven.without = Some(Part::Margin),
            Control::First => {
                driven.actuator = Actuator::IDEAL;
                (driven.time_constant_s, driven.without) = (0.0, Some(Part::Filter));
            }
            Control::NoTip => driven.sensor = Sensor::Cables,
            Control::OpenLoop => driven.sensor = Sensor::Nothing,
        }
        driven
    }
}

fn with(change: impl FnOnce(&mut Flaws)) -> Flaws {
    let mut flaws = Flaws::default();
    change(&mut flaws);
    flaws
}

fn motors(delay_s: f64, time_constant_s: f64) -> Actuator {
    Actuator {
        delay_s,
        time_constant_s,
        ..Actuator::IDEAL
    }
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::{Robot, RobotParameters};

    use super::*;
    use crate::closed_loop;
    use crate::scene::Scene;

    /// A controller that knows the shorter sections keeps the tip at the nearest reachable point.
    #[test]
    fn the_part_of_the_spiral_that_is_out_of_reach_is_that_far_away() {
        let mut shorter = RobotParameters::paper(3);
        for section in &mut shorter.sections {
            section.length_m *= 0.95;
        }
        let scene = Scene {
            robot: Robot::new(&shorter).unwrap(),
            ..Scene::spiral(3).unwrap()
        };
        let samples = closed_loop::run(&scene, NmpcSettings::default()).unwrap();
        // The evaluated cycles: see `FigureEightRun::settled_mm`.
        let settled = &samples[597..];
        let errors_mm = settled.iter().map(closed_loop::Sample::error_mm);
        let mean_mm = errors_mm.sum::<f64>() / settled.len() as f64;
        assert!((mean_mm - OUT_OF_REACH_MM).abs() < 0.005, "{mean_mm}");
    }
}
