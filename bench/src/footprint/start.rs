//! How long a daemon takes from its process to its robot.

use std::cell::Cell;
use std::os::unix::net::UnixDatagram;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, ensure};
use cdcr_client::{Connection, monotonic_ns};
use cdcr_scratch::Scratch;
use serde_json::{Value, json};

use crate::interrupt;
use crate::subject::TIMEOUT;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::place::ROBOT;
use crate::system::cores::Cores;

/// The pause of a client between two looks whether there is a daemon.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// Starts a daemon that a client looks for from the beginning, measures how long that takes from the start of the
/// process, and ends it.
pub(super) fn times(launch: &Launch, cores: &Cores) -> Result<Value> {
    let started = Started::new(launch, cores)?;
    let location = started.daemon.location();
    let connection = started.until(|| Ok(Connection::open(location, ROBOT).ok()))?;
    let mut telemetry = connection.telemetry()?;
    started.until(|| Ok(telemetry.try_next()?))?;
    let (record_ns, begin_ns) = (monotonic_ns(), started.begin_ns);
    let (daemon, ready_ns) = started.ready()?;
    let status = connection.status(TIMEOUT)?;
    drop((telemetry, connection));
    daemon.stop()?;
    let since_ms = |time_ns: u64| time_ns.saturating_sub(begin_ns) as f64 * 1e-6;
    Ok(json!({
        // To the first release of its grid.
        "first_release_ms": since_ms(status.origin_ns + status.period_ns),
        // To what it tells a service manager after its first good cycle (`READY=1`).
        "ready_ms": since_ms(ready_ns),
        // To the first record in the hands of a client that pauses for a millisecond between two looks for the daemon.
        "first_record_ms": since_ms(record_ns),
    }))
}

/// Starts a daemon and waits for its `READY=1`: no client has connected yet.
pub(super) fn without_client(launch: &Launch, cores: &Cores) -> Result<Daemon> {
    Ok(Started::new(launch, cores)?.ready()?.0)
}

/// A daemon under a service manager.
struct Started {
    daemon: Daemon,
    /// When its start began \[ns\].
    begin_ns: u64,
    deadline: Instant,
    /// In a thread of its own: a look of a client may last longer than what is measured.
    manager: JoinHandle<Result<Option<u64>>>,
    _folder: Scratch,
}

impl Started {
    fn new(launch: &Launch, cores: &Cores) -> Result<Self> {
        let folder = Scratch::temporary();
        let folder = folder.context("a folder for temporary files")?;
        let path = folder.path().join("notify");
        let manager = UnixDatagram::bind(&path).context("a socket for READY=1")?;
        manager.set_read_timeout(Some(Duration::from_millis(100)))?;
        let begin_ns = Cell::new(0);
        let daemon = Daemon::start_with(launch, cores, |command| {
            command.env("NOTIFY_SOCKET", path);
            begin_ns.set(monotonic_ns());
        })?;
        Ok(Self {
            daemon,
            begin_ns: begin_ns.get(),
            deadline: Instant::now() + TIMEOUT,
            manager: thread::spawn(move || hear_ready(&manager)),
            _folder: folder,
        })
    }

    /// Looks for what a client waits for.
    fn until<T>(&self, mut look: impl FnMut() -> Result<Option<T>>) -> Result<T> {
        loop {
            if let Some(found) = look()? {
                return Ok(found);
            }
            interrupt::check()?;
            let in_time = Instant::now() < self.deadline;
            ensure!(in_time, late(&self.daemon, "record"));
            thread::sleep(LOOK_EVERY);
        }
    }

    /// The daemon, and when it said `READY=1` \[ns\].
    fn ready(self) -> Result<(Daemon, u64)> {
        let heard = self.manager.join();
        let ready_ns = heard.map_err(|_| anyhow!("the service manager panicked"))??;
        let ready_ns = ready_ns.with_context(|| late(&self.daemon, "READY=1"))?;
        Ok((self.daemon, ready_ns))
    }
}

fn late(daemon: &Daemon, missing: &str) -> String {
    let words = daemon.stderr_tail();
    format!("the daemon does not start: no {missing} within {TIMEOUT:?}{words}")
}

/// When `READY=1` came \[ns\]; none within the time that a daemon may take.
fn hear_ready(manager: &UnixDatagram) -> Result<Option<u64>> {
    let deadline = Instant::now() + TIMEOUT;
    let mut message = [0; 4096];
    while Instant::now() < deadline {
        interrupt::check()?;
        let received = manager.recv(&mut message);
        let now_ns = monotonic_ns();
        if received.is_ok_and(|length| says_ready(&message[..length])) {
            return Ok(Some(now_ns));
        }
    }
    Ok(None)
}

/// Whether one of the lines is `READY=1` (`sd_notify(3)`).
fn says_ready(message: &[u8]) -> bool {
    let mut lines = message.split(|byte| *byte == b'\n');
    lines.any(|line| line == b"READY=1")
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
