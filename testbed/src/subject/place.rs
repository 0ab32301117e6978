//! A private place: a folder in memory, and one for temporary files. Dropping it removes every trace. What a killed
//! measurement left in memory, the next place removes; its folder for temporary files stays.

use std::collections::hash_map::RandomState;
use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher, Hasher};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use cdcr_shared_types::Location;
use rustix::fs::OFlags;
use rustix::process::geteuid;
use tempfile::TempDir;

pub const ROBOT: &str = "bench";

/// What the names of all places begin with.
pub const PREFIX: &str = "cdcr-bench-";
/// What the name of a place's root folder ends with.
pub const ROOT: &str = "root";
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
    pub fn new() -> Result<Self> {
        remove_abandoned();
        let folder = tempfile::Builder::new()
            .prefix(PREFIX)
            .tempdir()
            .context("a folder for temporary files")?;
        let random = RandomState::new().build_hasher().finish() as u32;
        let prefix = format!("{PREFIX}{}-{random:08x}_", std::process::id());
        let root = Path::new(Location::MEMORY).join(format!("{prefix}{ROOT}"));
        let location = Location::new(&prefix, &root).context("the names of a place")?;
        let lock = Lock::new(&prefix)?;
        Ok(Self {
            location,
            folder,
            lock,
        })
    }

    pub fn location(&self) -> &Location {
        &self.location
    }

    /// The folder of this place for temporary files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The files of this place that are mapped into memory.
    pub fn memory_files(&self) -> Vec<PathBuf> {
        self.location.memory_files()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(self.location.root());
        // The last one, so that who is killed here is cleared up after.
        let _ = fs::remove_file(&self.lock.path);
    }
}

/// A file beside those of a place, locked as long as its process lives: the system lets go of it, however the process
/// ends.
#[derive(Debug)]
struct Lock {
    path: PathBuf,
    #[cfg_attr(not(test), expect(dead_code))]
    file: File,
}

impl Lock {
    fn new(prefix: &str) -> Result<Self> {
        let path = Path::new(Location::MEMORY).join(format!("{prefix}{LOCK}"));
        loop {
            let file =
                Self::make(&path).with_context(|| format!("cannot write {}", path.display()))?;
            // Who looks for abandoned places may have had it before us, and removed its name.
            if is_file_at(&file, &path) {
                return Ok(Self { path, file });
            }
        }
    }

    fn make(path: &Path) -> io::Result<File> {
        let mut options = OpenOptions::new();
        let file = options
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(path)?;
        file.lock()?;
        Ok(file)
    }
}

/// Removes what places of this user left in shared memory whose process is gone. Everybody may write to that folder:
/// only regular files of our own with a name of ours are opened, no link is followed, and a lock that is held is left
/// alone.
fn remove_abandoned() {
    let entries = fs::read_dir(Location::MEMORY).into_iter().flatten();
    for path in entries.flatten().map(|entry| entry.path()) {
        let name = path.file_name().and_then(|name| name.to_str());
        let Some(prefix) = name.and_then(prefix_of_lock) else {
            continue;
        };
        let Ok(lock) = open_own(&path) else {
            continue;
        };
        if lock.try_lock().is_ok() && is_file_at(&lock, &path) {
            // The lock last: who is killed here leaves the rest to the next one.
            let _ = fs::remove_dir_all(path.with_file_name(format!("{prefix}{ROOT}")));
            let _ = fs::remove_file(&path);
        }
    }
}

/// What the names of a place begin with, of the name of its lock.
fn prefix_of_lock(name: &str) -> Option<&str> {
    let prefix = name.strip_suffix(LOCK)?;
    let (process, random) = prefix
        .strip_prefix(PREFIX)?
        .strip_suffix('_')?
        .split_once('-')?;
    let is_ours = !process.is_empty()
        && process.bytes().all(|byte| byte.is_ascii_digit())
        && random.len() == 8
        && random.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_ours.then_some(prefix)
}

/// A regular file of this user that has no other name. Never waits, follows no link.
fn open_own(path: &Path) -> io::Result<File> {
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(flags.bits().cast_signed())
        .open(path)?;
    let found = file.metadata()?;
    let is_own = found.is_file() && found.nlink() == 1 && found.uid() == geteuid().as_raw();
    is_own
        .then_some(file)
        .ok_or_else(|| io::ErrorKind::PermissionDenied.into())
}

fn is_file_at(file: &File, path: &Path) -> bool {
    let id = |file: fs::Metadata| (file.dev(), file.ino());
    let (opened, there) = (file.metadata().map(id), fs::symlink_metadata(path).map(id));
    matches!((opened, there), (Ok(opened), Ok(there)) if opened == there)
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

    #[test]
    fn only_names_of_locks_are_taken_for_locks() {
        let prefix = "cdcr-bench-17-0123abcd_";
        assert_eq!(prefix_of_lock(&format!("{prefix}{LOCK}")), Some(prefix));
        for name in [
            "cdcr-bench-lock",
            "cdcr-bench-_lock",
            "cdcr-bench-1-0_lock",
            "cdcr-bench--0123abcd_lock",
        ] {
            assert_eq!(prefix_of_lock(name), None, "{name}");
        }
    }

    #[test]
    fn neither_a_link_nor_a_pipe_nor_a_file_with_two_names_is_opened() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        fs::write(path("file"), "").expect("a file");
        assert!(open_own(&path("file")).is_ok());
        std::os::unix::fs::symlink(path("file"), path("link")).expect("a link");
        assert!(open_own(&path("link")).is_err());
        fs::hard_link(path("file"), path("other")).expect("a second name");
        assert!(open_own(&path("file")).is_err());
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mkfifoat(rustix::fs::CWD, path("pipe"), mode).expect("a pipe");
        assert!(open_own(&path("pipe")).is_err());
    }

    fn shared(place: &Place, name: &str) -> PathBuf {
        let root = place.location.root();
        fs::create_dir(root).expect("a folder");
        root.join(name)
    }
}
