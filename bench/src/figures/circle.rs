use anyhow::Result;
use plotters::style::RGBColor;

use super::shape::View;
use super::signals::{cables, duration_s, over_time, times};
use super::{find, find_all, plot};
use crate::chart::{BLUE, Curve, DARK, GREEN, GREY, ORANGE, Panel, Scale, sheet};
use crate::closed_loop::Sample;
use crate::dataset::Plot;
use crate::experiment::{CIRCLE_DISTANCES_M, Solver, Task};
use crate::simulation::{Outcome, obstacle_m};

const COLOURS: [RGBColor; 3] = [BLUE, ORANGE, GREEN];

/// The run with one safe distance.
struct Detour<'a> {
    distance_mm: f64,
    colour: RGBColor,
    run: &'a Outcome,
}

impl Detour<'_> {
    fn label(&self) -> String {
        format!("D = {} mm", self.distance_mm)
    }
}

pub(super) fn figures(outcomes: &[Outcome]) -> Result<Vec<Plot>> {
    let mut detours = Vec::new();
    let mut cable_panels = Vec::new();
    let mut time_panels = Vec::new();
    for (safe_distance_m, colour) in CIRCLE_DISTANCES_M.into_iter().zip(COLOURS) {
        let task = Task::Circle { safe_distance_m };
        let detour = Detour {
            distance_mm: 1e3 * safe_distance_m,
            colour,
            run: find(outcomes, task, Solver::KpsoRefined)?,
        };
        let title = format!("Circle, {}", detour.label());
        cable_panels.push(cables(title.clone(), detour.run));
        time_panels.push(times(title, &find_all(outcomes, task)?));
        detours.push(detour);
    }
    let views = [
        (View::ABOVE, "Circle from above"),
        (View::SIDE, "From the side"),
    ];
    let paths: Vec<Panel> = views
        .iter()
        .map(|(view, title)| path(*view, title, &detours))
        .collect();
    Ok(vec![
        plot(
            "circle-path",
            "Path of the tip around the obstacle (Fig. 12): thick the tip, thin the safe distance D, and \
             the robot where it is nearest to the obstacle.",
            sheet(&paths, 2, 900)?,
        ),
        plot(
            "circle-errors",
            "Distance of the tip from the reference: the approach from the straight robot, then the \
             detour at t = π/2 (Fig. 12). What remains is the rounding of the printed circle.",
            sheet(&[error_panel(&detours)], 1, 640)?,
        ),
        plot(
            "circle-clearance",
            "Clearance between the whole body and the obstacle, and the safe distances.",
            sheet(&[clearance_panel(&detours)], 1, 640)?,
        ),
        plot(
            "circle-cables",
            "Lengths of the cables (Fig. 13).",
            sheet(&cable_panels, 1, 520)?,
        ),
        plot(
            "circle-times",
            "Computation time of every cycle (Fig. 14).",
            sheet(&time_panels, 1, 560)?,
        ),
    ])
}

fn path(view: View, title: &str, detours: &[Detour]) -> Panel {
    let mut curves = Vec::new();
    if let Some(detour) = detours.first() {
        let reference = view.reference(&detour.run.first);
        curves.push(Curve::line("reference", reference, GREY).width(10));
        let centre_m = obstacle_m(&detour.run.scene);
        curves.push(Curve::line("obstacle", view.ball(&centre_m, 2e-3), DARK).width(8));
    }
    for detour in detours {
        let run = detour.run;
        let centre_m = obstacle_m(&run.scene);
        let safe = view.ball(&centre_m, 1e-3 * detour.distance_mm);
        curves.push(Curve::line("", safe, detour.colour).width(2));
        let tips = view.path(&run.first);
        curves.push(Curve::line(detour.label(), tips, detour.colour));
        let nearest = run
            .first
            .iter()
            .min_by(|a, b| a.clearance_m.total_cmp(&b.clearance_m));
        if let Some(sample) = nearest {
            let robot = view.backbone(&run.scene.robot, &sample.configuration);
            curves.push(Curve::line("", robot, detour.colour).width(7));
        }
    }
    view.panel(title, curves)
}

fn error_panel(detours: &[Detour]) -> Panel {
    let curve = |detour: &Detour| {
        let points = over_time(&detour.run.first, Sample::error_mm);
        Curve::line(detour.label(), points, detour.colour)
    };
    Panel {
        title: "Circle: error".into(),
        x: "time [s]",
        y: "error [mm]",
        scale: Scale::Log { floor: 1e-4 },
        curves: detours.iter().map(curve).collect(),
    }
}

fn clearance_panel(detours: &[Detour]) -> Panel {
    let mut curves = Vec::new();
    for detour in detours {
        let samples = &detour.run.first;
        let points = over_time(samples, |s| 1e3 * s.clearance_m);
        curves.push(Curve::line(detour.label(), points, detour.colour));
        let level = Curve::level("", detour.distance_mm, duration_s(samples), detour.colour);
        curves.push(level.width(2));
    }
    Panel {
        title: "Circle: clearance of the body".into(),
        x: "time [s]",
        y: "clearance [mm]",
        scale: Scale::Log { floor: 1.0 },
        curves,
    }
}
