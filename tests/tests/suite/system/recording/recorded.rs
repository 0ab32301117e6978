//! A daemon whose cycles are recorded.

use std::path::{Path, PathBuf};

use cdcr_tests::{Daemon, Program, assert_says, text, wait_until};
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
        let daemon = Daemon::start(configuration);
        let file = daemon.place().folder().join("run.mcap");
        Self::into(daemon, file)
    }

    pub(super) fn into(daemon: Daemon, file: PathBuf) -> Self {
        Self {
            recorder: Self::recorder(&daemon, &file),
            daemon,
            file,
        }
    }

    /// A recorder whose streams are open.
    pub(super) fn recorder(daemon: &Daemon, file: &Path) -> Program {
        let mut command = daemon.place().command("cdcrctl");
        let recorder = Program::start(command.arg("record").arg("-o").arg(file));
        wait_until("the recorder has begun", || file.exists());
        recorder
    }

    pub(super) fn end(&mut self) -> String {
        self.recorder.signal(Signal::INT);
        assert_says(&self.recorder.output(), 0, &["run.mcap"])
    }

    pub(super) fn cdcrctl(&self, arguments: &[&str]) -> String {
        let mut command = self.daemon.place().command("cdcrctl");
        let folder = self.daemon.place().folder();
        let output = Program::start(command.args(arguments).current_dir(folder)).output();
        assert!(output.status.success(), "{arguments:?}: {}", text(&output));
        String::from_utf8(output.stdout).unwrap()
    }

    pub(super) fn info(&self) -> Value {
        let printed = self.cdcrctl(&["info", "run.mcap", "--format", "json"]);
        serde_json::from_str(&printed).unwrap()
    }
}
