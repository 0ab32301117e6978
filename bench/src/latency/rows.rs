//! What a run found about each leg, a row each.

use hdrhistogram::Histogram;
use serde::Serialize;

use super::leg::Leg;
use super::round::Round;
use crate::closed_loop::quantile_us;
use crate::metric::median;
use crate::quantiles::Quantiles;

/// Values without which a 99th percentile is no more than the largest of them.
pub(super) const VALUES_OF_P99: u64 = 100;
pub(super) const VALUES_OF_P999: u64 = 1000;

#[derive(Debug, Clone, Serialize)]
pub struct Row {
    pub leg: Leg,
    pub from: &'static str,
    pub to: &'static str,
    pub samples: u64,
    pub latency_us: Quantiles,
    pub rounds_us: Middle,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Middle {
    pub p50: f64,
    pub p99: f64,
}

#[derive(Debug, Clone, Serialize)]
pub(super) struct RoundRow {
    pub(super) round: usize,
    pub(super) leg: Leg,
    pub(super) samples: u64,
    pub(super) latency_us: Quantiles,
}

/// A leg of the daemon beside one of iceoryx2 alone, each round by itself.
#[derive(Debug, Clone, Serialize)]
pub struct Ratio {
    pub leg: Leg,
    pub to: Leg,
    /// Ratio of the medians: its median over the rounds.
    pub p50: f64,
    pub rounds: Vec<f64>,
}

/// A bound that a leg shall keep at the 99th percentile.
#[derive(Debug, Clone, Serialize)]
pub struct Target {
    pub leg: Leg,
    /// Values of which the percentile is.
    pub samples: u64,
    pub limit_us: f64,
    pub p99_us: f64,
    pub kept: bool,
}

impl Target {
    pub(super) fn cells(&self) -> Vec<String> {
        let verdict = match (self.samples < VALUES_OF_P99, self.kept) {
            (true, _) => "too few values",
            (false, true) => "kept",
            (false, false) => "not kept",
        };
        let found = format!("{:.1}", self.p99_us);
        vec![
            format!("{} p99, µs", self.leg.name()),
            supported(found, self.samples, VALUES_OF_P99),
            format!("bound {:.1}: {verdict}", self.limit_us),
        ]
    }
}

/// A percentile for people: none of fewer values than it needs.
pub(super) fn supported(percentile: String, count: u64, least: u64) -> String {
    if count < least {
        "-".to_owned()
    } else {
        percentile
    }
}

pub(super) fn row(leg: Leg, rounds: &[Round]) -> Option<Row> {
    let all = pooled(leg, rounds)?;
    let of = |quantile| {
        let values = rounds
            .iter()
            .filter_map(|round| quantile_of(round, leg, quantile));
        median(&values.collect::<Vec<_>>())
    };
    let (from, to) = leg.definition();
    Some(Row {
        leg,
        from,
        to,
        samples: all.len(),
        latency_us: Quantiles::of(&all)?,
        rounds_us: Middle {
            p50: of(0.5)?,
            p99: of(0.99)?,
        },
    })
}

/// All rounds together; none without rounds.
pub(super) fn pooled(leg: Leg, rounds: &[Round]) -> Option<Histogram<u64>> {
    let mut of_rounds = rounds.iter().map(|round| &round.leg(leg).latencies);
    let mut all = of_rounds.next()?.clone();
    for latencies in of_rounds {
        // All have the same bounds.
        all.add(latencies).ok()?;
    }
    (!all.is_empty()).then_some(all)
}

pub(super) fn quantile_of(round: &Round, leg: Leg, quantile: f64) -> Option<f64> {
    let latencies = &round.leg(leg).latencies;
    (!latencies.is_empty()).then(|| quantile_us(latencies, quantile))
}

pub(super) fn p50_us(round: &Round, leg: Leg) -> Option<f64> {
    quantile_of(round, leg, 0.5)
}
