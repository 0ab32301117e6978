//! What `cdcr-bench deadline` hands over, from a few seconds of real processes.

use std::path::Path;

use cdcr_scratch::Scratch;
use cdcr_test_skip::{Need, skip};
use serde_json::Value;

use crate::{printed_json, program};

/// Whether this user may have real-time threads; if not, only a part can be measured.
fn is_realtime() -> bool {
    let granted = cdcr_testbed::system::thread::may_be_realtime();
    if !granted {
        skip(Need::Realtime, "without it, only a part can be measured");
    }
    granted
}

fn assert_quantiles(case: &Value, key: &str) {
    let values = ["min", "p50", "p99", "p999", "max"]
        .map(|name| case[key][name].as_f64().unwrap_or(f64::NAN));
    assert!(values.is_sorted(), "{key} of {case}");
    assert!(values[0] >= 0.0 && values[4] > 0.0, "{key} of {case}");
}

fn assert_case(case: &Value, cycles_least: u64) {
    let count = |key: &str| {
        case[key]
            .as_u64()
            .unwrap_or_else(|| panic!("{key} of {case}"))
    };
    // What was due either ran or was skipped.
    assert!(
        count("cycles") + count("skipped_periods") >= cycles_least,
        "{case}"
    );
    // cyclictest does not say why.
    let is_told = case["subject"] != "cyclictest";
    for cause in ["platform", "load", "compute", "fault", "other"] {
        assert_eq!(case["causes"][cause].is_u64(), is_told, "{case}");
    }
    assert!(case["steal_ms"].is_number() && case["realtime"].is_boolean());
    assert_quantiles(case, "wake_us");
    match case["subject"].as_str().expect("a subject") {
        "daemon" => {
            for key in ["compute_us", "response_us", "command_us"] {
                assert_quantiles(case, key);
            }
            assert!(
                case["tracking_share"].as_f64().expect("a share") > 0.0,
                "{case}"
            );
        }
        subject => {
            assert!(["bare", "cyclictest"].contains(&subject));
            assert!(case["response_us"].is_null(), "{case}");
        }
    }
}

#[test]
fn the_daemon_stands_beside_the_bare_loop_and_a_load_did_something() {
    let setup = if is_realtime() { "both" } else { "ordinary" };
    let folder = Scratch::temporary().expect("a folder");
    let arguments = [
        "deadline",
        "--duration=2s",
        "--rounds=2",
        "--load=flood",
        "--format=json",
        "--setup",
        setup,
        "--out",
    ];
    let document = printed_json(program(&arguments).arg(folder.path()));

    let cases = document["cases"].as_array().expect("a list");
    for case in cases {
        // 2 s of 5 ms; processes that start late on a machine that stalls get a little less.
        assert_case(case, 300);
        let rounds = case["rounds"].as_array().expect("a list");
        assert_eq!(rounds.len(), 2);
        for round in rounds {
            let updates = round["load_did"]["updates"].as_u64().expect("a count");
            assert_eq!(updates > 0, case["load"] == "flood", "{case}");
        }
    }
    let setups: &[bool] = if setup == "both" {
        &[true, false]
    } else {
        &[false]
    };
    for realtime in setups {
        let is_it = |row: &&Value| row["load"] == "flood" && row["realtime"] == *realtime;
        let of = |subject| {
            cases
                .iter()
                .filter(is_it)
                .any(|case| case["subject"] == subject)
        };
        assert!(of("bare") && of("daemon"), "{realtime}");
        let ratios = document["ratios"].as_array().expect("a list");
        let ratio = ratios.iter().find(is_it).expect("a ratio");
        for key in ["wake_p50", "wake_p99", "misses_beyond_bare"] {
            assert!(ratio[key].as_f64().is_some_and(f64::is_finite), "{ratio}");
        }
    }
    let metrics = document["metrics"].as_array().expect("a list");
    assert!(
        metrics
            .iter()
            .all(|metric| metric["rounds"].as_array().is_some_and(|r| !r.is_empty()))
    );
    assert!(document["environment"].is_object());
    assert_files(folder.path());
}

fn assert_files(folder: &Path) {
    for name in [
        "deadline.txt",
        "deadline.json",
        "deadline.csv",
        "deadline.html",
    ] {
        let text = std::fs::read_to_string(folder.join(name)).expect(name);
        assert!(text.contains("flood"), "{name}");
    }
    let log = std::fs::read_to_string(folder.join("histograms/deadline.hlog")).expect("a log");
    assert!(log.contains("flood") && log.contains("HIST"), "{log}");
}
