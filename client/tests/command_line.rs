//! Error messages of `cdcrctl`: each names the problem, its location and the next step.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::thread::sleep;
use std::time::Duration;

use cdcr_scratch::Scratch;
use cdcr_shared_types::Location;

/// Runs `cdcrctl` where no daemon can be.
fn cdcrctl(root: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_cdcrctl"))
        .args(arguments)
        .env("CDCR_PREFIX", "cdcr_cli_test_")
        .env("CDCR_ROOT", root)
        .env("CDCR_ROBOT", "trunk")
        .output()
        .expect("cdcrctl runs")
}

/// Runs a program that was just written. While another test starts a process, that process briefly holds this
/// file open, and the system call fails with "busy".
fn run_fresh(command: &mut Command) -> Output {
    loop {
        match command.output() {
            Err(error) if error.kind() == ErrorKind::ExecutableFileBusy => {
                sleep(Duration::from_millis(5));
            }
            output => return output.expect("cdcrctl runs"),
        }
    }
}

/// A copy of `cdcrctl` without `cdcrd` beside it.
fn copied_into(folder: &Scratch) -> PathBuf {
    let alone = folder.path().join("cdcrctl");
    fs::copy(env!("CARGO_BIN_EXE_cdcrctl"), &alone).expect("copied");
    alone
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn without_a_daemon_every_command_reports_where_it_searched_and_how_to_start_one() {
    let folder = Scratch::temporary().expect("a folder");
    let root = folder.path().join("none");
    for arguments in [
        &["status"][..],
        &["track"],
        &["echo"],
        &["ref", "spiral", "--track"],
        &["obstacle", "clear"],
    ] {
        let output = cdcrctl(&root, arguments);
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {text}");
        for part in [
            "no daemon is running",
            "\"trunk\"",
            "\"cdcr_cli_test_\"",
            &format!(
                "cdcrd run --robot trunk --prefix cdcr_cli_test_ --root {}",
                root.display()
            ),
        ] {
            assert!(text.contains(part), "{arguments:?}: {part} in {text}");
        }
        assert!(!root.exists(), "a client leaves nothing behind");
    }
}

#[test]
fn an_empty_root_is_no_daemon_either() {
    let folder = Scratch::temporary().expect("a folder");
    let output = cdcrctl(folder.path(), &["status"]);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("no services of that name exist"), "{text}");
    let location = Location::new("cdcr_cli_test_", folder.path()).expect("legal");
    assert_eq!(location.memory_files(), Vec::<PathBuf>::new());
}

#[test]
fn options_beat_the_environment() {
    let folder = Scratch::temporary().expect("a folder");
    let root = folder.path().join("none");
    let output = cdcrctl(&root, &["status", "--robot", "arm", "--prefix", "other_"]);
    let text = stderr(&output);
    assert!(text.contains("--robot arm --prefix other_"), "{text}");
}

#[test]
fn wrong_usage_is_exit_code_2() {
    let root = Path::new("/nonexistent");
    for arguments in [
        &["demo", "--sections", "4"][..],
        &["demo", "--duration", "50ms"],
        &["demo", "--duration", "21s"],
        &["demo", "--duration", "5"],
        &["ref", "circle", "--radius", "-1"],
        &["ref", "line", "--axis", "0,0,0"],
        &[
            "obstacle", "add", "--id", "1", "--at", "0,0", "--radius", "1",
        ],
        &["echo", "nonsense"],
        &["fly"],
        &[],
    ] {
        let output = cdcrctl(root, arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn invalid_names_are_rejected_with_the_rule() {
    let output = cdcrctl(Path::new("/tmp"), &["status", "--robot", "a/b"]);
    assert!(stderr(&output).contains("1 to 40 letters"));
    let output = cdcrctl(Path::new("/tmp"), &["status", "--prefix", "a b"]);
    assert!(stderr(&output).contains("1 to 40 letters"));
    let output = cdcrctl(Path::new("relative"), &["status"]);
    assert!(stderr(&output).contains("absolute path"));
}

#[test]
fn an_invalid_file_is_reported_with_its_line_even_without_a_daemon() {
    let folder = Scratch::temporary().expect("a folder");
    let file = folder.path().join("bad.csv");
    fs::write(&file, "t_s,x_m,y_m,z_m\n0,0,0,0.3\n0.1,0,NaN,0.3\n").expect("written");
    let path = file.to_str().expect("UTF-8");
    let output = cdcrctl(folder.path(), &["ref", "file", path]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("bad.csv:3: y_m is \"NaN\""));
    let output = cdcrctl(folder.path(), &["ref", "file", "/no/such.csv"]);
    assert!(stderr(&output).contains("cannot read /no/such.csv"));
    assert!(stderr(&output).contains("t_s,x_m,y_m,z_m"));
}

#[test]
fn the_demo_reports_a_daemon_that_is_not_built() {
    let folder = Scratch::temporary().expect("a folder");
    let alone = copied_into(&folder);
    let output = run_fresh(Command::new(&alone).args(["demo", "--duration", "1s"]));
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("cdcrd does not exist"), "{text}");
    assert!(text.contains("cargo build --release"), "{text}");
}

#[test]
fn a_demo_names_the_remedy_for_its_folder_and_no_folder_is_too_deep() {
    let folder = Scratch::temporary().expect("a folder");
    let deep = folder.path().join("d".repeat(100));
    fs::create_dir(&deep).expect("made");
    let alone = copied_into(&folder);
    fs::write(folder.path().join("cdcrd"), "").expect("written");
    let demo = |temporary: &Path| {
        let output = run_fresh(Command::new(&alone).arg("demo").env("TMPDIR", temporary));
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        stderr(&output)
    };
    let text = demo(&folder.path().join("missing"));
    assert!(text.contains("set TMPDIR"), "{text}");
    // This call reaches the start of the daemon, which is not a program.
    let text = demo(&deep);
    assert!(text.contains("cdcrd") && !text.contains("TMPDIR"), "{text}");
    assert_eq!(fs::read_dir(&deep).expect("there").count(), 0);
}

#[test]
fn a_daemon_that_fails_is_quoted_and_nothing_is_left() {
    let folder = Scratch::temporary().expect("a folder");
    let temporary = folder.path().join("tmp");
    fs::create_dir(&temporary).expect("made");
    let alone = copied_into(&folder);
    let daemon = folder.path().join("cdcrd");
    fs::write(&daemon, "#!/bin/sh\necho the core is on fire >&2\nexit 3\n").expect("written");
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    fs::set_permissions(&daemon, mode).expect("executable");
    let output = run_fresh(Command::new(&alone).arg("demo").env("TMPDIR", &temporary));
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.starts_with("error: the core is on fire\n"), "{text}");
    let left = fs::read_dir(&temporary).expect("there").count();
    assert_eq!(left, 0, "the demo's folder is gone");
}
