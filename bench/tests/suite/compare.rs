//! What `cdcr-bench compare` says of two files, and of files that are none.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::{Value, json};

fn compare(arguments: &[&str], files: [&Path; 2]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_cdcr-bench"))
        .arg("compare")
        .args(files)
        .args(arguments)
        .output()
        .expect("the program runs")
}

fn write(folder: &Path, name: &str, kernel: &str, rounds: [f64; 3]) -> PathBuf {
    // More of them than chance moves.
    let moving = ["b", "d", "e", "f"].map(
        |name| json!({ "name": format!("a/{name}"), "unit": "µs", "better": "lower", "rounds": rounds }),
    );
    let mut metrics = moving.to_vec();
    metrics.extend([
        json!({ "name": "a/c", "unit": "", "better": "higher", "rounds": [1.0, 1.0, 1.0] }),
        json!({ "name": "a/exact", "unit": "mm", "better": "lower", "rounds": [rounds[0]] }),
    ]);
    write_metrics(folder, name, kernel, &metrics)
}

fn write_metrics(folder: &Path, name: &str, kernel: &str, metrics: &[Value]) -> PathBuf {
    let document = json!({
        "environment": {
            "cdcr_version": "0.1.0",
            "kernel": { "release": kernel },
            "a key of a later version": 1,
        },
        "options": { "command": "all", "rounds": kernel },
        "cases": [],
        "metrics": metrics,
    });
    let file = folder.join(name);
    std::fs::write(&file, document.to_string()).expect("written");
    file
}

#[test]
fn a_change_for_the_worse_is_told_and_fails_only_where_that_is_asked() {
    let folder = tempfile::tempdir().expect("a folder");
    let before = write(folder.path(), "a.json", "6.1", [10.0, 11.0, 12.0]);
    let after = write(folder.path(), "b.json", "6.2", [20.0, 21.0, 22.0]);

    let found = compare(&[], [&before, &after]);
    let text = String::from_utf8(found.stdout).expect("a text");
    assert!(found.status.success(), "{text}");
    assert!(text.contains("a/b") && text.contains("worse"), "{text}");
    assert!(
        text.contains("4 worse, 0 better, 1 one-value-worse, 0 one-value-better, 1 within-noise"),
        "{text}"
    );
    assert!(text.contains("0 only in the run after"), "{text}");
    let options = "asked for with another value of rounds: 6.1 before, 6.2 after";
    assert!(text.contains(options), "{text}");
    assert!(
        text.contains("another kernel release: \"6.1\" before, \"6.2\" after"),
        "{text}"
    );

    let failing = ["--fail-on-worse", "--format", "json"];
    let found = compare(&failing, [&before, &after]);
    assert_eq!(found.status.code(), Some(1));
    let document: Value = serde_json::from_slice(&found.stdout).expect("one object");
    assert_eq!(document["metrics"][0]["verdict"], "worse");
    assert_eq!(
        document["metrics"][0]["change_percent"]
            .as_f64()
            .map(f64::round),
        Some(91.0)
    );
    assert_eq!(document["metrics"][4]["verdict"], "one-value-worse");
    assert_eq!(document["metrics"][5]["verdict"], "within-noise");

    let found = compare(&failing, [&after, &before]);
    assert!(
        found.status.success(),
        "the other way round it became better"
    );
}

#[test]
fn one_number_that_became_worse_may_be_chance_and_fails_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let metric = |rounds: [f64; 3]| {
        let metric = json!({ "name": "a", "unit": "µs", "better": "lower", "rounds": rounds });
        [metric]
    };
    let (low, high) = (metric([1.0, 2.0, 3.0]), metric([5.0, 6.0, 7.0]));
    let before = write_metrics(folder.path(), "a.json", "6.1", &low);
    let after = write_metrics(folder.path(), "b.json", "6.1", &high);
    let found = compare(&["--fail-on-worse"], [&before, &after]);
    let text = String::from_utf8_lossy(&found.stdout);
    assert!(text.contains("1 worse"), "{text}");
    assert!(found.status.success(), "{text}");
}

#[test]
fn files_that_are_no_results_are_named_with_what_is_expected() {
    let folder = tempfile::tempdir().expect("a folder");
    let good = write(folder.path(), "good.json", "6.1", [1.0, 2.0, 3.0]);
    let bad = folder.path().join("bad.json");
    for text in [
        "",
        "[]",
        "{\"metrics\": []}",
        "{\"environment\": {}, \"metrics\": [{}]}",
    ] {
        std::fs::write(&bad, text).expect("written");
        let found = compare(&[], [&good, &bad]);
        let errors = String::from_utf8_lossy(&found.stderr);
        assert_eq!(found.status.code(), Some(1), "{text}");
        assert!(
            errors.contains("bad.json is no result of cdcr-bench"),
            "{errors}"
        );
        assert!(errors.contains("\"metrics\""), "{errors}");
    }
    let found = compare(&[], [&folder.path().join("missing.json"), &good]);
    let errors = String::from_utf8_lossy(&found.stderr);
    assert!(
        errors.contains("cannot read") && errors.contains("missing.json"),
        "{errors}"
    );
}
