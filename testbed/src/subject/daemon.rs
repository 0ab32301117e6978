//! The measured daemon: the real `cdcrd`, started as a process.

use std::fmt::Display;
use std::path::PathBuf;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use cdcr_client::Connection;
use cdcr_process::{Place, Process, program};
use cdcr_shared_types::Location;
use cdcr_shared_types::codes::Mode;

use super::{ROBOT, TIMEOUT};
use crate::interrupt;
use crate::system::cores::Cores;

/// Configuration keys that a measurement needs: on a machine that stalls, the robot must not stop or hold for
/// lack of inputs, nor may the lease of the reference expire.
pub const STALL_TOLERANT: [(&str, &str); 3] = [
    ("link.command_valid_ms", "100"),
    ("cycle.miss_limit", "1000000"),
    ("reference.lease_ms", "60000"),
];

#[derive(Debug, Clone, Default)]
pub struct Launch {
    /// Configuration file; `None` for the default.
    pub config: Option<PathBuf>,
    /// Keys set in addition to the file; later ones win.
    pub settings: Vec<(String, String)>,
}

impl Launch {
    /// The default or the given file, with [`STALL_TOLERANT`].
    pub fn stall_tolerant(config: Option<PathBuf>) -> Self {
        let launch = Self {
            config,
            settings: Vec::new(),
        };
        STALL_TOLERANT
            .iter()
            .fold(launch, |launch, (key, value)| launch.with(key, value))
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
#[derive(Debug)]
pub struct Daemon {
    /// Declared before the place, so that the process ends before its files are removed.
    process: Process,
    place: Place,
    pub launch: Launch,
}

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
        let place = Place::new()?;
        let mut command = launch.command_that_ends_with_us("run")?;
        command
            .args(["--robot", ROBOT, "--prefix", place.location().prefix()])
            .arg("--root")
            .arg(place.location().root());
        change(&mut command);
        Ok(Self {
            process: cores.with_all(|| Process::start("cdcrd", command))?,
            place,
            launch: launch.clone(),
        })
    }

    /// Waits until the daemon controls its robot or, with a driver, waits for a first measurement.
    pub fn when_ready(mut self) -> Result<Self> {
        let deadline = Instant::now() + TIMEOUT;
        let mut last = "it did not start to control its robot".to_owned();
        while Instant::now() < deadline {
            interrupt::check()?;
            ensure!(
                !self.process.has_ended()?,
                "the daemon ended at once{}",
                self.output_tail()
            );
            match self.connect() {
                Ok(connection) if is_ready(&connection) => return Ok(self),
                Ok(_) => {}
                Err(cause) => last = cause.to_string(),
            }
            thread::sleep(Duration::from_millis(10));
        }
        bail!(
            "the daemon was not ready within {} s: {last}{}",
            TIMEOUT.as_secs(),
            self.output_tail()
        )
    }

    pub fn location(&self) -> &Location {
        self.place.location()
    }

    pub fn place(&self) -> &Place {
        &self.place
    }

    pub fn id(&self) -> u32 {
        self.process.id()
    }

    pub fn connect(&self) -> Result<Connection> {
        Ok(Connection::open_within(self.location(), ROBOT, TIMEOUT)?)
    }

    pub fn stop(mut self) -> Result<()> {
        ensure!(
            !self.process.has_ended()?,
            "the daemon ended by itself{}",
            self.output_tail()
        );
        self.process.end()
    }

    pub fn output_tail(&self) -> String {
        self.process.output_tail()
    }
}

fn is_ready(connection: &Connection) -> bool {
    connection
        .status(Duration::from_secs(1))
        .is_ok_and(|status| {
            let driven = status.link == cdcr_shared_types::codes::RobotLink::Driver.code();
            driven || status.mode != Mode::Starting.code()
        })
}
