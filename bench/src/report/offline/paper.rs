//! The paper's simulations as a result.

use anyhow::Result;
use serde_json::{Value, json};

use crate::csv::csv;
use crate::experiment::{Experiment, Task};
use crate::figures::{Figure, figures};
use crate::interrupt;
use crate::metric::Metric;
use crate::progress::Progress;
use crate::section::{Section, Sheet};
use crate::simulation::{self, Effort, Outcome, Simulation, work};
use crate::table::{self, Table};

const EXPLANATION: &str = "\
<p>What <code>cdcr-bench paper</code> measured: the three simulations of <em>Nonlinear Model Predictive \
Control for Trajectory Tracking of a Class of Continuum Robots</em>, each with the paper's parameters and \
four solvers, beside what the paper states. <code>kpso</code> is the knowledge-based swarm with an inertia \
weight, <code>kpso-verbatim</code> the same with Eq. 6 as printed, <code>gauss-newton</code> damped \
Gauss-Newton steps alone, and <code>kpso-refined</code> those steps after the swarm. Controls are the rates \
of the bend vectors or of the paper's angles.</p>\n\
<p>An error is the distance of the tip from the exact reference at the end of a cycle; the mean of a run \
is taken over all its samples, and of several seeds the median is shown. The time of a solve is that of \
one call, back to back, on the machine that made this page, and the paper's that of MATLAB on an \
i3-2310M. The pictures show the first seed.</p>\n\
<p><b>Simulation 1, a spiral.</b> One, two and three sections follow the spiral that the last section reaches while those below it \
stay straight: 994 samples of 5 ms, N = 2, 6 particles and 30 iterations.</p>\n\
<p><b>Simulation 2, a line with a vertical tip.</b> Three sections follow a line from the straight robot, with the tip vertical: 510 samples of 5 ms, \
N = 2, 15 particles and 70 iterations. The paper names no limit on the rates, so there are two. A \
straight robot cannot move along its own axis, and the line goes down at once: with any limit the \
first samples are late, and the less, the faster the sections may bend.</p>\n\
<p><b>Simulation 3, a circle with an obstacle.</b> One section comes from straight to a circle and goes round once, with a point in its way at \
t = π/2 from which the whole body keeps the distance D: N = 20, 6 particles and 30 iterations. The paper \
names neither D nor an error. Outside means after the approach (the error was below 0.02 mm once) and \
where the reference is at least 2 D from the obstacle; the peak is the largest error after the \
approach. The printed constants of the circle are rounded, which alone leaves 7.2e-3 mm.</p>\n";

/// Time of a unit of work, about \[s\].
const WORK_S: f64 = 2.5e-4;
/// Cycles of a whole simulation, about.
const CYCLES: u64 = 1000;

#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Seeds, and cycles of a run.
    pub effort: Effort,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            effort: Effort {
                seeds: 10,
                cycles_max: u64::MAX,
            },
        }
    }
}

impl Options {
    /// One seed and the first cycles: errors say nothing then.
    pub fn quick() -> Self {
        Self {
            effort: Effort {
                seeds: 1,
                cycles_max: 50,
            },
        }
    }
}

/// About how long it takes \[s\].
pub fn expected_s(options: &Options) -> f64 {
    let share = options.effort.cycles_max.min(CYCLES) as f64 / CYCLES as f64;
    options.effort.all_work() as f64 * WORK_S * share
}

pub fn run(options: &Options, progress: &mut Progress) -> Result<Report> {
    let effort = options.effort;
    let unit_s = expected_s(options) / effort.all_work() as f64;
    let mut outcomes = Vec::new();
    for experiment in Experiment::all() {
        interrupt::check()?;
        let (curve, solver) = (experiment.task.name(), experiment.solver.name());
        progress.begin(&format!("{curve}, {solver}"));
        let of_run_s = work(&experiment) as f64 * unit_s;
        outcomes.push(simulation::run(experiment, effort, || {
            progress.advance(of_run_s);
        })?);
    }
    Ok(Report::of(outcomes))
}

pub struct Report {
    outcomes: Vec<Outcome>,
}

impl Report {
    /// Of runs that have been made: one for each experiment that is drawn.
    pub fn of(outcomes: Vec<Outcome>) -> Self {
        Self { outcomes }
    }

    fn rows(&self) -> Vec<&Simulation> {
        self.outcomes.iter().map(|outcome| &outcome.row).collect()
    }
}

impl Section for Report {
    fn name(&self) -> &'static str {
        "paper"
    }

    fn heading(&self) -> &'static str {
        "The paper's simulations, offline"
    }

    fn explanation(&self) -> &'static str {
        EXPLANATION
    }

    fn json(&self) -> Result<Value> {
        Ok(json!({ "simulations": self.rows() }))
    }

    fn tables(&self) -> Vec<Table> {
        table::simulations(&self.outcomes)
    }

    fn sheets(&self) -> Result<Vec<Sheet>> {
        Ok(vec![Sheet {
            name: "paper".to_owned(),
            csv: csv(&self.rows())?,
        }])
    }

    fn pictures(&self) -> Result<Vec<Figure>> {
        Ok(figures(&self.outcomes)?.into_iter().flatten().collect())
    }

    /// The seeds stand for rounds: what depends on the swarm's luck is its spread.
    fn metrics(&self) -> Vec<Metric> {
        let of = |outcome: &Outcome| {
            let name = |what: &str| format!("paper/{}/{what}", path(outcome));
            let errors_mm = outcome.runs.iter().map(|run| run.mean_error_mm);
            let times_us = outcome.runs.iter().map(|run| run.solve_p50_us);
            [
                Metric::lower(name("mean_error"), "mm", errors_mm),
                Metric::lower(name("solve_p50"), "µs", times_us),
            ]
        };
        self.outcomes.iter().flat_map(of).collect()
    }
}

fn path(outcome: &Outcome) -> String {
    let task = outcome.experiment.task;
    let size = match task {
        Task::Spiral { sections } => format!("{sections}"),
        Task::Line { rate_limit_rad_s } => format!("{rate_limit_rad_s}rad_s"),
        Task::Circle { safe_distance_m } => format!("{:.0}mm", 1e3 * safe_distance_m),
    };
    let coordinates = table::coordinates(&outcome.row);
    let solver = outcome.experiment.solver.name();
    format!("{}-{size}/{coordinates}/{solver}", task.name())
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn every_experiment_has_its_own_numbers_of_every_seed() {
        let options = Options {
            effort: Effort {
                seeds: 2,
                cycles_max: 2,
            },
        };
        let report = run(&options, &mut Progress::silent()).expect("all run");
        let metrics = report.metrics();
        let names: HashSet<&str> = metrics.iter().map(|metric| &*metric.name).collect();
        assert_eq!(names.len(), 2 * Experiment::all().len());
        assert!(metrics.iter().all(|metric| metric.rounds.len() >= 2));
        let rows = report.json().expect("JSON")["simulations"].clone();
        assert_eq!(
            rows.as_array().expect("a list").len(),
            Experiment::all().len()
        );
        assert!(expected_s(&Options::quick()) < expected_s(&Options::default()));
    }
}
