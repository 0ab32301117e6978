//! One subject under one load: all its rounds, and what they come to together.

use std::collections::BTreeMap;

use anyhow::Result;
use serde::Serialize;

use super::Setup;
use super::segment::{Segment, Subject};
use super::tally::{Counts, PerTime, Tally, TimeQuantiles};
use crate::load::{Done, Load};
use crate::quantiles::Quantiles;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Key {
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

    /// All rounds together, their medians, and the rounds themselves.
    pub fn row(&self) -> CaseRow {
        let shares = self.rounds.iter().filter_map(|r| r.segment.tracking_share);
        let budget_hits = self.rounds.iter().map(|round| round.segment.budget_hits);
        let rounds = self.rounds.iter().map(|r| r.segment.tally.quantiles());
        let rounds: Vec<TimeQuantiles> = rounds.collect();
        let index = PerTime {
            wake: 0,
            compute: 1,
            response: 2,
            command: 3,
        };
        let median_of_rounds = index.map(|time| {
            let of_time = rounds.iter().filter_map(|times| *times.named()[*time].1);
            Quantiles::over_rounds(&of_time.collect::<Vec<_>>())
        });
        CaseRow {
            load: self.key.load,
            set_up: self.key.setup,
            subject: self.key.subject,
            realtime: self.key.setup == Setup::Realtime,
            counts: self.total.counts,
            budget_hits: budget_hits.sum(),
            times: self.total.quantiles(),
            median_of_rounds,
            tracking_share: shares.reduce(f64::min),
            rounds: self.round_rows(),
        }
    }

    pub fn round_rows(&self) -> Vec<RoundRow> {
        let rounds = self.rounds.iter().enumerate();
        let row = |(index, round): (usize, &Round)| {
            let Segment { tally, load, .. } = &round.segment;
            RoundRow {
                load: self.key.load,
                subject: self.key.subject,
                realtime: self.key.setup == Setup::Realtime,
                round: index + 1,
                start_s: round.start_s,
                counts: tally.counts,
                times: tally.quantiles(),
                load_did: *load,
            }
        };
        rounds.map(row).collect()
    }
}

#[derive(Debug, Serialize)]
pub struct CaseRow {
    load: Load,
    set_up: Setup,
    subject: Subject,
    realtime: bool,
    #[serde(flatten)]
    counts: Counts,
    budget_hits: u64,
    #[serde(flatten)]
    times: TimeQuantiles,
    median_of_rounds: TimeQuantiles,
    tracking_share: Option<f64>,
    rounds: Vec<RoundRow>,
}

#[derive(Debug, Serialize)]
pub struct RoundRow {
    load: Load,
    subject: Subject,
    realtime: bool,
    round: usize,
    start_s: f64,
    #[serde(flatten)]
    counts: Counts,
    #[serde(flatten)]
    times: TimeQuantiles,
    load_did: Done,
}
