//! What two runs say of each other.

use serde_json::json;

use super::change::chance_apart;
use super::*;
use crate::metric::Better;

fn lower(name: impl Into<String>, unit: &str, rounds: &[f64]) -> Metric {
    Metric::new(name, unit, Better::Lower, rounds.iter().copied())
}

#[test]
fn what_became_of_a_number_is_told_from_its_rounds() {
    use Better::{Higher, Lower};
    use Verdict::{
        Better as Improved, OneValueAlike, OneValueBetter, OneValueWorse, TooFewRounds,
        WithinNoise, Worse,
    };
    let (low, high): (&[f64], &[f64]) = (&[1.0, 2.0, 3.0], &[3.1, 4.0, 5.0]);
    for (better, before, after, verdict) in [
        (Lower, low, high, Worse),
        (Lower, high, low, Improved),
        (Higher, low, high, Improved),
        (Higher, high, low, Worse),
        // Ranges that touch; a change of 2 %, though the rounds are apart.
        (Lower, low, &[3.0, 4.0, 5.0], WithinNoise),
        (
            Lower,
            &[100.0, 100.1, 100.2],
            &[101.9, 102.0, 102.05],
            WithinNoise,
        ),
        // From zero every change counts.
        (Lower, &[0.0, 0.0, 0.0], &[4.0, 5.0, 6.0], Worse),
        (Lower, &[0.0, 0.0, 0.0], &[0.0, 0.0, 0.0], WithinNoise),
        // Two rounds prove nothing, and single values nothing of chance.
        (Lower, &[1.0, 1.0], &[9.0, 9.0, 9.0], TooFewRounds),
        (Lower, &[1.0], &[9.0, 9.0, 9.0], TooFewRounds),
        (Lower, &[100.0], &[102.0], OneValueAlike),
        (Lower, &[100.0], &[103.0], OneValueWorse),
        (Lower, &[100.0], &[97.0], OneValueBetter),
        (Lower, &[0.0], &[1e-9], OneValueWorse),
    ] {
        let [before, after] =
            [before, after].map(|rounds| Metric::new("a", "µs", better, rounds.iter().copied()));
        let found = Change::of(&before, &after).expect("both have values");
        assert_eq!(found.verdict, verdict, "{found:?}");
        let is_change = [Worse, Improved, WithinNoise].contains(&verdict);
        assert_eq!(found.false_alarm() > 0.0, is_change, "{found:?}");
    }
}

#[test]
fn the_chance_is_that_of_the_rank_test() {
    let all = [
        (3, 3, 0.1),
        (1, 1, 1.0),
        (5, 5, 2.0 / 252.0),
        (3, 6, 2.0 / 84.0),
    ];
    for (before, after, expected) in all {
        for found in [chance_apart(before, after), chance_apart(after, before)] {
            assert!(
                (found - expected).abs() < 1e-12,
                "{before}, {after}: {found}"
            );
        }
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
    let [one, other] = [[1.0, 1.1, 1.2], [1.1, 1.1, 1.3]];
    let before = input(vec![
        lower("same", "µs", &one),
        lower("worse", "µs", &one),
        lower("gone", "µs", &[1.0]),
        lower("other unit", "µs", &[1.0]),
        lower("empty", "µs", &[]),
    ]);
    let after = input(vec![
        lower("same", "µs", &other),
        lower("worse", "µs", &[2.0, 2.1, 2.2]),
        lower("new", "µs", &[1.0]),
        lower("other unit", "ms", &[1.0]),
        lower("empty", "µs", &[1.0]),
    ]);
    let found = Comparison::of(&before, &after);
    let names: Vec<&str> = found.metrics.iter().map(|change| &*change.name).collect();
    assert_eq!(names, ["worse", "same"], "changed ones first");
    assert_eq!(found.only_before, ["gone", "other unit"]);
    assert_eq!(found.only_after, ["empty", "new", "other unit"]);
    assert!(found.warnings.is_empty());
    // 2 of the 20 ways to deal six rounds leave three and three apart.
    assert!((found.changed_by_chance - 0.2).abs() < 1e-12, "{found:?}");
}

#[test]
fn another_machine_and_other_options_are_told() {
    let run = |release: &str, options: Option<&str>| Input {
        environment: serde_json::from_value(json!({ "kernel": { "release": release } }))
            .expect("a machine"),
        options: options.map(|json| serde_json::from_str(json).expect("options")),
        ..input(Vec::new())
    };
    let few = run("6.1", Some(r#"{"rounds":"3"}"#));
    for (other, words) in [
        (run("6.1", Some(r#"{"rounds":"3"}"#)), &[][..]),
        (
            run("7.0", Some(r#"{"rounds":"3"}"#)),
            &["another kernel release: \"6.1\" before", "bare loop"],
        ),
        (
            run("6.1", Some(r#"{"rounds":"6"}"#)),
            &[
                "another value of rounds: 3 before, 6 after",
                "for this reason",
            ],
        ),
        (run("6.1", None), &["the run after does not say"]),
    ] {
        let warnings = Comparison::of(&few, &other).warnings;
        assert_eq!(warnings.len(), words.len(), "{warnings:?}");
        let mut pairs = warnings.iter().zip(words);
        assert!(
            pairs.all(|(warning, words)| warning.contains(words)),
            "{warnings:?}"
        );
    }
}

#[test]
fn some_may_get_worse_by_chance() {
    let metric = |i| lower(format!("a/{i}"), "µs", &[10.0, 11.0, 12.0]);
    let many = input((0..31).map(metric).collect());
    // 31 numbers, 10 % of which chance moves: half of 3.1, rounded up, and two.
    assert_eq!(Comparison::of(&many, &many).worse_by_chance(), 4);
}
