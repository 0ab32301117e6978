//! Results of `deadline` as rows, plots, metrics and targets.

use std::collections::BTreeMap;
use std::slice;

use anyhow::Result;
use serde_json::{Map, Value, json};
use statrs::distribution::{Binomial, DiscreteCDF};

use super::stretch::Subject;
use super::tally::{COMMAND, TIME_NAMES, Tally, Times, WAKE, times_json};
use super::{DeadlineOptions, Setup};
use crate::chart::{BLUE, Curve, DARK, GREEN, GREY, ORANGE, Panel, Scale, longer};
use crate::dataset::{Dataset, Recording, each, joined, number};
use crate::load::Load;
use crate::metric::range;
use crate::quantiles::{pooled, quantiles};

const SHARES: f64 = 1e-5;
/// Significance level of a difference between two counts of misses.
const SIGNIFICANCE: f64 = 0.05;

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

/// All rounds of one subject under one load: a row and the latencies of each round.
#[derive(Default)]
pub(super) struct DeadlineCase {
    rounds: Vec<Value>,
    times: Vec<Times>,
}

pub(super) type Cases = BTreeMap<Key, DeadlineCase>;

impl DeadlineCase {
    pub(super) fn push(&mut self, key: Key, of_round: Value, tally: Tally) {
        // cyclictest reports neither causes nor the wait for its core, and only a daemon has clients.
        let untold = json!({
            "own_misses": null, "causes": null, "run_delay_ms": null,
            "lost_records": null, "lost_commands": null, "budget_hits": null, "tracking_share": null,
        });
        let times = times_json(&tally.times);
        let mut row = joined([untold, key.json(), of_round, tally.counts, times]);
        row["misses_per_million"] = per_million(misses(slice::from_ref(&row))).into();
        self.rounds.push(row);
        self.times.push(tally.times);
    }

    fn sum(&self, key: &str) -> Option<f64> {
        each(&self.rounds, key).reduce(|sum, value| sum + value)
    }

    fn pooled(&self) -> Times {
        std::array::from_fn(|time| pooled(self.times.iter().map(|times| &times[time])))
    }

    fn row(&self, key: Key, merged: Value, all: &Times) -> Value {
        let names = TIME_NAMES.map(|name| format!("{name}_us"));
        let medians = names.map(|name| (name.clone(), merged[name].clone()));
        let own = json!({
            "steal_ms": self.sum("steal_ms"),
            "run_delay_ms": self.sum("run_delay_ms"),
            "tracking_share": each(&self.rounds, "tracking_share").reduce(f64::min),
            "median_of_rounds": Map::from_iter(medians),
            "rounds": self.rounds,
        });
        let mut row = joined([merged, key.json(), times_json(all), own]);
        for of_a_round in ["round", "start_s", "load_did"] {
            row.as_object_mut().and_then(|row| row.remove(of_a_round));
        }
        row
    }
}

fn time_rows(key: Key, times: &Times) -> impl Iterator<Item = Value> {
    const TO: [&str; 4] = [
        "start (wake-up)",
        "hand-over, from the start (compute)",
        "hand-over (response)",
        "the client (command)",
    ];
    let measured = TO.into_iter().zip(times).filter(|(_, it)| !it.is_empty());
    measured.map(move |(to, times)| joined([key.json(), json!({ "to": to }), quantiles(times)]))
}

/// Deadline misses, and due releases: executed and skipped cycles.
fn misses(rounds: &[Value]) -> (u64, u64) {
    let count = |key| each(rounds, key).sum::<f64>() as u64;
    let due = count("cycles") + count("skipped_periods");
    (count("deadline_misses"), due)
}

fn per_million((misses, due): (u64, u64)) -> f64 {
    1e6 * misses as f64 / due.max(1) as f64
}

/// Probability that chance alone gives the daemon at least its part of the misses of both: conditional test of two
/// Poisson rates (Przyborowski and Wilenski, Biometrika 31, 1940).
fn misses_p_value(ours: (u64, u64), theirs: (u64, u64)) -> f64 {
    let (misses, due) = (ours.0 + theirs.0, ours.1 + theirs.1);
    if ours.0 == 0 || due == 0 {
        return 1.0;
    }
    let share = ours.1 as f64 / due as f64;
    // P(X ≥ n) = P(X > n - 1).
    Binomial::new(share, misses).map_or(1.0, |all| all.sf(ours.0 - 1))
}

/// The daemon, which has the key, beside the bare loop in each round. Both wake up early and spin until the release
/// (`realtime.spin_us`): starts within a microsecond of the release count as one microsecond, so that no ratio
/// depends on a clock reading.
fn ratio(dataset: &mut Dataset, key: Key, cases: &Cases) -> Option<Value> {
    let (subject, load) = (Subject::Bare, Load::None);
    let (daemon, bare) = (cases.get(&key)?, cases.get(&Key { subject, ..key })?);
    let unloaded = cases.get(&Key { load, ..key });
    let of_round = |round: usize| {
        let at = |case: &DeadlineCase, name| number(case.rounds.get(round)?, name);
        let over = |below, name| Some(at(daemon, name)?.max(1.0) / at(below, name)?.max(1.0));
        let wake_us = at(daemon, "wake_us_p50");
        let command = at(daemon, "command_us_p50").zip(wake_us);
        json!({
            "load": key.load,
            "set_up": key.setup,
            "wake_p50": over(bare, "wake_us_p50"),
            "wake_p99": over(bare, "wake_us_p99"),
            "command_beyond_wake_p50_us": command.map(|(command_us, wake_us)| command_us - wake_us),
            "response_p99_to_unloaded": unloaded.and_then(|below| over(below, "response_us_p99")),
        })
    };
    let rounds: Vec<Value> = (0..daemon.rounds.len()).map(of_round).collect();
    let mut row = dataset.merge("ratios", &rounds);
    for (_, _, name) in &dataset.table("ratios").metrics {
        row[format!("{name}_range")] = json!(range(each(&rounds, name)));
    }
    let (ours, theirs) = (misses(&daemon.rounds), misses(&bare.rounds));
    let p_value = misses_p_value(ours, theirs);
    let of_all = json!({
        "realtime": key.setup == Setup::Realtime,
        // Per million due cycles; negative when the daemon missed less often.
        "misses_beyond_bare": per_million(ours) - per_million(theirs),
        "misses_p_value": p_value,
        "misses_more": p_value < SIGNIFICANCE,
        "own_misses": daemon.sum("own_misses").map(|count| count as u64),
    });
    Some(joined([row, of_all]))
}

fn add_targets(dataset: &mut Dataset, cases: &Cases, period_us: f64) {
    let (mut all, mut both) = (Vec::new(), [Vec::new(), Vec::new()]);
    let is_ours = |key: &Key| (key.setup, key.subject) == (Setup::Realtime, Subject::Daemon);
    for (key, case) in cases.iter().filter(|(key, _)| is_ours(key)) {
        all.extend_from_slice(&case.rounds);
        // Only loads that were measured with both subjects.
        let subject = Subject::Bare;
        if let Some(bare) = cases.get(&Key { subject, ..*key }) {
            both[0].extend_from_slice(&case.rounds);
            both[1].extend_from_slice(&bare.rounds);
        }
    }
    let (own, due) = (each(&all, "own_misses").sum(), misses(&all).1);
    let minutes = format!("{:.1} min", due as f64 * period_us / 60e6);
    let own = (due > 0).then_some((own, Value::Null, minutes));
    let [ours, theirs] = both.map(|rounds| misses(&rounds));
    let what = "misses with cause compute or fault, all loads";
    dataset.target([what, "0", ""], own, 0.0..=0.0);
    let ((our_misses, our_due), (their_misses, their_due)) = (ours, theirs);
    let of = format!("{our_misses} of {our_due} against {their_misses} of {their_due}");
    let chance = (ours.1 > 0).then(|| (misses_p_value(ours, theirs), Value::Null, of));
    let what = "misses beyond the bare loop's, all loads: probability by chance";
    dataset.target([what, "not below 0.05", ""], chance, SIGNIFICANCE..=1.0);
}

pub(super) fn dataset(cases: &Cases, options: &DeadlineOptions, period_us: f64) -> Result<Dataset> {
    let mut dataset = Dataset::new("deadline", include_str!("deadline.toml"));
    let of_daemon = cases.keys().filter(|key| key.subject == Subject::Daemon);
    let ratios = of_daemon.filter_map(|key| ratio(&mut dataset, *key, cases));
    let ratios: Vec<Value> = ratios.collect();
    add_targets(&mut dataset, cases, period_us);
    let segment_s = options.segment().as_secs_f64();
    let (mut rows, mut time_table, mut rounds) = (Vec::new(), Vec::new(), Vec::new());
    let mut curves = BTreeMap::<_, Vec<Curve>>::new();
    for (key, case) in cases {
        let (all, merged) = (case.pooled(), dataset.merge("cases", &case.rounds));
        if key.subject == Subject::Daemon {
            dataset.compare("rounds", &merged, &case.rounds);
        }
        rows.push(case.row(*key, merged, &all));
        time_table.extend(time_rows(*key, &all));
        rounds.extend_from_slice(&case.rounds);
        for (round, times) in case.rounds.iter().zip(&case.times) {
            let recordings = TIME_NAMES.iter().zip(times).map(|(name, times)| Recording {
                tag: format!("{}.{name}", key.path(".")),
                start_s: number(round, "start_s").unwrap_or(0.0),
                duration_s: segment_s,
                histogram_ns: times.clone(),
            });
            let measured = recordings.filter(|it| !it.histogram_ns.is_empty());
            dataset.recordings.extend(measured);
        }
        // The last subject is drawn first.
        let of_load = curves.entry((key.setup, key.load)).or_default();
        of_load.splice(..0, drawn(key.subject, &all));
    }
    dataset.fact("rounds", options.rounds);
    dataset.fact("segment_s", segment_s);
    dataset.add_titled("ratios", &[&options.rounds.to_string()], ratios);
    dataset.add("cases", rows);
    dataset.add("times", time_table);
    dataset.add("rounds", rounds);
    let mut panels = BTreeMap::<Setup, Vec<Panel>>::new();
    for ((setup, load), curves) in curves {
        let of_setup = panels.entry(setup).or_default();
        of_setup.push(panel(load, curves, period_us));
    }
    for (setup, panels) in panels {
        dataset.plot(&format!("deadline-{}", setup.name()), &panels)?;
    }
    Ok(dataset)
}

fn drawn(subject: Subject, times: &Times) -> Vec<Curve> {
    let curve = |time: usize, label, colour| Curve::line(label, longer(&times[time]), colour);
    match subject {
        Subject::Bare => vec![curve(WAKE, "bare loop", GREEN)],
        Subject::Daemon => vec![
            curve(COMMAND, "command at the client", GREY),
            curve(WAKE, "daemon", BLUE),
        ],
        Subject::Cyclictest => vec![curve(WAKE, "cyclictest", ORANGE)],
    }
}

fn panel(load: Load, mut curves: Vec<Curve>, period_us: f64) -> Panel {
    // The deadline of a daemon is its period unless configured otherwise.
    curves.push(Curve::upright("period", period_us, SHARES, DARK).width(2));
    let axes = ["later than, µs after the release", "share of the cycles"];
    let scale = Scale::LogLog { floor: SHARES };
    Panel::new(format!("Load {}", load.name()), axes, scale, curves)
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
            // At least 3 of 4: (4 + 1) / 16.
            ((3, 1000), (1, 1000), 5.0 / 16.0),
            // With twice the cycles, a miss is the daemon's with probability 2/3: at least 1 of 1.
            ((1, 2000), (0, 1000), 2.0 / 3.0),
        ] {
            let found = misses_p_value(ours, theirs);
            assert!((found - expected).abs() < 1e-9, "{ours:?}");
        }
    }

    #[test]
    fn misses_are_compared_for_all_loads_together_and_ratios_by_the_worst_load() {
        use Subject::{Bare, Cyclictest, Daemon};
        let (mut cases, setup) = (Cases::new(), Setup::Realtime);
        for (load, subject, misses, own, wake_us) in [
            (Load::None, Daemon, 1, 0, 10.0),
            (Load::None, Bare, 2, 0, 10.0),
            (Load::Cpu, Daemon, 3, 2, 26.0),
            (Load::Cpu, Bare, 2, 0, 20.0),
            (Load::Cpu, Cyclictest, 9000, 0, 20.0),
            (Load::Io, Daemon, 0, 0, 90.0),
        ] {
            let key = Key {
                setup,
                load,
                subject,
            };
            let row = json!({
                "cycles": 11_000, "skipped_periods": 1000, "deadline_misses": misses, "own_misses": own,
                "wake_us": { "p50": wake_us },
            });
            let (rounds, times) = (vec![joined([key.json(), row])], Vec::new());
            cases.insert(key, DeadlineCase { rounds, times });
        }
        let mut dataset = Dataset::new("deadline", include_str!("deadline.toml"));
        for key in cases.keys().filter(|key| key.subject == Daemon) {
            ratio(&mut dataset, *key, &cases);
        }
        add_targets(&mut dataset, &cases, 5000.0);
        let targets = dataset.all_targets();
        let keys = ["found", "of", "reached"];
        let words = |row: &Value| keys.map(|key| row[key].to_string()).join(" ");
        let found: Vec<_> = targets.iter().map(words).collect();
        assert_eq!(found[0], "1.3 \"cpu\" false");
        assert_eq!(found[1], "2.0 \"3.0 min\" false");
        assert!(found[2].contains("4 of 24000 against 4 of 24000") && found[2].ends_with("true"));
        assert_eq!(found.len(), 3, "{found:?}");
    }
}
