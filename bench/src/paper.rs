//! The paper's simulations as a benchmark.

use anyhow::Result;
use serde_json::Value;

use crate::benchmark::Benchmark;
use crate::dataset::{Column, Dataset, Sheet, filled, fixed, plain, power, word};
use crate::experiment::{Experiment, Task};
use crate::interrupt;
use crate::plots::plots;
use crate::progress::Progress;
use crate::simulation::{self, Effort, Outcome};

const EXPLANATION: &str = include_str!("paper.html");

const SPIRAL: [Column; 4] = [
    plain("sections", "sections"),
    power("mean error mm", "mean_error_mm"),
    power("max mm", "max_error_mm"),
    power("paper's mean mm", "paper_mean_error_mm"),
];

const LINE: [Column; 6] = [
    plain("limit rad/s", "rate_limit_rad_s"),
    power("mean error mm", "mean_error_mm"),
    power("max mm", "max_error_mm"),
    power("paper's mean mm", "paper_mean_error_mm"),
    power("max |Θ| rad", "max_theta_rad"),
    power("max |Ψ| rad", "max_psi_rad"),
];

const CIRCLE: [Column; 5] = [
    plain("D mm", "safe_distance_mm"),
    fixed("min clearance mm", "min_clearance_mm", 4),
    power("mean error outside mm", "mean_error_outside_mm"),
    fixed("peak mm", "peak_error_mm", 2),
    plain("seeds", "seeds"),
];

/// Columns before and after those of each simulation.
const BEFORE: [Column; 2] = [word("solver", "solver"), word("coordinates", "coordinates")];
const AFTER: [Column; 4] = [
    fixed("mean µs", "solve_us_mean", 2),
    fixed("p50 µs", "solve_us_p50", 2),
    fixed("p99 µs", "solve_us_p99", 2),
    plain("paper's mean ms", "paper_mean_solve_ms"),
];

impl Benchmark for Effort {
    /// The errors of such a short run are meaningless.
    fn quicken(&mut self) {
        (self.seeds, self.cycles_max) = (1, 50);
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.seeds
    }

    fn expected_s(&self) -> f64 {
        let all = Experiment::all();
        let expected_s = all
            .iter()
            .map(|one| self.runs(one) as f64 * self.run_s(one));
        expected_s.sum()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let mut outcomes = Vec::new();
        for experiment in Experiment::all() {
            interrupt::check()?;
            let (curve, solver) = (experiment.task.name(), experiment.solver.name());
            progress.begin(&format!("{curve}, {solver}"));
            let advance = || progress.advance(self.run_s(&experiment));
            outcomes.push(simulation::run(experiment, *self, advance)?);
        }
        dataset(&outcomes)
    }
}

fn dataset(outcomes: &[Outcome]) -> Result<Dataset> {
    let all: Vec<Value> = outcomes.iter().map(|outcome| outcome.row.clone()).collect();
    let table = |name: &str, title: &str, columns: &[Column]| {
        let rows = all.iter().filter(|row| row["name"] == name);
        let columns = [&BEFORE, columns, &AFTER].concat();
        Sheet::of(title, &columns, rows.cloned().collect())
    };
    let line = "Simulation 2: line with a vertical tip (Eq. 9), 3 sections";
    let circle = "Simulation 3: circle around an obstacle, 1 section";
    let mut dataset = Dataset {
        name: "paper",
        heading: "The paper's simulations, offline",
        explanation: EXPLANATION,
        plots: plots(outcomes)?,
        sheets: vec![
            table("spiral", "Simulation 1: spiral (Eq. 8)", &SPIRAL),
            table("line", line, &LINE),
            table("circle", circle, &CIRCLE),
            Sheet::of("", &[&BEFORE[..], &SPIRAL, &AFTER].concat(), all.clone())
                .key("simulations")
                .file("paper"),
        ],
        ..Dataset::default()
    };
    // The seeds serve as rounds: results that depend on the random swarm get their spread from them.
    let numbers = [
        ("mean_error", "mm", "mean_error_mm"),
        ("solve_p50", "µs", "solve_p50_us"),
    ];
    for outcome in outcomes {
        dataset.compare(
            &filled(path(outcome), &outcome.row),
            &outcome.runs,
            &numbers,
        );
    }
    Ok(dataset)
}

/// Prefix of the names of the numbers: see [`filled`].
fn path(outcome: &Outcome) -> &'static str {
    match outcome.experiment.task {
        Task::Spiral { .. } => "paper/spiral-{sections}/{coordinates}/{solver}",
        Task::Line { .. } => "paper/line-{rate_limit_rad_s}rad_s/{coordinates}/{solver}",
        Task::Circle { .. } => "paper/circle-{safe_distance_mm}mm/{coordinates}/{solver}",
    }
}
