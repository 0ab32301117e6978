//! Invariant: the mode changes only along the diagram, and arrows marked "request" need an accepted request.

use std::collections::{BTreeSet, VecDeque};

use cdcr_client::events;
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{EventKind, Mode, Outcome, Reason, RequestKind};

use crate::chaos::CheckResult;

/// Cause of a change of mode.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum By {
    /// An event in the cycle.
    World,
    /// A request of a client.
    Request(RequestKind),
}

/// One arrow of the diagram.
struct Arrow {
    from: &'static [Mode],
    by: By,
    to: Mode,
    reason: Reason,
}

const MOVING: &[Mode] = &[Mode::Starting, Mode::Holding, Mode::Tracking, Mode::Homing];
const MOVING_BY_ITSELF: &[Mode] = &[Mode::Tracking, Mode::Homing];
const NOT_FAULTED: &[Mode] = &[
    Mode::Starting,
    Mode::Holding,
    Mode::Tracking,
    Mode::Homing,
    Mode::Stopped,
];
const LATCHED: &[Mode] = &[Mode::Stopped, Mode::Faulted];

const fn world(from: &'static [Mode], to: Mode, reason: Reason) -> Arrow {
    Arrow {
        from,
        by: By::World,
        to,
        reason,
    }
}

const fn request(from: &'static [Mode], kind: RequestKind, to: Mode) -> Arrow {
    Arrow {
        from,
        by: By::Request(kind),
        to,
        reason: Reason::Request,
    }
}

/// The diagram of `controller/src/safety/mode.rs`, arrow by arrow. The end of a daemon is not included,
/// because no run ends its daemon.
const ARROWS: &[Arrow] = &[
    // The first measurement.
    world(&[Mode::Starting], Mode::Holding, Reason::Start),
    // The first measurement, of a robot that was stopped before the daemon was restarted.
    world(&[Mode::Starting], Mode::Stopped, Reason::StoppedBefore),
    world(&[Mode::Starting], Mode::Stopped, Reason::ObstaclesLost),
    // The feed ended, its client fell silent or returned the lease.
    world(&[Mode::Tracking], Mode::Holding, Reason::ReferenceEnded),
    world(&[Mode::Tracking], Mode::Holding, Reason::LeaseExpired),
    world(&[Mode::Tracking], Mode::Holding, Reason::LeaseReleased),
    world(&[Mode::Tracking], Mode::Holding, Reason::ReferenceTooFar),
    // The robot is straight.
    world(&[Mode::Homing], Mode::Holding, Reason::HomeReached),
    // The exchange was delayed; a source of obstacles fell silent.
    world(MOVING_BY_ITSELF, Mode::Holding, Reason::InputsStale),
    world(
        MOVING_BY_ITSELF,
        Mode::Holding,
        Reason::ObstacleSourceSilent,
    ),
    // The machine was suspended; the leaky bucket is full.
    world(MOVING, Mode::Stopped, Reason::Suspended),
    world(MOVING, Mode::Stopped, Reason::DeadlineMisses),
    // A fault of the driver, the solver, the state or the surroundings.
    world(NOT_FAULTED, Mode::Faulted, Reason::MeasurementLost),
    world(NOT_FAULTED, Mode::Faulted, Reason::MeasurementJump),
    world(NOT_FAULTED, Mode::Faulted, Reason::MeasurementFrozen),
    world(NOT_FAULTED, Mode::Faulted, Reason::NonFinite),
    world(NOT_FAULTED, Mode::Faulted, Reason::LimitBroken),
    world(NOT_FAULTED, Mode::Faulted, Reason::ClearanceBroken),
    world(NOT_FAULTED, Mode::Faulted, Reason::CommonMode),
    world(MOVING, Mode::Faulted, Reason::FollowingError),
    // Requests of clients. A stop does not change a fault.
    request(NOT_FAULTED, RequestKind::Stop, Mode::Stopped),
    request(LATCHED, RequestKind::Reset, Mode::Holding),
    request(LATCHED, RequestKind::ResetAcceptingPose, Mode::Holding),
    request(&[Mode::Holding], RequestKind::Track, Mode::Tracking),
    request(
        &[Mode::Holding, Mode::Homing],
        RequestKind::Home,
        Mode::Homing,
    ),
    request(
        &[Mode::Holding, Mode::Tracking, Mode::Homing],
        RequestKind::Hold,
        Mode::Holding,
    ),
];

pub(crate) type ModeReason = (Mode, Reason);

pub(crate) fn place(record: &Telemetry) -> Result<ModeReason, String> {
    let known = |unknown: cdcr_shared_types::codes::UnknownCode| unknown.to_string();
    let mode = Mode::try_from(record.mode).map_err(known)?;
    Ok((mode, Reason::try_from(record.reason).map_err(known)?))
}

/// Adds the places reached by one arrow that satisfies `may`.
fn step(places: &mut BTreeSet<ModeReason>, may: impl Fn(&Arrow) -> bool) {
    let leaving = |arrow: &&Arrow| may(arrow) && places.iter().any(|p| arrow.from.contains(&p.0));
    let reached: Vec<_> = ARROWS
        .iter()
        .filter(leaving)
        .map(|arrow| (arrow.to, arrow.reason))
        .collect();
    places.extend(reached);
}

/// Whether one cycle can lead from one place to the other. It allows at most one change by an event, then its
/// accepted requests, then at most one fault found by its solve.
fn one_cycle_leads(from: ModeReason, to: ModeReason, accepted: &[RequestKind]) -> bool {
    let mut places = BTreeSet::from([from]);
    step(&mut places, |arrow| arrow.by == By::World);
    for _ in accepted {
        step(
            &mut places,
            |arrow| matches!(arrow.by, By::Request(kind) if accepted.contains(&kind)),
        );
    }
    step(&mut places, |arrow| {
        arrow.by == By::World && arrow.to == Mode::Faulted
    });
    places.contains(&to)
}

/// Whether any number of cycles with any requests can do so, for records with missing ones in between.
fn some_cycles_lead(from: ModeReason, to: ModeReason) -> bool {
    let mut places = BTreeSet::from([from]);
    for _ in ARROWS {
        step(&mut places, |_| true);
    }
    places.contains(&to)
}

/// A change that waits for the events with its cause.
#[derive(Debug, Clone, Copy)]
struct Change {
    from: ModeReason,
    to: ModeReason,
    cycle: u64,
    gather: u64,
    number: u64,
}

/// Checks the modes of all records. Events may be some records late, so each change is checked when they have
/// come.
#[derive(Debug, Default)]
pub(crate) struct ModeWatch {
    waiting: VecDeque<Change>,
    accepted: VecDeque<(u64, RequestKind)>,
    last: Option<ModeReason>,
    records: u64,
    /// Number of the last record after a gap.
    gap: Option<u64>,
    /// Stops without a request in any record, and their largest number: `cdcrctl stop` sends a signal when
    /// its answer is late.
    signals: u64,
    signals_max: u64,
}

/// Records that a change waits for its events. After a stall, the daemon reports at most 24 events in each
/// record.
const TIMEOUT_RECORDS: u64 = 100;

impl ModeWatch {
    /// Takes a record; `is_neighbour`: nothing was lost before it.
    pub(crate) fn look(&mut self, record: &Telemetry, is_neighbour: bool) -> CheckResult {
        self.records += 1;
        if !is_neighbour {
            self.gap = Some(self.records);
        }
        self.note_requests(record);
        let to = place(record)?;
        if let Some(from) = self.last.replace(to)
            && from != to
        {
            self.waiting.push_back(Change {
                from,
                to,
                cycle: record.cycle,
                gather: record.gather,
                number: self.records,
            });
        }
        while let Some(change) = self.waiting.front()
            && change.number + TIMEOUT_RECORDS < self.records
        {
            self.check_oldest()?;
        }
        Ok(())
    }

    /// Sets the number of started `cdcrctl stop`.
    pub(crate) fn may_have_signals(&mut self, most: u64) {
        self.signals_max = most;
    }

    /// Checks the remaining changes.
    pub(crate) fn finish(&mut self) -> CheckResult {
        while !self.waiting.is_empty() {
            self.check_oldest()?;
        }
        Ok(())
    }

    fn note_requests(&mut self, record: &Telemetry) {
        for event in events(record) {
            let is_accepted = event.kind == EventKind::Request.code()
                && event.outcome == Outcome::Accepted.code();
            if let (true, Ok(kind)) = (is_accepted, RequestKind::try_from(event.detail)) {
                let gather = record.gather - u64::from(event.gathers_ago);
                self.accepted.push_back((gather, kind));
            }
        }
    }

    fn check_oldest(&mut self) -> CheckResult {
        let Some(change) = self.waiting.pop_front() else {
            return Ok(());
        };
        while self
            .accepted
            .front()
            .is_some_and(|(gather, _)| *gather < change.gather)
        {
            self.accepted.pop_front();
        }
        // Records lost since then may have contained the events.
        let is_whole = self.gap.is_none_or(|gap| gap < change.number);
        let of_cycle = self
            .accepted
            .iter()
            .filter(|(gather, _)| *gather == change.gather);
        let kinds: Vec<_> = of_cycle.map(|(_, kind)| *kind).collect();
        let Change {
            from, to, cycle, ..
        } = change;
        let leads = if is_whole {
            one_cycle_leads(from, to, &kinds)
        } else {
            some_cycles_lead(from, to)
        };
        let is_signal = one_cycle_leads(from, to, &[RequestKind::Stop]);
        if leads {
            Ok(())
        } else if is_signal && self.signals < self.signals_max {
            self.signals += 1;
            Ok(())
        } else {
            Err(format!(
                "cycle {cycle}: from {from:?} to {to:?} with the requests {kinds:?} of gather {}, lost records: {}; accepted after it: {:?}",
                change.gather, !is_whole, self.accepted
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLDING: ModeReason = (Mode::Holding, Reason::Request);
    const TRACKING: ModeReason = (Mode::Tracking, Reason::Request);
    const STOPPED: ModeReason = (Mode::Stopped, Reason::Request);

    #[test]
    fn a_cycle_goes_along_the_arrows_only() {
        let track = [RequestKind::Track];
        assert!(one_cycle_leads(HOLDING, TRACKING, &track));
        assert!(!one_cycle_leads(HOLDING, TRACKING, &[]), "nobody asked");
        let both = [RequestKind::Reset, RequestKind::Track];
        assert!(one_cycle_leads(STOPPED, TRACKING, &both));
        assert!(!one_cycle_leads(STOPPED, TRACKING, &track), "it is latched");
        assert!(!one_cycle_leads(STOPPED, HOLDING, &[]), "it is latched");
        let lost = (Mode::Faulted, Reason::MeasurementLost);
        assert!(one_cycle_leads(TRACKING, lost, &[]));
        assert!(!one_cycle_leads(lost, STOPPED, &[RequestKind::Stop]));
        let ended = (Mode::Holding, Reason::ReferenceEnded);
        assert!(one_cycle_leads(TRACKING, ended, &[]));
        assert!(!one_cycle_leads(HOLDING, ended, &[]), "nothing ended");
        let start = (Mode::Starting, Reason::Start);
        assert!(!some_cycles_lead(HOLDING, start), "there is one start");
        assert!(some_cycles_lead(STOPPED, TRACKING));
    }

    fn record(number: u64, place: ModeReason) -> Telemetry {
        Telemetry {
            cycle: number,
            gather: number,
            mode: place.0.code(),
            reason: place.1.code(),
            ..Telemetry::default()
        }
    }

    #[test]
    fn a_change_waits_for_its_event() {
        let checked = |says_so: bool| {
            let mut watch = ModeWatch::default();
            watch.look(&record(1, STOPPED), true).unwrap();
            watch.look(&record(2, HOLDING), true).unwrap();
            let mut later = record(3, HOLDING);
            later.event_count = u32::from(says_so);
            later.events[0].kind = EventKind::Request.code();
            later.events[0].detail = RequestKind::Reset.code();
            later.events[0].gathers_ago = 1;
            watch.look(&later, true).unwrap();
            watch.finish()
        };
        assert_eq!(checked(true), Ok(()));
        assert!(checked(false).is_err());
    }

    #[test]
    fn a_signal_stops_as_often_as_one_may_have_been_sent() {
        let checked = |most: u64| {
            let mut watch = ModeWatch::default();
            watch.may_have_signals(most);
            watch.look(&record(1, HOLDING), true).unwrap();
            watch.look(&record(2, STOPPED), true).unwrap();
            watch.finish()
        };
        assert!(checked(0).is_err());
        assert_eq!(checked(1), Ok(()));
        let mut watch = ModeWatch::default();
        watch.may_have_signals(1);
        watch.look(&record(1, STOPPED), true).unwrap();
        watch.look(&record(2, HOLDING), true).unwrap();
        assert!(watch.finish().is_err(), "it resets nothing");
    }
}
