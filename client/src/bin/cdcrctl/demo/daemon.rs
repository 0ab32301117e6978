use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use anyhow::{Context, anyhow, ensure};
use cdcr_client::{Connection, STATUS_TIMEOUT};
use cdcr_process::{PlacedDaemon, PrivatePlace, program};
use cdcr_shared_types::Location;

use crate::interrupt::Interrupt;

/// Timeout for the start of the daemon.
const START_TIMEOUT: Duration = Duration::from_secs(10);
const ROBOT: &str = "demo";

/// Writes the configuration of the demo into its place.
pub(super) fn write_configuration(place: &PrivatePlace, text: &str) -> anyhow::Result<PathBuf> {
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

/// Fails when the demo is interrupted.
pub(super) fn undisturbed(interrupt: &Interrupt) -> anyhow::Result<()> {
    ensure!(!interrupt.is_raised(), "interrupted");
    Ok(())
}

/// The daemon of the demo.
pub(super) struct DemoDaemon(PlacedDaemon);

impl DemoDaemon {
    pub(super) fn start(place: PrivatePlace, config: &Path) -> anyhow::Result<Self> {
        let run = cdcrd("run", config)?;
        Ok(Self(PlacedDaemon::start(place, ROBOT, run)?))
    }

    /// Waits until the daemon controls its robot. `None`: interrupted.
    pub(super) fn connect(&mut self, interrupt: &Interrupt) -> anyhow::Result<Option<Connection>> {
        let connect = |location: &Location| {
            let connection = Connection::open(location, ROBOT)?;
            let status = connection.status(STATUS_TIMEOUT)?;
            Ok((connection, status))
        };
        let check = || undisturbed(interrupt);
        let ready = self.0.when_ready(START_TIMEOUT, check, connect);
        if interrupt.is_raised() {
            return Ok(None);
        }
        let explained = |cause| anyhow!(self.explained(&format!("{cause:#}")));
        ready.map(Some).map_err(explained)
    }

    /// Appends the daemon's log to an error text.
    pub(super) fn explained(&self, what: &str) -> String {
        explained(what, &self.0.process.stderr())
    }

    /// Stops the daemon and waits for its end.
    pub(super) fn stop(&mut self) -> anyhow::Result<()> {
        self.0.process.end()
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
