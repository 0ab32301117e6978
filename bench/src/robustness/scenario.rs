//! Robots, what the controller knows of them, and the controllers compared on them.

use std::collections::BTreeMap;

use cdcr_controller::closed_loop::{Driven, FigureEight, FigureEightError, Sensor, TipPart};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::plant::{Flaws, RobotPreset};
use serde::Deserialize;
use serde_json::Value;

use crate::chart::{BLUE, GREEN, GREY, ORANGE, PURPLE, RGBColor, SKY};

/// Default time constant of a daemon's estimate \[s\].
const TIME_CONSTANT_S: f64 = 0.18;

/// The controller of a daemon, or the same with parts switched off.
pub(super) struct Control {
    pub(super) name: &'static str,
    pub(super) colour: RGBColor,
    /// Robots to compare it on. A part is only switched off on one or two robots that show its effect alone.
    is_for: fn(&Scenario) -> bool,
    change: fn(&mut Driven),
}

#[rustfmt::skip]
const fn control(name: &'static str, colour: RGBColor, is_for: fn(&Scenario) -> bool, change: fn(&mut Driven)) -> Control {
    Control { name, colour, is_for, change }
}

const NO_RATE_WEIGHT: &str = "no weight on rates";
/// Unfiltered measurements, ideal motors, rates without cost.
const FIRST: &str = "first version";

/// The controllers, in the order of the tables; the whole one first.
#[rustfmt::skip]
pub(super) static CONTROLS: [Control; 9] = [
    control("full", BLUE, |_| true, |_| {}),
    control("no actuator model", GREEN, |on| on.actuator() != Actuator::IDEAL, |it| it.actuator = Actuator::IDEAL),
    control("no filter", SKY, |on| on.name == "30 µm of noise" || on.name.starts_with("tip alone"), unfiltered),
    control("no offset along the way", SKY, |on| on.name.starts_with("wrong model"), |it| it.without = Some(TipPart::Slope)),
    control(NO_RATE_WEIGHT, PURPLE, |on| on.name == "laboratory", |_| {}),
    // No clearance margin where the tip is measured in addition to the bends.
    control("no margin", SKY, |on| on.name == "5 % longer, ball", |it| it.without = Some(TipPart::Margin)),
    control(FIRST, ORANGE, |_| true, |it| { unfiltered(it); it.actuator = Actuator::IDEAL; }),
    control("no tip", PURPLE, |on| on.sensor.starts_with("both"), |it| it.sensor = Sensor::Cables),
    control("open loop", GREY, |_| true, |it| it.sensor = Sensor::Nothing),
];

fn unfiltered(driven: &mut Driven) {
    (driven.time_constant_s, driven.without) = (0.0, Some(TipPart::Filter));
}

impl Control {
    pub(super) fn is_full(&self) -> bool {
        self.name == CONTROLS[0].name
    }

    fn weighs_rates(&self) -> bool {
        ![NO_RATE_WEIGHT, FIRST].contains(&self.name)
    }

    pub(super) fn rests(&self) -> bool {
        self.is_full() || !self.weighs_rates()
    }

    pub(super) fn eight(&self, scenario: &Scenario) -> Result<FigureEight, FigureEightError> {
        let eight = scenario.eight()?;
        if self.weighs_rates() {
            return Ok(eight);
        }
        Ok(eight.with_settings(NmpcSettings {
            rate_weight: 0.0.into(),
            ..NmpcSettings::default()
        }))
    }
}

/// A robot of `scenarios.toml`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct Scenario {
    pub(super) name: String,
    /// The preset of `link.simulated`, if the robot is one.
    plant: Option<String>,
    flaws: BTreeMap<String, f64>,
    known: BTreeMap<String, f64>,
    pub(super) sensor: String,
    way: String,
    pub(super) ball_x_m: Option<f64>,
    pub(super) rests: bool,
    targets: String,
}

/// A number that is wanted: its key in a row, its name, and its bound \[mm\].
type Target = (String, String, f64);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Scenarios {
    targets: BTreeMap<String, Vec<Target>>,
    scenarios: Vec<Scenario>,
}

fn declared() -> Scenarios {
    toml::from_str(include_str!("scenarios.toml")).expect("a declaration")
}

/// Over that of the ideal robot.
const RATE_CHANGE: &str = "rate_change_rms";
/// Of the true body; the only number with a lower bound.
const CLEARANCE: &str = "min_clearance_mm";

impl Scenario {
    pub(super) fn all() -> Vec<Self> {
        declared().scenarios
    }

    pub(super) fn plant(&self) -> &str {
        self.plant.as_deref().unwrap_or("of its own")
    }

    pub(super) fn flaws(&self) -> Flaws {
        let mut presets = RobotPreset::ALL.into_iter();
        let own = presets.find(|preset| preset.name() == self.plant());
        with(own.map(RobotPreset::flaws).unwrap_or_default(), &self.flaws)
    }

    /// The controller's model of the motors.
    fn actuator(&self) -> Actuator {
        with(self.flaws(), &self.known).actuator
    }

    fn sensor(&self) -> Sensor {
        let (kind, every) = self.sensor.split_once(' ').unwrap_or_default();
        let every = every.parse().unwrap_or(1);
        match kind {
            "both" => Sensor::CablesAndTip { every },
            "tip" => Sensor::Tip { every },
            _ => Sensor::Cables,
        }
    }

    fn eight(&self) -> Result<FigureEight, FigureEightError> {
        match self.way.split_once(' ') {
            Some(("spiral", lower_m)) => FigureEight::spiral(lower_m.parse().unwrap_or_default()),
            Some((_, sections)) => FigureEight::through_straight(sections.parse().unwrap_or(3)),
            None => FigureEight::new(),
        }
    }

    fn targets(&self) -> Vec<Target> {
        if self.targets.is_empty() {
            return Vec::new();
        }
        let mut targets = declared().targets;
        targets.remove(&self.targets).expect("declared targets")
    }

    /// Targets that were not measured count as reached. `ideal_change`: `rate_change_rms` of the ideal robot.
    pub(super) fn is_reached(&self, row: &Value, ideal_change: Option<f64>) -> bool {
        self.targets().iter().all(|(key, _, bound)| {
            let found = row[key].as_f64();
            match &**key {
                CLEARANCE => found.is_none_or(|found| found >= *bound),
                RATE_CHANGE => {
                    let found = found.zip(ideal_change);
                    found.is_none_or(|(found, ideal)| found / ideal <= *bound)
                }
                _ => found.is_none_or(|found| found <= *bound),
            }
        })
    }

    pub(super) fn wanted(&self) -> String {
        let words = |(key, name, bound): Target| match &*key {
            CLEARANCE => format!("{name} ≥ {bound} mm"),
            RATE_CHANGE => format!("{name} ≤ {bound} × ideal"),
            _ => format!("{name} ≤ {bound} mm"),
        };
        let words: Vec<String> = self.targets().into_iter().map(words).collect();
        match &words[..] {
            [] => "within limits".to_owned(),
            words => words.join(", "),
        }
    }

    pub(super) fn controls(&self) -> impl Iterator<Item = &'static Control> {
        CONTROLS.iter().filter(|control| (control.is_for)(self))
    }

    pub(super) fn driven(&self, control: &Control, obeys_positions: bool, seed: u64) -> Driven {
        let mut driven = Driven {
            flaws: self.flaws(),
            actuator: self.actuator(),
            time_constant_s: TIME_CONSTANT_S,
            obeys_positions,
            sensor: self.sensor(),
            without: None,
            seed,
        };
        (control.change)(&mut driven);
        driven
    }
}

fn with(flaws: Flaws, named: &BTreeMap<String, f64>) -> Flaws {
    let set = |flaws: Flaws, (name, value): (&String, &f64)| flaws.with(name, *value);
    let flaws = named.iter().try_fold(flaws, set);
    flaws.expect("a flaw that is declared")
}
