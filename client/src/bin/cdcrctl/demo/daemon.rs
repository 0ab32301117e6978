use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use std::{fs, thread};

use anyhow::{Context, bail};
use cdcr_client::Connection;
use cdcr_process::{Place, Process, program};
use cdcr_shared_types::codes::Mode;

use crate::interrupt::Interrupt;

/// Timeout for the start of the daemon.
const START_TIMEOUT: Duration = Duration::from_secs(10);
const ROBOT: &str = "demo";

/// Writes the configuration of the demo into its place.
pub(super) fn write_configuration(place: &Place, text: &str) -> anyhow::Result<PathBuf> {
    let file = place.folder().join("demo.toml");
    fs::write(&file, text).with_context(|| {
        format!(
            "cannot write {}: set TMPDIR to a folder with free space",
            file.display()
        )
    })?;
    Ok(file)
}

/// `cdcrd SUBCOMMAND` with this configuration, from the folder of this program. It ends with this process,
/// even after SIGKILL.
pub(super) fn cdcrd(subcommand: &str, config: &Path) -> anyhow::Result<Command> {
    let mut command = Command::new(program("cdcrd")?);
    let ourselves = std::process::id().to_string();
    command.args([subcommand, "--end-with-parent", &ourselves]);
    command.arg("--config").arg(config);
    Ok(command)
}

/// A daemon in a private place. Dropping it stops the daemon and removes all files.
pub(super) struct DemoDaemon {
    /// Declared before its place, so that it ends first.
    process: Process,
    place: Place,
}

impl DemoDaemon {
    pub(super) fn start(place: Place, config: &Path) -> anyhow::Result<Self> {
        let mut command = cdcrd("run", config)?;
        command
            .args(["--robot", ROBOT, "--prefix", place.location().prefix()])
            .arg("--root")
            .arg(place.location().root());
        let process = Process::start("the demo's cdcrd", command)?;
        Ok(Self { process, place })
    }

    /// Waits until the daemon controls its robot. `None`: interrupted.
    pub(super) fn connect(&mut self, interrupt: &Interrupt) -> anyhow::Result<Option<Connection>> {
        let deadline = Instant::now() + START_TIMEOUT;
        let mut last = "it did not start to control its robot".to_owned();
        while Instant::now() < deadline {
            if interrupt.is_raised() {
                return Ok(None);
            }
            if self.process.has_ended()? {
                bail!(self.explained("the demo's daemon ended at once"));
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

    /// Appends the daemon's log to an error text.
    pub(super) fn explained(&self, what: &str) -> String {
        explained(what, &self.process.stderr())
    }

    /// Stops the daemon and waits for its end.
    pub(super) fn stop(&mut self) -> anyhow::Result<()> {
        self.process.end()
    }
}

/// The error that ended the program, if its log has one, then `what`, and the warnings before it. Normal log
/// lines are omitted.
fn explained(what: &str, log: &str) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reason_comes_first() {
        let log = "2026-01-01T00:00:00.000001Z  INFO running robot=\"demo\"\n\
                   2026-01-01T00:00:00.000002Z  WARN late: platform\n\
                   cdcrd: shared memory is full\nfree some\n";
        assert_eq!(
            explained("it ended", log),
            "cdcrd: shared memory is full\nfree some\nit ended\n\
             2026-01-01T00:00:00.000002Z  WARN late: platform"
        );
        assert_eq!(explained("it ended", ""), "it ended");
    }
}
