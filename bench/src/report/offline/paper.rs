//! The paper's simulations as a result.

use anyhow::Result;
use serde_json::{Value, json};

use crate::csv::csv;
use crate::experiment::{Experiment, Task};
use crate::figures::{Figure, figures};
use crate::interrupt;
use crate::metric::Metric;
use crate::page::paper::INTRODUCTION;
use crate::progress::Progress;
use crate::section::{Section, Sheet};
use crate::simulation::{self, Effort, Outcome, Simulation, work};
use crate::table::{self, Table};

/// Time of a unit of work, about \[s\].
const WORK_S: f64 = 2.5e-4;
/// Cycles of a whole simulation, about.
const CYCLES: u64 = 1000;

/// How much is run.
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

/// Runs every simulation.
///
/// # Errors
/// When a controller cannot be built, or a signal comes.
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
    Ok(Report { outcomes })
}

/// All simulations.
pub struct Report {
    outcomes: Vec<Outcome>,
}

impl Report {
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
        INTRODUCTION
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

/// Curve and size, coordinates, solver.
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
