//! Detection of a robot's daemon without shared memory.
//!
//! While it lives, a daemon holds two things: a lock on a file in the root folder, and a name in the abstract Unix
//! socket namespace. The kernel releases both when the process ends, however it ends. The file can be deleted while the
//! daemon runs; the name cannot, but it is not visible from another network namespace.

use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::MetadataExt;

use rustix::fs::{Mode, OFlags, open};
use rustix::io::Errno;
use rustix::net::sockopt::socket_peercred;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};
use rustix::process::{
    Pid, PidfdFlags, Signal, geteuid, pidfd_open, pidfd_send_signal, test_kill_process,
};

use crate::Location;
use crate::proc_stat::has_bit;

/// Program name of the daemon, as the kernel shows it.
const PROGRAM: &str = "cdcrd";

/// A running daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Presence {
    /// Its process id, if it could be determined.
    pub process_id: Option<u32>,
}

/// Holder of the abstract socket name of a robot's daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NameHolder {
    /// No process that answers.
    Nobody,
    /// A process of the user who owns the root folder.
    Ours {
        /// Its process id; `None` if it is not visible here.
        process_id: Option<u32>,
    },
    /// A process of another user, or of an unknown one.
    Foreign,
}

impl Location {
    /// The abstract socket name that the daemon of `robot` holds while it lives.
    pub fn daemon_name(&self, robot: &str) -> String {
        // FNV-1a (Fowler, Noll, Vo), 64 bits, because a root path may be longer than such a name.
        let bytes = [
            self.root().as_os_str().as_encoded_bytes(),
            self.prefix().as_bytes(),
        ];
        let hash = bytes
            .join(&0)
            .iter()
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
                (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
            });
        format!("cdcrd-{hash:016x}-{robot}")
    }

    /// The user who owns the root folder; if there is none, the user of this process.
    fn owner_id(&self) -> u32 {
        std::fs::metadata(self.root()).map_or_else(|_| geteuid().as_raw(), |root| root.uid())
    }

    /// The holder of [`daemon_name`](Self::daemon_name). Never waits.
    pub fn name_holder(&self, robot: &str) -> NameHolder {
        match socket_peer(&self.daemon_name(robot)) {
            Ok((user_id, process_id)) if user_id == self.owner_id() => {
                NameHolder::Ours { process_id }
            }
            // The holder has ended.
            Err(Errno::CONNREFUSED | Errno::NOENT) => NameHolder::Nobody,
            _ => NameHolder::Foreign,
        }
    }

    /// The daemon of `robot`, if it runs. A hung daemon and one without shared memory are detected as running.
    pub fn presence(&self, robot: &str) -> Option<Presence> {
        let by_lock = self.lock_holder(robot);
        let by_name = match self.name_holder(robot) {
            NameHolder::Ours { process_id } => Some(Presence { process_id }),
            NameHolder::Nobody | NameHolder::Foreign => None,
        };
        // The kernel reports the holder of the name; the lock file may contain what any process with write access
        // wrote.
        let process_id = by_name
            .and_then(|presence| presence.process_id)
            .or_else(|| by_lock.and_then(|presence| presence.process_id));
        by_lock.or(by_name).map(|_| Presence { process_id })
    }

    /// Names of the robots whose daemons run here, sorted, as far as this user can detect them.
    pub fn robots(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.root()).into_iter().flatten();
        let names = entries.flatten().filter_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            let robot = name.strip_prefix(self.prefix())?.strip_suffix(".lock")?;
            // With a longer prefix that begins with this one, the daemon has another name.
            let is_ours = matches!(self.name_holder(robot), NameHolder::Ours { .. });
            is_ours.then(|| robot.to_owned())
        });
        let mut names: Vec<_> = names.collect();
        names.sort();
        names
    }

    /// Holder of the lock on the file in the root folder. The daemon tries to lock it for longer than this check takes.
    fn lock_holder(&self, robot: &str) -> Option<Presence> {
        // A link or a pipe in its place is not followed and does not block.
        let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
        let opened = open(self.lock_file(robot), flags, Mode::empty()).ok()?;
        let file = File::from(opened);
        let Err(TryLockError::WouldBlock) = file.try_lock_shared() else {
            return None;
        };
        let mut text = String::new();
        // A process with write access may have written more.
        let read = file.take(32).read_to_string(&mut text);
        let process_id = read.ok().and_then(|_| text.trim().parse().ok());
        Some(Presence { process_id })
    }

    /// Stops the robot by sending the signal `SIGUSR1` to its daemon, which needs no shared memory. Returns the process
    /// id. The stop is executed in the next cycle, without an answer.
    ///
    /// # Errors
    /// If no daemon runs, or its process is not certain or must not be signalled.
    pub fn stop_by_signal(&self, robot: &str) -> std::io::Result<u32> {
        let not_found = || std::io::Error::from(ErrorKind::NotFound);
        let process = || {
            self.presence(robot)
                .and_then(|presence| presence.process_id)
        };
        let process_id = process().ok_or_else(not_found)?;
        let raw = i32::try_from(process_id).ok().and_then(Pid::from_raw);
        let pid = raw.ok_or_else(not_found)?;
        test_kill_process(pid)?;
        let handle = pidfd_open(pid, PidfdFlags::empty())?;
        // The process id may meanwhile belong to another process, or to another container, which the signal would end.
        let program = std::fs::read_to_string(format!("/proc/{process_id}/comm"))?;
        if process() != Some(process_id) || program.trim() != PROGRAM {
            return Err(not_found());
        }
        // A daemon without a handler for the signal would end during a motion.
        let status = std::fs::read_to_string(format!("/proc/{process_id}/status"))?;
        if !has_bit(&status, "SigCgt", Signal::USR1.as_raw().cast_unsigned() - 1) {
            return Err(ErrorKind::Unsupported.into());
        }
        pidfd_send_signal(&handle, Signal::USR1)?;
        Ok(process_id)
    }
}

/// User and process id at the other end of an abstract socket name.
fn socket_peer(name: &str) -> Result<(u32, Option<u32>), Errno> {
    let address = SocketAddrUnix::new_abstract_name(name.as_bytes())?;
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    connect(&socket, &address)?;
    let peer = socket_peercred(&socket)?;
    // 0: in another pid namespace.
    let process_id = u32::try_from(Pid::as_raw(Some(peer.pid))).ok();
    Ok((peer.uid.as_raw(), process_id.filter(|id| *id > 0)))
}

#[cfg(test)]
mod tests {
    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::net::{SocketAddr, UnixListener};
    use std::path::Path;

    use cdcr_scratch::Scratch;

    use super::*;

    fn listen(location: &Location, robot: &str) -> UnixListener {
        let name = location.daemon_name(robot);
        UnixListener::bind_addr(&SocketAddr::from_abstract_name(name).unwrap()).unwrap()
    }

    #[test]
    fn a_daemon_is_present_for_as_long_as_it_holds_its_name() {
        let prefix = format!("cdcrtest_presence_{}_", std::process::id());
        let location = Location::new(&prefix, Path::new("/nowhere/at/all")).unwrap();
        assert_eq!(location.presence("a"), None);
        let listener = listen(&location, "a");
        let process_id = Some(std::process::id());
        assert_eq!(location.presence("a"), Some(Presence { process_id }));
        assert_eq!(location.presence("b"), None, "another robot");
        let elsewhere = Location::new(&prefix, Path::new("/nowhere/else")).unwrap();
        assert_eq!(elsewhere.presence("a"), None, "another root");
        // This process is not the daemon's program, and the signal would end it.
        assert!(location.stop_by_signal("a").is_err());
        drop(listener);
        assert_eq!(location.presence("a"), None);
    }

    #[test]
    fn robots_of_a_location_are_those_with_a_live_daemon() {
        let root = Scratch::temporary().unwrap();
        let location = Location::new("a_", root.path()).unwrap();
        let longer = Location::new("a_b_", root.path()).unwrap();
        for (of, robot) in [
            (&location, "y"),
            (&location, "x"),
            (&location, "dead"),
            (&longer, "x"),
        ] {
            File::create(of.lock_file(robot)).unwrap();
        }
        let _alive = [
            listen(&location, "y"),
            listen(&location, "x"),
            listen(&longer, "x"),
        ];
        assert_eq!(location.robots(), ["x", "y"]);
        assert_eq!(longer.robots(), ["x"]);
        drop(root);
        assert_eq!(location.robots(), Vec::<String>::new());
    }

    #[test]
    fn names_fit_the_longest_location() {
        let root = format!("/{}", "r".repeat(98));
        let location = Location::new(&"p".repeat(40), Path::new(&root)).unwrap();
        let robot = "n".repeat(40);
        drop(listen(&location, &robot));
    }
}
