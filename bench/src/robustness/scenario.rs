//! Robots, what the controller knows of them, and the controllers compared on them.

use cdcr_controller::closed_loop::{Driven, FigureEight, FigureEightError, Part, Sensor};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::plant::{Flaws, Preset};
use serde_json::Value;

use crate::chart::{BLUE, GREEN, GREY, ORANGE, PURPLE, RGBColor, SKY};

/// Mean distance of the second half of the spiral from the nearest point that a tip with 5 % shorter sections
/// reaches \[mm\]: see the test below.
const OUT_OF_REACH_MM: f64 = 34.22;

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
    control("no actuator model", GREEN, |on| on.actuator != Actuator::IDEAL, |it| it.actuator = Actuator::IDEAL),
    control("no filter", SKY, |on| on.name == "30 µm of noise" || on.name.starts_with("tip alone"), unfiltered),
    control("no offset along the way", SKY, |on| on.name.starts_with("wrong model"), |it| it.without = Some(Part::Slope)),
    control(NO_RATE_WEIGHT, PURPLE, |on| on.name == "laboratory", |_| {}),
    // No clearance margin where the tip is measured in addition to the bends.
    control("no margin", SKY, |on| on.name == "5 % longer, ball", |it| it.without = Some(Part::Margin)),
    control(FIRST, ORANGE, |_| true, |it| { unfiltered(it); it.actuator = Actuator::IDEAL; }),
    control("no tip", PURPLE, |on| matches!(on.sensor, Sensor::CablesAndTip { .. }), |it| it.sensor = Sensor::Cables),
    control("open loop", GREY, |_| true, |it| it.sensor = Sensor::Nothing),
];

fn unfiltered(driven: &mut Driven) {
    (driven.time_constant_s, driven.without) = (0.0, Some(Part::Filter));
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

    pub(super) fn eight(&self, way: Way) -> Result<FigureEight, FigureEightError> {
        let eight = way()?;
        if self.weighs_rates() {
            return Ok(eight);
        }
        Ok(eight.with_settings(NmpcSettings {
            rate_weight: 0.0.into(),
            ..NmpcSettings::default()
        }))
    }
}

type Way = fn() -> Result<FigureEight, FigureEightError>;

#[derive(Debug, Clone)]
pub(super) struct Scenario {
    pub(super) name: &'static str,
    /// The preset of `link.simulated`, if the robot is one.
    pub(super) plant: &'static str,
    pub(super) flaws: Flaws,
    /// The controller's model of the motors.
    actuator: Actuator,
    sensor: Sensor,
    pub(super) way: Way,
    /// Centre of a ball at the path (m).
    pub(super) ball_x_m: Option<f64>,
    /// The robot is also sent to a position at which it must stay.
    pub(super) rests: bool,
    targets: &'static [Target],
}

/// A number that is wanted: its key in a row, its name, and its bound \[mm\]. In addition, every command must be
/// within its limits.
type Target = (&'static str, &'static str, f64);

/// Over that of the ideal robot.
const RATE_CHANGE: &str = "rate_change_rms";
/// Of the true body; the only number with a lower bound.
const CLEARANCE: &str = "min_clearance_mm";

const QUIET: &[Target] = &[
    ("rms_error_mm", "rms", 0.15),
    (RATE_CHANGE, "rate change", 2.0),
];
const PUNCTUAL: &[Target] = &[("mean_error_mm", "mean", 0.5), ("max_error_mm", "max", 2.0)];
const FINE: &[Target] = &[("mean_error_mm", "mean", 0.1)];
const COARSE: &[Target] = &[("mean_error_mm", "mean", 0.25)];
const EXACT: &[Target] = &[("settled_error_mm", "settled", 0.2)];
const NEAREST: &[Target] = &[("settled_error_mm", "settled", OUT_OF_REACH_MM + 0.2)];
const STILL: &[Target] = &[("rest_error_mm", "at rest", 0.3)];
const CLEAR: &[Target] = &[(CLEARANCE, "clearance", 9.9)];

/// Declares how a field of a scenario is changed.
macro_rules! changes {
    ($($field:ident: $type:ty;)+) => {
        $(pub(super) fn $field(self, $field: $type) -> Self {
            Self { $field, ..self }
        })+
    };
}

impl Scenario {
    /// The motors are known; the cable lengths are measured.
    fn new(name: &'static str, flaws: Flaws) -> Self {
        Self {
            name,
            plant: "of its own",
            actuator: flaws.actuator,
            flaws,
            sensor: Sensor::Cables,
            way: FigureEight::new,
            ball_x_m: None,
            rests: false,
            targets: &[],
        }
    }

    changes! {
        plant: &'static str;
        actuator: Actuator;
        sensor: Sensor;
        way: Way;
        ball_x_m: Option<f64>;
        rests: bool;
        targets: &'static [Target];
    }

    pub(super) fn preset(name: &'static str, preset: Preset) -> Self {
        Self::new(name, preset.flaws()).plant(preset.name())
    }

    #[rustfmt::skip]
    pub(super) fn all() -> Vec<Self> {
        let (of, preset) = (Self::new, Self::preset);
        let ideal = Flaws::default();
        let noise = |noise_m| Flaws { noise_m, ..ideal };
        let tip_noise = |tip_noise_m| Flaws { tip_noise_m, ..ideal };
        let lag = |delay_s, time_constant_s| Flaws { actuator: motors(delay_s, time_constant_s, 0.0), ..ideal };
        let known = motors(0.015, 0.03, 0.0);
        let wrong = |length_error| Flaws { length_error, payload_rad: [0.015, 0.0], ..tip_noise(3e-4) };
        let play = |actuator| Flaws { actuator, noise_m: 3e-5, ..tip_noise(3e-4) };
        let half_mm = play(motors(0.0, 0.0, 5e-4));
        let both = |every| Sensor::CablesAndTip { every };
        let alone = Sensor::Tip { every: 1 };
        let spiral: Way = || FigureEight::spiral(0.0);
        let one: Way = || FigureEight::through_straight(1);
        let two: Way = || FigureEight::through_straight(2);
        let three: Way = || FigureEight::through_straight(3);
        vec![
            preset("ideal", Preset::Ideal),
            of("30 µm of noise", noise(3e-5)).targets(QUIET),
            // Uniform within ± √3 σ.
            of("30 µm of noise, standard deviation", noise(3e-5 * 3_f64.sqrt())).targets(QUIET),
            of("lag 30 ms, delay 15 ms", lag(0.015, 0.03)).actuator(known).targets(PUNCTUAL),
            of("lag 21 ms, delay 10 ms", lag(0.01, 0.021)).actuator(known).targets(PUNCTUAL),
            of("lag 39 ms, delay 20 ms", lag(0.02, 0.039)).actuator(known).targets(PUNCTUAL),
            of("wrong model", wrong(0.05)).sensor(both(2)).targets(EXACT),
            of("wrong model, 5 % shorter", wrong(-0.05)).sensor(both(2)).targets(EXACT),
            of("wrong model, spiral", wrong(0.05)).sensor(both(2)).way(spiral).targets(EXACT),
            of("wrong model, 5 % shorter, lower spiral", wrong(-0.05)).sensor(both(2)).way(|| FigureEight::spiral(0.06))
                .targets(EXACT),
            of("wrong model, 5 % shorter, spiral", wrong(-0.05)).sensor(both(2)).way(spiral).targets(NEAREST),
            of("play of 0.5 mm", half_mm).sensor(both(1)).rests(true).targets(STILL),
            of("play of 0.5 mm, known as 0.4", half_mm).actuator(motors(0.0, 0.0, 4e-4)).sensor(both(1)).rests(true)
                .targets(STILL),
            of("play of 0.5 mm, taken for 0.6", half_mm).actuator(motors(0.0, 0.0, 6e-4)).sensor(both(1)).rests(true)
                .targets(STILL),
            // With and without play, to separate a limit cycle at rest from noise.
            of("lag 20 ms, tip at 100 Hz", play(motors(0.0, 0.02, 0.0))).sensor(both(2)).rests(true),
            of("lag 20 ms, tip at 100 Hz, play of 0.5 mm", play(motors(0.0, 0.02, 5e-4))).sensor(both(2)).rests(true)
                .targets(STILL),
            of("tip alone, 0.1 mm", tip_noise(1e-4)).sensor(alone).targets(FINE),
            of("tip alone, 0.5 mm", tip_noise(5e-4)).sensor(alone).targets(COARSE),
            of("tip alone, 0.1 mm, 1 section, through straight", tip_noise(1e-4)).sensor(alone).way(one).targets(FINE),
            of("tip alone, 0.5 mm, 1 section, through straight", tip_noise(5e-4)).sensor(alone).way(one).targets(COARSE),
            of("tip alone, 0.1 mm, 2 sections, through straight", tip_noise(1e-4)).sensor(alone).way(two).targets(FINE),
            of("tip alone, 0.5 mm, 2 sections, through straight", tip_noise(5e-4)).sensor(alone).way(two).targets(COARSE),
            of("tip alone, 0.1 mm, 3 sections, through straight", tip_noise(1e-4)).sensor(alone).way(three).targets(FINE),
            of("tip alone, 0.5 mm, 3 sections, through straight", tip_noise(5e-4)).sensor(alone).way(three).targets(COARSE),
            // It would collide with the ball.
            of("5 % longer, ball", Flaws { length_error: 0.05, ..play(Actuator::IDEAL) }).sensor(both(2))
                .ball_x_m(Some(0.33)).targets(CLEAR),
            preset("laboratory", Preset::Laboratory).rests(true),
            // At the turn, 5 mm nearer to the tip than the safe distance.
            preset("laboratory, ball", Preset::Laboratory).ball_x_m(Some(0.37)),
            preset("sloppy, with tip", Preset::Sloppy).sensor(both(2)),
            preset("slow", Preset::Slow),
            preset("blind", Preset::Blind).sensor(alone),
        ]
    }

    /// Whether a row reaches all targets; targets that were not measured count as reached. `ideal_change`:
    /// `rate_change_rms` of the ideal robot.
    pub(super) fn is_reached(&self, row: &Value, ideal_change: Option<f64>) -> bool {
        self.targets.iter().all(|&(key, _, bound)| {
            let found = row[key].as_f64();
            match key {
                CLEARANCE => found.is_none_or(|found| found >= bound),
                RATE_CHANGE => {
                    let found = found.zip(ideal_change);
                    found.is_none_or(|(found, ideal)| found / ideal <= bound)
                }
                _ => found.is_none_or(|found| found <= bound),
            }
        })
    }

    pub(super) fn wanted(&self) -> String {
        let words = self.targets.iter().map(|&(key, name, bound)| match key {
            CLEARANCE => format!("{name} ≥ {bound} mm"),
            RATE_CHANGE => format!("{name} ≤ {bound} × ideal"),
            _ => format!("{name} ≤ {bound} mm"),
        });
        match self.targets {
            [] => "within limits".to_owned(),
            _ => words.collect::<Vec<_>>().join(", "),
        }
    }

    pub(super) fn controls(&self) -> impl Iterator<Item = &'static Control> {
        CONTROLS.iter().filter(|control| (control.is_for)(self))
    }

    pub(super) fn driven(&self, control: &Control, obeys_positions: bool, seed: u64) -> Driven {
        let mut driven = Driven {
            flaws: self.flaws,
            actuator: self.actuator,
            time_constant_s: TIME_CONSTANT_S,
            obeys_positions,
            sensor: self.sensor,
            without: None,
            seed,
        };
        (control.change)(&mut driven);
        driven
    }
}

fn motors(delay_s: f64, time_constant_s: f64, play_m: f64) -> Actuator {
    Actuator {
        delay_s,
        time_constant_s,
        play_m,
    }
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::{Robot, RobotParameters};

    use super::*;
    use crate::closed_loop;
    use crate::closed_loop::Scene;
    use crate::experiment::Task;

    /// A controller that knows the shorter sections keeps the tip at the nearest reachable point.
    #[test]
    fn the_part_of_the_spiral_that_is_out_of_reach_is_that_far_away() {
        let mut shorter = RobotParameters::paper(3);
        for section in &mut shorter.sections {
            section.length_m *= 0.95;
        }
        let scene = Scene {
            robot: Robot::new(&shorter).unwrap(),
            ..Task::Spiral { sections: 3 }.scene().unwrap()
        };
        let samples = closed_loop::run(&scene, NmpcSettings::default()).unwrap();
        // The evaluated cycles: see `FigureEightRun::settled_mm`.
        let settled = &samples[597..];
        let errors_mm = settled.iter().map(closed_loop::Sample::error_mm);
        let mean_mm = errors_mm.sum::<f64>() / settled.len() as f64;
        assert!((mean_mm - OUT_OF_REACH_MM).abs() < 0.005, "{mean_mm}");
    }
}
