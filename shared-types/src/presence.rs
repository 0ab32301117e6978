//! Whether the daemon of a robot runs, told without shared memory.
//!
//! A daemon takes two things for as long as it lives: a lock on a file in the root folder, and a name among the abstract
//! Unix sockets. The kernel gives both back when the process ends, however it ends. The file can be deleted while the
//! daemon runs; the name cannot, but it is not seen from another network namespace.

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

/// Name of the daemon's program, as the kernel shows it.
const PROGRAM: &str = "cdcrd";

/// A daemon that runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Presence {
    /// Its process, as far as it could be told.
    pub process_id: Option<u32>,
}

/// Who holds the name of a robot's daemon among the abstract Unix sockets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NameHolder {
    /// Nobody who answers.
    Nobody,
    /// A process of the user to whom the root folder belongs.
    Ours {
        /// Its id; none when it is not visible here.
        process_id: Option<u32>,
    },
    /// A process of another user, or one that does not say of whom.
    Foreign,
}

impl Location {
    /// The name that the daemon of `robot` takes among the abstract Unix sockets while it lives.
    pub fn daemon_name(&self, robot: &str) -> String {
        // FNV-1a (Fowler, Noll, Vo), 64 bits: a root path may be longer than such a name.
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

    /// The user to whom the root folder belongs; without one, the user of this process.
    fn owner_id(&self) -> u32 {
        std::fs::metadata(self.root()).map_or_else(|_| geteuid().as_raw(), |root| root.uid())
    }

    /// Who holds [`daemon_name`](Self::daemon_name). Never waits.
    pub fn name_holder(&self, robot: &str) -> NameHolder {
        match peer_of(&self.daemon_name(robot)) {
            Ok((user_id, process_id)) if user_id == self.owner_id() => {
                NameHolder::Ours { process_id }
            }
            // Its holder has ended.
            Err(Errno::CONNREFUSED | Errno::NOENT) => NameHolder::Nobody,
            _ => NameHolder::Foreign,
        }
    }

    /// The daemon of `robot`, if it runs. Neither a hung daemon nor one without shared memory is taken for dead.
    pub fn presence(&self, robot: &str) -> Option<Presence> {
        let by_lock = self.lock_holder(robot);
        let by_name = match self.name_holder(robot) {
            NameHolder::Ours { process_id } => Some(Presence { process_id }),
            NameHolder::Nobody | NameHolder::Foreign => None,
        };
        // The kernel knows who holds the name; what stands in the lock file, whoever may write to it says.
        let process_id = by_name
            .and_then(|presence| presence.process_id)
            .or_else(|| by_lock.and_then(|presence| presence.process_id));
        by_lock.or(by_name).map(|_| Presence { process_id })
    }

    /// The robots whose daemons run here, in the order of their names, as far as this user can tell.
    pub fn robots(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.root()).into_iter().flatten();
        let names = entries.flatten().filter_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            let robot = name.strip_prefix(self.prefix())?.strip_suffix(".lock")?;
            // Of another prefix, which begins with this one, the daemon has another name.
            let is_ours = matches!(self.name_holder(robot), NameHolder::Ours { .. });
            is_ours.then(|| robot.to_owned())
        });
        let mut names: Vec<_> = names.collect();
        names.sort();
        names
    }

    /// Who has locked the file in the root folder. The daemon tries for longer to lock it than this look takes.
    fn lock_holder(&self, robot: &str) -> Option<Presence> {
        // Neither a link nor a pipe in its place leads anywhere.
        let flags = OFlags::RDONLY | OFlags::CLOEXEC | OFlags::NOFOLLOW | OFlags::NONBLOCK;
        let opened = open(self.lock_file(robot), flags, Mode::empty()).ok()?;
        let file = File::from(opened);
        let Err(TryLockError::WouldBlock) = file.try_lock_shared() else {
            return None;
        };
        let mut text = String::new();
        // Whoever may write to it may write more than that.
        let read = file.take(32).read_to_string(&mut text);
        let process_id = read.ok().and_then(|_| text.trim().parse().ok());
        Some(Presence { process_id })
    }

    /// Stops the robot by the signal `SIGUSR1` to its daemon, which needs no shared memory. Says to which process it was
    /// sent. It is carried out in the next cycle, and nobody answers.
    ///
    /// # Errors
    /// When no daemon runs, or its process cannot be told for sure, or must not be signalled.
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
        // The number may be of another process by now, or of another container: the signal would end that one.
        let program = std::fs::read_to_string(format!("/proc/{process_id}/comm"))?;
        if process() != Some(process_id) || program.trim() != PROGRAM {
            return Err(not_found());
        }
        // One that does not know the signal would end by it, in the middle of a motion.
        let status = std::fs::read_to_string(format!("/proc/{process_id}/status"))?;
        if !catches_stop_signal(&status) {
            return Err(ErrorKind::Unsupported.into());
        }
        pidfd_send_signal(&handle, Signal::USR1)?;
        Ok(process_id)
    }
}

/// Whether a process with this `/proc/<pid>/status` has a handler for `SIGUSR1`, see `proc_pid_status(5)`.
fn catches_stop_signal(status: &str) -> bool {
    let caught = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    let caught = caught.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    caught.is_some_and(|mask| mask & (1 << (Signal::USR1.as_raw() - 1)) != 0)
}

/// User and process at the other end of an abstract name.
fn peer_of(name: &str) -> Result<(u32, Option<u32>), Errno> {
    let address = SocketAddrUnix::new_abstract_name(name.as_bytes())?;
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    connect(&socket, &address)?;
    let peer = socket_peercred(&socket)?;
    // 0: of another namespace.
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
        // This process is not the program of the daemon, and would be ended.
        assert!(location.stop_by_signal("a").is_err());
        drop(listener);
        assert_eq!(location.presence("a"), None);
    }

    #[test]
    fn the_robots_of_a_place_are_those_whose_daemons_live() {
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
    fn names_fit_the_longest_place() {
        let root = format!("/{}", "r".repeat(98));
        let location = Location::new(&"p".repeat(40), Path::new(&root)).unwrap();
        let robot = "n".repeat(40);
        drop(listen(&location, &robot));
    }
}
