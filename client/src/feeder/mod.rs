//! Streams a trajectory to the daemon in chunks, ahead of time.
//!
//! [`schedule`](schedule) decides which points are due, [`watch`](watch) judges what the daemon makes
//! of them; both are pure. Only [`Feeder`] knows the clock and the ports.

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
use cdcr_shared_types::{Service, Telemetry};

use crate::{
    Connection, Lease, ReferenceFeed, RequestError, TelemetryStream, Trajectory, monotonic_ns,
};
use schedule::Schedule;
use watch::Watch;

/// How often the feeder looks after everything: about once a cycle of the daemon, more often when the
/// lease is short.
const TURN_MAX: Duration = Duration::from_millis(5);
const TURN_MIN: Duration = Duration::from_millis(1);
/// How long the daemon may take no notice, or neither send telemetry nor answer, before the feed gives up.
const TIMEOUT_NS: u64 = 1_000_000_000;
/// How long the daemon may only answer: its telemetry leaves by a thread that others can hold up, and the control does not wait for it.
const TELEMETRY_TIMEOUT_NS: u64 = 10_000_000_000;
/// How long after its end a tracked reference may take to be reported as ended.
const END_GRACE_NS: u64 = 500_000_000;

/// What a feed tells while it runs.
#[derive(Debug)]
#[non_exhaustive]
pub enum FeedEvent<'a> {
    /// The trajectory begins at this time of the daemon's clock.
    Scheduled {
        /// Time 0 of the trajectory \[ns, `CLOCK_MONOTONIC`\].
        start_ns: u64,
    },
    /// A record of the daemon; every one that arrives while the feed runs.
    Record(&'a Telemetry),
    /// Every 5 ms or a little more often: how far it is.
    Progress(FeedProgress),
}

/// How far a feed is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeedProgress {
    /// Time played since the start of the trajectory \[s\]; 0 before it begins.
    pub played_s: f64,
    /// How long the trajectory lasts \[s\].
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
    /// The observer said stop.
    Interrupted,
}

/// What a feed did.
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
    /// Telemetry records that were lost on the way to the feeder.
    pub lost_records: u64,
}

/// Streams one trajectory; made by [`Connection::feed`]. It holds the reference lease until it is
/// dropped.
pub struct Feeder<'c> {
    connection: &'c Connection,
    trajectory: &'c dyn Trajectory,
    options: FeedOptions,
    lease: Lease<'c>,
    port: ReferenceFeed,
    telemetry: TelemetryStream,
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

    /// Feeds the trajectory until it has been played, and gives the lease back.
    ///
    /// `observer` sees everything that happens and ends the feed by `ControlFlow::Break`. It runs
    /// between the turns, where the reference is ahead and nothing waits for it, but it must leave time to
    /// renew the lease: what takes longer than the daemon's lease (see [`Lease::left`]) loses it.
    ///
    /// # Errors
    /// When a chunk is refused, the daemon leaves tracking or falls silent, or a request fails.
    pub fn run(
        mut self,
        mut observer: impl FnMut(FeedEvent<'_>) -> ControlFlow<()>,
    ) -> Result<FeedReport, FeedError> {
        let now_ns = monotonic_ns();
        let mut state = FeedState {
            schedule: Schedule::new(self.trajectory, &self.options, now_ns)?,
            watch: Watch::new(self.connection.sender_id(), self.lease.grant()),
            heard_ns: now_ns,
            answered_ns: now_ns,
            released_ns: now_ns,
            begun_ns: now_ns,
            asked: false,
        };
        let start_ns = state.schedule.start_ns();
        let mut flow = observer(FeedEvent::Scheduled { start_ns });
        while flow.is_continue() && !state.is_over(monotonic_ns()) {
            self.send_due(&mut state)?;
            flow = self.listen(&mut state, &mut observer)?;
            // Right after all records were read: a program that was stopped for longer has not heard the daemon fall silent.
            state.check_patience(self.connection, monotonic_ns())?;
            self.track_once(&mut state)?;
            self.renew(&mut state)?;
            if flow.is_continue() {
                flow = observer(FeedEvent::Progress(state.progress(self.trajectory)));
                thread::sleep(turn(self.lease.left()));
            }
        }
        Ok(state.report(flow, self.telemetry.lost()))
    }

    /// Sends every chunk that is due.
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

    /// Reads all records that wait.
    fn listen(
        &mut self,
        state: &mut FeedState,
        observer: &mut impl FnMut(FeedEvent<'_>) -> ControlFlow<()>,
    ) -> Result<ControlFlow<()>, FeedError> {
        while let Some(record) = self.telemetry.try_next()? {
            state.heard_ns = monotonic_ns();
            state.released_ns = record.release_ns;
            let flow = observer(FeedEvent::Record(&record));
            state.watch.look(&record, &state.schedule)?;
            if flow.is_break() {
                return Ok(flow);
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Asks for tracking when the reference is there.
    fn track_once(&self, state: &mut FeedState) -> Result<(), FeedError> {
        if self.options.track && !state.asked && state.watch.is_accepted() {
            self.connection.request(RequestKind::Track)?;
            state.asked = true;
        }
        Ok(())
    }

    /// Renews the lease when that is due, or when it has to be known whether the daemon lives.
    fn renew(&self, state: &mut FeedState) -> Result<(), FeedError> {
        let now_ns = monotonic_ns();
        if now_ns < self.lease.renewal_due_ns() && state.silent_ns(now_ns) < TIMEOUT_NS / 2 {
            return Ok(());
        }
        match self.lease.renew() {
            Ok(_) => {
                state.answered_ns = monotonic_ns();
                Ok(())
            }
            Err(RequestError::Restarted { .. }) => Err(state.restarted()),
            Err(error) => Err(error.into()),
        }
    }
}

/// How long to sleep when the lease runs for `left`: at most a fifth of it.
fn turn(left: Duration) -> Duration {
    (left / 5).clamp(TURN_MIN, TURN_MAX)
}

/// What changes while a feed runs.
struct FeedState<'t> {
    schedule: Schedule<'t>,
    watch: Watch,
    /// When the last record arrived.
    heard_ns: u64,
    /// When the lease was renewed last.
    answered_ns: u64,
    /// Release of the last record.
    released_ns: u64,
    begun_ns: u64,
    /// Whether tracking has been asked for.
    asked: bool,
}

impl FeedState<'_> {
    fn is_over(&self, now_ns: u64) -> bool {
        let end_ns = self.schedule.end_ns();
        let waits_for_end = self.watch.is_tracking() && !self.watch.is_ended();
        // Only a record can tell that it went to its end.
        now_ns > end_ns && (!waits_for_end || self.released_ns > end_ns + END_GRACE_NS)
    }

    /// How long neither a record nor an answer came.
    fn silent_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.heard_ns.max(self.answered_ns))
    }

    fn check_patience(&self, connection: &Connection, now_ns: u64) -> Result<(), FeedError> {
        let unheard_ns = now_ns.saturating_sub(self.heard_ns);
        if self.silent_ns(now_ns) > TIMEOUT_NS || unheard_ns > TELEMETRY_TIMEOUT_NS {
            let waited = Duration::from_nanos(unheard_ns);
            return Err(connection.silent(Service::Telemetry, waited).into());
        }
        if !self.watch.is_accepted() && self.released_ns > self.begun_ns + TIMEOUT_NS {
            return Err(FeedError::Ignored);
        }
        Ok(())
    }

    fn restarted(&self) -> FeedError {
        let played_s = self.schedule.played_s(monotonic_ns());
        FeedError::Restarted { played_s }
    }

    fn progress(&self, trajectory: &dyn Trajectory) -> FeedProgress {
        FeedProgress {
            played_s: self.schedule.played_s(monotonic_ns()),
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

    #[test]
    fn a_turn_is_at_most_a_fifth_of_the_lease() {
        for (left_ms, turn_ms) in [(0, 1), (20, 4), (25, 5), (60_000, 5)] {
            let left = Duration::from_millis(left_ms);
            assert_eq!(turn(left), Duration::from_millis(turn_ms));
        }
    }
}
