//! The project's targets, and the values of a run.

use std::ops::RangeInclusive;

use serde_json::{Map, Value, json};

use crate::dataset::{Dataset, Sheet, plain, shorted, word};
use crate::deadline::misses_p_value;
use crate::latency::STOP_MARGIN_US;
use crate::metric::{Better, Metric};

/// Reading guide of the rows: HTML.
const EXPLANATION: &str = include_str!("targets.html");

/// The benchmarks that measure a target.
pub(super) const JUDGED: [&str; 4] = ["deadline", "latency", "rate", "footprint"];

/// Probability below which the additional misses are not considered chance.
const CHANCE: f64 = 0.05;

/// Value, range of its rounds, and its case or the amount of data.
type Worst = (f64, Option<(f64, f64)>, String);

/// Rows of the targets that the metrics and results of a run contain.
pub(super) fn targets(metrics: &[Metric], results: &Map<String, Value>) -> Vec<Value> {
    let most = |pattern: &str| worst(metrics, pattern);
    let up_to = |limit: f64| f64::MIN..=limit;
    #[rustfmt::skip]
    let wanted = [
        ("wake-up p50, daemon / bare loop", "≤ 1.1 for every load", "",
            most("deadline/*/realtime/wake_p50_to_bare"), up_to(1.1)),
        ("wake-up p99, daemon / bare loop", "≤ 1.1 for every load", "",
            most("deadline/*/realtime/wake_p99_to_bare"), up_to(1.1)),
        ("misses with cause compute or fault, all loads", "0", "", own_misses(results), up_to(0.0)),
        ("misses beyond the bare loop's, all loads: probability by chance", "not below 0.05", "",
            chance_of_misses(results), CHANCE..=1.0),
        ("release to command in the client, p50 less wake-up p50, no load", "≤ 40 µs", "µs",
            most("deadline/none/realtime/command_beyond_wake_p50"), up_to(40.0)),
        ("response p99 under clients that connect, loaded / unloaded", "≤ 1.3", "",
            most("deadline/clients/realtime/response_p99_to_unloaded"), up_to(1.3)),
        ("response p99 under a flood, loaded / unloaded", "≤ 1.3", "",
            most("deadline/flood/realtime/response_p99_to_unloaded"), up_to(1.3)),
        ("shortest period that holds, kpso-refined, 3 sections, 2 steps", "≤ 0.5 ms", "ms",
            most("rate/shortest/3-sections/kpso-refined/n2"), up_to(0.5)),
        ("safety checks p99, 6 sections, 64 obstacles in reach", "≤ 150 µs", "µs", most("guard/*/p99"), up_to(150.0)),
        ("CPU of the real-time core at 200 Hz, tracking", "≤ 3 %", "%",
            most("footprint/core_tracking_percent"), up_to(3.0)),
        ("resident memory", "≤ 64 MB", "MB", most("footprint/resident_mb"), up_to(64.0)),
        ("resident memory that tracking adds", "0", "kB", most("footprint/growth_kb"), up_to(0.0)),
        ("memory is locked (1: in every round)", "1", "", most("footprint/locked"), 1.0..=1.0),
        ("stop request to zero rates without ramp, p99, beyond one period", "≤ 100 µs", "µs",
            stop_beyond_period(results), up_to(STOP_MARGIN_US)),
    ];
    let row = |(what, target, unit, found, reached): (
        _,
        _,
        _,
        Option<Worst>,
        RangeInclusive<f64>,
    )| {
        let (value, range, of) = found?;
        let reached = reached.contains(&value);
        // `unit` is empty for a ratio or a count, `range` null without rounds.
        Some(json!({
            "what": what, "target": target, "found": value, "unit": unit, "range": range, "of": of, "reached": reached,
        }))
    };
    wanted.into_iter().filter_map(row).collect()
}

pub(super) fn dataset(targets: Vec<Value>) -> Dataset {
    let columns = [
        word("figure", "what"),
        word("target", "target"),
        word("of", "of"),
        word("reached", "reached"),
        shorted("found", "found"),
        plain("unit", "unit"),
        shorted("rounds", "range"),
    ];
    let heading = "Figures to reach";
    let title = if targets.is_empty() { "" } else { heading };
    let mut dataset = Dataset::new("targets", heading, EXPLANATION);
    dataset.sheets = vec![Sheet::of(title, &columns, targets).key("targets")];
    dataset
}

/// The worst of the metrics whose names match the pattern, by their medians; a number of which more is better,
/// by its worst round.
fn worst(metrics: &[Metric], pattern: &str) -> Option<Worst> {
    let values = metrics.iter().filter_map(|metric| {
        let of = own_part(pattern, &metric.name)?;
        let (least, most) = metric.range()?;
        let value = match metric.better {
            Better::Lower => metric.median()?,
            Better::Higher => least,
        };
        let range = (metric.rounds.len() > 1).then_some((least, most));
        Some((value, range, of))
    });
    values.max_by(|one, other| one.0.total_cmp(&other.0))
}

/// Misses, own misses and due releases (executed and skipped cycles) of the real-time cases of a subject,
/// `daemon` or `bare`, by load.
fn misses<'a>(results: &'a Map<String, Value>, subject: &str) -> Vec<(&'a Value, [u64; 3])> {
    let cases = results
        .get("deadline")
        .and_then(|it| it["cases"].as_array());
    let is_it = |case: &&Value| case["realtime"] == true && case["subject"] == subject;
    let counts = |case: &'a Value| {
        let count = |key: &str| case[key].as_u64().unwrap_or(0);
        let due = count("cycles") + count("skipped_periods");
        (
            &case["load"],
            [count("deadline_misses"), count("own_misses"), due],
        )
    };
    cases
        .into_iter()
        .flatten()
        .filter(is_it)
        .map(counts)
        .collect()
}

fn own_misses(results: &Map<String, Value>) -> Option<Worst> {
    let period_ms = results.get("deadline")?["period_ms"].as_f64()?;
    let cases = misses(results, "daemon");
    let sum = |index: usize| cases.iter().map(|(_, counts)| counts[index]).sum::<u64>();
    let minutes = sum(2) as f64 * period_ms / 60e3;
    (sum(2) > 0).then(|| (sum(1) as f64, None, format!("{minutes:.1} min")))
}

/// Over all loads that were measured with both subjects.
fn chance_of_misses(results: &Map<String, Value>) -> Option<Worst> {
    let all_bare = misses(results, "bare");
    let (mut ours, mut bare) = ((0, 0), (0, 0));
    for (load, daemon) in misses(results, "daemon") {
        if let Some((_, beside)) = all_bare.iter().find(|(of, _)| *of == load) {
            ours = (ours.0 + daemon[0], ours.1 + daemon[2]);
            bare = (bare.0 + beside[0], bare.1 + beside[2]);
        }
    }
    let of = format!("{} of {} against {} of {}", ours.0, ours.1, bare.0, bare.1);
    (ours.1 > 0 && bare.1 > 0).then(|| (misses_p_value(ours, bare), None, of))
}

/// As evaluated by `latency`, for its period.
fn stop_beyond_period(results: &Map<String, Value>) -> Option<Worst> {
    let targets = results.get("latency")?["targets"].as_array()?;
    let values = targets.iter().filter_map(|target| {
        let (p99_us, limit_us) = (target["p99_us"].as_f64()?, target["limit_us"].as_f64()?);
        let beyond_us = p99_us - limit_us + STOP_MARGIN_US;
        Some((beyond_us, None, target["leg"].as_str()?.to_owned()))
    });
    values.max_by(|one: &Worst, other| one.0.total_cmp(&other.0))
}

/// The words of a name at each `*` of the pattern; `None` if they do not match.
fn own_part(pattern: &str, name: &str) -> Option<String> {
    let [patterns, words] = [pattern, name].map(|text| text.split('/').collect::<Vec<_>>());
    let pairs = || patterns.iter().zip(&words);
    let fits = pairs().all(|(pattern, word)| *pattern == "*" || pattern == word);
    let own = pairs()
        .filter(|(pattern, _)| **pattern == "*")
        .map(|(_, word)| *word);
    (fits && patterns.len() == words.len()).then(|| own.collect::<Vec<_>>().join(" "))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_worst_load_counts_and_what_was_not_measured_has_no_row() {
        let lower = |case: &str, rounds: [f64; 3]| {
            let name = format!("deadline/{case}/wake_p50_to_bare");
            Metric::new(name, "", Better::Lower, rounds)
        };
        let metrics = [
            lower("none/realtime", [1.0, 1.02, 1.01]),
            lower("cpu/realtime", [1.2, 1.3, 1.1]),
            lower("cpu/ordinary", [9.0, 9.0, 9.0]),
        ];
        let found = targets(&metrics, &Map::new());
        assert_eq!(found.len(), 1, "{found:?}");
        says(&found[0], 1.2, "cpu", false);
        assert_eq!(found[0]["range"], json!([1.1, 1.3]));
        let text = dataset(found).text();
        assert!(text.contains("1.1 to 1.3"), "{text}");
    }

    #[test]
    #[rustfmt::skip]
    fn misses_are_judged_for_all_loads_together_and_a_stop_beyond_the_period_of_its_run() {
        let case = |load: &str, subject: &str, realtime: bool, misses: u32, own: u32| json!({
            "load": load, "subject": subject, "realtime": realtime, "cycles": 11_000, "skipped_periods": 1000,
            "deadline_misses": misses, "own_misses": own,
        });
        let target = |leg: &str, p99_us: f64| json!({ "leg": leg, "p99_us": p99_us, "limit_us": 2100.0 });
        let results = json!({
            "deadline": { "period_ms": 5.0, "cases": [
                case("none", "daemon", true, 1, 0),
                case("none", "bare", true, 2, 0),
                case("cpu", "daemon", true, 3, 2),
                case("cpu", "bare", true, 2, 0),
                case("cpu", "cyclictest", true, 9000, 0),
                case("io", "daemon", true, 0, 0),
                case("cpu", "daemon", false, 900, 70),
            ] },
            "latency": { "targets": [target("stop.zero_handover", 2050.0), target("stop.zero_command", 2130.0)] },
        });
        let found = targets(&[], results.as_object().expect("an object"));
        assert_eq!(found.len(), 3, "{found:?}");
        says(&found[0], 2.0, "3.0 min", false);
        assert_eq!(found[1]["of"], "4 of 24000 against 4 of 24000");
        assert!(found[1]["reached"] == true && found[1]["found"].as_f64() > Some(0.5), "{found:?}");
        says(&found[2], 130.0, "stop.zero_command", false);
    }

    fn says(target: &Value, found: f64, of: &str, reached: bool) {
        let shown = ["found", "of", "reached"].map(|key| &target[key]);
        assert_eq!(shown, [&json!(found), &json!(of), &json!(reached)]);
    }
}
