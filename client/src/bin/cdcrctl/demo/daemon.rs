use std::fs::{self, File};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use cdcr_client::Connection;
use cdcr_shared_types::codes::Mode;
use rustix::process::{Pid, Signal, kill_process};

use super::place::PrivatePlace;
use crate::interrupt::Interrupt;

/// How long the daemon may take to run.
const START_TIMEOUT: Duration = Duration::from_secs(10);
/// How long it may take to end.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);
const LOG: &str = "cdcrd.log";
const ROBOT: &str = "demo";

/// A daemon of our own in a private place. Dropping it stops it and removes every trace.
pub(super) struct DemoDaemon {
    child: Child,
    place: PrivatePlace,
}

impl DemoDaemon {
    /// Starts the `cdcrd` that lies beside this program.
    pub(super) fn start(place: PrivatePlace) -> anyhow::Result<Self> {
        let program = beside_ourselves("cdcrd")?;
        let log =
            File::create(place.folder().join(LOG)).context("cannot write the daemon's log")?;
        let child = Command::new(&program)
            // Whatever ends us, SIGKILL too, ends the daemon.
            .args(["run", "--end-with-parent", &std::process::id().to_string()])
            .arg("--config")
            .arg(place.folder().join(PrivatePlace::CONFIG))
            .args(["--robot", ROBOT, "--prefix", place.location().prefix()])
            .arg("--root")
            .arg(place.location().root())
            // It reads nothing. While it runs, nobody takes the place for abandoned.
            .stdin(place.lock()?)
            .stdout(log.try_clone()?)
            .stderr(log)
            // Ctrl-C reaches us alone; we stop the daemon in order.
            .process_group(0)
            .spawn()
            .with_context(|| format!("cannot start {}", program.display()))?;
        Ok(Self { child, place })
    }

    /// Waits until the daemon controls its robot. `None`: interrupted.
    pub(super) fn connect(&mut self, interrupt: &Interrupt) -> anyhow::Result<Option<Connection>> {
        let deadline = Instant::now() + START_TIMEOUT;
        let mut last = "it did not begin to control its robot".to_owned();
        while Instant::now() < deadline {
            if interrupt.is_raised() {
                return Ok(None);
            }
            if let Some(code) = self.child.try_wait()? {
                bail!(self.explained(&format!("the demo's daemon ended at once ({code})")));
            }
            match Connection::open(self.place.location(), ROBOT) {
                Ok(connection) if is_running(&connection) => return Ok(Some(connection)),
                Ok(_) => {}
                Err(cause) => last = cause.to_string(),
            }
            thread::sleep(Duration::from_millis(20));
        }
        let limit_s = START_TIMEOUT.as_secs();
        bail!(self.explained(&format!(
            "the demo's daemon was not ready within {limit_s} s: {last}"
        )))
    }

    /// What happened, with what the daemon wrote about it.
    pub(super) fn explained(&self, what: &str) -> String {
        explained(what, &self.place.folder().join(LOG))
    }

    /// Ends the daemon and waits for it.
    pub(super) fn stop(&mut self) -> anyhow::Result<()> {
        if self.child.try_wait()?.is_some() {
            return Ok(());
        }
        let pid = Pid::from_child(&self.child);
        kill_process(pid, Signal::TERM).context("cannot stop the demo's daemon")?;
        let deadline = Instant::now() + STOP_TIMEOUT;
        while Instant::now() < deadline {
            if self.child.try_wait()?.is_some() {
                return Ok(());
            }
            thread::sleep(Duration::from_millis(5));
        }
        self.child.kill()?;
        self.child.wait()?;
        let limit_s = STOP_TIMEOUT.as_secs();
        bail!(self.explained(&format!(
            "the demo's daemon did not end within {limit_s} s of SIGTERM and was killed"
        )))
    }
}

impl Drop for DemoDaemon {
    fn drop(&mut self) {
        if let Err(error) = self.stop() {
            tell!("warning: {error:#}");
        }
    }
}

/// The error that a program ended with, as far as it wrote one into its log; then what happened, and the warnings
/// before it. Lines of a good run are left out.
pub(super) fn explained(what: &str, log: &Path) -> String {
    let log = fs::read_to_string(log).unwrap_or_default();
    let lines = log.lines().filter(|line| !line.contains("Z  INFO "));
    let (warnings, error): (Vec<_>, Vec<_>) =
        lines.partition(|line| line.contains("Z  WARN ") || line.contains("Z ERROR "));
    [error, vec![what], warnings].concat().join("\n")
}

fn is_running(connection: &Connection) -> bool {
    connection
        .status(Duration::from_secs(1))
        .is_ok_and(|status| status.mode != Mode::Starting.code())
}

/// A program in the folder of this one.
pub(super) fn beside_ourselves(name: &str) -> anyhow::Result<PathBuf> {
    let ourselves = std::env::current_exe().context("cannot determine the folder of cdcrctl")?;
    let program = ourselves.with_file_name(name);
    if !program.exists() {
        bail!(
            "{} does not exist: the demo needs {name} beside cdcrctl; build both with \
             cargo build --release",
            program.display()
        );
    }
    Ok(program)
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    #[test]
    fn the_reason_comes_first() {
        let folder = Scratch::temporary().expect("a folder");
        let log = folder.path().join("log");
        let text = "2026-01-01T00:00:00.000001Z  INFO running robot=\"demo\"\n\
                    2026-01-01T00:00:00.000002Z  WARN late: platform\n\
                    cdcrd: shared memory is full\nfree some\n";
        fs::write(&log, text).expect("written");
        assert_eq!(
            explained("it ended", &log),
            "cdcrd: shared memory is full\nfree some\nit ended\n\
             2026-01-01T00:00:00.000002Z  WARN late: platform"
        );
        assert_eq!(
            explained("it ended", &folder.path().join("none")),
            "it ended"
        );
    }
}
