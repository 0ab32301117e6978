//! Where the position of the tip is that of the model, although a sensor is to measure it.

use std::fmt;
use std::time::{Duration, Instant};

use cdcr_client::{Connection, STATUS_TIMEOUT, counted, remedy};
use cdcr_controller::estimator::tip_offset_max_m;
use cdcr_shared_types::codes::{MeasurementKind, Mode, Outcome, TipCause};
use cdcr_shared_types::limits::TIP_SENSOR_SILENT_MS;
use cdcr_shared_types::{Status, Telemetry};

use crate::dry_run::{newest, robot_and_pose};
use crate::standing::distance_m;

pub(crate) const SILENT_NS: u64 = 1_000_000 * TIP_SENSOR_SILENT_MS as u64;

/// Some frames of a camera: a stray tip is followed by one that is used.
const STRAY_FOR: Duration = Duration::from_millis(150);

/// How long a tip sensor beside bends or cables has been silent; `None`: it measures, or none has measured \[ns\].
pub(crate) fn silence_ns(now_ns: u64, measured_ns: u64) -> Option<u64> {
    let silent_ns = now_ns.saturating_sub(measured_ns);
    (measured_ns > 0 && silent_ns > SILENT_NS).then_some(silent_ns)
}

/// A tip sensor beside bends or cables that does not measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unheard {
    /// It is configured, and none of its measurements was accepted.
    Never,
    /// It has measured.
    Silent { seconds: u64 },
}

impl Unheard {
    pub(crate) fn from_status(status: &Status) -> Option<Self> {
        if status.tip_measured_ns == 0 {
            let is_missed = status.has_tip_sensor != 0 && status.mode != Mode::Starting.code();
            return is_missed.then_some(Self::Never);
        }
        let silent_ns = silence_ns(status.header.sent_ns, status.tip_measured_ns)?;
        let seconds = silent_ns / 1_000_000_000;
        Some(Self::Silent { seconds })
    }
}

impl fmt::Display for Unheard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Never => f.write_str("no tip measurement accepted yet"),
            Self::Silent { seconds } => write!(f, "tip sensor silent for {seconds} s"),
        }
    }
}

/// Of a sensor that does not measure: how many of its measurements were refused, why, and what to do.
pub(crate) fn refused_text(status: &Status) -> Option<String> {
    let unheard = Unheard::from_status(status)?;
    match Outcome::try_from(status.tip_refused_by) {
        Ok(Outcome::Accepted) | Err(_) => (unheard == Unheard::Never).then(|| {
            "no measurement of the tip arrived: check that the tip sensor runs and sends (docs/drivers.md)"
                .to_owned()
        }),
        Ok(outcome) => Some(format!(
            "{} of the tip refused, the newest: {outcome}. {}",
            counted(status.tips_refused, "measurement"),
            remedy(outcome)
        )),
    }
}

/// Why the tip of a record is that of the model; `None`: it is measured, or no sensor is to measure it.
pub(crate) fn cause(status: &Status, record: &Telemetry) -> Option<String> {
    if let Some(unheard) = Unheard::from_status(status) {
        return Some(unheard.to_string());
    }
    let cause = TipCause::try_from(record.tip_cause).ok()?;
    if cause == TipCause::None {
        return None;
    }
    let (robot, _) = robot_and_pose(record).ok()?;
    let of_bends_m: [f64; 3] =
        core::array::from_fn(|i| record.tip_position_m[i] - record.tip_offset_m[i]);
    let away_mm = 1e3 * distance_m(record.tip_measured_m, of_bends_m);
    let limit_mm = 1e3 * tip_offset_max_m(robot.reach_m());
    Some(format!(
        "the measured tip is not in use because {cause}; it is {away_mm:.1} mm from where the bends place it, the limit is {limit_mm:.1} mm"
    ))
}

/// Warns a person who is about to move the robot by the tip that the model has. A stray tip is none: the next ones are used.
pub(crate) fn warn(connection: &Connection, status: &Status, record: &Telemetry) {
    let mut stream = None;
    let record = settled(*record, |left| {
        let stream = stream.get_or_insert_with(|| connection.telemetry());
        stream.as_mut().ok()?.next_within(left).ok().flatten()
    });
    if let Some(cause) = cause(status, &record) {
        tell!(
            "warning: {cause}: the tip and its distance from obstacles are those of the model, and the true tip may be elsewhere (cdcrctl status)"
        );
    }
}

/// The record, or where its tip may be a stray one, the first one with a tip that is used, if it comes within [`STRAY_FOR`].
fn settled(
    mut record: Telemetry,
    mut newer: impl FnMut(Duration) -> Option<Telemetry>,
) -> Telemetry {
    let until = Instant::now() + STRAY_FOR;
    while [TipCause::Far, TipCause::Jumps]
        .map(TipCause::code)
        .contains(&record.tip_cause)
        && let Some(left) = until.checked_duration_since(Instant::now())
        && let Some(next) = newer(left)
    {
        record = next;
    }
    record
}

/// As [`warn`], of the present. A daemon that does not answer is the caller's concern.
pub(crate) fn warn_now(connection: &Connection) {
    if let (Ok(status), Ok(record)) = (connection.status(STATUS_TIMEOUT), newest(connection)) {
        warn(connection, &status, &record);
    }
}

/// Reason why no tip was measured, reported at the end of a motion; `None` if one was measured. `record`: a present one.
pub(crate) fn never(status: &Status, record: &Telemetry) -> Option<String> {
    if Unheard::from_status(status) == Some(Unheard::Never) {
        let refused = refused_text(status).unwrap_or_default();
        return Some(format!("{}; {refused}", Unheard::Never));
    }
    let is_tip_alone = record.measurement.kind == MeasurementKind::TipPose.code();
    let is_measured = status.tip_measured_ns > 0 || is_tip_alone;
    (!is_measured).then(|| "no sensor measures the tip".to_owned())
}

/// Whether the tip becomes that of the model during a motion.
#[derive(Debug, Default)]
pub(crate) struct TipWatch {
    /// A measured tip was in use.
    was_used: bool,
    /// First release of those in a row whose measured tip was rejected \[ns\].
    rejected_ns: Option<u64>,
    is_reported: bool,
}

impl TipWatch {
    /// A warning when the measured tip has not been in use for [`SILENT_NS`], the first time. It names no option: not every
    /// command that moves the robot has the same ones.
    pub(crate) fn take(&mut self, record: &Telemetry) -> Option<String> {
        let silent_ns = silence_ns(record.release_ns, record.tip_measured_ns);
        let cause = TipCause::try_from(record.tip_cause).ok();
        let cause = cause.filter(|cause| *cause != TipCause::None);
        if silent_ns.is_none() && cause.is_none() {
            self.was_used |= record.tip_measured_ns > 0;
            self.rejected_ns = None;
            return None;
        }
        let since_ns = *self.rejected_ns.get_or_insert(record.release_ns);
        let is_new = self.was_used && !self.is_reported;
        let lasts = silent_ns.is_some() || record.release_ns - since_ns > SILENT_NS;
        if !is_new || !lasts {
            return None;
        }
        self.is_reported = true;
        let cause = match (silent_ns, cause) {
            (None, Some(cause)) => format!("the measured tip is not in use because {cause}"),
            _ => "the tip sensor is silent".to_owned(),
        };
        Some(format!(
            "warning: {cause}: until it measures again, the tip and its error are those of the model (cdcrctl status)"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dry_run::tests::robot;

    #[test]
    fn a_tip_that_becomes_that_of_the_model_on_the_way_is_reported() {
        const STEP_NS: u64 = 5_000_000;
        let reported = |measured_until: u64, rejected_from: u64| {
            let mut watch = TipWatch::default();
            let record = |cycle: u64| Telemetry {
                release_ns: cycle * STEP_NS,
                tip_measured_ns: cycle.min(measured_until) * STEP_NS,
                tip_cause: if cycle >= rejected_from {
                    TipCause::Jumps.code()
                } else {
                    TipCause::None.code()
                },
                ..Telemetry::default()
            };
            let reported = (1..=900).filter_map(|cycle| Some((cycle, watch.take(&record(cycle))?)));
            reported.collect::<Vec<_>>()
        };
        let silent = reported(100, u64::MAX);
        assert!(matches!(&silent[..], [(301, text)] if text.contains("the tip sensor is silent")));
        let rejected = reported(u64::MAX, 100);
        assert!(matches!(&rejected[..], [(301, text)] if text.contains("because it moved faster")));
        let texts = || silent.iter().chain(&rejected);
        assert!(texts().all(|(_, text)| !text.contains("--")), "{silent:?}");
        for of_never_or_always in [
            reported(0, u64::MAX),
            reported(u64::MAX, 800),
            reported(u64::MAX, 0),
        ] {
            assert!(of_never_or_always.is_empty(), "{of_never_or_always:?}");
        }
    }

    #[test]
    fn a_stray_tip_before_a_motion_is_no_cause() {
        use TipCause::{Far, Frozen, Jumps, None};
        let with = |cause: TipCause| Telemetry {
            tip_cause: cause.code(),
            ..Telemetry::default()
        };
        for (causes, kept) in [
            (vec![None], None),
            (vec![Jumps, Jumps, None, Far], None),
            (vec![Far, Far, Frozen], Frozen),
            (vec![Frozen, None], Frozen),
            // It ends without a newer one.
            (vec![Far, Far], Far),
        ] {
            let mut records = causes.into_iter().map(with);
            let first = records.next().expect("one");
            assert_eq!(settled(first, |_| records.next()).tip_cause, kept.code());
        }
    }

    #[test]
    fn a_tip_sensor_is_silent_only_after_it_has_measured() {
        let mut status = Status::default();
        status.header.sent_ns = 8_000_000_000;
        for (measured_ns, unheard) in [
            (0, None),
            (7_500_000_000, None),
            (8_100_000_000, None),
            (2_900_000_000, Some(Unheard::Silent { seconds: 5 })),
        ] {
            status.tip_measured_ns = measured_ns;
            assert_eq!(Unheard::from_status(&status), unheard);
        }
        assert_eq!(refused_text(&status), None);
    }

    #[test]
    fn a_rejected_tip_is_named_with_its_distance_also_between_two_measurements() {
        let mut status = Status::default();
        (status.header.sent_ns, status.tip_measured_ns) = (2_000_000_000, 1_900_000_000);
        let mut record = Telemetry {
            tip_position_m: [0.0, 0.0, 0.3],
            robot: robot(1),
            ..Telemetry::default()
        };
        for (tip_cause, x_m, named) in [
            (TipCause::Far, 0.05, "it is 50.0 mm from where"),
            (TipCause::Far, 0.05, "the limit is 33.3 mm"),
            // Also where the bends are within the limit by now, or beyond it for another cause.
            (TipCause::Far, 0.01, "it is too far from"),
            (TipCause::Jumps, 0.05, "it moved faster"),
            (TipCause::None, 0.05, ""),
        ] {
            record.tip_cause = tip_cause.code();
            record.tip_measured_m = [x_m, 0.0, 0.3];
            let cause = cause(&status, &record).unwrap_or_default();
            assert!(
                cause.contains(named) && cause.is_empty() == named.is_empty(),
                "{cause}"
            );
        }
    }

    #[test]
    fn a_sensor_that_was_never_heard_is_named_with_its_refusal_and_remedy() {
        let mut status = Status {
            mode: Mode::Holding.code(),
            has_tip_sensor: 1,
            ..Status::default()
        };
        assert_eq!(Unheard::from_status(&status), Some(Unheard::Never));
        assert!(refused_text(&status).is_some_and(|text| text.contains("runs and sends")));
        status.tips_refused = 7;
        status.tip_refused_by = Outcome::InTheFuture.code();
        let text = refused_text(&status).expect("refused");
        for part in [
            "7 measurements of the tip refused",
            "in the future",
            "CLOCK_MONOTONIC",
        ] {
            assert!(text.contains(part), "{text}");
        }
        let record = Telemetry::default();
        let cause = cause(&status, &record).expect("a cause");
        assert_eq!(cause, "no tip measurement accepted yet");
        // The daemon waits for its driver, or no sensor is to measure the tip.
        status.mode = Mode::Starting.code();
        assert_eq!(Unheard::from_status(&status), None);
        status.mode = Mode::Holding.code();
        status.has_tip_sensor = 0;
        assert_eq!(Unheard::from_status(&status), None);
    }
}
