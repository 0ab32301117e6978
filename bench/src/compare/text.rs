//! A comparison for people.

use std::fmt::Write as _;

use super::Comparison;
use super::change::{Change, LEAST_CHANGE_PERCENT, ROUNDS_MIN, Spread, Verdict};
use crate::environment::Environment;
use crate::report::number;
use crate::table::Table;

/// More names than this are not listed.
const NAMES_MAX: usize = 12;

/// Changed numbers in a table, all others as counts.
pub fn text(comparison: &Comparison) -> String {
    let mut text = String::new();
    let _ = writeln!(text, "before: {}", run(&comparison.before));
    let _ = writeln!(text, "after:  {}", run(&comparison.after));
    for warning in &comparison.warnings {
        let _ = writeln!(text, "warning: {warning}");
    }
    text.push('\n');
    let of = |fits: fn(Verdict) -> bool| -> Vec<&Change> {
        let all = comparison.metrics.iter();
        all.filter(|change| fits(change.verdict)).collect()
    };
    let changed = of(Verdict::is_changed);
    if changed.is_empty() {
        text.push_str("Nothing changed beyond noise.\n");
    } else {
        text.push_str(&table(&changed).text());
    }
    let others = of(Verdict::is_one_value_other);
    if !others.is_empty() {
        text.push('\n');
        text.push_str(&one_value_table(&others).text());
    }
    text.push('\n');
    text.push_str(&counts(comparison));
    text
}

fn run(environment: &Environment) -> String {
    let commit = match &environment.commit {
        Some(commit) => format!(" ({commit})"),
        None => String::new(),
    };
    format!(
        "cdcr {}{commit}, {}, {}, kernel {}",
        environment.cdcr_version,
        environment.started_utc,
        environment.processor.model,
        environment.kernel.release
    )
}

fn table(changes: &[&Change]) -> Table {
    let row = |change: &&Change| {
        let (before, after) = (&change.before, &change.after);
        vec![
            change.name.clone(),
            change.unit.clone(),
            change.verdict.words().to_owned(),
            percent(change),
            number(before.median),
            between(before),
            number(after.median),
            between(after),
            change
                .chance
                .map_or_else(String::new, |chance| format!("{chance:.3}")),
        ]
    };
    let heads = [
        "metric",
        "unit",
        "",
        "change %",
        "before",
        "rounds",
        "after",
        "rounds",
        "by chance",
    ];
    let title = format!(
        "Changed beyond noise: the rounds of the two runs are apart, and their medians differ by more than \
         {LEAST_CHANGE_PERCENT} %"
    );
    Table::new(title, &heads, 3, changes.iter().map(row).collect())
}

/// Numbers without a range: exact ones, and those of a run of one round.
fn one_value_table(changes: &[&Change]) -> Table {
    let row = |change: &&Change| {
        vec![
            change.name.clone(),
            change.unit.clone(),
            change.verdict.words().to_owned(),
            percent(change),
            number(change.before.median),
            number(change.after.median),
        ]
    };
    let heads = ["metric", "unit", "", "change %", "before", "after"];
    let title = format!(
        "One value each: they differ by more than {LEAST_CHANGE_PERCENT} %, which is a change only where the \
         number is exact"
    );
    Table::new(title, &heads, 3, changes.iter().map(row).collect())
}

fn percent(change: &Change) -> String {
    let percent = change.change_percent;
    percent.map_or_else(|| "from 0".to_owned(), |percent| format!("{percent:+.1}"))
}

fn between(spread: &Spread) -> String {
    format!("{} to {}", number(spread.min), number(spread.max))
}

fn counts(comparison: &Comparison) -> String {
    let (worse, better) = (
        comparison.count(Verdict::Worse),
        comparison.count(Verdict::Better),
    );
    let within = comparison.count(Verdict::WithinNoise);
    let few = comparison.count(Verdict::TooFewRounds);
    let mut text = format!("{worse} worse, {better} better, {within} within noise");
    if few > 0 {
        let _ = write!(
            text,
            ", {few} with fewer than {ROUNDS_MIN} rounds in one of the runs"
        );
    }
    text.push_str(".\n");
    let others =
        comparison.count(Verdict::OneValueWorse) + comparison.count(Verdict::OneValueBetter);
    let alike = comparison.count(Verdict::OneValueAlike);
    if others + alike > 0 {
        let _ = writeln!(
            text,
            "One value each: {others} differ by more than {LEAST_CHANGE_PERCENT} %, {alike} do not."
        );
    }
    if comparison.changed_by_chance > 0.0 {
        let _ = writeln!(
            text,
            "Without any change up to {:.1} of these would be called changed, by chance alone; more rounds make \
             it rarer (5 in each run: 1 of 126).",
            comparison.changed_by_chance
        );
    }
    for (when, names) in [
        ("before", &comparison.only_before),
        ("after", &comparison.only_after),
    ] {
        if !names.is_empty() {
            let shown = names[..names.len().min(NAMES_MAX)].join(", ");
            let more = if names.len() > NAMES_MAX { ", …" } else { "" };
            let _ = writeln!(
                text,
                "{} only in the run {when}: {shown}{more}",
                names.len()
            );
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::Input;
    use super::*;
    use crate::metric::Metric;

    fn text_of(before: Vec<Metric>, after: Vec<Metric>) -> String {
        let input = |metrics| Input {
            environment: Environment::default(),
            options: None,
            metrics,
        };
        text(&Comparison::of(&input(before), &input(after)))
    }

    #[test]
    fn changed_numbers_are_shown_and_others_counted() {
        let text = text_of(
            vec![
                Metric::lower("a/slow", "µs", [10.0, 11.0, 12.0]),
                Metric::lower("a/same", "µs", [10.0, 11.0, 12.0]),
                Metric::lower("a/twice", "µs", [1.0, 1.0]),
                Metric::lower("a/once", "µs", [1.0]),
            ],
            vec![
                Metric::lower("a/slow", "µs", [20.0, 22.0, 24.0]),
                Metric::lower("a/same", "µs", [11.0, 12.0, 13.0]),
                Metric::lower("a/twice", "µs", [1.0, 1.0]),
                Metric::lower("a/once", "µs", [2.0]),
                Metric::lower("a/new", "µs", [2.0]),
            ],
        );
        assert!(text.contains("a/slow") && text.contains("+100.0"), "{text}");
        assert!(!text.contains("a/same"), "{text}");
        let counts =
            "1 worse, 0 better, 1 within noise, 1 with fewer than 3 rounds in one of the runs.";
        assert!(text.contains(counts), "{text}");
        let single = "One value each: 1 differ by more than 2 %, 0 do not.";
        assert!(text.contains(single) && text.contains("a/once"), "{text}");
        assert!(text.contains("1 only in the run after: a/new"), "{text}");
        assert!(text.contains("up to 0.2 of these"), "{text}");
    }

    #[test]
    fn nothing_changed_is_said() {
        let metrics = || vec![Metric::lower("a", "µs", [1.0, 2.0, 3.0])];
        let text = text_of(metrics(), metrics());
        assert!(text.contains("Nothing changed beyond noise."), "{text}");
    }
}
