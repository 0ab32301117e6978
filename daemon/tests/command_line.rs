//! The command line of `cdcrd`, without starting it. (Being here, this test also makes cargo build the
//! binary for the tests of the whole system.)

use std::process::{Command, Output};

fn cdcrd(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cdcrd"));
    for variable in ["CDCR_CONFIG", "CDCR_ROBOT", "CDCR_PREFIX", "CDCR_ROOT"] {
        command.env_remove(variable);
    }
    command.args(arguments).output().expect("cdcrd runs")
}

#[test]
fn options_win_over_defaults_and_are_checked() {
    let good = cdcrd(&[
        "check", "--robot", "trunk", "--prefix", "lab_", "--root", "/tmp/lab",
    ]);
    let text = String::from_utf8_lossy(&good.stdout).into_owned();
    assert!(good.status.success());
    for part in ["trunk", "lab_", "/tmp/lab", "3 sections"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let bad = cdcrd(&["check", "--prefix", "a b"]);
    let text = String::from_utf8_lossy(&bad.stderr).into_owned();
    assert!(!bad.status.success() && text.contains("\"a b\""), "{text}");
}

#[test]
fn help_shows_an_example() {
    for command in [
        &["--help"][..],
        &["run", "--help"],
        &["check", "--help"],
        &["config", "default", "--help"],
    ] {
        let output = cdcrd(command);
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(
            output.status.success() && text.contains("Example:"),
            "{command:?}: {text}"
        );
    }
}
