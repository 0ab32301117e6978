//! What the rates say, as rows, plots and single numbers.

use anyhow::Result;
use serde_json::{Value, json, to_value};

use super::case::Case;
use super::trial::Trial;
use super::trial_metrics::TrialMetrics;
use super::{Measured, Shortest, Tried};
use crate::chart::{BLUE, Curve, DARK, GREEN, ORANGE, Panel, Scale, sheet};
use crate::dataset::{Column, Dataset, Plot, Recording, Sheet, fixed, percent, plain, power, word};
use crate::metric::median;

const EXPLANATION: &str = "<p>A period holds when, of a daemon that really tracks the spiral, at most 0.1 % of the releases were lost \
         (no cycle, or a command handed over after the end of the period), and no cycle was late by the \
         daemon's own doing (cause compute or page fault), in its own statistics of at least 2 s and 4000 periods.</p>\
         <p>A late cycle of the daemon's own doing decides at once. A trial that only lost releases is tried once \
         more; up to twice where the machine lost them while the work itself fits into the period. Every trial is kept.</p>\
         <p>A solve ends with its time, so a period can hold with solves that were cut short: their share, and the \
         distance of the tip from its reference, are what the shorter period costs. Core % is what the cycle and the \
         exchange use together of their core; Linux halts real-time threads beyond 95 %.</p>";

const STEPS: [Column; 20] = [
    plain("rate Hz", "rate_hz"),
    word("held in rounds", "held_in"),
    word("remarks", "remarks"),
    fixed("wake-up p50 µs", "wake_p50_us", 1),
    fixed("p99 µs", "wake_p99_us", 1),
    fixed("solve p50 µs", "solve_p50_us", 1),
    fixed("response p50 µs", "response_p50_us", 1),
    fixed("p99 µs", "response_p99_us", 1),
    fixed("p99.9 µs", "response_p999_us", 1),
    percent("core %", "core_share", 1),
    percent("cut short %", "budget_hit_share", 1),
    percent("stale %", "stale_input_share", 1),
    plain("own misses", "own_misses"),
    plain("late cycles", "late_cycles"),
    plain("beyond the period", "deadline_misses"),
    plain("skipped", "skipped_periods"),
    plain("of cycles", "cycles"),
    percent("lost %", "lost_share", 3),
    percent("followed %", "tracking_share_least", 1),
    power("error p99 mm", "error_p99_mm"),
];

const SHORTEST: [Column; 16] = [
    word("solver", "solver"),
    word("what ends it", "ended_by"),
    plain("N", "horizon_steps"),
    plain("sections", "sections"),
    plain("shortest ms", "shortest_period_ms"),
    plain("held in trials", "held_in"),
    fixed("response p50 µs", "held_response_us_p50", 1),
    fixed("p99 µs", "held_response_us_p99", 1),
    fixed("p99.9 µs", "held_response_us_p999", 1),
    percent("core %", "core_share", 1),
    percent("cut short %", "held_budget_hit_share", 1),
    plain("beyond the period", "held_deadline_misses"),
    plain("skipped", "held_skipped_periods"),
    plain("of cycles", "held_cycles"),
    percent("lost %", "lost_share", 3),
    power("error p99 mm", "held_error_p99_mm"),
];

pub(super) fn dataset(measured: Measured) -> Result<Dataset> {
    let steps: Vec<Value> = measured.steps.iter().map(step_row).collect();
    let shortest: Result<Vec<Value>> = measured.shortest.iter().map(shortest_row).collect();
    let rounds: Vec<&Trial> = measured
        .steps
        .iter()
        .flat_map(|step| &step.trials)
        .collect();
    let all: Vec<&Trial> = rounds.iter().copied().chain(&measured.trials).collect();
    let how = how(&measured);
    let title = format!(
        "The default ({}) with shorter and shorter periods, medians over rounds{how}",
        Case::DEFAULT.name()
    );
    let mut dataset = Dataset {
        name: "rate",
        heading: "How fast the loop can go",
        explanation: EXPLANATION,
        sheets: vec![
            Sheet::new(&shortest?)?
                .key("shortest")
                .file("rate")
                .table(format!("Shortest period that holds{how}"), &SHORTEST),
            Sheet::new(&steps)?
                .key("default")
                .file("rate-default")
                .table(title, &STEPS),
            Sheet::new(&rounds)?.key("default_rounds"),
            Sheet::new(&measured.trials)?.key("trials"),
            Sheet::new(&all)?.file("rate-trials"),
        ],
        plots: vec![plot(&steps)?],
        ..Dataset::default()
    };
    dataset.fact("realtime", measured.realtime);
    dataset.fact("spin_us", measured.spin_us);
    metrics(&mut dataset, &measured);
    let begin_ns = measured.begin_ns;
    let trials = measured.steps.into_iter().flat_map(|step| step.trials);
    let recording = |trial: Trial| {
        Some(Recording {
            tag: trial.tag,
            start_s: trial.begin_ns.saturating_sub(begin_ns) as f64 * 1e-9,
            duration_s: trial.metrics?.duration_s,
            histogram_ns: trial.responses,
        })
    };
    dataset.recordings = trials.filter_map(recording).collect();
    Ok(dataset)
}

fn how(measured: &Measured) -> String {
    let spin = if measured.spin_us > 0.0 {
        let spin_us = measured.spin_us;
        format!(", spinning {spin_us} µs (at most a quarter of the period)")
    } else {
        String::new()
    };
    if measured.realtime {
        spin
    } else {
        spin + ", without SCHED_FIFO (not granted)"
    }
}

fn metrics(dataset: &mut Dataset, measured: &Measured) {
    type Quantity = (&'static str, &'static str, fn(&TrialMetrics) -> f64);
    let quantities: [Quantity; 6] = [
        ("response_p50", "µs", |f| f.response_us.p50),
        ("response_p99", "µs", |f| f.response_us.p99),
        ("response_p999", "µs", |f| f.response_us.p999),
        ("core", "%", |f| 100.0 * f.core_share()),
        ("cut_short", "%", |f| 100.0 * f.budget_hit_share),
        ("own_misses", "", |f| f.causes.own() as f64),
    ];
    for step in &measured.steps {
        let rate_hz = rate_hz(step.period_ms).round();
        for (what, unit, value) in quantities {
            let name = format!("rate/default/{rate_hz}-hz/{what}");
            dataset.lower(name, unit, measured_in(step).map(value));
        }
    }
    for shortest in &measured.shortest {
        let name = format!("rate/shortest/{}", shortest.case.key());
        let held_ms = shortest.held.as_ref().map(|held| held.period_ms);
        dataset.lower(name, "ms", held_ms);
    }
}

fn plot(rows: &[Value]) -> Result<Plot> {
    let line = |label: &str, key: &str, factor: f64, colour| {
        let point = |row: &Value| {
            let (rate_hz, value) = (row["rate_hz"].as_f64()?, row[key].as_f64()?);
            Some((rate_hz * 1e-3, value * factor))
        };
        Curve::line(label, rows.iter().filter_map(point).collect(), colour)
    };
    let times = Panel {
        title: "Response of the default".to_owned(),
        x: "rate [kHz]",
        y: "[µs]",
        scale: Scale::LogLog { floor: 1.0 },
        curves: vec![
            line("period", "period_ms", 1e3, DARK),
            line("p99.9", "response_p999_us", 1.0, ORANGE),
            line("p99", "response_p99_us", 1.0, GREEN),
            line("p50", "response_p50_us", 1.0, BLUE),
        ],
    };
    let shares = Panel {
        title: "What it costs".to_owned(),
        x: "rate [kHz]",
        y: "[%]",
        scale: Scale::Linear,
        curves: vec![
            line("of the core", "core_share", 100.0, BLUE),
            line("solves cut short", "budget_hit_share", 100.0, ORANGE),
        ],
    };
    Ok(Plot {
        name: "rate",
        caption: "The default with shorter and shorter periods. The response is that of the cycles that ran: \
                  releases without a cycle are not in it.",
        svg: sheet(&[times, shares], 2, 620)?,
    })
}

fn shortest_row(shortest: &Shortest) -> Result<Value> {
    let (held, failed) = (shortest.held.as_ref(), shortest.failed.as_ref());
    let last = |tried: Option<&Tried>| tried.and_then(|tried| tried.trials.last().cloned());
    let metrics = last(held).and_then(|trial| trial.metrics);
    let counts =
        |tried: Option<&Tried>| tried.map_or((0, 0), |tried| (tried.held(), tried.trials.len()));
    let ended_by = match (failed, held) {
        (Some(failed), _) => format!(
            "{} ms, held in {} trials: {}",
            failed.period_ms,
            held_in(failed),
            last(Some(failed)).map_or_else(String::new, |trial| trial.remarks)
        ),
        (None, Some(_)) => "nothing: no shorter one was tried".to_owned(),
        (None, None) => String::new(),
    };
    let period_ms = held.map(|held| held.period_ms);
    let mut row = json!({
        "sections": shortest.case.sections,
        "solver": shortest.case.solver,
        "horizon_steps": shortest.case.horizon_steps,
        "shortest_period_ms": period_ms,
        "rate_hz": period_ms.map(rate_hz),
        "trials_held": counts(held).0,
        "trials": counts(held).1,
        "core_share": metrics.as_ref().map(TrialMetrics::core_share),
        "lost_share": metrics.as_ref().map(TrialMetrics::lost_share),
        "ended_by": ended_by,
        "held_in": held.map_or_else(String::new, held_in),
        "failed_period_ms": failed.map(|failed| failed.period_ms),
        "failed_trials_held": counts(failed).0,
        "failed_trials": counts(failed).1,
        "failed_remarks": last(failed).map(|trial| trial.remarks),
    });
    if let Some(held) = last(held) {
        row["held"] = to_value(held)?;
    }
    Ok(row)
}

fn held_in(tried: &Tried) -> String {
    format!("{} of {}", tried.held(), tried.trials.len())
}

/// Of each round in which the robot followed.
fn measured_in(step: &Tried) -> impl Iterator<Item = &TrialMetrics> {
    let trials = step.trials.iter();
    trials.filter_map(|trial| trial.metrics.as_ref())
}

/// Medians over the rounds, and sums of what was counted.
fn step_row(step: &Tried) -> Value {
    let middle = |value: fn(&TrialMetrics) -> f64| median(measured_in(step).map(value));
    let sum = |count: fn(&TrialMetrics) -> u64| -> u64 { measured_in(step).map(count).sum() };
    let tracking = measured_in(step).map(|f| f.tracking_share);
    // Those of the first round that did not hold, or else of the last one.
    let failed = step.trials.iter().find(|trial| !trial.holds);
    let told = failed.or(step.trials.last());
    json!({
        "period_ms": step.period_ms,
        "rate_hz": rate_hz(step.period_ms),
        "rounds": step.trials.len(),
        "rounds_held": step.held(),
        "wake_p50_us": middle(|f| f.wake_us.p50),
        "wake_p99_us": middle(|f| f.wake_us.p99),
        "solve_p50_us": middle(|f| f.solve_us.p50),
        "response_p50_us": middle(|f| f.response_us.p50),
        "response_p99_us": middle(|f| f.response_us.p99),
        "response_p999_us": middle(|f| f.response_us.p999),
        "core_share": middle(TrialMetrics::core_share),
        "budget_hit_share": middle(|f| f.budget_hit_share),
        "stale_input_share": middle(|f| f.stale_input_share),
        "error_p99_mm": middle(|f| f.error_p99_mm),
        "cycles": sum(|f| f.cycles),
        "own_misses": sum(|f| f.causes.own()),
        "late_cycles": sum(|f| f.causes.all()),
        "deadline_misses": sum(|f| f.deadline_misses),
        "skipped_periods": sum(|f| f.skipped_periods),
        "lost_share": sum(TrialMetrics::lost) as f64 / sum(TrialMetrics::due).max(1) as f64,
        "dropped_records": sum(|f| f.dropped_records),
        "tracking_share_least": tracking.reduce(f64::min).unwrap_or(0.0),
        "remarks": told.map_or("", |trial| &trial.remarks),
        "held_in": held_in(step),
    })
}

fn rate_hz(period_ms: f64) -> f64 {
    1e3 / period_ms
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantiles::histogram;
    use crate::rate::trial_metrics::tests::quiet;

    fn trial(period_ms: f64, holds: bool) -> Trial {
        Trial {
            case: Case::DEFAULT,
            period_ms,
            spin_us: 0.0,
            holds,
            remarks: if holds { "" } else { "too short" }.to_owned(),
            metrics: holds.then(quiet),
            tag: "tag".to_owned(),
            responses: histogram().unwrap(),
            begin_ns: 1,
        }
    }

    #[test]
    fn what_failed_is_told_and_is_no_value_of_a_metric() {
        let tried = |period_ms, holds: &[bool]| Tried {
            period_ms,
            trials: holds.iter().map(|holds| trial(period_ms, *holds)).collect(),
        };
        let (held, failed) = (tried(0.5, &[false, true]), tried(0.25, &[false; 3]));
        let found = dataset(Measured {
            realtime: false,
            spin_us: 0.0,
            begin_ns: 0,
            steps: vec![tried(5.0, &[true, true]), tried(0.1, &[true, false])],
            trials: [&held.trials[..], &failed.trials].concat(),
            shortest: vec![Shortest {
                case: Case::DEFAULT,
                held: Some(held),
                failed: Some(failed),
            }],
        })
        .unwrap();
        let json = found.json();
        assert_eq!(json["default"][1]["rounds_held"], 1);
        assert_eq!(json["default"][1]["remarks"], "too short");
        assert_eq!(json["shortest"][0]["shortest_period_ms"], 0.5);
        assert_eq!(json["shortest"][0]["failed_period_ms"], 0.25);
        assert_eq!(json["trials"][2]["holds"], false);
        let text = found.text();
        assert!(
            text.contains("0.25 ms, held in 0 of 3 trials: too short")
                && text.contains("1 of 2")
                && text.contains("not granted"),
            "{text}"
        );
        let of = |name: &str| {
            found
                .metrics
                .iter()
                .find(|metric| metric.name == name)
                .unwrap()
        };
        assert_eq!(of("rate/default/200-hz/response_p50").rounds, [30.0, 30.0]);
        assert_eq!(of("rate/default/10000-hz/response_p50").rounds, [30.0]);
        assert_eq!(of("rate/shortest/3-sections/kpso-refined/n2").rounds, [0.5]);
        assert_eq!(found.recordings.len(), 3);
    }
}
