//! A trial: one daemon tracking with one period, its results, and whether the period held.

use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use cdcr_client::{FeedError, LinkError, counted as count_of, monotonic_ns};
use cdcr_shared_types::Statistics;
use cdcr_shared_types::codes::Mode;
use serde_json::{Value, json};
use statrs::statistics::{Data, OrderStatistics as _};

use super::{RateCase, Stage};
use crate::causes::Causes;
use crate::dataset::{Recording, joined};
use crate::interrupt;
use crate::quantiles::{histogram, reported};
use crate::subject::TIMEOUT;
use crate::subject::daemon::Daemon;
use crate::subject::tracking::{DOES_NOT_FOLLOW, Tracking};
use crate::system::counts::{core_share, threads};

const WARM_UP: Duration = Duration::from_millis(300);
/// Interval between reads of the records: short enough that their queue of 256 does not fill at 10 kHz.
const READ_EVERY: Duration = Duration::from_millis(2);
/// With this or a longer period, a robot that does not follow fails because of the set-up \[ms\].
const EASY_MS: f64 = 2.0;
/// Restarts of a trial in which the daemon sent nothing for a second; such a trial does not rate its period.
const HELD_UP_MAX: usize = 2;
/// Share of a core beyond which the system may throttle real-time threads: Linux allows 95 %.
const FULL_PERCENT: f64 = 93.0;
/// Share of shortened solves or stale inputs from which on they are remarked.
const WORTH_A_REMARK_PERCENT: f64 = 1.0;
/// Largest share of releases without a cycle in time for a period that holds.
const LOST_MAX: f64 = 1e-3;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TrialOutcome {
    Holds,
    /// A cycle was late because of the daemon itself; decisive.
    Own,
    /// Too many releases were lost because of the machine; the work itself fits into the period.
    Machine,
    /// Too many releases were lost, without evidence that only the machine is the cause.
    Slow,
    NotFollowed,
}

impl TrialOutcome {
    /// Largest number of trials of a period when one of them ends with this outcome.
    pub(super) fn trials(self) -> usize {
        match self {
            Self::Holds | Self::Own | Self::NotFollowed => 1,
            Self::Slow => 2,
            Self::Machine => 3,
        }
    }
}

#[derive(Debug)]
pub(super) struct Trial {
    pub(super) period_ms: f64,
    pub(super) outcome: TrialOutcome,
    pub(super) row: Value,
    /// Response times of the cycles whose records were received; `None` if the robot did not follow.
    pub(super) responses: Option<Recording>,
}

impl Trial {
    pub(super) fn run(
        stage: &Stage,
        case: RateCase,
        period_ms: f64,
        measured_s: f64,
    ) -> Result<Self> {
        let spin_us = stage.spin_within_us(period_ms);
        let observe = || {
            let daemon = Daemon::start(&stage.launch(&case, period_ms), &stage.cores)?;
            let observed = observe(&daemon, stage, Duration::from_secs_f64(measured_s));
            daemon.stop().and(observed)
        };
        let mut found = observe();
        for _ in 0..HELD_UP_MAX {
            interrupt::check()?;
            if found.as_ref().is_err_and(was_held_up) {
                found = observe();
            }
        }
        interrupt::check()?;
        let (outcome, remarks, row, responses) = match found {
            Err(error) if period_ms < EASY_MS && did_not_follow(&error) => {
                let why = format!("did not follow: {error:#}");
                let why = why.lines().next().unwrap_or_default().to_owned();
                (TrialOutcome::NotFollowed, why, Value::Null, None)
            }
            found => {
                let (observed, mut responses) = found?;
                let (outcome, remarks) = (observed.outcome(period_ms), observed.remarks(period_ms));
                let (solver, hz) = (case.solver.name(), 1e3 / period_ms);
                responses.tag = format!("{solver}.{hz:.0}-hz.response");
                (outcome, remarks, observed.row(), Some(responses))
            }
        };
        let trial = Self::new(case, period_ms, spin_us, outcome, &remarks, row);
        Ok(Self { responses, ..trial })
    }

    pub(super) fn new(
        case: RateCase,
        period_ms: f64,
        spin_us: Option<f64>,
        outcome: TrialOutcome,
        remarks: &str,
        measured: Value,
    ) -> Self {
        let own = json!({
            "period_ms": period_ms,
            "period_us": 1e3 * period_ms,
            "rate_hz": 1e3 / period_ms,
            "spin_us": spin_us,
            "holds": outcome == TrialOutcome::Holds,
            "remarks": remarks,
        });
        Self {
            period_ms,
            outcome,
            row: joined([json!(case), own, measured]),
            responses: None,
        }
    }

    pub(super) fn holds(&self) -> bool {
        self.outcome == TrialOutcome::Holds
    }

    pub(super) fn remarks(&self) -> &str {
        self.row["remarks"].as_str().unwrap_or_default()
    }
}

fn feed_error(error: &anyhow::Error) -> Option<&FeedError> {
    error.chain().find_map(|cause| cause.downcast_ref())
}

/// Whether the machine stalled the whole daemon so long that its client took it for dead.
fn was_held_up(error: &anyhow::Error) -> bool {
    let error = feed_error(error);
    matches!(error, Some(FeedError::Link(LinkError::Silent { .. })))
}

/// Whether the robot did not follow; no other error rates the period.
fn did_not_follow(error: &anyhow::Error) -> bool {
    let mut words = error.chain().map(ToString::to_string);
    matches!(feed_error(error), Some(FeedError::LeftTracking { .. }))
        || words.any(|words| words.starts_with(DOES_NOT_FOLLOW))
}

#[derive(Debug, Default)]
pub(super) struct Observed {
    duration_s: f64,
    counted: Statistics,
    /// Of the cycle thread and of the exchange thread.
    core_shares: [f64; 2],
    tracking_share: f64,
    /// Distance of the tip from its reference in the received records: median and 99th percentile \[mm\].
    error_mm: [f64; 2],
}

fn observe(daemon: &Daemon, stage: &Stage, length: Duration) -> Result<(Observed, Recording)> {
    let tracking = Tracking::start(daemon.place.location(), stage.cores.client())?;
    let connection = daemon.connect()?;
    let mut telemetry = connection.telemetry()?;
    // A new client makes the daemon map memory; this belongs to the warm-up.
    interrupt::sleep(WARM_UP)?;
    while telemetry.try_next()?.is_some() {}

    let (begin_ns, mut responses) = (monotonic_ns(), histogram());
    let (mut received, mut errors_m) = (0_usize, Vec::new());
    connection.reset_statistics()?;
    let (before, begin) = (threads(daemon.process.id()), Instant::now());
    // Until the statistics cover `length`; they restart a moment after the request.
    let (length_ns, deadline) = (length.as_nanos() as u64, begin + length + TIMEOUT);
    let status = loop {
        if Instant::now() >= deadline {
            bail!("the daemon did not reset its statistics, or sends no status");
        }
        interrupt::check()?;
        while let Some(record) = telemetry.try_next()? {
            received += 1;
            responses.saturating_record(record.handed_over_ns.saturating_sub(record.due_ns));
            if record.mode == Mode::Tracking.code() {
                errors_m.push(record.position_error_m);
            }
        }
        let status = connection.status(TIMEOUT)?;
        let since_ns = status.statistics_since_ns;
        if since_ns >= begin_ns && status.header.sent_ns >= since_ns + length_ns {
            break status;
        }
        std::thread::sleep(READ_EVERY);
    };
    let (after, passed) = (threads(daemon.process.id()), begin.elapsed());
    tracking.stop()?;
    let counted = status.since_reset;
    ensure!(counted.response.count > 0, "the daemon ran no cycle");
    let duration_s = (status.header.sent_ns - status.statistics_since_ns) as f64 * 1e-9;
    let share = |name| core_share(&before, &after, name, passed);
    let tracking_share = errors_m.len() as f64 / received.max(1) as f64;
    let mut errors_m = Data::new(errors_m);
    let observed = Observed {
        duration_s,
        counted,
        core_shares: ["cdcr-cycle", "cdcr-exchange"].map(share),
        tracking_share,
        error_mm: [0.5, 0.99].map(|part| 1e3 * errors_m.quantile(part)),
    };
    let responses = Recording {
        tag: String::new(),
        start_s: (begin - stage.begun).as_secs_f64(),
        duration_s,
        histogram_ns: responses,
    };
    Ok((observed, responses))
}

impl Observed {
    fn outcome(&self, period_ms: f64) -> TrialOutcome {
        // Duration of the work of a release with the usual wake-up latency of the machine.
        let work_ns = self.counted.wake.p50_ns + self.counted.compute.p999_ns;
        let causes = Causes(self.counted.causes);
        if causes.own() > 0 {
            TrialOutcome::Own
        } else if self.lost_share() <= LOST_MAX {
            TrialOutcome::Holds
        } else if causes.all() > 0 && work_ns as f64 <= period_ms * 1e6 {
            TrialOutcome::Machine
        } else {
            TrialOutcome::Slow
        }
    }

    fn share_of_cycles(&self, count: u64) -> f64 {
        count as f64 / self.counted.cycles.max(1) as f64
    }

    /// Share of the due releases without a command in time: no cycle, or a deadline miss.
    fn lost_share(&self) -> f64 {
        let skipped = self.counted.skipped_periods;
        let due = self.counted.cycles + skipped;
        (self.counted.deadline_misses + skipped) as f64 / due.max(1) as f64
    }

    pub(super) fn row(&self) -> Value {
        let (counted, causes) = (&self.counted, Causes(self.counted.causes));
        json!({
            "duration_s": self.duration_s,
            "cycles": counted.cycles,
            "late_starts": counted.late_starts,
            "deadline_misses": counted.deadline_misses,
            "skipped_periods": counted.skipped_periods,
            "dropped_records": counted.dropped_records,
            "causes": causes,
            "own_misses": causes.own(),
            "late_cycles": causes.all(),
            "lost_share": self.lost_share(),
            "budget_hit_share": self.share_of_cycles(counted.budget_hits),
            "stale_input_share": self.share_of_cycles(counted.stale_inputs),
            "wake_us": reported(&counted.wake),
            "solve_us": reported(&counted.solve),
            "compute_us": reported(&counted.compute),
            "response_us": reported(&counted.response),
            "cycle_core_share": self.core_shares[0],
            "exchange_core_share": self.core_shares[1],
            "core_share": self.core_shares.iter().sum::<f64>(),
            "tracking_share": self.tracking_share,
            "error_p50_mm": self.error_mm[0],
            "error_p99_mm": self.error_mm[1],
        })
    }

    fn remarks(&self, period_ms: f64) -> String {
        let (counted, causes) = (&self.counted, Causes(self.counted.causes));
        let is_excused = self.outcome(period_ms) == TrialOutcome::Machine;
        let whose = if is_excused { "the machine: " } else { "" };
        let (late, skipped) = (counted.deadline_misses, counted.skipped_periods);
        let words = Some(causes.words()).filter(|words| !words.is_empty());
        let words = words.map_or(String::new(), |words| format!(" ({words})"));
        let own = causes.own();
        let percent = |share: f64| 100.0 * share;
        let core = percent(self.core_shares.iter().sum());
        let cut = percent(self.share_of_cycles(counted.budget_hits));
        let stale = percent(self.share_of_cycles(counted.stale_inputs));
        let (dropped, followed) = (counted.dropped_records, percent(self.tracking_share));
        #[rustfmt::skip]
        let remarks = [
            (own > 0, count_of(own, "own miss")),
            (self.lost_share() > LOST_MAX, format!("{whose}{late} late, {skipped} skipped{words}")),
            (core >= FULL_PERCENT, format!("core full ({core:.0} %): the system halts its threads")),
            (cut >= WORTH_A_REMARK_PERCENT, format!("{cut:.0} % of the solves cut short")),
            (stale >= WORTH_A_REMARK_PERCENT, format!("{stale:.0} % stale inputs")),
            (dropped > 0, count_of(dropped, "record") + " dropped"),
            (followed < 100.0, format!("followed in {followed:.1} %")),
        ];
        let notable = remarks.into_iter().filter(|(is_so, _)| *is_so);
        let words: Vec<String> = notable.map(|(_, words)| words).collect();
        words.join("; ")
    }
}

#[cfg(test)]
mod tests {
    use cdcr_client::Liveness;
    use cdcr_shared_types::codes::LateCause::{Compute, Load, PageFault, Platform, Stall};

    use super::*;

    #[test]
    #[rustfmt::skip]
    fn the_outcome_of_a_trial_follows_from_what_was_lost_and_why() {
        use TrialOutcome::{Holds, Machine, Own, Slow};
        let (none, stalls) = ([0; 5], [2, 0, 0, 0, 1]);
        let words = "3 late, 40 skipped (2 platform, 1 stall of the processor)";
        let excused = format!("the machine: {words}");
        let fault = "1 own miss; 0 late, 1000 skipped (10 platform, 1 page fault)";
        let mut observed = Observed { tracking_share: 1.0, ..Observed::default() };
        observed.counted.cycles = 4000;
        (observed.counted.wake.p50_ns, observed.counted.compute.p999_ns) = (10_000, 66_000);
        for (misses, skipped, causes, period_ms, outcome, remarks) in [
            (0, 0, none, 0.5, Holds, ""),
            (4, 0, none, 0.5, Holds, ""),
            (2, 2, none, 0.5, Holds, ""),
            // No evidence against the machine.
            (5, 0, none, 0.5, Slow, "5 late, 0 skipped"),
            (1, 1000, none, 0.5, Slow, "1 late, 1000 skipped"),
            (3, 40, stalls, 0.5, Machine, &*excused),
            // Wake-up of 10 µs and compute of 66 µs do not fit.
            (3, 40, stalls, 0.07, Slow, words),
            // A miss of the daemon's own is decisive.
            (0, 0, [0, 0, 1, 0, 0], 0.5, Own, "1 own miss"),
            (0, 1000, [10, 0, 0, 1, 0], 0.5, Own, fault),
            (0, 0, none, 0.5, Holds, ""),
        ] {
            (observed.counted.deadline_misses, observed.counted.skipped_periods) = (misses, skipped);
            for (cause, count) in [Platform, Load, Compute, PageFault, Stall].into_iter().zip(causes) {
                observed.counted.causes[cause.code() as usize] = count;
            }
            assert_eq!(observed.outcome(period_ms), outcome, "{observed:?}");
            assert_eq!(observed.remarks(period_ms), remarks);
        }
        // Loss of solution quality is remarked even when the period holds.
        observed.counted.budget_hits = 1600;
        (observed.core_shares, observed.tracking_share) = ([0.9, 0.1], 0.5);
        assert_eq!(observed.outcome(0.5), Holds);
        let expected = "core full (100 %): the system halts its threads; 40 % of the solves cut short; followed in 50.0 %";
        assert_eq!(observed.remarks(0.5), expected);
    }

    #[test]
    #[rustfmt::skip]
    fn only_a_robot_that_does_not_follow_did_not_follow() {
        let (played_s, waited) = (1.0, Duration::from_secs(1));
        let left = FeedError::LeftTracking { played_s, mode: "holding", reason: "deadline misses", remedy: "" };
        let silent = LinkError::Silent { service: "telemetry", waited, liveness: Liveness::Unknown };
        let fed = |error: FeedError| anyhow::Error::new(error).context("the feed");
        for (error, expected) in [
            (fed(left), [true, false]),
            (fed(FeedError::Restarted { played_s }), [false, false]),
            (fed(FeedError::Link(silent)), [false, true]),
            (anyhow::anyhow!("the daemon ended by itself"), [false, false]),
            (anyhow::anyhow!("{DOES_NOT_FOLLOW} within 10 s"), [true, false]),
        ] {
            assert_eq!([did_not_follow(&error), was_held_up(&error)], expected, "{error:#}");
        }
    }
}
