//! Why the robot is stopped or faulted, and what to do about it.

use cdcr_client::{Connection, counted, reason_remedy, remedy};
use cdcr_controller::robot::Configuration;
use cdcr_controller::safety::{FarthestBend, MarginShare};
use cdcr_shared_types::Status;
use cdcr_shared_types::codes::{MeasurementKind, Mode, Outcome, Reason};

use crate::dry_run::{newest, robot_and_pose};

/// What to do about the cause of a stop or fault, which only a reset ends.
pub(crate) fn stop_remedy(status: &Status) -> Option<&'static str> {
    let reason = Reason::try_from(status.reason).ok()?;
    Mode::is_latched(status.mode).then(|| reason_remedy(reason))
}

/// What to do where the robot cannot be moved: stopped, faulted, or not yet measured.
pub(crate) fn status_remedy(status: &Status) -> Option<String> {
    match Mode::try_from(status.mode).ok()? {
        Mode::Starting => Some(start_remedy(status)),
        _ => stop_remedy(status).map(str::to_owned),
    }
}

/// Outcomes of a measurement. Those that other messages have, too, are left out where such messages are common.
const OF_MEASUREMENTS: [Outcome; 9] = [
    Outcome::InThePast,
    Outcome::InTheFuture,
    Outcome::CableMean,
    Outcome::BeyondTurn,
    Outcome::TipElsewhere,
    Outcome::WrongRobot,
    Outcome::WrongInterface,
    Outcome::OtherDriver,
    Outcome::OutOfRange,
];

/// The daemon waits for the first measurement of its driver. The status counts refusals of all messages together.
fn start_remedy(status: &Status) -> String {
    let refusals =
        OF_MEASUREMENTS.map(|outcome| (outcome, status.outcomes[outcome.code() as usize]));
    match refusals.into_iter().max_by_key(|(_, count)| *count) {
        Some((outcome, count)) if count > 0 => format!(
            "No measurement was accepted yet; {} refused: {outcome}{}. {}",
            counted(count, "message"),
            match outcome {
                Outcome::TipElsewhere => format!(", {:.0} mm away", 1e3 * status.tip_contradiction_m),
                _ => String::new(),
            },
            remedy(outcome)
        ),
        _ => "No measurement was accepted yet: check that the driver runs and sends (docs/drivers.md).".to_owned(),
    }
}

/// The share of the tip margin in a clearance that is a fault or refuses a reset: one below `limit_m`.
pub(crate) fn margin_share(
    reasons: &[u32],
    clearance_m: f64,
    margin_m: f64,
    limit_m: f64,
) -> Option<MarginShare> {
    let is_cause = reasons.contains(&Reason::ClearanceBroken.code());
    // Since a fault the obstacle may have gone, and the clearance of the present says nothing of its cause.
    (is_cause && margin_m > 0.0 && clearance_m < limit_m).then_some(MarginShare {
        clearance_m,
        margin_m,
        limit_m,
    })
}

/// The bend that breaks its limit, where that is a fault or refuses a reset. Only telemetry has the bends.
pub(crate) fn broken_bend(connection: &Connection, status: &Status) -> Option<FarthestBend> {
    if ![status.reason, status.reset_refused_by].contains(&Reason::LimitBroken.code()) {
        return None;
    }
    let record = newest(connection).ok()?;
    let (robot, estimate) = robot_and_pose(&record).ok()?;
    let measured = match MeasurementKind::try_from(record.measurement.kind) {
        Ok(MeasurementKind::Configuration) => {
            Configuration::from_slice(&record.measurement.bend_rad[..robot.coordinate_count()])
        }
        Ok(MeasurementKind::CableLengths) => {
            Some(robot.bend_from_cable_lengths(&record.measurement.cable_length_m))
        }
        _ => None,
    };
    FarthestBend::find(&robot, measured, &estimate)
}
