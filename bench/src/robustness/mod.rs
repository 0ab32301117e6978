//! Robots that differ from their model: true error of the tip with the full controller, and with each of its
//! parts switched off.
//!
//! An offline closed loop; the same seed gives the same bits.

mod scenario;
mod tuning;

use std::collections::BTreeMap;
use std::sync::mpsc;
use std::thread;

use anyhow::{Result, ensure};
use cdcr_controller::closed_loop::{FigureEight, FigureEightRest, FigureEightRun};
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::robot::{Obstacle, Shape};
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::chart::{Curve, Panel, Scale};
use crate::dataset::{Dataset, number};
use crate::interrupt;
use crate::progress::Progress;
use scenario::{CONTROLS, Control, Scenario};

const DECLARATION: &str = include_str!("robustness.toml");

#[derive(serde::Deserialize)]
struct Parts {
    shown_parts: Vec<[String; 5]>,
}

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
    #[arg(long, alias = "rounds", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
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

    fn check(&self) -> Result<()> {
        let only = self.only.as_deref();
        let (is_any, what, place) = if self.sweep {
            let is_any = tuning::is_any(only);
            (is_any, "swept key", "tuning.md for the keys")
        } else {
            let is_any = Scenario::all().iter().any(|scenario| self.names(scenario));
            (is_any, "robot name", "robustness.md for the names")
        };
        let words = only.unwrap_or_default();
        ensure!(is_any, "no {what} contains {words:?}: see docs/{place}");
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
        let mut dataset = Dataset::new("robustness", DECLARATION);
        let (mut rows, mut panels) = (Vec::<Value>::new(), Vec::<Panel>::new());
        let cases = self.cases();
        for (case, runs) in cases.iter().zip(self.all_runs(&cases, progress)?) {
            let (scenario, control) = (&case.scenario, case.control);
            if case.obeys_positions {
                draw(&mut panels, scenario, control, &runs.rounds[0]);
            }
            // Without noise, all runs are equal.
            let flaws = scenario.flaws();
            let is_noisy = flaws.noise_m + flaws.tip_noise_m > 0.0;
            if control.is_full() && is_noisy {
                let (robot, interface) = (&scenario.name, case.interface());
                let name = format!("robustness/{robot}/{interface}/mean_error");
                dataset.lower(name, "mm", runs.rounds.iter().map(FigureEightRun::mean_mm));
            }
            // The first robot is the ideal one.
            let ideal = rows.first().and_then(|row| row["rate_change_rms"].as_f64());
            rows.push(case.row(&runs, ideal));
        }
        panels.retain(|panel| !panel.is_below(DRAWN_MM));
        let panels: Vec<_> = panels.into_iter().map(Panel::tapered).collect();
        dataset.plot("robustness-error", &panels)?;
        dataset.add("comparison", comparison(&rows));
        dataset.add("parts", parts(&rows));
        dataset.add("scenarios", rows);
        Ok(dataset)
    }
}

struct RobotCase {
    scenario: Scenario,
    control: &'static Control,
    obeys_positions: bool,
}

impl RobustnessOptions {
    fn names(&self, scenario: &Scenario) -> bool {
        let only = self.only.as_deref();
        only.is_none_or(|only| scenario.name.contains(only))
    }

    fn cases(&self) -> Vec<RobotCase> {
        let is_wanted = |scenario: &Scenario| scenario.plant() == "ideal" || self.names(scenario);
        let mut cases = Vec::new();
        for scenario in Scenario::all().into_iter().filter(is_wanted) {
            for control in scenario.controls() {
                cases.extend([true, false].map(|obeys_positions| RobotCase {
                    scenario: scenario.clone(),
                    control,
                    obeys_positions,
                }));
            }
        }
        cases
    }

    /// Runs all cases, distributed over the cores; they are independent of each other.
    fn all_runs(&self, cases: &[RobotCase], progress: &mut Progress) -> Result<Vec<Runs>> {
        let mut done = BTreeMap::new();
        thread::scope(|scope| {
            let (sender, results) = mpsc::channel();
            for first in 0..cores() {
                let sender = sender.clone();
                let own = cases.iter().enumerate().skip(first).step_by(cores());
                scope.spawn(move || {
                    let mut runs = own.map(|(place, case)| (place, case.runs(self.seeds)));
                    // After a failure, the receiver is gone.
                    let _ = runs.try_for_each(|runs| sender.send(runs));
                });
            }
            drop(sender);
            for (place, runs) in results {
                let case = &cases[place];
                progress.begin(&format!("{}, {}", case.scenario.name, case.control.name));
                progress.advance(f64::from(self.seeds) * RUN_S / cores() as f64);
                done.insert(place, runs?);
            }
            Ok(done.into_values().collect())
        })
    }
}

impl RobotCase {
    fn runs(&self, seeds: u32) -> Result<Runs> {
        let scenario = &self.scenario;
        let eight = self.control.eight(scenario)?;
        let ball = |x_m| {
            let centre_m = Vector3::new(x_m, 0.0, 0.7);
            Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros())
        };
        let obstacles = Vec::from_iter(scenario.ball_x_m.map(ball).transpose()?);
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

    fn interface(&self) -> &'static str {
        ["velocity", "position"][usize::from(self.obeys_positions)]
    }

    fn row(&self, Runs { rounds, rests }: &Runs, ideal_change: Option<f64>) -> Value {
        type Of = fn(&FigureEightRun) -> f64;
        let average = |of: Of| rounds.iter().map(of).sum::<f64>() / rounds.len() as f64;
        let largest = |of: Of| rounds.iter().map(of).fold(0.0, f64::max);
        let at_rest = |of: fn(&FigureEightRest) -> f64| rests.iter().map(of).reduce(f64::max);
        let clearances_mm = rounds.iter().map(FigureEightRun::min_clearance_mm);
        let limit_excess = largest(FigureEightRun::limit_excess);
        let mut row = json!({
            "name": self.scenario.name,
            "plant": self.scenario.plant(),
            "controller": self.control.name,
            "interface": self.interface(),
            "seeds": rounds.len(),
            "mean_error_mm": average(FigureEightRun::mean_mm),
            "settled_error_mm": average(FigureEightRun::settled_mm),
            "rms_error_mm": largest(FigureEightRun::rms_mm),
            "max_error_mm": largest(FigureEightRun::max_mm),
            "rest_error_mm": at_rest(|rest| rest.error_mm),
            "rest_rate_rad_s": at_rest(|rest| rest.rate_rad_s),
            "rate_change_rms": average(FigureEightRun::rate_change_square).sqrt(),
            "min_clearance_mm": clearances_mm.reduce(f64::min).filter(|mm| mm.is_finite()),
            "safe_distance_mm": 1e3 * NmpcSettings::default().safe_distance_m,
            "following_error_mm": largest(FigureEightRun::following_mm),
            "limit_excess": limit_excess,
            "wanted": null,
            "ok": null,
        });
        // There are no targets for a controller with a part switched off.
        if self.control.is_full() {
            let is_within = self.scenario.is_reached(&row, ideal_change);
            row["ok"] = (is_within && limit_excess <= LIMIT_EXCESS_MAX).into();
            row["wanted"] = self.scenario.wanted().into();
        }
        row
    }
}

#[derive(Default)]
struct Runs {
    rounds: Vec<FigureEightRun>,
    rests: Vec<FigureEightRest>,
}

fn cores() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Effect of each part of the controller: a number of a robot that needs it, with the part and without.
fn parts(rows: &[Value]) -> Vec<Value> {
    let declared: Parts = toml::from_str(DECLARATION).expect("a declaration");
    let row = |[part, without, robot, key, figure]: &[String; 5]| {
        let of = |controller: &str| {
            let mut rows = rows.iter().filter(|row| row["interface"] == "position");
            let row = rows.find(|row| row["name"] == **robot && row["controller"] == controller)?;
            let value = number(row, key)?;
            let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 4.0) as usize;
            Some(format!("{value:.digits$}"))
        };
        let (with, without) = (of("full")?, of(without)?);
        let row = json!({ "part": part, "robot": robot, "figure": figure, "with": with, "without": without });
        Some(row)
    };
    declared.shown_parts.iter().filter_map(row).collect()
}

fn comparison(rows: &[Value]) -> Vec<Value> {
    let mut robots: Vec<Value> = Vec::new();
    for row in rows.iter().filter(|row| row["interface"] == "position") {
        if row["controller"] == "full" {
            let mut robot = row.clone();
            // A control that is not for this robot has no error.
            for control in &CONTROLS {
                robot[control.name] = Value::Null;
            }
            robots.push(robot);
        }
        if let (Some(robot), Some(controller)) = (robots.last_mut(), row["controller"].as_str()) {
            robot[controller] = row["mean_error_mm"].clone();
        }
    }
    robots
}

fn draw(panels: &mut Vec<Panel>, scenario: &Scenario, control: &Control, run: &FigureEightRun) {
    if control.is_full() {
        let axes = ["time [s]", "error of the tip [mm]"];
        let scale = Scale::Log { floor: DRAWN_MM };
        panels.push(Panel::new(&*scenario.name, axes, scale, Vec::new()));
    }
    let parts = run.errors_mm().chunks(DRAWN_CYCLES).enumerate();
    let point = |(part, errors_mm): (usize, &[f64])| {
        let time_s = (part * DRAWN_CYCLES) as f64 * FigureEight::PERIOD_S;
        (time_s, errors_mm.iter().copied().fold(0.0, f64::max))
    };
    let curve = Curve::line(control.name, parts.map(point).collect(), control.colour);
    if let Some(panel) = panels.last_mut() {
        panel.curves.push(curve);
    }
}
