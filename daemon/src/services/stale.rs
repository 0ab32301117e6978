//! Orphaned files of a daemon that was killed at its start.
//!
//! iceoryx2 cleans up after dead nodes, but not a service whose second half is missing, nor a node that was
//! killed before its details were written. Whoever claimed the [`Instance`](crate::instance::Instance) is
//! the only one who creates services here, so both are of the dead and in nobody's use.

use std::fmt::Debug;
use std::fs::DirEntry;
use std::path::{Path, PathBuf};
use std::time::Duration;

use cdcr_shared_types::{Location, ipc};
use iceoryx2::config::Config;
use iceoryx2::node::NodeState;
use iceoryx2::prelude::{CallbackProgression, Node, ServiceName};
use iceoryx2::service::Service;
use iceoryx2::service::messaging_pattern::MessagingPattern;
use iceoryx2::service::service_hash::ServiceHash;

type Hasher = <ipc::Service as Service>::ServiceNameHasher;

/// Makes a service with `make`. One that cannot be opened because its creator was killed in the middle is
/// removed first; its memory, if there is any, belongs to a dead node and goes with that.
pub(super) fn make_anew<T, E: Debug>(
    node: &Node<ipc::Service>,
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

/// The same two names in the errors of both patterns, of opening and of creating.
fn is_orphaned(cause: &dyn Debug) -> bool {
    let cause = format!("{cause:?}");
    ["HangsInCreation", "ServiceInCorruptedState"]
        .iter()
        .any(|name| cause.contains(name))
}

/// The file by which clients find a service.
pub(crate) fn service_file(
    config: &Config,
    name: &ServiceName,
    pattern: MessagingPattern,
) -> PathBuf {
    let global = &config.global;
    let hash = ServiceHash::new::<Hasher>(name, pattern);
    let suffix = &global.service.static_config_storage_suffix;
    let file = format!("{}{}{suffix}", global.prefix, hash.as_str());
    Path::new(&global.service_dir().to_string()).join(file)
}

fn remove(node: &Node<ipc::Service>, name: &ServiceName, pattern: MessagingPattern) {
    let path = service_file(node.config(), name, pattern);
    let removed = std::fs::remove_file(&path);
    tracing::warn!(path = %path.display(), ?removed, "a killed daemon left this service orphaned");
}

/// A younger file may belong to a client that is just connecting.
const OLD: Duration = Duration::from_secs(2);

/// Removes what killed processes left and iceoryx2 does not, as long as nobody else is here: nodes that were
/// killed before their details were written, and the memory of orphaned services. Call it before the first
/// node of this process.
pub fn sweep(location: &Location) {
    let Ok(config) = location.iceoryx2_config() else {
        return;
    };
    let mut is_empty = true;
    let listed = Node::<ipc::Service>::list(&config, |state| {
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
        // Only when it is empty.
        let _ = std::fs::remove_dir(folder);
    }
    let services = global.service_dir().to_string();
    for folder in [Path::new(&nodes), Path::new(&services), location.root()] {
        remove_old_files(folder, &prefix);
    }
}

/// Removes the old files of `folder` whose names begin with `prefix`. What cannot be removed stays, as
/// harmless as it was.
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
