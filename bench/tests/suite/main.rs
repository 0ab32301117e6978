//! Tests of the public interface in one program, because each test program costs a link.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod all;
mod compare;
mod deadline;
mod footprint;
mod latency;
mod paper;
mod quality;
mod rate;
mod refused;
mod results;
mod robustness;

use std::collections::BTreeSet;
use std::process::{Command, Output};
use std::sync::{Mutex, MutexGuard, PoisonError};

use cdcr_bench::dataset::Dataset;
use serde_json::{Value, json};

/// Allows one measurement of a daemon at a time, because all use the same real-time core. While commands are
/// late, a client that polls for them does not pause. It would delay the reporters of other daemons, whose
/// clients would take them for dead.
fn machine() -> MutexGuard<'static, ()> {
    static MACHINE: Mutex<()> = Mutex::new(());
    MACHINE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The program with these arguments.
fn program(line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cdcr-bench"));
    command.args(line.split_ascii_whitespace());
    command
}

/// Output of the program, which must succeed.
fn printed(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

fn printed_json(command: &mut Command) -> Value {
    serde_json::from_str(&printed(command)).unwrap()
}

/// The page contains no reference outside itself.
fn needs_nothing_else(page: &str) {
    let quoted = |before: &str| -> Vec<&str> {
        let parts = page.split(before).skip(1);
        parts.filter_map(|part| part.split('"').next()).collect()
    };
    let ids = quoted(" id=\"");
    let each: BTreeSet<_> = ids.iter().collect();
    assert_eq!(each.len(), ids.len(), "two parts of one id: {ids:?}");
    for link in quoted("href=\"#") {
        assert!(each.contains(&link), "#{link} leads nowhere");
    }
    let page = page.replace("href=\"#", "");
    for word in ["src=", "href=", "url(", "<script", "@import"] {
        assert!(!page.contains(word), "{word} in a page");
    }
}

fn dataset_is_sound(dataset: &Dataset, rounds: &[usize]) {
    let mut json = dataset.json();
    json.insert("metrics".to_owned(), json!(dataset.metrics));
    is_sound(&json.into(), rounds);
}

/// What holds for the result of every benchmark: quantiles grow, shares are shares, no time is negative. Each
/// metric has one name, and a value for each of `rounds`.
fn is_sound(document: &Value, rounds: &[usize]) {
    values_are_sound(document);
    let metrics = list(document, "metrics");
    let names: BTreeSet<_> = metrics.iter().map(|it| it["name"].as_str()).collect();
    assert!(!metrics.is_empty() && names.len() == metrics.len());
    let mut counts = metrics.iter().map(|it| list(it, "rounds").len());
    assert!(counts.all(|count| rounds.contains(&count)), "{metrics:?}");
}

fn values_are_sound(value: &Value) {
    let all = value.as_array().into_iter().flatten();
    all.for_each(values_are_sound);
    let fields = value.as_object().into_iter().flatten();
    for (key, field) in fields {
        let is_share = key.ends_with("_share");
        let most = if is_share { 1.0 } else { f64::INFINITY };
        let is_bounded = is_share || key.ends_with("_us") || key.ends_with("_ms");
        let of_zero = ["excess", "misses", "beyond", "more_p50", "runtime"];
        if is_bounded && !of_zero.iter().any(|word| key.contains(word)) {
            let is_sound = |number| (0.0..=most).contains(&number);
            assert!(field.as_f64().is_none_or(is_sound), "{key}: {value}");
        }
        values_are_sound(field);
    }
    let quantiles = ["min", "p50", "p99", "p999", "max"].map(|name| value[name].as_f64());
    if let [Some(min), Some(p50), Some(p99), Some(p999), Some(max)] = quantiles {
        let all = [0.0, min, p50, p99, p999, max];
        assert!(all.is_sorted(), "{value}");
    }
}

fn list<'a>(document: &'a Value, key: &str) -> &'a [Value] {
    document[key].as_array().expect(key)
}

/// The row of a list whose `key` has this value.
fn row<'a>(document: &'a Value, list_of: &str, key: &str, value: &str) -> &'a Value {
    let row = list(document, list_of).iter().find(|row| row[key] == value);
    row.unwrap_or_else(|| panic!("no {key} {value} in {list_of}"))
}

fn number(row: &Value, key: &str) -> f64 {
    let number = row[key].as_f64();
    number.unwrap_or_else(|| panic!("{key} of {row}"))
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
