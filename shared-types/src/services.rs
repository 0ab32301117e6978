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

/// Default prefix of every shared-memory file of this project.
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
    /// Requests and responses, client ↔ daemon.
    Control,
}

/// Quality of service of a publish-subscribe service. The daemon creates the service with these numbers, which bound
/// its memory. Safe overflow is always on: a reader that stops loses the oldest messages and never blocks a writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QueueLengths {
    /// Maximum number of writers.
    pub publishers: usize,
    /// Maximum number of readers.
    pub subscribers: usize,
    /// Places reserved for the driver and the daemon itself. Monitoring clients leave them free.
    pub kept: usize,
    /// Messages queued for one reader.
    pub queue: usize,
    /// Messages delivered to a late joiner.
    pub history: usize,
}

impl QueueLengths {
    /// Messages that a reader may hold, and that a writer may have loaned: the default of iceoryx2.
    pub const HELD: usize = 2;

    /// Maximum number of monitoring readers.
    pub const fn watchers(self) -> usize {
        self.subscribers - self.kept
    }

    /// Messages in the memory of one writer: as many as can be in use at one time, so that a writer always has a free
    /// one. A message enters the queues of all readers at once, and a full queue drops its oldest. So queues and
    /// history together contain only the last messages sent; older ones are those that readers hold.
    pub const fn writer_messages(self) -> usize {
        let last = if self.queue > self.history {
            self.queue
        } else {
            self.history
        };
        last + self.subscribers * Self::HELD + Self::HELD
    }

    /// Shared memory for one writer's messages \[bytes\].
    pub const fn writer_bytes(self, message_bytes: usize) -> u64 {
        (self.writer_messages() * message_bytes) as u64
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

    /// Maximum number of control connections.
    pub const CONTROL_CLIENTS: usize = 20;
    /// Control connections reserved for a stop; other requests leave them free.
    pub const CONTROL_KEPT: usize = 4;
    /// Maximum number of waiting requests of one client.
    pub const CONTROL_REQUESTS: usize = 4;
    /// Maximum number of processes that have all services open, including the daemon.
    pub const NODES: usize = 40;
    /// Places for drivers beyond [`Self::NODES`]: one, and its replacement.
    pub const DRIVERS: usize = 2;
    /// Maximum number of readers of the telemetry.
    const TELEMETRY_READERS: usize = 8;

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

    /// Maximum number of processes that have this service open. A stop opens only [`Service::Control`], and a driver
    /// only the three services that it needs. Both find a place when all others are taken.
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
            // 32 chunks: the whole reference buffer of the daemon. Beside the daemon as many readers as of the telemetry: what records, or shows a
            // scene, reads all three. Each takes 18 KiB of a writer of references, 13 KiB of one of obstacles.
            Self::Reference => (8, Self::TELEMETRY_READERS + 1, 1, 32, 0),
            Self::Obstacles => (8, Self::TELEMETRY_READERS + 1, 1, 16, 0),
            // A driver, its replacement, and a tip sensor. Messages are small, so every connected process may read.
            Self::Measurement => (3, Self::NODES + 1, 1, 16, 0),
            Self::Command => (1, Self::NODES + Self::DRIVERS, Self::DRIVERS, 16, 0),
            // 256 records, 4 MB: 1.28 s at 5 ms.
            Self::Telemetry => (1, Self::TELEMETRY_READERS, 0, 256, 0),
            // Each connection reads it and may have one stream of it; a driver reads it once.
            Self::Status | Self::Control => {
                let readers = 2 * Self::NODES + Self::DRIVERS;
                (1, readers, Self::DRIVERS, 2, 1)
            }
            // What records reads bad cycles, too: 31 KiB for a reader.
            Self::Incidents => {
                let readers = Self::TELEMETRY_READERS;
                (1, readers, 0, INCIDENTS_MAX, INCIDENTS_MAX)
            }
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
    /// If `robot` is not a legal part of a service name: 1 to 40 letters, digits, `-` and `_`.
    pub fn name(self, robot: &str) -> Result<ServiceName, ServiceNameError> {
        let error = || ServiceNameError {
            robot: robot.to_owned(),
        };
        if !Location::is_legal_name(robot) {
            return Err(error());
        }
        let name = self.full_name(robot);
        name.as_str().try_into().map_err(|_| error())
    }

    /// Full name `cdcr/<robot>/<key>`, unchecked.
    pub fn full_name(self, robot: &str) -> String {
        format!("cdcr/{robot}/{}", self.key())
    }
}

/// Characters of a robot's name and of a prefix, and of a root path: both are parts of file names.
const NAME_MAX: usize = 40;
const ROOT_MAX: usize = 100;

/// A robot name that cannot be part of a service name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServiceNameError {
    /// The rejected name.
    pub robot: String,
}

impl core::fmt::Display for ServiceNameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "invalid robot name {:?}: use 1 to {NAME_MAX} letters, digits, '-' and '_'",
            self.robot
        )
    }
}

impl core::error::Error for ServiceNameError {}

/// Meeting place of a daemon and its clients: an iceoryx2 prefix and a root path. The defaults of iceoryx2 are not
/// used, because a file in the working directory could change them. All shared memory is in files below the root path,
/// on a file system in memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Location {
    prefix: String,
    root: PathBuf,
}

/// Depth of an absolute path in folders, without resolving links.
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
                "invalid prefix {prefix:?}: use 1 to {NAME_MAX} letters, digits, '-' and '_'"
            ),
            Self::Root(root) => write!(
                f,
                "invalid root path {}: use an absolute path of at most {ROOT_MAX} characters, not / itself",
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
    /// If iceoryx2 cannot use them; the message states what is legal.
    pub fn new(prefix: &str, root: &Path) -> Result<Self, LocationError> {
        if !Self::is_legal_name(prefix) {
            return Err(LocationError::Prefix(prefix.to_owned()));
        }
        if !root.is_absolute() || root.as_os_str().len() > ROOT_MAX || depth(root) == 0 {
            return Err(LocationError::Root(root.to_owned()));
        }
        let location = Self {
            prefix: prefix.to_owned(),
            root: root.to_owned(),
        };
        location.iceoryx2_config()?;
        Ok(location)
    }

    /// The location from the environment variables `CDCR_PREFIX` and `CDCR_ROOT`, each with its default.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_environment() -> Result<Self, LocationError> {
        let root = std::env::var_os("CDCR_ROOT").map_or_else(Self::default_root, PathBuf::from);
        let prefix = std::env::var("CDCR_PREFIX");
        Self::new(prefix.as_deref().unwrap_or(DEFAULT_PREFIX), &root)
    }

    /// A folder in memory that exists on every Linux. Every user may create files there, but not rename or remove those
    /// of another user.
    pub const MEMORY: &str = "/dev/shm";

    /// Root path of the daemon that the package installs as a service.
    pub const SERVICE_ROOT: &str = "/run/cdcr";

    /// Default root path: one for each Unix user, because the folder is private to its owner.
    ///
    /// It depends on no environment variable, so that a `stop` finds the daemon from any shell, service or `sudo`.
    pub fn default_root() -> PathBuf {
        use std::os::unix::fs::MetadataExt;
        let user_id = std::fs::metadata("/proc/self").map_or(0, |process| process.uid());
        Path::new(Self::MEMORY).join(format!("cdcr-{user_id}"))
    }

    /// Prefix of the shared-memory files.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Prefix of iceoryx2's file names: the prefix and its hash, so that no prefix is the beginning of another one with
    /// the same root path.
    pub fn file_prefix(&self) -> String {
        // FNV-1a (Fowler, Noll, Vo), 32 bits.
        let hash = self.prefix.bytes().fold(0x811c_9dc5_u32, |hash, byte| {
            (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
        });
        format!("{}{hash:08x}_", self.prefix)
    }

    /// The memory-mapped files of this location.
    pub fn memory_files(&self) -> Vec<PathBuf> {
        memory_files(&self.root, &self.file_prefix())
    }

    /// The file in the root folder that the daemon of `robot` locks while it runs, and removes at a clean end.
    pub fn lock_file(&self, robot: &str) -> PathBuf {
        self.root.join(format!("{}{robot}.lock", self.prefix))
    }

    /// Root path.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The iceoryx2 configuration of this location, for every node.
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
        // A service is created within a millisecond; one that takes longer is orphaned.
        config.global.creation_timeout = Duration::from_millis(250);
        Ok(config)
    }

    /// A node builder for this location that leaves signals to the process. Creates a missing root folder without
    /// access for others; iceoryx2 would create an open one.
    ///
    /// # Errors
    /// As [`Location::new`].
    pub fn node_builder(&self) -> Result<NodeBuilder, LocationError> {
        let mut folder = DirBuilder::new();
        // If this fails, creation of the node fails and reports it.
        let _ = folder.recursive(true).mode(0o700).create(&self.root);
        Ok(NodeBuilder::new()
            .config(&self.iceoryx2_config()?)
            .signal_handling_mode(SignalHandlingMode::Disabled))
    }

    /// A node builder for clients, as [`node_builder`](Self::node_builder), without cleanup of dead processes. Each
    /// cleanup takes 5 ms, and a client that stops a robot may find a thousand of them.
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

    /// Removes the resources of dead processes, of at most `most`. Returns their number.
    pub fn clear_dead_nodes(&self, most: usize) -> usize {
        let Ok(config) = self.iceoryx2_config() else {
            return 0;
        };
        let mut cleared = 0;
        if most == 0 {
            return cleared;
        }
        // The next call retries those that cannot be listed or removed now.
        let _ = Node::<ipc::Variant>::list(&config, |node| {
            // Without details, iceoryx2 would clean up the location of its global configuration.
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
        (1..=NAME_MAX).contains(&name.len())
            && name
                .bytes()
                .all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_')
    }
}

/// The memory-mapped files in the folder `root`: their names begin with `file_prefix`.
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
    fn a_program_that_records_everything_has_as_many_places_as_readers_of_the_telemetry() {
        let readers = Service::Telemetry.queues().watchers();
        for service in Service::ALL {
            assert!(service.queues().watchers() >= readers, "{service:?}");
        }
    }

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
