//! What a run found about each leg, as rows, plots and single numbers.

use anyhow::Result;
use hdrhistogram::Histogram;
use serde::Serialize;
use serde_json::{Value, json, to_value};

use super::hands::Looks;
use super::leg::Leg;
use super::plots;
use super::round::{Round, Unmeasured};
use crate::chart::sheet;
use crate::dataset::{Column, Dataset, Plot, Recording, Sheet, fixed, plain, word};
use crate::metric::{median, range};
use crate::quantiles::{Quantiles, quantile_us};

/// What may be added to a period from a stop to zero rates \[µs\].
const STOP_MARGIN_US: f64 = 100.0;
/// Values without which a 99th percentile is no more than the largest of them.
const VALUES_OF_P99: u64 = 100;
const VALUES_OF_P999: u64 = 1000;

const EXPLANATION: &str = "<p>A client on another core sends references, obstacles, measurements, requests and stops at times that \
         are spread evenly over the period, and has every command in its hands as soon as it is there.</p>\
         <p>The daemon takes inputs in once in a period, shortly before the release: most of each way is \
         waiting for the grid, half a period on the average, whatever the machine does. <b>grid</b> is that part; \
         <b>machinery</b> is the rest: gather, release, computation and hand-over. <b>bare</b> is iceoryx2 between two \
         processes that do nothing else, measured in the same rounds. A stop is told without its ramp.</p>";

const RATIOS: [(Leg, Leg); 3] = [
    (Leg::CommandHop, Leg::BareOneWay),
    (Leg::CommandHandover, Leg::BareOneWay),
    (Leg::LeaseMachinery, Leg::BareRequest),
];

const COLUMNS: [Column; 9] = [
    word("way", "leg"),
    plain("samples", "samples"),
    fixed("min µs", "latency_us_min", 2),
    fixed("p50 µs", "latency_us_p50", 2),
    fixed("p99 µs", "latency_us_p99", 2),
    fixed("p99.9 µs", "latency_us_p999", 2),
    fixed("max µs", "latency_us_max", 2),
    fixed("median of rounds: p50 µs", "rounds_us_p50", 2),
    fixed("p99 µs", "rounds_us_p99", 2),
];

const DEFINITIONS: [Column; 3] = [word("way", "leg"), word("from", "from"), word("to", "to")];

const RATIO_COLUMNS: [Column; 4] = [
    word("way", "leg"),
    word("beside", "to"),
    fixed("p50 / p50", "p50", 2),
    fixed("rounds", "range", 2),
];

const TARGET_COLUMNS: [Column; 5] = [
    word("way", "leg"),
    plain("samples", "samples"),
    fixed("p99 µs", "p99_us", 1),
    fixed("bound µs", "limit_us", 1),
    word("kept", "kept"),
];

const UNMEASURED_COLUMNS: [Column; 4] = [
    plain("releases", "looks_all"),
    plain("client awake too late", "looks_late"),
    plain("spoilt stops, repeated", "unmeasured_spoilt_stops"),
    plain(
        "samples without a received command",
        "unmeasured_without_command",
    ),
];

#[derive(Debug, Clone, Serialize)]
pub struct Setting {
    pub rounds: usize,
    pub samples: usize,
    pub stops: usize,
    pub period_us: f64,
    /// How long before a release the daemon gathers, as its records show \[µs\].
    pub gather_lead_us: f64,
    pub realtime: bool,
    pub client_realtime: bool,
    pub realtime_core: usize,
    pub client_core: usize,
    pub looks: Looks,
}

#[derive(Debug, Clone, Serialize)]
struct LegRow {
    leg: Leg,
    from: &'static str,
    to: &'static str,
    samples: u64,
    latency_us: Quantiles,
    rounds_us: Quantiles,
    #[serde(skip)]
    fewest: u64,
}

pub(super) fn dataset(setting: &Setting, rounds: &[Round]) -> Result<Dataset> {
    let rows = Leg::ALL.iter().filter_map(|leg| row(*leg, rounds));
    let rows: Vec<LegRow> = rows.collect();
    let ratios = RATIOS.into_iter().filter_map(|pair| ratio(pair, rounds));
    let ratios: Vec<Value> = ratios.collect();
    let limit_us = setting.period_us + STOP_MARGIN_US;
    let stops = rows.iter().filter(|row| is_bound(row.leg));
    let targets: Vec<Value> = stops.map(|row| target(row, limit_us)).collect();
    let mut unmeasured = Unmeasured::default();
    for round in rounds {
        unmeasured += round.unmeasured;
    }
    let shown: Vec<Value> = rows.iter().map(shown).collect::<Result<_>>()?;
    let counts = json!({ "looks": setting.looks, "unmeasured": unmeasured });
    let mut dataset = Dataset {
        name: "latency",
        heading: "Latency: how long messages take",
        explanation: EXPLANATION,
        sheets: vec![
            Sheet::new(&shown)?.table(setting.title(), &COLUMNS),
            Sheet::new(&ratios)?.key("ratios").table(
                "Beside iceoryx2 alone: ratio of the medians",
                &RATIO_COLUMNS,
            ),
            Sheet::new(&targets)?
                .key("targets")
                .table("Stops beside their bound", &TARGET_COLUMNS),
            Sheet::new(&[counts])?.table("What was not measured", &UNMEASURED_COLUMNS),
            Sheet::new(&rows)?
                .key("legs")
                .file("latency")
                .table("From which stamp to which", &DEFINITIONS),
            Sheet::new(&round_rows(rounds))?
                .key("rounds")
                .file("latency-rounds"),
        ],
        plots: vec![Plot {
            name: "latency",
            caption: "How long messages take. The time that one sample in so many exceeds: 100 is the 99th \
                      percentile. Last: the share of stops against the time to zero rates without the ramp.",
            svg: sheet(&plots::panels(rounds, limit_us), 1, 700)?,
        }],
        ..Dataset::default()
    };
    dataset.fact("setting", to_value(setting)?);
    dataset.fact("unmeasured", to_value(unmeasured)?);
    for leg in Leg::ALL.into_iter().filter(|leg| !leg.is_grid()) {
        for (word, quantile) in [("p50", 0.5), ("p99", 0.99)] {
            let of = |round: &Round| quantile_of(round, leg, quantile);
            let name = format!("latency/{}_{word}", leg.name().replace('.', "/"));
            dataset.lower(name, "µs", rounds.iter().filter_map(of));
        }
    }
    for (leg, to) in RATIOS {
        let [name, to_name] = [leg, to].map(|leg| leg.name().replace('.', "_"));
        let name = format!("latency/{name}_per_{to_name}_p50");
        let ratios = ratios_of_rounds((leg, to), rounds);
        dataset.lower(name, "", ratios);
    }
    dataset.metrics.retain(|metric| !metric.rounds.is_empty());
    dataset.recordings = recordings(rounds);
    Ok(dataset)
}

impl Setting {
    fn title(&self) -> String {
        let threads = match (self.realtime, self.client_realtime) {
            (true, true) => "SCHED_FIFO",
            (true, false) => "SCHED_FIFO for the daemon alone",
            (false, _) => "no real-time threads: not granted",
        };
        format!(
            "Latencies of messages, period {:.1} ms, gather {:.0} µs before the release, {threads}",
            self.period_us * 1e-3,
            self.gather_lead_us
        )
    }
}

fn row(leg: Leg, rounds: &[Round]) -> Option<LegRow> {
    let all = pooled(leg, rounds)?;
    let of_rounds = rounds.iter().map(|round| &round.leg(leg).latencies);
    let quantiles: Vec<Quantiles> = of_rounds.clone().filter_map(Quantiles::of).collect();
    let (from, to) = leg.definition();
    Some(LegRow {
        leg,
        from,
        to,
        samples: all.len(),
        latency_us: Quantiles::of(&all)?,
        rounds_us: Quantiles::over_rounds(&quantiles)?,
        fewest: of_rounds.map(Histogram::len).filter(|n| *n > 0).min()?,
    })
}

/// For people: without the percentiles of fewer values than they need.
fn shown(row: &LegRow) -> Result<Value> {
    let mut value = to_value(row)?;
    for (times, key, count, least) in [
        ("latency_us", "p99", row.samples, VALUES_OF_P99),
        ("latency_us", "p999", row.samples, VALUES_OF_P999),
        ("rounds_us", "p99", row.fewest, VALUES_OF_P99),
    ] {
        if count < least {
            value[times][key] = Value::Null;
        }
    }
    Ok(value)
}

/// A leg of the daemon beside one of iceoryx2 alone.
fn ratio((leg, to): (Leg, Leg), rounds: &[Round]) -> Option<Value> {
    let rounds = ratios_of_rounds((leg, to), rounds);
    let (p50, range) = (
        median(rounds.iter().copied())?,
        range(rounds.iter().copied())?,
    );
    Some(json!({ "leg": leg, "to": to, "p50": p50, "range": range, "rounds": rounds }))
}

fn ratios_of_rounds((leg, to): (Leg, Leg), rounds: &[Round]) -> Vec<f64> {
    let of = |round: &Round| Some(quantile_of(round, leg, 0.5)? / quantile_of(round, to, 0.5)?);
    rounds.iter().filter_map(of).collect()
}

/// Whether a stop's bound is asked of it.
fn is_bound(leg: Leg) -> bool {
    matches!(leg, Leg::StopZeroHandover | Leg::StopZeroCommand)
}

/// A bound that a leg shall keep at the 99th percentile; of too few values nothing is known.
fn target(row: &LegRow, limit_us: f64) -> Value {
    let p99_us = (row.samples >= VALUES_OF_P99).then_some(row.latency_us.p99);
    json!({
        "leg": row.leg,
        "samples": row.samples,
        "limit_us": limit_us,
        "p99_us": p99_us,
        "kept": p99_us.map(|p99_us| p99_us <= limit_us),
    })
}

fn round_rows(rounds: &[Round]) -> Vec<Value> {
    let row = |(index, leg): (usize, Leg)| {
        let latencies = &rounds[index].leg(leg).latencies;
        let latency_us = Quantiles::of(latencies)?;
        let samples = latencies.len();
        Some(
            json!({ "round": index + 1, "leg": leg, "samples": samples, "latency_us": latency_us }),
        )
    };
    let all = (0..rounds.len()).flat_map(|index| Leg::ALL.map(|leg| (index, leg)));
    all.filter_map(row).collect()
}

fn recordings(rounds: &[Round]) -> Vec<Recording> {
    let all = rounds
        .iter()
        .flat_map(|round| Leg::ALL.map(|leg| (leg, round.leg(leg))));
    let recording = |(leg, sampled): (Leg, &super::round::Sampled)| {
        let (first_ns, last_ns) = sampled.span_ns?;
        Some(Recording {
            tag: leg.name().to_owned(),
            start_s: first_ns as f64 * 1e-9,
            duration_s: (last_ns - first_ns) as f64 * 1e-9,
            histogram_ns: sampled.latencies.clone(),
        })
    };
    all.filter_map(recording).collect()
}

/// All rounds together; none without samples.
pub(super) fn pooled(leg: Leg, rounds: &[Round]) -> Option<Histogram<u64>> {
    let mut of_rounds = rounds.iter().map(|round| &round.leg(leg).latencies);
    let mut all = of_rounds.next()?.clone();
    for latencies in of_rounds {
        // All have the same bounds.
        all.add(latencies).ok()?;
    }
    (!all.is_empty()).then_some(all)
}

fn quantile_of(round: &Round, leg: Leg, quantile: f64) -> Option<f64> {
    let latencies = &round.leg(leg).latencies;
    (!latencies.is_empty()).then(|| quantile_us(latencies, quantile))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setting() -> Setting {
        Setting {
            rounds: 2,
            samples: 100,
            stops: 20,
            period_us: 5000.0,
            gather_lead_us: 200.0,
            realtime: true,
            client_realtime: true,
            realtime_core: 1,
            client_core: 0,
            looks: Looks { all: 7, late: 1 },
        }
    }

    /// A round in which every leg takes 1 to 100 µs, times `factor`, and every stop `stop_us`.
    fn round(factor: u64, stop_us: u64) -> Round {
        let mut round = Round::new(0).expect("bounds");
        for leg in Leg::ALL {
            for us in 1..=100 {
                let us = if is_bound(leg) { stop_us } else { factor * us };
                round.record(leg, 1000 * us);
            }
        }
        round
    }

    #[test]
    fn every_leg_has_a_row_of_all_rounds_and_a_stop_a_period_and_a_little_more() {
        for (stop_us, kept) in [(5090, true), (5120, false)] {
            let found =
                dataset(&setting(), &[round(1, stop_us), round(2, stop_us)]).expect("a result");
            let json = found.json();
            let row = &json["legs"][Leg::ReferenceCommand as usize];
            let expected = (&json!("reference.command"), &json!(200));
            assert_eq!((&row["leg"], &row["samples"]), expected);
            let near = |value: &Value, expected: f64| {
                (value.as_f64().expect("a number") - expected).abs() <= 2e-3 * expected
            };
            assert!(near(&row["latency_us"]["max"], 200.0), "{row}");
            // The medians of the rounds are 50 and 100.
            assert!(near(&row["rounds_us"]["p50"], 75.0), "{row}");
            let ratios = json["ratios"].as_array().expect("a list");
            assert!(ratios.iter().all(|ratio| near(&ratio["p50"], 1.0)));
            let mut metrics = found.metrics.iter();
            assert!(metrics.all(|m| m.rounds.len() == 2 && !m.name.contains("grid")));
            assert_eq!(found.recordings.len(), 2 * Leg::ALL.len());
            let targets = &json["targets"];
            assert_eq!(
                [&targets[0]["kept"], &targets[1]["kept"]],
                [&json!(kept); 2]
            );
        }
    }

    #[test]
    fn a_percentile_of_too_few_values_is_not_printed() {
        for (count, absent) in [
            (99, [true; 3]),
            (100, [false, true, false]),
            (1000, [false; 3]),
        ] {
            let mut round = Round::new(0).expect("bounds");
            for us in 1..=count {
                round.record(Leg::StopZeroHandover, 1000 * us);
            }
            let row = row(Leg::StopZeroHandover, &[round]).expect("samples");
            let value = shown(&row).expect("JSON");
            let times = [
                &value["latency_us"]["p99"],
                &value["latency_us"]["p999"],
                &value["rounds_us"]["p99"],
            ];
            assert_eq!(times.map(Value::is_null), absent);
            assert_eq!(target(&row, 1.0)["kept"].is_null(), count < 100);
        }
    }
}
