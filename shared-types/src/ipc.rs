//! The variant of iceoryx2 that daemon and clients use.

use core::fmt::Debug;
use std::path::{Path, PathBuf};

use iceoryx2::config::Config;
use iceoryx2::prelude::{ServiceName, ZeroCopySend};
use iceoryx2::service;
use iceoryx2::service::messaging_pattern::MessagingPattern;
use iceoryx2::service::service_hash::ServiceHash;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_cal::shm_allocator::bump_allocator::BumpAllocator;
use iceoryx2_cal::shm_allocator::pool_allocator::PoolAllocator;
use iceoryx2_cal::{
    arc_sync_policy, bag, dynamic_storage, event, hash, monitoring, reactor,
    resizable_shared_memory, serialize, shared_memory, static_storage, zero_copy_connection,
};

/// iceoryx2's `ipc::Service` with all memory in files below the root folder of the [`Location`](crate::Location), which
/// belongs to one user. None is in `/dev/shm`, where every user may create files.
///
/// Its files and folders are open to all (iceoryx2's feature `dev_permissions`). Access is controlled by the root
/// folder alone, which the daemon restricts to its user and, if configured, a group.
///
/// Invariant: the root folder is on a tmpfs. The kernel writes mapped files on a disk back to it and blocks threads
/// that access them meanwhile. The daemon checks this at its start.
#[derive(Debug, Clone)]
pub struct Variant {}

impl service::Service for Variant {
    type StaticStorage = static_storage::recommended::Ipc;
    type ConfigSerializer = serialize::recommended::Recommended;
    /// Holds one number that distinguishes the nodes of one process; their identities also contain process id and time.
    /// In a file it would be open to all users (0666).
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        dynamic_storage::process_local::Storage<T>;
    type Bag = bag::recommended::Recommended;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        dynamic_storage::file::Storage<T>;
    type ServiceNameHasher = hash::recommended::Recommended;
    type SharedMemory = shared_memory::file::Memory<PoolAllocator>;
    type ResizableSharedMemory =
        resizable_shared_memory::dynamic::DynamicMemory<PoolAllocator, Self::SharedMemory>;
    type Connection = zero_copy_connection::file::Connection;
    /// Unused: no service of this project sends events.
    type Event = event::recommended::Local;
    type Monitoring = monitoring::recommended::Ipc;
    type Reactor = reactor::recommended::Ipc;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> =
        arc_sync_policy::single_threaded::SingleThreaded<T>;
    type BlackboardMgmt<T: Send + Sync + Debug + ZeroCopySend + 'static> =
        dynamic_storage::file::Storage<T>;
    type BlackboardPayload = shared_memory::file::Memory<BumpAllocator>;
    type UniqueId = iceoryx2::unique_id_generator::unique_system_id::UniqueSystemId;
}

impl service::internal::ServiceInternal<Variant> for Variant {}

/// The file through which clients find a service.
pub fn service_file(config: &Config, name: &ServiceName, pattern: MessagingPattern) -> PathBuf {
    let global = &config.global;
    let hash = ServiceHash::new::<<Variant as service::Service>::ServiceNameHasher>(name, pattern);
    let suffix = &global.service.static_config_storage_suffix;
    let file = format!("{}{}{suffix}", global.prefix, hash.as_str());
    Path::new(&global.service_dir().to_string()).join(file)
}

const ALL_TAKEN: &str = "all places are taken";
const SYSTEM_REFUSED: &str = "the system refused a file, a lock or memory";

/// Meaning for users of a common iceoryx2 failure.
fn meaning(failure: &str) -> Option<&'static str> {
    Some(match failure {
        "ConnectionBrokenSinceSenderNoLongerExists" => "the other side has ended",
        "ConnectionCorrupted" => "the connection is damaged",
        "ConnectionError" | "ConnectionFailure" => "no connection",
        "ExceedsMaxActiveRequests" => "too many requests wait for their answers",
        "ExceedsMaxBorrows" => "too many received messages are held at once",
        "ExceedsMaxLoans" => "too many messages are written at once",
        "ExceedsMaxSupportedClients"
        | "ExceedsMaxSupportedPublishers"
        | "ExceedsMaxSupportedSubscribers" => ALL_TAKEN,
        "FailedToEstablishConnection" => "cannot create or open its file",
        "InsufficientPermissions" => "permission denied for its files",
        "InternalError" | "InternalFailure" => SYSTEM_REFUSED,
        "UnableToCreateDataSegment" => "cannot create the memory for its messages",
        "UnableToCreatePortTag" => "cannot create its marker file",
        "UnableToMapSendersDataSegment" => "cannot map the memory of the sender",
        _ => return None,
    })
}

/// Meaning of an iceoryx2 failure in words. A cause without a text is given by its name: `SystemCorrupted` → "system
/// corrupted".
pub fn words(cause: &dyn Debug) -> String {
    let names = format!("{cause:?}");
    let names = names.split(['(', ')']).filter(|name| !name.is_empty());
    let words: Vec<_> = names
        .map(|name| meaning(name).map_or_else(|| split_name(name), str::to_owned))
        .collect();
    words.join(": ")
}

fn split_name(name: &str) -> String {
    let mut words = String::new();
    for character in name.chars() {
        if character.is_ascii_uppercase() {
            if words.ends_with(|before: char| before.is_ascii_alphanumeric()) {
                words.push(' ');
            }
            words.push(character.to_ascii_lowercase());
        } else {
            words.push(character);
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use iceoryx2::node::NodeCreationFailure;
    use iceoryx2::port::ReceiveError;
    use iceoryx2::port::publisher::PublisherCreateError;
    use iceoryx2::port::update_connections::ConnectionFailure;
    use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError;
    use iceoryx2_cal::zero_copy_connection::ZeroCopyCreationError;

    use super::{ALL_TAKEN, SYSTEM_REFUSED, words};

    #[test]
    fn failures_are_described_in_words() {
        assert_eq!(
            words(&PublishSubscribeOpenError::InternalFailure),
            SYSTEM_REFUSED
        );
        assert_eq!(
            words(&PublisherCreateError::ExceedsMaxSupportedPublishers),
            ALL_TAKEN
        );
        let cause = ZeroCopyCreationError::InternalError;
        let failed = ConnectionFailure::FailedToEstablishConnection(cause);
        assert_eq!(
            words(&ReceiveError::ConnectionFailure(failed)),
            "no connection: cannot create or open its file: the system refused a file, a lock or memory"
        );
        // A cause without a text of its own.
        assert_eq!(
            words(&NodeCreationFailure::SystemCorrupted),
            "system corrupted"
        );
    }
}
