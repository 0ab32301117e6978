//! Whether clients still find this daemon: what they look for lies in files, which anybody with the right to can delete.

use std::fs::{File, Metadata, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use cdcr_shared_types::{Location, Service};
use iceoryx2::service::messaging_pattern::MessagingPattern;
use rustix::fs::{FlockOperation, flock};

use super::{InstanceError, file_error, is_file_at, lock, write_process_id};
use crate::services::remains;

/// What clients need to find a daemon, as it was when the daemon began.
#[derive(Debug)]
pub(crate) struct PlaceWatch {
    location: Location,
    robot: String,
    root: File,
    /// Who may use it.
    mode: u32,
    lock: Arc<Mutex<File>>,
    name: Option<Arc<UnixListener>>,
    services: Vec<(PathBuf, Option<u64>)>,
}

/// What became of the place.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Found {
    /// All is there.
    Whole,
    /// The lock file was missing and has been made again.
    Mended,
    /// Clients cannot find this daemon any more, and it cannot change that.
    Lost {
        /// What is missing or is another one.
        path: PathBuf,
    },
}

/// Of those who ask for the holder of the name, so many are let go at one look: anybody may ask, as often as he likes.
const LET_GO_MAX: usize = 256;

impl PlaceWatch {
    pub(super) fn new(
        location: &Location,
        robot: &str,
        lock: Arc<Mutex<File>>,
        name: Option<Arc<UnixListener>>,
    ) -> Result<Self, InstanceError> {
        let failed = |cause| file_error(location.root(), cause);
        let root = File::open(location.root()).map_err(failed)?;
        Ok(Self {
            mode: root.metadata().map_err(failed)?.mode(),
            root,
            location: location.clone(),
            robot: robot.to_owned(),
            lock,
            name,
            services: service_files(location, robot)
                .map(|path| {
                    let inode = inode(&path);
                    (path, inode)
                })
                .collect(),
        })
    }

    /// Looks whether the files are those of the beginning, and makes the lock file again where it is missing.
    pub(crate) fn look(&self) -> Found {
        // Programs that delete old files leave a locked folder alone. Another one may have it for a moment.
        let _ = flock(&self.root, FlockOperation::NonBlockingLockShared);
        if !is_file_at(&self.root, self.location.root()) {
            let path = self.location.root().to_owned();
            return Found::Lost { path };
        }
        self.look_at_mode();
        let missing = self
            .services
            .iter()
            .find(|(path, before)| inode(path) != *before);
        if let Some((path, _)) = missing {
            let path = path.clone();
            return Found::Lost { path };
        }
        self.look_at_lock()
    }

    /// Closes the folder again where somebody opened it: nothing else keeps others from the files in it.
    fn look_at_mode(&self) {
        let is_changed = |root: Metadata| root.mode() != self.mode;
        if self.root.metadata().is_ok_and(is_changed) {
            let mended = self
                .root
                .set_permissions(Permissions::from_mode(self.mode & 0o7777));
            tracing::warn!(
                ?mended,
                "the permissions of the root folder were changed: set back"
            );
        }
    }

    fn look_at_lock(&self) -> Found {
        let path = self.location.lock_file(&self.robot);
        let mut held = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
        if is_file_at(&held, &path) {
            return Found::Whole;
        }
        if path.symlink_metadata().is_ok() {
            // Another daemon has made it.
            return Found::Lost { path };
        }
        let made = lock(&path, &self.location, &self.robot).and_then(|mut file| {
            write_process_id(&mut file).map_err(|cause| file_error(&path, cause))?;
            Ok(file)
        });
        match made {
            Ok(file) => {
                *held = file;
                Found::Mended
            }
            Err(_) => Found::Lost { path },
        }
    }

    /// Lets those go who asked for the holder of the name: the kernel has answered them.
    pub(crate) fn let_go(&self) {
        let Some(name) = &self.name else { return };
        for _ in 0..LET_GO_MAX {
            if name.accept().is_err() {
                break;
            }
        }
    }

    /// Where it is.
    pub(crate) fn location(&self) -> &Location {
        &self.location
    }
}

fn inode(path: &Path) -> Option<u64> {
    path.symlink_metadata().ok().map(|file| file.ino())
}

/// The files by which clients find the services of `robot`.
fn service_files(location: &Location, robot: &str) -> impl Iterator<Item = PathBuf> {
    let config = location.iceoryx2_config().ok();
    Service::ALL.into_iter().filter_map(move |service| {
        let pattern = match service {
            Service::Control => MessagingPattern::RequestResponse,
            _ => MessagingPattern::PublishSubscribe,
        };
        let name = service.name(robot).ok()?;
        Some(remains::service_file(config.as_ref()?, &name, pattern))
    })
}
