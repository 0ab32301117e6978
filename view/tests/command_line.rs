//! The command line of `cdcr-view` without a daemon. (This test also makes cargo build the binary for the
//! tests of the whole system.)

use std::process::Command;

use cdcr_scratch::Scratch;

#[test]
fn a_daemon_that_is_not_there_is_named() {
    let scratch = Scratch::in_memory().expect("a folder");
    let output = Command::new(env!("CARGO_BIN_EXE_cdcr-view"))
        .args(["--robot", "nobody", "--prefix", scratch.prefix()])
        .arg("--root")
        .arg(scratch.path())
        .output()
        .expect("cdcr-view runs");
    let reported = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{reported}");
    assert!(
        reported.contains("no daemon") && reported.contains("nobody"),
        "{reported}"
    );
}
