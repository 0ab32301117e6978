//! Checks that clients still find this daemon: they use files that every authorised user can delete.

use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use cdcr_shared_types::{Location, Service, ipc};
use iceoryx2::service::messaging_pattern::MessagingPattern;

use super::{Instance, acl, file_error, is_file_at, lock, write_process_id};

/// The files that clients need to find the daemon, as they were at its start.
#[derive(Debug)]
pub(crate) struct PlaceWatch {
    location: Location,
    robot: String,
    root: Arc<File>,
    /// Group with access in addition to the owner.
    group_id: Option<u32>,
    lock: Arc<Mutex<File>>,
    name: Option<Arc<UnixListener>>,
    services: Vec<(PathBuf, Option<u64>)>,
}

#[derive(Debug, PartialEq, Eq)]
pub(crate) enum PlaceCheck {
    /// All files are present.
    Whole,
    /// The lock file was missing and has been created again.
    Restored,
    /// Clients cannot find this daemon any more, and it cannot repair that.
    Lost {
        /// The missing or replaced file.
        path: PathBuf,
    },
}

/// Clients disconnected per check from the socket of the name: any user may connect, any number of times.
const DISCONNECTS_MAX: usize = 256;

impl PlaceWatch {
    pub(super) fn new(instance: &Instance, robot: &str) -> Self {
        let location = &instance.location;
        Self {
            location: location.clone(),
            robot: robot.to_owned(),
            root: Arc::clone(&instance.root),
            group_id: instance.group_id,
            lock: Arc::clone(&instance.locked),
            name: instance.name.clone(),
            services: service_files(location, robot)
                .map(|path| {
                    let inode = inode(&path);
                    (path, inode)
                })
                .collect(),
        }
    }

    /// Checks that the files are those of the start, and creates a missing lock file again.
    pub(crate) fn check(&self) -> PlaceCheck {
        if !is_file_at(&self.root, self.location.root()) {
            let path = self.location.root().to_owned();
            return PlaceCheck::Lost { path };
        }
        self.restore_access();
        let missing = self
            .services
            .iter()
            .find(|(path, before)| inode(path) != *before);
        if let Some((path, _)) = missing {
            let path = path.clone();
            return PlaceCheck::Lost { path };
        }
        self.check_lock()
    }

    /// Restores the access of the folder if somebody changed it: only the folder protects its files.
    fn restore_access(&self) {
        if !acl::is_for(&self.root, self.group_id) {
            let restored = acl::set_for(&self.root, self.group_id);
            tracing::warn!(
                ?restored,
                "restored the permissions of the root folder: its mode or its access control list had been changed"
            );
        }
    }

    fn check_lock(&self) -> PlaceCheck {
        let path = self.location.lock_file(&self.robot);
        let mut held = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
        if is_file_at(&held, &path) {
            return PlaceCheck::Whole;
        }
        if path.symlink_metadata().is_ok() {
            // Another daemon has created it.
            return PlaceCheck::Lost { path };
        }
        let made = lock(&path, &self.location, &self.robot).and_then(|mut file| {
            write_process_id(&mut file).map_err(|cause| file_error(&path, cause))?;
            Ok(file)
        });
        match made {
            Ok(file) => {
                *held = file;
                PlaceCheck::Restored
            }
            Err(_) => PlaceCheck::Lost { path },
        }
    }

    /// Disconnects the clients that asked for the holder of the name: the kernel has answered them.
    pub(crate) fn disconnect_clients(&self) {
        let Some(name) = &self.name else { return };
        for _ in 0..DISCONNECTS_MAX {
            if name.accept().is_err() {
                break;
            }
        }
    }

    pub(crate) fn location(&self) -> &Location {
        &self.location
    }
}

fn inode(path: &Path) -> Option<u64> {
    path.symlink_metadata().ok().map(|file| file.ino())
}

/// The files through which clients find the services of `robot`.
fn service_files(location: &Location, robot: &str) -> impl Iterator<Item = PathBuf> {
    let config = location.iceoryx2_config().ok();
    Service::ALL.into_iter().filter_map(move |service| {
        let pattern = match service {
            Service::Control => MessagingPattern::RequestResponse,
            _ => MessagingPattern::PublishSubscribe,
        };
        let name = service.name(robot).ok()?;
        Some(ipc::service_file(config.as_ref()?, &name, pattern))
    })
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    use cdcr_scratch::Scratch;

    use super::*;

    /// A group that need not exist.
    const GROUP: u32 = 64_321;

    #[test]
    fn a_changed_access_to_the_folder_is_set_back_and_it_stays_locked() {
        let folder = Scratch::in_memory().unwrap();
        let location = Location::new("cdcrtest_place_", &folder.path().join("root")).unwrap();
        let instance = Instance::claim(&location, "a", None).unwrap();
        let mut watch = instance.watch("a");
        for group_id in [None, Some(GROUP)] {
            watch.group_id = group_id;
            let assert_set_back = || {
                assert_eq!(watch.check(), PlaceCheck::Whole);
                assert!(acl::is_for(&watch.root, group_id), "{group_id:?}");
            };
            let open = Permissions::from_mode(0o777);
            watch.root.set_permissions(open).unwrap();
            assert_set_back();
            // The mode of a folder with an access control list remains the same.
            acl::set_for(&watch.root, Some(GROUP + 1)).unwrap();
            assert_set_back();
            acl::set_for(&watch.root, None).unwrap();
            assert_set_back();
        }
        let another = File::open(location.root()).unwrap();
        assert!(another.try_lock().is_err());
        drop((instance, watch));
        // A child process of another test may hold a copy of the lock until it executes its program.
        another.lock().unwrap();
    }
}
