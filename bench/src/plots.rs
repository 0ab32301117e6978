//! The paper's figures, drawn from the first run of each experiment.

use anyhow::{Context, Result};
use cdcr_client::counted;
use cdcr_controller::nmpc::Coordinates;
use cdcr_controller::robot::{Configuration, Robot, ZyxAngles};
use nalgebra::Vector3;

use crate::chart::{
    BLUE, Curve, DARK, GREEN, GREY, ORANGE, PURPLE, Panel, Point, RGBColor, SKY, Scale, View,
    YELLOW,
};
use crate::closed_loop::{PERIOD_S, Sample};
use crate::dataset::Dataset;
use crate::experiment::{CIRCLE_DISTANCES_M, LINE_TILT_MAX_RAD, Outcome, Solver, Task};

/// Smallest bend with a meaningful direction \[rad\].
const STRAIGHT_RAD: f64 = 1e-3;
/// Smaller errors are drawn at this value, because the scale is logarithmic \[mm\].
const ERRORS: Scale = Scale::Log { floor: 1e-14 };
const BROWN: RGBColor = RGBColor(120, 80, 40);
const COLOURS: [RGBColor; 3] = [BLUE, ORANGE, GREEN];
const PALE_COLOURS: [RGBColor; 3] = [SKY, YELLOW, PURPLE];
const POINTS: u32 = 24;
const SHAPES: usize = 6;

/// Limit of drawn angle rates: a spike at a nearly straight section would flatten all other values \[rad/s\].
const ANGLE_RATE_MAX_RAD_S: f64 = 10.0;
const CLEARANCE_MAX_MM: f64 = 2.0;
const SHARES: f64 = 1e-3;

pub fn draw(dataset: &mut Dataset, outcomes: &[Outcome]) -> Result<()> {
    let tasks = Task::all().into_iter();
    let drawn = tasks.map(|task| Drawn::new(outcomes, task));
    let drawn = drawn.collect::<Result<Vec<_>>>()?;
    let [spirals, lines, circles] = ["spiral", "line", "circle"].map(|name| {
        let is_it = |one: &&Drawn<'_>| one.run.experiment.task.name() == name;
        drawn.iter().filter(is_it).collect::<Vec<_>>()
    });
    let mut plot = |name, size, panels: Vec<Panel>| dataset.plot(name, size, &panels);
    plot("paper-spiral-path", (2, 900), spiral_paths(&spirals))?;
    plot(
        "paper-spiral-errors",
        (1, 560),
        each(&spirals, Drawn::errors),
    )?;
    plot(
        "paper-spiral-solvers",
        (1, 560),
        each(&spirals, Drawn::distances),
    )?;
    plot(
        "paper-spiral-controls",
        (2, 620),
        pairs(&spirals, Drawn::controls),
    )?;
    plot(
        "paper-spiral-cables",
        (1, 600),
        each(&spirals, Drawn::cables),
    )?;
    plot("paper-spiral-times", (1, 560), each(&spirals, Drawn::times))?;
    plot("paper-line-shapes", (2, 1050), pairs(&lines, Drawn::shapes))?;
    plot("paper-line-angles", (2, 600), pairs(&lines, Drawn::angles))?;
    plot(
        "paper-line-controls",
        (2, 620),
        pairs(&lines, Drawn::controls),
    )?;
    let errors = [each(&lines, Drawn::errors), each(&lines, Drawn::tilt)].into_iter();
    plot("paper-line-errors", (1, 560), errors.flatten().collect())?;
    plot(
        "paper-line-solvers",
        (1, 560),
        each(&lines, Drawn::distances),
    )?;
    plot("paper-line-cables", (1, 600), each(&lines, Drawn::cables))?;
    plot("paper-line-times", (1, 560), each(&lines, Drawn::times))?;
    let views = [(View::ABOVE, "above"), (View::SIDE, "the side")];
    let paths = views.map(|(view, from)| circle_path(view, from, &circles));
    plot("paper-circle-path", (2, 900), paths.into())?;
    plot(
        "paper-circle-errors",
        (1, 640),
        vec![circle_errors(&circles)],
    )?;
    plot(
        "paper-circle-clearance",
        (1, 640),
        vec![circle_clearance(&circles)],
    )?;
    plot(
        "paper-circle-cables",
        (1, 520),
        each(&circles, Drawn::cables),
    )?;
    plot("paper-circle-times", (1, 560), each(&circles, Drawn::times))
}

fn each(tasks: &[&Drawn<'_>], panel: fn(&Drawn<'_>) -> Panel) -> Vec<Panel> {
    tasks.iter().map(|task| panel(task)).collect()
}

fn pairs(tasks: &[&Drawn<'_>], panels: fn(&Drawn<'_>) -> [Panel; 2]) -> Vec<Panel> {
    tasks.iter().flat_map(|task| panels(task)).collect()
}

fn path(view: View, samples: &[Sample]) -> Vec<Point> {
    view.line(samples.iter().map(|sample| sample.tip.position_m.into()))
}

fn reference(view: View, samples: &[Sample]) -> Vec<Point> {
    view.line(samples.iter().map(|sample| sample.reference_m.into()))
}

fn backbone(view: View, robot: &Robot, at: &Configuration) -> Vec<Point> {
    let shares = (0..=POINTS).map(|i| f64::from(i) / f64::from(POINTS));
    let sections = 0..robot.section_count();
    let places = sections.flat_map(|j| shares.clone().map(move |share| (j, share)));
    view.line(places.map(|(j, share)| robot.body_point(at, j, share).into()))
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

/// For each value, the share of samples that are equal or larger.
fn exceeded(samples: &[Sample], value: impl Fn(&Sample) -> f64) -> Vec<Point> {
    let mut values: Vec<f64> = samples.iter().map(value).collect();
    values.retain(|value| *value > 0.0);
    values.sort_unstable_by(f64::total_cmp);
    let count = values.len();
    let points = values.into_iter().enumerate();
    points
        .map(|(k, value)| (value, (count - k) as f64 / count as f64))
        .collect()
}

fn timed(title: String, y: &'static str, scale: Scale, curves: Vec<Curve>) -> Panel {
    Panel::new(title, ["time [s]", y], scale, curves)
}

/// One simulation, with every solver and with `kpso-refined`.
struct Drawn<'a> {
    title: String,
    all: Vec<&'a Outcome>,
    run: &'a Outcome,
}

impl<'a> Drawn<'a> {
    fn new(outcomes: &'a [Outcome], task: Task) -> Result<Self> {
        let title = match task {
            Task::Spiral { sections } => format!("spiral, {}", counted(sections, "section")),
            Task::Line { rate_limit_rad_s } => {
                format!("line, rates up to {rate_limit_rad_s} rad/s")
            }
            Task::Circle { safe_distance_m } => format!("circle, D = {} mm", 1e3 * safe_distance_m),
        };
        let find = |solver: Solver| {
            let is_it = |outcome: &&Outcome| {
                let found = &outcome.experiment;
                let what = (found.task, found.solver, found.coordinates);
                what == (task, solver, Coordinates::BendVector)
            };
            let missing = || format!("no outcome of {task:?} with {}", solver.name());
            outcomes.iter().find(is_it).with_context(missing)
        };
        Ok(Self {
            title: format!("Simulated {title}"),
            all: Solver::ALL.into_iter().map(find).collect::<Result<_>>()?,
            run: find(Solver::KpsoRefined)?,
        })
    }

    fn samples(&self) -> &'a [Sample] {
        &self.run.first
    }

    fn level(&self, label: String, y: f64, colour: RGBColor) -> Curve {
        let end_s = self.samples().last().map_or(1.0, |sample| sample.time_s);
        Curve::level(label, y, 0.0..end_s, colour)
    }

    fn sections(&self) -> usize {
        let first = self.samples().first();
        first.map_or(0, |sample| sample.configuration.section_count())
    }

    fn errors(&self) -> Panel {
        let axis = |(i, label): (usize, &str)| {
            let along = over_time(self.samples(), |s| s.offset_mm()[i].abs());
            Curve::line(label, along, COLOURS[i]).width(3)
        };
        let axes = ["|x error|", "|y error|", "|z error|"].into_iter();
        let mean_mm = self.run.experiment.task.paper().mean_error_mm;
        let mean = mean_mm.map(|mm| self.level(format!("paper's mean {mm:e} mm"), mm, DARK));
        let curves = axes.enumerate().map(axis).chain(mean).collect();
        timed(self.title.clone(), "error [mm]", ERRORS, curves)
    }

    /// A panel with linear axes, titled with the simulation and `part`.
    fn linear(&self, part: &str, y: &'static str, curves: Vec<Curve>) -> Panel {
        timed(format!("{}{part}", self.title), y, Scale::Linear, curves)
    }

    fn distances(&self) -> Panel {
        // The first curve is broad, because the next one often covers it.
        let widths = [9, 3, 3, 3];
        self.shares("error is larger than [mm]", widths, Sample::error_mm, None)
    }

    /// Share of the cycles in which a value exceeds each threshold, for each solver.
    fn shares(
        &self,
        x: &'static str,
        widths: [u32; Solver::ALL.len()],
        value: impl Fn(&Sample) -> f64,
        beside: impl IntoIterator<Item = Curve>,
    ) -> Panel {
        let styles = [SKY, PURPLE, ORANGE, BLUE].into_iter().zip(widths);
        let curve = |(outcome, (colour, width)): (&&Outcome, (RGBColor, u32))| {
            let points = exceeded(&outcome.first, &value);
            Curve::line(outcome.experiment.solver.name(), points, colour).width(width)
        };
        let curves = self.all.iter().zip(styles).map(curve).chain(beside);
        let (title, scale) = (self.title.clone(), Scale::LogLog { floor: SHARES });
        Panel::new(title, [x, "share of the cycles"], scale, curves.collect())
    }

    fn angles(&self) -> [Panel; 2] {
        let samples = self.samples();
        let bend = |j: usize| {
            let points = over_time(samples, |s| s.configuration.bend_rad(j));
            Curve::line(format!("θ{}", j + 1), points, COLOURS[j % 3])
        };
        let direction = |j: usize| {
            let pieces = bent(samples, j, unwrapped(samples, j));
            Curve::pieces(format!("φ{}", j + 1), pieces, COLOURS[j % 3])
        };
        let sections = 0..self.sections();
        let (bends, directions) = (sections.clone().map(bend), sections.map(direction));
        [
            self.linear(": bend", "θ [rad]", bends.collect()),
            self.linear(": direction", "φ [rad]", directions.collect()),
        ]
    }

    /// The commanded rates: of the bend vectors, and of the paper's angles.
    fn controls(&self) -> [Panel; 2] {
        let samples = self.samples();
        let (mut vectors, mut angles) = (Vec::new(), Vec::new());
        for j in 0..self.sections() {
            let colours = [COLOURS[j % 3], PALE_COLOURS[j % 3]];
            let label = |name: &str| format!("{name}{}", j + 1);
            for (i, colour) in colours.into_iter().enumerate() {
                let points = over_time(samples, |s| s.rates.section(j)[i]);
                vectors.push(Curve::line(label(["u̇", "v̇"][i]), points, colour).width(3));
                let most = ANGLE_RATE_MAX_RAD_S;
                let points = over_time(samples, |s| angle_rates(s, j)[i].clamp(-most, most));
                let pieces = bent(samples, j, points);
                angles.push(Curve::pieces(label(["θ̇", "φ̇"][i]), pieces, colour).width(3));
            }
        }
        [
            self.linear(": as commanded", "u̇, v̇ [rad/s]", vectors),
            self.linear(": in angles", "θ̇, φ̇ [rad/s]", angles),
        ]
    }

    fn cables(&self) -> Panel {
        let colours = [COLOURS, PALE_COLOURS, [DARK, GREY, BROWN]];
        let robot = &self.run.scene.robot;
        let from_m = robot.cable_lengths(&Configuration::straight(robot.section_count()));
        let curve = |i: usize| {
            let length = |s: &Sample| 1e3 * (robot.cable_lengths(&s.configuration)[i] - from_m[i]);
            let (section, cable) = (i / 3, i % 3);
            let points = over_time(self.samples(), length);
            let label = format!("L{}{}", section + 1, cable + 1);
            Curve::line(label, points, colours[section % 3][cable]).width(3)
        };
        let curves = (0..robot.cable_count()).map(curve);
        self.linear("", "change of length [mm]", curves.collect())
    }

    /// Share of solves that took longer than each time, for each solver, with the paper's mean and the
    /// period.
    fn times(&self) -> Panel {
        let mean_ms = self.run.experiment.task.paper().mean_solve_ms;
        let period_ms = 1e3 * PERIOD_S;
        let at = |label, ms: f64, colour| {
            Curve::upright(format!("{label} {ms} ms"), 1e3 * ms, SHARES, colour)
        };
        // Equal for the spiral with two sections.
        let marks = [
            at("paper's mean", mean_ms, GREY).width(10),
            at("period", period_ms, DARK),
        ];
        let us = |sample: &Sample| sample.solve_ns as f64 * 1e-3;
        self.shares("solve takes longer than [µs]", [2; _], us, marks)
    }

    fn shapes(&self) -> [Panel; 2] {
        let samples = self.samples();
        let last = samples.len().saturating_sub(1);
        let panel = |view: View, from: &str| {
            let mut curves = vec![Curve::line("line", reference(view, samples), ORANGE).width(8)];
            for i in 0..SHAPES {
                let Some(sample) = samples.get(i * last / (SHAPES - 1)) else {
                    continue;
                };
                let points = backbone(view, &self.run.scene.robot, &sample.configuration);
                let time = format!("{:.2} s", sample.time_s);
                let label = Some(time).filter(|_| [0, SHAPES - 1].contains(&i));
                let label = label.unwrap_or_default();
                curves.push(Curve::line(label, points, between(GREY, BLUE, i)).width(5));
            }
            view.panel(format!("{}, {from}", self.title), curves)
        };
        [panel(View::SIDE, "side"), panel(View::FRONT, "front")]
    }

    fn tilt(&self) -> Panel {
        let angles = |s: &Sample| ZyxAngles::from_rotation(&s.tip.rotation);
        let theta = over_time(self.samples(), |s| angles(s).theta_rad.abs());
        let psi = over_time(self.samples(), |s| angles(s).psi_rad.abs());
        let bound = format!("bound {LINE_TILT_MAX_RAD} rad");
        let curves = vec![
            Curve::line("|Θ|", theta, BLUE).width(3),
            Curve::line("|Ψ|", psi, ORANGE).width(3),
            self.level(bound, LINE_TILT_MAX_RAD, DARK),
        ];
        let title = format!("{}: tilt of the tip", self.title);
        timed(title, "tilt [rad]", ERRORS, curves)
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
    let is_bent = |sample: &Sample| sample.configuration.bend_rad(j) > STRAIGHT_RAD;
    let all: Vec<(bool, Point)> = samples.iter().map(is_bent).zip(points).collect();
    let runs = all.chunk_by(|a, b| a.0 == b.0).filter(|run| run[0].0);
    runs.map(|run| run.iter().map(|(_, point)| *point).collect())
        .collect()
}

fn spiral_paths(tasks: &[&Drawn<'_>]) -> Vec<Panel> {
    let (mut above, mut side) = (Vec::new(), Vec::new());
    for (task, colour) in tasks.iter().zip(COLOURS) {
        let (run, samples) = (task.run, task.samples());
        let label = format!("n = {}", run.scene.robot.section_count());
        side.push(Curve::line("", reference(View::SIDE, samples), GREY).width(10));
        side.push(Curve::line(label, path(View::SIDE, samples), colour));
        if let Some(last) = samples.last() {
            let robot = backbone(View::SIDE, &run.scene.robot, &last.configuration);
            side.push(Curve::line("", robot, colour).width(7));
        }
    }
    if let Some(task) = tasks.last() {
        let samples = task.samples();
        let along = reference(View::ABOVE, samples);
        above.push(Curve::line("reference", along, GREY).width(10));
        above.push(Curve::line("tip, n = 3", path(View::ABOVE, samples), GREEN));
    }
    vec![
        View::ABOVE.panel("Simulated spiral from above", above),
        View::SIDE.panel("Simulated robots at the end, from the side", side),
    ]
}

fn detours<'a>(tasks: &[&'a Drawn<'a>]) -> impl Iterator<Item = (&'a Drawn<'a>, f64, RGBColor)> {
    let with = |((task, distance_m), colour): ((&&'a Drawn<'a>, _), _)| (*task, distance_m, colour);
    tasks.iter().zip(CIRCLE_DISTANCES_M).zip(COLOURS).map(with)
}

fn circle_path(view: View, from: &str, tasks: &[&Drawn<'_>]) -> Panel {
    let mut curves = Vec::new();
    for (task, distance_m, colour) in detours(tasks) {
        let (run, samples) = (task.run, task.samples());
        let centre_m = run.scene.obstacle_m();
        if curves.is_empty() {
            curves.push(Curve::line("reference", reference(view, samples), GREY).width(10));
            curves.push(Curve::line("obstacle", ball(view, &centre_m, 2e-3), DARK).width(8));
        }
        curves.push(Curve::line("", ball(view, &centre_m, distance_m), colour).width(2));
        let label = format!("D = {} mm", 1e3 * distance_m);
        curves.push(Curve::line(label, path(view, samples), colour));
        let nearest = samples
            .iter()
            .min_by(|a, b| a.clearance_m.total_cmp(&b.clearance_m));
        if let Some(sample) = nearest {
            let robot = backbone(view, &run.scene.robot, &sample.configuration);
            curves.push(Curve::line("", robot, colour).width(7));
        }
    }
    view.panel(format!("Simulated circle from {from}"), curves)
}

fn of_detours(
    tasks: &[&Drawn<'_>],
    value: impl Fn(&Sample, f64) -> f64,
) -> impl Iterator<Item = Curve> {
    let curve = move |(task, distance_m, colour): (&Drawn<'_>, f64, RGBColor)| {
        let points = over_time(task.samples(), |sample| value(sample, distance_m));
        Curve::line(format!("D = {} mm", 1e3 * distance_m), points, colour)
    };
    detours(tasks).map(curve)
}

fn circle_errors(tasks: &[&Drawn<'_>]) -> Panel {
    let curves = of_detours(tasks, |sample, _| sample.error_mm()).collect();
    let title = "Simulated circle: error".to_owned();
    timed(title, "error [mm]", Scale::Log { floor: 1e-4 }, curves)
}

/// Negative where the body is nearer than the safe distance.
fn circle_clearance(tasks: &[&Drawn<'_>]) -> Panel {
    let spare_mm = |sample: &Sample, distance_m| 1e3 * (sample.clearance_m - distance_m);
    let curves = of_detours(tasks, |sample, m| spare_mm(sample, m).min(CLEARANCE_MAX_MM));
    let level = |task: &&Drawn<'_>| task.level("safe distance D".to_owned(), 0.0, DARK);
    let curves = curves.chain(tasks.first().map(level)).collect();
    let title = "Simulated circle: clearance of the body beyond D".to_owned();
    timed(title, "clearance - D [mm]", Scale::Linear, curves)
}
