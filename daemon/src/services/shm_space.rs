//! Space in the memory of the root folder: checked before use, then allocated permanently.
//!
//! iceoryx2 gives its files a size, and the kernel allocates a page when it is first touched. If no memory is
//! left then, the kernel kills the process (SIGBUS), perhaps hours later within a cycle. So the daemon first
//! checks the space, and allocates the memory of its files before it uses them.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use cdcr_shared_types::shm_space::{
    self, InsufficientSpace, PORT_BYTES, Resource, free_bytes, mount_point,
};
use cdcr_shared_types::{
    Command, Incident, Response, Service, Status, Telemetry, ipc, memory_files,
};
use iceoryx2::prelude::Node;
use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;

/// Answers to one request that may be prepared, waiting or held: iceoryx2's defaults.
const ANSWERS: usize = 6;
/// Memory of one writer's messages \[bytes\].
pub(super) const fn writer_bytes(service: Service, message_bytes: usize) -> u64 {
    service.queues().writer_bytes(message_bytes)
}

/// Memory of the answers to all clients \[bytes\].
pub(super) const fn control_bytes() -> u64 {
    let answers = Service::CONTROL_CLIENTS * 2 * Service::CONTROL_REQUESTS * ANSWERS;
    (answers * size_of::<Response>()) as u64
}

/// Total memory of a daemon \[bytes\]. Management adds less than a fiftieth of the messages.
pub const fn daemon_bytes() -> u64 {
    let messages = writer_bytes(Service::Command, size_of::<Command>())
        + writer_bytes(Service::Telemetry, size_of::<Telemetry>())
        + writer_bytes(Service::Status, size_of::<Status>())
        + writer_bytes(Service::Incidents, size_of::<Incident>())
        + control_bytes();
    messages + messages / 50 + PORT_BYTES
}

#[derive(Debug)]
pub(super) struct ShmSpace {
    root: PathBuf,
    file_prefix: String,
}

impl ShmSpace {
    pub(super) fn new(root: &Path, file_prefix: &str) -> Self {
        Self {
            root: root.to_owned(),
            file_prefix: file_prefix.to_owned(),
        }
    }

    pub(super) fn from_node(node: &Node<ipc::Variant>) -> Self {
        let global = &node.config().global;
        Self {
            root: PathBuf::from(global.root_path().to_string()),
            file_prefix: global.prefix.to_string(),
        }
    }

    /// Checks that `needed_bytes` and `needed_files` are free. Unknown free space passes the check.
    pub(super) fn ask(
        &self,
        needed_bytes: u64,
        needed_files: u64,
    ) -> Result<(), InsufficientSpace> {
        shm_space::check(&self.root, needed_bytes, needed_files)
    }

    /// Allocates every page of the files without changing their content.
    pub(super) fn take(&self) -> Result<(), InsufficientSpace> {
        let mut free_before = free_bytes(&self.root);
        for file in self.files() {
            let Ok(size) = file.metadata().map(|file| file.len()) else {
                continue;
            };
            if fallocate(&file, FallocateFlags::empty(), 0, size) == Err(Errno::NOSPC) {
                return Err(InsufficientSpace {
                    mount: mount_point(&self.root),
                    resource: Resource::Bytes,
                    needed: size,
                    free: free_before.unwrap_or(0),
                });
            }
            free_before = free_bytes(&self.root);
        }
        Ok(())
    }

    /// Allocated memory of the files \[bytes\].
    pub(super) fn taken_bytes(&self) -> u64 {
        let blocks = self.files().filter_map(|file| file.metadata().ok());
        blocks.map(|file| file.blocks() * 512).sum()
    }

    /// The daemon's files. One that has just been removed is omitted.
    fn files(&self) -> impl Iterator<Item = File> {
        let open = |path| OpenOptions::new().read(true).write(true).open(path).ok();
        memory_files(&self.root, &self.file_prefix)
            .into_iter()
            .filter_map(open)
    }
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;
    use cdcr_shared_types::{Location, QueueLengths};

    use super::super::{Ports, ServiceError, incidents, node, publisher, telemetry};
    use super::*;

    #[test]
    fn a_daemon_takes_the_memory_it_computes_and_keeps_it() {
        let folder = Scratch::in_memory().unwrap();
        let location = Location::new("cdcrtest_room_", &folder.path().join("root")).unwrap();
        std::fs::create_dir(location.root()).unwrap();
        let node = node(&location).unwrap();
        let _ports = Ports::create(&node, "cdcr").unwrap();
        let _telemetry = telemetry(&node, "cdcr").unwrap();
        let _status = publisher::<Status>(&node, Service::Status, "cdcr").unwrap();
        let _incidents = incidents(&node, "cdcr").unwrap();
        let space = ShmSpace::from_node(&node);
        let sizes: u64 = space
            .files()
            .map(|file| file.metadata().unwrap().len())
            .sum();
        let taken_bytes = space.taken_bytes();
        assert!(taken_bytes >= sizes, "{taken_bytes} of {sizes}");
        let reported = daemon_bytes();
        assert!(
            (taken_bytes..taken_bytes + taken_bytes / 20).contains(&reported),
            "{reported} reported, {taken_bytes} taken"
        );
    }

    #[test]
    fn a_writer_always_has_memory_whatever_its_readers_keep() {
        let folder = Scratch::in_memory().unwrap();
        let location = Location::new("cdcrtest_keep_", &folder.path().join("root")).unwrap();
        let node = node(&location).unwrap();
        let writer = incidents(&node, "cdcr").unwrap();
        let name = Service::Incidents.name("cdcr").unwrap();
        let service = node.service_builder(&name).publish_subscribe::<Incident>();
        let service = service.open().unwrap();
        let reader = || service.subscriber_builder().create().unwrap();
        let queues = Service::Incidents.queues();
        let mut readers: Vec<_> = (0..queues.subscribers)
            .map(|_| (reader(), Vec::new()))
            .collect();
        for sequence in 1..=6 * queues.queue as u64 {
            let mut incident = Incident::default();
            incident.header.sequence = sequence;
            assert!(writer.send_copy(incident).is_ok(), "message {sequence}");
            // The first one never reads, the next ones keep the oldest that they get, the last one is replaced.
            for (pace, (reader, held)) in (3..).zip(&mut readers[1..]) {
                if sequence % (pace * 13) == 0 && held.len() == QueueLengths::HELD {
                    held.remove(0);
                }
                if held.len() < QueueLengths::HELD {
                    held.extend(reader.receive().unwrap());
                }
            }
            if sequence % 50 == 0 {
                readers.pop();
                readers.push((reader(), Vec::new()));
            }
        }
    }

    #[test]
    fn what_nobody_has_is_refused_in_words() {
        let space = ShmSpace::new(Path::new(Location::MEMORY), "");
        let Some(free_bytes) = free_bytes(&space.root) else {
            return;
        };
        let refused = space.ask(u64::MAX, 0).unwrap_err();
        assert_eq!(refused.needed, u64::MAX);
        assert!(space.ask(0, 0).is_ok());
        let free = refused.free;
        let what = "the daemon".to_owned();
        let error = ServiceError::Full {
            what,
            lack: refused,
        }
        .to_string();
        assert!(
            error.contains("/dev/shm") && error.contains("MB"),
            "{error}"
        );
        // Other processes use it, too: the free space was about the same a moment ago.
        assert!(free / 2 < free_bytes, "{error}");
    }
}
