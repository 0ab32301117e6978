//! The status that late joiners get.

use cdcr_controller::nmpc::RateWeight;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{Interface, Mode, Outcome, Reason, RobotLink, TipCause};

use crate::config::{Config, LinkKind, TipSensor, Validated, ns};
use crate::convert;
use crate::handover::{RuntimeSettings, Summary};

/// Copies the data of the newest cycle into a status.
pub(super) fn update(status: &mut wire::Status, summary: &Summary) {
    let inputs = &summary.inputs;
    status.mode = summary.mode.code();
    status.reason = summary.reason.code();
    status.reset_refused_by = summary.reset_refused_by.unwrap_or(Reason::Start).code();
    status.cycles = summary.totals.cycles;
    status.late_starts = summary.totals.late_starts;
    status.deadline_misses = summary.totals.deadline_misses;
    status.skipped_periods = summary.totals.skipped_periods;
    status.faults = summary.faults;
    status.outcomes = inputs.outcomes;
    status.lease_holder = inputs.lease_holder;
    status.reference_end_ns = inputs.reference_end_ns;
    status.reference_points = inputs.reference_points;
    status.obstacle_count = summary.obstacle_count;
    status.obstacles_refused = inputs.obstacles_refused;
    let silent_source = inputs.silent_source.unwrap_or_default();
    (status.silent_obstacle_source, status.silent_since_ns) = silent_source;
    status.clearance_m = summary.clearance_m;
    status.tip_margin_m = summary.tip_margin_m;
    status.tip_position_m = summary.tip_position_m;
    status.position_error_m = summary.reference_distance_m;
    status.reference_position_m = summary.reference_position_m;
    status.measured_error_m = summary.measured_error_m;
    status.tip_measured_ns = summary.tip_measured_ns;
    let rejected = summary.tip_rejected.map(|rejection| rejection.cause);
    let cause = rejected.map_or(TipCause::None, Into::into);
    status.driver_measures_tip_only = inputs.driver_measures_tip_only.into();
    status.tip_cause = cause.code();
    status.tips_refused = inputs.refused_tips.count;
    let refused_m = inputs.refused_tips.contradiction_m;
    status.tip_contradiction_m = refused_m.max(summary.tip_contradiction_m);
    status.tip_refused_by = match inputs.refused_tips {
        refused if refused.is_over => Outcome::Accepted.code(),
        refused => refused.newest.code(),
    };
    status.following_error_rad = summary.following.bend_rad;
    status.following_error_m = summary.following.cable_m;
    status.settings = summary.settings;
    status.safe_distance_min_m = inputs.safe_distance_min_m;
}

/// A process beside the driver is to measure the tip.
pub(super) fn has_tip_sensor(config: &Config) -> bool {
    config.link.kind == LinkKind::Driver && config.link.tip_sensor == TipSensor::Separate
}

/// The status of the daemon before its first cycle.
pub(super) fn first(validated: &Validated, daemon_id: u64) -> wire::Status {
    let config = &validated.config;
    let period_ns = ns(config.cycle.period_ms);
    wire::Status {
        header: wire::Header {
            sender_id: daemon_id,
            ..wire::Header::default()
        },
        robot_name: convert::text(&config.robot.name),
        build: convert::text(env!("CARGO_PKG_VERSION")),
        process_id: std::process::id(),
        mode: Mode::Starting.code(),
        link: RobotLink::from(config.link.kind).code(),
        interface: Interface::from(config.link.interface).code(),
        has_tip_sensor: has_tip_sensor(config).into(),
        position_error_m: f64::NAN,
        reference_position_m: [f64::NAN; 3],
        measured_error_m: f64::NAN,
        period_ns,
        deadline_ns: config.cycle.deadline_ns(),
        robot: (&validated.robot).into(),
        settings: convert::settings_to_wire(&RuntimeSettings::new(config)),
        clearance_m: f64::INFINITY,
        clearance_fault_m: config.safety.clearance_fault_m,
        safe_distance_min_m: config.controller.safe_distance_m,
        obstacle_source_timeout_ns: ns(config.obstacles.source_timeout_ms),
        rate_weight_auto: RateWeight::auto(config.link.is_ideal()).into(),
        ..wire::Status::default()
    }
}
