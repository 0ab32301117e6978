use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Component, Path, PathBuf};
use std::time::Duration;

use iceoryx2::config::Config;
use iceoryx2::node::{NodeState, NodeView};
use iceoryx2::prelude::{
    CallbackProgression, FileName, Node, NodeBuilder, Path as IoxPath, SemanticString, ServiceName,
    SignalHandlingMode,
};

use crate::ipc;
use crate::limits::INCIDENTS_MAX;

/// Prefix of every shared-memory file of ours, unless a user chooses another.
pub const DEFAULT_PREFIX: &str = "cdcr_";

/// The eight services of a daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Service {
    /// Reference chunks, client → daemon.
    Reference,
    /// Obstacle updates, client → daemon.
    Obstacles,
    /// Measurements, driver → daemon.
    Measurement,
    /// Commands, daemon → driver.
    Command,
    /// One record per cycle, daemon → any.
    Telemetry,
    /// Snapshots for late joiners, daemon → any.
    Status,
    /// The last bad cycles, daemon → any.
    Incidents,
    /// Requests and answers.
    Control,
}

/// Quality of service of a publish-subscribe service: the daemon creates with these numbers, and
/// they bound its memory. Safe overflow is always on: a stopped reader loses the oldest messages, and
/// never stops a writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QueueLengths {
    /// Writers at one time.
    pub publishers: usize,
    /// Readers at one time.
    pub subscribers: usize,
    /// Of them, places that are kept for those who take part: the driver, the daemon itself. Clients that only
    /// watch leave them free.
    pub kept: usize,
    /// Messages that wait for one reader.
    pub queue: usize,
    /// Messages that a late joiner still gets.
    pub history: usize,
}

impl QueueLengths {
    /// Messages that a reader may hold, and that a writer may have in the making: iceoryx2's defaults.
    pub const HELD: usize = 2;

    /// Readers that only watch, at one time.
    pub const fn watchers(self) -> usize {
        self.subscribers - self.kept
    }

    /// Shared memory of one writer's messages \[bytes\]: as many as all readers together may have, so that it never
    /// waits.
    pub const fn writer_bytes(self, message_bytes: usize) -> u64 {
        let messages = self.subscribers * (self.queue + Self::HELD) + self.history + Self::HELD;
        (messages * message_bytes) as u64
    }
}

impl Service {
    /// Every service.
    pub const ALL: [Self; 8] = [
        Self::Reference,
        Self::Obstacles,
        Self::Measurement,
        Self::Command,
        Self::Telemetry,
        Self::Status,
        Self::Incidents,
        Self::Control,
    ];

    /// Clients that may have a control connection at one time.
    pub const CONTROL_CLIENTS: usize = 20;
    /// Of them, places that are kept for a stop: clients that ask for anything else leave them free.
    pub const CONTROL_KEPT: usize = 4;
    /// Requests of one client that may wait at one time.
    pub const CONTROL_REQUESTS: usize = 4;
    /// Processes that may have all services open at one time, the daemon among them.
    pub const NODES: usize = 40;
    /// Drivers that find a place when those are full: one, and the one that takes its place.
    pub const DRIVERS: usize = 2;

    /// Last part of the service's name.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Reference => "reference",
            Self::Obstacles => "obstacles",
            Self::Measurement => "measurement",
            Self::Command => "command",
            Self::Telemetry => "telemetry",
            Self::Status => "status",
            Self::Incidents => "incidents",
            Self::Control => "control",
        }
    }

    /// Processes that may have this service open at one time. A stop opens [`Service::Control`] alone, and a driver the three
    /// services that it needs, so both find a place when all others are full.
    pub const fn nodes(self) -> usize {
        match self {
            Self::Control => Self::NODES + 8,
            Self::Measurement | Self::Command | Self::Status => Self::NODES + Self::DRIVERS,
            Self::Reference | Self::Obstacles | Self::Telemetry | Self::Incidents => Self::NODES,
        }
    }

    /// Queue lengths, for all but [`Service::Control`].
    pub const fn queues(self) -> QueueLengths {
        let (publishers, subscribers, kept, queue, history) = match self {
            // 32 chunks: the whole reference buffer of the daemon.
            Self::Reference => (8, 4, 1, 32, 0),
            Self::Obstacles => (8, 4, 1, 16, 0),
            // A driver, the one that takes its place, a tip sensor. Who may connect may read, where the messages are small.
            Self::Measurement => (3, Self::NODES + 1, 1, 16, 0),
            Self::Command => (1, Self::NODES + Self::DRIVERS, Self::DRIVERS, 16, 0),
            // 256 records: 1.28 s at 5 ms. A reader costs 4 MB.
            Self::Telemetry => (1, 8, 0, 256, 0),
            // Each connection reads it, and may have one stream of it; a driver reads it once.
            Self::Status | Self::Control => {
                let readers = 2 * Self::NODES + Self::DRIVERS;
                (1, readers, Self::DRIVERS, 2, 1)
            }
            // Few look at bad cycles, and each reader costs 64 of them, 1 MB.
            Self::Incidents => (1, 4, 0, INCIDENTS_MAX, INCIDENTS_MAX),
        };
        QueueLengths {
            publishers,
            subscribers,
            kept,
            queue,
            history,
        }
    }

    /// Full name `cdcr/<robot>/<key>`.
    ///
    /// # Errors
    /// When `robot` is not a legal part of a service name (empty, or too long).
    pub fn name(self, robot: &str) -> Result<ServiceName, ServiceNameError> {
        let error = || ServiceNameError {
            robot: robot.to_owned(),
        };
        if !Location::is_legal_name(robot) {
            return Err(error());
        }
        let name = format!("cdcr/{robot}/{}", self.key());
        name.as_str().try_into().map_err(|_| error())
    }
}

/// A robot name that cannot be part of a service name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServiceNameError {
    /// The name.
    pub robot: String,
}

impl core::fmt::Display for ServiceNameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "invalid robot name {:?}: use 1 to 40 letters, digits, '-' and '_'",
            self.robot
        )
    }
}

impl core::error::Error for ServiceNameError {}

/// Where a daemon and its clients meet: an iceoryx2 prefix and a root path of our own, never iceoryx2's defaults (which a
/// file in the working directory could change). All shared memory is in files below the root path, which lies in memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Location {
    prefix: String,
    root: PathBuf,
}

/// How many folders deep an absolute path leads, links aside.
fn depth(path: &Path) -> usize {
    path.components().fold(0, |depth: usize, part| match part {
        Component::Normal(_) => depth + 1,
        Component::ParentDir => depth.saturating_sub(1),
        _ => depth,
    })
}

/// A prefix or root path that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LocationError {
    /// The prefix is not a legal start of a file name.
    Prefix(String),
    /// The root is not an absolute path that iceoryx2 accepts.
    Root(PathBuf),
}

impl core::fmt::Display for LocationError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Prefix(prefix) => write!(
                f,
                "invalid prefix {prefix:?}: use 1 to 40 letters, digits, '-' and '_'"
            ),
            Self::Root(root) => write!(
                f,
                "{} is no root path: use an absolute path of at most 100 characters, not / itself",
                root.display()
            ),
        }
    }
}

impl core::error::Error for LocationError {}

impl Location {
    /// A location with the given prefix and root path.
    ///
    /// # Errors
    /// When iceoryx2 could not use them; the message says what is legal.
    pub fn new(prefix: &str, root: &Path) -> Result<Self, LocationError> {
        if !Self::is_legal_name(prefix) {
            return Err(LocationError::Prefix(prefix.to_owned()));
        }
        if !root.is_absolute() || root.as_os_str().len() > 100 || depth(root) == 0 {
            return Err(LocationError::Root(root.to_owned()));
        }
        let location = Self {
            prefix: prefix.to_owned(),
            root: root.to_owned(),
        };
        location.iceoryx2_config()?;
        Ok(location)
    }

    /// The location that the variables `CDCR_PREFIX` and `CDCR_ROOT` of the environment name, each with its default.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_environment() -> Result<Self, LocationError> {
        let root = std::env::var_os("CDCR_ROOT").map_or_else(Self::default_root, PathBuf::from);
        let prefix = std::env::var("CDCR_PREFIX");
        Self::new(prefix.as_deref().unwrap_or(DEFAULT_PREFIX), &root)
    }

    /// A folder that every Linux has in memory. Everybody may create files there, and nobody may rename or remove those of
    /// another user.
    pub const MEMORY: &str = "/dev/shm";

    /// Root path of the daemon that the package installs as a service.
    pub const SERVICE_ROOT: &str = "/run/cdcr";

    /// Root path unless a user chooses another: one for each Unix user, because the folder is private to its owner.
    ///
    /// It depends on no environment variable: a `stop` has to find the daemon from any shell, service or `sudo`.
    pub fn default_root() -> PathBuf {
        use std::os::unix::fs::MetadataExt;
        let user_id = std::fs::metadata("/proc/self").map_or(0, |process| process.uid());
        Path::new(Self::MEMORY).join(format!("cdcr-{user_id}"))
    }

    /// Prefix of the shared-memory files.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Start of the names of iceoryx2's files: the prefix, and a hash, so that no prefix is the beginning of another one
    /// that uses the same root path.
    pub fn file_prefix(&self) -> String {
        // FNV-1a (Fowler, Noll, Vo), 32 bits.
        let hash = self.prefix.bytes().fold(0x811c_9dc5_u32, |hash, byte| {
            (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
        });
        format!("{}{hash:08x}_", self.prefix)
    }

    /// The files of this location that are mapped into memory.
    pub fn memory_files(&self) -> Vec<PathBuf> {
        memory_files(&self.root, &self.file_prefix())
    }

    /// Name of the file in the root folder that the daemon of `robot` locks while it runs, and removes at a clean
    /// end.
    pub fn lock_file(&self, robot: &str) -> PathBuf {
        self.root.join(format!("{}{robot}.lock", self.prefix))
    }

    /// Root path.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The iceoryx2 configuration for this location, to be passed to every node.
    ///
    /// # Errors
    /// As [`Location::new`].
    pub fn iceoryx2_config(&self) -> Result<Config, LocationError> {
        let mut config = Config::default();
        config.global.prefix = FileName::new(self.file_prefix().as_bytes())
            .map_err(|_| LocationError::Prefix(self.prefix.clone()))?;
        let root = IoxPath::new(self.root.as_os_str().as_encoded_bytes())
            .map_err(|_| LocationError::Root(self.root.clone()))?;
        config.global.set_root_path(&root);
        // A service is made within a millisecond; one that takes longer was left unfinished.
        config.global.creation_timeout = Duration::from_millis(250);
        Ok(config)
    }

    /// A node builder for this location that leaves signals to the process. Makes the root folder if it is missing, closed to
    /// others: iceoryx2 would make one that is open to all.
    ///
    /// # Errors
    /// As [`Location::new`].
    pub fn node_builder(&self) -> Result<NodeBuilder, LocationError> {
        let mut folder = DirBuilder::new();
        // Where that fails, the node fails, too, and says so.
        let _ = folder.recursive(true).mode(0o700).create(&self.root);
        Ok(NodeBuilder::new()
            .config(&self.iceoryx2_config()?)
            .signal_handling_mode(SignalHandlingMode::Disabled))
    }

    /// A node builder for clients: as [`node_builder`](Self::node_builder), but nothing is done about dead processes.
    /// To clear one away takes 5 ms, and a client that wants to stop a robot may come after a thousand of them.
    ///
    /// # Errors
    /// As [`Location::new`].
    pub fn client_node_builder(&self) -> Result<NodeBuilder, LocationError> {
        let mut config = self.iceoryx2_config()?;
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        Ok(NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled))
    }

    /// Clears away what dead processes left, `most` of them at most. Returns how many it was.
    pub fn clear_dead_nodes(&self, most: usize) -> usize {
        let Ok(config) = self.iceoryx2_config() else {
            return 0;
        };
        let mut cleared = 0;
        if most == 0 {
            return cleared;
        }
        // What cannot be listed or cleared now, the next one tries again.
        let _ = Node::<ipc::Service>::list(&config, |node| {
            // Of one without details iceoryx2 would clear the place that its global configuration names.
            if let NodeState::Dead(dead) = node
                && dead.details().is_some()
                && dead.try_remove_stale_resources().is_ok()
            {
                cleared += 1;
            }
            if cleared < most {
                CallbackProgression::Continue
            } else {
                CallbackProgression::Stop
            }
        });
        cleared
    }

    fn is_legal_name(name: &str) -> bool {
        (1..=40).contains(&name.len())
            && name
                .bytes()
                .all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_')
    }
}

/// The files in the folder `root` that are mapped into memory: their names begin with `file_prefix`.
pub fn memory_files(root: &Path, file_prefix: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root).into_iter().flatten();
    let paths = entries.flatten().map(|entry| entry.path());
    paths
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().as_encoded_bytes();
            name.starts_with(file_prefix.as_bytes())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked_before_iceoryx2_sees_them() {
        assert_eq!(
            Service::Status.name("trunk").map(|n| n.to_string()).ok(),
            Some("cdcr/trunk/status".to_owned())
        );
        assert!(Service::Status.name("").is_err());
        assert!(Service::Status.name("a/b").is_err());
        assert!(Location::new("x y", Path::new("/tmp/x")).is_err());
        assert!(Location::new("x_", Path::new("relative")).is_err());
        assert!(Location::new("x_", Path::new("/tmp/x")).is_ok());
    }
}
