//! Streams a trajectory to the daemon in chunks, ahead of time.
//!
//! [`schedule`] decides which points are due, [`watch`] evaluates the daemon's telemetry;
//! both are pure. Only [`Feeder`] uses the clock and the ports.

mod error;
mod options;
mod schedule;
mod watch;

pub use error::FeedError;
pub use options::FeedOptions;

use std::ops::ControlFlow;
use std::thread;
use std::time::Duration;

use cdcr_shared_types::codes::{ChunkMode, Interpolation, RequestKind};
use cdcr_shared_types::limits::REFERENCE_AHEAD_S_MAX;
use cdcr_shared_types::{Service, Telemetry};

use crate::{
    Connection, Lease, ReferenceFeed, RequestError, TelemetryStream, Trajectory, monotonic_ns,
};
use schedule::Schedule;
use watch::FeedWatch;

/// Time between two iterations of the feed: about one cycle of the daemon, less for a short lease.
const TURN_MAX: Duration = Duration::from_millis(5);
const TURN_MIN: Duration = Duration::from_millis(1);
/// Time without an outcome of the first chunk, or without telemetry and answers, after which the feed fails.
const TIMEOUT_NS: u64 = 1_000_000_000;
/// Time without telemetry after which the feed fails although the daemon answers. Telemetry is sent by a
/// thread that other load may delay; the control does not wait for it.
const TELEMETRY_TIMEOUT_NS: u64 = 10_000_000_000;
/// Time after the end of a tracked reference for the daemon to report that end.
const END_GRACE_NS: u64 = 500_000_000;

/// The longest trajectory that can be fed \[s\]: a day.
pub const DURATION_MAX_S: f64 = REFERENCE_AHEAD_S_MAX as f64;

/// Event of a running feed.
#[derive(Debug)]
#[non_exhaustive]
pub enum FeedEvent<'a> {
    /// The start of the trajectory is scheduled.
    Scheduled {
        /// Time 0 of the trajectory \[ns, `CLOCK_MONOTONIC`\].
        start_ns: u64,
    },
    /// A telemetry record; every record that arrives during the feed.
    Record(&'a Telemetry),
    /// Progress, once per iteration of the feed: at least every 5 ms.
    Progress(FeedProgress),
}

/// Progress of a feed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeedProgress {
    /// Time played since the start of the trajectory \[s\]; 0 before it begins.
    pub played_s: f64,
    /// Duration of the trajectory \[s\].
    pub duration_s: f64,
    /// Points sent.
    pub sent_points: u64,
    /// Points of the whole trajectory.
    pub points: u64,
    /// Whether the daemon is tracking it.
    pub tracking: bool,
}

/// How a feed ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FeedEnd {
    /// The trajectory was played to its end.
    Played,
    /// The observer ended the feed.
    Interrupted,
}

/// Result of a feed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeedReport {
    /// How it ended.
    pub end: FeedEnd,
    /// Time 0 of the trajectory \[ns, `CLOCK_MONOTONIC`\].
    pub start_ns: u64,
    /// Time of its last point \[ns, `CLOCK_MONOTONIC`\].
    pub end_ns: u64,
    /// Points sent.
    pub points: u64,
    /// Chunks sent.
    pub chunks: u64,
    /// Whether the daemon tracked it.
    pub tracked: bool,
    /// Telemetry records lost by the feeder.
    pub lost_records: u64,
}

/// Streams one trajectory; created by [`Connection::feed`]. It holds the lease until it is dropped.
pub struct Feeder<'c> {
    connection: &'c Connection,
    trajectory: &'c dyn Trajectory,
    options: FeedOptions,
    lease: Lease<'c>,
    port: ReferenceFeed,
    telemetry: TelemetryStream,
}

impl Connection {
    /// Prepares to stream `trajectory` to the daemon ahead of time; see [`Feeder::run`].
    ///
    /// # Errors
    /// When the options are out of range, or the lease or a port is not available.
    pub fn feed<'c>(
        &'c self,
        trajectory: &'c dyn Trajectory,
        options: FeedOptions,
    ) -> Result<Feeder<'c>, FeedError> {
        Feeder::open(self, trajectory, options)
    }
}

impl<'c> Feeder<'c> {
    pub(crate) fn open(
        connection: &'c Connection,
        trajectory: &'c dyn Trajectory,
        options: FeedOptions,
    ) -> Result<Self, FeedError> {
        options.check()?;
        Ok(Self {
            connection,
            trajectory,
            options,
            port: connection.reference_feed()?,
            telemetry: connection.telemetry()?,
            lease: connection.acquire_lease()?,
        })
    }

    /// Feeds the trajectory until it has been played, then gives the lease back.
    ///
    /// `observer` gets all events and ends the feed with `ControlFlow::Break`. It runs between iterations,
    /// while the reference is ahead and nothing waits for it. It must leave time to renew the lease: an
    /// observer that takes longer than the lease (see [`Lease::left`]) loses it.
    ///
    /// # Errors
    /// When a chunk is refused, the daemon leaves tracking or stops sending, or a request fails.
    pub fn run(
        mut self,
        mut observer: impl FnMut(FeedEvent<'_>) -> ControlFlow<()>,
    ) -> Result<FeedReport, FeedError> {
        let now_ns = monotonic_ns();
        let mut state = FeedState {
            schedule: Schedule::new(self.trajectory, &self.options, now_ns)?,
            watch: FeedWatch::new(self.connection.sender_id(), self.lease.grant()),
            record_arrived_ns: now_ns,
            renewed_ns: now_ns,
            last_release_ns: now_ns,
            begun_ns: now_ns,
            track_requested: false,
        };
        let start_ns = state.schedule.start_ns();
        let mut flow = observer(FeedEvent::Scheduled { start_ns });
        while flow.is_continue() && !state.is_over(monotonic_ns()) {
            self.send_due(&mut state)?;
            flow = self.read_records(&mut state, &mut observer)?;
            // Right after all records were read: after a suspension of this program, queued records prove
            // that the daemon was not silent.
            state.check_timeouts(self.connection, monotonic_ns())?;
            self.track_once(&mut state)?;
            self.renew(&mut state)?;
            if flow.is_continue() {
                flow = observer(FeedEvent::Progress(state.progress(self.trajectory)));
                thread::sleep(turn(self.lease.left()));
            }
        }
        if self.options.track && flow.is_continue() && !state.watch.is_tracking() {
            // After a suspension of this program the records of its end may still be queued.
            flow = self.read_records(&mut state, &mut observer)?;
            let holds = !self.lease.is_expired(monotonic_ns());
            state.check_tracked(flow, holds, self.telemetry.lost())?;
        }
        Ok(state.report(flow, self.telemetry.lost()))
    }

    /// Sends all due chunks.
    fn send_due(&self, state: &mut FeedState) -> Result<(), FeedError> {
        loop {
            let first_point = state.schedule.sent();
            let points = state.schedule.next_chunk(monotonic_ns());
            if points.is_empty() {
                return Ok(());
            }
            let mode = if first_point == 0 {
                ChunkMode::Replace
            } else {
                ChunkMode::Append
            };
            let interpolation: Interpolation = self.options.interpolation;
            let header = self.port.send(mode, interpolation, &points)?;
            state.watch.sent(header.sequence, first_point);
        }
    }

    /// Reads all queued records.
    fn read_records(
        &mut self,
        state: &mut FeedState,
        observer: &mut impl FnMut(FeedEvent<'_>) -> ControlFlow<()>,
    ) -> Result<ControlFlow<()>, FeedError> {
        while let Some(record) = self.telemetry.try_next()? {
            state.record_arrived_ns = monotonic_ns();
            state.last_release_ns = record.release_ns;
            let flow = observer(FeedEvent::Record(&record));
            state.watch.evaluate(&record, &state.schedule)?;
            if flow.is_break() {
                return Ok(flow);
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Requests tracking once, after the first chunk is accepted.
    fn track_once(&self, state: &mut FeedState) -> Result<(), FeedError> {
        if self.options.track && !state.track_requested && state.watch.is_accepted() {
            let tracked = self.connection.request(RequestKind::Track);
            tracked.map_err(|error| {
                let is_over = monotonic_ns() > state.schedule.end_ns();
                FeedError::not_tracked(error, state.played_s(), is_over)
            })?;
            state.track_requested = true;
        }
        Ok(())
    }

    /// Renews the lease when that is due, or to check a silent daemon.
    fn renew(&self, state: &mut FeedState) -> Result<(), FeedError> {
        let now_ns = monotonic_ns();
        if now_ns < self.lease.renewal_due_ns() && state.silent_ns(now_ns) < TIMEOUT_NS / 2 {
            return Ok(());
        }
        match self.lease.renew() {
            Ok(_) => {
                state.renewed_ns = monotonic_ns();
                Ok(())
            }
            Err(RequestError::Restarted) => Err(state.restarted()),
            Err(error) => Err(error.into()),
        }
    }
}

/// Sleep of one iteration: a fifth of the lease time `left`, within bounds.
fn turn(left: Duration) -> Duration {
    (left / 5).clamp(TURN_MIN, TURN_MAX)
}

/// State of a running feed.
struct FeedState<'t> {
    schedule: Schedule<'t>,
    watch: FeedWatch,
    /// Arrival of the last record.
    record_arrived_ns: u64,
    /// Last renewal of the lease.
    renewed_ns: u64,
    /// Release of the last record.
    last_release_ns: u64,
    begun_ns: u64,
    /// Whether tracking has been requested.
    track_requested: bool,
}

impl FeedState<'_> {
    fn is_over(&self, now_ns: u64) -> bool {
        let end_ns = self.schedule.end_ns();
        let waits_for_end = self.watch.is_tracking() && !self.watch.is_ended();
        // Only a record shows that the reference was tracked to its end.
        now_ns > end_ns && (!waits_for_end || self.last_release_ns > end_ns + END_GRACE_NS)
    }

    /// Time since the last record or answer.
    fn silent_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.record_arrived_ns.max(self.renewed_ns))
    }

    fn check_timeouts(&self, connection: &Connection, now_ns: u64) -> Result<(), FeedError> {
        let no_record_ns = now_ns.saturating_sub(self.record_arrived_ns);
        if self.silent_ns(now_ns) > TIMEOUT_NS || no_record_ns > TELEMETRY_TIMEOUT_NS {
            let waited = Duration::from_nanos(no_record_ns);
            return Err(connection.silent(Service::Telemetry, waited).into());
        }
        if !self.watch.is_accepted() && self.last_release_ns > self.begun_ns + TIMEOUT_NS {
            return Err(FeedError::Ignored);
        }
        Ok(())
    }

    /// Fails where a reference that was to be tracked has passed and was not, while the lease was held or not.
    fn check_tracked(
        &self,
        flow: ControlFlow<()>,
        holds_lease: bool,
        lost_records: u64,
    ) -> Result<(), FeedError> {
        // The daemon has accepted the request to track; the records of that may be among those that were lost.
        let is_unknown = self.track_requested && lost_records > 0;
        if flow.is_break() || self.watch.is_tracking() || is_unknown {
            return Ok(());
        }
        let played_s = self.played_s();
        Err(if holds_lease {
            FeedError::TooLate { played_s }
        } else {
            FeedError::LeaseLost { played_s }
        })
    }

    fn restarted(&self) -> FeedError {
        let played_s = self.played_s();
        FeedError::Restarted { played_s }
    }

    fn played_s(&self) -> f64 {
        self.schedule.played_s(monotonic_ns())
    }

    fn progress(&self, trajectory: &dyn Trajectory) -> FeedProgress {
        FeedProgress {
            played_s: self.played_s(),
            duration_s: trajectory.duration_s(),
            sent_points: self.schedule.sent(),
            points: self.schedule.points(),
            tracking: self.watch.is_tracking() && !self.watch.is_ended(),
        }
    }

    fn report(&self, flow: ControlFlow<()>, lost_records: u64) -> FeedReport {
        FeedReport {
            end: match flow {
                ControlFlow::Continue(()) => FeedEnd::Played,
                ControlFlow::Break(()) => FeedEnd::Interrupted,
            },
            start_ns: self.schedule.start_ns(),
            end_ns: self.schedule.end_ns(),
            points: self.schedule.sent(),
            chunks: self.watch.chunks(),
            tracked: self.watch.is_tracking(),
            lost_records,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Spiral;
    use crate::lease::Grant;

    #[test]
    fn a_reference_that_was_not_tracked_names_the_lease_only_where_that_was_lost() {
        let spiral = Spiral::for_sections(&[0.3]);
        let grant = Grant {
            daemon_id: 3,
            asked_ns: 0,
        };
        let mut state = FeedState {
            schedule: Schedule::new(&spiral, &FeedOptions::default(), 0).expect("valid"),
            watch: FeedWatch::new(7, grant),
            record_arrived_ns: 0,
            renewed_ns: 0,
            last_release_ns: 0,
            begun_ns: 0,
            track_requested: false,
        };
        let go_on = ControlFlow::Continue(());
        let held = state.check_tracked(go_on, true, 0);
        assert!(matches!(held, Err(FeedError::TooLate { .. })), "{held:?}");
        let lost = state.check_tracked(go_on, false, 5);
        assert!(matches!(lost, Err(FeedError::LeaseLost { .. })), "{lost:?}");
        assert!(state.check_tracked(ControlFlow::Break(()), true, 0).is_ok());
        // The records that show it tracking were lost.
        state.track_requested = true;
        assert!(state.check_tracked(go_on, false, 5).is_ok());
        assert!(state.check_tracked(go_on, true, 0).is_err());
    }

    #[test]
    fn a_turn_is_at_most_a_fifth_of_the_lease() {
        for (left_ms, turn_ms) in [(0, 1), (20, 4), (25, 5), (60_000, 5)] {
            let left = Duration::from_millis(left_ms);
            assert_eq!(turn(left), Duration::from_millis(turn_ms));
        }
    }
}
