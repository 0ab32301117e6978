//! Results of `cdcr-bench footprint`, from one daemon for a moment.
use std::process::Stdio;

use cdcr_process::in_public_memory;
use cdcr_scratch::Scratch;
use cdcr_test_skip::{Need, skip};
use cdcr_testbed::system::counts;
use serde_json::Value;

use crate::{is_sound, list, machine, number, program, row, stderr};

#[test]
fn one_daemon_is_measured_from_its_start_to_its_end_and_nothing_is_left() {
    let _machine = machine();
    let folder = Scratch::temporary().unwrap();
    let child = program("footprint --rounds 1 --duration 500ms --format json")
        .env("TMPDIR", folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let process = child.id();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let document: Value = serde_json::from_slice(&output.stdout).unwrap();

    is_sound(&document, &[1]);
    let start = &list(&document, "rounds")[0];
    let ms = |key: &str| number(start, key);
    // The first good cycle and the first received record come after the release.
    let first_ms = ms("first_release_ms");
    let least_ms = ms("ready_ms").min(ms("first_record_ms"));
    assert!(0.0 < first_ms && first_ms < least_ms, "{start}");
    let quantity = |key: &str| number(row(&document, "quantities", "key", key), "median");
    let parts = quantity("own_mb") + quantity("shared_mb") + quantity("file_mb");
    assert!((quantity("resident_mb") - parts).abs() < 1e-6);
    assert!(quantity("peak_mb") >= quantity("resident_mb"));
    let steps = ["growth_idle_kb", "growth_by_client_kb", "growth_kb"].map(quantity);
    let added_mb = 1e-3 * steps.iter().sum::<f64>();
    assert!((quantity("resident_start_mb") + added_mb - quantity("resident_mb")).abs() < 1e-6);
    // The daemon's report agrees with the kernel's count.
    let is_locked = quantity("locked_mb") > 0.0;
    assert!((quantity("locked") - f64::from(is_locked)).abs() < 1e-9);
    assert!(quantity("memory_files") > 0.0 && quantity("root_files") > 0.0);
    assert_eq!(list(&document, "programs").len(), 3);

    assert_eq!(folder.path().read_dir().unwrap().count(), 0);
    assert!(in_public_memory(&format!("cdcrbed_{process}_")).is_empty());

    if counts::threads(std::process::id()).is_empty() {
        skip(Need::Kernel, "it counts no time of threads (schedstat)");
        return;
    }
    let used = |name| number(row(&document, "threads", "name", name), "tracking_percent");
    assert!(used("cdcr-cycle") > 0.0 && used("cdcr-exchange") > 0.0 && used("cdcrd") > 0.0);

    let sum = used("cdcr-cycle") + used("cdcr-exchange");
    assert!((quantity("core_tracking_percent") - sum).abs() < 1e-9);
}
