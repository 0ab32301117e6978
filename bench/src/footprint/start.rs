//! How long a daemon takes from its process to its robot.

use std::cell::Cell;
use std::os::unix::net::UnixDatagram;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, ensure};
use cdcr_client::{Connection, TelemetryStream, monotonic_ns};
use cdcr_scratch::Scratch;
use serde_json::{Value, json};

use crate::interrupt;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::place::ROBOT;
use crate::system::cores::Cores;

const TIMEOUT: Duration = Duration::from_secs(10);
/// The pause of a client between two looks whether there is a daemon.
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
        // To the first record in the hands of a client that pauses for a millisecond between two looks for the daemon.
        "first_record_ms": since_ms(record_ns),
    }))
}

/// Starts a daemon and waits for its `READY=1`: no client has connected yet.
pub(super) fn without_client(launch: &Launch, cores: &Cores) -> Result<Daemon> {
    Ok(start(launch, cores, |_| Ok(true))?.0)
}

#[derive(Default)]
struct Client {
    connection: Option<Connection>,
    telemetry: Option<TelemetryStream>,
    record_ns: u64,
}

impl Client {
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
    // In a thread of its own: a look of the client may last longer than what is measured.
    let heard = thread::spawn(move || hear_ready(&manager));
    let late = |missing: &str| {
        let words = daemon.stderr_tail();
        format!("the daemon does not start: no {missing} within {TIMEOUT:?}{words}")
    };
    let deadline = Instant::now() + TIMEOUT;
    while !has_served(&daemon)? {
        interrupt::check()?;
        ensure!(Instant::now() < deadline, late("record"));
        thread::sleep(LOOK_EVERY);
    }
    let heard = heard.join();
    let ready_ns = heard.map_err(|_| anyhow!("the service manager panicked"))??;
    let ready_ns = ready_ns.with_context(|| late("READY=1"))?;
    Ok((daemon, begin_ns.get(), ready_ns))
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
