use anyhow::Result;
use plotters::style::RGBColor;

use super::shape::View;
use super::signals::{COLOURS, cables, duration_s, over_time, times};
use super::{Drawn, plot};
use crate::chart::{Curve, DARK, GREY, Panel, Scale};
use crate::closed_loop::Sample;
use crate::dataset::Plot;
use crate::experiment::{CIRCLE_DISTANCES_M, Task};
use crate::simulation::{Outcome, obstacle_m};

struct Detour<'a> {
    distance_mm: f64,
    colour: RGBColor,
    drawn: Drawn<'a>,
}

impl Detour<'_> {
    fn label(&self) -> String {
        format!("D = {} mm", self.distance_mm)
    }

    fn samples(&self) -> &[Sample] {
        &self.drawn.run.first
    }
}

pub(super) fn plots(outcomes: &[Outcome]) -> Result<Vec<Plot>> {
    let detour = |(safe_distance_m, colour): (f64, RGBColor)| {
        let distance_mm = 1e3 * safe_distance_m;
        let title = format!("Circle, D = {distance_mm} mm");
        let drawn = Drawn::new(outcomes, Task::Circle { safe_distance_m }, title)?;
        Ok(Detour {
            distance_mm,
            colour,
            drawn,
        })
    };
    let detours = CIRCLE_DISTANCES_M.into_iter().zip(COLOURS).map(detour);
    let detours = detours.collect::<Result<Vec<_>>>()?;
    let tasks = || detours.iter().map(|detour| &detour.drawn);
    let all = [
        plot(
            "circle-path",
            "Path of the tip around the obstacle (Fig. 12): thick the tip, thin the safe distance D, and \
             the robot where it is nearest to the obstacle.",
            (2, 900),
            &[
                path(View::ABOVE, "Circle from above", &detours),
                path(View::SIDE, "From the side", &detours),
            ],
        ),
        plot(
            "circle-errors",
            "Distance of the tip from the reference: the approach from the straight robot, then the \
             detour at t = π/2 (Fig. 12). What remains is the rounding of the printed circle.",
            (1, 640),
            &[error_panel(&detours)],
        ),
        plot(
            "circle-clearance",
            "Clearance between the whole body and the obstacle, and the safe distances.",
            (1, 640),
            &[clearance_panel(&detours)],
        ),
        plot(
            "circle-cables",
            "Lengths of the cables (Fig. 13).",
            (1, 520),
            &tasks().map(cables).collect::<Vec<_>>(),
        ),
        plot(
            "circle-times",
            "Computation time of every cycle (Fig. 14).",
            (1, 560),
            &tasks().map(times).collect::<Vec<_>>(),
        ),
    ];
    all.into_iter().collect()
}

fn path(view: View, title: &str, detours: &[Detour]) -> Panel {
    let mut curves = Vec::new();
    if let Some(detour) = detours.first() {
        let reference = view.reference(detour.samples());
        curves.push(Curve::line("reference", reference, GREY).width(10));
        let centre_m = obstacle_m(&detour.drawn.run.scene);
        curves.push(Curve::line("obstacle", view.ball(&centre_m, 2e-3), DARK).width(8));
    }
    for detour in detours {
        let run = detour.drawn.run;
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
        let points = over_time(detour.samples(), Sample::error_mm);
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
        let samples = detour.samples();
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
