//! The demo: one command, real processes.

use std::fs::{self, File};
use std::path::PathBuf;

use cdcr_client::Connection;
use cdcr_process::{PREFIX, ROOT, cdcrd_in};
use cdcr_shared_types::Location;
use cdcr_shared_types::codes::Mode;
use cdcr_tests::{
    Place, Program, TIMEOUT, assert_output, in_public_memory, text, wait_status, wait_until,
};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use super::error_max_m;
use crate::own_mounts::{has_own_mounts, mount, name_of};

fn demo(place: &Place, arguments: &[&str]) -> (bool, String, String) {
    let output = place
        .command("cdcrctl")
        .arg("demo")
        .args(arguments)
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (
        output.status.success(),
        text(&output.stdout),
        text(&output.stderr),
    )
}

fn is_braille(character: char) -> bool {
    ('\u{2801}'..='\u{28ff}').contains(&character)
}

/// For a demo of 1 s: the number of cycles is that of one second, and missing ones explain the distance of
/// the tip from its reference.
fn assert_error_is_explained(report: &Value) {
    const MOST: u64 = 201;
    const PERIOD_S: f64 = 5e-3;
    let count = |key: &str| report[key].as_u64().unwrap();
    let [mean_mm, max_mm] =
        ["mean_error_mm", "max_error_mm"].map(|key| report[key].as_f64().unwrap());
    let cycles = count("cycles");
    assert!((20..=MOST).contains(&cycles), "{report}");
    assert!(count("deadline_misses") <= cycles, "{report}");
    assert!(
        count("skipped_periods") + count("lost_records") > 0 || cycles > MOST - 20,
        "{report}"
    );
    // Without missing ones, the first and the last release may be on either side of the ends.
    let missing = MOST - cycles;
    let lost_s = if missing <= 2 {
        0.0
    } else {
        missing as f64 * PERIOD_S
    };
    assert!(max_mm >= mean_mm, "{report}");
    // Beside lost releases, solves may have been cut short, which costs a little and is not in the report.
    let is_whole = count("skipped_periods") + count("lost_records") == 0;
    let exact_m = if is_whole { 1e-5 } else { 1e-3 };
    let error_max_m = error_max_m(exact_m, [(lost_s, PERIOD_S)]);
    assert!(mean_mm < 1e3 * error_max_m, "{report}");
}

/// Each miss has a cause, a bare loop ran beside, and the verdict follows from both.
fn assert_misses_are_explained(report: &Value) {
    let causes = report["misses_by_cause"].as_object().unwrap();
    assert_eq!(causes.len(), 5, "{report}");
    let total: u64 = causes.values().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!(total, report["deadline_misses"], "{report}");
    let stolen = report["misses_explained_by_steal"].as_u64().unwrap();
    assert!(stolen <= total, "{report}");
    let baseline = &report["baseline"];
    let bare_cycles = baseline["cycles"].as_u64().unwrap();
    assert!((1..=200).contains(&bare_cycles), "{report}");
    let [p50, p99, max] =
        ["p50", "p99", "max"].map(|key| baseline["wake_us"][key].as_f64().unwrap());
    assert!(p50 <= p99 && p99 <= max, "{report}");
    let verdict = &report["verdict"];
    let is_fine = verdict["limited_by"] == "nothing";
    assert_eq!(is_fine, verdict["next"].is_null(), "{report}");
    assert!(verdict["text"].as_str().unwrap().ends_with('.'), "{report}");
    assert!(!is_fine || total == 0, "{report}");
    if report["realtime"] == true {
        assert!(verdict["grant"].is_null(), "{report}");
        assert_eq!(is_fine, total == 0, "{report}");
    }
    if let Some(steal) = report["steal"].as_object() {
        let [taken_s, window_s] = ["steal_s", "window_s"].map(|key| steal[key].as_f64().unwrap());
        assert!(taken_s >= 0.0 && window_s > 0.0, "{report}");
    }
}

#[test]
fn the_demo_prints_one_json_object_with_every_field() {
    let place = Place::new();
    for sections in ["1", "3"] {
        let arguments = [
            "--sections",
            sections,
            "--duration",
            "1s",
            "--format",
            "json",
        ];
        let (good, out, err) = demo(&place, &arguments);
        assert!(good, "{err}");
        let report: Value = serde_json::from_str(&out).expect("one JSON object");
        assert_eq!(report["sections"].to_string(), sections);
        assert_error_is_explained(&report);
        assert_misses_are_explained(&report);
        assert!(!out.contains(is_braille), "{out}");
        let missing = report["realtime_missing"].as_array().unwrap();
        assert_eq!(report["realtime"].as_bool().unwrap(), missing.is_empty());
        for field in ["deadline_misses", "skipped_periods"] {
            assert!(report[field].is_u64(), "{field}: {out}");
        }
        for field in ["wake_us", "solve_us", "response_us"] {
            let [p50, p99, max] =
                ["p50", "p99", "max"].map(|key| report[field][key].as_f64().unwrap());
            assert!(0.0 <= p50 && p50 <= p99 && p99 <= max, "{field}: {out}");
        }
    }
}

#[test]
fn the_demo_writes_telemetry_and_pictures() {
    let place = Place::new();
    let folder = place.folder().join("out");
    let folder_text = folder.to_str().unwrap();
    let (good, out, err) = demo(&place, &["--duration", "500ms", "--out", folder_text]);
    assert!(good, "{err}");
    assert!(
        out.contains("mm") && out.contains("cycles of 5 ms"),
        "{out}"
    );
    assert!(out.contains("ideal simulated robot"), "{out}");
    assert!(out.contains("next to a bare loop"), "{out}");
    assert!(out.contains(is_braille), "the robot is drawn: {out}");
    assert!(!out.contains('\x1b'), "no colours in a pipe: {out:?}");
    let table = fs::read_to_string(folder.join("telemetry.csv")).unwrap();
    let head = table.lines().next().unwrap();
    assert!(head.contains("error_m") && head.contains("_us"), "{head}");
    assert!(
        table.lines().count() > 20,
        "{} lines",
        table.lines().count()
    );
    for picture in ["path.svg", "error.svg", "timing.svg", "shape.svg"] {
        let text = fs::read_to_string(folder.join(picture)).unwrap();
        assert!(
            text.contains("<svg") && text.trim_end().ends_with("</svg>"),
            "{picture}"
        );
    }
}

/// A running demo with a private folder for temporary files. Dropping it removes what is left.
struct RunningDemo {
    program: Program,
    place: Place,
}

impl RunningDemo {
    fn start() -> Self {
        let place = Place::new();
        let temporary = place.folder().join("tmp");
        fs::create_dir(&temporary).unwrap();
        let mut command = place.command("cdcrctl");
        command
            .args(["demo", "--duration", "20s"])
            .env("TMPDIR", temporary);
        Self {
            program: Program::start(&mut command),
            place,
        }
    }

    /// Prefix of its file names.
    fn prefix(&self) -> String {
        format!("{PREFIX}{}_", self.program.id())
    }

    /// Names in its folder for temporary files.
    fn temporary(&self) -> Vec<String> {
        let entries = fs::read_dir(self.place.folder().join("tmp")).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        names.collect()
    }

    /// Waits for its process of this subcommand of `cdcrd`.
    fn wait_cdcrd(&self, subcommand: &str) -> u32 {
        let process = || cdcrd_in(&self.prefix(), subcommand);
        wait_until(subcommand, || process().is_some());
        process().unwrap()
    }

    fn wait_tracking(&self) {
        let memory = in_public_memory(&self.prefix());
        let mut locks = memory
            .iter()
            .filter_map(|path| path.to_str()?.strip_suffix("lock"));
        let place = locks.next().unwrap();
        let root = PathBuf::from(format!("{place}{ROOT}"));
        let prefix = place.rsplit('/').next().unwrap();
        let location = Location::new(prefix, &root).unwrap();
        let connection = Connection::open_within(&location, "demo", TIMEOUT).unwrap();
        wait_status(&connection, |status| status.mode == Mode::Tracking.code());
    }
}

impl Drop for RunningDemo {
    fn drop(&mut self) {
        if let Some(left) = cdcrd_in(&self.prefix(), "") {
            let left = Pid::from_raw(left.cast_signed()).unwrap();
            let _ = kill_process(left, Signal::KILL);
        }
        for left in in_public_memory(&self.prefix()) {
            let _ = fs::remove_file(&left).or_else(|_| fs::remove_dir_all(left));
        }
    }
}

#[test]
fn an_interrupted_demo_leaves_nothing() {
    // The baseline, the start of the daemon, and what a user sees most of the time.
    for (signal, subcommand, is_tracking) in [
        (Signal::INT, "bare", false),
        (Signal::INT, "run", false),
        (Signal::INT, "run", true),
        (Signal::TERM, "run", true),
    ] {
        let mut demo = RunningDemo::start();
        demo.wait_cdcrd(subcommand);
        if is_tracking {
            demo.wait_tracking();
        }
        demo.program.signal(signal);
        let output = demo.program.output();
        assert_eq!(output.status.code(), Some(130), "{}", text(&output));
        let left = cdcrd_in(&demo.prefix(), "");
        assert_eq!(left, None, "its cdcrd {subcommand} still runs");
        assert_eq!(in_public_memory(&demo.prefix()), Vec::<PathBuf>::new());
        assert_eq!(demo.temporary(), Vec::<String>::new());
    }
}

#[test]
fn the_daemon_of_a_killed_demo_ends() {
    let mut demo = RunningDemo::start();
    let daemon = demo.wait_cdcrd("run");
    demo.wait_tracking();
    demo.program.signal(Signal::KILL);
    demo.program.output();
    // It may still be a zombie.
    let stat = || fs::read_to_string(format!("/proc/{daemon}/stat")).unwrap_or_default();
    let has_ended = |stat: &str| stat.is_empty() || stat.contains(") Z ");
    wait_until("the end of its daemon", || {
        cdcrd_in(&demo.prefix(), "").is_none() && has_ended(&stat())
    });
    let left = in_public_memory(&demo.prefix());
    for root in left.iter().filter(|path| path.is_dir()) {
        // Threads of a zombie may still be ending, and hold its locks.
        wait_until("its lock is free", || {
            File::open(root).unwrap().try_lock().is_ok()
        });
        // Only folders and the lock of its place remain in memory.
        let mut entries = fs::read_dir(root).unwrap().flatten();
        assert!(entries.all(|entry| entry.path().is_dir()), "{root:?}");
    }
    // The next demo removes and reports what is left, and leaves nothing itself.
    let next = demo
        .place
        .command("cdcrctl")
        .args(["demo", "--duration", "500ms"])
        .env("TMPDIR", demo.place.folder().join("tmp"))
        .output()
        .unwrap();
    assert!(next.status.success(), "{}", text(&next));
    assert!(
        text(&next).contains("left by a program that was killed"),
        "{}",
        text(&next)
    );
    assert_eq!(demo.temporary(), Vec::<String>::new());
    assert_eq!(in_public_memory(&demo.prefix()), Vec::<PathBuf>::new());
}

/// As with a folder of another user, or on a medium that is full or read-only.
#[test]
fn a_folder_for_results_that_cannot_be_written_is_refused_before_the_run() {
    let test = &name_of(&a_folder_for_results_that_cannot_be_written_is_refused_before_the_run);
    if !has_own_mounts(test) {
        return;
    }
    let place = Place::new();
    let out = place.folder().join("out");
    fs::create_dir(&out).unwrap();
    let out = out.display();
    if !mount(&format!(
        "mount --bind '{out}' '{out}' && mount -o remount,ro,bind '{out}'"
    )) {
        return;
    }
    for line in [
        "demo --format json --out out",
        "calibrate excite -o out/moved.csv",
    ] {
        let mut command = place.command("cdcrctl");
        command.args(line.split(' ')).current_dir(place.folder());
        let output = Program::start(&mut command).output();
        assert_output(&output, 1, &["cannot write into"]);
        assert!(output.stdout.is_empty(), "it ran: {}", text(&output));
    }
    assert!(mount(&format!("umount '{out}'")));
}
