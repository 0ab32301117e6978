//! The measured legs, each from one time stamp to another, and their latencies in one round.

use std::collections::BTreeMap;

use cdcr_client::monotonic_ns;
use serde::Deserialize;

use crate::dataset::Recording;
use crate::quantiles::histogram;

#[derive(Debug, Deserialize)]
pub struct Declared {
    pub legs: Vec<[String; 3]>,
    pub panels: Vec<(String, Vec<String>)>,
    pub ratios: Vec<[String; 2]>,
    pub bound: Vec<String>,
}

pub fn declared() -> Declared {
    toml::from_str(super::DECLARATION).expect("a declaration")
}

pub(super) struct Round {
    /// Stops without a result: a record or command is missing, or the robot was hardly moving.
    pub(super) spoilt_stops: u64,
    /// Samples whose command the client did not receive, because it was away too long.
    pub(super) without_command: u64,
    began_ns: u64,
    pub(super) legs: BTreeMap<String, Recording>,
}

/// Times at which a message was sent, gathered and answered \[ns, `CLOCK_MONOTONIC`\].
pub(super) type Passage = [u64; 3];

impl Round {
    pub(super) fn new(began_ns: u64) -> Self {
        Self {
            spoilt_stops: 0,
            without_command: 0,
            began_ns,
            legs: BTreeMap::new(),
        }
    }

    pub(super) fn record(&mut self, leg: &str, latency_ns: u64) {
        let now_s = monotonic_ns().saturating_sub(self.began_ns) as f64 * 1e-9;
        let recording = self.legs.entry(leg.to_owned());
        let recording = recording.or_insert_with(|| Recording {
            tag: leg.to_owned(),
            start_s: now_s,
            duration_s: 0.0,
            histogram_ns: histogram(),
        });
        recording.duration_s = now_s - recording.start_s;
        recording.histogram_ns.saturating_record(latency_ns);
    }

    /// Adds a whole leg, its wait for the grid (none if it came during the gather), and the machinery.
    pub(super) fn record_way(&mut self, whole: &str, passage: Passage) {
        let [sent_ns, gather_ns, received_ns] = passage;
        let whole_ns = received_ns.saturating_sub(sent_ns);
        let grid_ns = gather_ns.saturating_sub(sent_ns).min(whole_ns);
        let way = whole.split('.').next().unwrap_or_default();
        self.record(whole, whole_ns);
        self.record(&format!("{way}.grid"), grid_ns);
        self.record(&format!("{way}.machinery"), whole_ns - grid_ns);
    }
}
