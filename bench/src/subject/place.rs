//! A private place in shared memory. Dropping it removes every trace; what a killed measurement could not remove, the
//! next place does.

use std::collections::hash_map::RandomState;
use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher, Hasher};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use cdcr_shared_types::{Location, memory_files};
use tempfile::TempDir;

/// Name of the robot of every measurement.
pub const ROBOT: &str = "bench";

/// What the names of all places begin with.
const PREFIX: &str = "cdcr-bench-";
/// What the name of a place's lock ends with.
const LOCK: &str = "lock";

/// A prefix and a folder that nobody else uses.
#[derive(Debug)]
pub struct Place {
    location: Location,
    folder: TempDir,
    lock: Lock,
}

impl Place {
    /// A fresh one. Places of this user whose process is gone are removed first.
    ///
    /// # Errors
    /// When the folder for temporary files or shared memory cannot be written, or a name is too long.
    pub fn new() -> Result<Self> {
        remove_abandoned();
        let folder = tempfile::Builder::new()
            .prefix(PREFIX)
            .tempdir()
            .context("a folder for temporary files")?;
        let random = RandomState::new().build_hasher().finish() as u32;
        let prefix = format!("{PREFIX}{}-{random:08x}_", std::process::id());
        let location = Location::new(&prefix, &folder.path().join("root"))
            .context("the folder lies in TMPDIR: set TMPDIR to a shorter absolute path")?;
        let lock = Lock::new(&prefix)?;
        Ok(Self {
            location,
            folder,
            lock,
        })
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
            let _ = fs::remove_file(file);
        }
        let _ = fs::remove_file(&self.lock.path);
    }
}

/// A file beside those of a place, locked as long as its process lives: the system lets go of it, however the process
/// ends.
#[derive(Debug)]
struct Lock {
    path: PathBuf,
    /// Holds the lock until it is closed.
    #[cfg_attr(not(test), expect(dead_code))]
    file: File,
}

impl Lock {
    fn new(prefix: &str) -> Result<Self> {
        let path = Path::new("/dev/shm").join(format!("{prefix}{LOCK}"));
        let what = || format!("cannot write {}", path.display());
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&path)
            .with_context(what)?;
        // Somebody who looks for abandoned places may hold it just now, and removes its name: then this place is not
        // found should it be abandoned, which is no worse.
        file.lock().with_context(what)?;
        Ok(Self { path, file })
    }
}

/// Removes the files of places whose process is gone. Other users' places are theirs; a lock that cannot be opened or
/// is held is left alone.
fn remove_abandoned() {
    let own = rustix::process::geteuid().as_raw();
    for path in memory_files(PREFIX) {
        let Some(prefix) = path
            .file_name()
            .and_then(|name| name.to_str()?.strip_suffix(LOCK))
        else {
            continue;
        };
        let is_own_file =
            fs::symlink_metadata(&path).is_ok_and(|file| file.is_file() && file.uid() == own);
        let Some(lock) = is_own_file.then(|| File::open(&path).ok()).flatten() else {
            continue;
        };
        if lock.try_lock().is_ok() {
            // The lock last: who is killed here leaves the rest to the next one.
            for file in memory_files(prefix) {
                if file != path {
                    let _ = fs::remove_file(file);
                }
            }
            let _ = fs::remove_file(&path);
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
        let (gone, kept) = (one.lock.path.clone(), other.lock.path.clone());
        drop(one);
        assert!(!folder.exists() && other.folder().exists());
        assert!(!gone.exists() && kept.exists());
    }

    #[test]
    fn what_a_killed_measurement_left_is_removed_by_the_next() {
        let used = Place::new().expect("a place");
        let kept = [used.lock.path.clone(), shared(&used, "data")];
        fs::write(&kept[1], "in use").expect("a file");

        // As a process that is killed: nothing of its place is removed, but its lock is let go.
        let killed = Place::new().expect("a place");
        let left = [killed.lock.path.clone(), shared(&killed, "data")];
        fs::write(&left[1], "left behind").expect("a file");
        killed.lock.file.unlock().expect("a lock that is held");

        let _next = Place::new().expect("a place");
        assert!(left.iter().all(|file| !file.exists()), "{left:?}");
        assert!(kept.iter().all(|file| file.exists()), "{kept:?}");
    }

    fn shared(place: &Place, name: &str) -> PathBuf {
        Path::new("/dev/shm").join(format!("{}{name}", place.location.file_prefix()))
    }
}
