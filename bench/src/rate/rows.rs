//! What the rates say, a row for each period and each case.

use serde::Serialize;

use super::case::Case;
use super::figures::Figures;
use super::trial::Trial;
use super::{Shortest, Step};
use crate::metric::{median, range};

/// The shortest period of one case, as a row of JSON and CSV.
#[derive(Serialize)]
pub(super) struct ShortestRow<'a> {
    #[serde(flatten)]
    pub(super) case: Case,
    pub(super) shortest_period_ms: Option<f64>,
    pub(super) rate_hz: Option<f64>,
    pub(super) trials_held: usize,
    pub(super) trials: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) held: Option<&'a Trial>,
    pub(super) failed_period_ms: Option<f64>,
    pub(super) failed_trials_held: usize,
    pub(super) failed_trials: usize,
    pub(super) failed_remarks: Option<&'a str>,
}

/// The default with one period: medians over the rounds.
#[derive(Serialize)]
pub(super) struct StepRow {
    pub(super) period_ms: f64,
    pub(super) rate_hz: f64,
    pub(super) rounds: usize,
    pub(super) rounds_held: usize,
    pub(super) wake_p50_us: f64,
    pub(super) wake_p99_us: f64,
    pub(super) solve_p50_us: f64,
    pub(super) response_p50_us: f64,
    pub(super) response_p99_us: f64,
    pub(super) response_p999_us: f64,
    pub(super) core_share: f64,
    pub(super) budget_hit_share: f64,
    pub(super) stale_input_share: f64,
    pub(super) error_p99_mm: f64,
    pub(super) cycles: u64,
    pub(super) own_misses: u64,
    pub(super) late_cycles: u64,
    pub(super) deadline_misses: u64,
    pub(super) skipped_periods: u64,
    /// Of all releases of all rounds.
    pub(super) lost_share: f64,
    pub(super) dropped_records: u64,
    pub(super) tracking_share_least: f64,
    pub(super) remarks: String,
}

impl Shortest {
    /// The shortest period that held \[ms\].
    pub fn period_ms(&self) -> Option<f64> {
        self.held.as_ref().map(|trial| trial.period_ms)
    }

    pub(super) fn row(&self) -> ShortestRow<'_> {
        let failed = self.failed.as_ref();
        ShortestRow {
            case: self.case,
            shortest_period_ms: self.period_ms(),
            rate_hz: self.period_ms().map(rate_hz),
            trials_held: self.held_tally.held,
            trials: self.held_tally.trials,
            held: self.held.as_ref(),
            failed_period_ms: failed.map(|trial| trial.period_ms),
            failed_trials_held: self.failed_tally.held,
            failed_trials: self.failed_tally.trials,
            failed_remarks: failed.map(|trial| trial.remarks.as_str()),
        }
    }
}

impl Step {
    /// One value of each round in which the robot followed.
    pub(super) fn values(&self, value: impl Fn(&Figures) -> f64) -> Vec<f64> {
        self.measured().map(value).collect()
    }

    pub(super) fn measured(&self) -> impl Iterator<Item = &Figures> {
        self.rounds
            .iter()
            .filter_map(|trial| trial.figures.as_ref())
    }

    pub(super) fn row(&self) -> StepRow {
        let middle = |value: fn(&Figures) -> f64| median(&self.values(value)).unwrap_or(f64::NAN);
        let sum = |count: fn(&Figures) -> u64| -> u64 { self.measured().map(count).sum() };
        let tracking = range(&self.values(|f| f.tracking_share));
        StepRow {
            period_ms: self.period_ms,
            rate_hz: rate_hz(self.period_ms),
            rounds: self.rounds.len(),
            rounds_held: self.rounds.iter().filter(|trial| trial.holds).count(),
            wake_p50_us: middle(|f| f.wake_us.p50),
            wake_p99_us: middle(|f| f.wake_us.p99),
            solve_p50_us: middle(|f| f.solve_us.p50),
            response_p50_us: middle(|f| f.response_us.p50),
            response_p99_us: middle(|f| f.response_us.p99),
            response_p999_us: middle(|f| f.response_us.p999),
            core_share: middle(Figures::core_share),
            budget_hit_share: middle(|f| f.budget_hit_share),
            stale_input_share: middle(|f| f.stale_input_share),
            error_p99_mm: middle(|f| f.error_p99_mm),
            cycles: sum(|f| f.cycles),
            own_misses: sum(|f| f.causes.own()),
            late_cycles: sum(|f| f.causes.all()),
            deadline_misses: sum(|f| f.deadline_misses),
            skipped_periods: sum(|f| f.skipped_periods),
            lost_share: sum(Figures::lost) as f64 / sum(Figures::due).max(1) as f64,
            dropped_records: sum(|f| f.dropped_records),
            tracking_share_least: tracking.map_or(0.0, |(least, _)| least),
            remarks: self.remarks(),
        }
    }

    /// Those of the first round that did not hold, or else of the last one.
    fn remarks(&self) -> String {
        let failed = self.rounds.iter().find(|trial| !trial.holds);
        let told = failed.or(self.rounds.last());
        told.map_or_else(String::new, |trial| trial.remarks.clone())
    }
}

pub(super) fn rate_hz(period_ms: f64) -> f64 {
    1e3 / period_ms
}
