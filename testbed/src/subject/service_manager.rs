//! A service manager in the place of systemd: receives the messages of a daemon, `sd_notify(3)`.

use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::Command;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use cdcr_client::monotonic_ns;
use cdcr_scratch::Scratch;

use super::TIMEOUT;
use super::daemon::{Daemon, Launch};
use crate::interrupt;
use crate::system::cores::Cores;

const LINE: &str = "READY=1";
/// Longest wait for one message.
const WAIT: Duration = Duration::from_millis(10);

#[derive(Debug)]
pub struct ServiceManager {
    socket: UnixDatagram,
    path: PathBuf,
}

impl ServiceManager {
    /// Listens at a new socket.
    pub fn listen(path: PathBuf) -> Result<Self> {
        let socket = UnixDatagram::bind(&path).context("a socket for a service manager")?;
        socket.set_read_timeout(Some(WAIT))?;
        Ok(Self { socket, path })
    }

    /// Makes it the manager of the process that the command starts.
    pub fn manage<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command.env("NOTIFY_SOCKET", &self.path)
    }

    /// The lines of the next message; none if it does not come within 10 ms.
    pub fn hear(&self) -> Vec<String> {
        let mut message = [0; 4096];
        let length = self.socket.recv(&mut message).unwrap_or(0);
        let text = String::from_utf8_lossy(&message[..length]).into_owned();
        text.lines().map(str::to_owned).collect()
    }

    fn ready_ns(&self) -> Result<Option<u64>> {
        let deadline = Instant::now() + TIMEOUT;
        while Instant::now() < deadline {
            interrupt::check()?;
            if self.hear().iter().any(|line| line == LINE) {
                return Ok(Some(monotonic_ns()));
            }
        }
        Ok(None)
    }
}

/// A start of a daemon, heard on a separate thread: one poll of a client may last longer than the start.
#[derive(Debug)]
pub struct ManagedStart {
    /// Time at which the process was started.
    pub begin_ns: u64,
    ready_ns: JoinHandle<Result<Option<u64>>>,
}

impl ManagedStart {
    /// Starts a daemon without waiting.
    pub fn begin(launch: &Launch, cores: &Cores) -> Result<(Daemon, Self)> {
        let folder = Scratch::temporary().context("a folder for temporary files")?;
        let manager = ServiceManager::listen(folder.path().join("notify"))?;
        let mut begin_ns = 0;
        let daemon = Daemon::start_with(launch, cores, |command| {
            manager.manage(command);
            begin_ns = monotonic_ns();
        })?;
        let ready_ns = std::thread::spawn(move || {
            let _folder = folder;
            manager.ready_ns()
        });
        Ok((daemon, Self { begin_ns, ready_ns }))
    }

    /// Time of the message after the first good cycle (`READY=1`); `None` without one.
    pub fn ready_ns(self) -> Result<Option<u64>> {
        let heard = self.ready_ns.join();
        heard.map_err(|_| anyhow!("the service manager panicked"))?
    }
}
