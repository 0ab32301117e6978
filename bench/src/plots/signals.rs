//! Curves over time that several simulations have: errors, angles, control signals, cables, solve times.

use cdcr_controller::robot::{CABLES_MAX, Configuration};
use plotters::style::RGBColor;

use super::Drawn;
use crate::chart::{
    BLUE, Curve, DARK, GREEN, GREY, ORANGE, PURPLE, Panel, Point, SKY, Scale, YELLOW,
};
use crate::closed_loop::Sample;
use crate::experiment::Solver;
use crate::simulation::Outcome;

/// A section bent by less than this has no direction to speak of \[rad\].
const STRAIGHT_RAD: f64 = 1e-3;
/// Errors below this are drawn here: a logarithm knows no zero \[mm\].
pub(super) const ERROR_FLOOR_MM: f64 = 1e-14;
const TIME: &str = "time [s]";
pub(super) const COLOURS: [RGBColor; 3] = [BLUE, ORANGE, GREEN];
const BROWN: RGBColor = RGBColor(120, 80, 40);
const PALE_COLOURS: [RGBColor; 3] = [SKY, YELLOW, PURPLE];

pub(super) fn over_time(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> Vec<Point> {
    samples.iter().map(|s| (s.time_s, value(s))).collect()
}

/// From the start to the last sample \[s\].
pub(super) fn duration_s(samples: &[Sample]) -> std::ops::Range<f64> {
    0.0..samples.last().map_or(1.0, |sample| sample.time_s)
}

/// Errors along the axes, and the paper's mean.
pub(super) fn errors(task: &Drawn<'_>) -> Panel {
    let outcome = task.run;
    let samples = &outcome.first;
    let axis = |i: usize, label| {
        let along = over_time(samples, |s| s.offset_mm()[i].abs());
        Curve::line(label, along, COLOURS[i]).width(3)
    };
    let mut curves = vec![
        axis(0, "|x error|"),
        axis(1, "|y error|"),
        axis(2, "|z error|"),
    ];
    if let Some(mean_mm) = outcome.row.paper.mean_error_mm {
        let label = format!("paper's mean {mean_mm:e} mm");
        curves.push(Curve::level(label, mean_mm, duration_s(samples), DARK));
    }
    Panel {
        title: task.title.clone(),
        x: TIME,
        y: "error [mm]",
        scale: Scale::Log {
            floor: ERROR_FLOOR_MM,
        },
        curves,
    }
}

pub(super) fn distances(task: &Drawn<'_>) -> Panel {
    // The first is broad, as the next often lies upon it.
    let styles = [(SKY, 9), (PURPLE, 3), (ORANGE, 3), (BLUE, 3)];
    let curve = |(outcome, (colour, width)): (&&Outcome, (RGBColor, u32))| {
        let points = over_time(&outcome.first, Sample::error_mm);
        Curve::line(outcome.row.solver.name(), points, colour).width(width)
    };
    Panel {
        title: task.title.clone(),
        x: TIME,
        y: "error [mm]",
        scale: Scale::Log {
            floor: ERROR_FLOOR_MM,
        },
        curves: task.all.iter().zip(styles).map(curve).collect(),
    }
}

/// Bend θ and direction φ of every section.
pub(super) fn angles(task: &Drawn<'_>) -> [Panel; 2] {
    let (title, samples) = (&task.title, &task.run.first);
    let sections = section_count(samples);
    let bend = |j: usize| {
        let points = over_time(samples, |s| s.configuration.bend_rad(j));
        Curve::line(format!("θ{}", j + 1), points, COLOURS[j % 3])
    };
    let direction = |j: usize| {
        let pieces = bent(samples, j, unwrapped(samples, j));
        Curve::pieces(format!("φ{}", j + 1), pieces, COLOURS[j % 3])
    };
    [
        panel(
            format!("{title}: bend"),
            "θ [rad]",
            (0..sections).map(bend).collect(),
        ),
        panel(
            format!("{title}: direction"),
            "φ [rad]",
            (0..sections).map(direction).collect(),
        ),
    ]
}

/// What is commanded, rates of the bend vectors, and the same in the paper's angles.
pub(super) fn controls(task: &Drawn<'_>) -> [Panel; 2] {
    let (title, samples) = (&task.title, &task.run.first);
    let mut vectors = Vec::new();
    let mut angles = Vec::new();
    for j in 0..section_count(samples) {
        for (i, name, colours) in [(0, "u̇", COLOURS), (1, "v̇", PALE_COLOURS)] {
            let points = over_time(samples, |s| s.rates.section(j)[i]);
            let label = format!("{name}{}", j + 1);
            vectors.push(Curve::line(label, points, colours[j % 3]).width(3));
        }
        for (i, name, colours) in [(0, "θ̇", COLOURS), (1, "φ̇", PALE_COLOURS)] {
            let points = over_time(samples, |s| angle_rates(s, j)[i]);
            let label = format!("{name}{}", j + 1);
            let pieces = bent(samples, j, points);
            angles.push(Curve::pieces(label, pieces, colours[j % 3]).width(3));
        }
    }
    [
        panel(format!("{title}: as commanded"), "u̇, v̇ [rad/s]", vectors),
        panel(format!("{title}: in angles"), "θ̇, φ̇ [rad/s]", angles),
    ]
}

/// Lengths of all cables; of several sections less those at the straight robot, beside which they change
/// little.
pub(super) fn cables(task: &Drawn<'_>) -> Panel {
    let outcome = task.run;
    let colours = [COLOURS, PALE_COLOURS, [DARK, GREY, BROWN]];
    let robot = &outcome.scene.robot;
    let cables = robot.cable_count();
    let straight_m = robot.cable_lengths(&Configuration::straight(robot.section_count()));
    let (label, from_m) = if robot.section_count() == 1 {
        ("length [mm]", [0.0; CABLES_MAX])
    } else {
        ("change of length [mm]", straight_m)
    };
    let curve = |i: usize| {
        let length = |s: &Sample| {
            let lengths_m = robot.cable_lengths(&s.configuration);
            1e3 * (lengths_m[i] - from_m[i])
        };
        let label = format!("L{}{}", i / 3 + 1, i % 3 + 1);
        let points = over_time(&outcome.first, length);
        Curve::line(label, points, colours[i / 3 % 3][i % 3]).width(3)
    };
    panel(task.title.clone(), label, (0..cables).map(curve).collect())
}

/// Solve times of several solvers, and the paper's mean.
pub(super) fn times(task: &Drawn<'_>) -> Panel {
    let curve = |outcome: &&Outcome| {
        let points = over_time(&outcome.first, |s| s.solve_ns as f64 * 1e-3);
        let solver = outcome.row.solver;
        Curve::line(solver.name(), points, colour(solver)).width(2)
    };
    let mut curves: Vec<Curve> = task.all.iter().map(curve).collect();
    let mean_ms = task.run.row.paper.mean_solve_ms;
    let label = format!("paper's mean {mean_ms} ms");
    let x = duration_s(&task.run.first);
    curves.push(Curve::level(label, 1e3 * mean_ms, x, DARK));
    Panel {
        title: task.title.clone(),
        x: TIME,
        y: "solve time [µs]",
        scale: Scale::Log { floor: 0.1 },
        curves,
    }
}

pub(super) fn colour(solver: Solver) -> RGBColor {
    match solver {
        Solver::Kpso => SKY,
        Solver::KpsoVerbatim => PURPLE,
        Solver::GaussNewton => ORANGE,
        Solver::KpsoRefined => BLUE,
    }
}

pub(super) fn panel(title: String, y: &'static str, curves: Vec<Curve>) -> Panel {
    Panel {
        title,
        x: TIME,
        y,
        scale: Scale::Linear,
        curves,
    }
}

fn section_count(samples: &[Sample]) -> usize {
    samples
        .first()
        .map_or(0, |s| s.configuration.section_count())
}

/// The rates of θ and φ that the command makes at the sample.
fn angle_rates(sample: &Sample, j: usize) -> [f64; 2] {
    let ([u, v], [du, dv]) = (sample.configuration.section(j), sample.rates.section(j));
    let square = (u * u + v * v).max(f64::MIN_POSITIVE);
    [
        (u * du + v * dv) / square.sqrt(),
        (u * dv - v * du) / square,
    ]
}

fn unwrapped(samples: &[Sample], j: usize) -> Vec<Point> {
    let mut last_rad = 0.0;
    over_time(samples, |s| s.configuration.direction_rad(j))
        .into_iter()
        .map(|(time_s, rad)| {
            let turns = f64::round((last_rad - rad) / std::f64::consts::TAU);
            last_rad = rad + turns * std::f64::consts::TAU;
            (time_s, last_rad)
        })
        .collect()
}

/// The points at which section `j` is bent enough to have a direction.
fn bent(samples: &[Sample], j: usize, points: Vec<Point>) -> Vec<Vec<Point>> {
    let is_bent = |i: usize| samples[i].configuration.bend_rad(j) > STRAIGHT_RAD;
    let indexed: Vec<(usize, Point)> = points.into_iter().enumerate().collect();
    let runs = indexed.chunk_by(|a, b| is_bent(a.0) == is_bent(b.0));
    let bent = runs.filter(|run| is_bent(run[0].0));
    bent.map(|run| run.iter().map(|(_, point)| *point).collect())
        .collect()
}
