//! One subject under one load: all its rounds, and what they come to together.

use std::collections::BTreeMap;

use anyhow::Result;
use serde_json::{Value, json, to_value};

use super::Setup;
use super::segment::{Segment, Subject};
use super::tally::{COMMAND, COMPUTE, RESPONSE, Tally, TimeQuantiles, WAKE, times_json};
use crate::dataset::joined;
use crate::load::Load;
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
    pub fn row(&self) -> Result<Value> {
        let shares = self.rounds.iter().filter_map(|r| r.segment.tracking_share);
        let budget_hits = self.rounds.iter().map(|round| round.segment.budget_hits);
        let rounds = self.rounds.iter().map(|r| r.segment.tally.quantiles());
        let rounds: Vec<TimeQuantiles> = rounds.collect();
        let median_of_rounds = [WAKE, COMPUTE, RESPONSE, COMMAND].map(|time| {
            let of_time = rounds.iter().filter_map(|times| times[time]);
            Quantiles::over_rounds(&of_time.collect::<Vec<_>>())
        });
        let own = json!({
            "set_up": self.key.setup,
            "budget_hits": budget_hits.sum::<u64>(),
            "median_of_rounds": times_json(median_of_rounds),
            "tracking_share": shares.reduce(f64::min),
            "rounds": self.round_rows()?,
        });
        self.told(own, &self.total)
    }

    pub fn round_rows(&self) -> Result<Vec<Value>> {
        let rounds = self.rounds.iter().enumerate();
        let row = |(index, round): (usize, &Round)| {
            let (start_s, did) = (round.start_s, round.segment.load);
            let own = json!({ "round": index + 1, "start_s": start_s, "load_did": did });
            self.told(own, &round.segment.tally)
        };
        rounds.map(row).collect()
    }

    /// With what was measured under which load; null is what the subject does not tell: cyclictest tells neither why it
    /// was late nor how long it waited for its core, and only a daemon has clients.
    fn told(&self, own: Value, tally: &Tally) -> Result<Value> {
        const OF_CLIENTS: [&str; 3] = ["lost_records", "lost_commands", "budget_hits"];
        const OF_CAUSES: [&str; 3] = ["causes", "own_misses", "run_delay_ms"];
        let Key {
            setup,
            load,
            subject,
        } = self.key;
        let of_key = json!({
            "load": load,
            "subject": subject,
            "realtime": setup == Setup::Realtime,
        });
        let counts = to_value(tally.counts)?;
        let mut row = joined([own, of_key, counts, times_json(tally.quantiles())])?;
        let unknown = match subject {
            Subject::Daemon => Vec::new(),
            Subject::Bare => OF_CLIENTS.to_vec(),
            Subject::Cyclictest => [OF_CLIENTS, OF_CAUSES].concat(),
        };
        for key in unknown {
            if let Some(value) = row.get_mut(key) {
                *value = Value::Null;
            }
        }
        Ok(row)
    }
}
