//! What `cdcr-bench compare` says of two files, and of files that are none.

use std::path::{Path, PathBuf};
use std::process::Output;

use cdcr_scratch::Scratch;
use serde_json::{Value, json};

use crate::{program, stderr};

fn compare(arguments: &[&str], files: [&Path; 2]) -> Output {
    let mut command = program(&["compare"]);
    command.args(files).args(arguments).output().unwrap()
}

/// A result with these numbers, five times, so that more of them move than chance moves, or once.
fn write(folder: &Path, name: &str, count: usize, rounds: [f64; 3]) -> PathBuf {
    let moving = (0..count).map(|i| {
        let name = format!("a/{i}");
        json!({ "name": name, "unit": "µs", "better": "lower", "rounds": rounds })
    });
    let exact = json!({ "name": "b", "unit": "mm", "better": "lower", "rounds": [rounds[0]] });
    let document = json!({
        "environment": { "kernel": { "release": "6.1" }, "a key of a later version": 1 },
        "options": { "command": "all" },
        "cases": [],
        "metrics": moving.chain([exact]).collect::<Vec<_>>(),
    });
    let file = folder.join(name);
    std::fs::write(&file, document.to_string()).expect("written");
    file
}

#[test]
fn a_change_for_the_worse_is_told_and_fails_only_where_that_is_asked() {
    let folder = Scratch::temporary().expect("a folder");
    let before = write(folder.path(), "a.json", 5, [10.0, 11.0, 12.0]);
    let after = write(folder.path(), "b.json", 5, [20.0, 21.0, 22.0]);
    let found = compare(&[], [&before, &after]);
    let text = String::from_utf8(found.stdout).expect("a text");
    assert!(found.status.success(), "{text}");
    let counts = "5 worse, 0 better, 1 one-value-worse, 0 one-value-better, 0 within-noise";
    assert!(text.contains("a/4") && text.contains(counts), "{text}");

    let failing = ["--fail-on-worse", "--format", "json"];
    let found = compare(&failing, [&before, &after]);
    assert_eq!(found.status.code(), Some(1));
    let document: Value = serde_json::from_slice(&found.stdout).expect("one object");
    let metrics = &document["metrics"];
    let change_percent = metrics[0]["change_percent"].as_f64().map(f64::round);
    assert_eq!(
        (&metrics[0]["verdict"], change_percent),
        (&json!("worse"), Some(91.0))
    );
    assert_eq!(metrics[5]["verdict"], "one-value-worse");
    // The other way round it became better.
    assert!(compare(&failing, [&after, &before]).status.success());

    // One number that became worse may be chance.
    let before = write(folder.path(), "a.json", 1, [1.0, 2.0, 3.0]);
    let after = write(folder.path(), "b.json", 1, [5.0, 6.0, 7.0]);
    let found = compare(&["--fail-on-worse"], [&before, &after]);
    let text = String::from_utf8_lossy(&found.stdout);
    assert!(text.contains("1 worse") && found.status.success(), "{text}");
}

#[test]
fn files_that_are_no_results_are_named_with_what_is_expected() {
    let folder = Scratch::temporary().expect("a folder");
    let good = write(folder.path(), "good.json", 1, [1.0, 2.0, 3.0]);
    let bad = folder.path().join("bad.json");
    for text in [
        "",
        "[]",
        "{\"metrics\": []}",
        "{\"environment\": {}, \"metrics\": [{}]}",
    ] {
        std::fs::write(&bad, text).expect("written");
        let found = compare(&[], [&good, &bad]);
        let errors = stderr(&found);
        assert_eq!(found.status.code(), Some(1), "{text}");
        let words = ["bad.json is no result of cdcr-bench", "\"metrics\""];
        assert!(words.iter().all(|words| errors.contains(words)), "{errors}");
    }
    let found = compare(&[], [&folder.path().join("missing.json"), &good]);
    let errors = stderr(&found);
    assert!(
        errors.contains("cannot read") && errors.contains("missing.json"),
        "{errors}"
    );
}
