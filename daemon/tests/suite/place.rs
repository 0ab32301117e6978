use std::fs::File;
use std::path::Path;

use tempfile::TempDir;

/// A folder for temporary files, and the beginning of the names of its daemon in shared memory. What a killed run leaves
/// of both, the next run of the system's tests removes (tests/src/sweep.rs): it knows the name, and leaves alone what is
/// locked.
#[derive(Debug)]
pub(crate) struct Place {
    prefix: String,
    folder: TempDir,
    _lock: File,
}

impl Place {
    /// `name` is without underscores, and of one test only.
    pub(crate) fn new(name: &str) -> Self {
        let prefix = format!("cdcrtest_{}_{name}_", std::process::id());
        let folder = tempfile::Builder::new().prefix(&prefix).tempdir().unwrap();
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

impl Drop for Place {
    fn drop(&mut self) {
        for entry in std::fs::read_dir("/dev/shm")
            .into_iter()
            .flatten()
            .flatten()
        {
            if entry
                .file_name()
                .to_string_lossy()
                .starts_with(&self.prefix)
            {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }
}
