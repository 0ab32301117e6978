use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use cdcr_shared_types::memory_files;

/// A file that stays empty for this long was left by a dead process: the living need microseconds, and on a crowded core
/// some tenths of a second until they are let run.
const PATIENCE: Duration = Duration::from_secs(1);
/// The same while a daemon starts or ends, which waits for it.
const PATIENCE_AT_START: Duration = Duration::from_millis(250);

/// Removes what a client left in shared memory that was killed while it made a file.
///
/// iceoryx2 0.10 makes a file empty and write-only, and then gives it its size. Of a client that is killed
/// between the two an empty file stays, and whoever clears away after the dead client waits for its size
/// without end: each new client, each new daemon, and the daemon that ends.
#[derive(Debug)]
pub struct UnfinishedFiles {
    prefix: String,
    looked: Instant,
    seen: Vec<Unfinished>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Unfinished {
    path: PathBuf,
    inode: u64,
}

impl UnfinishedFiles {
    /// Those whose names begin with `prefix`.
    pub fn new(prefix: String) -> Self {
        let seen = find(&prefix);
        Self {
            prefix,
            looked: Instant::now(),
            seen,
        }
    }

    /// Looks once a second, and removes what is as unfinished as at the look before.
    pub fn look(&mut self) {
        if self.looked.elapsed() >= PATIENCE {
            self.remove_what_stayed();
        }
    }

    /// Removes what is unfinished now, and still is a quarter of a second later. Takes that time only if there is
    /// something, so that a daemon which was killed itself is soon back.
    pub fn clear(mut self) {
        if !self.seen.is_empty() {
            std::thread::sleep(PATIENCE_AT_START);
            self.remove_what_stayed();
        }
    }

    fn remove_what_stayed(&mut self) {
        let found = find(&self.prefix);
        for file in found.iter().filter(|file| self.seen.contains(file)) {
            tracing::warn!(path = %file.path.display(), "removed: a client was killed while it made this file");
            // Somebody else may have been faster.
            let _ = std::fs::remove_file(&file.path);
        }
        self.seen = found;
        self.looked = Instant::now();
    }
}

fn find(prefix: &str) -> Vec<Unfinished> {
    let found = memory_files(prefix).into_iter().filter_map(|path| {
        let file = path.symlink_metadata().ok().filter(is_unfinished)?;
        let inode = file.ino();
        Some(Unfinished { path, inode })
    });
    found.collect()
}

/// As iceoryx2 makes it: empty, and for nobody to read.
fn is_unfinished(file: &Metadata) -> bool {
    file.len() == 0 && file.mode() & 0o777 == 0o200
}

#[cfg(test)]
mod tests {
    #![allow(
        clippy::unwrap_used,
        reason = "in a test a panic is the report, in its helpers, too"
    )]

    use std::fs::{File, OpenOptions, remove_file};
    use std::os::unix::fs::OpenOptionsExt;
    use std::path::Path;

    use super::*;

    #[test]
    fn what_stays_unfinished_is_removed_and_nothing_else() {
        let prefix = format!("cdcrtest_unfinished_{}_", std::process::id());
        let path = |name| Path::new("/dev/shm").join(format!("{prefix}{name}"));
        let [left, growing, readable] = ["left", "growing", "readable"].map(path);
        let make = |path, mode| {
            let mut options = OpenOptions::new();
            options
                .write(true)
                .create_new(true)
                .mode(mode)
                .open(path)
                .unwrap()
        };
        let _left = make(&left, 0o200);
        let grows: File = make(&growing, 0o200);
        let _readable = make(&readable, 0o600);
        let mut files = UnfinishedFiles::new(prefix.clone());
        files.look();
        assert!(left.exists(), "too early");
        grows.set_len(100).unwrap();
        files.clear();
        assert!(!left.exists() && growing.exists() && readable.exists());
        for path in [growing, readable] {
            remove_file(path).unwrap();
        }
    }
}
