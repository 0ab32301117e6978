//! The paper's figures, drawn from the first run of each experiment.

use anyhow::{Context, Result, bail};
use cdcr_client::counted;
use cdcr_controller::nmpc::{Coordinates, SolverKind};
use cdcr_controller::robot::{Configuration, ZyxAngles};
use nalgebra::Vector3;

use crate::chart::{
    BLUE, Curve, DARK, GREEN, GREY, ORANGE, PURPLE, Panel, Point, RGBColor, SKY, Scale, View,
    YELLOW,
};
use crate::closed_loop::{PERIOD_S, Sample, obstacle_m};
use crate::dataset::Dataset;
use crate::experiment::{Experiment, LINE_TILT_MAX_RAD, Outcome, SOLVERS, Task};

/// Smallest bend with a meaningful direction \[rad\].
const STRAIGHT_RAD: f64 = 1e-3;
/// Smaller errors are drawn at this value, because the scale is logarithmic \[mm\].
const ERRORS: Scale = Scale::Log { floor: 1e-14 };
const BROWN: RGBColor = RGBColor(120, 80, 40);
/// A colour for each section, a pale one, and those of the cables of a third section.
const COLOURS: [[RGBColor; 3]; 3] = [
    [BLUE, ORANGE, GREEN],
    [SKY, YELLOW, PURPLE],
    [DARK, GREY, BROWN],
];
const POINTS: u32 = 24;
const SHAPES: usize = 6;

/// Limit of drawn angle rates: a spike at a nearly straight section would flatten all other values \[rad/s\].
const ANGLE_RATE_MAX_RAD_S: f64 = 10.0;
const CLEARANCE_MAX_MM: f64 = 2.0;
const SHARES: f64 = 1e-3;

/// Draws the declared plots, `paper-SIMULATION-KIND`.
pub fn draw<'a>(dataset: &mut Dataset, outcomes: &'a [Outcome]) -> Result<()> {
    let tasks = Task::all().into_iter();
    let drawn = tasks.map(|task| Drawn::new(outcomes, task));
    let drawn = drawn.collect::<Result<Vec<_>>>()?;
    for plot in dataset.declaration.plots.clone() {
        let words = plot.name.splitn(3, '-').collect::<Vec<_>>();
        let is_it = |one: &&Drawn<'a>| one.run.experiment.task.name() == words[1];
        let tasks: Vec<_> = drawn.iter().filter(is_it).collect();
        let each = |panels: fn(&Drawn<'a>) -> Vec<Panel>| -> Vec<Panel> {
            tasks.iter().flat_map(|task| panels(task)).collect()
        };
        let panels = match (words[1], words[2]) {
            ("spiral", "path") => spiral_paths(&tasks),
            ("circle", "path") => vec![
                circle_path(View::ABOVE, "above", &tasks),
                circle_path(View::SIDE, "the side", &tasks),
            ],
            ("circle", "errors") => vec![circle_errors(&tasks)],
            ("circle", "clearance") => vec![circle_clearance(&tasks)],
            ("line", "errors") => {
                let errors = each(Drawn::errors).into_iter();
                errors.chain(each(Drawn::tilt)).collect()
            }
            (_, "errors") => each(Drawn::errors),
            (_, "solvers") => each(Drawn::distances),
            (_, "controls") => each(Drawn::controls),
            (_, "cables") => each(Drawn::cables),
            (_, "times") => each(Drawn::times),
            (_, "shapes") => each(Drawn::shapes),
            (_, "angles") => each(Drawn::angles),
            _ => bail!("the plot {} is declared, and cannot be drawn", plot.name),
        };
        dataset.plot(&plot.name, &panels)?;
    }
    Ok(())
}

fn ball(view: View, centre_m: &Vector3<f64>, radius_m: f64) -> Vec<Point> {
    let (x, y) = view.point((*centre_m).into());
    let at = |degrees: u32| {
        let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
        (x + 1e3 * radius_m * cos, y + 1e3 * radius_m * sin)
    };
    (0..=360).step_by(4).map(at).collect()
}

fn over_time(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> Vec<Point> {
    samples.iter().map(|s| (s.time_s, value(s))).collect()
}

fn exceeded(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> Vec<Point> {
    let mut values: Vec<f64> = samples.iter().map(value).collect();
    values.retain(|value| *value > 0.0);
    values.sort_unstable_by(f64::total_cmp);
    let count = values.len() as f64;
    let point = |(k, value)| (value, 1.0 - k as f64 / count);
    values.into_iter().enumerate().map(point).collect()
}

fn timed(title: String, y: &'static str, scale: Scale, curves: Vec<Curve>) -> Panel {
    Panel::new(title, ["time [s]", y], scale, curves)
}

/// One simulation, with every solver and with `kpso-refined`.
struct Drawn<'a> {
    title: String,
    all: Vec<&'a Outcome>,
    run: &'a Outcome,
    samples: &'a [Sample],
}

impl<'a> Drawn<'a> {
    fn new(outcomes: &'a [Outcome], task: Task) -> Result<Self> {
        let title = match task {
            Task::Spiral { sections } => format!("spiral, {}", counted(sections, "section")),
            Task::Line {
                rate_limit_rad_s: most,
            } => format!("line, rates up to {most} rad/s"),
            Task::Circle { safe_distance_m } => format!("circle, D = {} mm", 1e3 * safe_distance_m),
        };
        let find = |solver: (SolverKind, bool)| {
            let expected = Experiment::new(task, solver, Coordinates::BendVector);
            let is_it = |outcome: &&Outcome| outcome.experiment == expected;
            let missing = || format!("no outcome of {task:?} with {}", expected.solver_name());
            outcomes.iter().find(is_it).with_context(missing)
        };
        let run = find((SolverKind::KpsoRefined, false))?;
        Ok(Self {
            title: format!("Simulated {title}"),
            all: SOLVERS.into_iter().map(find).collect::<Result<_>>()?,
            samples: &run.first.0,
            run,
        })
    }

    fn level(&self, label: String, y: f64, colour: RGBColor) -> Curve {
        let end_s = self.samples.last().map_or(1.0, |sample| sample.time_s);
        Curve::level(label, y, 0.0..end_s, colour)
    }

    fn safe_m(&self) -> f64 {
        self.run.experiment.settings().safe_distance_m
    }

    fn sections(&self) -> std::ops::Range<usize> {
        0..self.run.scene.robot.section_count()
    }

    /// Values over time, each with its label and colour.
    fn series(
        &self,
        labels: impl IntoIterator<Item = (String, RGBColor)>,
        value: impl Fn(&Sample, usize) -> f64,
    ) -> Vec<Curve> {
        let labels = labels.into_iter().enumerate();
        let curve = |(i, (label, colour))| {
            Curve::line(label, over_time(self.samples, |s| value(s, i)), colour).width(3)
        };
        labels.map(curve).collect()
    }

    /// The same, only while section `j` of a value is bent enough to have a direction.
    fn while_bent(&self, label: String, j: usize, points: Vec<Point>, colour: RGBColor) -> Curve {
        let is_bent = |sample: &Sample| sample.configuration.bend_rad(j) > STRAIGHT_RAD;
        let all: Vec<(bool, Point)> = self.samples.iter().map(is_bent).zip(points).collect();
        let runs = all.chunk_by(|a, b| a.0 == b.0).filter(|run| run[0].0);
        let pieces = runs.map(|run| run.iter().map(|(_, point)| *point).collect());
        Curve::pieces(label, pieces.collect(), colour).width(3)
    }

    /// A panel with linear axes, titled with the simulation and `part`.
    fn linear(&self, part: &str, y: &'static str, curves: Vec<Curve>) -> Panel {
        timed(format!("{}{part}", self.title), y, Scale::Linear, curves)
    }

    fn errors(&self) -> Vec<Panel> {
        let labels = ["x", "y", "z"].map(|axis| format!("|{axis} error|"));
        let labels = labels.into_iter().zip(COLOURS[0]);
        let mut curves = self.series(labels, |s, axis| s.offset_mm()[axis].abs());
        let (mean_mm, _) = self.run.experiment.task.paper();
        curves.extend(mean_mm.map(|mm| self.level(format!("paper's mean {mm:e} mm"), mm, DARK)));
        vec![timed(self.title.clone(), "error [mm]", ERRORS, curves)]
    }

    fn tilt(&self) -> Vec<Panel> {
        let labels = [("|Θ|".to_owned(), BLUE), ("|Ψ|".to_owned(), ORANGE)];
        let mut curves = self.series(labels, |s, i| {
            let angles = ZyxAngles::from_rotation(&s.tip.rotation);
            [angles.theta_rad, angles.psi_rad][i].abs()
        });
        let bound = format!("bound {LINE_TILT_MAX_RAD} rad");
        curves.push(self.level(bound, LINE_TILT_MAX_RAD, DARK));
        let title = format!("{}: tilt of the tip", self.title);
        vec![timed(title, "tilt [rad]", ERRORS, curves)]
    }

    fn distances(&self) -> Vec<Panel> {
        // The first curve is broad, because the next one often covers it.
        let widths = [9, 3, 3, 3];
        self.shares("error is larger than [mm]", widths, Sample::error_mm, [])
    }

    fn times(&self) -> Vec<Panel> {
        let (_, mean_ms) = self.run.experiment.task.paper();
        let at = |label, ms: f64, colour| {
            Curve::upright(format!("{label} {ms} ms"), 1e3 * ms, SHARES, colour)
        };
        // Equal for the spiral with two sections.
        let marks = [
            at("paper's mean", mean_ms, GREY).width(10),
            at("period", 1e3 * PERIOD_S, DARK),
        ];
        let us = |sample: &Sample| sample.solve_ns as f64 * 1e-3;
        self.shares("solve takes longer than [µs]", [2; 4], us, marks)
    }

    /// Share of the cycles in which a value exceeds each threshold, for each solver.
    fn shares<const N: usize>(
        &self,
        x: &'static str,
        widths: [u32; SOLVERS.len()],
        value: impl Fn(&Sample) -> f64,
        beside: [Curve; N],
    ) -> Vec<Panel> {
        let styles = [SKY, PURPLE, ORANGE, BLUE].into_iter().zip(widths);
        let curve = |(outcome, (colour, width)): (&&Outcome, (RGBColor, u32))| {
            let points = exceeded(&outcome.first.0, &value);
            Curve::line(outcome.experiment.solver_name(), points, colour).width(width)
        };
        let curves = self.all.iter().zip(styles).map(curve).chain(beside);
        let (axes, scale) = ([x, "share of the cycles"], Scale::LogLog { floor: SHARES });
        vec![Panel::new(&*self.title, axes, scale, curves.collect())]
    }

    fn angles(&self) -> Vec<Panel> {
        let label = |j: usize| (format!("θ{}", j + 1), COLOURS[0][j % 3]);
        let labels = self.sections().map(label);
        let bends = self.series(labels, |s, j| s.configuration.bend_rad(j));
        let direction = |j: usize| {
            let points = unwrapped(self.samples, j);
            self.while_bent(format!("φ{}", j + 1), j, points, COLOURS[0][j % 3])
        };
        let directions = self.sections().map(direction);
        vec![
            self.linear(": bend", "θ [rad]", bends),
            self.linear(": direction", "φ [rad]", directions.collect()),
        ]
    }

    fn controls(&self) -> Vec<Panel> {
        let label = |names: [&str; 2], k: usize| {
            let colour = COLOURS[k % 2][k / 2 % 3];
            (format!("{}{}", names[k % 2], k / 2 + 1), colour)
        };
        let count = 0..2 * self.sections().end;
        let vectors = count.clone().map(|k| label(["u̇", "v̇"], k));
        let vectors = self.series(vectors, |s, k| s.rates.section(k / 2)[k % 2]);
        let angles = count.map(|k| {
            let (label, colour) = label(["θ̇", "φ̇"], k);
            let most = ANGLE_RATE_MAX_RAD_S;
            let rate = |s: &Sample| angle_rates(s, k / 2)[k % 2].clamp(-most, most);
            self.while_bent(label, k / 2, over_time(self.samples, rate), colour)
        });
        vec![
            self.linear(": as commanded", "u̇, v̇ [rad/s]", vectors),
            self.linear(": in angles", "θ̇, φ̇ [rad/s]", angles.collect()),
        ]
    }

    fn cables(&self) -> Vec<Panel> {
        let robot = &self.run.scene.robot;
        let from_m = robot.cable_lengths(&Configuration::straight(robot.section_count()));
        let label = |i: usize| {
            let (section, cable) = (i / 3, i % 3);
            let colour = COLOURS[section % 3][cable];
            (format!("L{}{}", section + 1, cable + 1), colour)
        };
        let curves = self.series((0..robot.cable_count()).map(label), |s, i| {
            1e3 * (robot.cable_lengths(&s.configuration)[i] - from_m[i])
        });
        vec![self.linear("", "change of length [mm]", curves)]
    }

    fn shapes(&self) -> Vec<Panel> {
        let last = self.samples.len().saturating_sub(1);
        let panel = |(view, from): (View, &str)| {
            let mut curves = vec![Curve::line("line", self.reference(view), ORANGE).width(8)];
            let shown = (0..SHAPES).map(|i| (i, self.samples.get(i * last / (SHAPES - 1))));
            for (i, sample) in shown.filter_map(|(i, sample)| Some((i, sample?))) {
                let is_end = [0, SHAPES - 1].contains(&i);
                let time = format!("{:.2} s", sample.time_s);
                let label = if is_end { time } else { String::new() };
                let colour = between(GREY, BLUE, i);
                curves.push(Curve::line(label, self.backbone(view, sample), colour).width(5));
            }
            view.panel(format!("{}, {from}", self.title), curves)
        };
        Vec::from([(View::SIDE, "side"), (View::FRONT, "front")].map(panel))
    }

    fn path(&self, view: View) -> Vec<Point> {
        view.line(self.samples.iter().map(|s| s.tip.position_m.into()))
    }

    fn reference(&self, view: View) -> Vec<Point> {
        view.line(self.samples.iter().map(|s| s.reference_m.into()))
    }

    fn backbone(&self, view: View, sample: &Sample) -> Vec<Point> {
        let (robot, at) = (&self.run.scene.robot, &sample.configuration);
        let shares = (0..=POINTS).map(|i| f64::from(i) / f64::from(POINTS));
        let sections = self.sections();
        let places = sections.flat_map(|j| shares.clone().map(move |share| (j, share)));
        view.line(places.map(|(j, share)| robot.body_point(at, j, share).into()))
    }
}

fn between(from: RGBColor, to: RGBColor, index: usize) -> RGBColor {
    let share = index as f64 / (SHAPES - 1) as f64;
    let mix = |a: u8, b: u8| (f64::from(a) + share * (f64::from(b) - f64::from(a))) as u8;
    RGBColor(mix(from.0, to.0), mix(from.1, to.1), mix(from.2, to.2))
}

/// Rates of θ and φ caused by the command at the sample.
fn angle_rates(sample: &Sample, j: usize) -> [f64; 2] {
    let ([u, v], [du, dv]) = (sample.configuration.section(j), sample.rates.section(j));
    let square = (u * u + v * v).max(f64::MIN_POSITIVE);
    let (along, across) = (u * du + v * dv, u * dv - v * du);
    [along / square.sqrt(), across / square]
}

fn unwrapped(samples: &[Sample], j: usize) -> Vec<Point> {
    let mut points = over_time(samples, |s| s.configuration.direction_rad(j));
    let mut last_rad = 0.0;
    for (_, rad) in &mut points {
        let turns = f64::round((last_rad - *rad) / std::f64::consts::TAU);
        *rad += turns * std::f64::consts::TAU;
        last_rad = *rad;
    }
    points
}

fn spiral_paths(tasks: &[&Drawn<'_>]) -> Vec<Panel> {
    let (mut above, mut side) = (Vec::new(), Vec::new());
    for (task, colour) in tasks.iter().zip(COLOURS[0]) {
        let label = format!("n = {}", task.sections().end);
        side.push(Curve::line("", task.reference(View::SIDE), GREY).width(10));
        side.push(Curve::line(label, task.path(View::SIDE), colour));
        if let Some(last) = task.samples.last() {
            side.push(Curve::line("", task.backbone(View::SIDE, last), colour).width(7));
        }
    }
    if let Some(task) = tasks.last() {
        let reference = task.reference(View::ABOVE);
        above.push(Curve::line("reference", reference, GREY).width(10));
        above.push(Curve::line("tip, n = 3", task.path(View::ABOVE), GREEN));
    }
    vec![
        View::ABOVE.panel("Simulated spiral from above", above),
        View::SIDE.panel("Simulated robots at the end, from the side", side),
    ]
}

fn circle_path(view: View, from: &str, tasks: &[&Drawn<'_>]) -> Panel {
    let mut curves = Vec::new();
    for (task, colour) in tasks.iter().zip(COLOURS[0]) {
        let (centre_m, safe_m) = (obstacle_m(&task.run.scene), task.safe_m());
        if curves.is_empty() {
            curves.push(Curve::line("reference", task.reference(view), GREY).width(10));
            curves.push(Curve::line("obstacle", ball(view, &centre_m, 2e-3), DARK).width(8));
        }
        curves.push(Curve::line("", ball(view, &centre_m, safe_m), colour).width(2));
        let label = format!("D = {} mm", 1e3 * safe_m);
        curves.push(Curve::line(label, task.path(view), colour));
        let samples = task.samples.iter();
        let nearest = samples.min_by(|a, b| a.clearance_m.total_cmp(&b.clearance_m));
        let robot = nearest.map(|sample| task.backbone(view, sample));
        curves.extend(robot.map(|robot| Curve::line("", robot, colour).width(7)));
    }
    view.panel(format!("Simulated circle from {from}"), curves)
}

/// A value over time for each circle, from a sample and the safe distance.
fn of_circles(tasks: &[&Drawn<'_>], value: impl Fn(&Sample, f64) -> f64) -> Vec<Curve> {
    let curve = |(task, colour): (&&Drawn<'_>, RGBColor)| {
        let safe_m = task.safe_m();
        let points = over_time(task.samples, |sample| value(sample, safe_m));
        Curve::line(format!("D = {} mm", 1e3 * safe_m), points, colour)
    };
    tasks.iter().zip(COLOURS[0]).map(curve).collect()
}

fn circle_errors(tasks: &[&Drawn<'_>]) -> Panel {
    let curves = of_circles(tasks, |sample, _| sample.error_mm());
    let title = "Simulated circle: error".to_owned();
    timed(title, "error [mm]", Scale::Log { floor: 1e-4 }, curves)
}

/// Negative where the body is nearer than the safe distance.
fn circle_clearance(tasks: &[&Drawn<'_>]) -> Panel {
    let spare_mm = |sample: &Sample, safe_m| 1e3 * (sample.clearance_m - safe_m);
    let mut curves = of_circles(tasks, |sample, m| spare_mm(sample, m).min(CLEARANCE_MAX_MM));
    let level = |task: &&Drawn<'_>| task.level("safe distance D".to_owned(), 0.0, DARK);
    curves.extend(tasks.first().map(level));
    let title = "Simulated circle: clearance of the body beyond D".to_owned();
    timed(title, "clearance - D [mm]", Scale::Linear, curves)
}
