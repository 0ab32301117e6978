//! C programs with the libraries of `c/`: its examples as a new user runs them, and the effects of bad inputs
//! and bad moments.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Command, Stdio};

use cdcr_tests::{
    Daemon, Place, Program, STALL_TOLERANT, TIMEOUT, assert_output, text, wait_until,
};

use super::driver_example::run_driver;

/// Largest number of lines of the example driver for beginners.
const DRIVER_LINES: usize = 60;

/// The library that a program is linked with.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Linked {
    Shared,
    Static,
}

/// The folder of the C sources.
fn sources() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../c")
}

/// Compiles a source of `c/` into the place's folder, as described in docs/c.md.
fn built(place: &Place, source: &str, linked: Linked) -> PathBuf {
    let ourselves = std::env::current_exe().unwrap();
    let libraries = ourselves.parent().unwrap();
    let program = place.folder().join("program");
    let mut compiler = Command::new("cc");
    compiler
        .args(["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-I"])
        .arg(sources().join("include"))
        .arg(sources().join(source));
    match linked {
        Linked::Shared => compiler
            .arg("-L")
            .arg(libraries)
            .arg("-lcdcr_c")
            .arg(format!("-Wl,-rpath,{}", libraries.display())),
        Linked::Static => compiler
            .arg(libraries.join("libcdcr_c.a"))
            .args(["-lpthread", "-ldl"]),
    };
    let output = compiler.arg("-lm").arg("-o").arg(&program).output();
    let output = output.expect("a C compiler");
    assert!(output.status.success(), "{}", text(&output));
    program
}

#[test]
fn the_driver_in_c_obeys_speeds() {
    run_driver("velocity", |place| {
        place.command_of(&built(place, "examples/driver.c", Linked::Shared))
    });
}

#[test]
fn the_driver_in_c_obeys_positions() {
    run_driver("position", |place| {
        place.command_of(&built(place, "examples/driver.c", Linked::Static))
    });
}

#[test]
fn the_driver_in_c_is_short() {
    let source = std::fs::read_to_string(sources().join("examples/driver.c")).unwrap();
    assert!(source.lines().count() <= DRIVER_LINES);
}

#[test]
fn the_client_in_c_feeds_and_watches() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let program = built(daemon.place(), "examples/feed.c", Linked::Shared);
    let output = Program::start(&mut daemon.place().command_of(&program)).output();
    let reported = assert_output(&output, 0, &["robot cdcr: 3 sections, 0.9 m"]);
    let tracked: u64 = reported
        .split(" cycles tracked")
        .next()
        .and_then(|begin| begin.lines().last()?.parse().ok())
        .unwrap_or_else(|| panic!("{reported}"));
    assert!(tracked > 20, "{reported}");
}

/// A case of `c/tests/probe.c`.
struct Probe {
    case: &'static str,
    program: Program,
    stdin: ChildStdin,
}

impl Probe {
    fn start(daemon: &Daemon, case: &'static str) -> Self {
        let program = built(daemon.place(), "tests/probe.c", Linked::Shared);
        let mut command = daemon.place().command_of(&program);
        let mut program = Program::start(command.arg(case).stdin(Stdio::piped()));
        let stdin = program.0.stdin.take().unwrap();
        Self {
            case,
            program,
            stdin,
        }
    }

    /// Waits until it has printed `lines` lines.
    fn wait(&mut self, lines: usize) {
        wait_until("it comes so far", || {
            self.program.lines() >= lines || !self.program.runs()
        });
    }

    fn go_on(&mut self) {
        // A program that has ended prints the reason.
        let _ = self.stdin.write_all(b"\n");
    }

    fn ends_well(mut self) {
        let output = self.program.output();
        assert!(output.status.success(), "{}: {}", self.case, text(&output));
    }
}

/// Bad inputs are refused; handles stay on their thread and end with it; a forked child leaves its parent's
/// handles alone.
#[test]
fn what_a_program_in_c_does_wrong_is_refused_and_harms_nobody() {
    let daemon = Daemon::start(STALL_TOLERANT);
    for case in ["forks", "threads", "inputs"] {
        Probe::start(&daemon, case).ends_well();
    }
}

#[test]
fn a_lease_of_another_is_a_refusal_and_one_of_a_program_that_ended_is_free() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let lease = connection.acquire_lease_within(TIMEOUT).unwrap();
    let mut probe = Probe::start(&daemon, "lease");
    probe.wait(1);
    lease.release().unwrap();
    probe.go_on();
    probe.ends_well();
    // Sixty seconds before it would have expired.
    drop(connection.acquire_lease_within(TIMEOUT).unwrap());
}

#[test]
fn a_driver_in_c_that_is_started_again_leaves_its_motors_where_they_stand() {
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = \"driver\"\ninterface = \"position\"\nmeasurement_timeout_ms = 1000.0\n"
    ));
    Probe::start(&daemon, "stands").ends_well();
}

#[test]
fn a_daemon_that_goes_away_is_silence_and_rest() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let mut probe = Probe::start(&daemon, "away");
    probe.wait(1);
    daemon.kill();
    probe.go_on();
    probe.wait(2);
    daemon.restart();
    probe.go_on();
    probe.ends_well();
    daemon.end_clean();
}
