use anyhow::Result;

use super::shape::View;
use super::signals::{cables, controls, distances, errors, times};
use super::{find, find_all, named, plot};
use crate::chart::{BLUE, Curve, GREEN, GREY, ORANGE, sheet};
use crate::dataset::Plot;
use crate::experiment::{Solver, Task};
use crate::simulation::Outcome;

const SECTIONS: [usize; 3] = [1, 2, 3];

fn title(sections: usize) -> String {
    let plural = if sections == 1 { "" } else { "s" };
    format!("Spiral, {sections} section{plural}")
}

pub(super) fn figures(outcomes: &[Outcome]) -> Result<Vec<Plot>> {
    let mut refined = Vec::new();
    let mut all = Vec::new();
    for sections in SECTIONS {
        let task = Task::Spiral { sections };
        refined.push(find(outcomes, task, Solver::KpsoRefined)?);
        all.push(find_all(outcomes, task)?);
    }
    let each = || SECTIONS.iter().zip(&refined);
    let each_all = || SECTIONS.iter().zip(&all);
    let error_panels: Vec<_> = each().map(|(n, one)| errors(title(*n), one)).collect();
    let solver_panels: Vec<_> = each_all()
        .map(|(n, runs)| distances(title(*n), &named(runs)))
        .collect();
    let control_panels: Vec<_> = each()
        .flat_map(|(n, one)| controls(&title(*n), &one.first))
        .collect();
    let cable_panels: Vec<_> = each().map(|(n, one)| cables(title(*n), one)).collect();
    let time_panels: Vec<_> = each_all().map(|(n, runs)| times(title(*n), runs)).collect();
    Ok(vec![
        path(&refined)?,
        plot(
            "spiral-errors",
            "Errors along the axes with kpso-refined (the paper's Fig. 3, right, and Fig. 4).",
            sheet(&error_panels, 1, 560)?,
        ),
        plot(
            "spiral-solvers",
            "Distance of the tip from the reference with every solver.",
            sheet(&solver_panels, 1, 560)?,
        ),
        plot(
            "spiral-controls",
            "Control signals with kpso-refined (Fig. 6): left the rates of the bend vectors, which are \
             commanded, right the same in the paper's angles, where a section is bent by more than \
             1e-3 rad.",
            sheet(&control_panels, 2, 620)?,
        ),
        plot(
            "spiral-cables",
            "Lengths of the cables with kpso-refined, with several sections less the length at the straight robot; Lji is cable i of section j.",
            sheet(&cable_panels, 1, 600)?,
        ),
        plot(
            "spiral-times",
            "Computation time of every cycle (Fig. 5).",
            sheet(&time_panels, 1, 560)?,
        ),
    ])
}

fn path(runs: &[&Outcome]) -> Result<Plot> {
    let colours = [BLUE, ORANGE, GREEN];
    let (mut above, mut side) = (Vec::new(), Vec::new());
    for (run, colour) in runs.iter().zip(colours) {
        let label = format!("n = {}", run.row.sections);
        let reference = View::SIDE.reference(&run.first);
        side.push(Curve::line("", reference, GREY).width(10));
        let tips = View::SIDE.path(&run.first);
        side.push(Curve::line(label, tips, colour));
        if let Some(last) = run.first.last() {
            let robot = View::SIDE.backbone(&run.scene.robot, &last.configuration);
            side.push(Curve::line("", robot, colour).width(7));
        }
    }
    if let Some(run) = runs.last() {
        let reference = View::ABOVE.reference(&run.first);
        above.push(Curve::line("reference", reference, GREY).width(10));
        above.push(Curve::line(
            "tip, n = 3",
            View::ABOVE.path(&run.first),
            GREEN,
        ));
    }
    let panels = [
        View::ABOVE.panel("Spiral from above", above),
        View::SIDE.panel("From the side, robots at the end", side),
    ];
    Ok(plot(
        "spiral-path",
        "Path of the tip over the reference (the paper's Fig. 3, left), and the shapes of the robots \
         with one, two and three sections at the end.",
        sheet(&panels, 2, 900)?,
    ))
}
