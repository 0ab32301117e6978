use anyhow::Result;

use super::shape::View;
use super::signals::{cables, controls, distances, errors, times};
use super::{Drawn, each, plot};
use crate::chart::{BLUE, Curve, GREEN, GREY, ORANGE};
use crate::dataset::Plot;
use crate::experiment::Task;
use crate::simulation::Outcome;

fn title(sections: usize) -> String {
    let plural = if sections == 1 { "" } else { "s" };
    format!("Spiral, {sections} section{plural}")
}

pub(super) fn plots(outcomes: &[Outcome]) -> Result<Vec<Plot>> {
    let task = |sections| Drawn::new(outcomes, Task::Spiral { sections }, title(sections));
    let tasks = (1..=3).map(task).collect::<Result<Vec<_>>>()?;
    let all = [
        path(&tasks),
        plot(
            "spiral-errors",
            "Errors along the axes with kpso-refined (the paper's Fig. 3, right, and Fig. 4).",
            (1, 560),
            &each(&tasks, |task| [errors(task)]),
        ),
        plot(
            "spiral-solvers",
            "Distance of the tip from the reference with every solver.",
            (1, 560),
            &each(&tasks, |task| [distances(task)]),
        ),
        plot(
            "spiral-controls",
            "Control signals with kpso-refined (Fig. 6): left the rates of the bend vectors, which are \
             commanded, right the same in the paper's angles, where a section is bent by more than \
             1e-3 rad.",
            (2, 620),
            &each(&tasks, controls),
        ),
        plot(
            "spiral-cables",
            "Lengths of the cables with kpso-refined, with several sections less the length at the straight \
             robot; Lji is cable i of section j.",
            (1, 600),
            &each(&tasks, |task| [cables(task)]),
        ),
        plot(
            "spiral-times",
            "Computation time of every cycle (Fig. 5).",
            (1, 560),
            &each(&tasks, |task| [times(task)]),
        ),
    ];
    all.into_iter().collect()
}

fn path(tasks: &[Drawn<'_>]) -> Result<Plot> {
    let colours = [BLUE, ORANGE, GREEN];
    let (mut above, mut side) = (Vec::new(), Vec::new());
    for (Drawn { run, .. }, colour) in tasks.iter().zip(colours) {
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
    if let Some(Drawn { run, .. }) = tasks.last() {
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
    plot(
        "spiral-path",
        "Path of the tip over the reference (the paper's Fig. 3, left), and the shapes of the robots \
         with one, two and three sections at the end.",
        (2, 900),
        &panels,
    )
}
