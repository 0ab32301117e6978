//! A daemon as a process in a private place.

use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use cdcr_shared_types::codes::{Mode, RobotLink};
use cdcr_shared_types::{Location, Status};

use super::{POLL_INTERVAL, PrivatePlace, Process};

/// A running daemon. Dropping it stops the daemon and removes all of its files.
#[derive(Debug)]
pub struct PlacedDaemon {
    /// Declared before the place, so that the process ends before its files are removed.
    pub process: Process,
    pub place: PrivatePlace,
}

impl PlacedDaemon {
    /// Starts `cdcrd run` without waiting. The command has neither robot nor place yet.
    pub fn start(place: PrivatePlace, robot: &str, mut run: Command) -> Result<Self> {
        run.args(["--robot", robot, "--prefix", place.location().prefix()])
            .arg("--root")
            .arg(place.location().root());
        Ok(Self {
            process: Process::start("cdcrd", run)?,
            place,
        })
    }

    /// Calls `connect` until the daemon is ready: it controls its robot or, with a driver, waits for a first
    /// measurement. Fails after `limit`, when the daemon ends, or when `check` fails.
    pub fn when_ready<C>(
        &mut self,
        limit: Duration,
        check: impl Fn() -> Result<()>,
        connect: impl Fn(&Location) -> Result<(C, Status)>,
    ) -> Result<C> {
        let deadline = Instant::now() + limit;
        let is_ready = |status: &Status| {
            let is_driven = status.link == RobotLink::Driver.code();
            is_driven || status.mode != Mode::Starting.code()
        };
        let mut last = "it did not start to control its robot".to_owned();
        while Instant::now() < deadline {
            check()?;
            if self.process.has_ended()? {
                bail!("the daemon ended at once");
            }
            match connect(self.place.location()) {
                Ok((client, status)) if is_ready(&status) => return Ok(client),
                Ok(_) => {}
                Err(cause) => last = cause.to_string(),
            }
            thread::sleep(POLL_INTERVAL);
        }
        let seconds = limit.as_secs();
        bail!("the daemon was not ready within {seconds} s: {last}")
    }
}
