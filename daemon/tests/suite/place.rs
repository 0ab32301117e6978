use std::fs::File;
use std::path::Path;

use cdcr_shared_types::Location;
use tempfile::TempDir;

/// A folder in memory for all files of a test, and the prefix of its daemon. What a killed run leaves, the next run of the
/// system's tests removes (testbed/src/subject/sweep.rs): it knows the name, and leaves alone what is locked.
#[derive(Debug)]
pub(crate) struct Place {
    prefix: String,
    folder: TempDir,
    _lock: File,
}

impl Place {
    /// `name` is without underscores, and of one test only.
    pub(crate) fn new(name: &str) -> Self {
        let prefix = format!("cdcrbed_{}_{name}_", std::process::id());
        let builder = tempfile::Builder::new()
            .prefix(&prefix)
            .tempdir_in(Location::MEMORY);
        let folder = builder.unwrap();
        let lock = File::open(folder.path()).unwrap();
        lock.lock().unwrap();
        Self {
            prefix,
            folder,
            _lock: lock,
        }
    }

    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn prefix(&self) -> &str {
        &self.prefix
    }
}
