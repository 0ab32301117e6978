//! Results of `cdcr-bench deadline`, from a few seconds of real processes.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use cdcr_scratch::Scratch;
use cdcr_test_skip::{Need, skip};
use hdrhistogram::Histogram;
use hdrhistogram::serialization::Deserializer;
use hdrhistogram::serialization::interval_log::{IntervalLogIterator, LogEntry};
use serde_json::Value;

use crate::{is_sound, list, machine, number, printed_json, program};

/// Whether this user may have real-time threads; otherwise only a part can be measured.
fn is_realtime() -> bool {
    let granted = cdcr_testbed::system::thread::may_be_realtime();
    if !granted {
        skip(Need::Realtime, "without it, only a part can be measured");
    }
    granted
}

/// All rounds of a case together: times are added, values of single rounds are left out.
fn assert_case(case: &Value) {
    // A due release was executed or skipped, or its record was lost because the machine stalled the watcher.
    let lost = case["lost_records"].as_f64().unwrap_or_default();
    let due = number(case, "cycles") + number(case, "skipped_periods") + lost;
    // 2 s of 5 ms; processes that start late on a stalled machine get a little less.
    assert!(due >= 300.0, "{case}");
    let (is_daemon, is_reported) = (case["subject"] == "daemon", case["subject"] != "cyclictest");
    for cause in ["platform", "load", "compute", "fault", "other"] {
        assert_eq!(case["causes"][cause].is_u64(), is_reported, "{case}");
    }
    for key in ["compute_us", "response_us", "command_us"] {
        assert_eq!(case[key].is_object(), is_daemon, "{key} of {case}");
    }
    assert!(!is_daemon || number(case, "tracking_share") > 0.0, "{case}");
    let rounds = list(case, "rounds");
    assert_eq!(rounds.len(), 2);
    for key in ["cycles", "steal_ms", "run_delay_ms"] {
        let sum: f64 = rounds.iter().filter_map(|row| row[key].as_f64()).sum();
        let all = case[key].as_f64().unwrap_or_default();
        assert!((sum - all).abs() < 1e-6, "{key} of {case}");
    }
    let most = [0, 1].map(|round| number(&rounds[round]["wake_us"], "max"));
    assert_eq!(case["wake_us"]["max"], most[0].max(most[1]), "{case}");
    assert!(number(&case["median_of_rounds"]["wake_us"], "p50") > 0.0);
    assert!(case["round"].is_null() && case["start_s"].is_null());
}

#[test]
fn the_daemon_stands_beside_the_bare_loop_and_a_load_did_something() {
    let _machine = machine();
    let setup = if is_realtime() { "both" } else { "ordinary" };
    let folder = Scratch::temporary().expect("a folder");
    let line = "deadline --duration=2s --rounds=2 --load=flood --format=json";
    let mut program = program(&format!("{line} --setup {setup} --out"));
    let document = printed_json(program.arg(folder.path()));

    let cases = list(&document, "cases");
    for case in cases {
        assert_case(case);
        for round in list(case, "rounds") {
            let updates = round["load_did"]["updates"].as_u64().expect("a count");
            assert_eq!(updates > 0, case["load"] == "flood", "{case}");
        }
    }
    for realtime in [true, false] {
        let is_it = |row: &&Value| row["load"] == "flood" && row["realtime"] == realtime;
        let ratio = list(&document, "ratios").iter().find(is_it);
        assert_eq!(ratio.is_some(), !realtime || setup == "both");
        for key in ["wake_p50", "wake_p99", "misses_beyond_bare"] {
            let is_there = ratio.is_none_or(|ratio| ratio[key].is_number());
            assert!(is_there, "{ratio:?}");
        }
    }
    is_sound(&document, &[1, 2]);
    for name in ["txt", "json", "csv", "html"].map(|end| format!("deadline.{end}")) {
        let text = std::fs::read_to_string(folder.path().join(&name)).expect(&name);
        assert!(text.contains("flood"), "{name}");
    }
    assert_log(&folder.path().join("histograms/deadline.hlog"), cases);
}

/// The log contains as many wake-ups as cycles ran in each case, and the longest of them.
fn assert_log(file: &Path, cases: &[Value]) {
    let text = std::fs::read_to_string(file).expect("a log");
    let (mut found, mut begin) = (BTreeMap::<String, (u64, u64)>::new(), Duration::ZERO);
    for entry in IntervalLogIterator::new(text.as_bytes()) {
        if let LogEntry::Interval(interval) = entry.expect("an entry") {
            assert!(begin <= interval.start_timestamp(), "in the order of time");
            begin = interval.start_timestamp();
            let bytes = STANDARD.decode(interval.encoded_histogram());
            let times = Deserializer::new().deserialize(&mut &*bytes.expect("base64"));
            let times: Histogram<u64> = times.expect("a histogram");
            let tag = interval.tag().expect("a tag").as_str().to_owned();
            let (count, longest_ns) = found.entry(tag).or_default();
            (*count, *longest_ns) = (*count + times.len(), times.max().max(*longest_ns));
        }
    }
    for case in cases {
        let words = ["load", "set_up", "subject"].map(|key| case[key].as_str().expect(key));
        let (count, longest_ns) = found[&format!("{}.wake", words.join("."))];
        assert_eq!(case["cycles"], count, "{case}");
        let beyond_us = number(&case["wake_us"], "max") - longest_ns as f64 * 1e-3;
        assert!(beyond_us.abs() < 1e-6, "{case}");
    }
}
