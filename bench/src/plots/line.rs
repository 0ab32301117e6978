use anyhow::Result;
use cdcr_controller::robot::ZyxAngles;
use plotters::style::RGBColor;

use super::shape::View;
use super::signals::{angles, cables, controls, distances, duration_s, errors, over_time, times};
use super::{Drawn, each, plot};
use crate::chart::{BLUE, Curve, DARK, GREY, ORANGE, Panel, Scale};
use crate::closed_loop::Sample;
use crate::dataset::Plot;
use crate::experiment::{LINE_RATES_RAD_S, LINE_TILT_MAX_RAD, Task};
use crate::simulation::Outcome;

const SHAPES: usize = 6;

pub(super) fn plots(outcomes: &[Outcome]) -> Result<Vec<Plot>> {
    let task = |rate_limit_rad_s: f64| {
        let title = format!("Line, rates up to {rate_limit_rad_s} rad/s");
        Drawn::new(outcomes, Task::Line { rate_limit_rad_s }, title)
    };
    let tasks = LINE_RATES_RAD_S
        .into_iter()
        .map(task)
        .collect::<Result<Vec<_>>>()?;
    let mut error_panels = each(&tasks, |task| [errors(task)]);
    error_panels.extend(tasks.iter().map(tilt));
    let all = [
        plot(
            "line-shapes",
            "Shapes of the robot at equal intervals, from grey to blue, and the line (Fig. 7).",
            (2, 1050),
            &each(&tasks, shapes),
        ),
        plot(
            "line-angles",
            "Bend and direction of the sections (Fig. 8). Two sections in one direction and the middle one \
             against them make an S. Any vertical plane will do for it.",
            (2, 600),
            &each(&tasks, angles),
        ),
        plot(
            "line-controls",
            "Control signals (Fig. 9): left as commanded, right in the paper's angles.",
            (2, 620),
            &each(&tasks, controls),
        ),
        plot(
            "line-errors",
            "Errors along the axes and of the orientation (Fig. 10). The straight robot cannot move along \
             its axis, so the first samples are late.",
            (1, 560),
            &error_panels,
        ),
        plot(
            "line-solvers",
            "Distance of the tip from the reference with every solver.",
            (1, 560),
            &each(&tasks, |task| [distances(task)]),
        ),
        plot(
            "line-cables",
            "Lengths of the cables less those at the straight robot; Lji is cable i of section j.",
            (1, 600),
            &each(&tasks, |task| [cables(task)]),
        ),
        plot(
            "line-times",
            "Computation time of every cycle (Fig. 11).",
            (1, 560),
            &each(&tasks, |task| [times(task)]),
        ),
    ];
    all.into_iter().collect()
}

fn shapes(task: &Drawn<'_>) -> [Panel; 2] {
    let Drawn { title, run, .. } = task;
    let last = run.first.len().saturating_sub(1);
    let panel = |view: View, from: &str| {
        let mut curves = vec![Curve::line("line", view.reference(&run.first), ORANGE).width(8)];
        for i in 0..SHAPES {
            let Some(sample) = run.first.get(i * last / (SHAPES - 1)) else {
                continue;
            };
            let points = view.backbone(&run.scene.robot, &sample.configuration);
            let label = if i == 0 || i == SHAPES - 1 {
                format!("{:.2} s", sample.time_s)
            } else {
                String::new()
            };
            curves.push(Curve::line(label, points, between(GREY, BLUE, i)).width(5));
        }
        view.panel(format!("{title}, {from}"), curves)
    };
    [panel(View::SIDE, "side"), panel(View::FRONT, "front")]
}

fn between(from: RGBColor, to: RGBColor, index: usize) -> RGBColor {
    let share = index as f64 / (SHAPES - 1) as f64;
    let mix = |a: u8, b: u8| (f64::from(a) + share * (f64::from(b) - f64::from(a))) as u8;
    RGBColor(mix(from.0, to.0), mix(from.1, to.1), mix(from.2, to.2))
}

fn tilt(task: &Drawn<'_>) -> Panel {
    let Drawn { title, run, .. } = task;
    let angles = |s: &Sample| ZyxAngles::from_rotation(&s.tip.rotation);
    let theta = over_time(&run.first, |s| angles(s).theta_rad.abs());
    let psi = over_time(&run.first, |s| angles(s).psi_rad.abs());
    let bound = format!("bound {LINE_TILT_MAX_RAD} rad");
    Panel {
        title: format!("{title}: tilt of the tip"),
        x: "time [s]",
        y: "tilt [rad]",
        scale: Scale::Log { floor: 1e-14 },
        curves: vec![
            Curve::line("|Θ|", theta, BLUE).width(3),
            Curve::line("|Ψ|", psi, ORANGE).width(3),
            Curve::level(bound, LINE_TILT_MAX_RAD, duration_s(&run.first), DARK),
        ],
    }
}
