//! A daemon whose cycles are recorded.

use std::path::PathBuf;

use cdcr_tests::{Daemon, Program, assert_output};
use rustix::process::Signal;
use serde_json::Value;

/// A daemon, and a program that records its topics.
pub(super) struct Recorded {
    pub(super) daemon: Daemon,
    pub(super) recorder: Program,
    pub(super) file: PathBuf,
}

impl Recorded {
    pub(super) fn start(configuration: &str) -> Self {
        Self::into(Daemon::start(configuration), "run.mcap")
    }

    /// A file of the daemon's folder.
    pub(super) fn into(daemon: Daemon, file: &str) -> Self {
        Self {
            recorder: daemon.place().record(file),
            file: daemon.place().folder().join(file),
            daemon,
        }
    }

    pub(super) fn end(&mut self) -> String {
        self.recorder.signal(Signal::INT);
        assert_output(&self.recorder.output(), 0, &["run.mcap"])
    }

    pub(super) fn info(&self) -> Value {
        self.daemon.place().json("info run.mcap")
    }
}
