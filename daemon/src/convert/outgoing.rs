//! Domain → wire: messages about the daemon and its cycles, and commands to the robot.

use cdcr_controller::estimator::Measurement;
use cdcr_controller::nmpc::{SolveReport, SolveStatus};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::{CABLES_MAX, Configuration, Robot, quaternion_xyzw};
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{self, LateCause};
use cdcr_shared_types::model;
use nalgebra::Vector3;

use super::settings::settings_to_wire;
use crate::handover::{CycleRecord, TimedMeasurement};
use crate::obstacles::KnownObstacle;
use crate::rt::attribution::Scheduling;

pub fn command(record: &CycleRecord, robot: &Robot, period_ns: u64) -> wire::Command {
    let target = record
        .commanded
        .advanced(&record.rates, period_ns as f64 * 1e-9);
    let mut command = wire::Command {
        cycle: record.release.cycle,
        release_ns: record.release.release_ns,
        target_ns: record.release.release_ns + period_ns,
        valid_until_ns: record.release.release_ns + record.policy.command_valid_ns,
        interface: codes::Interface::from(record.policy.interface).code(),
        mode: codes::Mode::from(record.mode).code(),
        sections: robot.section_count() as u32,
        cable_length_m: robot.cable_lengths(&target),
        cable_speed_m_s: robot.cable_speeds(&record.rates),
        ..wire::Command::default()
    };
    copy(record.rates.as_slice(), &mut command.bend_rate_rad_s);
    copy(target.as_slice(), &mut command.bend_target_rad);
    command
}

/// The telemetry of a cycle without the reporter's parts: header, command, scheduling and events.
pub fn telemetry(record: &CycleRecord, robot: &Robot, period_ns: u64) -> wire::Telemetry {
    let mut telemetry = wire::Telemetry::default();
    fill_telemetry(&mut telemetry, record, robot, period_ns);
    telemetry
}

/// Assigns all fields of a reused telemetry message, except those written otherwise by [`fill_telemetry`] or
/// the reporter. A forgotten field, which would keep data of an earlier cycle, does not compile.
macro_rules! assign_all {
    ($telemetry:ident, $($field:ident = $value:expr),* $(,)?) => {
        let wire::Telemetry {
            header: _, command: _, scheduling: _, events: _, event_count: _, // in the reporter
            obstacles: _, bend_rad: _, commanded_rad: _, present_rad: _, delayed_rad: _, motor_rad: _, way_rad: _, previous_rate_rad_s: _,
            warm_plan: _, plan: _,
            $($field: _,)*
        } = $telemetry;
        $($telemetry.$field = $value;)*
    };
}

/// The arrays of which a cycle uses a part: what the cycle before used of them, and this one does not, is cleared.
fn fill_arrays(telemetry: &mut wire::Telemetry, record: &CycleRecord) {
    let left_over = telemetry.obstacles[..telemetry.obstacle_count as usize].iter_mut();
    for gone in left_over.skip(record.obstacles.count()) {
        *gone = wire::Obstacle::default();
    }
    for (target, known) in telemetry.obstacles.iter_mut().zip(record.obstacles.iter()) {
        *target = obstacle_to_wire(known);
    }
    // Plans have room for the longest horizon, of which few cycles use more than a part.
    let length = record.plan_length;
    let left_over = length..length.max(telemetry.plan_length as usize);
    for (from, to) in [
        (&record.warm_plan, &mut telemetry.warm_plan),
        (&record.plan, &mut telemetry.plan),
    ] {
        copy(&from[..length], to);
        to[left_over.clone()].fill(0.0);
    }
    let way = record.way.unwrap_or(Configuration::straight(
        record.configuration.section_count(),
    ));
    for (from, to) in [
        (&way, &mut telemetry.way_rad),
        (&record.configuration, &mut telemetry.bend_rad),
        (&record.commanded, &mut telemetry.commanded_rad),
        (&record.present, &mut telemetry.present_rad),
        (&record.delayed, &mut telemetry.delayed_rad),
        (&record.motors, &mut telemetry.motor_rad),
    ] {
        copy(from.as_slice(), to);
    }
    copy(
        record.previous_rates.as_slice(),
        &mut telemetry.previous_rate_rad_s,
    );
}

/// Same as [`telemetry`] in a message that held another cycle of `robot`, or none: fields common to both are
/// not written again.
pub fn fill_telemetry(
    telemetry: &mut wire::Telemetry,
    record: &CycleRecord,
    robot: &Robot,
    period_ns: u64,
) {
    fill_arrays(telemetry, record);
    let mut measurement = wire::Measurement::default();
    if let Some(timed) = &record.measurement {
        measurement = measurement_to_wire(timed, robot);
        measurement.interface = codes::Interface::from(record.policy.interface).code();
    }
    let (tip_measured_m, tip_measured_ns) = match &record.tip_measurement {
        Some(TimedMeasurement {
            measurement: Measurement::TipPosition(position_m),
            measured_ns,
            ..
        }) => ((*position_m).into(), *measured_ns),
        _ => ([0.0; 3], 0),
    };
    assign_all!(
        telemetry,
        cycle = record.release.cycle,
        release_ns = record.release.release_ns,
        due_ns = record.release.due_ns,
        start_ns = record.release.start_ns,
        solve_start_ns = record.solve_start_ns,
        solve_end_ns = record.solve_end_ns,
        handed_over_ns = record.handed_over_ns,
        period_ns = period_ns,
        elapsed_ns = record.elapsed_ns,
        skipped_periods = record.release.skipped,
        timing_flags = timing_flags(record),
        deadline_misses_total = record.totals.deadline_misses,
        skipped_periods_total = record.totals.skipped_periods,
        mode = codes::Mode::from(record.mode).code(),
        reason = codes::Reason::from(record.mode.reason()).code(),
        miss_bucket = record.miss_bucket,
        gather = record.gather,
        gather_ns = record.gather_ns,
        settings = settings_to_wire(&record.settings),
        robot = robot.into(),
        window_first_cycle = record.window_first_cycle,
        lease_state = codes::LeaseState::from(record.lease).code(),
        lease_number = record.lease_number,
        deceleration_rad_s2 = record.policy.deceleration_rad_s2,
        home_rate_rad_s = record.policy.home_rate_rad_s,
        deadline_ns = record.policy.deadline_ns,
        late_start_ns = record.policy.late_start_ns,
        measurement_timeout_ns = record.policy.measurement_timeout_ns,
        clearance_fault_m = record.policy.clearance_fault_m,
        measurement_jump_rad = record.policy.plausibility.jump_rad,
        measurement_frozen_rad = record.policy.plausibility.frozen_rad,
        measurement_jump_limit = record.policy.plausibility.jump_limit,
        measurement_state = codes::MeasurementState::from(record.measurement_use).code(),
        tip_state = codes::MeasurementState::from(record.tip_use).code(),
        tip_offset_m = record.tip_offset_m.into(),
        tip_margin_m = record.tip_margin_m,
        tip_contradiction_m = record.seen.tip_contradiction_m,
        miss_limit = record.policy.miss_limit,
        plan_length = record.plan_length as u32,
        report = report(&record.report),
        reference = reference(&record.reference),
        approach = (&record.approach).into(),
        tip_position_m = record.tip.position_m.into(),
        tip_orientation = quaternion_xyzw(&record.tip.rotation),
        position_error_m = position_error_m(record),
        guard_flags = model::guard_flags(&record.limits_hit, record.clearance_hit),
        clearance_m = record.clearance_m,
        following_error_rad = record.following.bend_rad,
        following_error_m = record.following.cable_m,
        following_warning_rad = record.policy.following.warning_rad,
        following_fault_rad = record.policy.following.fault_rad,
        following_lag_ns = (record.policy.following.lag_s * 1e9) as u64,
        acceleration_rad_s2 = record.policy.acceleration_rad_s2,
        reference_lead_ns = record.policy.reference_lead_ns,
        motor_time_constant_ns = record.policy.motor_time_constant_ns(),
        play_m = record.policy.actuator.play_m,
        slack_m = record
            .slack
            .map_or([0.0; CABLES_MAX], |slack| *slack.slack_m()),
        approach_distance_m = record.policy.approach_distance_m,
        pace_m_s = record.pace_m_s,
        control_begins = u32::from(record.control_begins),
        moves_to_begin = u32::from(record.way.is_some()),
        ran_out_in_solve = u32::from(record.ran_out_in_solve),
        pose_differs = u32::from(record.seen.pose_differs),
        measurement_rejected = u32::from(record.seen.measurement_rejected),
        reference_too_far = u32::from(record.seen.too_far),
        tip_cause = record
            .tip_unused
            .map_or(codes::TipCause::None, Into::into)
            .code(),
        obstacle_count = record.obstacles.count() as u32,
        measurement = measurement,
        tip_measured_m = tip_measured_m,
        tip_measured_ns = tip_measured_ns,
    );
}

/// Distance of tip and reference \[m\]; NaN without a reference.
pub fn position_error_m(record: &CycleRecord) -> f64 {
    (record.tip.position_m - reference_position_m(record)).norm()
}

/// Position of the reference at the release \[m\]; NaN without one.
pub fn reference_position_m(record: &CycleRecord) -> Vector3<f64> {
    match record.reference.state {
        ReferenceState::None => Vector3::repeat(f64::NAN),
        _ => record.reference.position_m,
    }
}

/// A measurement as a cycle used it. Its sender is no longer known, so the header is zero.
pub(super) fn measurement_to_wire(timed: &TimedMeasurement, robot: &Robot) -> wire::Measurement {
    let mut message = wire::Measurement {
        measured_ns: timed.measured_ns,
        rested_from_ns: timed.rested_ns[0],
        rested_until_ns: timed.rested_ns[1],
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

/// An obstacle at the time of its stamp.
pub(super) fn obstacle_to_wire(known: &KnownObstacle) -> wire::Obstacle {
    wire::Obstacle {
        id: known.id,
        measured_ns: known.measured_ns,
        lifetime_ns: known
            .expires_ns
            .map_or(0, |expires_ns| expires_ns.saturating_sub(known.measured_ns)),
        ..(&known.obstacle).into()
    }
}

fn copy(from: &[f64], to: &mut [f64]) {
    to[..from.len()].copy_from_slice(from);
}

/// Scheduler statistics of the cycle thread; `None`: not available. `cause` is the cause of a late cycle.
pub fn scheduling(
    scheduling: Option<&Scheduling>,
    longest_gap_ns: u64,
    cause: Option<LateCause>,
) -> wire::SchedulingReport {
    let Scheduling {
        on_core_ns,
        run_delay_ns,
        switches,
        page_faults,
    } = scheduling.copied().unwrap_or_default();
    wire::SchedulingReport {
        run_delay_ns,
        on_core_ns,
        longest_gap_ns,
        page_faults,
        switches,
        late_cause: cause.unwrap_or_default().code(),
        known: u32::from(scheduling.is_some()),
    }
}

fn timing_flags(record: &CycleRecord) -> u32 {
    u32::from(record.lateness.late_start) * codes::timing::LATE_START
        + u32::from(record.lateness.deadline_miss) * codes::timing::DEADLINE_MISS
        + u32::from(record.stale_inputs) * codes::timing::STALE_INPUTS
}

fn report(report: &SolveReport) -> wire::SolverReport {
    let (violated, violation) = match report.status {
        SolveStatus::ConstraintViolated { constraint, amount } => (constraint.into(), amount),
        _ => (codes::Constraint::None, 0.0),
    };
    wire::SolverReport {
        violated: violated.code(),
        violation,
        budget_spent: u32::from(report.budget_spent),
        cost: report.cost,
        warm_cost: report.warm_cost,
        gradient_norm: report.gradient_norm,
        seed: report.seed,
        evaluations: report.evaluations,
        quanta: report.quanta,
        iterations: report.iterations,
        refinements: report.refinements,
        status: codes::SolverStatus::from(report.status).code(),
        winner: codes::Winner::from(report.winner).code(),
    }
}

fn reference(sample: &ReferenceSample) -> wire::ReferenceSample {
    let (kind, orientation) = model::orientation_to_wire(&sample.orientation);
    wire::ReferenceSample {
        position_m: sample.position_m.into(),
        orientation,
        orientation_kind: kind.code(),
        state: codes::ReferenceState::from(sample.state).code(),
    }
}

/// Text in a fixed field, cut at a character boundary.
pub fn text(text: &str) -> [u8; wire::limits::TEXT_BYTES] {
    let mut bytes = [0; wire::limits::TEXT_BYTES];
    let end = (0..=text.len().min(bytes.len()))
        .rev()
        .find(|&end| text.is_char_boundary(end));
    let end = end.unwrap_or(0);
    bytes[..end].copy_from_slice(&text.as_bytes()[..end]);
    bytes
}
