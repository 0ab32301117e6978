//! Private folders of tests and measurements. Dropping one removes it; what a killed process left, the first folder of the
//! next process removes, and says so ([`sweep`]).
//!
//! Invariant: nothing here knows a daemon, a robot or iceoryx2, so that every crate can use it for its tests.

mod sweep;

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use tempfile::TempDir;

pub use sweep::{PREFIX, sweep};

/// The folder in memory that is open to all.
pub const MEMORY: &str = "/dev/shm";

/// The folder on a disk that is open to all.
const DISK: &str = "/var/tmp";

/// A private folder, locked as long as its process lives. Dropping it removes it with all that is in it.
#[derive(Debug)]
pub struct Scratch {
    prefix: String,
    folder: TempDir,
    /// A process of another container has no number here, but holds its lock.
    _lock: File,
}

impl Scratch {
    /// One in the folder for temporary files.
    ///
    /// # Errors
    /// That it cannot be made there.
    pub fn temporary() -> io::Result<Self> {
        Self::new(&std::env::temp_dir())
    }

    /// One in memory.
    ///
    /// # Errors
    /// That it cannot be made there.
    pub fn in_memory() -> io::Result<Self> {
        Self::new(Path::new(MEMORY))
    }

    /// One on a disk: where a test finds the programs that were built with it, or, where it may not write there, where files outlive a boot.
    ///
    /// # Errors
    /// That it cannot be made there.
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
            // A process of the same number in another container may have it, or its sweep may have been faster.
            if lock.try_lock().is_ok() && folder.path().exists() {
                return Ok(Self {
                    prefix,
                    folder,
                    _lock: lock,
                });
            }
        }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// What its name begins with, and what the names of other files of its owner begin with, so that they are swept with it.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }
}

/// A prefix that nobody else in this process has.
fn fresh_prefix() -> String {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    format!("{PREFIX}{}_{number}_", std::process::id())
}

/// Where folders are made, and what killed processes left is looked for.
fn parents() -> Vec<PathBuf> {
    let open_to_all = [MEMORY.into(), std::env::temp_dir(), DISK.into()];
    let mut parents: Vec<PathBuf> = open_to_all.into();
    parents.extend(sweep::folder_of_test_programs());
    // One folder may have two names.
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
