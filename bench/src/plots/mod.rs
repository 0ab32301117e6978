//! The paper's figures, drawn from the first run of each experiment.

mod circle;
mod line;
mod shape;
mod signals;
mod spiral;

use anyhow::{Context, Result};
use cdcr_controller::nmpc::Coordinates;

use crate::chart::{Panel, sheet};
use crate::dataset::Plot;
use crate::experiment::{Solver, Task};
use crate::simulation::Outcome;

/// All figures: spiral, line and circle. Every experiment that is drawn must be among the outcomes.
pub fn plots(outcomes: &[Outcome]) -> Result<Vec<Plot>> {
    let mut all = spiral::plots(outcomes)?;
    all.extend(line::plots(outcomes)?);
    all.extend(circle::plots(outcomes)?);
    Ok(all)
}

struct Drawn<'a> {
    title: String,
    all: Vec<&'a Outcome>,
    /// That of `kpso-refined`.
    run: &'a Outcome,
}

impl<'a> Drawn<'a> {
    fn new(outcomes: &'a [Outcome], task: Task, title: String) -> Result<Self> {
        let find = |solver: Solver| {
            let is_it = |outcome: &&Outcome| {
                let found = &outcome.experiment;
                let what = (found.task, found.solver, found.coordinates);
                what == (task, solver, Coordinates::BendVector)
            };
            let missing = || format!("no outcome of {task:?} with {}", solver.name());
            outcomes.iter().find(is_it).with_context(missing)
        };
        let all = Solver::ALL.into_iter().map(find);
        Ok(Self {
            title,
            all: all.collect::<Result<_>>()?,
            run: find(Solver::KpsoRefined)?,
        })
    }
}

/// The panels of every task on one sheet.
fn each<'a, P: IntoIterator<Item = Panel>>(
    tasks: &[Drawn<'a>],
    panels: impl Fn(&Drawn<'a>) -> P,
) -> Vec<Panel> {
    tasks.iter().flat_map(panels).collect()
}

/// So many panels beside each other, each so high.
fn plot(
    name: &'static str,
    caption: &'static str,
    (columns, height): (usize, u32),
    panels: &[Panel],
) -> Result<Plot> {
    let svg = sheet(panels, columns, height)?;
    Ok(Plot { name, caption, svg })
}
