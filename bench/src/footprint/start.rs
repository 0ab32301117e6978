//! How long a daemon takes from its process to its robot.

use std::cell::Cell;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use cdcr_client::{Connection, monotonic_ns};
use serde::Serialize;
use tempfile::TempDir;

use crate::interrupt;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::place::ROBOT;
use crate::system::cores::Cores;

const TIMEOUT: Duration = Duration::from_secs(10);
/// How often a client looks whether there is a daemon.
const LOOK_EVERY: Duration = Duration::from_millis(1);

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Start {
    /// To the first release of its grid \[ms\].
    pub first_release_ms: f64,
    /// To what it tells a service manager after its first good cycle (`READY=1`) \[ms\].
    pub ready_ms: f64,
    /// To the first record in the hands of a client that looks for the daemon each millisecond \[ms\].
    pub first_record_ms: f64,
}

impl Start {
    /// Starts a daemon that a client looks for from the beginning, measures how long that takes, and ends it.
    pub(super) fn measure(launch: &Launch, cores: &Cores) -> Result<Self> {
        let (daemon, manager, begin_ns) = spawn(launch, cores)?;
        let found = first_record(&daemon).and_then(|found| Ok((found, manager.ready_ns()?)));
        let (found, ready_ns) = found.map_err(|error| with_stderr_tail(error, &daemon))?;
        daemon.stop()?;
        let since_ms = |time_ns: u64| time_ns.saturating_sub(begin_ns) as f64 * 1e-6;
        Ok(Self {
            first_release_ms: since_ms(found.release_ns),
            ready_ms: since_ms(ready_ns),
            first_record_ms: since_ms(found.record_ns),
        })
    }
}

/// Starts a daemon and waits for its `READY=1`: no client has connected yet.
pub(super) fn without_client(launch: &Launch, cores: &Cores) -> Result<Daemon> {
    let (daemon, manager, _) = spawn(launch, cores)?;
    match manager.ready_ns() {
        Ok(_) => Ok(daemon),
        Err(error) => Err(with_stderr_tail(error, &daemon)),
    }
}

/// A daemon under a service manager, and when its start began \[ns\].
fn spawn(launch: &Launch, cores: &Cores) -> Result<(Daemon, Manager, u64)> {
    let folder = tempfile::Builder::new().prefix("cdcr-bench-").tempdir();
    let folder = folder.context("a folder for temporary files")?;
    let path = folder.path().join("notify");
    let manager = Manager::listen(&path, folder)?;
    let begin_ns = Cell::new(0);
    let daemon = Daemon::start_with(launch, cores, |command| {
        command.env("NOTIFY_SOCKET", path);
        begin_ns.set(monotonic_ns());
    })?;
    Ok((daemon, manager, begin_ns.get()))
}

fn with_stderr_tail(error: anyhow::Error, daemon: &Daemon) -> anyhow::Error {
    let words = daemon.stderr_tail();
    error.context(format!("the daemon does not start{words}"))
}

struct Found {
    /// When the first cycle of the daemon was released \[ns\].
    release_ns: u64,
    record_ns: u64,
}

/// Looks for the daemon until it is there.
fn first_record(daemon: &Daemon) -> Result<Found> {
    let deadline = Instant::now() + TIMEOUT;
    let connection = loop {
        interrupt::check()?;
        match Connection::open(daemon.location(), ROBOT) {
            Ok(connection) => break connection,
            Err(error) if Instant::now() >= deadline => return Err(error.into()),
            Err(_) => std::thread::sleep(LOOK_EVERY),
        }
    };
    let record = connection.telemetry()?.next_within(TIMEOUT)?;
    record.context("it sends no record")?;
    let record_ns = monotonic_ns();
    let status = connection.status(TIMEOUT)?;
    Ok(Found {
        release_ns: status.origin_ns + status.period_ns,
        record_ns,
    })
}

/// A service manager that waits for a `READY=1`.
struct Manager {
    _folder: TempDir,
    thread: JoinHandle<Result<u64>>,
}

impl Manager {
    fn listen(path: &Path, folder: TempDir) -> Result<Self> {
        let socket = UnixDatagram::bind(path)
            .with_context(|| format!("cannot listen at {}", path.display()))?;
        socket.set_read_timeout(Some(Duration::from_millis(100)))?;
        let thread = std::thread::spawn(move || hear(&socket));
        Ok(Self {
            _folder: folder,
            thread,
        })
    }

    fn ready_ns(self) -> Result<u64> {
        let heard = self.thread.join();
        heard.map_err(|_| anyhow!("the service manager panicked"))?
    }
}

fn hear(socket: &UnixDatagram) -> Result<u64> {
    let deadline = Instant::now() + TIMEOUT;
    let mut message = [0; 4096];
    while Instant::now() < deadline {
        interrupt::check()?;
        // Nothing came: a look at the clock, and again.
        let Ok(length) = socket.recv(&mut message) else {
            continue;
        };
        if says_ready(&message[..length]) {
            return Ok(monotonic_ns());
        }
    }
    bail!("it did not say READY=1 within {} s", TIMEOUT.as_secs())
}

/// Whether one of the lines is `READY=1` (`sd_notify(3)`).
fn says_ready(message: &[u8]) -> bool {
    message
        .split(|byte| *byte == b'\n')
        .any(|line| line == b"READY=1")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ready_is_a_line_of_its_own() {
        assert!(says_ready(b"READY=1"));
        assert!(says_ready(b"STATUS=holding\nREADY=1\nMAINPID=7"));
        assert!(!says_ready(b"STATUS=READY=1"));
        assert!(!says_ready(b"READY=0"));
    }
}
