//! One daemon with one period, tracking: what it reaches.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use cdcr_client::{Connection, FeedError, TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::Mode;
use cdcr_shared_types::{Status, Telemetry};
use hdrhistogram::Histogram;
use serde::Serialize;

use super::case::{Case, Stage};
use super::trial_metrics::{TrialMetrics, Verdict};
use crate::causes::Causes;
use crate::interrupt;
use crate::quantiles::{Quantiles, histogram};
use crate::subject::daemon::Daemon;
use crate::subject::tracking::{DOES_NOT_FOLLOW, Tracking};
use crate::system::counts::{core_share, threads};

/// Between the begin of tracking and that of the measurement.
const WARM_UP: Duration = Duration::from_millis(300);
/// How often the records are read: far more often than their queue of 256 fills at 10 kHz.
const READ_EVERY: Duration = Duration::from_millis(2);
/// A robot that does not follow with so long a period, or a longer one, does not fail because of the rate: the
/// set-up is broken \[ms\].
const EASY_MS: f64 = 2.0;
/// How long the status with the last cycles may take. Generous: machines stall.
const STATUS_TIMEOUT: Duration = Duration::from_secs(5);
/// What start, begin of tracking, warm-up and end take, about \[s\].
const AROUND_S: f64 = 1.0;

/// How long a trial measures: the longer of both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    pub least_s: f64,
    pub least_periods: u32,
}

impl Length {
    /// How long it measures with this period \[s\].
    pub fn measured_s(&self, period_ms: f64) -> f64 {
        let periods_s = f64::from(self.least_periods) * period_ms * 1e-3;
        self.least_s.max(periods_s)
    }

    /// How long a trial takes altogether, about \[s\].
    pub fn whole_s(&self, period_ms: f64) -> f64 {
        self.measured_s(period_ms) + AROUND_S
    }
}

#[derive(Debug, Clone, Serialize)]
pub struct Trial {
    #[serde(flatten)]
    pub case: Case,
    pub period_ms: f64,
    /// How long before each release it spun \[µs\].
    pub spin_us: f64,
    pub holds: bool,
    pub remarks: String,
    /// What was measured; none when the robot did not follow its reference all the time.
    #[serde(flatten)]
    pub metrics: Option<TrialMetrics>,
    #[serde(skip)]
    pub tag: String,
    /// Responses of the cycles whose records a client got \[ns\].
    #[serde(skip)]
    pub responses: Histogram<u64>,
    /// When the measurement began, on the clock of the daemon \[ns\].
    #[serde(skip)]
    pub begin_ns: u64,
}

impl Trial {
    /// Starts a daemon, lets it track, and measures.
    pub fn run(stage: &Stage, case: Case, period_ms: f64, length: Length) -> Result<Self> {
        let daemon = Daemon::start(&stage.launch(&case, period_ms), &stage.cores)?;
        let begin_ns = monotonic_ns();
        let measured_s = length.measured_s(period_ms);
        let observed = observe(&daemon, stage, Duration::from_secs_f64(measured_s));
        let observed = daemon.stop().and(observed);
        interrupt::check()?;
        let mut trial = Self {
            case,
            period_ms,
            spin_us: stage.spin_within_us(period_ms),
            holds: false,
            remarks: String::new(),
            metrics: None,
            tag: format!("{}.{:.0}-hz.response", case.solver.name(), 1e3 / period_ms),
            responses: histogram()?,
            begin_ns,
        };
        match observed {
            Ok((metrics, records)) => {
                trial.holds = metrics.verdict(period_ms) == Verdict::Holds;
                trial.remarks = metrics.remarks(period_ms);
                trial.metrics = Some(metrics);
                trial.responses = records.responses;
                trial.begin_ns = records.begin_ns;
            }
            Err(error) if period_ms < EASY_MS && did_not_follow(&error) => {
                trial.remarks = format!("did not follow: {}", one_line(&error));
            }
            Err(error) => return Err(error),
        }
        Ok(trial)
    }

    /// Whether it says, as the `count`-th trial of its period, whether that holds. A robot that did not follow has
    /// no second trial.
    pub fn decides(&self, count: usize) -> bool {
        let metrics = self.metrics.as_ref();
        let trials = metrics.map_or(1, |metrics| metrics.verdict(self.period_ms).trials());
        count >= trials
    }
}

/// Whether this error says that the robot does not follow; every other one says nothing about the period.
fn did_not_follow(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let feed = cause.downcast_ref::<FeedError>();
        feed.is_some_and(|feed| matches!(feed, FeedError::LeftTracking { .. }))
            || cause.to_string().starts_with(DOES_NOT_FOLLOW)
    })
}

fn one_line(error: &anyhow::Error) -> String {
    let text = format!("{error:#}");
    text.lines().next().unwrap_or_default().to_owned()
}

fn observe(daemon: &Daemon, stage: &Stage, length: Duration) -> Result<(TrialMetrics, Records)> {
    let tracking = Tracking::start(daemon.location(), stage.cores.client())?;
    let connection = daemon.connect()?;
    let mut telemetry = connection.telemetry()?;
    // Whoever connects makes the daemon map memory: that belongs to the warm-up.
    interrupt::sleep(WARM_UP)?;
    while telemetry.try_next()?.is_some() {}

    let mut records = Records::begin()?;
    connection.reset_statistics()?;
    let (before, begin) = (threads(daemon.id()), Instant::now());
    let status = records.watch(&mut telemetry, &connection, length)?;
    let (after, passed) = (threads(daemon.id()), begin.elapsed());
    tracking.stop()?;
    let share = |name: &str| core_share(&before, &after, name, passed);
    let metrics = TrialMetrics {
        cycle_core_share: share("cdcr-cycle"),
        exchange_core_share: share("cdcr-exchange"),
        ..records.metrics(&status)?
    };
    Ok((metrics, records))
}

struct Records {
    begin_ns: u64,
    responses: Histogram<u64>,
    received: u64,
    tracking: u64,
    errors_m: Vec<f64>,
}

impl Records {
    fn begin() -> Result<Self> {
        Ok(Self {
            begin_ns: monotonic_ns(),
            responses: histogram()?,
            received: 0,
            tracking: 0,
            errors_m: Vec::new(),
        })
    }

    /// Until the statistics, which begin anew a moment after they were asked to, count for as long as `length`.
    fn watch(
        &mut self,
        telemetry: &mut TelemetryStream,
        connection: &Connection,
        length: Duration,
    ) -> Result<Status> {
        let length_ns = length.as_nanos() as u64;
        let deadline = Instant::now() + length + STATUS_TIMEOUT;
        while Instant::now() < deadline {
            interrupt::check()?;
            while let Some(record) = telemetry.try_next()? {
                self.take(&record);
            }
            let status = connection.status(STATUS_TIMEOUT)?;
            let since_ns = status.statistics_since_ns;
            if since_ns >= self.begin_ns && status.header.sent_ns >= since_ns + length_ns {
                return Ok(status);
            }
            std::thread::sleep(READ_EVERY);
        }
        anyhow::bail!("the daemon did not reset its statistics, or sends no status")
    }

    fn take(&mut self, record: &Telemetry) {
        self.received += 1;
        let response_ns = record.handed_over_ns.saturating_sub(record.due_ns);
        self.responses.saturating_record(response_ns);
        if record.mode == Mode::Tracking.code() {
            self.tracking += 1;
            self.errors_m.push(record.position_error_m);
        }
    }

    /// Together with what the daemon counted; nothing of the use of the core.
    fn metrics(&mut self, status: &Status) -> Result<TrialMetrics> {
        let reported = &status.since_reset;
        let share = |count: u64, of: u64| count as f64 / of.max(1) as f64;
        let times = |summary| Quantiles::reported(summary).context("the daemon ran no cycle");
        self.errors_m.sort_by(f64::total_cmp);
        Ok(TrialMetrics {
            duration_s: (status.header.sent_ns - status.statistics_since_ns) as f64 * 1e-9,
            cycles: reported.cycles,
            late_starts: reported.late_starts,
            deadline_misses: reported.deadline_misses,
            skipped_periods: reported.skipped_periods,
            causes: Causes::reported(reported),
            budget_hit_share: share(reported.budget_hits, reported.cycles),
            stale_input_share: share(reported.stale_inputs, reported.cycles),
            dropped_records: reported.dropped_records,
            wake_us: times(&reported.wake)?,
            solve_us: times(&reported.solve)?,
            compute_us: times(&reported.compute)?,
            response_us: times(&reported.response)?,
            cycle_core_share: 0.0,
            exchange_core_share: 0.0,
            tracking_share: share(self.tracking, self.received),
            error_p50_mm: quantile_mm(&self.errors_m, 0.5),
            error_p99_mm: quantile_mm(&self.errors_m, 0.99),
        })
    }
}

/// A quantile of sorted distances \[mm\]; not a number of none.
fn quantile_mm(sorted_m: &[f64], quantile: f64) -> f64 {
    let last = sorted_m.len().saturating_sub(1);
    let index = (quantile * last as f64).round() as usize;
    sorted_m
        .get(index)
        .map_or(f64::NAN, |error_m| error_m * 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_robot_that_does_not_follow_did_not_follow() {
        let left = FeedError::LeftTracking {
            played_s: 1.0,
            mode: "holding",
            reason: "deadline misses",
            remedy: "",
        };
        let wrapped = |error: FeedError| anyhow::Error::new(error).context("the feed");
        assert!(did_not_follow(&wrapped(left)));
        assert!(!did_not_follow(&wrapped(FeedError::Restarted {
            played_s: 1.0
        })));
        assert!(!did_not_follow(&anyhow::anyhow!(
            "the daemon ended by itself"
        )));
        let slow = anyhow::anyhow!("{DOES_NOT_FOLLOW} within 10 s");
        assert!(did_not_follow(&slow));
    }

    #[test]
    fn a_trial_is_as_long_as_both_limits_ask() {
        let length = Length {
            least_s: 2.0,
            least_periods: 4000,
        };
        assert!((length.measured_s(5.0) - 20.0).abs() < 1e-9);
        assert!((length.measured_s(0.1) - 2.0).abs() < 1e-9);
        assert!(length.whole_s(0.1) > 2.0);
    }

    #[test]
    fn quantiles_of_errors_are_in_millimetres() {
        let errors_m: Vec<f64> = (0..=100).map(|index| f64::from(index) * 1e-3).collect();
        assert!((quantile_mm(&errors_m, 0.5) - 50.0).abs() < 1e-9);
        assert!((quantile_mm(&errors_m, 0.99) - 99.0).abs() < 1e-9);
        assert!(quantile_mm(&[], 0.5).is_nan());
    }
}
