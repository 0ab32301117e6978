//! Results of each leg as rows, plots and single numbers.

use anyhow::Result;
use hdrhistogram::Histogram;
use serde_json::{Value, json};

use super::leg::{Leg, Round};
use crate::chart::{BLUE, Curve, GREEN, GREY, ORANGE, PURPLE, Panel, SKY, Scale, YELLOW, longer};
use crate::dataset::{Dataset, each, number, together};
use crate::metric::{median, range};
use crate::quantiles::{Quantiles, pooled};

/// Time that a stop may take beyond one period until zero rates \[µs\].
const STOP_MARGIN_US: f64 = 100.0;
/// Values needed for a 99th percentile: with fewer it is just the largest value.
const VALUES_OF_P99: u64 = 100;
const VALUES_OF_P999: u64 = 1000;
const SHARES: f64 = 1e-4;

const RATIOS: [(Leg, Leg); 3] = [
    (Leg::CommandHop, Leg::BareOneWay),
    (Leg::CommandHandover, Leg::BareOneWay),
    (Leg::LeaseMachinery, Leg::BareRequest),
];

const BOUND: [Leg; 2] = [Leg::StopZeroHandover, Leg::StopZeroCommand];

#[rustfmt::skip]
const PANELS: [(&str, &[Leg]); 4] = [
    ("Commands beside iceoryx2 alone",
        &[Leg::BareOneWay, Leg::BareRoundTrip, Leg::CommandHop, Leg::CommandHandover, Leg::CommandRelease]),
    ("Sent → first command that uses it: whole, and without the wait for the grid",
        &[Leg::ReferenceCommand, Leg::ReferenceMachinery, Leg::ObstacleCommand, Leg::ObstacleMachinery,
            Leg::MeasurementCommand, Leg::MeasurementMachinery]),
    ("Request → answer beside iceoryx2 alone",
        &[Leg::BareRequest, Leg::LeaseMachinery, Leg::LeaseAnswer, Leg::TrackMachinery, Leg::TrackAnswer]),
    ("Stop → zero rates, without the ramp",
        &[Leg::StopZeroHandover, Leg::StopZeroCommand, Leg::StopGrid]),
];

pub(super) fn dataset(title: &str, setting: Value, rounds: &[Round]) -> Result<Dataset> {
    let limit_us = number(&setting, "period_us").unwrap_or(f64::NAN) + STOP_MARGIN_US;
    let mut dataset = Dataset::new("latency", include_str!("latency.toml"));
    let (mut legs, mut of_rounds) = (Vec::new(), Vec::new());
    for leg in Leg::ALL {
        let each_round = round_rows(leg, rounds);
        if let Some(row) = row(leg, rounds, &each_round)? {
            let (way, part) = leg.name().split_once('.').unwrap_or_default();
            if !leg.is_grid() {
                let names = json!({ "way": way, "part": part });
                dataset.compare("rounds", &names, &each_round);
            }
            legs.push(row);
        }
        of_rounds.extend(each_round);
        let recordings = rounds.iter().map(|round| &round.legs[leg as usize]);
        let measured = recordings.filter(|recording| !recording.histogram_ns.is_empty());
        dataset.recordings.extend(measured.cloned());
    }
    let ratios = RATIOS.map(|legs| ratio(&mut dataset, legs, rounds));
    let is_bound = |row: &&Value| BOUND.iter().any(|leg| row["leg"] == leg.name());
    let stops = legs.iter().filter(is_bound);
    let targets: Vec<Value> = stops.map(|row| target(row, limit_us)).collect();
    let beyond = targets.iter().filter_map(|target| {
        let beyond_us = number(target, "p99_us")? - limit_us + STOP_MARGIN_US;
        Some((beyond_us, Value::Null, target["leg"].as_str()?.to_owned()))
    });
    let worst = beyond.max_by(|one, other| one.0.total_cmp(&other.0));
    let what = "stop request to zero rates without ramp, p99, beyond one period";
    dataset.target([what, "≤ 100 µs", "µs"], worst, f64::MIN..=STOP_MARGIN_US);
    let sum = |count: fn(&Round) -> u64| rounds.iter().map(count).sum::<u64>();
    let unmeasured = json!({
        "spoilt_stops": sum(|round| round.spoilt_stops),
        "without_command": sum(|round| round.without_command),
    });
    let counts = json!({ "looks": setting["looks"], "unmeasured": unmeasured });
    dataset.fact("setting", setting);
    dataset.fact("unmeasured", unmeasured);
    dataset.plot("latency", &panels(rounds, limit_us)?)?;
    dataset.add_titled("shown", &[title], legs.iter().map(shown).collect());
    dataset.add("ratios", ratios.into_iter().flatten().collect());
    dataset.add("targets", targets);
    dataset.add("counts", vec![counts]);
    dataset.add("legs", legs);
    dataset.add("rounds", of_rounds);
    Ok(dataset)
}

fn quantiles(leg: Leg, round: &Round) -> Option<Quantiles> {
    Quantiles::of(&round.legs[leg as usize].histogram_ns)
}

fn round_rows(leg: Leg, rounds: &[Round]) -> Vec<Value> {
    let row = |(index, round): (usize, &Round)| {
        let samples = round.legs[leg as usize].histogram_ns.len();
        let latency_us = quantiles(leg, round)?;
        let round = index + 1;
        Some(json!({ "round": round, "leg": leg, "samples": samples, "latency_us": latency_us }))
    };
    rounds.iter().enumerate().filter_map(row).collect()
}

fn row(leg: Leg, rounds: &[Round], each_round: &[Value]) -> Result<Option<Value>> {
    let (all, (from, to)) = (of_all(leg, rounds)?, leg.definition());
    let row = json!({
        "leg": leg,
        "from": from,
        "to": to,
        "samples": all.len(),
        "samples_of_round_least": each(each_round, "samples").reduce(f64::min),
        "latency_us": Quantiles::of(&all),
        "rounds_us": together(each_round, &[])["latency_us"],
    });
    Ok((!all.is_empty()).then_some(row))
}

fn of_all(leg: Leg, rounds: &[Round]) -> Result<Histogram<u64>> {
    pooled(
        rounds
            .iter()
            .map(|round| &round.legs[leg as usize].histogram_ns),
    )
}

fn ratio(dataset: &mut Dataset, (leg, to): (Leg, Leg), rounds: &[Round]) -> Option<Value> {
    let of_round = |round: &Round| Some(quantiles(leg, round)?.p50 / quantiles(to, round)?.p50);
    let values: Vec<f64> = rounds.iter().filter_map(of_round).collect();
    let [name, to_name] = [leg, to].map(|leg| leg.name().replace('.', "_"));
    let (p50, range) = (median(values.clone())?, range(values.clone()));
    let row = json!({ "leg": leg, "to": to, "p50": p50, "range": range, "rounds": values });
    dataset.lower(format!("latency/{name}_per_{to_name}_p50"), "", values);
    Some(row)
}

/// The row for people, without percentiles of too few values.
fn shown(row: &Value) -> Value {
    let mut shown = row.clone();
    for (times, key, count, least) in [
        ("latency_us", "p99", "samples", VALUES_OF_P99),
        ("latency_us", "p999", "samples", VALUES_OF_P999),
        ("rounds_us", "p99", "samples_of_round_least", VALUES_OF_P99),
    ] {
        if row[count].as_f64() < Some(least as f64) {
            shown[times][key] = Value::Null;
        }
    }
    shown
}

/// An upper limit for the 99th percentile of a leg; unknown with too few values.
fn target(row: &Value, limit_us: f64) -> Value {
    let p99_us = number(&shown(row), "latency_us_p99");
    let kept = p99_us.map(|p99_us| p99_us <= limit_us);
    json!({ "leg": row["leg"], "samples": row["samples"], "limit_us": limit_us, "p99_us": p99_us, "kept": kept })
}

fn panels(rounds: &[Round], limit_us: f64) -> Result<Vec<Panel>> {
    let panel = |(title, legs): (&str, &[Leg])| {
        let mut curves = Vec::new();
        for (leg, colour) in legs.iter().zip([BLUE, SKY, GREEN, YELLOW, ORANGE, PURPLE]) {
            let times = longer(&of_all(*leg, rounds)?);
            curves.push(Curve::line(leg.name(), times, colour));
        }
        if legs.contains(&BOUND[0]) {
            curves.push(Curve::upright("bound for 99 %", limit_us, SHARES, GREY));
        }
        let axes = ["longer than, µs", "share of the samples"];
        let scale = Scale::LogLog { floor: SHARES };
        Ok(Panel::new(title, axes, scale, curves))
    };
    PANELS.into_iter().map(panel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A round in which every leg takes 1 to 100 µs times `factor`, and every stop `stop_us`.
    fn round(factor: u64, stop_us: u64) -> Round {
        let mut round = Round::new(0).expect("bounds");
        for leg in Leg::ALL {
            for us in 1..=100 {
                let is_stop = BOUND.contains(&leg);
                round.record(leg, 1000 * if is_stop { stop_us } else { factor * us });
            }
        }
        round
    }

    #[test]
    fn a_stop_may_take_a_period_and_a_little_more_and_medians_are_those_of_the_rounds() {
        for (stop_us, kept) in [(5090, true), (5120, false)] {
            let rounds = [round(1, stop_us), round(2, stop_us)];
            let setting = json!({ "period_us": 5000.0 });
            let found = dataset("", setting, &rounds).expect("a result");
            let mut targets = found.rows("targets").iter();
            assert!(targets.all(|target| target["kept"] == kept));
            assert_eq!(found.targets[0]["reached"], kept);
            let leg = &found.rows("legs")[Leg::ReferenceCommand as usize];
            // The medians of the rounds are 50 and 100.
            let p50_us = number(leg, "rounds_us_p50").expect("a number");
            assert!((p50_us - 75.0).abs() < 0.2, "{leg}");
            let mut metrics = found.metrics.iter();
            assert!(metrics.all(|metric| !metric.name.contains("grid")));
        }
    }

    #[test]
    fn percentiles_of_too_few_values_are_not_told() {
        let leg = Leg::StopZeroHandover;
        let [both, p999, none] = [[true; 3], [false, true, false], [false; 3]];
        for (count, absent) in [(99, both), (100, p999), (1000, none)] {
            let mut round = Round::new(0).expect("bounds");
            (1..=count).for_each(|us| round.record(leg, 1000 * us));
            let found = dataset("", json!({ "period_us": 5000.0 }), &[round]).expect("a result");
            let [row] = found.rows("shown") else {
                panic!("rows of legs that were not measured");
            };
            let times = ["latency_us_p99", "latency_us_p999", "rounds_us_p99"];
            assert_eq!(times.map(|key| number(row, key).is_none()), absent);
            assert_eq!(found.rows("targets")[0]["kept"].is_null(), count < 100);
        }
    }
}
