//! What a reference would ask of the robot, computed before anything moves.
//!
//! The closed loop of the controller, with the daemon's robot where it is now, its obstacles, safe distance and acceleration, and the solver's
//! default settings. The robot is the ideal one: what it cannot reach, no robot of this model can.

use std::fmt;
use std::io::Write;
use std::time::Duration;

use anyhow::{Context, bail};
use cdcr_client::model::{obstacle_of, orientation_of, robot_of};
use cdcr_client::{Connection, Trajectory, obstacles};
use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{Configuration, Obstacle, Robot};

/// The way to the first point may take so long \[s\].
const WAY_MAX_S: f64 = 30.0;
/// A tip that comes no nearer than by this in [`PATIENT_CYCLES`] has arrived \[m\].
const NEARER_M: f64 = 1e-6;
const PATIENT_CYCLES: u32 = 100;
/// How long a record is waited for.
const TIMEOUT: Duration = Duration::from_secs(1);

/// The largest values along a path.
#[derive(Debug, Clone, PartialEq)]
struct Demands {
    /// From the tip now to the first point \[m\].
    distance_m: f64,
    cycles: u64,
    error_sum_m: f64,
    error_max_m: f64,
    error_end_m: f64,
    /// Time \[s\], point \[m\] and error \[m\] of the first point that is missed by more than allowed.
    first_missed: Option<(f64, [f64; 3], f64)>,
    rate_rad_s: f64,
    /// The largest part of its limit that a rate takes.
    rate_share: f64,
    acceleration_rad_s2: f64,
    stroke_m: f64,
    stroke_max_m: f64,
    clearance_m: f64,
    safe_distance_m: f64,
}

/// Computes `trajectory` with the daemon's robot, prints what it asks for, and fails where a point is missed by more than
/// `allowed_m`.
pub(crate) fn run(
    connection: &Connection,
    trajectory: &dyn Trajectory,
    allowed_m: f64,
) -> anyhow::Result<()> {
    let demands = demands(connection, trajectory, allowed_m)?;
    write!(std::io::stdout(), "{}: {demands}", trajectory.name())?;
    demands.check()
}

/// Fails where `trajectory` cannot be reached: a point is missed by more than `allowed_m`.
pub(crate) fn check(
    connection: &Connection,
    trajectory: &dyn Trajectory,
    allowed_m: f64,
) -> anyhow::Result<()> {
    demands(connection, trajectory, allowed_m)?.check()
}

fn demands(
    connection: &Connection,
    trajectory: &dyn Trajectory,
    allowed_m: f64,
) -> anyhow::Result<Demands> {
    let record = connection.telemetry()?.next_within(TIMEOUT)?;
    let record = &record.context("no telemetry within 1 s, so where the robot is is not known")?;
    let robot = robot_of(&record.robot)?;
    let width = robot.coordinate_count();
    let here = Configuration::from_slice(&record.bend_rad[..width])
        .context("the daemon does not know where the robot is")?;
    let settings = NmpcSettings {
        safe_distance_m: record.settings.safe_distance_m,
        orientation_weight: record.settings.orientation_weight,
        ..NmpcSettings::default()
    };
    let period_s = record.period_ns as f64 * 1e-9;
    let known: Vec<Obstacle> = obstacles(record).iter().filter_map(obstacle_of).collect();
    let mut nmpc = Nmpc::new(robot.clone(), period_s, settings)?;
    let acceleration = record.acceleration_rad_s2;
    let closed_loop = |start, obstacles: &[Obstacle], from_s: Option<f64>| {
        let reference_at =
            move |time_s: f64| sample(trajectory, from_s.map_or(0.0, |from_s| from_s + time_s));
        ClosedLoop::new(&robot, period_s, settings, start, obstacles, reference_at)
            .with_acceleration(acceleration)
    };

    let mut way = closed_loop(here, &known, None);
    let distance_m = way.error_m();
    let (mut best_m, mut since) = (f64::INFINITY, 0);
    while since < PATIENT_CYCLES && way.time_s() < WAY_MAX_S {
        way.step(&mut nmpc);
        since += 1;
        if way.error_m() < best_m - NEARER_M {
            (best_m, since) = (way.error_m(), 0);
        }
    }

    let moved: Vec<_> = known.iter().map(|one| one.moved(way.time_s())).collect();
    let mut path = closed_loop(*way.configuration(), &moved, Some(0.0));
    let mut demands = Demands::new(&robot, &settings, distance_m);
    let end = (trajectory.duration_s() / period_s).ceil() as u64;
    for _ in 0..end {
        let before = path.command().rates;
        path.step(&mut nmpc);
        let changes = path
            .command()
            .rates
            .as_slice()
            .iter()
            .zip(before.as_slice());
        demands.rates(&robot, path.command().rates.as_slice());
        let fastest = changes.map(|(now, before)| (now - before).abs() / period_s);
        demands.acceleration_rad_s2 = fastest.fold(demands.acceleration_rad_s2, f64::max);
        let strokes = robot.cable_strokes(path.configuration());
        demands.stroke_m = strokes
            .iter()
            .fold(demands.stroke_m, |most, s| most.max(s.abs()));
        demands.clearance_m = demands.clearance_m.min(path.clearance_m());
        let time_s = path.time_s().min(trajectory.duration_s());
        demands.error(time_s, trajectory, path.error_m(), allowed_m);
    }
    Ok(demands)
}

fn sample(trajectory: &dyn Trajectory, time_s: f64) -> ReferenceSample {
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m: trajectory.position_m(time_s).into(),
        orientation: orientation_of(trajectory.orientation(time_s)),
    }
}

impl Demands {
    fn new(robot: &Robot, settings: &NmpcSettings, distance_m: f64) -> Self {
        Self {
            distance_m,
            cycles: 0,
            error_sum_m: 0.0,
            error_max_m: 0.0,
            error_end_m: 0.0,
            first_missed: None,
            rate_rad_s: 0.0,
            rate_share: 0.0,
            acceleration_rad_s2: 0.0,
            stroke_m: 0.0,
            stroke_max_m: robot.cable_stroke_max_m(),
            clearance_m: f64::INFINITY,
            safe_distance_m: settings.safe_distance_m,
        }
    }

    fn check(&self) -> anyhow::Result<()> {
        if let Some((time_s, [x, y, z], error_m)) = self.first_missed {
            bail!(
                "not reachable: at {time_s:.2} s the tip stays {:.1} mm away from ({x:.4}, {y:.4}, {z:.4}) m; nothing moved",
                1e3 * error_m
            );
        }
        Ok(())
    }

    fn rates(&mut self, robot: &Robot, rates: &[f64]) {
        for (pair, section) in rates.chunks(2).zip(robot.sections()) {
            for rate in pair {
                self.rate_rad_s = self.rate_rad_s.max(rate.abs());
                self.rate_share = self.rate_share.max(rate.abs() / section.rate_max_rad_s);
            }
        }
    }

    fn error(&mut self, time_s: f64, trajectory: &dyn Trajectory, error_m: f64, allowed_m: f64) {
        self.cycles += 1;
        self.error_sum_m += error_m;
        self.error_max_m = self.error_max_m.max(error_m);
        self.error_end_m = error_m;
        if error_m > allowed_m && self.first_missed.is_none() {
            self.first_missed = Some((time_s, trajectory.position_m(time_s), error_m));
        }
    }
}

impl fmt::Display for Demands {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mean_m = self.error_sum_m / self.cycles.max(1) as f64;
        let [distance, mean, max, end, stroke, most] = [
            self.distance_m,
            mean_m,
            self.error_max_m,
            self.error_end_m,
            self.stroke_m,
            self.stroke_max_m,
        ]
        .map(|m| 1e3 * m);
        writeln!(f, "nothing moved; the ideal robot would need")?;
        writeln!(f, "  first point   {distance:.1} mm from the tip")?;
        writeln!(
            f,
            "  tip error     mean {mean:.3}, max {max:.3}, final {end:.3} mm on the path"
        )?;
        writeln!(
            f,
            "  rate          {:.3} rad/s, {:.0} % of its limit",
            self.rate_rad_s,
            100.0 * self.rate_share
        )?;
        writeln!(f, "  acceleration  {:.2} rad/s²", self.acceleration_rad_s2)?;
        writeln!(f, "  cable stroke  {stroke:.1} of {most:.1} mm")?;
        if self.clearance_m.is_finite() {
            let [clearance, safe] = [self.clearance_m, self.safe_distance_m].map(|m| 1e3 * m);
            writeln!(
                f,
                "  clearance     {clearance:.1} mm, safe distance {safe:.1} mm"
            )?;
        }
        Ok(())
    }
}
