//! Results of `deadline` as rows, plots and single numbers.

use std::collections::BTreeMap;
use std::slice;

use anyhow::Result;
use serde_json::{Map, Value, json};
use statrs::distribution::{Binomial, DiscreteCDF};

use super::stretch::Subject;
use super::tally::{COMMAND, TIME_NAMES, Tally, Times, WAKE, empty_times, times_json};
use super::targets::add_targets;
use super::{DeadlineOptions, Setup};
use crate::chart::{BLUE, Curve, DARK, GREEN, GREY, ORANGE, Panel, Scale, longer, plot};
use crate::dataset::{
    Column, Dataset, Recording, Sheet, each, fixed, joined, number, percent, plain, signed,
    together, word,
};
use crate::load::Load;
use crate::metric::{median, range};
use crate::quantiles::Quantiles;

const SHARES: f64 = 1e-5;

/// Significance level of a difference between two counts of misses.
pub(super) const SIGNIFICANCE: f64 = 0.05;

const EXPLANATION: &str = include_str!("deadline.html");

const RATIOS: [Column; 11] = [
    word("load", "load"),
    word("set-up", "set_up"),
    fixed("wake-up p50", "wake_p50", 2),
    fixed("rounds", "wake_p50_range", 2),
    fixed("wake-up p99", "wake_p99", 2),
    fixed("rounds", "wake_p99_range", 2),
    fixed(
        "command less wake-up p50 µs",
        "command_beyond_wake_p50_us",
        1,
    ),
    fixed("response p99 to no load", "response_p99_to_unloaded", 2),
    plain("own misses", "own_misses"),
    signed("misses beyond bare per 10⁶", "misses_beyond_bare"),
    fixed("by chance", "misses_p_value", 2),
];

const COUNTS: [Column; 18] = [
    word("load", "load"),
    word("set-up", "set_up"),
    word("subject", "subject"),
    plain("cycles", "cycles"),
    plain("late starts", "late_starts"),
    plain("misses", "deadline_misses"),
    plain("skipped", "skipped_periods"),
    plain("platform", "causes_platform"),
    plain("load", "causes_load"),
    plain("compute", "causes_compute"),
    plain("fault", "causes_fault"),
    plain("other", "causes_other"),
    fixed("steal ms", "steal_ms", 0),
    fixed("waited ms", "run_delay_ms", 1),
    plain("lost records", "lost_records"),
    plain("lost commands", "lost_commands"),
    percent("tracking %", "tracking_share", 1),
    plain("cut short", "budget_hits"),
];

const COUNTED: [&str; 9] = [
    "cycles",
    "late_starts",
    "deadline_misses",
    "own_misses",
    "skipped_periods",
    "causes",
    "lost_records",
    "lost_commands",
    "budget_hits",
];

const PLOTS: [(Setup, &str, &str); 2] = [
    (
        Setup::Realtime,
        "deadline-realtime",
        "With real time: share of the cycles that started later than so much after their release, and of \
         the commands that came later to the client. Both axes are logarithmic, and the same in all panels; the \
         upright line is the period.",
    ),
    (
        Setup::Ordinary,
        "deadline-ordinary",
        "The same without real time.",
    ),
];

const TIMES: [Column; 9] = [
    word("load", "load"),
    word("set-up", "set_up"),
    word("subject", "subject"),
    word("from the release to", "to"),
    fixed("min", "min", 1),
    fixed("p50", "p50", 1),
    fixed("p99", "p99", 1),
    fixed("p99.9", "p999", 1),
    fixed("max", "max", 1),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key {
    pub(super) setup: Setup,
    pub(super) load: Load,
    pub(super) subject: Subject,
}

impl Key {
    fn path(self, separator: &str) -> String {
        [self.load.name(), self.setup.name(), self.subject.name()].join(separator)
    }

    fn json(self) -> Value {
        let realtime = self.setup == Setup::Realtime;
        json!({ "load": self.load, "set_up": self.setup, "subject": self.subject, "realtime": realtime })
    }
}

/// All rounds of one subject under one load: a row and the latencies of each round, and all latencies.
pub(super) struct Case {
    pub(super) rounds: Vec<Value>,
    times: Vec<Times>,
    all: Times,
}

pub(super) type Cases = BTreeMap<Key, Case>;

impl Case {
    pub(super) fn new() -> Result<Self> {
        let all = empty_times()?;
        Ok(Self {
            rounds: Vec::new(),
            times: Vec::new(),
            all,
        })
    }

    pub(super) fn push(&mut self, key: Key, of_round: Value, tally: Tally) -> Result<()> {
        for (all, times) in self.all.iter_mut().zip(&tally.times) {
            all.add(times)?;
        }
        let times = times_json(&tally.times);
        // cyclictest reports neither causes nor the wait for its core, and only a daemon has clients.
        let untold = json!({
            "own_misses": null, "causes": null, "run_delay_ms": null,
            "lost_records": null, "lost_commands": null, "budget_hits": null, "tracking_share": null,
        });
        let mut row = joined([untold, key.json(), of_round, tally.counts, times]);
        row["misses_per_million"] = per_million(misses(slice::from_ref(&row))).into();
        self.rounds.push(row);
        self.times.push(tally.times);
        Ok(())
    }

    pub(super) fn sum(&self, key: &str) -> Option<f64> {
        each(&self.rounds, key).reduce(|sum, value| sum + value)
    }

    fn row(&self, key: Key) -> Value {
        let mut all = together(&self.rounds, &COUNTED);
        for of_a_round in ["round", "start_s", "load_did"] {
            all.as_object_mut().and_then(|all| all.remove(of_a_round));
        }
        let names = TIME_NAMES.map(|name| format!("{name}_us"));
        let own = json!({
            "steal_ms": self.sum("steal_ms"),
            "run_delay_ms": self.sum("run_delay_ms"),
            "tracking_share": each(&self.rounds, "tracking_share").reduce(f64::min),
            "median_of_rounds": Map::from_iter(names.map(|name| (name.clone(), all[name].clone()))),
            "rounds": self.rounds,
        });
        joined([all, key.json(), times_json(&self.all), own])
    }
}

fn time_rows(key: Key, times: &Times) -> Vec<Value> {
    const TO: [&str; 4] = [
        "start (wake-up)",
        "hand-over, from the start (compute)",
        "hand-over (response)",
        "the client (command)",
    ];
    let measured = TO.into_iter().zip(times);
    let measured = measured.filter_map(|(to, times)| Some((to, Quantiles::of(times)?)));
    let row = |(to, times)| joined([key.json(), json!({ "to": to }), json!(times)]);
    measured.map(row).collect()
}

/// Deadline misses, and due releases: executed and skipped cycles.
pub(super) fn misses(rounds: &[Value]) -> (u64, u64) {
    let count = |key| each(rounds, key).sum::<f64>() as u64;
    let due = count("cycles") + count("skipped_periods");
    (count("deadline_misses"), due)
}

fn per_million((misses, due): (u64, u64)) -> f64 {
    1e6 * misses as f64 / due.max(1) as f64
}

/// Probability that chance alone gives the daemon at least its part of the misses of both, each given as
/// misses and due cycles. Conditional test of two Poisson rates (Przyborowski and Wilenski, Biometrika 31,
/// 1940). 1 when the daemon missed nothing.
pub(super) fn misses_p_value(ours: (u64, u64), theirs: (u64, u64)) -> f64 {
    let (misses, due) = (ours.0 + theirs.0, ours.1 + theirs.1);
    if ours.0 == 0 || due == 0 {
        return 1.0;
    }
    let share = ours.1 as f64 / due as f64;
    // P(X ≥ n) = P(X > n - 1).
    Binomial::new(share, misses).map_or(1.0, |all| all.sf(ours.0 - 1))
}

/// Ratio of one number in each round of `above` to that in the same round of `below`, if both have it. Both
/// subjects wake up early and spin until the release (`realtime.spin_us`). Starts within a microsecond of the
/// release count as one microsecond, so that no ratio depends on a clock reading.
fn over(above: &Case, below: &Case, key: &str) -> Vec<f64> {
    let pairs = above.rounds.iter().zip(&below.rounds);
    let ratio = |(above, below)| Some(number(above, key)?.max(1.0) / number(below, key)?.max(1.0));
    pairs.filter_map(ratio).collect()
}

pub(super) fn ratio(dataset: &mut Dataset, key: Key, cases: &Cases) -> Option<Value> {
    let of = |load, subject| {
        cases.get(&Key {
            load,
            subject,
            ..key
        })
    };
    let (daemon, bare) = (of(key.load, Subject::Daemon)?, of(key.load, Subject::Bare)?);
    let unloaded = of(Load::None, Subject::Daemon);
    let beyond = |row: &Value| Some(number(row, "command_us_p50")? - number(row, "wake_us_p50")?);
    let [wake_p50, wake_p99] = ["wake_us_p50", "wake_us_p99"].map(|key| over(daemon, bare, key));
    let command: Vec<f64> = daemon.rounds.iter().filter_map(beyond).collect();
    let response = unloaded.map(|unloaded| over(daemon, unloaded, "response_us_p99"));
    let (ours, theirs) = (misses(&daemon.rounds), misses(&bare.rounds));
    let p_value = misses_p_value(ours, theirs);
    let mut row = json!({
        "load": key.load,
        "set_up": key.setup,
        "realtime": key.setup == Setup::Realtime,
        // Per million due cycles; negative when the daemon missed less often.
        "misses_beyond_bare": per_million(ours) - per_million(theirs),
        "misses_p_value": p_value,
        "misses_more": p_value < SIGNIFICANCE,
        "own_misses": daemon.sum("own_misses").map(|count| count as u64),
    });
    for (key_of_row, what, unit, rounds) in [
        ("wake_p50", "wake_p50_to_bare", "", wake_p50),
        ("wake_p99", "wake_p99_to_bare", "", wake_p99),
        (
            "command_beyond_wake_p50_us",
            "command_beyond_wake_p50",
            "µs",
            command,
        ),
        (
            "response_p99_to_unloaded",
            "response_p99_to_unloaded",
            "",
            response.unwrap_or_default(),
        ),
    ] {
        row[key_of_row] = median(rounds.iter().copied()).into();
        row[format!("{key_of_row}_range")] = json!(range(rounds.iter().copied()));
        let (load, setup) = (key.load.name(), key.setup.name());
        dataset.lower(format!("deadline/{load}/{setup}/{what}"), unit, rounds);
    }
    Some(row)
}

pub(super) fn dataset(cases: &Cases, options: &DeadlineOptions, period_us: f64) -> Result<Dataset> {
    let heading = "Deadline misses and latencies, beside a bare loop";
    let mut dataset = Dataset::new("deadline", heading, EXPLANATION);
    let of_daemon = cases.keys().filter(|key| key.subject == Subject::Daemon);
    let ratios = of_daemon.filter_map(|key| ratio(&mut dataset, *key, cases));
    let ratios: Vec<Value> = ratios.collect();
    add_targets(&mut dataset, &ratios, cases, period_us);
    let segment_s = options.segment().as_secs_f64();
    let (mut rows, mut time_table, mut rounds) = (Vec::new(), Vec::new(), Vec::new());
    for (key, case) in cases {
        rows.push(case.row(*key));
        time_table.extend(time_rows(*key, &case.all));
        rounds.extend_from_slice(&case.rounds);
        let path = format!("deadline/{}", key.path("/"));
        if key.subject == Subject::Daemon {
            let misses = ("misses", "per million", "misses_per_million");
            let numbers = [("own_misses", "", "own_misses"), misses];
            dataset.compare(&path, &case.rounds, &numbers);
        }
        for time in ["wake", "response", "command"] {
            for quantile in ["p50", "p99"] {
                let key = format!("{time}_us_{quantile}");
                let values = each(&case.rounds, &key);
                dataset.lower(format!("{path}/{time}_{quantile}"), "µs", values);
            }
        }
        for (round, times) in case.rounds.iter().zip(&case.times) {
            let measured = TIME_NAMES.iter().zip(times);
            let measured = measured.filter(|(_, times)| !times.is_empty());
            let recordings = measured.map(|(name, times)| Recording {
                tag: format!("{}.{name}", key.path(".")),
                start_s: number(round, "start_s").unwrap_or(0.0),
                duration_s: segment_s,
                histogram_ns: times.clone(),
            });
            dataset.recordings.extend(recordings);
        }
    }
    dataset.fact("rounds", options.rounds);
    dataset.fact("segment_s", segment_s);
    let count = options.rounds;
    let of_ratios =
        format!("The daemon over the bare loop: medians of {count} rounds, and their range");
    let of_cases =
        "Cycles that were late, and why (causes of late starts, misses and skipped periods)";
    dataset.sheets = vec![
        Sheet::of(&of_ratios, &RATIOS, ratios).key("ratios"),
        Sheet::of(of_cases, &COUNTS, rows).key("cases"),
        Sheet::of("Latencies of all rounds together, µs", &TIMES, time_table),
        Sheet::of("", &COUNTS, rounds).file("deadline"),
    ];
    for (setup, name, caption) in PLOTS {
        let panels = panels(cases, setup, period_us);
        if !panels.is_empty() {
            dataset.plots.push(plot(name, caption, (2, 520), &panels)?);
        }
    }
    Ok(dataset)
}

fn panels(cases: &Cases, setup: Setup, period_us: f64) -> Vec<Panel> {
    let keys = cases.keys().filter(|key| key.setup == setup);
    let mut loads: Vec<Load> = keys.map(|key| key.load).collect();
    loads.dedup();
    let panel = |load: Load| {
        let mut curves = Vec::new();
        for (subject, time, label, colour) in [
            (Subject::Daemon, COMMAND, "command at the client", GREY),
            (Subject::Cyclictest, WAKE, "cyclictest", ORANGE),
            (Subject::Daemon, WAKE, "daemon", BLUE),
            (Subject::Bare, WAKE, "bare loop", GREEN),
        ] {
            let key = Key {
                setup,
                load,
                subject,
            };
            let case = cases.get(&key).map(|case| longer(&case.all[time]));
            curves.extend(case.map(|points| Curve::line(label, points, colour)));
        }
        // The deadline of a daemon is its period unless configured otherwise.
        curves.push(Curve::upright("period", period_us, SHARES, DARK).width(2));
        let axes = ["later than, µs after the release", "share of the cycles"];
        let scale = Scale::LogLog { floor: SHARES };
        Panel::new(format!("Load {}", load.name()), axes, scale, curves)
    };
    loads.into_iter().map(panel).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_misses_as_the_bare_loop_are_no_difference() {
        for (ours, theirs, expected) in [
            ((0, 1000), (9, 1000), 1.0),
            // One of one: probability 1/2.
            ((1, 1000), (0, 1000), 0.5),
            // Five of five: (1/2)^5.
            ((5, 1000), (0, 1000), 1.0 / 32.0),
            // At least 3 of 4: (4 + 1) / 16.
            ((3, 1000), (1, 1000), 5.0 / 16.0),
            // With twice the cycles, a miss is the daemon's with probability 2/3: at least 1 of 1.
            ((1, 2000), (0, 1000), 2.0 / 3.0),
        ] {
            assert!(
                (misses_p_value(ours, theirs) - expected).abs() < 1e-9,
                "{ours:?}"
            );
        }
        assert!((per_million((1, 2000)) - 500.0).abs() < 1e-9);
    }
}
