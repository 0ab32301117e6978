//! Robots that differ from their model: true error of the tip with the full controller, and with each of its
//! parts switched off.
//!
//! An offline closed loop; the same seed gives the same bits.

mod parts;
mod scenario;
mod tuning;

use std::collections::BTreeMap;
use std::sync::mpsc;
use std::thread;

use anyhow::{Context, Result, ensure};
use cdcr_controller::closed_loop::{FigureEight, FigureEightRest, FigureEightRun};
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::robot::{Obstacle, Shape};
use nalgebra::Vector3;
use serde_json::{Value, json};

pub use parts::parts;
pub use tuning::knob;

use crate::benchmark::Benchmark;
use crate::chart::{Curve, Panel, Scale, plot};
use crate::dataset::{Column, Dataset, Sheet, fixed, plain, word};
use crate::interrupt;
use crate::progress::Progress;
use scenario::{Control, Scenario, Way};

const EXPLANATION: &str = include_str!("robustness.html");

const COLUMNS: [Column; 16] = [
    word("robot", "name"),
    word("plant", "plant"),
    word("controller", "controller"),
    word("interface", "interface"),
    plain("seeds", "seeds"),
    fixed("mean mm", "mean_error_mm", 3),
    fixed("rms mm", "rms_error_mm", 3),
    fixed("settled mm", "settled_error_mm", 3),
    fixed("max mm", "max_error_mm", 3),
    fixed("at rest mm", "rest_error_mm", 3),
    fixed("at rest rad/s", "rest_rate_rad_s", 3),
    fixed("rate change rms rad/s", "rate_change_rms", 4),
    fixed("clearance mm", "min_clearance_mm", 2),
    fixed("following mm", "following_error_mm", 3),
    word("wanted", "wanted"),
    word("reached", "ok"),
];

/// Effect of the controller's parts, one robot per line.
const COMPARISON: [Column; 10] = [
    word("robot", "name"),
    fixed("full", "full", 3),
    fixed("no actuator model", "no actuator model", 3),
    fixed("first version", "first version", 3),
    fixed("no tip", "no tip", 3),
    fixed("open loop", "open loop", 3),
    fixed("rate change rms rad/s", "rate_change_rms", 4),
    fixed("at rest", "rest_error_mm", 3),
    word("wanted", "wanted"),
    word("reached", "ok"),
];

/// Tolerance for rounding of the limits of a command, as a share.
const LIMIT_EXCESS_MAX: f64 = 1e-9;
/// Smallest drawn error \[mm\].
const DRAWN_MM: f64 = 1e-3;
/// Cycles of which the largest error is drawn.
const DRAWN_CYCLES: usize = 10;
/// Approximate duration of a run \[s\].
const RUN_S: f64 = 0.12;

#[derive(Debug, Clone, clap::Args)]
pub struct RobustnessOptions {
    /// Runs of each robot with each controller, each with its own noise, 1 to 1000.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub seeds: u32,
    /// Run only the ideal robot, the basis of comparison, and robots with TEXT in their name; with --sweep, only the
    /// presets and the keys that contain TEXT ("preset": only the presets).
    #[arg(long, value_name = "TEXT")]
    pub only: Option<String>,
    /// Vary one configuration key at a time on the laboratory robot instead: the tables and the plot of docs/tuning.md.
    #[arg(long, conflicts_with = "seeds")]
    pub sweep: bool,
}

impl Benchmark for RobustnessOptions {
    fn for_report(&mut self) {
        self.seeds = 20;
    }

    fn quicken(&mut self) {
        self.seeds = 1;
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.seeds
    }

    fn check(&self) -> Result<()> {
        let only = self.only.as_deref();
        let words = only.unwrap_or_default();
        if self.sweep {
            let is_any = tuning::is_any(only);
            ensure!(
                is_any,
                "no swept key contains {words:?}: see docs/tuning.md for the keys"
            );
        } else {
            let is_any = Scenario::all().iter().any(|scenario| self.names(scenario));
            ensure!(
                is_any,
                "no robot name contains {words:?}: see docs/robustness.md for the names"
            );
        }
        Ok(())
    }

    fn expected_s(&self) -> f64 {
        if self.sweep {
            return tuning::count(self.only.as_deref()) as f64 * RUN_S;
        }
        f64::from(self.seeds) * self.cases().len() as f64 * RUN_S / cores() as f64
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        if self.sweep {
            return tuning::run(self.only.as_deref(), RUN_S, progress);
        }
        let mut dataset =
            Dataset::new("robustness", "Robots that are not their model", EXPLANATION);
        let (mut rows, mut panels) = (Vec::<Value>::new(), Vec::<Panel>::new());
        let cases = self.cases();
        for (case, runs) in cases.iter().zip(self.all_runs(&cases, progress)?) {
            let Case {
                scenario,
                control,
                obeys_positions,
            } = case;
            let interface = if *obeys_positions {
                draw(&mut panels, scenario, *control, &runs.rounds[0]);
                "position"
            } else {
                "velocity"
            };
            // Without noise, all runs are equal.
            let is_noisy = scenario.flaws.noise_m + scenario.flaws.tip_noise_m > 0.0;
            if *control == Control::Full && is_noisy {
                let name = format!("robustness/{}/{interface}/mean_error", scenario.name);
                dataset.lower(name, "mm", runs.rounds.iter().map(FigureEightRun::mean_mm));
            }
            // The first robot is the ideal one.
            let ideal = rows.first().and_then(|row| row["rate_change_rms"].as_f64());
            rows.push(row(scenario, *control, interface, &runs, ideal));
        }
        panels.retain(|panel| !panel.is_below(DRAWN_MM));
        if !panels.is_empty() {
            let caption = "Error of the tip in truth, simulated, position interface, the first seed. \
                 Robots whose error is below 0.001 mm throughout, as the ideal one, are left out.";
            let errors = plot("robustness-error", caption, (2, 420), &panels)?;
            dataset.plots.push(errors);
        }
        dataset.sheets.push(comparison(&rows));
        dataset.sheets.push(parts(&rows));
        let title = "Robots that are not their model, on a figure eight";
        let sheet = Sheet::of(title, &COLUMNS, rows);
        dataset
            .sheets
            .push(sheet.key("scenarios").file("robustness"));
        Ok(dataset)
    }
}

struct Case {
    scenario: Scenario,
    control: Control,
    obeys_positions: bool,
}

impl RobustnessOptions {
    fn names(&self, scenario: &Scenario) -> bool {
        let only = self.only.as_deref();
        only.is_none_or(|only| scenario.name.contains(only))
    }

    /// Each scenario with its controllers, behind both interfaces.
    fn cases(&self) -> Vec<Case> {
        let is_wanted = |scenario: &Scenario| scenario.is_ideal() || self.names(scenario);
        let mut cases = Vec::new();
        for scenario in Scenario::all().into_iter().filter(is_wanted) {
            for control in scenario.controls() {
                cases.extend([true, false].map(|obeys_positions| Case {
                    scenario: scenario.clone(),
                    control,
                    obeys_positions,
                }));
            }
        }
        cases
    }

    /// Runs all cases, distributed over the cores; they are independent of each other.
    fn all_runs(&self, cases: &[Case], progress: &mut Progress) -> Result<Vec<Runs>> {
        let eight = &FigureEight::new()?;
        let mut done = BTreeMap::new();
        thread::scope(|scope| {
            let (sender, results) = mpsc::channel();
            for first in 0..cores() {
                let sender = sender.clone();
                let own = cases.iter().enumerate().skip(first).step_by(cores());
                scope.spawn(move || {
                    let mut runs = own.map(|(place, case)| (place, case.runs(eight, self.seeds)));
                    // After a failure, the receiver is gone.
                    let _ = runs.try_for_each(|runs| sender.send(runs));
                });
            }
            drop(sender);
            for (place, runs) in results {
                let case = &cases[place];
                progress.begin(&format!("{}, {}", case.scenario.name, case.control.name()));
                progress.advance(f64::from(self.seeds) * RUN_S / cores() as f64);
                done.insert(place, runs?);
            }
            Ok(done.into_values().collect())
        })
    }
}

impl Case {
    /// One run for each seed.
    fn runs(&self, eight: &FigureEight, seeds: u32) -> Result<Runs> {
        let scenario = &self.scenario;
        let eight = self.control.eight(match scenario.way {
            Way::Eight => eight.clone(),
            Way::ThroughStraight(sections) => FigureEight::through_straight(sections)?,
            Way::Spiral { lower_m } => FigureEight::spiral(lower_m)?,
        });
        let obstacles = scenario.ball_x_m.into_iter().map(ball);
        let obstacles: Vec<_> = obstacles.collect::<Result<_>>()?;
        let mut runs = Runs::default();
        for seed in 1..=u64::from(seeds) {
            interrupt::check()?;
            let driven = scenario.driven(self.control, self.obeys_positions, seed);
            runs.rounds.push(eight.run(driven, &obstacles)?);
            if scenario.rests && self.control.rests() {
                runs.rests.push(eight.rest(driven)?);
            }
        }
        Ok(runs)
    }
}

fn cores() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// A ball of 20 mm radius on the figure eight or beside it.
fn ball(x_m: f64) -> Result<Obstacle> {
    let centre_m = Vector3::new(x_m, 0.0, 0.7);
    Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).context("the ball")
}

/// The mean error of every robot with each controller behind the position interface, from the rows of a
/// result.
pub fn comparison(rows: &[Value]) -> Sheet {
    let mut robots: Vec<Value> = Vec::new();
    for row in rows.iter().filter(|row| row["interface"] == "position") {
        if row["controller"] == "full" {
            robots.push(row.clone());
        }
        if let (Some(robot), Some(controller)) = (robots.last_mut(), row["controller"].as_str()) {
            robot[controller] = row["mean_error_mm"].clone();
        }
    }
    let title = "Mean error of the tip in truth, mm, position interface: with all that the controller does, and with a part switched off; of the whole controller root mean square of what the rates change by from cycle to cycle, and largest error at rest, mm";
    Sheet::of(title, &COMPARISON, robots)
}

#[derive(Default)]
struct Runs {
    rounds: Vec<FigureEightRun>,
    /// Results at rest; empty without a target for them.
    rests: Vec<FigureEightRest>,
}

/// The row of a robot with a controller, over all seeds. `ideal_change`: root mean square of the rate changes
/// of the ideal robot \[rad/s\].
fn row(
    scenario: &Scenario,
    control: Control,
    interface: &str,
    Runs { rounds, rests }: &Runs,
    ideal_change: Option<f64>,
) -> Value {
    type Of = fn(&FigureEightRun) -> f64;
    let average = |of: Of| rounds.iter().map(of).sum::<f64>() / rounds.len() as f64;
    let largest = |of: Of| rounds.iter().map(of).fold(0.0, f64::max);
    let at_rest = |of: fn(&FigureEightRest) -> f64| rests.iter().map(of).reduce(f64::max);
    let clearances_mm = rounds.iter().map(FigureEightRun::min_clearance_mm);
    let limit_excess = largest(FigureEightRun::limit_excess);
    let mut row = json!({
        "name": scenario.name,
        "plant": scenario.plant(),
        "controller": control.name(),
        "interface": interface,
        "seeds": rounds.len(),
        "mean_error_mm": average(FigureEightRun::mean_mm),
        "settled_error_mm": average(FigureEightRun::settled_mm),
        "rms_error_mm": largest(FigureEightRun::rms_mm),
        "max_error_mm": largest(FigureEightRun::max_mm),
        "rest_error_mm": at_rest(|rest| rest.error_mm),
        // Of the fastest component.
        "rest_rate_rad_s": at_rest(|rest| rest.rate_rad_s),
        // Root mean square of the change of the rates from cycle to cycle [rad/s].
        "rate_change_rms": average(FigureEightRun::rate_change_square).sqrt(),
        // Of the true body; null without an obstacle.
        "min_clearance_mm": clearances_mm.reduce(f64::min).filter(|mm| mm.is_finite()),
        "safe_distance_mm": 1e3 * NmpcSettings::default().safe_distance_m,
        // Of the motor with the largest following error.
        "following_error_mm": largest(FigureEightRun::following_mm),
        // Largest excess of a command over a limit, as a share of the limit.
        "limit_excess": limit_excess,
        "wanted": null,
        "ok": null,
    });
    // There are no targets for a controller with a part switched off.
    if control == Control::Full {
        let is_within = scenario.is_reached(&row, ideal_change);
        row["ok"] = (is_within && limit_excess <= LIMIT_EXCESS_MAX).into();
        row["wanted"] = scenario.wanted().into();
    }
    row
}

/// A panel with the error of the first run over time.
fn draw(panels: &mut Vec<Panel>, scenario: &Scenario, control: Control, run: &FigureEightRun) {
    let most = |errors_mm: &[f64]| errors_mm.iter().copied().fold(0.0, f64::max);
    let parts = run.errors_mm().chunks(DRAWN_CYCLES).enumerate();
    let time_s = |part: usize| (part * DRAWN_CYCLES) as f64 * FigureEight::PERIOD_S;
    let points = parts.map(|(part, errors_mm)| (time_s(part), most(errors_mm)));
    let curve = Curve::line(control.name(), points.collect(), control.colour());
    if control == Control::Full {
        panels.push(Panel::new(
            scenario.name,
            ["time [s]", "error of the tip [mm]"],
            Scale::Log { floor: DRAWN_MM },
            Vec::new(),
        ));
    }
    if let Some(panel) = panels.last_mut() {
        panel.curves.push(curve);
    }
}
