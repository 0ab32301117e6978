//! What two runs say of each other.

use serde_json::json;

use super::change::chance_apart;
use super::*;
use crate::metric::Better;

fn lower<const N: usize>(name: impl Into<String>, unit: &str, rounds: [f64; N]) -> Metric {
    Metric::new(name, unit, Better::Lower, rounds)
}

fn change(better: Better, before: &[f64], after: &[f64]) -> Change {
    let metric = |rounds: &[f64]| Metric {
        name: "a".to_owned(),
        unit: "µs".to_owned(),
        better,
        rounds: rounds.to_vec(),
    };
    Change::of(&metric(before), &metric(after)).expect("both have values")
}

#[test]
fn ranges_that_touch_are_noise() {
    let found = change(Better::Lower, &[1.0, 2.0, 3.0], &[3.0, 4.0, 5.0]);
    assert_eq!((found.verdict, found.chance), (Verdict::WithinNoise, None));
    assert_eq!(found.change_percent, Some(100.0));
}

#[test]
fn apart_is_changed_and_the_metric_says_which_way_is_better() {
    let (low, high) = ([1.0, 2.0, 3.0], [3.1, 4.0, 5.0]);
    for (better, before, after, expected) in [
        (Better::Lower, low, high, Verdict::Worse),
        (Better::Lower, high, low, Verdict::Better),
        (Better::Higher, low, high, Verdict::Better),
        (Better::Higher, high, low, Verdict::Worse),
    ] {
        assert_eq!(change(better, &before, &after).verdict, expected);
    }
}

#[test]
fn a_change_of_two_percent_is_of_no_account() {
    let found = change(
        Better::Lower,
        &[100.0, 100.1, 100.2],
        &[101.9, 102.0, 102.05],
    );
    assert_eq!(found.verdict, Verdict::WithinNoise);
    assert!(found.chance.is_some(), "though the rounds are apart");
}

#[test]
fn from_zero_every_change_counts() {
    let found = change(Better::Lower, &[0.0, 0.0, 0.0], &[4.0, 5.0, 6.0]);
    assert_eq!(
        (found.verdict, found.change_percent),
        (Verdict::Worse, None)
    );
    let same = change(Better::Lower, &[0.0, 0.0, 0.0], &[0.0, 0.0, 0.0]);
    assert_eq!(same.verdict, Verdict::WithinNoise);
}

#[test]
fn two_rounds_prove_nothing() {
    let found = change(Better::Lower, &[1.0, 1.0], &[9.0, 9.0, 9.0]);
    assert_eq!(found.verdict, Verdict::TooFewRounds);
}

#[test]
fn single_values_are_compared_directly_and_prove_nothing_of_chance() {
    for (before, after, verdict) in [
        (100.0, 102.0, Verdict::OneValueAlike),
        (100.0, 103.0, Verdict::OneValueWorse),
        (100.0, 97.0, Verdict::OneValueBetter),
        (0.0, 0.0, Verdict::OneValueAlike),
        (0.0, 1e-9, Verdict::OneValueWorse),
    ] {
        let found = change(Better::Lower, &[before], &[after]);
        assert_eq!(
            (found.verdict, found.chance),
            (verdict, None),
            "{before}, {after}"
        );
        assert_eq!(found.false_alarm(), 0.0);
    }
    let found = change(Better::Lower, &[1.0], &[9.0, 9.0, 9.0]);
    assert_eq!(found.verdict, Verdict::TooFewRounds);
}

#[test]
fn the_chance_is_that_of_the_rank_test() {
    for (before, after, expected) in [
        (3, 3, 0.1),
        (1, 1, 1.0),
        (5, 5, 2.0 / 252.0),
        (3, 6, 2.0 / 84.0),
    ] {
        let found = chance_apart(before, after);
        assert!(
            (found - expected).abs() < 1e-12,
            "{before}, {after}: {found}"
        );
        assert!((chance_apart(after, before) - expected).abs() < 1e-12);
    }
}

fn input(metrics: Vec<Metric>) -> Input {
    Input {
        environment: Environment::default(),
        options: None,
        metrics,
    }
}

#[test]
fn every_number_is_in_one_list() {
    let before = input(vec![
        lower("same", "µs", [1.0, 1.1, 1.2]),
        lower("worse", "µs", [1.0, 1.1, 1.2]),
        lower("gone", "µs", [1.0]),
        lower("other unit", "µs", [1.0]),
        lower("empty", "µs", []),
    ]);
    let after = input(vec![
        lower("same", "µs", [1.1, 1.1, 1.3]),
        lower("worse", "µs", [2.0, 2.1, 2.2]),
        lower("new", "µs", [1.0]),
        lower("other unit", "ms", [1.0]),
        lower("empty", "µs", [1.0]),
    ]);
    let found = Comparison::of(&before, &after);
    let names: Vec<&str> = found.metrics.iter().map(|change| &*change.name).collect();
    assert_eq!(names, ["worse", "same"], "changed ones first");
    assert_eq!(
        (found.count(Verdict::Worse), found.count(Verdict::Better)),
        (1, 0)
    );
    assert_eq!(found.only_before, ["gone", "other unit"]);
    assert_eq!(found.only_after, ["empty", "new", "other unit"]);
    assert!(found.warnings.is_empty());
    // 2 of the 20 ways to deal six rounds leave three and three apart.
    assert!((found.changed_by_chance - 0.2).abs() < 1e-12, "{found:?}");
}

#[test]
fn another_machine_is_told() {
    let [before, after] = [("6.1", false), ("7.0", true)].map(|(release, realtime)| {
        let machine =
            json!({ "kernel": { "release": release }, "privileges": { "realtime": realtime } });
        Input {
            environment: serde_json::from_value(machine).expect("a machine"),
            ..input(Vec::new())
        }
    });
    let warnings = Comparison::of(&before, &after).warnings;
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(
        warnings[1].contains("another privileges realtime: false before, true after"),
        "{warnings:?}"
    );
    assert!(warnings[2].contains("bare loop"), "{warnings:?}");
}

#[test]
fn other_options_are_told() {
    let asked = |json: &str| Input {
        options: serde_json::from_str(json).expect("options"),
        ..input(Vec::new())
    };
    let (few, many) = (asked(r#"{"rounds":"3"}"#), asked(r#"{"rounds":"6"}"#));
    assert!(Comparison::of(&few, &few).warnings.is_empty());
    let warnings = Comparison::of(&few, &many).warnings;
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    let expected = "asked for with another value of rounds: 3 before, 6 after";
    assert_eq!(warnings[0], expected);
    let warnings = Comparison::of(&few, &input(Vec::new())).warnings;
    assert!(
        warnings[0].contains("the run after does not say"),
        "{warnings:?}"
    );
}

#[test]
fn some_may_get_worse_by_chance() {
    let many = |from: f64| {
        let metric = |i| lower(format!("a/{i}"), "µs", [from, from + 1.0, from + 2.0]);
        input((0..31).map(metric).collect())
    };
    let found = Comparison::of(&many(10.0), &many(10.0));
    // 31 numbers, 10 % of which chance moves: half of 3.1, rounded up, and two.
    assert_eq!(found.worse_by_chance(), 4);
}
