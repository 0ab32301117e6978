use cdcr_controller::safety::{self, ModeMachine, Observation};
use cdcr_shared_types::codes::{
    self, MeasurementKind, Mode, Reason, RequestKind, SolverStatus, guard,
};
use cdcr_shared_types::model::{mode_of, mode_request};
use cdcr_shared_types::{InputEvent, Telemetry};

use super::Difference;
use super::check::Check;

/// The mode machine, with the recorded inputs.
///
/// Inputs that a record does not contain are taken from its reason. These are measurement faults, home
/// reached, a suspension of the machine, stale inputs or obstacles, a stop by signal or before the start, and
/// the shutdown. All others are computed: faults of clearance, following error and solver, the bucket of
/// misses, lease, end of the reference, and requests.
#[derive(Debug, Default)]
pub(super) struct Modes {
    before: Option<PreviousCycle>,
}

/// State after the previous cycle.
#[derive(Debug)]
struct PreviousCycle {
    machine: ModeMachine,
    clearance_m: f64,
    miss_bucket: u32,
}

impl Modes {
    /// Records are missing: the mode of the next one is accepted as recorded.
    pub(super) fn forget(&mut self) {
        self.before = None;
    }

    /// Checks the mode of the next record, after these accepted requests.
    pub(super) fn check(
        &mut self,
        record: &Telemetry,
        requests: &[InputEvent],
    ) -> Option<Difference> {
        let recorded = recorded_mode(record);
        let mut check = Check::new(record.cycle);
        let mut machine = None;
        if let Some(before) = self.before.take() {
            let advanced = before.advanced(record, requests);
            let (mode, reason) = (advanced.mode().into(), advanced.mode().reason().into());
            check.same("mode", Mode::text_of(record.mode), Mode::text(mode));
            check.same(
                "reason",
                Reason::text_of(record.reason),
                Reason::text(reason),
            );
            machine = Some(advanced);
        }
        let difference = check.first();
        let machine = machine.filter(|_| difference.is_none());
        // After a difference, as after a gap, the recorded mode is used.
        self.before = recorded.map(|mode| PreviousCycle {
            machine: machine.unwrap_or_else(|| ModeMachine::resumed(mode, record.lease_number)),
            clearance_m: record.clearance_m,
            miss_bucket: record.miss_bucket,
        });
        difference
    }
}

impl PreviousCycle {
    fn advanced(&self, record: &Telemetry, requests: &[InputEvent]) -> ModeMachine {
        let mut machine = self.machine;
        let was_shut_down = machine.mode().reason() == safety::Reason::Shutdown;
        let is_now = |mode: Mode, reason: Reason| {
            record.mode == mode.code() && record.reason == reason.code()
        };
        if is_now(Mode::Stopped, Reason::Shutdown) {
            machine.shut_down();
        }
        // A reset may arrive in the same cycle, and so may a hold of a robot that was not stopped before.
        let resets = [RequestKind::Reset, RequestKind::ResetAcceptingPose].map(RequestKind::code);
        let is_reset = |event: &InputEvent| resets.contains(&event.detail);
        let is_lost = is_now(Mode::Stopped, Reason::ObstaclesLost);
        let is_stopped_before = is_lost
            || is_now(Mode::Stopped, Reason::StoppedBefore)
            || is_now(Mode::Holding, Reason::Request) && requests.iter().any(is_reset);
        if is_stopped_before && machine.mode() == safety::Mode::Starting {
            machine = ModeMachine::stopped_before(if is_lost {
                safety::Reason::ObstaclesLost
            } else {
                safety::Reason::StoppedBefore
            });
        }
        let mut seen = self.observation(record);
        // On the way home it is accepted only on arrival.
        let is_track = |event: &InputEvent| event.detail == RequestKind::Track.code();
        seen.at_home |= requests.iter().any(is_track) && machine.mode() == safety::Mode::Homing;
        machine.observe(&seen);
        let mut requests = requests
            .iter()
            .filter_map(|event| mode_request(event.detail.try_into().ok()?, record.lease_number))
            .peekable();
        // A stop by signal is not a message.
        if requests.peek().is_none()
            && is_now(Mode::Stopped, Reason::Request)
            && (was_shut_down || !machine.mode().is_latched())
        {
            let _ = machine.request(safety::Request::Stop, &seen);
        }
        let requests: Vec<_> = requests.collect();
        let stop = Some(&safety::Request::Stop).filter(|stop| requests.contains(stop));
        for request in stop.into_iter().chain(&requests) {
            // A refusal is visible in the mode.
            let _ = machine.request(*request, &seen);
        }
        let failed = record.report.status == SolverStatus::NonFinite.code();
        if failed || record.guard_flags & guard::NON_FINITE != 0 {
            machine.fault(safety::Reason::NonFinite);
        }
        machine
    }

    fn observation(&self, record: &Telemetry) -> Observation {
        let recorded_reason = Reason::try_from(record.reason).ok().map(Into::into);
        let reason_in = |mode: Mode, reasons: &[Reason]| {
            let is_recorded = record.mode == mode.code()
                && reasons.iter().any(|reason| reason.code() == record.reason);
            recorded_reason.filter(|_| is_recorded)
        };
        let miss_limit = record.miss_limit;
        Observation {
            measured: record.measurement.kind != MeasurementKind::None.code(),
            reference: codes::ReferenceState::try_from(record.reference.state)
                .unwrap_or_default()
                .into(),
            too_far: record.reference_too_far != 0,
            measurement_rejected: record.measurement_rejected != 0,
            tip_contradiction_m: record.tip_contradiction_m,
            pose_differs: record.pose_differs != 0,
            lease: codes::LeaseState::try_from(record.lease_state)
                .unwrap_or_default()
                .into(),
            lease_number: record.lease_number,
            at_home: reason_in(Mode::Holding, &[Reason::HomeReached]).is_some(),
            misses_overflow: miss_limit > 0 && self.miss_bucket >= miss_limit,
            suspended: reason_in(Mode::Stopped, &[Reason::Suspended]).is_some(),
            wait: reason_in(
                Mode::Holding,
                &[
                    Reason::InputsStale,
                    Reason::ObstacleSourceSilent,
                    Reason::ReferenceTooFar,
                ],
            ),
            fault: self.fault(
                record,
                reason_in(
                    Mode::Faulted,
                    &[
                        Reason::MeasurementLost,
                        Reason::MeasurementJump,
                        Reason::MeasurementFrozen,
                        Reason::CommonMode,
                        // By the measured bends.
                        Reason::ClearanceBroken,
                        Reason::LimitBroken,
                    ],
                ),
            ),
        }
    }

    /// Determines the fault, in the daemon's order of checks.
    fn fault(
        &self,
        record: &Telemetry,
        recorded_reason: Option<safety::Reason>,
    ) -> Option<safety::Reason> {
        if record.measurement.kind == MeasurementKind::None.code() {
            return None;
        }
        let is_measured = recorded_reason
            .filter(|recorded_reason| *recorded_reason != safety::Reason::LimitBroken);
        if is_measured.is_some() {
            return is_measured;
        }
        if self.clearance_m < record.clearance_fault_m {
            return Some(safety::Reason::ClearanceBroken);
        }
        let errors_rad = record.following_error_rad.iter();
        let largest_rad = errors_rad.copied().fold(0.0, f64::max);
        let is_in_control = !self.machine.mode().is_latched() && record.control_begins == 0;
        if is_in_control && largest_rad > record.following_fault_rad {
            return Some(safety::Reason::FollowingError);
        }
        if record.bend_rad.iter().any(|bend| !bend.is_finite()) {
            return Some(safety::Reason::NonFinite);
        }
        recorded_reason
    }
}

/// The mode of a record; `None` when a code is unknown.
fn recorded_mode(record: &Telemetry) -> Option<safety::Mode> {
    let reason = Reason::try_from(record.reason).ok()?;
    Some(mode_of(record.mode.try_into().ok()?, reason.into()))
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::EventKind;

    use super::*;

    /// A stopped robot, and the cycle after it in which a request was granted; `change` adds what it saw.
    fn difference(
        kind: RequestKind,
        granted: (Mode, Reason),
        change: impl Fn(&mut Telemetry),
    ) -> bool {
        let before = match granted.0 {
            Mode::Tracking => (Mode::Holding, Reason::Request),
            _ => (Mode::Stopped, Reason::Request),
        };
        let [stopped, mut after] = [before, granted].map(|(mode, reason)| {
            let mut record = Telemetry {
                mode: mode.code(),
                reason: reason.code(),
                clearance_m: f64::INFINITY,
                following_fault_rad: 1.0,
                lease_state: codes::LeaseState::Held.code(),
                ..Telemetry::default()
            };
            record.measurement.kind = MeasurementKind::Configuration.code();
            record.reference.state = codes::ReferenceState::Inside.code();
            record
        });
        change(&mut after);
        let request = InputEvent {
            kind: EventKind::Request.code(),
            detail: kind.code(),
            ..InputEvent::default()
        };
        let mut modes = Modes::default();
        assert_eq!(modes.check(&stopped, &[]), None);
        modes.check(&after, &[request]).is_some()
    }

    #[test]
    fn a_request_that_was_granted_wrongly_is_a_difference() {
        let reset = |kind, change: fn(&mut Telemetry)| {
            difference(kind, (Mode::Holding, Reason::Request), change)
        };
        let (plain, accepting) = (RequestKind::Reset, RequestKind::ResetAcceptingPose);
        for kind in [plain, accepting] {
            assert!(!reset(kind, |_| ()));
            assert!(reset(kind, |record| record.measurement_rejected = 1));
            assert!(reset(kind, |record| record.tip_contradiction_m = 0.12));
        }
        assert!(reset(plain, |record| record.pose_differs = 1));
        assert!(!reset(accepting, |record| record.pose_differs = 1));
        let track = |change: fn(&mut Telemetry)| {
            difference(
                RequestKind::Track,
                (Mode::Tracking, Reason::Request),
                change,
            )
        };
        assert!(!track(|_| ()));
        assert!(track(|record| record.reference_too_far = 1));
    }
}
