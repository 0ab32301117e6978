//! The project's targets, and the values of a run.

use serde_json::{Map, Value, json};

use crate::dataset::{Dataset, Sheet, plain, shorted, word};
use crate::deadline::misses_p_value;
use crate::latency::STOP_MARGIN_US;
use crate::metric::{Metric, range};

/// Reading guide of the rows: HTML.
const EXPLANATION: &str = include_str!("targets.html");

/// The benchmarks that measure a target.
pub(super) const JUDGED: [&str; 4] = ["deadline", "latency", "rate", "footprint"];

/// Probability below which the additional misses are not considered chance.
const CHANCE: f64 = 0.05;

struct Found<'a> {
    metrics: &'a [Metric],
    results: &'a Map<String, Value>,
}

/// Value, range of its rounds, and its case or the amount of data.
type Worst = (f64, Option<(f64, f64)>, String);
/// Description, target in words, unit, value, and condition.
type Wanted = (
    &'static str,
    &'static str,
    &'static str,
    fn(&Found<'_>) -> Option<Worst>,
    fn(f64) -> bool,
);

#[rustfmt::skip]
const WANTED: [Wanted; 14] = [
    ("wake-up p50, daemon / bare loop", "≤ 1.1 for every load", "",
        |found| found.most("deadline/*/realtime/wake_p50_to_bare"), |ratio| ratio <= 1.1),
    ("wake-up p99, daemon / bare loop", "≤ 1.1 for every load", "",
        |found| found.most("deadline/*/realtime/wake_p99_to_bare"), |ratio| ratio <= 1.1),
    ("misses with cause compute or fault, all loads", "0", "",
        |found| found.own_misses(), |count| count == 0.0),
    ("misses beyond the bare loop's, all loads: probability by chance", "not below 0.05", "",
        |found| found.chance_of_misses(), |probability| probability >= CHANCE),
    ("release to command in the client, p50 less wake-up p50, no load", "≤ 40 µs", "µs",
        |found| found.most("deadline/none/realtime/command_beyond_wake_p50"), |us| us <= 40.0),
    ("response p99 under clients that connect, loaded / unloaded", "≤ 1.3", "",
        |found| found.most("deadline/clients/realtime/response_p99_to_unloaded"), |ratio| ratio <= 1.3),
    ("response p99 under a flood, loaded / unloaded", "≤ 1.3", "",
        |found| found.most("deadline/flood/realtime/response_p99_to_unloaded"), |ratio| ratio <= 1.3),
    ("shortest period that holds, kpso-refined, 3 sections, 2 steps", "≤ 0.5 ms", "ms",
        |found| found.most("rate/shortest/3-sections/kpso-refined/n2"), |ms| ms <= 0.5),
    ("safety checks p99, 6 sections, 64 obstacles in reach", "≤ 150 µs", "µs",
        |found| found.most("guard/*/p99"), |us| us <= 150.0),
    ("CPU of the real-time core at 200 Hz, tracking", "≤ 3 %", "%",
        |found| found.most("footprint/core_tracking_percent"), |percent| percent <= 3.0),
    ("resident memory", "≤ 64 MB", "MB",
        |found| found.most("footprint/resident_mb"), |mb| mb <= 64.0),
    ("resident memory that tracking adds", "0", "kB",
        |found| found.most("footprint/growth_kb"), |kb| kb <= 0.0),
    ("memory is locked (1: in every round)", "1", "",
        |found| found.least("footprint/locked"), |locked| locked == 1.0),
    ("stop request to zero rates without ramp, p99, beyond one period", "≤ 100 µs", "µs",
        |found| found.stop_beyond_period(), |us| us <= STOP_MARGIN_US),
];

/// Rows of the targets that the metrics and results of a run contain.
pub(super) fn targets(metrics: &[Metric], results: &Map<String, Value>) -> Vec<Value> {
    let found = Found { metrics, results };
    let target = |(what, target, unit, find, is_reached): Wanted| {
        let (value, range, of) = find(&found)?;
        let reached = is_reached(value);
        Some(json!({
            "what": what,
            "target": target,
            "found": value,
            // Empty for a ratio or a count.
            "unit": unit,
            // Smallest and largest round, if measured in rounds.
            "range": range,
            // The case of the value, or the amount of data.
            "of": of,
            "reached": reached,
        }))
    };
    WANTED.into_iter().filter_map(target).collect()
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
    let title = if targets.is_empty() {
        ""
    } else {
        "Figures to reach"
    };
    Dataset {
        name: "targets",
        heading: "Figures to reach",
        explanation: EXPLANATION,
        sheets: vec![Sheet::of(title, &columns, targets).key("targets")],
        ..Dataset::default()
    }
}

impl Found<'_> {
    /// The metric with the largest median among the matching names.
    fn most(&self, pattern: &str) -> Option<Worst> {
        let values = self.metrics.iter().filter_map(|metric| {
            let of = own_part(pattern, &metric.name)?;
            Some((metric.median()?, range_of_rounds(metric), of))
        });
        values.max_by(|one, other| one.0.total_cmp(&other.0))
    }

    fn least(&self, name: &str) -> Option<Worst> {
        let metric = self.metrics.iter().find(|metric| metric.name == name)?;
        let (value, _) = range(metric.rounds.iter().copied())?;
        Some((value, range_of_rounds(metric), String::new()))
    }

    /// The real-time cases of a subject, `daemon` or `bare`.
    fn cases(&self, subject: &'static str) -> impl Iterator<Item = &Value> {
        let deadline = self.results.get("deadline");
        let cases = deadline.and_then(|result| result["cases"].as_array());
        let all = cases.into_iter().flatten();
        all.filter(move |case| case["realtime"] == true && case["subject"] == subject)
    }

    fn own_misses(&self) -> Option<Worst> {
        let period_ms = self.results.get("deadline")?["period_ms"].as_f64()?;
        let (mut own, mut cycles) = (0, 0);
        for case in self.cases("daemon") {
            own += case["own_misses"].as_u64()?;
            cycles += due(case)?;
        }
        let minutes = cycles as f64 * period_ms / 60e3;
        (cycles > 0).then(|| (own as f64, None, format!("{minutes:.1} min")))
    }

    /// Over all loads that were measured with both subjects.
    fn chance_of_misses(&self) -> Option<Worst> {
        let (mut ours, mut bare) = ((0, 0), (0, 0));
        for daemon in self.cases("daemon") {
            let beside = self.cases("bare").find(|it| it["load"] == daemon["load"]);
            let Some(beside) = beside else {
                continue;
            };
            for (sum, case) in [(&mut ours, daemon), (&mut bare, beside)] {
                sum.0 += case["deadline_misses"].as_u64()?;
                sum.1 += due(case)?;
            }
        }
        let of = format!("{} against {}", counts(ours), counts(bare));
        (ours.1 > 0 && bare.1 > 0).then(|| (misses_p_value(ours, bare), None, of))
    }

    /// As evaluated by `latency`, for its period.
    fn stop_beyond_period(&self) -> Option<Worst> {
        let targets = self.results.get("latency")?["targets"].as_array()?;
        let values = targets.iter().filter_map(|target| {
            let (p99_us, limit_us) = (target["p99_us"].as_f64()?, target["limit_us"].as_f64()?);
            let beyond_us = p99_us - limit_us + STOP_MARGIN_US;
            Some((beyond_us, None, target["leg"].as_str()?.to_owned()))
        });
        values.max_by(|one: &Worst, other| one.0.total_cmp(&other.0))
    }
}

/// Due releases: executed and skipped cycles.
fn due(case: &Value) -> Option<u64> {
    Some(case["cycles"].as_u64()? + case["skipped_periods"].as_u64()?)
}

fn range_of_rounds(metric: &Metric) -> Option<(f64, f64)> {
    range(metric.rounds.iter().copied()).filter(|_| metric.rounds.len() > 1)
}

fn counts((misses, due): (u64, u64)) -> String {
    format!("{misses} of {due}")
}

/// The words of a name at each `*` of the pattern; `None` if they do not match.
fn own_part(pattern: &str, name: &str) -> Option<String> {
    let [pattern, name] = [pattern, name].map(|text| text.split('/').collect::<Vec<_>>());
    let fits = |(pattern, word): (&&str, &&str)| *pattern == "*" || pattern == word;
    let is_it = pattern.len() == name.len() && pattern.iter().zip(&name).all(fits);
    let own = pattern
        .iter()
        .zip(name)
        .filter(|(pattern, _)| **pattern == "*");
    is_it.then(|| own.map(|(_, word)| word).collect::<Vec<_>>().join(" "))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::metric::Better;

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
