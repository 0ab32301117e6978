//! Computes the demands of a reference on the robot before anything moves.
//!
//! It simulates the closed loop with the ideal robot of the daemon's model. The start is the present
//! configuration, with the daemon's tip offset, obstacles, acceleration and solver settings. The tip first
//! moves directly to the first point, then along the points as they would be sent; each part has its own
//! maxima. A robot with a limit of its acceleration first joins their motion, as with the daemon; errors count
//! from then on. The guard has the daemon's stopping path, and keeps the margin of the present tip offset. A real
//! robot has motors, play and noise: near obstacles it may achieve less. The body may touch itself in the simulation,
//! so that a path that the daemon would not complete is refused with its cause.

mod held_back;
mod joining;
mod self_contact;
mod sent;
mod slowed;
mod too_fast;
mod unrepeated;

use std::fmt;
use std::io::Write;
use std::time::Duration;

use anyhow::{Context, bail};
use cdcr_client::model::{moving_ns, obstacle_of, robot_of, settings_of};
use cdcr_client::{Connection, FeedOptions, Orientation, Trajectory, obstacles};
use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
use cdcr_controller::reference::{self, Approach};
use cdcr_controller::robot::{Configuration, Obstacle, Robot};
use cdcr_shared_types::Telemetry;
use nalgebra::Vector3;

use crate::bar::Bar;
use crate::bend_limit::{BendShare, WAY_OUT};
use crate::interrupt::Interrupt;
use held_back::HeldBack;
use joining::joining;
use self_contact::{SelfContact, permitted_m, without_limit};
use sent::{PositionsOf, check_duration, points};
use slowed::Slowed;
pub(crate) use too_fast::check_speed;
use unrepeated::Unrepeated;

/// Maximum duration of the move to the first point \[s\].
const MOVE_MAX_S: f64 = 30.0;
/// A tip that gets no nearer than by this in [`STALL_CYCLES`] has arrived \[m\].
const NEARER_M: f64 = 1e-6;
const STALL_CYCLES: u32 = 100;
/// A robot this near to the safe distance is held back by an obstacle \[m\].
const NEAR_M: f64 = 5e-3;
/// Maximum number of cycles of a simulated reference.
const CYCLES_MAX: u64 = 200_000;

/// From a first point nearer than this, the approach is the reference itself \[m\].
const JOINED_M: f64 = 1e-3;
/// A dry run does not know the limits of the daemon's approach.
const NO_APPROACH: &str = "  \
    --track does not take this fastest way: it joins the moving reference (motion.approach). Rates, strokes and clearance of the approach are \
    not computed;\n  its clearance may be smaller, down to the safe distance that the guard keeps. --blend goes straight to the first point: \
    --blend --dry-run computes that way, too.";

/// Demands of a reference on the robot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Demands {
    /// Distance from the present tip to the first point \[m\].
    distance_m: f64,
    /// The move to the first point.
    before: Motion,
    /// The motion from the first point on.
    along: Motion,
    cycles: u64,
    error_sum_m: f64,
    error_max_m: f64,
    error_end_m: f64,
    /// Time \[s\] and point \[m\] of the largest error.
    farthest: (f64, [f64; 3]),
    /// The limit that held the robot back there.
    missed_at: Option<HeldBack>,
    /// The clearance there.
    missed_clearance_m: f64,
    end_m: [f64; 3],
    stroke_max_m: f64,
    safe_distance_m: f64,
    has_orientation: bool,
    unrepeated: Option<Unrepeated>,
    /// The deepest along the reference, of those that the daemon would not permit.
    self_contact: Option<SelfContact>,
    /// Overlap of the body that the daemon would permit \[m\].
    overlap_max_m: f64,
    /// The body overlaps by that much at the start, more than the robot may.
    overlaps: bool,
    /// The reference does not begin where the tip is, and nothing brings the tip there before: `--track` would join it.
    pub(crate) may_join: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Motion {
    rate_rad_s: f64,
    /// The largest rate as a share of its limit.
    rate_share: f64,
    acceleration_rad_s2: f64,
    bend_rad: f64,
    bend_share: BendShare,
    stroke_m: f64,
    /// In the newest period.
    held_back: Option<HeldBack>,
    /// In the newest period.
    slowed: Option<Slowed>,
    clearance_m: f64,
}

/// The record of this cycle; a status may be 0.1 s old.
pub(crate) fn newest(connection: &Connection) -> anyhow::Result<Telemetry> {
    let record = connection
        .telemetry()?
        .next_within(Duration::from_secs(1))?;
    record.context("no telemetry within 1 s: the tip position is unknown")
}

/// The daemon's robot and its configuration.
pub(crate) fn robot_and_pose(record: &Telemetry) -> anyhow::Result<(Robot, Configuration)> {
    let robot = robot_of(&record.robot)?;
    let here = Configuration::from_slice(&record.bend_rad[..robot.coordinate_count()]);
    Ok((
        robot,
        here.context("the daemon does not know the pose of the robot")?,
    ))
}

/// Simulates `trajectory` with the daemon's robot, as it would be fed with `options`.
pub(crate) fn compute(
    connection: &Connection,
    trajectory: &dyn Trajectory,
    options: &FeedOptions,
) -> anyhow::Result<Demands> {
    let record = newest(connection)?;
    let settings = settings_of(&record.settings)?;
    simulate(&record, settings, trajectory, options)
}

/// As [`compute`], with any orientation.
pub(crate) fn compute_positions(
    connection: &Connection,
    trajectory: &dyn Trajectory,
    options: &FeedOptions,
) -> anyhow::Result<Demands> {
    compute(connection, &PositionsOf(trajectory), options)
}

/// The longest reference that is simulated \[s\].
fn longest_s(record: &Telemetry) -> f64 {
    CYCLES_MAX as f64 * record.period_ns as f64 * 1e-9
}

/// Simulates `trajectory` from the state in `record`.
pub(crate) fn simulate(
    record: &Telemetry,
    settings: NmpcSettings,
    trajectory: &dyn Trajectory,
    options: &FeedOptions,
) -> anyhow::Result<Demands> {
    let (robot, here) = robot_and_pose(record)?;
    let overlap_max_m = permitted_m(&robot, &here);
    let overlaps = overlap_max_m > robot.self_overlap_max_m();
    let robot = without_limit(&robot)?;
    let period_s = record.period_ns as f64 * 1e-9;
    let cycles = (trajectory.duration_s() / period_s).ceil();
    check_duration(trajectory, longest_s(record))?;
    let points = points(trajectory, options, robot.reach_m())?;
    let offset_m: Vector3<f64> = record.tip_offset_m.map(|m| -m).into();
    let at_s = |time_s: f64| points.sample((time_s * 1e9) as u64).moved(&offset_m);
    let known: Vec<Obstacle> = obstacles(record).iter().filter_map(obstacle_of).collect();
    let mut nmpc = Nmpc::new(robot.clone(), period_s, settings)?;
    let valid_periods = moving_ns(record) as f64 / record.period_ns as f64;

    let first = |_: f64| at_s(0.0);
    let mut way = ClosedLoop::new(&robot, period_s, settings, here, &known, first)?
        .with_acceleration(record.acceleration_rad_s2)
        .with_stopping(valid_periods, record.deceleration_rad_s2)
        .with_tip_offset(record.tip_margin_m);
    let mut demands = Demands::new(&robot, &settings, way.error_m());
    (demands.overlap_max_m, demands.overlaps) = (overlap_max_m, overlaps);
    demands.has_orientation = matches!(
        trajectory.orientation(0.0),
        Orientation::Axis(_) | Orientation::Full(_)
    );
    let (mut nearest_m, mut since) = (f64::INFINITY, 0);
    while since < STALL_CYCLES && way.time_s() < MOVE_MAX_S {
        demands.before.step(&mut way, &mut nmpc, period_s);
        since += 1;
        if way.error_m() < nearest_m - NEARER_M {
            (nearest_m, since) = (way.error_m(), 0);
        }
    }

    // The reference begins after the lead, wherever the robot is by then.
    let lead_s = options.lead.as_secs_f64();
    let moved: Vec<_> = known.iter().map(|one| one.moved(lead_s)).collect();
    let there = *way.configuration();
    // As the daemon does, which joins a moving reference from rest; the ideal robot has no limit of its acceleration.
    let joining = if record.acceleration_rad_s2.is_finite() {
        joining(&points, record.period_ns, robot.reach_m())
    } else {
        Approach::default()
    };
    let followed = |time_s: f64| joining.followed_sample(&at_s(time_s), (time_s * 1e9) as u64);
    let mut path = ClosedLoop::new(&robot, period_s, settings, there, &moved, followed)?
        .with_acceleration(record.acceleration_rad_s2)
        .with_stopping(valid_periods, record.deceleration_rad_s2)
        .with_tip_offset(record.tip_margin_m);
    let interrupt = Interrupt::catch()?;
    let bar = Bar::new("dry run");
    for cycle in 0..cycles as u64 {
        if interrupt.is_raised() {
            bail!("interrupted; nothing moved");
        }
        demands.along.step(&mut path, &mut nmpc, period_s);
        demands.note_self_contact(&path);
        let time_s = path.time_s().min(trajectory.duration_s());
        if joining.is_over((path.time_s() * 1e9) as u64) {
            let (point_m, clearance_m) = (trajectory.position_m(time_s), path.clearance_m());
            demands.note_error(time_s, point_m, path.error_m(), clearance_m);
        }
        bar.show_share(cycle as f64 / cycles);
    }
    let shapes = [&there, path.configuration()];
    demands.unrepeated = Unrepeated::after(trajectory, &robot, &settings, shapes);
    Ok(demands)
}

impl Motion {
    const NONE: Self = Self {
        rate_rad_s: 0.0,
        rate_share: 0.0,
        acceleration_rad_s2: 0.0,
        bend_rad: 0.0,
        bend_share: BendShare::NONE,
        stroke_m: 0.0,
        held_back: None,
        slowed: None,
        clearance_m: f64::INFINITY,
    };

    /// Simulates one period and updates the maxima.
    fn step<R: Fn(f64) -> reference::ReferenceSample>(
        &mut self,
        closed: &mut ClosedLoop<R>,
        nmpc: &mut Nmpc,
        period_s: f64,
    ) {
        let before = closed.command().rates;
        closed.step(nmpc);
        let rates = closed.command().rates;
        for (now, before) in rates.as_slice().iter().zip(before.as_slice()) {
            let acceleration = (now - before).abs() / period_s;
            self.acceleration_rad_s2 = self.acceleration_rad_s2.max(acceleration);
        }
        let sections = closed.robot().sections();
        for (pair, section) in rates.as_slice().chunks(2).zip(sections) {
            for rate in pair {
                self.rate_rad_s = self.rate_rad_s.max(rate.abs());
                self.rate_share = self.rate_share.max(rate.abs() / section.rate_max_rad_s);
            }
        }
        for j in 0..closed.robot().section_count() {
            self.bend_rad = self.bend_rad.max(closed.configuration().bend_rad(j));
        }
        let bend_share = BendShare::largest(closed.robot(), closed.configuration());
        self.bend_share = self.bend_share.larger(bend_share);
        let strokes_m = closed.robot().cable_strokes(closed.configuration());
        let largest_m = strokes_m.iter().fold(0.0_f64, |most, m| most.max(m.abs()));
        self.stroke_m = self.stroke_m.max(largest_m);
        self.held_back = HeldBack::newest(closed, largest_m);
        self.slowed = Slowed::newest(closed, &before, period_s);
        self.clearance_m = self.clearance_m.min(closed.clearance_m());
    }

    fn rate(&self) -> String {
        let share = 100.0 * self.rate_share;
        format!("{:.3} rad/s, {share:.0} %", self.rate_rad_s)
    }
}

impl Demands {
    fn new(robot: &Robot, settings: &NmpcSettings, distance_m: f64) -> Self {
        Self {
            distance_m,
            before: Motion::NONE,
            along: Motion::NONE,
            cycles: 0,
            error_sum_m: 0.0,
            error_max_m: 0.0,
            error_end_m: 0.0,
            farthest: (0.0, [0.0; 3]),
            missed_at: None,
            missed_clearance_m: f64::INFINITY,
            end_m: [0.0; 3],
            stroke_max_m: robot.cable_stroke_max_m(),
            safe_distance_m: settings.safe_distance_m,
            has_orientation: false,
            unrepeated: None,
            self_contact: None,
            overlap_max_m: 0.0,
            overlaps: false,
            may_join: false,
        }
    }

    /// Notes a body that touches itself.
    fn note_self_contact<R: Fn(f64) -> reference::ReferenceSample>(
        &mut self,
        closed: &ClosedLoop<R>,
    ) {
        let deepest_m = (self.self_contact).map_or(self.overlap_max_m, |it| it.overlap_m());
        let contact = SelfContact::find(
            closed.robot(),
            closed.configuration(),
            deepest_m,
            closed.time_s(),
        );
        self.self_contact = contact.or(self.self_contact);
    }

    fn note_error(&mut self, time_s: f64, point_m: [f64; 3], error_m: f64, clearance_m: f64) {
        self.cycles += 1;
        self.error_sum_m += error_m;
        (self.error_end_m, self.end_m) = (error_m, point_m);
        if error_m > self.error_max_m {
            (self.error_max_m, self.farthest) = (error_m, (time_s, point_m));
            (self.missed_at, self.missed_clearance_m) = (self.along.held_back, clearance_m);
        }
    }

    pub(crate) fn print(&self, name: &str) -> anyhow::Result<()> {
        write!(
            std::io::stdout(),
            "{name}: nothing moved; the ideal robot would need\n{self}"
        )?;
        Ok(())
    }

    /// Largest bend of a section \[rad\] and largest rate \[rad/s\] along the reference.
    pub(crate) fn bend_and_rate(&self) -> (f64, f64) {
        (self.along.bend_rad, self.along.rate_rad_s)
    }

    /// Fails when the body would touch itself along the reference, deeper than the daemon permits.
    pub(crate) fn check_self_contact(&self) -> anyhow::Result<()> {
        let Some(contact) = self.self_contact else {
            return Ok(());
        };
        if self.overlaps {
            bail!(
                "{contact}; the body overlaps by {:.1} mm already, more than robot.self_overlap_max_m, and may only move out: lead it out in small \
                 steps (cdcrctl jog), or set that to 2 if the body is free in truth; nothing moved",
                1e3 * self.overlap_max_m
            );
        }
        bail!(
            "{contact}: use another point or path, or begin in another shape (cdcrctl home); nothing moved"
        )
    }

    /// Fails when there is a [`miss`](Self::miss).
    pub(crate) fn check(&self, allowed_m: f64) -> anyhow::Result<()> {
        match self.miss(allowed_m) {
            Some((cause, remedy)) => bail!("{cause}: {remedy}; nothing moved"),
            None => Ok(()),
        }
    }

    /// Fails when the orientation is why a point is missed by more than `allowed_m`: the `positions` alone are reached.
    pub(crate) fn check_orientation(
        &self,
        allowed_m: f64,
        positions: impl FnOnce() -> anyhow::Result<Self>,
    ) -> anyhow::Result<()> {
        let is_missed = self.error_max_m > allowed_m;
        if is_missed && self.has_orientation && positions()?.error_max_m <= allowed_m {
            bail!(
                "position and orientation cannot both be reached: {}, though without an orientation it reaches every \
                 point: drop the orientation, or lower controller.orientation_weight; nothing moved",
                self.missed()
            );
        }
        Ok(())
    }

    /// Text for the point with the largest error.
    fn missed(&self) -> String {
        let (time_s, point_m) = self.farthest;
        format!("at {time_s:.2} s {}", away(self.error_max_m, point_m))
    }

    /// Fails when the end is missed by more than `allowed_m`.
    pub(crate) fn check_end(&self, allowed_m: f64) -> anyhow::Result<()> {
        if self.error_end_m > allowed_m {
            let Motion {
                held_back, slowed, ..
            } = self.along;
            let limit = match (held_back, slowed) {
                (Some(limit @ HeldBack::Bend(_)), _) => format!(": {limit}; {WAY_OUT}"),
                (Some(limit), _) => format!(": {limit}"),
                (None, Some(limit)) => format!(": {limit}"),
                (None, None) => String::new(),
            };
            bail!(
                "not reachable: {}{}{}; nothing moved",
                away(self.error_end_m, self.end_m),
                limit,
                self.obstruction()
            );
        }
        Ok(())
    }

    /// Names the obstacle that the motion came near.
    fn obstruction(&self) -> String {
        self.beside(self.before.clearance_m.min(self.along.clearance_m))
            .unwrap_or_default()
    }

    /// Names an obstacle at this clearance, if it is near enough to hold the robot back.
    fn beside(&self, clearance_m: f64) -> Option<String> {
        let [clearance_mm, safe_mm] = [clearance_m, self.safe_distance_m].map(|m| 1e3 * m);
        (clearance_m <= self.safe_distance_m + NEAR_M).then(|| {
            format!(
                ", beside an obstacle at {clearance_mm:.1} mm of its body, where the clearance guard keeps {safe_mm:.1} mm \
                 (cdcrctl obstacle list)"
            )
        })
    }
}

/// Text for the distance between tip and point.
pub(crate) fn away(error_m: f64, [x, y, z]: [f64; 3]) -> String {
    let error_mm = 1e3 * error_m;
    format!("the tip stays {error_mm:.1} mm away from ({x:.4}, {y:.4}, {z:.4}) m")
}

impl fmt::Display for Demands {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mean_m = self.error_sum_m / self.cycles.max(1) as f64;
        let errors_m = [mean_m, self.error_max_m, self.error_end_m];
        let [mean, max, end] = errors_m.map(|m| 1e3 * m);
        let (along, before) = (&self.along, &self.before);
        let mut line = |name: &str, along: &str, before: &str| {
            writeln!(
                f,
                "{}",
                format!("  {name:<14}{along:<26}{before}").trim_end()
            )
        };
        line("", "along the reference", "fastest way to its first point")?;
        let distance = format!("{:.1} mm from the tip", 1e3 * self.distance_m);
        line("first point", "", &distance)?;
        line("rate", &along.rate(), &before.rate())?;
        let [here, there] =
            [along, before].map(|motion| format!("{:.2} rad/s²", motion.acceleration_rad_s2));
        line("acceleration", &here, &there)?;
        let [here, there] = [along, before].map(|motion| format!("{:.3} rad", motion.bend_rad));
        line("bend", &here, &there)?;
        let most = 1e3 * self.stroke_max_m;
        let [here, there] =
            [along, before].map(|motion| format!("{:.1} mm", 1e3 * motion.stroke_m));
        line("cable stroke", &format!("{here} of {most:.1} mm"), &there)?;
        if along.clearance_m.is_finite() {
            let safe = 1e3 * self.safe_distance_m;
            let [here, there] =
                [along, before].map(|motion| format!("{:.1} mm", 1e3 * motion.clearance_m));
            line("clearance", &format!("{here}, safe {safe:.1} mm"), &there)?;
        }
        line(
            "tip error",
            &format!("mean {mean:.3}, max {max:.3}, final {end:.3} mm"),
            "",
        )?;
        if let Some(unrepeated) = self.unrepeated {
            writeln!(f, "  note: {unrepeated}")?;
        }
        if let Some(near) = along.bend_share.warning() {
            writeln!(f, "  warning: {near}")?;
        }
        if self.distance_m > JOINED_M && self.may_join {
            writeln!(f, "{NO_APPROACH}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests;
