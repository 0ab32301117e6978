//! `cdcrd doctor` on the machine that runs the tests.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Output;

use cdcr_scratch::Scratch;
use serde_json::Value;

use crate::command_line::cdcrd;

/// Every key, as used by programs.
const KEYS: &str = "\
    fifo pin memory_lock preemption rt_throttling rt_group cores isolation tick siblings \
    governor deep_sleep sysctls steal neighbours realtime_neighbours interrupts irqbalance \
    clock_source virtual_machine shared_memory huge_pages swap root_folder";

fn doctor(folder: &Path, realtime: &str, arguments: &[&str]) -> Output {
    let config = folder.join("robot.toml");
    std::fs::write(&config, format!("[realtime]\n{realtime}\n")).unwrap();
    let root = folder.join("root");
    let options = [
        "doctor",
        "--config",
        config.to_str().unwrap(),
        "--root",
        root.to_str().unwrap(),
    ];
    cdcrd(&[&options, arguments].concat())
}

fn json(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    let error = String::from_utf8_lossy(&output.stderr);
    serde_json::from_str(&text).unwrap_or_else(|cause| panic!("{cause}: {text}{error}"))
}

fn severities(report: &Value) -> BTreeMap<String, String> {
    let text = |finding: &Value, field: &str| finding[field].as_str().unwrap().to_owned();
    let findings = report["findings"].as_array().unwrap().iter();
    findings
        .map(|finding| (text(finding, "key"), text(finding, "verdict")))
        .collect()
}

fn badness(verdict: &str) -> usize {
    let words = ["ok", "unknown", "warning", "fault"];
    words.iter().position(|word| *word == verdict).unwrap()
}

#[test]
fn the_report_has_every_check_and_its_worst_is_the_exit_status() {
    let folder = Scratch::in_memory().unwrap();
    let output = doctor(folder.path(), "mode = \"prefer\"", &["--format", "json"]);
    let report = json(&output);
    let severities = severities(&report);
    let keys: BTreeSet<&str> = KEYS.split(' ').collect();
    assert!(severities.keys().eq(keys), "{severities:?}");
    for finding in report["findings"].as_array().unwrap() {
        for field in ["title", "value", "why", "remedy"] {
            let text = finding[field].as_str().unwrap();
            assert!(!text.is_empty(), "{field}: {finding}");
        }
    }
    let worst = severities.values().map(|verdict| badness(verdict)).max();
    let shown = report["worst"].as_str().unwrap();
    assert_eq!(Some(badness(shown)), worst);
    let status = [0, 10, 10, 20][badness(shown)];
    assert_eq!(output.status.code(), Some(status));
    assert!(!folder.path().join("root").exists(), "it changes nothing");
}

#[test]
fn what_is_missing_is_as_bad_as_it_was_asked_for() {
    let folder = Scratch::in_memory().unwrap();
    // No machine has this core.
    let of_mode = |mode: &str| {
        let realtime = format!("mode = \"{mode}\"\ncore = 1023");
        let output = doctor(folder.path(), &realtime, &["--format", "json"]);
        (
            severities(&json(&output))["pin"].clone(),
            output.status.code(),
        )
    };
    assert_eq!(of_mode("require"), ("fault".to_owned(), Some(20)));
    assert_eq!(of_mode("prefer").0, "warning");
    assert_eq!(of_mode("off").0, "ok");
}

#[test]
fn text_is_plain_where_there_is_no_terminal() {
    let folder = Scratch::in_memory().unwrap();
    let output = doctor(folder.path(), "mode = \"prefer\"", &[]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(!text.contains('\u{1b}'), "{text}");
    let begins = |line: &&str| {
        let word = line.split_whitespace().next().unwrap_or("");
        line.starts_with(|c: char| c.is_alphabetic())
            && ["ok", "unknown", "warning", "fault"].contains(&word)
    };
    assert_eq!(
        text.lines().filter(begins).count(),
        KEYS.split(' ').count(),
        "{text}"
    );
    let last = text.lines().last().unwrap();
    assert!(
        last.contains("warnings") && last.contains("faults"),
        "{text}"
    );
}

#[test]
fn a_bad_configuration_is_no_report() {
    let folder = Scratch::in_memory().unwrap();
    let output = doctor(folder.path(), "core = -7", &[]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(78), "{error}");
    assert!(
        error.contains("realtime.core") && output.stdout.is_empty(),
        "{error}"
    );
}
