use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail, ensure};
use cdcr_client::model::settings_of;
use cdcr_client::{
    Changed, Circle, Connection, FeedEnd, FeedEvent, FeedOptions, FeedReport, Figure, FigurePlane,
    FigureShape, FileTrajectory, Line, Orientation, PAPER_SECTION_M, STATUS_TIMEOUT, Spiral,
    Straight, Trajectory, counted, section_lengths_m,
};
use cdcr_shared_types::codes::{Mode, Reason, RequestKind};
use cdcr_shared_types::{Status, Telemetry};

use crate::args::{
    ChangeArguments, CircleOptions, Curve, CurveArguments, FeedArguments, FigureArguments, GENTLE,
    LineOptions, RefOptions, SpiralOptions, StraightArguments, Target,
};
use crate::bar::Bar;
use crate::done::Done;
use crate::dry_run::{self, newest};
use crate::interrupt::Interrupt;
use crate::obstacle_in_way;
use crate::reach;
use crate::shape_choice::Guided;
use crate::standing::{MOVED_M, check_stands, distance_m};
use crate::stop_cause::stop_remedy;
use crate::tell;
use crate::tip_error::TipError;
use crate::unmeasured_tip::{self, TipWatch};
use crate::value::{CURVE_S, SPEED_M_S_MAX};
use crate::way_end;

/// From a first point farther away than this, the tip is visibly beside the reference for a while \[m\].
const FAR_M: f64 = 0.02;
/// Delay of the start of `goto` and `jog`.
const GO_LEAD: Duration = Duration::from_millis(500);
/// Default tolerance for reaching a point \[m\].
pub(crate) const MISSED_M: f64 = 1e-3;
/// A reference farther away than this, in robot lengths, needs a confirmation.
const FAR: f64 = 10.0;
/// Maximum number of rows of a repeated curve or file.
const ROWS_MAX: usize = 10_000_000;

/// Feed options, trajectory and connection.
type Prepared<'a> = (&'a FeedArguments, Box<dyn Trajectory>, Connection);

pub(crate) fn run(target: &Target, options: &RefOptions) -> anyhow::Result<Done> {
    let (arguments, trajectory, connection) = prepare(target, &options.curve)?;
    check_unit(&*trajectory, lengths_m(&connection, None)?.iter().sum())?;
    let feed = feed_options(arguments);
    feed.check()?;
    check_duration(&*trajectory)?;
    if !matches!(options.curve, Curve::File(_) | Curve::Stdin(_)) {
        check_speed(&*trajectory)?;
    }
    let allowed_m = arguments.max_error.unwrap_or(MISSED_M);
    if arguments.dry_run {
        if arguments.blend {
            blend(&connection, arguments, &*trajectory)?;
        }
        let mut demands = dry_run::compute(&connection, &*trajectory, &feed)?;
        demands.may_join = !arguments.blend;
        demands.print(trajectory.name())?;
        reach::check(&newest(&connection)?, &*trajectory, allowed_m)?;
        let positions = || dry_run::compute_positions(&connection, &*trajectory, &feed);
        demands.check_orientation(allowed_m, positions)?;
        demands.check(allowed_m)?;
        demands.check_self_contact()?;
        if !arguments.blend {
            note_distance(&newest(&connection)?, &*trajectory);
        }
        return Ok(Done::Good);
    }
    let before = newest(&connection)?;
    reach::check(&before, &*trajectory, allowed_m)?;
    if arguments.track {
        let settings = settings_of(&before.settings)?;
        dry_run::check_speed(&before, settings, &*trajectory, &feed, allowed_m)?;
    }
    if arguments.blend {
        let done = blend(&connection, arguments, &*trajectory)?;
        if done != Done::Good {
            return Ok(done);
        }
    } else {
        if arguments.track {
            note_distance(&before, &*trajectory);
        }
        unmeasured_tip::warn_now(&connection);
    }
    let (done, mut error) = follow(&connection, &*trajectory, feed, |_| Ok(()))?;
    if done == Done::Good {
        // A daemon that has ended meanwhile does not hide the error.
        let present = (connection.status(STATUS_TIMEOUT).ok()).zip(newest(&connection).ok());
        error.unheard =
            present.and_then(|(status, record)| unmeasured_tip::never(&status, &record));
        error.print(arguments.max_error)?;
    }
    Ok(done)
}

/// Moves the tip to the first point as `goto` does, or computes that way.
fn blend(
    connection: &Connection,
    arguments: &FeedArguments,
    trajectory: &dyn Trajectory,
) -> anyhow::Result<Done> {
    let (speed, acceleration) = GENTLE;
    let way = StraightArguments {
        speed,
        acceleration,
        max_error: arguments.max_error.unwrap_or(MISSED_M).max(MOVED_M),
        dry_run: arguments.dry_run,
    };
    let first_m = trajectory.position_m(0.0);
    go(connection, &way, |_| first_m).context("moving to the first point")
}

/// Prints a note where an approach may lead the tip far from the reference.
fn note_distance(before: &Telemetry, trajectory: &dyn Trajectory) {
    let away_m = distance_m(before.tip_position_m, trajectory.position_m(0.0));
    if away_m > FAR_M {
        tell!(
            "note: the tip is {:.0} mm from the first point. With --track it joins the moving reference, and may stay this far away or \
             farther meanwhile. Use --blend to move to the first point first; Ctrl-C holds the robot",
            1e3 * away_m
        );
    }
}

/// `cdcrctl goto …`, `cdcrctl jog …`: moves to the point that `end_m` computes from the tip position.
pub(crate) fn go(
    connection: &Connection,
    arguments: &StraightArguments,
    end_m: impl Fn([f64; 3]) -> [f64; 3],
) -> anyhow::Result<Done> {
    let status = connection.status(STATUS_TIMEOUT)?;
    if !arguments.dry_run {
        check_mode(&status)?;
    }
    let before = newest(connection)?;
    unmeasured_tip::warn(connection, &status, &before);
    if !arguments.dry_run {
        // Before the simulation, which lasts as long as the path is far.
        check_stands(connection, &before)?;
    }
    let start_m = before.tip_position_m;
    let goal_m = end_m(start_m);
    let reach_m = section_lengths_m(&status.robot).iter().sum();
    let begin_m = within(start_m, reach_m);
    let way = Straight::new(begin_m, goal_m, arguments.speed, arguments.acceleration);
    check_unit(&way, reach_m)?;
    reach::check_point(&before, goal_m, arguments.max_error)?;
    let way = Guided::new(&before, way, arguments.max_error)?;
    let options = go_options();
    let demands = dry_run::compute(connection, &way, &options)?;
    if arguments.dry_run {
        demands.print(way.name())?;
    }
    if let Err(missed) = demands.check_end(arguments.max_error) {
        let note = obstacle_in_way::note(connection, &way, &options, arguments.max_error)?;
        bail!("{missed}{note}");
    }
    demands.check_self_contact()?;
    if arguments.dry_run {
        return Ok(Done::Good);
    }
    check_stands(connection, &before)?;
    let (done, mut error) = follow(connection, &way, options, |_| Ok(()))?;
    if done == Done::Good {
        let end = newest(connection)?;
        error.take(&end);
        let status = connection.status(STATUS_TIMEOUT)?;
        let cause = unmeasured_tip::cause(&status, &end);
        let cause = cause.or_else(|| unmeasured_tip::never(&status, &end));
        way_end::print(&end, cause, &error, goal_m, arguments.max_error)?;
    }
    Ok(done)
}

/// Fails when only a reset lets the robot move.
pub(crate) fn check_mode(status: &Status) -> anyhow::Result<()> {
    if let Some(remedy) = stop_remedy(status) {
        let mode = Mode::text_of(status.mode);
        let reason = Reason::text_of(status.reason);
        bail!("the daemon is {mode} ({reason}), and only a reset lets the robot move. {remedy}");
    }
    Ok(())
}

/// Feed options for a path that starts at the tip.
pub(crate) fn go_options() -> FeedOptions {
    FeedOptions {
        track: true,
        lead: GO_LEAD,
        ..FeedOptions::default()
    }
}

/// The nearest point that the daemon accepts: the tip of a robot that is longer than its model may be farther
/// away.
pub(crate) fn within(point_m: [f64; 3], reach_m: f64) -> [f64; 3] {
    let factor = (0.999 * reach_m / distance_m(point_m, [0.0; 3])).min(1.0);
    point_m.map(|m| factor * m)
}

/// Feeds a trajectory and monitors the tip. When `watch` refuses a record, the robot holds, and the call
/// returns that error.
pub(crate) fn follow(
    connection: &Connection,
    trajectory: &dyn Trajectory,
    options: FeedOptions,
    mut watch: impl FnMut(&Telemetry) -> anyhow::Result<()>,
) -> anyhow::Result<(Done, TipError)> {
    let interrupt = Interrupt::catch()?;
    let bar = Bar::new(trajectory.name());
    let (mut error, mut tip) = (TipError::default(), TipWatch::default());
    let mut refused = None;
    let report = connection.feed(trajectory, options)?.run(|event| {
        match event {
            FeedEvent::Scheduled { start_ns } => {
                error.start_ns = start_ns;
                error.fed_ns = start_ns - options.lead.as_nanos() as u64;
            }
            FeedEvent::Record(record) => {
                error.take(record);
                tip.take(record).into_iter().for_each(tell::later);
                refused = watch(record).err();
            }
            FeedEvent::Progress(progress) => bar.show(&progress, error.live()),
            _ => {}
        }
        if refused.is_some() || interrupt.is_raised() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    drop(bar);
    if let Some(refused) = refused {
        connection.request(RequestKind::Hold)?;
        return Err(refused.context("the daemon holds"));
    }
    let done = finish(connection, trajectory.name(), &report)?;
    Ok((done, error))
}

/// Refuses a reference so short that it would pass between two cycles.
fn check_duration(trajectory: &dyn Trajectory) -> anyhow::Result<()> {
    let is_point = trajectory.knots_s().is_some_and(|knots| knots.len() < 2);
    let duration_s = trajectory.duration_s();
    ensure!(
        is_point || duration_s >= *CURVE_S.start(),
        "the reference takes {duration_s:.1e} s, less than {} s: use a lower speed",
        CURVE_S.start()
    );
    Ok(())
}

/// Refuses a drawn curve on which the tip would be faster than is probably meant. A file may have steps.
fn check_speed(trajectory: &dyn Trajectory) -> anyhow::Result<()> {
    const STEP_S: f64 = 1e-4;
    let speed_m_s = |k: u32| {
        let time_s = f64::from(k) * 1e-3 * (trajectory.duration_s() - STEP_S);
        let [from_m, to_m] = [time_s, time_s + STEP_S].map(|at_s| trajectory.position_m(at_s));
        distance_m(from_m, to_m) / STEP_S
    };
    let fastest_m_s = (0..=1000).map(speed_m_s).fold(0.0, f64::max);
    ensure!(
        fastest_m_s <= 1.001 * SPEED_M_S_MAX,
        "the tip would move at up to {fastest_m_s:.1} m/s, more than {SPEED_M_S_MAX}: use a lower speed, rate or velocity, or a longer \
         duration (in m/s, rad/s, s)"
    );
    Ok(())
}

/// Refuses a reference in millimetres. The daemon would refuse it, too, but without this reason.
fn check_unit(trajectory: &dyn Trajectory, reach_m: f64) -> anyhow::Result<()> {
    let ends_s = [0.0, trajectory.duration_s()];
    let times_s = trajectory.knots_s().unwrap_or(&ends_s);
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let distances_m = times_s
        .iter()
        .map(|&time_s| norm(trajectory.position_m(time_s)));
    let farthest_m = distances_m.fold(0.0, f64::max);
    if farthest_m > FAR * reach_m {
        bail!(
            "the reference goes {farthest_m:.1} m away from the base, and the robot is {reach_m:.2} m long: are these \
             millimetres?\npositions are in m: 150 mm are 0.15"
        );
    }
    Ok(())
}

/// Checks everything that needs no daemon first, so that a bad file is reported even without one.
fn prepare<'a>(target: &Target, curve: &'a Curve) -> anyhow::Result<Prepared<'a>> {
    let (arguments, change, trajectory) = match curve {
        Curve::File(options) => {
            let trajectory = FileTrajectory::read(&options.path)?;
            (&options.feed, &options.change, trajectory)
        }
        Curve::Stdin(options) => {
            let name = Path::new("standard input");
            let trajectory = FileTrajectory::read_from(name, std::io::stdin())?;
            (&options.feed, &options.change, trajectory)
        }
        _ => return prepare_drawn(target.connect()?, curve),
    };
    let trajectory = changed(trajectory, change)?;
    Ok((arguments, trajectory, target.connect()?))
}

/// Applies the options for speed, size, plane and rounds.
fn changed(
    trajectory: impl Trajectory + 'static,
    change: &ChangeArguments,
) -> anyhow::Result<Box<dyn Trajectory>> {
    let &ChangeArguments {
        speed,
        repeat,
        scale,
        plane,
    } = change;
    let is_turned = matches!(trajectory.orientation(0.0), Orientation::Full(_));
    ensure!(
        !is_turned || plane == FigurePlane::Xy,
        "--plane does not support orientations: remove qx,qy,qz,qw from the file"
    );
    let duration_s = f64::from(repeat) * trajectory.duration_s() / speed;
    let rows = trajectory.knots_s().map_or(0, <[f64]>::len) * repeat as usize;
    ensure!(
        duration_s <= *CURVE_S.end(),
        "the reference lasts {duration_s:.0} s: at most {} s are allowed (--speed, --repeat)",
        CURVE_S.end()
    );
    ensure!(
        rows <= ROWS_MAX,
        "the reference has {rows} rows: at most {ROWS_MAX} are allowed (--repeat)"
    );
    let trajectory = Box::new(trajectory);
    Ok(Box::new(Changed::new(
        trajectory, speed, scale, plane, repeat,
    )))
}

/// A curve from a formula, for the daemon's robot.
fn prepare_drawn(connection: Connection, curve: &Curve) -> anyhow::Result<Prepared<'_>> {
    let lengths = |curve: &CurveArguments| lengths_m(&connection, curve.sections);
    let robot_m: f64 = lengths_m(&connection, None)?.iter().sum();
    let (arguments, trajectory): (_, Box<dyn Trajectory>) = match curve {
        Curve::Spiral(options) => {
            let spiral = spiral(options, &lengths(&options.curve)?);
            (&options.curve.feed, changed(spiral, &options.curve.change)?)
        }
        Curve::Line(options) => {
            let line = line(options, &lengths(&options.curve)?);
            (&options.curve.feed, changed(line, &options.curve.change)?)
        }
        Curve::Circle(options) => {
            let circle = circle(options, &lengths(&options.curve)?);
            (&options.curve.feed, changed(circle, &options.curve.change)?)
        }
        Curve::Helix(options) => {
            let rise = |radius_m| options.rise.map_or(1.0, |rise_m| rise_m / radius_m);
            let shape = |radius_m| FigureShape::Helix {
                turns: options.turns,
                rise: rise(radius_m),
            };
            figure(&options.figure, robot_m, shape)
        }
        Curve::Lissajous(options) => figure(&options.figure, robot_m, |_| {
            FigureShape::Lissajous(options.ratio)
        }),
        Curve::Rose(options) => figure(&options.figure, robot_m, |_| {
            FigureShape::Rose(options.petals)
        }),
        Curve::Polygon(options) => figure(&options.figure, robot_m, |_| {
            FigureShape::Polygon(options.corners)
        }),
        Curve::File(_) | Curve::Stdin(_) => bail!("a file is read, not drawn"),
    };
    Ok((arguments, trajectory, connection))
}

/// A figure for a robot of this length; its shape may depend on its radius \[m\].
fn figure(
    options: &FigureArguments,
    robot_m: f64,
    shape: impl FnOnce(f64) -> FigureShape,
) -> (&FeedArguments, Box<dyn Trajectory>) {
    let [radius_m, height_m] = Figure::SHARES.map(|share| share * robot_m);
    let centre_m = options.centre.unwrap_or([0.0, 0.0, height_m]);
    let radius_m = options.radius.unwrap_or(radius_m);
    let place_m = (centre_m, radius_m);
    let (plane, speed_m_s, rounds) = (options.plane, options.speed, options.repeat);
    let figure = Figure::new(shape(radius_m), plane, place_m, speed_m_s, rounds);
    (&options.feed, Box::new(figure))
}

/// Lengths of the daemon's sections; with `--sections`, that many, with the paper's lengths for additional
/// ones.
fn lengths_m(connection: &Connection, sections: Option<u32>) -> anyhow::Result<Vec<f64>> {
    let status = connection
        .status(STATUS_TIMEOUT)
        .context("cannot read the robot's sections")?;
    let mut lengths = section_lengths_m(&status.robot);
    if let Some(sections) = sections {
        lengths.resize(sections as usize, PAPER_SECTION_M);
    }
    Ok(lengths)
}

fn spiral(options: &SpiralOptions, lengths_m: &[f64]) -> Spiral {
    let paper = Spiral::for_sections(lengths_m);
    Spiral {
        start_rad: options.start.map_or(paper.start_rad, f64::to_radians),
        duration_s: duration_s(&options.curve, paper.duration_s),
        ..paper
    }
}

fn line(options: &LineOptions, lengths_m: &[f64]) -> Line {
    let paper = Line::for_sections(lengths_m);
    Line {
        start_m: options.start.unwrap_or(paper.start_m),
        velocity_m_s: options.velocity,
        duration_s: duration_s(&options.curve, paper.duration_s),
        tip_axis: options.axis,
    }
}

fn circle(options: &CircleOptions, lengths_m: &[f64]) -> Circle {
    let paper = Circle::for_sections(lengths_m);
    Circle {
        radius_m: options.radius.unwrap_or(paper.radius_m),
        height_m: options.height.unwrap_or(paper.height_m),
        rate_rad_s: options.rate,
        duration_s: duration_s(&options.curve, paper.duration_s),
    }
}

fn duration_s(curve: &CurveArguments, paper_s: f64) -> f64 {
    curve.duration.map_or(paper_s, |d| d.as_secs_f64())
}

fn feed_options(arguments: &FeedArguments) -> FeedOptions {
    FeedOptions {
        step: arguments.step,
        lead: arguments.lead,
        interpolation: arguments.interpolation,
        track: arguments.track,
        ..FeedOptions::default()
    }
}

/// The lease has already been given back; an interrupted feed also requests hold.
fn finish(connection: &Connection, name: &str, report: &FeedReport) -> anyhow::Result<Done> {
    if report.end == FeedEnd::Interrupted {
        connection.request(RequestKind::Hold)?;
        tell!("interrupted: released the lease, the daemon holds");
        return Ok(Done::Interrupted);
    }
    let seconds = (report.end_ns - report.start_ns) as f64 * 1e-9;
    let tracked = if report.tracked {
        "and tracked to its end"
    } else {
        "but not tracked (use --track, or cdcrctl track while feeding)"
    };
    writeln!(
        std::io::stdout(),
        "{name}: {} in {}, {seconds:.2} s, fed {tracked}",
        counted(report.points, "point"),
        counted(report.chunks, "chunk")
    )?;
    Ok(Done::Good)
}
