//! A private place in shared memory. Dropping it removes every trace.

use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use cdcr_shared_types::{Location, memory_files};
use tempfile::TempDir;

/// Name of the robot of every measurement.
pub const ROBOT: &str = "bench";

/// A prefix and a folder that nobody else uses.
#[derive(Debug)]
pub struct Place {
    location: Location,
    folder: TempDir,
}

impl Place {
    /// A fresh one.
    ///
    /// # Errors
    /// When the folder for temporary files cannot be written, or its name is too long.
    pub fn new() -> Result<Self> {
        let folder = tempfile::Builder::new()
            .prefix("cdcr-bench-")
            .tempdir()
            .context("a folder for temporary files")?;
        let random = RandomState::new().build_hasher().finish() as u32;
        let prefix = format!("cdcr-bench-{}-{random:08x}_", std::process::id());
        let location = Location::new(&prefix, &folder.path().join("root"))
            .context("the folder lies in TMPDIR: set TMPDIR to a shorter absolute path")?;
        Ok(Self { location, folder })
    }

    /// Where daemon and clients meet.
    pub fn location(&self) -> &Location {
        &self.location
    }

    /// The folder of this place; its sub-folder `root` is iceoryx2's.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The files of this place in shared memory.
    pub fn memory_files(&self) -> Vec<PathBuf> {
        memory_files(&self.location.file_prefix())
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        for file in self.memory_files() {
            let _ = std::fs::remove_file(file);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_places_are_apart_and_leave_nothing() {
        let (one, other) = (
            Place::new().expect("a place"),
            Place::new().expect("a place"),
        );
        assert_ne!(one.location(), other.location());
        let folder = one.folder().to_owned();
        drop(one);
        assert!(!folder.exists() && other.folder().exists());
    }
}
