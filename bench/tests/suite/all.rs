//! Files that `cdcr-bench all` writes.

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::thread;
use std::time::Duration;

use cdcr_bench::budget::BUDGETS_US;
use cdcr_bench::compare::{ChangeClass, Comparison, Input};
use cdcr_process::{cdcrd_in, in_public_memory};
use cdcr_scratch::Scratch;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};

use crate::{is_sound, list, machine, needs_nothing_else, number, printed, program, stderr};

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

#[test]
fn a_quick_result_is_marked_as_no_measurement() {
    for format in ["text", "markdown"] {
        let text = printed(&mut program(&format!("budget --quick --format {format}")));
        assert!(text.contains(cdcr_bench::report::QUICK), "{text}");
    }
}

#[test]
fn a_report_holds_every_format_and_a_smaller_one_does_not_replace_it() {
    let place = Scratch::temporary().expect("a folder");
    let folder = place.path().join("report");
    let found = all(&folder, "--only solver,budget --rounds 2");
    let errors = stderr(&found);
    let is_written = found.status.success() && errors.contains("written to");
    assert!(is_written, "{errors}");
    assert!(found.stdout.starts_with(b"The machine"));
    let expected = "budget-overrun.svg budget.csv report.html report.json report.txt solver-estimate.csv \
                    solver-growth.csv solver-guard.csv solver-sections.svg solver.csv";
    let expected: BTreeSet<_> = expected.split(' ').map(str::to_owned).collect();
    assert_eq!(names(&folder), expected);

    let file = folder.join("report.json");
    let report = json_in(&file);
    let kernel = &report["environment"]["kernel"];
    assert!(kernel["release"].is_string(), "{report}");
    assert_eq!(report["extent"]["quick"], true);
    // Without the folder, whose path does not matter.
    let options =
        json!({ "command": "all", "only": "solver,budget", "quick": "true", "rounds": "2" });
    assert_eq!(report["options"], options);
    assert_eq!(report["failed"], json!([]));
    is_sound(&report, &[2]);
    for row in list(&report["solver"], "estimate") {
        let of = |key: &str| number(row, key);
        let (both, p50) = (of("both_p50_us"), of("estimate_p50_us"));
        assert!(0.0 < p50 && both >= p50.max(of("solve_p50_us")), "{row}");
    }
    let budgets = list(&report["budget"], "cases");
    assert_budgets(budgets);
    let input = Input::read(&file).expect("a result");
    let comparison = Comparison::new(&input, &input);
    let changed = [ChangeClass::Worse, ChangeClass::Better].map(|class| comparison.count(class));
    assert!(!comparison.metrics.is_empty() && changed == [0, 0]);
    assert!(comparison.warnings.is_empty(), "{:?}", comparison.warnings);
    let page = fs::read_to_string(folder.join("report.html")).expect("the page");
    assert_eq!(page.matches("<svg").count(), 2);
    for id in ["environment", "solver", "budget"] {
        for link in [format!("id=\"{id}\""), format!("href=\"#{id}\"")] {
            assert!(page.contains(&link), "{link}");
        }
    }
    needs_nothing_else(&page);

    // A report with fewer results goes beside it, even if benchmarks were renamed; a failed result does not count as
    // lost.
    let mut older = report;
    older["renamed"] = json!({ "cases": [] });
    older["failing"] = json!({ "error": "no luck" });
    (older["took_s"]["renamed"], older["took_s"]["failing"]) = (json!(1.0), json!(1.0));
    let older = older.to_string();
    fs::write(&file, &older).expect("written");
    let found = all(&folder, "--only budget");
    let errors = stderr(&found);
    let words = "with renamed, solver, which is missing here";
    assert!(found.status.success() && errors.contains(words), "{errors}");
    assert_eq!(fs::read_to_string(&file).expect("the report"), older);
    let aside = json_in(&folder.join("partial").join("report.json"));
    assert!(aside["budget"].is_object() && aside["solver"].is_null());
}

/// Every case has every budget, and no plan is worse than the warm start.
fn assert_budgets(rows: &[Value]) {
    let cases = ["default", "tip-axis", "obstacles"].into_iter();
    let all = cases.flat_map(|case| BUDGETS_US.map(|us| (case, us)));
    assert_eq!(rows.len(), all.clone().count());
    for (row, (case, budget_us)) in rows.iter().zip(all) {
        // 50 solves in each round.
        let expected = [json!(case), json!(budget_us), json!(100), json!(0)];
        let keys = ["case", "budget_us", "solves", "worse_than_warm_start"];
        assert_eq!(keys.map(|key| row[key].clone()), expected);
        // Without any time there is always work left.
        let has_time = budget_us > 0;
        assert!(has_time || row["ended_by_budget_share"] == 1.0, "{row}");
    }
}

#[test]
fn ctrl_c_leaves_no_daemon_none_of_its_files_and_no_result() {
    let _machine = machine();
    for (only, has_daemon) in [("deadline", true), ("solver", false)] {
        let [place, folder] = [(); 2].map(|()| Scratch::temporary().expect("a folder"));
        let mut command = command(folder.path(), &format!("--rounds 100 --only {only}"));
        command.env("TMPDIR", place.path()).stdout(Stdio::null());
        let mut child = command.stderr(Stdio::piped()).spawn().expect("it runs");
        // The first line of output shows that the signal handlers are installed.
        let mut errors = BufReader::new(child.stderr.take().expect("a pipe"));
        let mut text = String::new();
        errors.read_line(&mut text).expect("a line");
        assert!(text.contains(only), "{text}");
        let own = format!("cdcrbed_{}_", child.id());
        // A daemon with a client has files; the time until then depends on the machine.
        let runs = || cdcrd_in(&own, "run").is_some() && !in_public_memory(&own).is_empty();
        while has_daemon && !runs() {
            let ended = child.try_wait().expect("it is ours");
            assert!(ended.is_none(), "no daemon was seen");
            thread::sleep(Duration::from_millis(20));
        }
        thread::sleep(Duration::from_millis(500));
        assert_eq!(!names(place.path()).is_empty(), has_daemon, "{only}");
        kill_process(Pid::from_child(&child), Signal::INT).expect("a signal");
        errors.read_to_string(&mut text).expect("the rest");
        assert_eq!(child.wait().expect("it ends").code(), Some(1), "{text}");
        assert!(text.contains("interrupted"), "{text}");
        assert!(cdcrd_in(&own, "").is_none() && in_public_memory(&own).is_empty());
        assert!(names(place.path()).is_empty() && names(folder.path()).is_empty());
    }
}

#[test]
fn a_benchmark_that_fails_does_not_lose_the_others() {
    let place = Scratch::temporary().expect("a folder");
    let (config, folder) = (place.path().join("bad.toml"), place.path().join("report"));
    fs::write(&config, "[cycle]\nno_such_key = 1\n").expect("written");
    let line = format!("--only deadline,budget --config {}", config.display());
    let found = all(&folder, &line);
    let errors = stderr(&found);
    let words = "1 of 2 benchmarks failed: deadline";
    let has_failed = found.status.code() == Some(1) && errors.contains(words);
    assert!(has_failed, "{errors}");
    let report = json_in(&folder.join("report.json"));
    assert_eq!(report["failed"], json!(["deadline"]));
    let cause = report["deadline"]["error"].as_str().expect("why");
    let causes = ["no_such_key", "cdcrd does not exist"];
    assert!(causes.iter().any(|words| cause.contains(words)), "{cause}");
    assert!(report["budget"]["cases"].is_array());
    let page = fs::read_to_string(folder.join("report.html")).expect("the page");
    assert!(page.contains("There is no result:"));
}
