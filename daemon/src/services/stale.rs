//! Orphaned files of a daemon that was killed at its start.
//!
//! iceoryx2 cleans up after dead nodes, but not a service whose second half is missing, nor a node killed
//! before its details were written. Only the process that has claimed the
//! [`Instance`](crate::instance::Instance) creates services here, so both belong to dead processes and are
//! not in use.

use std::fmt::Debug;
use std::fs::DirEntry;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

use cdcr_shared_types::{Location, ipc};
use iceoryx2::config::Config;
use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::node::NodeState;
use iceoryx2::prelude::{CallbackProgression, Node, ServiceName};
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::messaging_pattern::MessagingPattern;
use iceoryx2::service::service_hash::ServiceHash;

/// Creates a service with `make`. First removes a service that cannot be opened because its creator was
/// killed half-way. Its memory, if any, belongs to a dead node and is removed with that.
pub(super) fn create_or_replace<T, E: Debug>(
    node: &Node<ipc::Variant>,
    name: &ServiceName,
    pattern: MessagingPattern,
    make: impl Fn() -> Result<T, E>,
) -> Result<T, E> {
    match make() {
        Err(cause) if is_orphaned(&cause) => {
            remove(node, name, pattern);
            make()
        }
        result => result,
    }
}

/// The errors of both patterns, of opening and of creating, use the same two names.
fn is_orphaned(cause: &dyn Debug) -> bool {
    let cause = format!("{cause:?}");
    ["HangsInCreation", "ServiceInCorruptedState"]
        .iter()
        .any(|name| cause.contains(name))
}

/// The node that a port belongs to, and the port's number.
pub(super) type PortOfNode = (UniqueNodeId, u128);

/// Longest wait for a place occupied by a dead process.
const FREE_WITHIN: Duration = Duration::from_secs(2);
/// After this time no other process is still removing the resources of a dead one.
const LOST_AFTER: Duration = Duration::from_secs(1);

/// Creates a port with `create`. If `is_full` reports that all places of `service` are taken, the places of
/// dead processes are freed first; `ports` lists the owners. If all owners are alive, the error is returned
/// at once.
pub(super) fn create_in_free_slot<P, E>(
    node: &Node<ipc::Variant>,
    service: &ServiceHash,
    ports: impl Fn(&mut Vec<PortOfNode>),
    is_full: impl Fn(&E) -> bool,
    create: impl Fn() -> Result<P, E>,
) -> Result<P, E> {
    let begin = Instant::now();
    let mut is_last = false;
    loop {
        let result = create();
        if is_last || !result.as_ref().is_err_and(&is_full) {
            return result;
        }
        // List the ports before the nodes: a process that starts in between has no place here.
        let mut lost = Vec::new();
        ports(&mut lost);
        let Some(nodes) = Nodes::list(node.config()) else {
            return result;
        };
        lost.retain(|(owner, _)| !nodes.living.contains(owner));
        if lost.is_empty() {
            return result;
        }
        let waited = begin.elapsed();
        if waited > LOST_AFTER {
            lost.retain(|(owner, _)| !nodes.dead.contains(owner));
            remove_lost_ports(node.config(), service, &lost);
        }
        is_last = waited > FREE_WITHIN;
        thread::sleep(Duration::from_millis(10));
    }
}

/// All processes that use shared memory or have left resources there.
#[derive(Default)]
struct Nodes {
    living: Vec<UniqueNodeId>,
    dead: Vec<UniqueNodeId>,
}

impl Nodes {
    /// Lists the nodes, and tries to remove the resources of dead ones. `None` if they cannot be listed.
    fn list(config: &Config) -> Option<Self> {
        let mut nodes = Self::default();
        let listed = Node::<ipc::Variant>::list(config, |state| {
            let id = *state.node_id();
            if let NodeState::Dead(dead) = state {
                nodes.dead.push(id);
                // Another process may be removing it, too.
                let _ = dead.try_remove_stale_resources();
            } else {
                nodes.living.push(id);
            }
            CallbackProgression::Continue
        });
        listed.is_ok().then_some(nodes)
    }
}

/// Removes the ports of removed nodes from a service that clients keep open.
///
/// A process killed during its clean-up may have removed the tag of a dead process's port, but not the port.
/// iceoryx2 skips a port without a tag, so the port would occupy its place while any process keeps the
/// service open. With a new tag iceoryx2 removes it.
fn remove_lost_ports(config: &Config, service: &ServiceHash, ports: &[PortOfNode]) {
    for (owner, port) in ports {
        let global = &config.global;
        let folder = Path::new(&global.node_dir().to_string()).join(owner.value().to_string());
        let suffix = &global.node.port_tag_suffix;
        let tag = folder.join(format!("{}{port}{suffix}", global.prefix));
        let made = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&tag, ""));
        let removed = ipc::Variant::__internal_remove_node_from_service(owner, service, config);
        let _ = std::fs::remove_file(tag);
        // Only removed if empty.
        let _ = std::fs::remove_dir(folder);
        tracing::warn!(?made, ?removed, "found a stale port of a dead process");
    }
}

fn remove(node: &Node<ipc::Variant>, name: &ServiceName, pattern: MessagingPattern) {
    let path = ipc::service_file(node.config(), name, pattern);
    let removed = std::fs::remove_file(&path);
    tracing::warn!(path = %path.display(), ?removed, "a killed daemon left this service orphaned");
}

/// A newer file may belong to a client that is just connecting.
const OLD: Duration = Duration::from_secs(2);

/// Removes what killed processes left and iceoryx2 does not remove, if no other process is connected: nodes
/// killed before their details were written, and the memory of orphaned services. Call it before the first
/// node of this process.
pub fn sweep(location: &Location) {
    let Ok(config) = location.iceoryx2_config() else {
        return;
    };
    let mut is_empty = true;
    let listed = Node::<ipc::Variant>::list(&config, |state| {
        is_empty &= !matches!(state, NodeState::Alive(_) | NodeState::Inaccessible(_));
        CallbackProgression::Continue
    });
    if listed.is_err() || !is_empty {
        return;
    }
    let global = &config.global;
    let prefix = location.file_prefix();
    let nodes = global.node_dir().to_string();
    for folder in old_entries(Path::new(&nodes)).filter(|path| path.is_dir()) {
        remove_old_files(&folder, &prefix);
        // Only removed if empty.
        let _ = std::fs::remove_dir(folder);
    }
    let services = global.service_dir().to_string();
    for folder in [Path::new(&nodes), Path::new(&services), location.root()] {
        remove_old_files(folder, &prefix);
    }
}

/// Removes the old files of `folder` whose names begin with `prefix`. Files that cannot be removed remain,
/// without harm.
fn remove_old_files(folder: &Path, prefix: &str) {
    for path in old_entries(folder) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with(prefix) && path.is_file() {
            let _ = std::fs::remove_file(path);
        }
    }
}

fn old_entries(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_old = |entry: &DirEntry| {
        let changed = entry.metadata().and_then(|metadata| metadata.modified());
        let age = changed.ok().and_then(|time| time.elapsed().ok());
        age.is_some_and(|age| age > OLD)
    };
    entries.filter(is_old).map(|entry| entry.path())
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;
    use cdcr_shared_types::{Service, Status};

    use super::super::{ServiceError, node, publisher};
    use super::*;

    /// Removes the files through which others know the node, and its other files in the folder of the nodes.
    fn forget(node: &Node<ipc::Variant>) {
        let folder = node.config().global.node_dir().to_string();
        let id = node.id().value().to_string();
        for entry in std::fs::read_dir(folder).unwrap().flatten() {
            let path = entry.path();
            if !entry.file_name().to_string_lossy().contains(&id) {
                continue;
            }
            if path.is_dir() {
                std::fs::remove_dir_all(path).unwrap();
            } else {
                std::fs::remove_file(path).unwrap();
            }
        }
    }

    #[test]
    fn a_port_that_outlived_its_node_gives_its_place_away_and_one_that_lives_keeps_it() {
        let folder = Scratch::in_memory().unwrap();
        let location = Location::new("cdcrtest_lost_", &folder.path().join("root")).unwrap();
        let first = node(&location).unwrap();
        let lost = publisher::<Status>(&first, Service::Status, "cdcr").unwrap();
        let second = node(&location).unwrap();
        let refused = publisher::<Status>(&second, Service::Status, "cdcr").unwrap_err();
        assert!(matches!(refused, ServiceError::Taken { .. }), "{refused}");
        lost.send_copy(Status::default()).unwrap();
        forget(&first);
        let publisher = publisher::<Status>(&second, Service::Status, "cdcr").unwrap();
        publisher.send_copy(Status::default()).unwrap();
        // Their destructors would remove files that are gone.
        std::mem::forget((lost, first));
    }
}
