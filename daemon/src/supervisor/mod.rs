//! Slow work and text output: signals, statistics, status, incidents, watchdog, service manager, log.
//!
//! Invariant: nothing here delays the cycle. The supervisor runs on another core, if there is one, below all
//! other real-time threads. It receives the cycles through rings that never block the sender. It waits for no
//! file: the `status_thread` publishes its results.

mod late_line;
mod refusals;
mod snapshot;
mod statistics;
mod steal;
mod tip_silence;
mod watchdog;

use std::time::{Duration, Instant};

use cdcr_controller::safety::FollowingError;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{LateCause, Mode};
use cdcr_shared_types::limits::{POSE_DIFFERS_RAD, TIP_SENSOR_SILENT_MS};

use crate::config::{Validated, ns};
use crate::exit::{Ended, ExitCause};
use crate::handover::{Shared, Summary, SupervisorEnds};
use crate::rt::clock::Clock;
use crate::service_manager::{ServiceManager, StatusLine};
use crate::status_thread::StatusThread;
use refusals::{Refusals, newest_refusal};
use statistics::Statistics;
use steal::{Steal, StealMonitor};
use tip_silence::{TipNews, TipSilence};
use watchdog::Watchdog;

/// Ten periods between two checks, within this range: a check costs a wake-up with cold caches.
const PERIODS_PER_CHECK: u64 = 10;
const CHECK_INTERVAL_MIN: Duration = Duration::from_millis(20);
const CHECK_INTERVAL_MAX: Duration = Duration::from_millis(50);
const STATUS_EVERY: Duration = Duration::from_millis(100);
/// If there is no summary for this time, the status is not published: it would be out of date.
const SUMMARY_MAX: Duration = Duration::from_secs(1);
/// Shortest time between two log lines for late cycles.
const LATE_LINE_EVERY: Duration = Duration::from_secs(1);
/// Time limit for exchange and reporter to publish the last record and close their ports.
const END_MAX: Duration = Duration::from_secs(5);
/// Time over which cycles are counted for the service manager.
const RATE_EVERY: Duration = Duration::from_secs(1);

/// Monitors the threads, and reports to log, clients and service manager.
#[derive(Debug)]
pub struct Supervisor {
    ends: SupervisorEnds,
    check_interval: Duration,
    status: wire::Status,
    statistics: Statistics,
    resets: u64,
    budget_hits: u64,
    steal: StealMonitor,
    watchdog: Watchdog,
    manager: ServiceManager,
    rate: Rate,
    newest: Summary,
    summed: Instant,
    /// Time of the last log line about the following error.
    late_logged_at: Instant,
    /// Time of the last log line about a shortened solve.
    cut_logged_at: Instant,
    /// The newest late cycle that is not yet in the log.
    late: Option<Summary>,
    logged: Instant,
    tip_silence: TipSilence,
    refusals: Refusals,
}

/// Rate of the cycles.
#[derive(Debug)]
struct Rate {
    cycles: u64,
    since: Instant,
    hertz: f64,
}

impl Supervisor {
    /// The supervisor of a daemon.
    ///
    /// # Errors
    ///
    /// The memory for the statistics cannot be allocated.
    pub fn new(
        validated: &Validated,
        ends: SupervisorEnds,
        daemon_id: u64,
        clock: &impl Clock,
    ) -> anyhow::Result<Self> {
        let now = Instant::now();
        Ok(Self {
            ends,
            check_interval: check_interval(ns(validated.config.cycle.period_ms)),
            status: snapshot::first(validated, daemon_id),
            statistics: Statistics::new(clock.now_ns())?,
            resets: 0,
            budget_hits: 0,
            steal: StealMonitor::default(),
            watchdog: Watchdog::new(
                Duration::from_nanos(ns(validated.config.cycle.watchdog_ms)),
                now,
            ),
            manager: ServiceManager::from_environment(),
            rate: Rate {
                cycles: 0,
                since: now,
                hertz: 0.0,
            },
            newest: Summary::default(),
            summed: now,
            late_logged_at: now,
            cut_logged_at: now,
            late: None,
            logged: now,
            tip_silence: TipSilence::new(snapshot::has_tip_sensor(&validated.config)),
            refusals: Refusals::new(snapshot::has_tip_sensor(&validated.config)),
        })
    }

    /// Sets the privileges that the system refused, and the core of the real-time threads.
    pub fn set_realtime(&mut self, missing: u32, core: Option<usize>, clock: &impl Clock) {
        self.status.realtime_missing = missing;
        self.status.core = core.map_or(u32::MAX, |core| core as u32);
        self.steal = StealMonitor::new(core, clock);
    }

    /// Supervises the threads until `is_over`; asks them to end when `should_end`. `desk` publishes the
    /// results.
    ///
    /// # Errors
    ///
    /// A thread hangs. It cannot be joined, so the process must end.
    pub fn run(
        &mut self,
        clock: &impl Clock,
        shared: &Shared,
        desk: &StatusThread,
        mut should_end: impl FnMut() -> bool,
        mut is_over: impl FnMut() -> bool,
    ) -> Result<(), Ended> {
        let mut next_status = Instant::now();
        let mut cycle_ended = None;
        loop {
            let over = is_over();
            self.steal.begin_check(clock);
            self.take_summaries(clock);
            self.take_incidents(clock, desk);
            self.notify_service_manager(shared);
            if over || Instant::now() >= next_status {
                next_status = Instant::now() + STATUS_EVERY;
                self.publish(clock, shared);
                desk.wake();
            }
            if over {
                return Ok(());
            }
            if !shared.is_ending() && should_end() {
                tracing::info!("ending: the robot comes to rest first");
                self.manager.stopping();
                shared.end();
            }
            if shared.cycle_ended.is_set() {
                let since = *cycle_ended.get_or_insert_with(Instant::now);
                let hangs = since.elapsed() > END_MAX;
                hangs.then(ports_do_not_close).map_or(Ok(()), Err)?;
            } else {
                self.watchdog.check(shared.beats(), Instant::now())?;
            }
            // The service manager waits for the first cycle.
            let has_begun = self.newest.totals.cycles > 0;
            let rest = if has_begun {
                self.check_interval
            } else {
                CHECK_INTERVAL_MIN
            };
            sleep_unless_signalled(rest.min(next_status.saturating_duration_since(Instant::now())));
        }
    }

    fn take_summaries(&mut self, clock: &impl Clock) {
        while let Ok(mut summary) = self.ends.summaries.pop() {
            if summary.late_cause != LateCause::None.code() {
                let steal = self.steal.since(summary.due_ns, clock);
                summary.late_cause = steal.cause(summary.late_cause, summary.response_ns);
            }
            self.statistics.record(&summary);
            self.budget_hits += summary.counts.budget_hits;
            self.status.clearance_guarded += u64::from(summary.clearance_guarded);
            self.status.following_warnings += u64::from(summary.following_warning);
            self.log(&summary);
            self.log_refusals(&summary);
            self.count_tolerated(&summary);
            if !summary.lateness.deadline_miss {
                self.manager.ready();
            }
            self.newest = summary;
            self.summed = Instant::now();
        }
    }

    /// Passes on incidents to be published, while the ring has space.
    ///
    /// The reporter sends an incident before its summary. An incident without its summary waits for the next
    /// check, so that both are evaluated with the same reading of the steal.
    fn take_incidents(&mut self, clock: &impl Clock, desk: &StatusThread) {
        while !self.ends.explained.is_full()
            && let Ok(next) = self.ends.incidents.peek()
            && next.telemetry.cycle <= self.newest.cycle
            && let Ok(mut incident) = self.ends.incidents.pop()
        {
            let steal = self.steal.since(incident.telemetry.due_ns, clock);
            explain(&mut incident, steal);
            // The ring was not full.
            let _ = self.ends.explained.push(incident);
            desk.wake();
        }
    }

    fn notify_service_manager(&mut self, shared: &Shared) {
        let since = self.rate.since.elapsed();
        if since >= RATE_EVERY {
            let cycles = self.newest.totals.cycles;
            self.rate = Rate {
                hertz: (cycles - self.rate.cycles) as f64 / since.as_secs_f64(),
                cycles,
                since: Instant::now(),
            };
        }
        self.manager.feed_watchdog(shared.beats()[0]);
        if self.newest.totals.cycles > 0 && !shared.is_ending() {
            self.manager.send_status(&StatusLine {
                mode: self.newest.mode,
                reason: self.newest.reason,
                rate_hz: self.rate.hertz,
                deadline_misses: self.newest.totals.deadline_misses,
                skipped_periods: self.newest.totals.skipped_periods,
                tracking_error_m: self.newest.position_error_m,
            });
        }
    }

    /// Logs each change of mode or reason, and late cycles at most once a second.
    fn log(&mut self, summary: &Summary) {
        if has_changed_mode(summary, &self.newest) {
            let (mode, reason) = (summary.mode.text(), summary.reason.text());
            if summary.mode == Mode::Faulted {
                let place = summary.fault_place.map(|place| format!(": {place}"));
                let place = place.unwrap_or_default();
                tracing::error!(cycle = summary.cycle, reason, "{mode}: {reason}{place}");
            } else {
                tracing::info!(cycle = summary.cycle, reason, "{mode}: {reason}");
            }
        }
        let was_latched = Mode::is_latched(self.newest.mode.code());
        let is_latched = Mode::is_latched(summary.mode.code());
        if was_latched && !is_latched && summary.pose_differs {
            let pose = accepted_pose(&summary.following);
            tracing::warn!(
                cycle = summary.cycle,
                "the reset accepted a pose that differs from that of the last command{pose}"
            );
        }
        if summary.following_warning
            && !self.newest.following_warning
            && self.late_logged_at.elapsed() >= LATE_LINE_EVERY
        {
            self.late_logged_at = Instant::now();
            tracing::warn!(
                cycle = summary.cycle,
                following_error_rad = summary.following.largest_rad(),
                "following error above safety.following_warning_rad"
            );
        }
        if let Some(rejection) = summary.tip_rejected
            && rejection.is_news(self.newest.tip_rejected.as_ref())
        {
            tracing::warn!(cycle = summary.cycle, "{rejection}");
        }
        match self.tip_silence.news(summary) {
            Some(TipNews::Silent) => tracing::warn!(
                cycle = summary.cycle,
                "no tip measurement for {TIP_SENSOR_SILENT_MS} ms: continuing with the bends and the last tip offset"
            ),
            Some(TipNews::SilentForLong {
                silent_s,
                interval_s,
            }) => tracing::warn!(
                cycle = summary.cycle,
                "no tip measurement for {silent_s} s (longest gap before: {interval_s} s): check that the sensor runs"
            ),
            Some(TipNews::Missing) => tracing::warn!(
                cycle = summary.cycle,
                tips_refused = summary.inputs.refused_tips.count,
                "no tip measurement accepted yet (link.tip_sensor = \"separate\"): tip and clearance are those of the model{}",
                newest_refusal(summary.inputs.refused_tips)
            ),
            Some(TipNews::Regular) => {
                tracing::info!(cycle = summary.cycle, "the tip sensor measures regularly");
            }
            None => {}
        }
        if is_cut_short(summary)
            && !is_cut_short(&self.newest)
            && self.cut_logged_at.elapsed() >= LATE_LINE_EVERY
        {
            self.cut_logged_at = Instant::now();
            tracing::warn!(
                cycle = summary.cycle,
                "solver budget cut to less than half to fit the other parts of the cycle: {}",
                summary.core_budget.describe(summary.costs)
            );
        }
        let is_late = summary.late_cause != LateCause::None.code();
        if is_late && (summary.lateness.deadline_miss || summary.skipped_periods > 0) {
            self.late = Some(*summary);
        }
        if self.logged.elapsed() >= LATE_LINE_EVERY
            && let Some(late) = self.late.take()
        {
            self.logged = Instant::now();
            let cause = LateCause::text_of(late.late_cause);
            tracing::warn!(
                cycle = late.cycle,
                wake_us = late.wake_ns / 1000,
                response_us = late.response_ns / 1000,
                cause,
                deadline_misses = summary.totals.deadline_misses,
                skipped_periods = summary.totals.skipped_periods,
                "{}",
                late_line::text(&late, summary)
            );
        }
    }

    fn log_refusals(&mut self, summary: &Summary) {
        for (outcome, hint) in self.refusals.news(summary, &self.newest) {
            let reason = outcome.text();
            tracing::warn!(
                cycle = summary.cycle,
                reason,
                "refused a message: {reason}{hint}"
            );
        }
    }

    /// Counts how often the leaky bucket became full and the robot continued; logs the first time.
    fn count_tolerated(&mut self, summary: &Summary) {
        if !summary.misses_tolerated || self.newest.misses_tolerated {
            return;
        }
        self.status.misses_tolerated += 1;
        if self.status.misses_tolerated == 1 {
            tracing::warn!(
                cycle = summary.cycle,
                "too many deadline misses: a real robot would have been stopped, the simulated robot continues; set \
                 cycle.miss_limit to stop it as well, and see cdcrd doctor"
            );
        }
    }

    fn publish(&mut self, clock: &impl Clock, shared: &Shared) {
        let now_ns = clock.now_ns();
        let dropped = shared.dropped_records.get() + self.newest.inputs.dropped_events;
        self.statistics.advance(now_ns);
        self.statistics
            .dropped(dropped.saturating_sub(self.status.dropped_records));
        let resets = shared.statistics_resets.get();
        if resets != self.resets {
            self.resets = resets;
            self.statistics.reset(now_ns);
            tracing::info!("statistics reset");
        }
        self.status.origin_ns = shared.origin_ns();
        self.status.dropped_records = dropped;
        self.status.budget_hits = self.budget_hits;
        if self.newest.totals.cycles > 0 {
            snapshot::update(&mut self.status, &self.newest);
        }
        self.statistics.report(&mut self.status);
        if self.newest.totals.cycles > 0 && self.summed.elapsed() > SUMMARY_MAX {
            return;
        }
        self.status.header.sent_ns = now_ns;
        self.ends.status.write(self.status);
    }
}

fn check_interval(period_ns: u64) -> Duration {
    Duration::from_nanos(PERIODS_PER_CHECK * period_ns)
        .clamp(CHECK_INTERVAL_MIN, CHECK_INTERVAL_MAX)
}

/// This thread receives the signals that end the daemon or reload the configuration; they end the sleep.
fn sleep_unless_signalled(length: Duration) {
    // Always within range.
    if let Ok(length) = length.try_into() {
        let _ = rustix::thread::nanosleep(&length);
    }
}

/// The mode or its reason has changed.
fn has_changed_mode(summary: &Summary, before: &Summary) -> bool {
    (summary.mode, summary.reason) != (before.mode, before.reason)
}

/// Section and distance; only the previous daemon knew them where it left the pose uncertain.
fn accepted_pose(following: &FollowingError) -> String {
    match following.largest() {
        (section, rad) if rad > POSE_DIFFERS_RAD => format!(": section {section} by {rad:.2} rad"),
        _ => " of the previous daemon".to_owned(),
    }
}

fn is_cut_short(summary: &Summary) -> bool {
    summary.solved && summary.core_budget.is_cut_short(summary.costs)
}

fn ports_do_not_close() -> Ended {
    Ended {
        cause: ExitCause::ExchangeHung,
        message: format!(
            "exchange and reporter did not end within {} s; the robot is at rest, the process ends without them",
            END_MAX.as_secs()
        ),
    }
}

/// Adds the steal to an incident, and changes its cause if the steal explains it.
fn explain(incident: &mut wire::Incident, steal: Steal) {
    incident.steal_ns = steal.steal_ns;
    incident.steal_window_ns = steal.window_ns;
    let record = &mut incident.telemetry;
    let lateness_ns = record.handed_over_ns.saturating_sub(record.due_ns);
    let cause = &mut record.scheduling.late_cause;
    *cause = steal.cause(*cause, lateness_ns);
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::codes::Reason;

    use super::*;

    #[test]
    fn another_reason_is_news_in_the_same_mode() {
        let summary = |cycle, mode, reason| Summary {
            cycle,
            mode,
            reason,
            ..Summary::default()
        };
        let stopped = summary(1, Mode::Stopped, Reason::DeadlineMisses);
        assert!(has_changed_mode(
            &stopped,
            &summary(0, Mode::Holding, Reason::DeadlineMisses)
        ));
        assert!(has_changed_mode(
            &summary(2, Mode::Stopped, Reason::Request),
            &stopped
        ));
        assert!(!has_changed_mode(
            &summary(2, Mode::Stopped, Reason::DeadlineMisses),
            &stopped
        ));
    }

    #[test]
    fn steal_changes_the_cause_of_a_kept_cycle() {
        let steal = Steal {
            steal_ns: 10_000_000,
            window_ns: 100_000_000,
        };
        let mut incident = wire::Incident::default();
        incident.telemetry.due_ns = 5;
        incident.telemetry.handed_over_ns = 8_000_005;
        incident.telemetry.scheduling.late_cause = LateCause::Load.code();
        let before = incident.telemetry;
        explain(&mut incident, steal);
        assert_eq!(incident.steal_ns, steal.steal_ns);
        assert_eq!(incident.steal_window_ns, steal.window_ns);
        let after = incident.telemetry.scheduling;
        assert_eq!(after.late_cause, LateCause::Platform.code());
        incident.telemetry.scheduling.late_cause = before.scheduling.late_cause;
        assert_eq!(
            incident.telemetry, before,
            "all else is as its readers got it"
        );
    }
}
