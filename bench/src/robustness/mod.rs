//! A robot that is not its model: how far its tip is from the reference in truth, with all that the controller does about it and
//! with each part of that switched off.
//!
//! A closed loop offline; each seed gives the same bits again.

mod scenario;
mod tuning;

use anyhow::{Context, Result};
use cdcr_controller::closed_loop::{FigureEight, FigureEightRun};
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::robot::{Obstacle, Shape};
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::chart::{Curve, Panel, Scale, sheet};
use crate::dataset::{Column, Dataset, Plot, Sheet, fixed, plain, word};
use crate::interrupt;
use crate::progress::Progress;
use scenario::{Control, Scenario};

const EXPLANATION: &str = "\
<p>Three sections follow a figure eight of 160 mm by 80 mm at up to 52 mm/s. The robot is not its model: its motors lag, its \
sensors have noise, its sections have other lengths, a load bends it. The error is that of the tip in truth, without the first \
second; every row is the mean of the seeds, the largest error is that of all of them. The controller is the one of \
a daemon with its default settings and its motors configured (<em>full</em>), and the same with a part switched off.</p>\n";

const COLUMNS: [Column; 11] = [
    word("robot", "name"),
    word("controller", "controller"),
    word("interface", "interface"),
    plain("seeds", "seeds"),
    fixed("mean mm", "mean_error_mm", 3),
    fixed("settled mm", "settled_error_mm", 3),
    fixed("max mm", "max_error_mm", 3),
    fixed("rate change rms rad/s", "rate_change_rms", 4),
    fixed("clearance mm", "min_clearance_mm", 2),
    fixed("target mm", "target_mm", 2),
    word("reached", "reached"),
];

/// What the parts of the controller are for, one robot a line.
const COMPARISON: [Column; 9] = [
    word("robot", "name"),
    fixed("full", "full", 3),
    fixed("no actuator model", "no actuator model", 3),
    fixed(
        "sensors believed at once, motors taken for ideal",
        "no estimator",
        3,
    ),
    fixed("no tip", "no tip", 3),
    fixed("open loop", "open loop", 3),
    fixed("rate change rms rad/s", "rate_change_rms", 4),
    fixed("wanted", "target_mm", 2),
    word("reached", "reached"),
];

/// Cycles of which the largest error is drawn.
const DRAWN_CYCLES: usize = 10;
/// What a run takes, about \[s\].
const RUN_S: f64 = 0.12;

#[derive(Debug, Clone, Copy, clap::Args)]
pub struct RobustnessOptions {
    /// Runs of each robot with each controller, each with other noise, 1 to 1000.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub seeds: u32,
    /// Turn one knob after the other instead, on the robot of the laboratory: the tables and the picture of docs/tuning.md.
    #[arg(long, conflicts_with = "seeds")]
    pub sweep: bool,
}

impl Benchmark for RobustnessOptions {
    fn of_report(quick: bool) -> Self {
        let seeds = if quick { 1 } else { 20 };
        Self {
            seeds,
            sweep: false,
        }
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.seeds
    }

    fn expected_s(&self) -> f64 {
        if self.sweep {
            return tuning::count() as f64 * RUN_S;
        }
        f64::from(self.seeds) * 2.0 * cases().len() as f64 * RUN_S
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        if self.sweep {
            return tuning::run(RUN_S, progress);
        }
        let (eight, ball) = (FigureEight::new()?, ball()?);
        let mut dataset = Dataset {
            name: "robustness",
            heading: "Robots that are not their model",
            explanation: EXPLANATION,
            ..Dataset::default()
        };
        let (mut rows, mut panels) = (Vec::new(), Vec::<Panel>::new());
        for (scenario, control) in cases() {
            for (interface, obeys_positions) in [("position", true), ("velocity", false)] {
                let mut runs = Vec::new();
                for seed in 1..=u64::from(self.seeds) {
                    interrupt::check()?;
                    progress.begin(&format!("{}, {}", scenario.name, control.name()));
                    let driven = scenario.driven(control, obeys_positions, seed);
                    runs.push(eight.run(driven, &ball[..usize::from(scenario.has_ball)])?);
                    progress.advance(RUN_S);
                }
                if obeys_positions {
                    draw(&mut panels, &scenario, control, &runs[0]);
                }
                // Without noise every run is the same.
                let is_noisy = scenario.flaws.noise_m + scenario.flaws.tip_noise_m > 0.0;
                if control == Control::Full && is_noisy {
                    let name = format!("robustness/{}/{interface}/mean_error", scenario.name);
                    dataset.lower(name, "mm", runs.iter().map(FigureEightRun::mean_mm));
                }
                rows.push(row(&scenario, control, interface, &runs));
            }
        }
        dataset.plots.push(Plot {
            name: "robustness-error",
            caption: "Error of the tip in truth, position interface, the first seed.",
            svg: sheet(&panels, 2, 420)?,
        });
        dataset.sheets.push(comparison(&rows));
        let title = "Robots that are not their model, on a figure eight";
        let sheet = Sheet::new(&rows)?.key("scenarios").file("robustness");
        dataset.sheets.push(sheet.table(title, &COLUMNS));
        Ok(dataset)
    }
}

/// Each scenario with the controllers that differ on it.
fn cases() -> Vec<(Scenario, Control)> {
    let with_controls = |scenario: Scenario| {
        let controls: Vec<Control> = scenario.controls().collect();
        controls
            .into_iter()
            .map(move |control| (scenario.clone(), control))
    };
    Scenario::all()
        .into_iter()
        .flat_map(with_controls)
        .collect()
}

/// 5 mm nearer to the tip than the safe distance where that turns.
fn ball() -> Result<[Obstacle; 1]> {
    let centre_m = Vector3::new(0.37, 0.0, 0.7);
    let ball = Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros());
    Ok([ball.context("the ball")?])
}

/// The mean error of every robot with each controller behind the position interface, from the rows of a result.
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
    let title = "Mean error of the tip in truth, mm, position interface: with all that the controller does, and with a part switched off; root mean square of what the rates change by from cycle to cycle";
    Sheet::of(title, &COMPARISON, robots)
}

/// What one knob of a sweep does, from the rows of its result.
pub fn knob(knob: &str, rows: &[Value]) -> Sheet {
    tuning::table(knob, rows)
}

/// One line: a robot with a controller, over all seeds.
fn row(scenario: &Scenario, control: Control, interface: &str, runs: &[FigureEightRun]) -> Value {
    let average =
        |of: fn(&FigureEightRun) -> f64| runs.iter().map(of).sum::<f64>() / runs.len() as f64;
    let clearances = runs.iter().map(FigureEightRun::min_clearance_mm);
    let mean_error_mm = average(FigureEightRun::mean_mm);
    let target_mm = scenario.target_mm.filter(|_| control == Control::Full);
    json!({
        "name": scenario.name,
        "controller": control.name(),
        "interface": interface,
        "seeds": runs.len(),
        "mean_error_mm": mean_error_mm,
        "settled_error_mm": average(FigureEightRun::settled_mm),
        "max_error_mm": runs.iter().map(FigureEightRun::max_mm).fold(0.0, f64::max),
        // Root mean square of what the rates change by from cycle to cycle [rad/s].
        "rate_change_rms": average(FigureEightRun::rate_change_square).sqrt(),
        // Of the true body; none without an obstacle.
        "min_clearance_mm": clearances.reduce(f64::min).filter(|mm| mm.is_finite()),
        "safe_distance_mm": 1e3 * NmpcSettings::default().safe_distance_m,
        "target_mm": target_mm,
        // Whether the mean error is what is wanted.
        "reached": target_mm.map(|mm| if mean_error_mm <= mm { "yes" } else { "no" }),
    })
}

/// The error over time of a first run, a panel for each robot.
fn draw(panels: &mut Vec<Panel>, scenario: &Scenario, control: Control, run: &FigureEightRun) {
    let most = |errors_mm: &[f64]| errors_mm.iter().copied().fold(0.0, f64::max);
    let parts = run.errors_mm().chunks(DRAWN_CYCLES).enumerate();
    let time_s = |part: usize| (part * DRAWN_CYCLES) as f64 * FigureEight::PERIOD_S;
    let points = parts.map(|(part, errors_mm)| (time_s(part), most(errors_mm)));
    let curve = Curve::line(control.label(), points.collect(), control.colour());
    if control == Control::Full {
        panels.push(Panel {
            title: scenario.name.to_owned(),
            x: "time [s]",
            y: "error of the tip [mm]",
            scale: Scale::Log { floor: 1e-3 },
            curves: Vec::new(),
        });
    }
    if let Some(panel) = panels.last_mut() {
        panel.curves.push(curve);
    }
}
