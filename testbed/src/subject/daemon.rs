//! The measured daemon: the real `cdcrd`, started as a process.

use std::fmt::Display;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use anyhow::{Result, bail, ensure};
use cdcr_client::Connection;
use cdcr_process::{PlacedDaemon, PrivatePlace, program};
use cdcr_shared_types::Location;
use derive_more::Deref;

use super::{ROBOT, TIMEOUT};
use crate::interrupt;
use crate::system::cores::Cores;

/// Keys of a configuration, before its tables: on a machine that stalls, no deadline miss stops the robot, and no lease
/// of the reference expires.
pub const STALL_TOLERANT: &str = "cycle.miss_limit = 1000000\nreference.lease_ms = 60000.0\n";

#[derive(Debug, Clone, Default)]
pub struct Launch {
    /// Configuration file; `None` for the default.
    pub config: Option<PathBuf>,
    /// Keys set in addition to the file; later ones win.
    pub settings: Vec<(String, String)>,
}

impl Launch {
    /// The default or the given file, with [`STALL_TOLERANT`], and commands that stay valid for a stall.
    pub fn stall_tolerant(config: Option<PathBuf>) -> Self {
        let launch = Self {
            config,
            settings: Vec::new(),
        };
        let keys = STALL_TOLERANT
            .lines()
            .filter_map(|line| line.split_once(" = "));
        keys.fold(launch, |launch, (key, value)| launch.with(key, value))
            .with("link.command_valid_ms", 100)
    }

    /// Sets one more key, like `cycle.period_ms`.
    #[must_use]
    pub fn with(mut self, key: &str, value: impl Display) -> Self {
        self.settings.push((key.to_owned(), value.to_string()));
        self
    }

    /// Sets one more key where there is a value for it.
    #[must_use]
    pub fn with_some(self, key: &str, value: Option<impl Display>) -> Self {
        match value {
            Some(value) => self.with(key, value),
            None => self,
        }
    }

    /// Sets the period \[ms\]. Gather lead and late-start limit keep their defaults unless the period is too short:
    /// the gather must fit between two cycles.
    #[must_use]
    pub fn with_period(self, period_ms: f64) -> Self {
        self.with("cycle.period_ms", period_ms)
            .with("cycle.gather_lead_ms", (0.35 * period_ms).min(0.2))
            .with("cycle.late_start_ms", period_ms.min(1.0))
    }

    /// Places the daemon on the real-time core of `cores`, or switches real time off.
    #[must_use]
    pub fn placed(self, cores: &Cores, realtime: bool) -> Self {
        let mode = if realtime { "prefer" } else { "off" };
        self.with("realtime.mode", mode)
            .with("realtime.core", cores.realtime)
    }

    /// `cdcrd SUBCOMMAND` with this configuration, independent of the environment.
    pub fn command(&self, subcommand: &str) -> Result<Command> {
        let mut command = Command::new(program("cdcrd")?);
        for (name, _) in std::env::vars_os() {
            if name.to_string_lossy().starts_with("CDCR_") {
                command.env_remove(name);
            }
        }
        // A service manager of the bench must get no messages of the daemon.
        for name in ["NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"] {
            command.env_remove(name);
        }
        command.arg(subcommand);
        if let Some(config) = &self.config {
            command.arg("--config").arg(config);
        }
        for (key, value) in &self.settings {
            command.arg("--set").arg(format!("{key}={value}"));
        }
        Ok(command)
    }

    /// For a subcommand that keeps running: its process ends when this process ends, even by SIGKILL.
    pub(super) fn command_that_ends_with_us(&self, subcommand: &str) -> Result<Command> {
        let mut command = self.command(subcommand)?;
        command.args(["--end-with-parent", &std::process::id().to_string()]);
        Ok(command)
    }
}

/// A running daemon. Dropping it stops the daemon and removes all of its files.
#[derive(Debug, Deref)]
pub struct Daemon(PlacedDaemon);

impl Daemon {
    /// Starts a daemon and waits until it controls its robot. Call it from a thread that outlives the daemon.
    pub fn start(launch: &Launch, cores: &Cores) -> Result<Self> {
        Self::start_with(launch, cores, |_| ())?.when_ready()
    }

    /// Starts a daemon without waiting. `change` may modify the command.
    pub fn start_with(
        launch: &Launch,
        cores: &Cores,
        change: impl FnOnce(&mut Command),
    ) -> Result<Self> {
        let place = PrivatePlace::new()?;
        let mut command = launch.command_that_ends_with_us("run")?;
        change(&mut command);
        let placed = cores.with_all(|| PlacedDaemon::start(place, ROBOT, command))?;
        Ok(Self(placed))
    }

    /// Waits until the daemon controls its robot or, with a driver, waits for a first measurement.
    pub fn when_ready(mut self) -> Result<Self> {
        let connect = |location: &Location| {
            let connection = Connection::open(location, ROBOT)?;
            Ok(((), connection.status(Duration::from_secs(1))?))
        };
        let ready = self.0.when_ready(TIMEOUT, interrupt::check, connect);
        ready.or_else(|cause| {
            interrupt::check()?;
            bail!("{cause:#}{}", self.process.output_tail())
        })?;
        Ok(self)
    }

    pub fn connect(&self) -> Result<Connection> {
        Ok(Connection::open_within(
            self.place.location(),
            ROBOT,
            TIMEOUT,
        )?)
    }

    pub fn stop(mut self) -> Result<()> {
        ensure!(
            !self.0.process.has_ended()?,
            "the daemon ended by itself{}",
            self.process.output_tail()
        );
        self.0.process.end()
    }
}
