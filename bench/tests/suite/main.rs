//! Tests of the public interface, in one program: each test program costs a link.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod all;
mod compare;
mod deadline;
mod footprint;
mod latency;
mod paper;
mod quality;
mod rate;
mod refused;
mod results;
mod robustness;

use std::process::{Command, Output};
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde_json::Value;

/// The machine, for one measurement of a daemon at a time. Each has real-time threads on the same cores; one that looks for commands
/// does not rest while they are late, and goes before the reporters of the daemons of others, whose clients take them for dead.
fn machine() -> MutexGuard<'static, ()> {
    static MACHINE: Mutex<()> = Mutex::new(());
    MACHINE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The program with these words.
fn program(line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_cdcr-bench"));
    command.args(line.split_ascii_whitespace());
    command
}

/// What the program prints; it has to succeed.
fn printed(command: &mut Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    String::from_utf8(output.stdout).unwrap()
}

fn printed_json(command: &mut Command) -> Value {
    serde_json::from_str(&printed(command)).unwrap()
}

/// Every link leads to a place of the page itself.
fn needs_nothing_else(page: &str) {
    let page = page.replace("href=\"#", "");
    for word in ["src=", "href=", "url(", "<script", "@import"] {
        assert!(!page.contains(word), "{word} in a page");
    }
}

fn list<'a>(document: &'a Value, key: &str) -> &'a [Value] {
    document[key].as_array().expect(key)
}

fn number(row: &Value, key: &str) -> f64 {
    let number = row[key].as_f64();
    number.unwrap_or_else(|| panic!("{key} of {row}"))
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
