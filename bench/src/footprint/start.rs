//! How long a daemon takes from its process to its robot.

use std::cell::Cell;
use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use cdcr_client::{Connection, TelemetryStream, monotonic_ns};
use serde_json::{Value, json};

use crate::interrupt;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::place::ROBOT;
use crate::system::cores::Cores;

const TIMEOUT: Duration = Duration::from_secs(10);
/// How often a client looks whether there is a daemon.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// Starts a daemon that a client looks for from the beginning, measures how long that takes from the start of the
/// process, and ends it.
pub(super) fn times(launch: &Launch, cores: &Cores) -> Result<Value> {
    let mut client = Client::default();
    let (daemon, begin_ns, ready_ns) = start(launch, cores, |daemon| client.looks(daemon))?;
    let Client {
        connection,
        telemetry,
        record_ns,
    } = client;
    let status = connection.context("the client is gone")?.status(TIMEOUT)?;
    drop(telemetry);
    daemon.stop()?;
    let since_ms = |time_ns: u64| time_ns.saturating_sub(begin_ns) as f64 * 1e-6;
    Ok(json!({
        // To the first release of its grid.
        "first_release_ms": since_ms(status.origin_ns + status.period_ns),
        // To what it tells a service manager after its first good cycle (`READY=1`).
        "ready_ms": since_ms(ready_ns),
        // To the first record in the hands of a client that looks for the daemon each millisecond.
        "first_record_ms": since_ms(record_ns),
    }))
}

/// Starts a daemon and waits for its `READY=1`: no client has connected yet.
pub(super) fn without_client(launch: &Launch, cores: &Cores) -> Result<Daemon> {
    Ok(start(launch, cores, |_| Ok(true))?.0)
}

/// A client that waits for the first record of a daemon.
#[derive(Default)]
struct Client {
    connection: Option<Connection>,
    telemetry: Option<TelemetryStream>,
    record_ns: u64,
}

impl Client {
    /// Whether it has seen a record.
    fn looks(&mut self, daemon: &Daemon) -> Result<bool> {
        if self.record_ns > 0 {
            return Ok(true);
        }
        if self.connection.is_none() {
            self.connection = Connection::open(daemon.location(), ROBOT).ok();
        }
        if let (Some(connection), None) = (&self.connection, &self.telemetry) {
            self.telemetry = Some(connection.telemetry()?);
        }
        if let Some(telemetry) = &mut self.telemetry
            && telemetry.try_next()?.is_some()
        {
            self.record_ns = monotonic_ns();
        }
        Ok(self.record_ns > 0)
    }
}

/// A daemon under a service manager, that has said `READY=1` and done for a client what that waits for; when its start
/// began, and when it was ready \[ns\].
fn start(
    launch: &Launch,
    cores: &Cores,
    mut has_served: impl FnMut(&Daemon) -> Result<bool>,
) -> Result<(Daemon, u64, u64)> {
    let folder = tempfile::Builder::new().prefix("cdcr-bench-").tempdir();
    let folder = folder.context("a folder for temporary files")?;
    let path = folder.path().join("notify");
    let manager = UnixDatagram::bind(&path).context("a socket for READY=1")?;
    // Waiting for the message is the pause between two looks of the client.
    manager.set_read_timeout(Some(LOOK_EVERY))?;
    let begin_ns = Cell::new(0);
    let daemon = Daemon::start_with(launch, cores, |command| {
        command.env("NOTIFY_SOCKET", path);
        begin_ns.set(monotonic_ns());
    })?;
    let deadline = Instant::now() + TIMEOUT;
    let (mut ready_ns, mut is_served, mut message) = (0, false, [0; 4096]);
    while ready_ns == 0 || !is_served {
        interrupt::check()?;
        let missing = if ready_ns == 0 { "READY=1" } else { "a record" };
        ensure!(
            Instant::now() < deadline,
            "the daemon does not start: no {missing} within {TIMEOUT:?}{}",
            daemon.stderr_tail()
        );
        if let Ok(length) = manager.recv(&mut message)
            && ready_ns == 0
            && says_ready(&message[..length])
        {
            ready_ns = monotonic_ns();
        }
        is_served = has_served(&daemon)?;
    }
    Ok((daemon, begin_ns.get(), ready_ns))
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
