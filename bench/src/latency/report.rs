//! Results of each leg as rows, plots and single numbers.

use anyhow::Result;
use hdrhistogram::Histogram;
use serde_json::{Value, json};

use super::leg::{Declared, Round, declared};
use crate::chart::{BLUE, Curve, GREEN, GREY, ORANGE, PURPLE, Panel, SKY, Scale, YELLOW, longer};
use crate::dataset::{Dataset, each, joined, number, together};
use crate::metric::{median, range};
use crate::quantiles::{pooled, quantile_us, quantiles};

/// Time that a stop may take beyond one period until zero rates \[µs\].
const STOP_MARGIN_US: f64 = 100.0;
/// Values needed for a 99th percentile: with fewer it is just the largest value.
const VALUES_OF_P99: u64 = 100;
const VALUES_OF_P999: u64 = 1000;
const SHARES: f64 = 1e-4;

pub(super) fn dataset(title: &str, setting: Value, rounds: &[Round]) -> Result<Dataset> {
    let limit_us = number(&setting, "period_us").unwrap_or(f64::NAN) + STOP_MARGIN_US;
    let mut dataset = Dataset::new("latency", super::DECLARATION);
    let declared = declared();
    let (mut legs, mut of_rounds) = (Vec::new(), Vec::new());
    for [leg, from, to] in &declared.legs {
        let each_round = round_rows(leg, rounds);
        let stamps = json!({ "leg": leg, "from": from, "to": to });
        let row = row(leg, rounds, &each_round);
        legs.extend(row.map(|row| joined([stamps, row])));
        // The wait for the grid is spread evenly over a period by design, so two runs cannot differ in it.
        let (way, part) = leg.split_once('.').unwrap_or_default();
        if part != "grid" {
            let names = json!({ "way": way, "part": part });
            dataset.compare("rounds", &names, &each_round);
        }
        of_rounds.extend(each_round);
        let recordings = rounds.iter().filter_map(|round| round.legs.get(leg));
        dataset.recordings.extend(recordings.cloned());
    }
    let ratio_of = |legs| ratio(&mut dataset, legs, rounds);
    let ratios: Vec<Value> = declared.ratios.iter().filter_map(ratio_of).collect();
    let is_bound = |row: &&Value| declared.bound.iter().any(|leg| row["leg"] == **leg);
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
    dataset.plot("latency", &panels(&declared, rounds, limit_us))?;
    dataset.add_titled("shown", &[title], legs.iter().map(shown).collect());
    dataset.add("ratios", ratios);
    dataset.add("targets", targets);
    dataset.add("counts", vec![counts]);
    dataset.add("legs", legs);
    dataset.add("rounds", of_rounds);
    Ok(dataset)
}

fn round_rows(leg: &str, rounds: &[Round]) -> Vec<Value> {
    let row = |(index, round): (usize, &Round)| {
        let times = &round.legs.get(leg)?.histogram_ns;
        let (samples, us) = (times.len(), quantiles(times));
        Some(json!({ "round": index + 1, "leg": leg, "samples": samples, "latency_us": us }))
    };
    rounds.iter().enumerate().filter_map(row).collect()
}

fn row(leg: &str, rounds: &[Round], each_round: &[Value]) -> Option<Value> {
    let all = of_all(leg, rounds);
    let row = json!({
        "samples": all.len(),
        "samples_of_round_least": each(each_round, "samples").reduce(f64::min),
        "latency_us": quantiles(&all),
        "rounds_us": together(each_round, &[])["latency_us"],
    });
    (!all.is_empty()).then_some(row)
}

fn of_all(leg: &str, rounds: &[Round]) -> Histogram<u64> {
    let recordings = rounds.iter().filter_map(|round| round.legs.get(leg));
    pooled(recordings.map(|recording| &recording.histogram_ns))
}

fn ratio(dataset: &mut Dataset, legs: &[String; 2], rounds: &[Round]) -> Option<Value> {
    let p50 = |round: &Round, leg| Some(quantile_us(&round.legs.get(leg)?.histogram_ns, 0.5));
    let of_round = |round: &Round| Some(p50(round, &*legs[0])? / p50(round, &*legs[1])?);
    let values: Vec<f64> = rounds.iter().filter_map(of_round).collect();
    let (p50, range, [leg, to]) = (median(values.clone())?, range(values.clone()), legs);
    let row = json!({ "leg": leg, "to": to, "p50": p50, "range": range, "rounds": values });
    let [name, to_name] = legs.each_ref().map(|leg| leg.replace('.', "_"));
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

fn panels(declared: &Declared, rounds: &[Round], limit_us: f64) -> Vec<Panel> {
    let panel = |(title, legs): &(String, Vec<String>)| {
        let mut curves = Vec::new();
        for (leg, colour) in legs.iter().zip([BLUE, SKY, GREEN, YELLOW, ORANGE, PURPLE]) {
            curves.push(Curve::line(leg, longer(&of_all(leg, rounds)), colour));
        }
        if legs.contains(&declared.bound[0]) {
            curves.push(Curve::upright("bound for 99 %", limit_us, SHARES, GREY));
        }
        let axes = ["longer than, µs", "share of the samples"];
        let scale = Scale::LogLog { floor: SHARES };
        Panel::new(title, axes, scale, curves)
    };
    declared.panels.iter().map(panel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A round in which a reference takes 1 to 100 µs times `factor`, and every stop `stop_us`.
    fn round(factor: u64, stop_us: u64) -> Round {
        let mut round = Round::new(0);
        for us in 1..=100 {
            round.record_way("reference.command", [0, 0, 1000 * factor * us]);
            for leg in ["stop.zero_handover", "stop.zero_command"] {
                round.record(leg, 1000 * stop_us);
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
            // The medians of the rounds are 50 and 100.
            let p50_us = number(&found.rows("legs")[0], "rounds_us_p50").expect("a number");
            assert!((p50_us - 75.0).abs() < 0.2, "{p50_us}");
            let names = found.metrics.iter().map(|metric| &*metric.name);
            let names: Vec<&str> = names.filter(|name| name.ends_with("p50")).collect();
            let legs = "reference/command reference/machinery stop/zero_handover stop/zero_command";
            let expected = legs.split(' ').map(|leg| format!("latency/{leg}_p50"));
            assert!(names.into_iter().eq(expected));
        }
    }

    #[test]
    fn percentiles_of_too_few_values_are_not_shown() {
        let [both, p999, none] = [[true; 3], [false, true, false], [false; 3]];
        for (count, absent) in [(99, both), (100, p999), (1000, none)] {
            let mut round = Round::new(0);
            (1..=count).for_each(|us| round.record("stop.zero_handover", 1000 * us));
            let found = dataset("", json!({ "period_us": 5000.0 }), &[round]).expect("a result");
            let rows = found.rows("shown");
            assert_eq!(rows.len(), 1, "only legs that were measured");
            let times = ["latency_us_p99", "latency_us_p999", "rounds_us_p99"];
            assert_eq!(times.map(|key| number(&rows[0], key).is_none()), absent);
            assert_eq!(found.rows("targets")[0]["kept"].is_null(), count < 100);
        }
    }

    #[test]
    fn every_way_is_made_of_a_wait_for_the_grid_and_machinery_that_are_declared() {
        let legs: Vec<String> = declared().legs.into_iter().map(|[leg, ..]| leg).collect();
        for grid in legs.iter().filter(|leg| leg.contains(".grid")) {
            let (mut round, at) = (Round::new(0), legs.iter().position(|leg| leg == grid));
            let whole = &legs[at.expect("it is there") - 1];
            round.record_way(whole, [100, 400, 1000]);
            let machinery = &grid.replace("grid", "machinery");
            let way = [whole, grid, machinery];
            assert!(way.iter().all(|leg| legs.contains(leg)));
            let longest_ns = way.map(|leg| round.legs[leg].histogram_ns.max());
            assert_eq!(longest_ns, [900, 300, 600]);
        }
    }
}
