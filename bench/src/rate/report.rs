//! Results of the rates as rows, plots and single numbers.

use anyhow::Result;
use serde_json::{Value, json};

use super::trial::Trial;
use super::{RateCase, Shortest};
use crate::chart::{BLUE, DARK, GREEN, ORANGE, Panel, Scale, of_rows};
use crate::dataset::{Dataset, each, filled, joined};

pub(super) fn dataset(
    realtime: bool,
    spin_us: Option<f64>,
    steps: Vec<Vec<Trial>>,
    shortest: &[Shortest],
) -> Result<Dataset> {
    let how = how(realtime, spin_us);
    let mut dataset = declared();
    dataset.fact("realtime", realtime);
    dataset.fact("spin_us", spin_us);
    let (mut default, mut rounds) = (Vec::new(), Vec::new());
    for step in &steps {
        let of_step = rows(step);
        let merged = dataset.merge("default", &of_step);
        default.push(step_row(step, merged, &of_step));
        rounds.extend(of_step);
    }
    let (mut found, mut trials) = (Vec::new(), Vec::new());
    for shortest in shortest {
        let row = shortest_row(shortest);
        let name = "rate/shortest/{sections}-sections/{solver}/n{horizon_steps}";
        dataset.lower(filled(name, &row), "ms", shortest.held_ms);
        found.push(row);
        trials.extend(rows(&shortest.trials));
    }
    dataset.plot("rate", &panels(&default))?;
    dataset.add_titled("shortest", &[&how], found);
    dataset.add_titled("default", &[&RateCase::DEFAULT.name(), &how], default);
    dataset.add("all", [&rounds[..], &trials].concat());
    dataset.add("default_rounds", rounds);
    dataset.add("trials", trials);
    let trials = steps.into_iter().flatten();
    dataset.recordings = trials.filter_map(|trial| trial.responses).collect();
    Ok(dataset)
}

fn declared() -> Dataset {
    Dataset::new("rate", include_str!("rate.toml"))
}

fn rows(trials: &[Trial]) -> Vec<Value> {
    trials.iter().map(|trial| trial.row.clone()).collect()
}

fn how(realtime: bool, spin_us: Option<f64>) -> String {
    let refused = [", without SCHED_FIFO (not granted)", ""][usize::from(realtime)];
    match spin_us {
        None => refused.to_owned(),
        Some(0.0) => format!(", without rehearsal or spinning{refused}"),
        Some(us) => format!(", spinning {us} µs (at most a quarter of the period){refused}"),
    }
}

/// Plot of the default case at each rate, from the rows of its result, as SVG.
pub fn picture(rows: &[Value]) -> Result<String> {
    let mut dataset = declared();
    dataset.plot("rate", &panels(rows))?;
    Ok(dataset.declaration.plots.remove(0).svg)
}

fn panels(rows: &[Value]) -> [Panel; 2] {
    let line = |label: &str, key: &str, colour| of_rows(label, rows, "rate_hz", key, colour);
    let panel = |title: &str, y, scale, curves| Panel::new(title, ["rate [Hz]", y], scale, curves);
    let times = vec![
        line("period", "period_us", DARK),
        line("p99.9", "response_us_p999", ORANGE),
        line("p99", "response_us_p99", GREEN),
        line("p50", "response_us_p50", BLUE),
    ];
    let shares = vec![
        line("of the core", "core_share", BLUE),
        line("solves cut short", "budget_hit_share", ORANGE),
    ];
    let (title, scale) = ("Response of the default", Scale::LogLog { floor: 1.0 });
    [
        panel(title, "response time [µs]", scale, times),
        panel("What it costs", "share", Scale::LogAcross, shares),
    ]
}

fn shortest_row(shortest: &Shortest) -> Value {
    let (held_ms, failed_ms) = (shortest.held_ms, shortest.failed_ms);
    let [held, failed] = [held_ms, failed_ms].map(|ms| shortest.trials_with(ms));
    let remarks = failed.last().map(|trial| trial.remarks());
    let failed_in = held_in(&failed);
    let ended_by = match (failed_ms, remarks) {
        (Some(ms), Some(remarks)) => format!("{ms} ms, held in {failed_in} trials: {remarks}"),
        _ if held.is_empty() => String::new(),
        _ => "nothing: no shorter one was tried".to_owned(),
    };
    let own = json!({
        "shortest_period_ms": held_ms,
        "rate_hz": held_ms.map(|held_ms| 1e3 / held_ms),
        "trials_held": count_held(&held),
        "trials": held.len(),
        "ended_by": ended_by,
        "held_in": if held.is_empty() { String::new() } else { held_in(&held) },
        "failed_period_ms": failed_ms,
        "failed_trials_held": count_held(&failed),
        "failed_trials": failed.len(),
        "failed_remarks": remarks,
        "held": held.last().map(|trial| &trial.row),
    });
    joined([json!(shortest.case), own])
}

fn count_held(trials: &[&Trial]) -> usize {
    trials.iter().filter(|trial| trial.holds()).count()
}

fn held_in(trials: &[&Trial]) -> String {
    format!("{} of {}", count_held(trials), trials.len())
}

fn step_row(trials: &[Trial], all: Value, rounds: &[Value]) -> Value {
    // The first round that did not hold, otherwise the last one.
    let shown = trials.iter().find(|trial| !trial.holds()).or(trials.last());
    let sum = |keys: &[&str]| keys.iter().filter_map(|key| all[key].as_f64()).sum::<f64>();
    let due = sum(&["cycles", "skipped_periods"]).max(1.0);
    let trials: Vec<&Trial> = trials.iter().collect();
    let own = json!({
        "rounds": trials.len(),
        "rounds_held": count_held(&trials),
        "held_in": held_in(&trials),
        "lost_share": sum(&["deadline_misses", "skipped_periods"]) / due,
        "tracking_share_least": each(rounds, "tracking_share").reduce(f64::min).unwrap_or(0.0),
        "remarks": shown.map(Trial::remarks).unwrap_or_default(),
    });
    joined([all, own])
}

#[cfg(test)]
mod tests {
    use super::super::tests::trial;
    use super::super::trial::TrialOutcome::{Holds, NotFollowed};
    use super::*;

    #[test]
    fn what_failed_is_reported_and_is_no_value_of_a_metric() {
        let tried = |period_ms, outcomes: &[_]| -> Vec<Trial> {
            let outcomes = outcomes.iter();
            outcomes.map(|outcome| trial(period_ms, *outcome)).collect()
        };
        let mut trials = tried(0.5, &[NotFollowed, Holds]);
        trials.extend(tried(0.25, &[NotFollowed; 3]));
        let steps = vec![tried(5.0, &[Holds; 2]), tried(0.1, &[Holds, NotFollowed])];
        let shortest = Shortest {
            case: RateCase::DEFAULT,
            trials,
            held_ms: Some(0.5),
            failed_ms: Some(0.25),
        };
        let found = dataset(false, Some(0.0), steps, &[shortest]).unwrap();
        let text = found.text();
        let ended = "0.25 ms, held in 0 of 3 trials: too short";
        for words in ["not granted", "without rehearsal", ended] {
            assert!(text.contains(words), "{words} in {text}");
        }
        for (name, rounds) in [
            ("rate/default/200-hz/response_p50", &[30.0, 30.0][..]),
            ("rate/default/10000-hz/response_p50", &[30.0]),
            ("rate/default/10000-hz/core", &[20.0]),
            ("rate/shortest/3-sections/kpso-refined/n2", &[0.5]),
        ] {
            let metric = found.metrics.iter().find(|metric| metric.name == name);
            assert_eq!(metric.unwrap().rounds, rounds, "{name}");
        }
    }
}
