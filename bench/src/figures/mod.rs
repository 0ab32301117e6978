//! The paper's figures, drawn from the first run of each experiment.

mod circle;
mod line;
mod shape;
mod signals;
mod spiral;

use anyhow::{Context, Result};
use cdcr_controller::nmpc::Coordinates;

use crate::dataset::Plot;
use crate::experiment::{Solver, Task};
use crate::simulation::Outcome;

/// All figures: spiral, line and circle.
pub fn figures(outcomes: &[Outcome]) -> Result<Vec<Plot>> {
    let mut all = spiral::figures(outcomes)?;
    all.extend(line::figures(outcomes)?);
    all.extend(circle::figures(outcomes)?);
    Ok(all)
}

/// The outcome of a task with bend vectors.
fn find(outcomes: &[Outcome], task: Task, solver: Solver) -> Result<&Outcome> {
    let mut all = outcomes.iter();
    all.find(|outcome| {
        let experiment = &outcome.experiment;
        experiment.task == task
            && experiment.solver == solver
            && experiment.coordinates == Coordinates::BendVector
    })
    .with_context(|| format!("no outcome of {task:?} with {}", solver.name()))
}

fn find_all(outcomes: &[Outcome], task: Task) -> Result<Vec<&Outcome>> {
    let solvers = Solver::ALL.iter();
    solvers
        .map(|solver| find(outcomes, task, *solver))
        .collect()
}

fn named<'a>(outcomes: &[&'a Outcome]) -> Vec<(String, &'a Outcome)> {
    let all = outcomes.iter();
    all.map(|outcome| (outcome.row.solver.name().to_owned(), *outcome))
        .collect()
}

fn plot(name: &'static str, caption: &'static str, svg: String) -> Plot {
    Plot { name, caption, svg }
}
