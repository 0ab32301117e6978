use std::process::{Command, Output};

use super::*;

/// Set for a child process in which the test skips.
const SKIPS: &str = "CDCR_TEST_SKIPS";

#[test]
fn a_child_skips() {
    if std::env::var_os(SKIPS).is_some() {
        skip(Need::Clock, "it is a trial");
    }
}

fn child(require: &str) -> Output {
    Command::new(std::env::current_exe().expect("the test has a path"))
        .args(["--exact", "tests::a_child_skips"])
        .env(SKIPS, "1")
        .env(REQUIRE, require)
        .output()
        .expect("it runs")
}

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    format!("{out}{err}")
}

/// One test for everything, because its children are one run.
#[test]
fn a_skipped_test_passes_and_is_listed_and_fails_where_its_need_is_required() {
    let run = Run::started_by(std::process::id());
    assert_eq!(run.take().expect("a folder to write to"), [""; 0]);
    for _ in 0..2 {
        let skipped = child("root,realtime");
        assert!(skipped.status.success(), "{}", text(&skipped));
        let reported = String::from_utf8_lossy(&skipped.stderr);
        assert!(
            reported.contains(": needs clock: it is a trial\n"),
            "{reported}"
        );
    }
    let lines = run.take().expect("a folder to write to");
    assert_eq!(lines.len(), 2, "{lines:?}");
    assert!(lines[0].starts_with("skipped: ") && lines[0].ends_with("needs clock: it is a trial"));
    assert_eq!(run.take().expect("a folder to write to"), [""; 0]);

    let failed = child("root, clock");
    assert!(!failed.status.success(), "{}", text(&failed));
    for part in ["it is a trial", Need::Clock.remedy()] {
        assert!(text(&failed).contains(part), "{}", text(&failed));
    }
    let failed = child("rot");
    assert!(!failed.status.success(), "{}", text(&failed));
    assert!(
        text(&failed).contains("unknown need 'rot'"),
        "{}",
        text(&failed)
    );
    assert_eq!(run.take().expect("a folder to write to"), [""; 0]);
}

#[test]
fn a_list_of_needs_has_the_words_of_the_needs() {
    assert_eq!(required(""), Ok(vec![]));
    let all = Need::ALL.map(Need::word).join(",");
    assert_eq!(required(&all), Ok(Need::ALL.to_vec()));
    let error = required("realtime,sudo").expect_err("no such need");
    assert!(
        error.contains("'sudo'") && error.contains("util-linux"),
        "{error}"
    );
}
