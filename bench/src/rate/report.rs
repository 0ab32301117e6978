//! Results of the rates as rows, plots and single numbers.

use anyhow::Result;
use serde_json::{Value, json};

use super::trial::Trial;
use super::{Case, Shortest};
use crate::chart::{BLUE, DARK, GREEN, ORANGE, Panel, Scale, of_rows, plot};
use crate::dataset::{
    Column, Dataset, Plot, Sheet, each, filled, fixed, joined, number, percent, plain, power,
    together, word,
};

const EXPLANATION: &str = include_str!("rate.html");

const STEPS: [Column; 20] = [
    plain("rate Hz", "rate_hz"),
    word("held in rounds", "held_in"),
    word("remarks", "remarks"),
    fixed("wake-up p50 µs", "wake_us_p50", 1),
    fixed("p99 µs", "wake_us_p99", 1),
    fixed("solve p50 µs", "solve_us_p50", 1),
    fixed("response p50 µs", "response_us_p50", 1),
    fixed("p99 µs", "response_us_p99", 1),
    fixed("p99.9 µs", "response_us_p999", 1),
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
    percent("core %", "held_core_share", 1),
    percent("cut short %", "held_budget_hit_share", 1),
    plain("beyond the period", "held_deadline_misses"),
    plain("skipped", "held_skipped_periods"),
    plain("of cycles", "held_cycles"),
    percent("lost %", "held_lost_share", 3),
    power("error p99 mm", "held_error_p99_mm"),
];

const COUNTS: [&str; 8] = [
    "cycles",
    "late_starts",
    "deadline_misses",
    "skipped_periods",
    "dropped_records",
    "causes",
    "own_misses",
    "late_cycles",
];

const NUMBERS: [(&str, &str, &str); 6] = [
    ("response_p50", "µs", "response_us_p50"),
    ("response_p99", "µs", "response_us_p99"),
    ("response_p999", "µs", "response_us_p999"),
    ("core", "%", "core_share"),
    ("cut_short", "%", "budget_hit_share"),
    ("own_misses", "", "own_misses"),
];

pub(super) fn dataset(
    realtime: bool,
    spin_us: Option<f64>,
    steps: Vec<Vec<Trial>>,
    shortest: &[Shortest],
) -> Result<Dataset> {
    let how = how(realtime, spin_us);
    let mut dataset = Dataset::new("rate", "How fast the loop can go", EXPLANATION);
    dataset.fact("realtime", realtime);
    dataset.fact("spin_us", spin_us);
    let (mut default, mut rounds) = (Vec::new(), Vec::new());
    for step in &steps {
        let of_step = rows(step);
        let row = step_row(step, &of_step);
        let rate_hz = number(&row, "rate_hz").unwrap_or(f64::NAN);
        let path = format!("rate/default/{rate_hz:.0}-hz");
        dataset.compare(&path, &of_step, &NUMBERS);
        default.push(row);
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
    let default_case = shortest.iter().find(|it| it.case == Case::DEFAULT);
    let shortest_ms = default_case.and_then(|it| Some((it.held_ms?, Value::Null, String::new())));
    let what = "shortest period that holds, kpso-refined, 3 sections, 2 steps";
    dataset.target([what, "≤ 0.5 ms", "ms"], shortest_ms, 0.0..=0.5);
    dataset.plots.push(picture(&default)?);
    let name = Case::DEFAULT.name();
    let of_default =
        format!("The default ({name}) with shorter and shorter periods, medians over rounds{how}");
    let of_shortest = format!("Shortest period that holds{how}");
    dataset.sheets = vec![
        Sheet::of(&of_shortest, &SHORTEST, found)
            .key("shortest")
            .file("rate"),
        Sheet::of(&of_default, &STEPS, default)
            .key("default")
            .file("rate-default"),
        Sheet::of("", &[], [&rounds[..], &trials].concat()).file("rate-trials"),
        Sheet::of("", &[], rounds).key("default_rounds"),
        Sheet::of("", &[], trials).key("trials"),
    ];
    let trials = steps.into_iter().flatten();
    dataset.recordings = trials.filter_map(|trial| trial.responses).collect();
    Ok(dataset)
}

fn rows(trials: &[Trial]) -> Vec<Value> {
    trials.iter().map(|trial| trial.row.clone()).collect()
}

fn how(realtime: bool, spin_us: Option<f64>) -> String {
    let spin = match spin_us {
        None => String::new(),
        Some(0.0) => ", without rehearsal or spinning".to_owned(),
        Some(us) => format!(", spinning {us} µs (at most a quarter of the period)"),
    };
    let refused = [", without SCHED_FIFO (not granted)", ""][usize::from(realtime)];
    spin + refused
}

/// Plot of the default case at each rate, from the rows of its result.
pub fn picture(rows: &[Value]) -> Result<Plot> {
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
    let scale = Scale::LogLog { floor: 1.0 };
    let panels = [
        panel(
            "Response of the default",
            "response time [µs]",
            scale,
            times,
        ),
        panel("What it costs", "share", Scale::LogAcross, shares),
    ];
    plot(
        "rate",
        "The default with shorter and shorter periods. The response is that of the cycles that ran: \
         releases without a cycle are not in it.",
        (2, 620),
        &panels,
    )
}

fn shortest_row(shortest: &Shortest) -> Value {
    let Shortest {
        held_ms, failed_ms, ..
    } = *shortest;
    let [held, failed] = [held_ms, failed_ms].map(|ms| shortest.trials_with(ms));
    let remarks = failed.last().map(|trial| trial.remarks());
    let ended_by = match (failed_ms, remarks) {
        (Some(ms), Some(remarks)) => {
            format!("{ms} ms, held in {} trials: {remarks}", held_in(&failed))
        }
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

fn step_row(trials: &[Trial], rounds: &[Value]) -> Value {
    // The first round that did not hold, otherwise the last one.
    let shown = trials.iter().find(|trial| !trial.holds()).or(trials.last());
    let all = together(rounds, &COUNTS);
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
    fn what_failed_is_told_and_is_no_value_of_a_metric() {
        let tried = |period_ms, outcomes: &[_]| -> Vec<Trial> {
            let outcomes = outcomes.iter();
            outcomes.map(|outcome| trial(period_ms, *outcome)).collect()
        };
        let mut trials = tried(0.5, &[NotFollowed, Holds]);
        trials.extend(tried(0.25, &[NotFollowed; 3]));
        let steps = vec![tried(5.0, &[Holds; 2]), tried(0.1, &[Holds, NotFollowed])];
        let shortest = Shortest {
            case: Case::DEFAULT,
            trials,
            held_ms: Some(0.5),
            failed_ms: Some(0.25),
        };
        let found = dataset(false, Some(0.0), steps, &[shortest]).unwrap();
        let json = found.json();
        assert_eq!(json["default"][1]["rounds_held"], 1);
        assert_eq!(json["default"][1]["remarks"], "too short");
        assert_eq!(json["default"][0]["cycles"], 8000);
        let row = &json["shortest"][0];
        assert_eq!(
            (&row["shortest_period_ms"], &row["failed_period_ms"]),
            (&json!(0.5), &json!(0.25))
        );
        assert_eq!(row["ended_by"], "0.25 ms, held in 0 of 3 trials: too short");
        assert_eq!(row["held_in"], "1 of 2");
        assert_eq!(json["trials"][2]["holds"], false);
        let text = found.text();
        assert!(
            text.contains("not granted") && text.contains("without rehearsal"),
            "{text}"
        );
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
