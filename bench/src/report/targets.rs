//! What the project set out to reach, and what a run found.

use serde::Serialize;
use serde_json::{Map, Value};

use crate::metric::Metric;
use crate::table::Table;

/// How the rows are to be read: HTML.
pub(super) const EXPLANATION: &str = "\
<p>With three sections, <code>kpso-refined</code>, 5 ms and real time. A figure is the median over the rounds; \
where several cases stand behind it, the worst of them. \"Beyond the bare loop\" asks how probable so many \
misses would be if daemon and bare loop missed alike: below 5 % for any load (shared among the loads) is \
called different.</p>\n";

/// Probability below which misses are not called chance, all loads together.
const CHANCE: f64 = 0.05;

/// What a stop may take beyond one period \[µs\].
const STOP_MARGIN_US: f64 = 100.0;

/// One figure to reach.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Target {
    /// What.
    pub what: &'static str,
    /// What it should be, in words.
    pub target: &'static str,
    /// What it is.
    pub found: f64,
    /// Its unit; empty for a ratio or a count.
    pub unit: &'static str,
    /// Which case it comes from; empty when there is only one.
    pub of: String,
    /// Whether it is reached.
    pub reached: bool,
}

/// How one figure is found and judged.
struct Wanted {
    what: &'static str,
    target: &'static str,
    unit: &'static str,
    found: fn(&Found<'_>) -> Option<Worst>,
    reached: fn(f64) -> bool,
}

/// What a run found.
struct Found<'a> {
    metrics: &'a [Metric],
    results: &'a Map<String, Value>,
}

/// A value, and where it is from.
struct Worst {
    value: f64,
    of: String,
}

const WANTED: &[Wanted] = &[
    Wanted {
        what: "wake-up p50, daemon / bare loop",
        target: "≤ 1.1 for every load",
        unit: "",
        found: |found| found.most("deadline/*/realtime/wake_p50_to_bare"),
        reached: |ratio| ratio <= 1.1,
    },
    Wanted {
        what: "wake-up p99, daemon / bare loop",
        target: "≤ 1.1 for every load",
        unit: "",
        found: |found| found.most("deadline/*/realtime/wake_p99_to_bare"),
        reached: |ratio| ratio <= 1.1,
    },
    Wanted {
        what: "misses with cause compute or fault, all loads",
        target: "0",
        unit: "",
        found: |found| found.own_misses(),
        reached: |count| count == 0.0,
    },
    Wanted {
        what: "misses beyond the bare loop's: least probability by chance, times loads",
        target: "not below 0.05",
        unit: "",
        found: |found| found.chance_of_misses(),
        reached: |probability| probability >= CHANCE,
    },
    Wanted {
        what: "release to command in the client, p50 less wake-up p50, no load",
        target: "≤ 40 µs",
        unit: "µs",
        found: |found| found.most("deadline/none/realtime/command_beyond_wake_p50"),
        reached: |us| us <= 40.0,
    },
    Wanted {
        what: "response p99 under clients that connect, loaded / unloaded",
        target: "≤ 1.3",
        unit: "",
        found: |found| found.most("deadline/clients/realtime/response_p99_to_unloaded"),
        reached: |ratio| ratio <= 1.3,
    },
    Wanted {
        what: "response p99 under a flood, loaded / unloaded",
        target: "≤ 1.3",
        unit: "",
        found: |found| found.most("deadline/flood/realtime/response_p99_to_unloaded"),
        reached: |ratio| ratio <= 1.3,
    },
    Wanted {
        what: "shortest period that holds, kpso-refined, 3 sections, 2 steps",
        target: "≤ 0.5 ms",
        unit: "ms",
        found: |found| found.most("rate/shortest/3-sections/kpso-refined/n2"),
        reached: |ms| ms <= 0.5,
    },
    Wanted {
        what: "CPU of the real-time core at 200 Hz, tracking",
        target: "≤ 3 %",
        unit: "%",
        found: |found| found.most("footprint/core_tracking_percent"),
        reached: |percent| percent <= 3.0,
    },
    Wanted {
        what: "resident memory",
        target: "≤ 64 MB",
        unit: "MB",
        found: |found| found.most("footprint/resident_mb"),
        reached: |mb| mb <= 64.0,
    },
    Wanted {
        what: "resident memory that tracking adds",
        target: "0",
        unit: "kB",
        found: |found| found.most("footprint/growth_kb"),
        reached: |kb| kb <= 0.0,
    },
    Wanted {
        what: "stop request to zero rates without ramp, p99, beyond one period",
        target: "≤ 100 µs",
        unit: "µs",
        found: |found| found.stop_beyond_period(),
        reached: |us| us <= STOP_MARGIN_US,
    },
];

/// The figures that the metrics and results of a run tell.
pub fn targets(metrics: &[Metric], results: &Map<String, Value>) -> Vec<Target> {
    let found = Found { metrics, results };
    let target = |wanted: &Wanted| {
        let worst = (wanted.found)(&found)?;
        Some(Target {
            what: wanted.what,
            target: wanted.target,
            found: worst.value,
            unit: wanted.unit,
            of: worst.of,
            reached: (wanted.reached)(worst.value),
        })
    };
    WANTED.iter().filter_map(target).collect()
}

/// The figures for people.
pub(super) fn table(targets: &[Target]) -> Table {
    let row = |target: &Target| {
        vec![
            target.what.to_owned(),
            target.target.to_owned(),
            target.of.clone(),
            if target.reached { "yes" } else { "no" }.to_owned(),
            format!("{} {}", number(target.found), target.unit)
                .trim_end()
                .to_owned(),
        ]
    };
    let heads = ["figure", "target", "worst of", "reached", "found"];
    Table::new(
        "Figures to reach",
        &heads,
        4,
        targets.iter().map(row).collect(),
    )
}

/// Three digits, as far as they say something.
pub(crate) fn number(value: f64) -> String {
    let digits = match value.abs() {
        _ if value == value.round() && value.abs() < 1e6 => 0,
        size if size >= 100.0 => 0,
        size if size >= 10.0 => 1,
        size if size >= 1.0 => 2,
        size if size >= 1e-3 => 4,
        _ => return format!("{value:.2e}"),
    };
    let text = format!("{value:.digits$}");
    match text.split_once('.') {
        Some(_) => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        None => text,
    }
}

impl Found<'_> {
    /// The metric with the largest median of those whose name fits.
    fn most(&self, pattern: &str) -> Option<Worst> {
        let fitting = self
            .metrics
            .iter()
            .filter(|metric| fits(pattern, &metric.name));
        let values = fitting.filter_map(|metric| {
            Some(Worst {
                value: metric.median()?,
                of: own_part(pattern, &metric.name),
            })
        });
        values.max_by(|one, other| one.value.total_cmp(&other.value))
    }

    /// Daemon beside bare loop, with real time.
    fn ratios(&self) -> Vec<&Value> {
        let ratios = self
            .results
            .get("deadline")
            .and_then(|result| result["ratios"].as_array());
        let all = ratios.into_iter().flatten();
        all.filter(|ratio| ratio["realtime"] == true).collect()
    }

    fn own_misses(&self) -> Option<Worst> {
        let ratios = self.ratios();
        let counts = ratios.iter().map(|ratio| ratio["own_misses"].as_f64());
        let value = counts.collect::<Option<Vec<f64>>>()?.into_iter().sum();
        (!ratios.is_empty()).then(|| Worst {
            value,
            of: String::new(),
        })
    }

    fn chance_of_misses(&self) -> Option<Worst> {
        let ratios = self.ratios();
        let loads = ratios.len() as f64;
        let probabilities = ratios.iter().filter_map(|ratio| {
            Some(Worst {
                value: (ratio["misses_p_value"].as_f64()? * loads).min(1.0),
                of: ratio["load"].as_str()?.to_owned(),
            })
        });
        probabilities.min_by(|one, other| one.value.total_cmp(&other.value))
    }

    /// As `latency` judges it, for the period that it measured with.
    fn stop_beyond_period(&self) -> Option<Worst> {
        let targets = self.results.get("latency")?["targets"].as_array()?;
        let values = targets.iter().filter_map(|target| {
            let (p99_us, limit_us) = (target["p99_us"].as_f64()?, target["limit_us"].as_f64()?);
            Some(Worst {
                value: p99_us - limit_us + STOP_MARGIN_US,
                of: target["leg"].as_str()?.to_owned(),
            })
        });
        values.max_by(|one, other| one.value.total_cmp(&other.value))
    }
}

/// Whether a name is as the pattern says; a `*` stands for one of its words.
fn fits(pattern: &str, name: &str) -> bool {
    let (mut wanted, mut words) = (pattern.split('/'), name.split('/'));
    loop {
        match (wanted.next(), words.next()) {
            (None, None) => return true,
            (Some(pattern), Some(word)) if pattern == "*" || pattern == word => {}
            _ => return false,
        }
    }
}

/// The words of a name where the pattern has a `*`.
fn own_part(pattern: &str, name: &str) -> String {
    let pairs = pattern.split('/').zip(name.split('/'));
    let own: Vec<&str> = pairs
        .filter(|(p, _)| *p == "*")
        .map(|(_, word)| word)
        .collect();
    own.join(" ")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn object(value: &Value) -> Map<String, Value> {
        value.as_object().expect("an object").clone()
    }

    #[test]
    fn the_worst_load_counts_and_what_was_not_measured_has_no_row() {
        let metrics = [
            Metric::lower(
                "deadline/none/realtime/wake_p50_to_bare",
                "",
                [1.0, 1.02, 1.01],
            ),
            Metric::lower(
                "deadline/cpu/realtime/wake_p50_to_bare",
                "",
                [1.2, 1.3, 1.1],
            ),
            Metric::lower("deadline/cpu/ordinary/wake_p50_to_bare", "", [9.0]),
        ];
        let found = targets(&metrics, &Map::new());
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!((found[0].found, &*found[0].of), (1.2, "cpu"));
        assert!(!found[0].reached);
    }

    #[test]
    fn misses_are_judged_for_all_loads_together() {
        let ratio = |load: &str, realtime: bool, own: u32, p: f64| json!({ "load": load, "realtime": realtime, "own_misses": own, "misses_p_value": p });
        let results = object(&json!({ "deadline": { "ratios": [
            ratio("none", true, 0, 0.9),
            ratio("cpu", true, 2, 0.03),
            ratio("cpu", false, 70, 0.0),
        ] } }));
        let found = targets(&[], &results);
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!((found[0].found, found[0].reached), (2.0, false));
        // 3 % for one of two loads may well be chance.
        assert_eq!((found[1].found, found[1].reached), (0.06, true));
        assert_eq!(found[1].of, "cpu");
    }

    #[test]
    fn a_stop_is_judged_beyond_the_period_of_its_run() {
        let target =
            |leg: &str, p99_us: f64| json!({ "leg": leg, "p99_us": p99_us, "limit_us": 2100.0 });
        let results = object(&json!({ "latency": { "targets": [
            target("stop.zero_handover", 2050.0),
            target("stop.zero_command", 2130.0),
        ] } }));
        let found = targets(&[], &results);
        assert_eq!((found[0].found, found[0].reached), (130.0, false));
        assert_eq!(found[0].of, "stop.zero_command");
    }

    #[test]
    fn numbers_are_as_long_as_they_say_something() {
        for (value, text) in [
            (0.0, "0"),
            (1.234_56, "1.23"),
            (512.4, "512"),
            (0.2, "0.2"),
            (3e-7, "3.00e-7"),
        ] {
            assert_eq!(number(value), text);
        }
    }
}
