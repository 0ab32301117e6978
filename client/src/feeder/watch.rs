use cdcr_shared_types::codes::{EventKind, Mode, Outcome, Reason};
use cdcr_shared_types::{InputEvent, Telemetry};

use super::{FeedError, schedule::Schedule};
use crate::events;
use crate::lease::Grant;
use crate::remedy::reason_remedy;

/// A reference that ended earlier than this before its last point was not completed \[ns\].
const EARLY_END_NS: u64 = 50_000_000;

/// Evaluates the telemetry for one feed: outcomes of its chunks, and the mode.
#[derive(Debug)]
pub(super) struct FeedWatch {
    sender_id: u64,
    grant: Grant,
    /// Sequence number and first point of every sent chunk.
    chunks: Vec<(u64, u64)>,
    accepted: bool,
    tracking: bool,
    ended: bool,
}

impl FeedWatch {
    /// For the chunks of `sender_id`, which holds the lease by `grant`.
    pub(super) fn new(sender_id: u64, grant: Grant) -> Self {
        Self {
            sender_id,
            grant,
            chunks: Vec::new(),
            accepted: false,
            tracking: false,
            ended: false,
        }
    }

    /// Registers a sent chunk.
    pub(super) fn sent(&mut self, sequence: u64, first_point: u64) {
        self.chunks.push((sequence, first_point));
    }

    pub(super) fn chunks(&self) -> u64 {
        self.chunks.len() as u64
    }

    /// Whether the daemon has accepted the first chunk.
    pub(super) fn is_accepted(&self) -> bool {
        self.accepted
    }

    /// Whether the daemon has been tracking.
    pub(super) fn is_tracking(&self) -> bool {
        self.tracking
    }

    /// Whether the daemon has tracked the reference to its end.
    pub(super) fn is_ended(&self) -> bool {
        self.ended
    }

    /// Evaluates one record.
    pub(super) fn evaluate(
        &mut self,
        record: &Telemetry,
        schedule: &Schedule,
    ) -> Result<(), FeedError> {
        if !self.grant.is_from(&record.header) {
            return self.evaluate_other_daemon(record, schedule);
        }
        for event in events(record) {
            self.evaluate_chunk_event(event, record.release_ns, schedule)?;
        }
        match Mode::try_from(record.mode) {
            Ok(Mode::Tracking) if self.accepted => self.tracking = true,
            _ if self.tracking && !self.ended => self.evaluate_end(record, schedule)?,
            _ => {}
        }
        Ok(())
    }

    /// Evaluates a record of another daemon: an earlier one, or one that replaced the first.
    fn evaluate_other_daemon(
        &self,
        record: &Telemetry,
        schedule: &Schedule,
    ) -> Result<(), FeedError> {
        if record.header.sent_ns < self.grant.asked_ns {
            return Ok(());
        }
        let played_s = schedule.played_s(record.release_ns);
        Err(FeedError::Restarted { played_s })
    }

    fn evaluate_chunk_event(
        &mut self,
        event: &InputEvent,
        release_ns: u64,
        schedule: &Schedule,
    ) -> Result<(), FeedError> {
        let is_ours =
            event.kind == EventKind::Reference.code() && event.sender_id == self.sender_id;
        let chunk = self.chunks.iter().find(|chunk| chunk.0 == event.sequence);
        let Some(&(_, first_point)) = chunk.filter(|_| is_ours) else {
            return Ok(());
        };
        match Outcome::try_from(event.outcome) {
            Ok(Outcome::Accepted) => {
                self.accepted = true;
                Ok(())
            }
            Ok(Outcome::NoLease) => {
                let played_s = schedule.played_s(release_ns);
                Err(FeedError::LeaseLost { played_s })
            }
            outcome => {
                let point = first_point + u64::from(event.detail);
                Err(FeedError::Refused {
                    outcome: outcome.unwrap_or(Outcome::UnknownCode),
                    point,
                    time_s: schedule.time_s(point),
                })
            }
        }
    }

    fn evaluate_end(&mut self, record: &Telemetry, schedule: &Schedule) -> Result<(), FeedError> {
        let at_end = record.release_ns + EARLY_END_NS >= schedule.end_ns();
        let reason = Reason::try_from(record.reason);
        if reason == Ok(Reason::ReferenceEnded) && at_end {
            self.ended = true;
            return Ok(());
        }
        Err(FeedError::LeftTracking {
            played_s: schedule.played_s(record.release_ns),
            mode: Mode::text_of(record.mode),
            reason: Reason::text_of(record.reason),
            remedy: reason.map_or("", reason_remedy),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{FeedOptions, Spiral};
    use cdcr_shared_types::Header;

    const ME: u64 = 7;
    const GRANT: Grant = Grant {
        daemon_id: 3,
        asked_ns: 500,
    };

    fn record(mode: Mode, reason: Reason, release_ns: u64) -> Telemetry {
        Telemetry {
            header: Header {
                sender_id: GRANT.daemon_id,
                sent_ns: 1_000,
                ..Header::default()
            },
            mode: mode.code(),
            reason: reason.code(),
            release_ns,
            ..Telemetry::default()
        }
    }

    fn with_event(sender_id: u64, sequence: u64, outcome: Outcome) -> Telemetry {
        let mut record = record(Mode::Holding, Reason::Start, 0);
        record.event_count = 1;
        record.events[0] = InputEvent {
            sender_id,
            sequence,
            outcome: outcome.code(),
            detail: 3,
            ..InputEvent::default()
        };
        record
    }

    fn check(test: impl FnOnce(&mut FeedWatch, &Schedule)) {
        let spiral = Spiral::for_sections(&[0.3]);
        let schedule = Schedule::new(&spiral, &FeedOptions::default(), 0).expect("valid");
        let mut watch = FeedWatch::new(ME, GRANT);
        watch.sent(1, 0);
        watch.sent(2, 128);
        test(&mut watch, &schedule);
    }

    #[test]
    fn only_outcomes_of_our_chunks_count() {
        check(|watch, schedule| {
            let evaluate = |watch: &mut FeedWatch, record| watch.evaluate(&record, schedule);
            assert!(evaluate(watch, with_event(8, 1, Outcome::NoLease)).is_ok());
            assert!(evaluate(watch, with_event(ME, 9, Outcome::NoLease)).is_ok());
            assert!(!watch.is_accepted());
            assert!(evaluate(watch, with_event(ME, 1, Outcome::Accepted)).is_ok());
            assert!(watch.is_accepted());
            let lost = evaluate(watch, with_event(ME, 2, Outcome::NoLease));
            assert_eq!(lost, Err(FeedError::LeaseLost { played_s: 0.0 }));
            let error =
                evaluate(watch, with_event(ME, 2, Outcome::OutOfReach)).expect_err("refused");
            assert_eq!(
                error,
                FeedError::Refused {
                    outcome: Outcome::OutOfReach,
                    point: 131,
                    time_s: 0.655
                }
            );
        });
    }

    #[test]
    fn the_end_of_the_reference_is_no_error_but_a_fault_is() {
        check(|watch, schedule| {
            let end_ns = schedule.end_ns();
            watch.accepted = true;
            let tracking = record(Mode::Tracking, Reason::Request, 0);
            watch.evaluate(&tracking, schedule).expect("tracking");
            assert!(watch.is_tracking());
            let faulted = record(Mode::Faulted, Reason::MeasurementLost, end_ns / 2);
            let text = watch
                .evaluate(&faulted, schedule)
                .expect_err("fault")
                .to_string();
            assert!(
                text.contains("faulted because the measurement is lost"),
                "{text}"
            );
            let early = record(Mode::Holding, Reason::ReferenceEnded, end_ns / 2);
            assert!(watch.evaluate(&early, schedule).is_err());
            let ended = record(Mode::Holding, Reason::ReferenceEnded, end_ns);
            watch.evaluate(&ended, schedule).expect("the natural end");
            assert!(watch.is_ended());
        });
    }

    #[test]
    fn another_daemon_ends_the_feed_but_what_an_earlier_one_left_does_not() {
        check(|watch, schedule| {
            let mut other = record(Mode::Holding, Reason::Start, 0);
            other.header.sender_id = 4;
            other.header.sent_ns = 499;
            assert!(watch.evaluate(&other, schedule).is_ok());
            other.header.sent_ns = 501;
            let error = watch.evaluate(&other, schedule).expect_err("restarted");
            assert_eq!(error, FeedError::Restarted { played_s: 0.0 });
        });
    }

    #[test]
    fn holding_before_tracking_is_waited_for() {
        check(|watch, schedule| {
            let holding = record(Mode::Holding, Reason::Start, 0);
            assert!(watch.evaluate(&holding, schedule).is_ok());
        });
    }
}
