//! A private place: a folder in shared memory and a folder for temporary files. Dropping it removes both.
//! What a killed process left is removed by the next process (`cdcr_scratch`).

use std::fs::{self, File, OpenOptions};
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
pub use cdcr_scratch::PREFIX;
use cdcr_scratch::Scratch;
use cdcr_shared_types::Location;
use rustix::fs::OFlags;

/// Last part of the name of a place's root folder.
pub const ROOT: &str = "root";

/// Names that are tried while files of other users have them.
const NAMES_MAX: u32 = 100;

/// A prefix and a folder that no other process uses.
#[derive(Debug)]
pub struct PrivatePlace {
    location: Location,
    folder: Scratch,
    /// File in shared memory, locked until its process ends, like the folder. A process of another container
    /// may see only one of the two locks.
    _lock: File,
}

impl PrivatePlace {
    pub fn new() -> Result<Self> {
        let mut names = 1..NAMES_MAX;
        loop {
            let folder = super::folder()?;
            let in_memory =
                |part: &str| Path::new(Location::MEMORY).join(format!("{}{part}", folder.prefix()));
            let location = Location::new(folder.prefix(), &in_memory(ROOT));
            let location = location.context("the names of a place")?;
            let locked = in_memory("lock");
            let mut options = OpenOptions::new();
            let file = options.write(true).create(true).truncate(false).mode(0o600);
            let file = file.custom_flags(OFlags::NOFOLLOW.bits().cast_signed());
            let lock = match file.open(&locked) {
                // Another user has a file of this name.
                Err(cause)
                    if cause.kind() == ErrorKind::PermissionDenied && names.next().is_some() =>
                {
                    continue;
                }
                lock => lock.with_context(|| format!("cannot write {}", locked.display()))?,
            };
            // A process with the same id in another container may hold the lock, or its sweep may have
            // removed the file.
            if lock.try_lock().is_ok() && locked.exists() {
                return Ok(Self {
                    location,
                    folder,
                    _lock: lock,
                });
            }
        }
    }

    pub fn location(&self) -> &Location {
        &self.location
    }

    /// Folder for temporary files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Files that are mapped into memory.
    pub fn memory_files(&self) -> Vec<PathBuf> {
        self.location.memory_files()
    }
}

impl Drop for PrivatePlace {
    fn drop(&mut self) {
        // The lock, and the root folder even if a test has renamed it.
        for path in in_public_memory(self.location.prefix()) {
            let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(path));
        }
    }
}

/// Entries of the public shared-memory folder whose names begin with `prefix`.
pub fn in_public_memory(prefix: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(Location::MEMORY).into_iter().flatten();
    let paths = entries.flatten().map(|entry| entry.path());
    let name = |path: &Path| path.file_name().unwrap_or_default().as_bytes().to_owned();
    let is_meant = |path: &PathBuf| name(path).starts_with(prefix.as_bytes());
    paths.filter(is_meant).collect()
}

/// A process of `cdcrd` with a file of a place with this prefix in its command line: of a subcommand, or of any if
/// empty. Zombies do not count.
pub fn cdcrd_in(prefix: &str, subcommand: &str) -> Option<u32> {
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    let mut ids = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let program = format!("cdcrd\0{subcommand}");
    ids.find(|id| {
        let line = fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
        let line = String::from_utf8_lossy(&line);
        line.contains(&program) && line.contains(prefix)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_in_memory_is_swept() {
        assert_eq!(cdcr_scratch::MEMORY, Location::MEMORY);
    }

    #[test]
    fn two_places_are_apart_and_leave_nothing() {
        let (one, other) = (PrivatePlace::new().unwrap(), PrivatePlace::new().unwrap());
        assert_ne!(one.location(), other.location());
        let (folder, prefix) = (one.folder().to_owned(), one.location().prefix().to_owned());
        fs::create_dir(one.location().root()).unwrap();
        assert_eq!(in_public_memory(&prefix).len(), 2);
        drop(one);
        assert!(!folder.exists() && other.folder().exists());
        assert_eq!(in_public_memory(&prefix), Vec::<PathBuf>::new());
        assert_eq!(in_public_memory(other.location().prefix()).len(), 1);
    }
}
