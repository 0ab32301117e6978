//! What `cdcr-bench all` leaves in its folder.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread;
use std::time::Duration;

use cdcr_bench::compare::{ChangeClass, Comparison, Input};
use cdcr_scratch::Scratch;
use cdcr_testbed::subject::place::in_public_memory;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};

use crate::{list, needs_nothing_else, number, program, stderr};

fn command(folder: &Path, line: &str) -> Command {
    let mut command = program(&format!("all --quick {line} --out"));
    command.arg(folder).stdin(Stdio::null());
    command
}

fn all(folder: &Path, line: &str) -> Output {
    command(folder, line).output().expect("the program runs")
}

fn json_in(file: &Path) -> Value {
    let text = fs::read_to_string(file).expect("a text");
    serde_json::from_str(&text).expect("one object")
}

fn names(folder: &Path) -> BTreeSet<String> {
    let entries = fs::read_dir(folder).expect("a folder").flatten();
    let name = |entry: fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
    entries.map(name).collect()
}

/// The numbers that a run can be compared by, of a report with several rounds.
fn is_compared_with_itself(file: &Path) {
    let input = Input::read(file).expect("a result");
    let comparison = Comparison::of(&input, &input);
    assert!(!comparison.metrics.is_empty());
    assert_eq!(
        comparison.count(ChangeClass::Worse) + comparison.count(ChangeClass::Better),
        0
    );
    assert!(comparison.warnings.is_empty(), "{:?}", comparison.warnings);
}

#[test]
fn a_report_holds_every_format_and_a_smaller_one_does_not_replace_it() {
    let place = Scratch::temporary().expect("a folder");
    let folder = place.path().join("report");
    let found = all(&folder, "--only solver,budget --rounds 2");
    let errors = stderr(&found);
    assert!(found.status.success(), "{errors}");
    assert!(errors.contains("written into"), "{errors}");
    let summary = String::from_utf8(found.stdout).expect("a text");
    assert!(summary.starts_with("The machine"), "{summary}");

    let expected = "budget-overrun.svg budget.csv report.html report.json report.txt solver-estimate.csv \
                    solver-growth.csv solver-guard.csv solver-sections.svg solver.csv";
    let expected: BTreeSet<_> = expected.split(' ').map(str::to_owned).collect();
    assert_eq!(names(&folder), expected);

    let report = json_in(&folder.join("report.json"));
    assert!(
        report["environment"]["kernel"]["release"].is_string(),
        "{report}"
    );
    assert_eq!(report["extent"]["quick"], true);
    // Without the folder: where a report lies does not matter.
    let options =
        json!({ "command": "all", "only": "solver,budget", "quick": "true", "rounds": "2" });
    assert_eq!(report["options"], options);
    assert_eq!(report["failed"], Value::Array(Vec::new()));
    let metrics = list(&report, "metrics");
    let names: BTreeSet<_> = metrics
        .iter()
        .map(|metric| metric["name"].as_str())
        .collect();
    assert_eq!(
        names.len(),
        metrics.len(),
        "a size that several series share counts once"
    );
    for row in list(&report["solver"], "estimate") {
        let us = |key: &str| number(row, key);
        let (estimate_us, both_us) = (us("estimate_p50_us"), us("both_p50_us"));
        assert!(
            0.0 < estimate_us && estimate_us <= us("estimate_p99_us"),
            "{row}"
        );
        assert!(both_us >= estimate_us.max(us("solve_p50_us")), "{row}");
    }
    for name in ["solver", "budget"] {
        assert!(report[name]["cases"].is_array(), "{name}");
        assert!(report["took_s"][name].as_f64() > Some(0.0), "{name}");
        let own = metrics.iter().filter(|metric| {
            let full = metric["name"].as_str().expect("a name");
            full.starts_with(name) && list(metric, "rounds").len() == 2
        });
        assert!(own.count() > 3, "{name}");
    }
    is_compared_with_itself(&folder.join("report.json"));
    page_is_whole(&fs::read_to_string(folder.join("report.html")).expect("the page"));

    // A report of less stays beside it, whatever its benchmarks are called today; what failed in it is no loss.
    let mut older = report;
    older["renamed"] = json!({ "cases": [] });
    older["failing"] = json!({ "error": "no luck" });
    let older = older.to_string();
    fs::write(folder.join("report.json"), &older).expect("written");
    let found = all(&folder, "--only budget");
    let errors = stderr(&found);
    assert!(found.status.success(), "{errors}");
    assert!(
        errors.contains("with renamed, solver, which this one lacks"),
        "{errors}"
    );
    let kept = fs::read_to_string(folder.join("report.json"));
    assert_eq!(kept.expect("the report"), older);
    let aside = json_in(&folder.join("partial").join("report.json"));
    assert!(aside["budget"].is_object() && aside["solver"].is_null());
}

fn page_is_whole(page: &str) {
    assert_eq!(page.matches("<svg").count(), 2);
    for id in ["environment", "solver", "budget"] {
        assert!(page.contains(&format!("id=\"{id}\"")), "{id}");
        assert!(page.contains(&format!("href=\"#{id}\"")), "{id}");
    }
    needs_nothing_else(page);
}

#[test]
fn ctrl_c_leaves_nothing_in_the_folder() {
    let place = Scratch::temporary().expect("a folder");
    let mut child = command(place.path(), "--only solver --rounds 100")
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program runs");
    // It has begun when it says so; the signal handlers are there then.
    let mut errors = std::io::BufReader::new(child.stderr.take().expect("a pipe"));
    let mut line = String::new();
    std::io::BufRead::read_line(&mut errors, &mut line).expect("a line");
    assert!(line.contains("solver"), "{line}");
    thread::sleep(Duration::from_millis(100));
    kill_process(Pid::from_child(&child), Signal::INT).expect("a signal");
    let mut rest = String::new();
    std::io::Read::read_to_string(&mut errors, &mut rest).expect("the rest");
    let status = child.wait().expect("it ends");
    assert_eq!(status.code(), Some(1), "{rest}");
    assert!(rest.contains("interrupted"), "{rest}");
    assert!(names(place.path()).is_empty());
}

/// The daemons in the private places whose names begin like this.
fn daemons_in(places: &str) -> Vec<u32> {
    let entries = fs::read_dir("/proc").expect("processes").flatten();
    let numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    numbers
        .filter(|process| is_daemon(*process, places))
        .collect()
}

/// Of a process that is gone or a zombie: no.
fn is_daemon(process: u32, places: &str) -> bool {
    let line = fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
    let line = String::from_utf8_lossy(&line);
    line.contains("cdcrd\0run\0") && line.contains(&format!("\0{places}"))
}

#[test]
fn ctrl_c_leaves_no_daemon_and_none_of_its_files() {
    let place = Scratch::temporary().expect("a folder");
    let mut child = program("deadline --duration=6s --rounds=2 --load=none --setup=ordinary")
        .env("TMPDIR", place.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program runs");
    let own = format!("cdcrbed_{}_", child.id());

    // A daemon with a client runs when it has files; how soon is up to the machine.
    let has_ended = loop {
        let ended = child.try_wait().expect("it is ours").is_some();
        let is_there = !daemons_in(&own).is_empty() && !in_public_memory(&own).is_empty();
        if ended || is_there {
            break ended;
        }
        thread::sleep(Duration::from_millis(20));
    };
    thread::sleep(Duration::from_secs(1));
    let daemons = daemons_in(&own);
    let folders = names(place.path());
    if !has_ended {
        kill_process(Pid::from_child(&child), Signal::INT).expect("a signal");
    }
    let output = child.wait_with_output().expect("it ends");
    let errors = stderr(&output);
    assert!(!has_ended, "no daemon was seen: {errors}");
    assert!(!folders.is_empty(), "{errors}");

    assert!(!output.status.success(), "{errors}");
    assert!(errors.contains("interrupted"), "{errors}");
    assert!(!daemons.iter().any(|process| is_daemon(*process, &own)));
    assert!(in_public_memory(&own).is_empty());
    assert!(names(place.path()).is_empty());
}

#[test]
fn a_folder_that_cannot_be_made_and_a_missing_file_are_told_before_the_work() {
    let folder = Scratch::temporary().expect("a folder");
    let file = folder.path().join("file");
    fs::write(&file, "").expect("written");
    let found = all(&file.join("inside"), "--only budget");
    let errors = stderr(&found);
    assert!(
        errors.contains("cannot make the folder") && errors.contains("inside"),
        "{errors}"
    );

    let place = Scratch::temporary().expect("a folder");
    let found = all(place.path(), "--config nowhere.toml");
    let errors = stderr(&found);
    assert_eq!(found.status.code(), Some(1));
    assert!(errors.contains("no file nowhere.toml"), "{errors}");
}

#[test]
fn a_benchmark_that_fails_does_not_lose_the_others() {
    let place = Scratch::temporary().expect("a folder");
    let config = place.path().join("bad.toml");
    fs::write(&config, "[cycle]\nno_such_key = 1\n").expect("written");
    let folder = place.path().join("report");
    let mut command = command(&folder, "--only deadline,budget");
    let found = command
        .arg("--config")
        .arg(config)
        .output()
        .expect("the program runs");
    let errors = stderr(&found);
    assert_eq!(found.status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("1 of 2 benchmarks failed: deadline"),
        "{errors}"
    );

    let report = json_in(&folder.join("report.json"));
    assert_eq!(report["failed"], json!(["deadline"]));
    let cause = report["deadline"]["error"].as_str().expect("why");
    assert!(
        cause.contains("no_such_key") || cause.contains("cdcrd does not exist"),
        "{cause}"
    );
    assert!(report["budget"]["cases"].is_array());
    let page = fs::read_to_string(folder.join("report.html")).expect("the page");
    assert!(page.contains("There is no result:"));
}
