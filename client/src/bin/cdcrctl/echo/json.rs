//! Every message as JSON: codes in words, SI units in the names, only what is used of each array.

use cdcr_client::{events, obstacles as obstacles_of, realtime_missing, text};
use cdcr_shared_types::codes::{
    ChunkMode, Constraint, Coordinates, EventKind, Interface, Interpolation, LateCause, LeaseState,
    MeasurementKind, MeasurementState, Mode, ObstacleAction, ObstacleShape, OrientationKind,
    Outcome, Reason, ReferenceState, RobotLink, SolverKind, SolverStatus, VelocityRule, Winner,
    guard, timing,
};
use cdcr_shared_types::limits::{CHUNK_POINTS_MAX, OBSTACLES_MAX, PLAN_MAX, SECTIONS_MAX};
use cdcr_shared_types::{
    Command, Header, Incident, InputEvent, LatencySummary, Measurement, Obstacle, ObstacleUpdate,
    ReferenceChunk, ReferencePoint, RobotDescription, SchedulingReport, SolverReport,
    SolverSettings, Statistics, Status, Telemetry,
};
use serde_json::{Map, Value, json};

fn header(header: &Header) -> Value {
    json!({
        "sender_id": header.sender_id,
        "sequence": header.sequence,
        "sent_ns": header.sent_ns,
    })
}

fn used_sections(sections: u32) -> usize {
    (sections as usize).min(SECTIONS_MAX)
}

pub(crate) fn telemetry(record: &Telemetry) -> Value {
    let coordinates = 2 * used_sections(record.command.sections);
    let plan_length = (record.plan_length as usize).min(PLAN_MAX);
    let when_and_mode = json!({
        "header": header(&record.header),
        "cycle": record.cycle,
        "release_ns": record.release_ns,
        "due_ns": record.due_ns,
        "start_ns": record.start_ns,
        "solve_start_ns": record.solve_start_ns,
        "solve_end_ns": record.solve_end_ns,
        "handed_over_ns": record.handed_over_ns,
        "period_ns": record.period_ns,
        "elapsed_ns": record.elapsed_ns,
        "skipped_periods": record.skipped_periods,
        "timing_flags": record.timing_flags,
        "late_start": record.timing_flags & timing::LATE_START != 0,
        "deadline_miss": record.timing_flags & timing::DEADLINE_MISS != 0,
        "stale_inputs": record.timing_flags & timing::STALE_INPUTS != 0,
        "deadline_misses_total": record.deadline_misses_total,
        "skipped_periods_total": record.skipped_periods_total,
        "scheduling": scheduling(&record.scheduling),
        "mode": Mode::text_of(record.mode),
        "reason": Reason::text_of(record.reason),
        "miss_bucket": record.miss_bucket,
    });
    let inputs = json!({
        "gather": record.gather,
        "gather_ns": record.gather_ns,
        "events": events(record).iter().map(event).collect::<Vec<_>>(),
        "measurement": measurement(&record.measurement),
        "measurement_state": MeasurementState::text_of(record.measurement_state),
        "bend_rad": &record.bend_rad[..coordinates],
        "previous_rate_rad_s": &record.previous_rate_rad_s[..coordinates],
        "settings": settings(&record.settings),
        "robot": robot(&record.robot),
        "window_first_cycle": record.window_first_cycle,
        "deceleration_rad_s2": record.deceleration_rad_s2,
        "home_rate_rad_s": record.home_rate_rad_s,
        "deadline_ns": record.deadline_ns,
        "late_start_ns": record.late_start_ns,
        "measurement_timeout_ns": record.measurement_timeout_ns,
        "clearance_fault_m": record.clearance_fault_m,
        "following_warning_rad": record.following_warning_rad,
        "following_fault_rad": record.following_fault_rad,
        "following_lag_ns": record.following_lag_ns,
        "acceleration_rad_s2": record.acceleration_rad_s2,
        "measurement_jump_rad": record.measurement_jump_rad,
        "measurement_jump_limit": record.measurement_jump_limit,
        "measurement_frozen_rad": record.measurement_frozen_rad,
        "miss_limit": record.miss_limit,
        "lease_state": LeaseState::text_of(record.lease_state),
        "obstacles": obstacles_of(record).iter().map(obstacle).collect::<Vec<_>>(),
    });
    let outputs = json!({
        "warm_plan": &record.warm_plan[..plan_length],
        "plan": &record.plan[..plan_length],
        "report": report(&record.report),
        "reference": {
            "state": ReferenceState::text_of(record.reference.state),
            "position_m": record.reference.position_m,
            "orientation_kind": OrientationKind::text_of(record.reference.orientation_kind),
            "orientation": record.reference.orientation,
        },
        "tip_position_m": record.tip_position_m,
        "tip_orientation": record.tip_orientation,
        "position_error_m": record.position_error_m,
        "guard_flags": record.guard_flags,
        "guards": guards(record.guard_flags),
        "clearance_m": record.clearance_m,
        "commanded_rad": &record.commanded_rad[..coordinates],
        "following_error_rad": &record.following_error_rad[..coordinates / 2],
        "following_error_m": &record.following_error_m[..3 * coordinates / 2],
        "command": command(&record.command),
    });
    joined([when_and_mode, inputs, outputs])
}

fn scheduling(report: &SchedulingReport) -> Value {
    json!({
        "known": report.known != 0,
        "late_cause": LateCause::text_of(report.late_cause),
        "run_delay_ns": report.run_delay_ns,
        "on_core_ns": report.on_core_ns,
        "longest_gap_ns": report.longest_gap_ns,
        "page_faults": report.page_faults,
        "switches": report.switches,
    })
}

/// One object with the fields of all.
fn joined<const N: usize>(parts: [Value; N]) -> Value {
    let fields = parts.into_iter().filter_map(|part| match part {
        Value::Object(fields) => Some(fields),
        _ => None,
    });
    Value::Object(fields.flatten().collect())
}

/// Names of the limits and guards that changed a command.
pub(super) fn guards(flags: u32) -> Vec<&'static str> {
    let set = guard::ALL.iter().filter(|(bit, _)| flags & bit != 0);
    set.map(|(_, name)| *name).collect()
}

fn event(event: &InputEvent) -> Value {
    json!({
        "sender_id": event.sender_id,
        "sequence": event.sequence,
        "judged_ns": event.judged_ns,
        "kind": EventKind::text_of(event.kind),
        "outcome": Outcome::text_of(event.outcome),
        "detail": event.detail,
        "gathers_ago": event.gathers_ago,
    })
}

fn measurement(measurement: &Measurement) -> Value {
    let sections = used_sections(measurement.sections);
    let kind = MeasurementKind::try_from(measurement.kind);
    let mut object = Map::new();
    let text = MeasurementKind::text_of(measurement.kind);
    object.insert("kind".to_owned(), json!(text));
    object.insert("measured_ns".to_owned(), json!(measurement.measured_ns));
    let values = match kind {
        Ok(MeasurementKind::Configuration) => {
            json!({ "bend_rad": &measurement.bend_rad[..2 * sections] })
        }
        Ok(MeasurementKind::TipPose) => json!({
            "tip_position_m": measurement.tip_position_m,
            "tip_orientation": measurement.tip_orientation,
        }),
        Ok(MeasurementKind::CableLengths) => {
            json!({ "cable_length_m": &measurement.cable_length_m[..3 * sections] })
        }
        Ok(MeasurementKind::None) | Err(_) => json!({}),
    };
    if let Value::Object(values) = values {
        object.extend(values);
    }
    Value::Object(object)
}

fn report(report: &SolverReport) -> Value {
    json!({
        "status": SolverStatus::text_of(report.status),
        "winner": Winner::text_of(report.winner),
        "violated": Constraint::text_of(report.violated),
        "violation": report.violation,
        "budget_spent": report.budget_spent != 0,
        "cost": report.cost,
        "warm_cost": report.warm_cost,
        "gradient_norm": report.gradient_norm,
        "seed": report.seed,
        "evaluations": report.evaluations,
        "quanta": report.quanta,
        "iterations": report.iterations,
        "refinements": report.refinements,
    })
}

pub(crate) fn command(command: &Command) -> Value {
    let sections = used_sections(command.sections);
    json!({
        "header": header(&command.header),
        "cycle": command.cycle,
        "release_ns": command.release_ns,
        "target_ns": command.target_ns,
        "valid_until_ns": command.valid_until_ns,
        "mode": Mode::text_of(command.mode),
        "sections": command.sections,
        "interface": Interface::text_of(command.interface),
        "bend_rate_rad_s": &command.bend_rate_rad_s[..2 * sections],
        "bend_target_rad": &command.bend_target_rad[..2 * sections],
        "cable_length_m": &command.cable_length_m[..3 * sections],
        "cable_speed_m_s": &command.cable_speed_m_s[..3 * sections],
    })
}

pub(crate) fn status(status: &Status) -> Value {
    let missing = realtime_missing(status.realtime_missing);
    let sections = used_sections(status.robot.sections);
    let counted = json!({
        "header": header(&status.header),
        "robot_name": text(&status.robot_name),
        "build": text(&status.build),
        "process_id": status.process_id,
        "mode": Mode::text_of(status.mode),
        "reason": Reason::text_of(status.reason),
        "realtime": missing.is_empty(),
        "realtime_missing": missing.iter().map(|(name, _)| name).collect::<Vec<_>>(),
        "link": RobotLink::text_of(status.link),
        "core": (status.core != u32::MAX).then_some(status.core),
        "origin_ns": status.origin_ns,
        "period_ns": status.period_ns,
        "deadline_ns": status.deadline_ns,
        "cycles": status.cycles,
        "late_starts": status.late_starts,
        "deadline_misses": status.deadline_misses,
        "skipped_periods": status.skipped_periods,
        "misses_tolerated": status.misses_tolerated,
        "budget_hits": status.budget_hits,
        "dropped_records": status.dropped_records,
        "faults": status.faults,
        "clearance_guarded": status.clearance_guarded,
        "obstacles_refused": status.obstacles_refused,
        "outcomes": outcomes(status),
        "statistics_since_ns": status.statistics_since_ns,
        "since_reset": statistics(&status.since_reset),
        "last_minute": statistics(&status.last_minute),
    });
    let known = json!({
        "lease_holder": status.lease_holder,
        "reference_end_ns": status.reference_end_ns,
        "reference_points": status.reference_points,
        "obstacle_count": status.obstacle_count,
        "clearance_m": status.clearance_m,
        "interface": Interface::text_of(status.interface),
        "tip_position_m": status.tip_position_m,
        "position_error_m": status.position_error_m,
        "following_error_rad": &status.following_error_rad[..sections],
        "following_error_m": &status.following_error_m[..3 * sections],
        "following_warnings": status.following_warnings,
        "safe_distance_min_m": status.safe_distance_min_m,
        "obstacle_source_timeout_ns": status.obstacle_source_timeout_ns,
        "robot": robot(&status.robot),
        "settings": settings(&status.settings),
    });
    joined([counted, known])
}

fn outcomes(status: &Status) -> Value {
    let counted = Outcome::ALL.iter().zip(status.outcomes);
    let named = counted.map(|(outcome, count)| (outcome.text().to_owned(), json!(count)));
    Value::Object(named.collect())
}

fn statistics(statistics: &Statistics) -> Value {
    json!({
        "cycles": statistics.cycles,
        "late_starts": statistics.late_starts,
        "deadline_misses": statistics.deadline_misses,
        "skipped_periods": statistics.skipped_periods,
        "longest_streak": statistics.longest_streak,
        "budget_hits": statistics.budget_hits,
        "stale_inputs": statistics.stale_inputs,
        "stale_measurements": statistics.stale_measurements,
        "dropped_records": statistics.dropped_records,
        "causes": causes(statistics),
        "wake": latency(&statistics.wake),
        "gather": latency(&statistics.gather),
        "compute": latency(&statistics.compute),
        "solve": latency(&statistics.solve),
        "response": latency(&statistics.response),
        "publish": latency(&statistics.publish),
    })
}

/// Late cycles by their cause; "in time" is none.
fn causes(statistics: &Statistics) -> Value {
    let counted = LateCause::ALL.iter().zip(statistics.causes).skip(1);
    let named = counted.map(|(cause, count)| (cause.text().to_owned(), json!(count)));
    Value::Object(named.collect())
}

pub(crate) fn incident(incident: &Incident) -> Value {
    json!({
        "header": header(&incident.header),
        "steal_ns": incident.steal_ns,
        "steal_window_ns": incident.steal_window_ns,
        "telemetry": telemetry(&incident.telemetry),
    })
}

fn latency(latency: &LatencySummary) -> Value {
    json!({
        "count": latency.count,
        "min_ns": latency.min_ns,
        "p50_ns": latency.p50_ns,
        "p99_ns": latency.p99_ns,
        "p999_ns": latency.p999_ns,
        "max_ns": latency.max_ns,
    })
}

fn robot(robot: &RobotDescription) -> Value {
    let used = &robot.section[..used_sections(robot.sections)];
    let sections = used.iter().map(|section| {
        json!({
            "length_m": section.length_m,
            "cable_radius_m": section.cable_radius_m,
            "cable_offset_rad": section.cable_offset_rad,
            "bend_max_rad": section.bend_max_rad,
            "rate_max_rad_s": section.rate_max_rad_s,
            "body_radius_m": section.body_radius_m,
        })
    });
    json!({
        "fingerprint": robot.fingerprint,
        "cable_speed_max_m_s": robot.cable_speed_max_m_s,
        "cable_stroke_max_m": robot.cable_stroke_max_m,
        "sections": sections.collect::<Vec<_>>(),
    })
}

fn settings(settings: &SolverSettings) -> Value {
    json!({
        "solver": SolverKind::text_of(settings.solver),
        "coordinates": Coordinates::text_of(settings.coordinates),
        "horizon_steps": settings.horizon_steps,
        "control_blocks": settings.control_blocks,
        "swarm_size": settings.swarm_size,
        "swarm_iterations": settings.swarm_iterations,
        "regenerate_after": settings.regenerate_after,
        "velocity_rule": VelocityRule::text_of(settings.velocity_rule),
        "refinement_steps": settings.refinement_steps,
        "inertia": settings.inertia,
        "cognitive": settings.cognitive,
        "social": settings.social,
        "damping": settings.damping,
        "position_weight": settings.position_weight,
        "orientation_weight": settings.orientation_weight,
        "orientation_tolerance_rad": settings.orientation_tolerance_rad,
        "rate_weight": settings.rate_weight,
        "rate_change_weight": settings.rate_change_weight,
        "terminal_weight": settings.terminal_weight,
        "safe_distance_m": settings.safe_distance_m,
        "obstacle_step_penalty": settings.obstacle_step_penalty,
        "obstacle_slope_penalty": settings.obstacle_slope_penalty,
        "obstacle_square_penalty": settings.obstacle_square_penalty,
        "budget_ns": settings.budget_ns,
        "seed": settings.seed,
    })
}

pub(crate) fn reference(chunk: &ReferenceChunk) -> Value {
    let points = &chunk.points[..(chunk.count as usize).min(CHUNK_POINTS_MAX)];
    json!({
        "header": header(&chunk.header),
        "mode": ChunkMode::text_of(chunk.mode),
        "interpolation": Interpolation::text_of(chunk.interpolation),
        "points": points.iter().map(point).collect::<Vec<_>>(),
    })
}

fn point(point: &ReferencePoint) -> Value {
    json!({
        "time_ns": point.time_ns,
        "position_m": point.position_m,
        "orientation_kind": OrientationKind::text_of(point.orientation_kind),
        "orientation": point.orientation,
    })
}

pub(crate) fn obstacles(update: &ObstacleUpdate) -> Value {
    let used = &update.obstacles[..(update.count as usize).min(OBSTACLES_MAX)];
    json!({
        "header": header(&update.header),
        "action": ObstacleAction::text_of(update.action),
        "obstacles": used.iter().map(obstacle).collect::<Vec<_>>(),
    })
}

pub(crate) fn obstacle(obstacle: &Obstacle) -> Value {
    json!({
        "id": obstacle.id,
        "shape": ObstacleShape::text_of(obstacle.shape),
        "start_m": obstacle.start_m,
        "end_m": obstacle.end_m,
        "radius_m": obstacle.radius_m,
        "velocity_m_s": obstacle.velocity_m_s,
        "measured_ns": obstacle.measured_ns,
        "lifetime_ns": obstacle.lifetime_ns,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_are_cut_to_what_is_used_and_nan_is_null() {
        let mut record = Telemetry {
            plan_length: 4,
            position_error_m: f64::NAN,
            clearance_m: f64::INFINITY,
            obstacle_count: 2,
            guard_flags: guard::CLEARANCE | guard::BEND,
            ..Telemetry::default()
        };
        record.command.sections = 2;
        let value = telemetry(&record);
        assert_eq!(value["bend_rad"].as_array().map(Vec::len), Some(4));
        assert_eq!(value["plan"].as_array().map(Vec::len), Some(4));
        assert!(value["position_error_m"].is_null() && value["clearance_m"].is_null());
        assert_eq!(value["obstacles"].as_array().map(Vec::len), Some(2));
        assert_eq!(value["guards"], json!(["bend", "clearance"]));
        assert_eq!(
            value["command"]["cable_length_m"].as_array().map(Vec::len),
            Some(6)
        );
    }

    #[test]
    fn counters_have_the_names_of_their_outcomes() {
        let mut status_record = Status::default();
        status_record.outcomes[Outcome::NotFinite.code() as usize] = 5;
        let value = status(&status_record);
        assert_eq!(value["outcomes"]["a value is not a finite number"], 5);
        assert_eq!(value["realtime"], true);
        assert_eq!(value["misses_tolerated"], 0);
    }

    #[test]
    fn statistics_name_their_causes_and_a_record_says_why_it_was_late() {
        let mut snapshot = Status::default();
        snapshot.last_minute.causes[LateCause::Load.code() as usize] = 7;
        snapshot.since_reset.gather.p99_ns = 8;
        let value = status(&snapshot);
        let causes = &value["last_minute"]["causes"];
        assert_eq!(causes["another task had the core"], 7);
        assert_eq!(causes.as_object().map(Map::len), Some(LateCause::COUNT - 1));
        assert_eq!(value["since_reset"]["gather"]["p99_ns"], 8);

        let mut bad = Incident::default();
        bad.telemetry.scheduling.late_cause = LateCause::PageFault.code();
        bad.telemetry.timing_flags = timing::DEADLINE_MISS;
        bad.telemetry.measurement_state = MeasurementState::Repeated.code();
        let value = incident(&bad);
        let record = &value["telemetry"];
        assert_eq!(record["scheduling"]["late_cause"], "page fault");
        assert_eq!(record["deadline_miss"], true);
        assert_eq!(record["late_start"], false);
        assert_eq!(record["measurement_state"], "repeated");
    }
}
