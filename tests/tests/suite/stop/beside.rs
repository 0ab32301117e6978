//! Conditions that could prevent a stop.

use std::io::PipeReader;
use std::os::fd::OwnedFd;
use std::os::unix::net::{UnixDatagram, UnixStream};

use cdcr_tests::threads::Hung;
use cdcr_tests::{Daemon, unread_pipe};
use rustix::fs::fstat;

use super::access::kill_a_victim;
use super::place::empty;
use crate::own_mounts::{Filled, has_own_mounts, mount, mount_memory};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Beside {
    Nothing,
    Crowd,
    DeadNodes,
    HungSupervisor,
    HungExchange,
    FullMemory,
    FewInodes,
    EmptiedRoot,
    /// A pipe that is not read.
    FullStderr,
    /// A journal that accepts nothing more.
    FullJournal,
}

/// Folder of the journal's socket.
const JOURNAL: &str = "/run/systemd/journal";

/// A condition that lasts until this is dropped.
pub(super) enum Obstruction {
    None,
    Thread(#[expect(dead_code, reason = "held")] Hung),
    Memory(#[expect(dead_code, reason = "held")] Filled),
}

/// The ends of a log that is not read.
pub(super) enum Unread {
    Nothing,
    Pipe(#[expect(dead_code, reason = "held")] PipeReader),
    Journal(
        #[expect(dead_code, reason = "held")] UnixDatagram,
        #[expect(dead_code, reason = "held")] UnixStream,
    ),
}

impl Beside {
    /// Whether the test of this name can continue here. If it needs private mounts, it runs in another
    /// process that has them.
    pub(super) fn is_ready(self, test: &str) -> bool {
        match self {
            Self::FullMemory => has_own_mounts(test) && mount_memory("size=128m"),
            Self::FewInodes => has_own_mounts(test) && mount_memory("size=128m,nr_inodes=1000"),
            Self::FullJournal => {
                let script = format!("mount -t tmpfs none /run && mkdir -p {JOURNAL}");
                has_own_mounts(test) && mount(&script)
            }
            _ => true,
        }
    }

    /// Slow enough that the robot still moves when the stop arrives. A hung exchange needs space for the
    /// records of one second.
    fn configuration(self) -> String {
        let period_ms = if self == Self::HungExchange {
            50.0
        } else {
            5.0
        };
        format!(
            "[cycle]\nperiod_ms = {period_ms:?}\nmiss_limit = 1000000\nwatchdog_ms = 20000.0\n\
             [reference]\nlease_ms = 60000.0\n[motion]\nhome_rate_rad_s = 0.1\n"
        )
    }

    pub(super) fn start(self, link: &str) -> (Daemon, Unread) {
        let configuration = format!("{}{link}", self.configuration());
        match self {
            Self::FullStderr => {
                let (reader, writer) = unread_pipe();
                let daemon = Daemon::start_with(&configuration, |command| {
                    command.stderr(writer);
                });
                (daemon, Unread::Pipe(reader))
            }
            Self::FullJournal => {
                let socket = format!("{JOURNAL}/socket");
                let _ = std::fs::remove_file(&socket);
                let journal = UnixDatagram::bind(&socket).unwrap();
                let filler = UnixDatagram::unbound().unwrap();
                filler.set_nonblocking(true).unwrap();
                while filler.send_to(b"MESSAGE=full\n", &socket).is_ok() {}
                let (theirs, ours) = UnixStream::pair().unwrap();
                let file = fstat(&theirs).unwrap();
                let daemon = Daemon::start_with(&configuration, |command| {
                    let stream = format!("{}:{}", file.st_dev, file.st_ino);
                    command.env("JOURNAL_STREAM", stream);
                    command.stderr(OwnedFd::from(theirs));
                });
                (daemon, Unread::Journal(journal, ours))
            }
            _ => (Daemon::start(&configuration), Unread::Nothing),
        }
    }

    /// Prepares a daemon before its first stop.
    pub(super) fn prepare(self, daemon: &Daemon, test: &str) {
        if self == Self::DeadNodes {
            kill_a_victim(daemon.place(), test);
        }
    }

    /// Creates the condition for the next stop. `None` if the system does not permit it.
    pub(super) fn obstruct(self, daemon: &Daemon) -> Option<Obstruction> {
        let hung = |name| Hung::new(daemon.id(), name).map(Obstruction::Thread);
        match self {
            Self::HungSupervisor => return hung("cdcrd"),
            Self::HungExchange => return hung("cdcr-exchange"),
            Self::FullMemory => return Some(Obstruction::Memory(Filled::but_kilobytes(0))),
            Self::FewInodes => return Some(Obstruction::Memory(Filled::but_files(0))),
            Self::EmptiedRoot => empty(daemon.place().location().root()),
            _ => {}
        }
        Some(Obstruction::None)
    }

    /// Reason, as printed, why a stop is sent only as a signal. `None`: the stop is confirmed.
    pub(super) fn unconfirmed(self) -> Option<&'static str> {
        match self {
            Self::FullMemory => Some("is full"),
            Self::FewInodes => Some("nr_inodes="),
            Self::HungExchange | Self::EmptiedRoot => Some("not confirmed"),
            _ => None,
        }
    }

    /// Whether floods occur in each mode even in a short run.
    pub(super) fn is_flooded_in_each_mode(self) -> bool {
        matches!(self, Self::Nothing | Self::HungSupervisor)
    }

    /// Whether the daemon may free space meanwhile, so that a stop can be confirmed nevertheless.
    pub(super) fn may_have_room(self) -> bool {
        matches!(self, Self::FullMemory | Self::FewInodes)
    }
}
