//! Output of `cdcr-bench compare` for two files, and for missing ones.

use std::path::{Path, PathBuf};
use std::process::Output;

use cdcr_scratch::Scratch;
use serde_json::{Value, json};

use crate::{list, number, program, stderr};

fn compare(line: &str, files: [&Path; 2]) -> Output {
    let mut command = program(&format!("compare {line}"));
    command.args(files).output().unwrap()
}

/// A name, a unit, and the value of each round.
type Number<'a> = (&'a str, &'a str, &'a [f64]);

/// Writes a result with these numbers, of which less is better, and these keys.
fn write(folder: &Path, name: &str, keys: &[(&str, Value)], numbers: &[Number]) -> PathBuf {
    let metric = |(name, unit, rounds): &Number| json!({ "name": name, "unit": unit, "better": "lower", "rounds": rounds });
    let mut document = json!({
        "environment": { "kernel": { "release": "6.1" }, "a key of a later version": 1 },
        "options": { "command": "all" },
        "cases": [],
        "metrics": numbers.iter().map(metric).collect::<Vec<_>>(),
    });
    for (key, value) in keys {
        document[key] = value.clone();
    }
    let file = folder.join(name);
    std::fs::write(&file, document.to_string()).expect("written");
    file
}

#[test]
fn a_change_for_the_worse_is_reported_and_fails_only_where_that_is_asked() {
    let folder = Scratch::temporary().expect("a folder");
    // Five numbers, so that more of them change than by chance, and an exact one.
    let many = |name, rounds: &[f64; 3]| {
        let moving = ["a/0", "a/1", "a/2", "a/3", "a/4"].map(|name| (name, "µs", &rounds[..]));
        let all = [&moving[..], &[("b", "mm", &rounds[..1])]].concat();
        write(folder.path(), name, &[], &all)
    };
    let before = many("a.json", &[10.0, 11.0, 12.0]);
    let after = many("b.json", &[20.0, 21.0, 22.0]);
    let found = compare("", [&before, &after]);
    let text = String::from_utf8(found.stdout).expect("a text");
    let counts = "5 worse, 0 better, 1 one-value-worse, 0 one-value-better, 0 within-noise";
    let is_reported = text.contains("a/4") && text.contains(counts);
    assert!(found.status.success() && is_reported, "{text}");

    let two = [("a/0", "µs", &[1.0, 2.0][..])];
    let few = write(folder.path(), "few.json", &[], &two);
    let text = String::from_utf8(compare("", [&few, &few]).stdout).expect("a text");
    assert!(text.contains("Nothing can be compared"), "{text}");

    let failing = "--fail-on-worse --format json";
    let found = compare(failing, [&before, &after]);
    assert_eq!(found.status.code(), Some(1));
    let document: Value = serde_json::from_slice(&found.stdout).expect("one object");
    let metrics = &document["metrics"];
    assert!(metrics[0]["verdict"] == "worse" && metrics[5]["verdict"] == "one-value-worse");
    assert!((number(&metrics[0], "change_percent") - 100.0 / 1.1).abs() < 1e-9);
    // In the opposite direction, the numbers became better.
    assert!(compare(failing, [&after, &before]).status.success());

    // Of 31 numbers, 10 % change by chance: half of 3.1, rounded up, and two more may get worse.
    let names: Vec<String> = (0..31).map(|i| format!("a/{i}")).collect();
    let run = |file, worse| {
        let rounds = |i| [&[1.0, 2.0, 3.0][..], &[5.0, 6.0, 7.0]][usize::from(i < worse)];
        let numbers = names.iter().enumerate();
        let numbers = numbers.map(|(i, name)| (&**name, "µs", rounds(i)));
        write(folder.path(), file, &[], &numbers.collect::<Vec<_>>())
    };
    for (worse, fails) in [(4, false), (5, true)] {
        let [before, after] = [run("a.json", 0), run("b.json", worse)];
        let found = compare("--fail-on-worse", [&before, &after]);
        assert_eq!(found.status.success(), !fails, "{worse}");
    }
}

#[test]
#[rustfmt::skip]
fn the_class_of_a_change_follows_from_its_rounds() {
    let (low, high): (&[f64], &[f64]) = (&[1.0, 2.0, 3.0], &[3.1, 4.0, 5.0]);
    let cases: [(&str, &[f64], &[f64], &str); 14] = [
        ("lower", low, high, "worse"),
        ("lower", high, low, "better"),
        ("higher", low, high, "better"),
        ("higher", high, low, "worse"),
        // Ranges that touch; then a change of 2 % with disjoint rounds.
        ("lower", low, &[3.0, 4.0, 5.0], "within-noise"),
        ("lower", &[100.0, 100.1, 100.2], &[101.9, 102.0, 102.05], "within-noise"),
        // From zero, every change counts.
        ("lower", &[0.0, 0.0, 0.0], &[4.0, 5.0, 6.0], "worse"),
        ("lower", &[0.0, 0.0, 0.0], &[0.0, 0.0, 0.0], "within-noise"),
        // Too few rounds; then single values, without an estimate of chance.
        ("lower", &[1.0, 1.0], &[9.0, 9.0, 9.0], "too-few-rounds"),
        ("lower", &[1.0], &[9.0, 9.0, 9.0], "too-few-rounds"),
        ("lower", &[100.0], &[102.0], "one-value-alike"),
        ("lower", &[100.0], &[103.0], "one-value-worse"),
        ("lower", &[100.0], &[97.0], "one-value-better"),
        ("lower", &[0.0], &[1e-9], "one-value-worse"),
    ];
    let folder = Scratch::temporary().expect("a folder");
    let run = |file, is_after: bool| {
        let metrics = cases.iter().enumerate().map(|(index, (better, before, after, _))| {
            let rounds = if is_after { after } else { before };
            json!({ "name": format!("{index}"), "unit": "µs", "better": better, "rounds": rounds })
        });
        write(folder.path(), file, &[("metrics", metrics.collect())], &[])
    };
    let found = compare("--format json", [&run("a.json", false), &run("b.json", true)]);
    let document: Value = serde_json::from_slice(&found.stdout).expect("one object");
    assert_eq!(list(&document, "metrics").len(), cases.len());
    for change in list(&document, "metrics") {
        let index: usize = change["name"].as_str().and_then(|name| name.parse().ok()).expect("an index");
        assert_eq!(change["verdict"], cases[index].3, "{change}");
    }
    // The eight with three rounds in each run change by chance in 2 of 20 cases; the others do not count.
    let by_chance = number(&document, "changed_by_chance");
    assert!((by_chance - 0.8).abs() < 1e-12, "{by_chance}");
}

#[test]
#[rustfmt::skip]
fn what_one_run_alone_has_another_machine_and_other_options_are_reported() {
    let folder = Scratch::temporary().expect("a folder");
    let (one, two): (&[f64], &[f64]) = (&[1.0, 1.1, 1.2], &[2.0, 2.1, 2.2]);
    let old = [("same", one), ("worse", one), ("gone", one), ("unit", one), ("empty", &[])];
    let old = old.map(|(name, all)| (name, "µs", all));
    let new = [("same", "µs", one), ("worse", "µs", two), ("new", "µs", one), ("unit", "ms", one), ("empty", "µs", one)];
    let before = write(folder.path(), "a.json", &[], &old);
    let machine = ("environment", json!({ "kernel": { "release": "7.0" } }));
    let options = ("options", json!({ "command": "all", "rounds": "6" }));
    let other_kernel = "another kernel release: \"6.1\" before, \"7.0\" after";
    let other_rounds = "another value of rounds: none before, 6 after";
    for (keys, warned) in [
        (&[][..], &[][..]),
        (&[machine], &[other_kernel, "bare loop"]),
        (&[options], &[other_rounds, "for this reason"]),
        (&[("options", Value::Null)], &["the run after does not contain its options"]),
    ] {
        let after = write(folder.path(), "b.json", keys, &new);
        let found = compare("--format json", [&before, &after]);
        let document: Value = serde_json::from_slice(&found.stdout).expect("one object");
        let metrics = list(&document, "metrics").iter();
        let names: Vec<&Value> = metrics.map(|change| &change["name"]).collect();
        assert_eq!(names, ["worse", "same"], "changed ones first");
        assert_eq!(document["only_before"], json!(["gone", "unit"]));
        assert_eq!(document["only_after"], json!(["empty", "new", "unit"]));
        // 2 of the 20 divisions of six rounds leave three and three disjoint.
        let by_chance = number(&document, "changed_by_chance");
        assert!((by_chance - 0.2).abs() < 1e-12, "{document}");
        assert_eq!(list(&document, "warnings").len(), warned.len(), "{document}");
        let text = document["warnings"].to_string().replace("\\\"", "\"");
        assert!(warned.iter().all(|words| text.contains(words)), "{text}");
    }
}

#[test]
fn files_that_are_no_results_are_named_with_what_is_expected() {
    let folder = Scratch::temporary().expect("a folder");
    let good = write(folder.path(), "good.json", &[], &[]);
    let [bad, missing] = ["bad.json", "missing.json"].map(|name| folder.path().join(name));
    let is_refused = |files, words| {
        let found = compare("", files);
        let errors = stderr(&found);
        let is_reported = errors.contains(words);
        assert!(found.status.code() == Some(1) && is_reported, "{errors}");
    };
    let texts = r#"|{"metrics": []}|{"environment": {}, "metrics": [{}]}"#;
    for text in texts.split('|') {
        std::fs::write(&bad, text).expect("written");
        is_refused([&good, &bad], "bad.json is not a result of cdcr-bench");
    }
    is_refused([&missing, &good], "missing.json");
}
