//! Wire ↔ domain. Converting validates: what comes out of here is finite, in range and of known kind.
//!
//! The only file that knows both a wire type and its domain twin.

use cdcr_controller::estimator::Measurement;
use cdcr_controller::nmpc::{NmpcSettings, SolveReport, SolveStatus, SolverKind};
use cdcr_controller::optimizer::{Candidate, VelocityRule};
use cdcr_controller::reference::{
    Interpolation, Orientation, ReferencePoint, ReferenceSample, ReferenceState, TrajectoryError,
};
use cdcr_controller::robot::{CABLES_MAX, Configuration, Robot, quaternion_xyzw};
use cdcr_controller::safety::{LeaseState, LimitsHit, Mode, Reason, Refusal, Request};
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{self, Outcome};
use nalgebra::{Quaternion, Unit, UnitQuaternion, Vector3};

use crate::cycle::CycleRecord;
use crate::ports::TimedMeasurement;

/// Why a message was refused, and at which of its points or obstacles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refused {
    /// Why.
    pub outcome: Outcome,
    /// Index of the point or obstacle; 0 where there is none.
    pub detail: u32,
}

impl Refused {
    /// A refusal of the message as a whole.
    pub fn whole(outcome: Outcome) -> Self {
        Self { outcome, detail: 0 }
    }

    fn at(outcome: Outcome, index: usize) -> Self {
        Self {
            outcome,
            detail: index as u32,
        }
    }
}

/// Unit vectors and quaternions may be off by this much.
const UNIT_TOLERANCE: f64 = 1e-6;
/// Positions may lie this much outside the reachable ball \[m\]: rounding of the straight robot.
const REACH_TOLERANCE_M: f64 = 1e-6;
/// A driver's clock may be this far ahead \[ns\].
const CLOCK_TOLERANCE_NS: u64 = 1_000_000;

/// The points of a chunk, all checked: finite, ahead of `now_ns`, inside the reachable ball, with
/// increasing times and unit orientations.
///
/// # Errors
/// The first point that is wrong, and what is wrong with it.
pub fn reference_points<'a>(
    chunk: &'a wire::ReferenceChunk,
    robot: &Robot,
    now_ns: u64,
) -> Result<impl Iterator<Item = ReferencePoint> + Clone + 'a, Refused> {
    let interpolation = match codes::Interpolation::try_from(chunk.interpolation) {
        Ok(codes::Interpolation::Linear) => Interpolation::Linear,
        Ok(codes::Interpolation::Cubic) => Interpolation::Cubic,
        Err(_) => return Err(Refused::whole(Outcome::UnknownCode)),
    };
    let points = (1..=wire::limits::CHUNK_POINTS_MAX)
        .contains(&(chunk.count as usize))
        .then(|| &chunk.points[..chunk.count as usize])
        .ok_or(Refused::whole(Outcome::CountOutOfRange))?;
    for (index, point) in points.iter().enumerate() {
        reference_point(point, interpolation, robot.reach_m(), now_ns)
            .map_err(|outcome| Refused::at(outcome, index))?;
        if index > 0 && point.time_ns <= points[index - 1].time_ns {
            return Err(Refused::at(Outcome::TimeNotIncreasing, index));
        }
    }
    let reach_m = robot.reach_m();
    Ok(points
        .iter()
        .filter_map(move |point| reference_point(point, interpolation, reach_m, now_ns).ok()))
}

fn reference_point(
    point: &wire::ReferencePoint,
    interpolation: Interpolation,
    reach_m: f64,
    now_ns: u64,
) -> Result<ReferencePoint, Outcome> {
    let position_m = Vector3::from(point.position_m);
    if !position_m
        .iter()
        .chain(&point.orientation)
        .all(|value| value.is_finite())
    {
        return Err(Outcome::NotFinite);
    }
    if point.time_ns <= now_ns {
        return Err(Outcome::InThePast);
    }
    if position_m.norm() > reach_m + REACH_TOLERANCE_M {
        return Err(Outcome::OutOfReach);
    }
    Ok(ReferencePoint {
        time_ns: point.time_ns,
        position_m,
        orientation: orientation(point)?,
        interpolation,
    })
}

fn orientation(point: &wire::ReferencePoint) -> Result<Orientation, Outcome> {
    let [x, y, z, w] = point.orientation;
    match codes::OrientationKind::try_from(point.orientation_kind) {
        Ok(codes::OrientationKind::None) => Ok(Orientation::Free),
        Ok(codes::OrientationKind::Axis) => {
            let axis = Vector3::new(x, y, z);
            let is_unit = (axis.norm() - 1.0).abs() <= UNIT_TOLERANCE;
            let axis = is_unit.then(|| Orientation::Axis(Unit::new_normalize(axis)));
            axis.ok_or(Outcome::NotUnit)
        }
        Ok(codes::OrientationKind::Full) => {
            let rotation = Quaternion::new(w, x, y, z);
            let is_unit = (rotation.norm() - 1.0).abs() <= UNIT_TOLERANCE;
            let full =
                is_unit.then(|| Orientation::Full(UnitQuaternion::from_quaternion(rotation)));
            full.ok_or(Outcome::NotUnit)
        }
        Err(_) => Err(Outcome::UnknownCode),
    }
}

/// Why the trajectory did not take points.
pub fn trajectory_refusal(error: &TrajectoryError) -> Refused {
    match error {
        TrajectoryError::TimeNotIncreasing { index } => {
            Refused::at(Outcome::TimeNotIncreasing, *index)
        }
        TrajectoryError::Full { .. } => Refused::whole(Outcome::BufferFull),
    }
}

/// A driver's measurement, checked against the robot and the clock.
///
/// # Errors
/// What is wrong with it.
pub fn measurement(
    message: &wire::Measurement,
    robot: &Robot,
    now_ns: u64,
) -> Result<TimedMeasurement, Refused> {
    if message.sections as usize != robot.section_count() {
        return Err(Refused::whole(Outcome::WrongRobot));
    }
    if message.measured_ns > now_ns + CLOCK_TOLERANCE_NS {
        return Err(Refused::whole(Outcome::OutOfRange));
    }
    let finite = |values: &[f64]| match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(Refused::at(Outcome::NotFinite, index)),
        None => Ok(()),
    };
    let measurement = match codes::MeasurementKind::try_from(message.kind) {
        Ok(codes::MeasurementKind::Configuration) => {
            let bends = &message.bend_rad[..robot.coordinate_count()];
            finite(bends)?;
            let configuration = Configuration::from_slice(bends);
            configuration
                .map(Measurement::Configuration)
                .ok_or(Refused::whole(Outcome::WrongRobot))?
        }
        Ok(codes::MeasurementKind::CableLengths) => {
            finite(&message.cable_length_m[..robot.cable_count()])?;
            let mut lengths = [0.0; CABLES_MAX];
            lengths[..robot.cable_count()]
                .copy_from_slice(&message.cable_length_m[..robot.cable_count()]);
            Measurement::CableLengths(lengths)
        }
        Ok(codes::MeasurementKind::TipPose) => {
            finite(&message.tip_position_m)?;
            Measurement::TipPosition(Vector3::from(message.tip_position_m))
        }
        Ok(codes::MeasurementKind::None) | Err(_) => {
            return Err(Refused::whole(Outcome::UnknownCode));
        }
    };
    Ok(TimedMeasurement {
        measurement,
        measured_ns: message.measured_ns,
    })
}

/// A measurement as a cycle used it. Who sent it is not known any more, so the header is zero.
fn measurement_to_wire(timed: &TimedMeasurement, robot: &Robot) -> wire::Measurement {
    let mut message = wire::Measurement {
        measured_ns: timed.measured_ns,
        sections: robot.section_count() as u32,
        ..wire::Measurement::default()
    };
    let kind = match &timed.measurement {
        Measurement::Configuration(configuration) => {
            copy(configuration.as_slice(), &mut message.bend_rad);
            codes::MeasurementKind::Configuration
        }
        Measurement::CableLengths(lengths) => {
            message.cable_length_m = *lengths;
            codes::MeasurementKind::CableLengths
        }
        Measurement::TipPosition(position_m) => {
            message.tip_position_m = (*position_m).into();
            codes::MeasurementKind::TipPose
        }
    };
    message.kind = kind.code();
    message
}

/// The request of a client that concerns the mode; none for those about lease and settings.
pub fn mode_request(kind: codes::RequestKind) -> Option<Request> {
    match kind {
        codes::RequestKind::Track => Some(Request::Track),
        codes::RequestKind::Hold => Some(Request::Hold),
        codes::RequestKind::Home => Some(Request::Home),
        codes::RequestKind::Stop => Some(Request::Stop),
        codes::RequestKind::Reset => Some(Request::Reset),
        codes::RequestKind::AcquireLease
        | codes::RequestKind::ReleaseLease
        | codes::RequestKind::Settings => None,
    }
}

/// A refusal of the mode machine.
pub fn refusal(refusal: Refusal) -> Outcome {
    match refusal {
        Refusal::WrongMode => Outcome::WrongMode,
        Refusal::NoLease => Outcome::NoLease,
        Refusal::NoReference => Outcome::NoReference,
        Refusal::CauseStands => Outcome::CauseStands,
    }
}

/// The mode.
pub fn mode(mode: Mode) -> codes::Mode {
    match mode {
        Mode::Starting => codes::Mode::Starting,
        Mode::Holding { .. } => codes::Mode::Holding,
        Mode::Tracking { .. } => codes::Mode::Tracking,
        Mode::Homing => codes::Mode::Homing,
        Mode::Stopped { .. } => codes::Mode::Stopped,
        Mode::Faulted { .. } => codes::Mode::Faulted,
    }
}

/// Why a mode.
pub fn reason(reason: Reason) -> codes::Reason {
    match reason {
        Reason::Start => codes::Reason::Start,
        Reason::Request => codes::Reason::Request,
        Reason::ReferenceEnded => codes::Reason::ReferenceEnded,
        Reason::LeaseExpired => codes::Reason::LeaseExpired,
        Reason::HomeReached => codes::Reason::HomeReached,
        Reason::DeadlineMisses => codes::Reason::DeadlineMisses,
        Reason::MeasurementLost => codes::Reason::MeasurementLost,
        Reason::NonFinite => codes::Reason::NonFinite,
        Reason::LimitBroken => codes::Reason::LimitBroken,
        Reason::Shutdown => codes::Reason::Shutdown,
        Reason::LeaseReleased => codes::Reason::LeaseReleased,
    }
}

/// Settings on the wire. Fields of functions that this build does not have are zero.
pub fn settings_to_wire(settings: &NmpcSettings, budget_ns: u64) -> wire::SolverSettings {
    wire::SolverSettings {
        solver: match settings.solver {
            SolverKind::Kpso => codes::SolverKind::Kpso,
            SolverKind::GaussNewton => codes::SolverKind::GaussNewton,
            SolverKind::KpsoRefined => codes::SolverKind::KpsoRefined,
        }
        .code(),
        coordinates: codes::Coordinates::BendVector.code(),
        horizon_steps: settings.horizon_steps,
        control_blocks: settings.control_blocks,
        swarm_size: settings.swarm_size,
        swarm_iterations: settings.swarm_iterations,
        regenerate_after: settings.regenerate_after,
        velocity_rule: match settings.velocity_rule {
            VelocityRule::Inertia => codes::VelocityRule::Inertia,
            VelocityRule::Constriction => codes::VelocityRule::Constriction,
            VelocityRule::Verbatim => codes::VelocityRule::Verbatim,
        }
        .code(),
        refinement_steps: settings.refinement_steps,
        inertia: settings.inertia,
        cognitive: settings.cognitive,
        social: settings.social,
        damping: settings.damping,
        position_weight: settings.position_weight,
        rate_weight: settings.rate_weight,
        rate_change_weight: settings.rate_change_weight,
        terminal_weight: settings.terminal_weight,
        budget_ns,
        seed: settings.seed,
        ..wire::SolverSettings::default()
    }
}

/// Settings from the wire, checked. What this build does not have is refused, never ignored.
///
/// # Errors
/// `Unsupported`, `UnknownCode` or `OutOfRange`.
pub fn settings_from_wire(message: &wire::SolverSettings) -> Result<NmpcSettings, Outcome> {
    let unused = [
        message.orientation_weight,
        message.orientation_tolerance_rad,
        message.safe_distance_m,
        message.obstacle_step_penalty,
        message.obstacle_slope_penalty,
    ];
    let asks_for_more = message.coordinates != codes::Coordinates::BendVector.code()
        || message.budget_ns != 0
        || unused.iter().any(|value| *value != 0.0);
    if asks_for_more {
        return Err(Outcome::Unsupported);
    }
    let unknown = |_| Outcome::UnknownCode;
    let settings = NmpcSettings {
        solver: match codes::SolverKind::try_from(message.solver).map_err(unknown)? {
            codes::SolverKind::Kpso => SolverKind::Kpso,
            codes::SolverKind::GaussNewton => SolverKind::GaussNewton,
            codes::SolverKind::KpsoRefined => SolverKind::KpsoRefined,
        },
        horizon_steps: message.horizon_steps,
        control_blocks: message.control_blocks,
        swarm_size: message.swarm_size,
        swarm_iterations: message.swarm_iterations,
        regenerate_after: message.regenerate_after,
        velocity_rule: match codes::VelocityRule::try_from(message.velocity_rule)
            .map_err(unknown)?
        {
            codes::VelocityRule::Inertia => VelocityRule::Inertia,
            codes::VelocityRule::Constriction => VelocityRule::Constriction,
            codes::VelocityRule::Verbatim => VelocityRule::Verbatim,
        },
        inertia: message.inertia,
        cognitive: message.cognitive,
        social: message.social,
        refinement_steps: message.refinement_steps,
        damping: message.damping,
        position_weight: message.position_weight,
        rate_weight: message.rate_weight,
        rate_change_weight: message.rate_change_weight,
        terminal_weight: message.terminal_weight,
        seed: message.seed,
    };
    settings.validate().map_err(|_| Outcome::OutOfRange)?;
    Ok(settings)
}

/// The robot on the wire.
pub fn robot(robot: &Robot) -> wire::RobotDescription {
    let mut description = wire::RobotDescription {
        sections: robot.section_count() as u32,
        fingerprint: robot.fingerprint(),
        cable_speed_max_m_s: robot.cable_speed_max_m_s(),
        ..wire::RobotDescription::default()
    };
    for (target, section) in description.section.iter_mut().zip(robot.sections()) {
        *target = wire::SectionDescription {
            length_m: section.length_m,
            cable_radius_m: section.cable_radius_m,
            cable_offset_rad: section.cable_offset_rad,
            bend_max_rad: section.bend_max_rad,
            rate_max_rad_s: section.rate_max_rad_s,
            body_radius_m: section.body_radius_m,
        };
    }
    description
}

/// The command of a cycle.
pub fn command(
    record: &CycleRecord,
    robot: &Robot,
    period_ns: u64,
    valid_for_ns: u64,
) -> wire::Command {
    let target = record
        .configuration
        .advanced(&record.rates, period_ns as f64 * 1e-9);
    let mut command = wire::Command {
        cycle: record.release.cycle,
        release_ns: record.release.release_ns,
        valid_for_ns,
        mode: mode(record.mode).code(),
        sections: robot.section_count() as u32,
        cable_length_m: robot.cable_lengths(target.as_slice()),
        cable_speed_m_s: robot.cable_speeds(record.rates.as_slice()),
        ..wire::Command::default()
    };
    copy(record.rates.as_slice(), &mut command.bend_rate_rad_s);
    copy(target.as_slice(), &mut command.bend_target_rad);
    command
}

/// The telemetry of a cycle, all but what the exchange adds: header, events and command.
pub fn telemetry(record: &CycleRecord, robot: &Robot, period_ns: u64) -> wire::Telemetry {
    let reference_known = record.reference.state != ReferenceState::None;
    let error_m = (record.tip.position_m - record.reference.position_m).norm();
    let mut telemetry = wire::Telemetry {
        cycle: record.release.cycle,
        release_ns: record.release.release_ns,
        due_ns: record.release.due_ns,
        start_ns: record.release.start_ns,
        solve_start_ns: record.solve_start_ns,
        solve_end_ns: record.solve_end_ns,
        handed_over_ns: record.handed_over_ns,
        period_ns,
        elapsed_ns: record.elapsed_ns,
        skipped_periods: record.release.skipped,
        timing_flags: timing_flags(record),
        deadline_misses_total: record.totals.deadline_misses,
        skipped_periods_total: record.totals.skipped_periods,
        mode: mode(record.mode).code(),
        reason: reason(record.mode.reason()).code(),
        miss_bucket: record.miss_bucket,
        gather: record.gather,
        gather_ns: record.gather_ns,
        settings: settings_to_wire(&record.settings, 0),
        robot: self::robot(robot),
        window_first_cycle: record.window_first_cycle,
        lease_state: match record.lease {
            LeaseState::Free => codes::LeaseState::Free,
            LeaseState::Held => codes::LeaseState::Held,
            LeaseState::Expired => codes::LeaseState::Expired,
        }
        .code(),
        deceleration_rad_s2: record.policy.deceleration_rad_s2,
        home_rate_rad_s: record.policy.home_rate_rad_s,
        deadline_ns: record.policy.deadline_ns,
        late_start_ns: record.policy.late_start_ns,
        measurement_timeout_ns: record.policy.measurement_timeout_ns,
        miss_limit: record.policy.miss_limit,
        plan_length: record.plan_length as u32,
        warm_plan: record.warm_plan,
        plan: record.plan,
        report: report(&record.report),
        reference: reference(&record.reference),
        tip_position_m: record.tip.position_m.into(),
        tip_orientation: quaternion_xyzw(&record.tip.rotation),
        position_error_m: if reference_known { error_m } else { f64::NAN },
        guard_flags: guard_flags(record.limits_hit),
        ..wire::Telemetry::default()
    };
    if let Some(timed) = &record.measurement {
        telemetry.measurement = measurement_to_wire(timed, robot);
    }
    copy(record.configuration.as_slice(), &mut telemetry.bend_rad);
    copy(
        record.previous_rates.as_slice(),
        &mut telemetry.previous_rate_rad_s,
    );
    telemetry
}

fn copy(from: &[f64], to: &mut [f64]) {
    to[..from.len()].copy_from_slice(from);
}

fn timing_flags(record: &CycleRecord) -> u32 {
    let late = if record.verdict.late_start {
        codes::timing::LATE_START
    } else {
        0
    };
    let miss = if record.verdict.deadline_miss {
        codes::timing::DEADLINE_MISS
    } else {
        0
    };
    late | miss
}

fn guard_flags(hit: LimitsHit) -> u32 {
    let bits = [
        (hit.rate, codes::guard::RATE),
        (hit.bend, codes::guard::BEND),
        (hit.cable_speed, codes::guard::CABLE_SPEED),
        (hit.non_finite, codes::guard::NON_FINITE),
    ];
    bits.iter()
        .filter(|(set, _)| *set)
        .fold(0, |flags, (_, bit)| flags | bit)
}

fn report(report: &SolveReport) -> wire::SolverReport {
    wire::SolverReport {
        cost: report.cost,
        warm_cost: report.warm_cost,
        gradient_norm: report.gradient_norm,
        seed: report.seed,
        evaluations: report.evaluations,
        quanta: report.quanta,
        iterations: report.iterations,
        refinements: report.refinements,
        status: match report.status {
            SolveStatus::Idle => codes::SolverStatus::Idle,
            SolveStatus::Converged => codes::SolverStatus::Converged,
            SolveStatus::BudgetSpent => codes::SolverStatus::BudgetSpent,
            SolveStatus::IterationsSpent => codes::SolverStatus::IterationsSpent,
            SolveStatus::NonFinite => codes::SolverStatus::NonFinite,
        }
        .code(),
        winner: match report.winner {
            Candidate::WarmStart => codes::Winner::WarmStart,
            Candidate::Previous => codes::Winner::Previous,
            Candidate::Zero => codes::Winner::Zero,
            Candidate::LeastSquares => codes::Winner::LeastSquares,
            Candidate::Swarm => codes::Winner::Swarm,
        }
        .code(),
    }
}

fn reference(sample: &ReferenceSample) -> wire::ReferenceSample {
    let (orientation, kind) = match sample.orientation {
        Orientation::Free => ([0.0; 4], codes::OrientationKind::None),
        Orientation::Axis(axis) => ([axis.x, axis.y, axis.z, 0.0], codes::OrientationKind::Axis),
        Orientation::Full(full) => (full.coords.into(), codes::OrientationKind::Full),
    };
    wire::ReferenceSample {
        position_m: sample.position_m.into(),
        orientation,
        orientation_kind: kind.code(),
        state: match sample.state {
            ReferenceState::None => codes::ReferenceState::None,
            ReferenceState::Before => codes::ReferenceState::Before,
            ReferenceState::Inside => codes::ReferenceState::Inside,
            ReferenceState::Ended => codes::ReferenceState::Ended,
        }
        .code(),
    }
}

/// Text in a fixed field, cut at a character's border.
pub fn text(text: &str) -> [u8; wire::limits::TEXT_BYTES] {
    let mut bytes = [0; wire::limits::TEXT_BYTES];
    let end = (0..=text.len().min(bytes.len()))
        .rev()
        .find(|&end| text.is_char_boundary(end));
    let end = end.unwrap_or(0);
    bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
    bytes
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::RobotParameters;

    use super::*;

    fn trunk() -> Robot {
        Robot::new(&RobotParameters::paper(1)).unwrap()
    }

    fn chunk(points: &[wire::ReferencePoint]) -> wire::ReferenceChunk {
        let mut chunk = wire::ReferenceChunk {
            count: points.len() as u32,
            ..Default::default()
        };
        chunk.points[..points.len()].copy_from_slice(points);
        chunk
    }

    fn point(time_ns: u64, position_m: [f64; 3]) -> wire::ReferencePoint {
        wire::ReferencePoint {
            time_ns,
            position_m,
            ..Default::default()
        }
    }

    fn refusal_of(chunk: &wire::ReferenceChunk) -> (Outcome, u32) {
        let refused = reference_points(chunk, &trunk(), 100)
            .err()
            .expect("it is wrong");
        (refused.outcome, refused.detail)
    }

    #[test]
    fn every_kind_of_bad_point_is_refused_with_its_place() {
        let good = point(200, [0.0, 0.0, 0.3]);
        assert_eq!(
            reference_points(&chunk(&[good]), &trunk(), 100)
                .ok()
                .map(Iterator::count),
            Some(1)
        );
        let nan = point(300, [f64::NAN, 0.0, 0.0]);
        assert_eq!(refusal_of(&chunk(&[good, nan])), (Outcome::NotFinite, 1));
        assert_eq!(
            refusal_of(&chunk(&[point(100, [0.0; 3])])),
            (Outcome::InThePast, 0)
        );
        assert_eq!(
            refusal_of(&chunk(&[good, point(300, [0.0, 0.2, 0.3])])),
            (Outcome::OutOfReach, 1)
        );
        assert_eq!(
            refusal_of(&chunk(&[good, good])),
            (Outcome::TimeNotIncreasing, 1)
        );
        assert_eq!(refusal_of(&chunk(&[])), (Outcome::CountOutOfRange, 0));
        let many = wire::ReferenceChunk {
            count: 129,
            ..Default::default()
        };
        assert_eq!(refusal_of(&many), (Outcome::CountOutOfRange, 0));
        let odd = wire::ReferenceChunk {
            interpolation: 9,
            ..chunk(&[good])
        };
        assert_eq!(refusal_of(&odd), (Outcome::UnknownCode, 0));
        let axis = wire::ReferencePoint {
            orientation_kind: codes::OrientationKind::Axis.code(),
            orientation: [0.0, 0.0, 0.5, 0.0],
            ..good
        };
        assert_eq!(refusal_of(&chunk(&[axis])), (Outcome::NotUnit, 0));
        let unknown = wire::ReferencePoint {
            orientation_kind: 7,
            ..good
        };
        assert_eq!(refusal_of(&chunk(&[unknown])), (Outcome::UnknownCode, 0));
    }

    #[test]
    fn settings_round_trip_and_unsupported_ones_are_refused() {
        let settings = NmpcSettings {
            solver: SolverKind::Kpso,
            seed: 99,
            ..Default::default()
        };
        assert_eq!(
            settings_from_wire(&settings_to_wire(&settings, 0)),
            Ok(settings)
        );
        let with = |change: fn(&mut wire::SolverSettings)| {
            let mut message = settings_to_wire(&NmpcSettings::default(), 0);
            change(&mut message);
            settings_from_wire(&message)
        };
        assert_eq!(
            with(|m| m.orientation_weight = 1.0),
            Err(Outcome::Unsupported)
        );
        assert_eq!(
            with(|m| m.safe_distance_m = f64::NAN),
            Err(Outcome::Unsupported)
        );
        assert_eq!(with(|m| m.solver = 77), Err(Outcome::UnknownCode));
        assert_eq!(with(|m| m.swarm_size = 0), Err(Outcome::OutOfRange));
        assert_eq!(with(|m| m.inertia = f64::NAN), Err(Outcome::OutOfRange));
    }

    #[test]
    fn measurements_are_checked_against_robot_and_clock() {
        let good = wire::Measurement {
            kind: codes::MeasurementKind::Configuration.code(),
            sections: 1,
            measured_ns: 90,
            ..Default::default()
        };
        let outcome =
            |message| measurement(&message, &trunk(), 100).map_err(|refused| refused.outcome);
        assert!(outcome(good).is_ok());
        assert_eq!(
            outcome(wire::Measurement {
                sections: 2,
                ..good
            }),
            Err(Outcome::WrongRobot)
        );
        let future = wire::Measurement {
            measured_ns: 10_000_000,
            ..good
        };
        assert_eq!(outcome(future), Err(Outcome::OutOfRange));
        let mut nan = good;
        nan.bend_rad[1] = f64::INFINITY;
        assert_eq!(outcome(nan), Err(Outcome::NotFinite));
        assert_eq!(
            outcome(wire::Measurement { kind: 0, ..good }),
            Err(Outcome::UnknownCode)
        );
    }

    #[test]
    fn measurements_round_trip() {
        let configuration = Configuration::from_slice(&[0.1, -0.2]).unwrap();
        let lengths = trunk().cable_lengths(configuration.as_slice());
        for measurement_in in [
            Measurement::Configuration(configuration),
            Measurement::CableLengths(lengths),
            Measurement::TipPosition(Vector3::new(0.1, 0.2, 0.3)),
        ] {
            let timed = TimedMeasurement {
                measurement: measurement_in,
                measured_ns: 90,
            };
            let message = measurement_to_wire(&timed, &trunk());
            assert_eq!(measurement(&message, &trunk(), 100), Ok(timed));
        }
    }

    #[test]
    fn text_is_cut_at_a_character() {
        let long = "ä".repeat(40);
        let cut = text(&long);
        assert_eq!(std::str::from_utf8(&cut[..48]), Ok("ä".repeat(24).as_str()));
        assert_eq!(&text("abc")[..4], b"abc\0");
    }
}
