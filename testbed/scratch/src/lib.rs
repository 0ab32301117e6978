//! Private folders for tests and measurements. Dropping one removes it. What a killed process left is removed
//! and reported when the next process creates its first folder ([`sweep`]).
//!
//! Invariant: nothing here knows a daemon, a robot or iceoryx2, so that the tests of every crate can use it.

mod sweep;

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use tempfile::TempDir;

pub use sweep::{PREFIX, sweep};

/// The public folder in shared memory.
pub const MEMORY: &str = "/dev/shm";

/// The public folder on a disk.
const DISK: &str = "/var/tmp";

/// A private folder, locked until its process ends. Dropping it removes the folder with its contents.
#[derive(Debug)]
pub struct Scratch {
    prefix: String,
    folder: TempDir,
    /// The lock is visible to processes of other containers; the process id is not.
    _lock: File,
}

impl Scratch {
    /// Creates a folder for temporary files.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn temporary() -> io::Result<Self> {
        Self::new(&std::env::temp_dir())
    }

    /// Creates a folder in shared memory.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn in_memory() -> io::Result<Self> {
        Self::new(Path::new(MEMORY))
    }

    /// Creates a folder on a disk: beside the programs built with a test, otherwise in a public folder that
    /// survives a reboot.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn on_disk() -> io::Result<Self> {
        let built = sweep::folder_of_test_programs().map(|folder| Self::new(&folder));
        match built {
            Some(Ok(folder)) => Ok(folder),
            _ => Self::new(Path::new(DISK)),
        }
    }

    fn new(parent: &Path) -> io::Result<Self> {
        sweep::sweep_once();
        loop {
            let prefix = fresh_prefix();
            let folder = tempfile::Builder::new()
                .prefix(&prefix)
                .tempdir_in(parent)?;
            let lock = File::open(folder.path())?;
            // A process with the same id in another container may hold the lock, or its sweep may have
            // removed the folder.
            if lock.try_lock().is_ok() && folder.path().exists() {
                return Ok(Self {
                    prefix,
                    folder,
                    _lock: lock,
                });
            }
        }
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// First part of the folder's name. Other files of the same owner begin with it, too, so that the sweep
    /// finds them.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }
}

/// A prefix that is unique in this process.
fn fresh_prefix() -> String {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    format!("{PREFIX}{}_{number}_", std::process::id())
}

/// Folders in which private folders are created and swept.
fn parents() -> Vec<PathBuf> {
    let open_to_all = [MEMORY.into(), std::env::temp_dir(), DISK.into()];
    let mut parents: Vec<PathBuf> = open_to_all.into();
    parents.extend(sweep::folder_of_test_programs());
    // Two paths may lead to the same folder.
    let mut parents: Vec<PathBuf> = parents.iter().flat_map(fs::canonicalize).collect();
    parents.sort();
    parents.dedup();
    parents
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_folders_are_apart_and_leave_nothing() {
        for make in [Scratch::temporary, Scratch::in_memory, Scratch::on_disk] {
            let (one, other) = (make().unwrap(), make().unwrap());
            assert_ne!(one.prefix(), other.prefix());
            fs::write(one.path().join("file"), "").unwrap();
            let path = one.path().to_owned();
            drop(one);
            assert!(!path.exists() && other.path().exists());
        }
    }
}
