//! One subject under one load: all its rounds, and what they come to together.

use std::collections::BTreeMap;

use anyhow::Result;
use serde::Serialize;

use super::Setup;
use super::segment::{Segment, Subject};
use super::tally::{Counts, Tally, TimeQuantiles};
use crate::load::{Done, Load};
use crate::metric::median;
use crate::quantiles::Quantiles;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Key {
    /// How the threads were set up.
    pub setup: Setup,
    pub load: Load,
    pub subject: Subject,
}

#[derive(Debug)]
pub struct Round {
    /// When it began, after the start of the run \[s\].
    pub start_s: f64,
    pub segment: Segment,
}

/// All rounds of one subject under one load.
#[derive(Debug)]
pub struct Case {
    pub key: Key,
    pub rounds: Vec<Round>,
    pub total: Tally,
}

pub type Cases = BTreeMap<Key, Case>;

impl Case {
    pub fn new(key: Key) -> Result<Self> {
        Ok(Self {
            key,
            rounds: Vec::new(),
            total: Tally::new()?,
        })
    }

    pub fn push(&mut self, round: Round) -> Result<()> {
        self.total.add(&round.segment.tally)?;
        self.rounds.push(round);
        Ok(())
    }

    /// One number of each round; rounds that lack it are left out.
    pub fn each(&self, value: impl Fn(&TimeQuantiles) -> Option<f64>) -> Vec<f64> {
        let rounds = self.rounds.iter();
        rounds
            .filter_map(|round| value(&round.segment.tally.quantiles()))
            .collect()
    }

    pub fn row(&self) -> Row {
        let shares = self.rounds.iter().filter_map(|r| r.segment.tracking_share);
        let budget_hits = self.rounds.iter().map(|round| round.segment.budget_hits);
        Row {
            load: self.key.load,
            subject: self.key.subject,
            realtime: self.key.setup == Setup::Realtime,
            counts: self.total.counts,
            budget_hits: budget_hits.sum(),
            times: self.total.quantiles(),
            median_of_rounds: Medians::of(self),
            tracking_share: shares.reduce(f64::min),
            rounds: self.rounds.iter().map(RoundRow::of).collect(),
        }
    }
}

/// A case as JSON: counts and latencies of all rounds together, the medians of the rounds, and the rounds.
#[derive(Debug, Serialize)]
pub struct Row {
    load: Load,
    subject: Subject,
    realtime: bool,
    #[serde(flatten)]
    counts: Counts,
    pub(super) budget_hits: u64,
    #[serde(flatten)]
    times: TimeQuantiles,
    median_of_rounds: Medians,
    pub(super) tracking_share: Option<f64>,
    rounds: Vec<RoundRow>,
}

#[allow(
    clippy::struct_field_names,
    reason = "the keys of the JSON end with their unit"
)]
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Medians {
    pub wake_p50_us: Option<f64>,
    pub wake_p99_us: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub response_p99_us: Option<f64>,
    /// Median of release → command in the client's hands.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command_p50_us: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub command_p99_us: Option<f64>,
}

impl Medians {
    /// Of all rounds of a case.
    fn of(case: &Case) -> Self {
        let p50 = |q: Option<Quantiles>| q.map(|q| q.p50);
        let p99 = |q: Option<Quantiles>| q.map(|q| q.p99);
        Self {
            wake_p50_us: median(&case.each(|t| p50(t.wake_us))),
            wake_p99_us: median(&case.each(|t| p99(t.wake_us))),
            response_p99_us: median(&case.each(|t| p99(t.response_us))),
            command_p50_us: median(&case.each(|t| p50(t.command_us))),
            command_p99_us: median(&case.each(|t| p99(t.command_us))),
        }
    }
}

#[derive(Debug, Serialize)]
struct RoundRow {
    start_s: f64,
    #[serde(flatten)]
    counts: Counts,
    #[serde(flatten)]
    times: TimeQuantiles,
    load_did: Done,
}

impl RoundRow {
    fn of(round: &Round) -> Self {
        let Segment { tally, load, .. } = &round.segment;
        Self {
            start_s: round.start_s,
            counts: tally.counts,
            times: tally.quantiles(),
            load_did: *load,
        }
    }
}
