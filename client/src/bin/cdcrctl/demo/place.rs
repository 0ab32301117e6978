use std::fs::{self, DirBuilder, File};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use anyhow::Context;
use cdcr_shared_types::Location;
use rustix::io::Errno;
use rustix::process::{Pid, geteuid, test_kill_process};

/// Beginning of the name of each demo's folder; its process id and a random number follow.
const NAME: &str = "cdcr-demo-";

/// A folder, and a root folder in memory, that nobody else uses. Dropping it removes both.
pub(super) struct PrivatePlace {
    folder: PathBuf,
    location: Location,
    /// Held by the demo and its daemon, so that no other demo removes the place before both have ended.
    lock: File,
}

impl PrivatePlace {
    /// A new place below TMPDIR with this configuration in it.
    pub(super) fn new(config: &str) -> anyhow::Result<Self> {
        let random = RandomState::new().build_hasher().finish() as u32;
        let name = format!("{NAME}{}-{random:08x}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let location = location(&folder).context("the names of a demo")?;
        let problem = || {
            format!(
                "cannot write to {}: set TMPDIR to a folder on a disk with free space and write permission",
                folder.display()
            )
        };
        DirBuilder::new()
            .mode(0o700)
            .create(&folder)
            .with_context(problem)?;
        let place = Self {
            lock: File::open(&folder).with_context(problem)?,
            folder: folder.clone(),
            location,
        };
        place.lock.try_lock().with_context(problem)?;
        fs::write(place.folder.join(Self::CONFIG), config).with_context(problem)?;
        Ok(place)
    }

    /// Name of the configuration in the folder.
    pub(super) const CONFIG: &str = "demo.toml";

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn location(&self) -> &Location {
        &self.location
    }

    /// The lock, for a process that uses the place: it holds it until it ends.
    pub(super) fn lock(&self) -> io::Result<File> {
        self.lock.try_clone()
    }
}

impl Drop for PrivatePlace {
    fn drop(&mut self) {
        if let Err(error) = remove(&self.folder, &self.location) {
            tell!("warning: cannot remove {}: {error}", self.folder.display());
        }
    }
}

/// Removes what killed demos of this user left, and reports each on the standard error.
pub(super) fn sweep_abandoned() {
    for folder in abandoned(&std::env::temp_dir(), Path::new(Location::MEMORY)) {
        let was_there = folder.exists();
        let removed = location(&folder)
            .map_err(io::Error::other)
            .and_then(|location| remove(&folder, &location));
        let folder = folder.display();
        match removed {
            Ok(()) if was_there => {
                tell!("removed {folder} and its memory, left by a killed demo");
            }
            Ok(()) => tell!("removed the memory of {folder}, left by a killed demo"),
            Err(error) => tell!("warning: cannot remove {folder}: {error}"),
        }
    }
}

/// Folders of demos of this user whose process has ended and whose lock nobody holds, also those of which only the root folder in
/// `memory` is left: theirs lay below another TMPDIR, or somebody removed it.
fn abandoned(temporary: &Path, memory: &Path) -> Vec<PathBuf> {
    let entries = |folder| fs::read_dir(folder).into_iter().flatten().flatten();
    let folders = entries(temporary).map(|entry| entry.path());
    let roots = entries(memory).filter(|root| !temporary.join(root.file_name()).exists());
    // A daemon holds its root folder locked.
    let roots = roots.filter(|root| is_abandoned(&root.path()));
    let folders = folders.filter(|folder| is_abandoned(folder));
    folders
        .chain(roots.map(|root| temporary.join(root.file_name())))
        .collect()
}

fn is_abandoned(folder: &Path) -> bool {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let is_ours = || {
        // Not what a link points to.
        fs::symlink_metadata(folder)
            .is_ok_and(|entry| entry.is_dir() && entry.uid() == geteuid().as_raw())
    };
    let is_unlocked = || File::open(folder).is_ok_and(|lock| lock.try_lock().is_ok());
    process(&name).is_some_and(has_ended) && is_ours() && is_unlocked()
}

/// The process in the name of a demo's folder.
fn process(name: &str) -> Option<Pid> {
    let (process, random) = name.strip_prefix(NAME)?.split_once('-')?;
    let is_random = random.len() == 8 && random.bytes().all(|byte| byte.is_ascii_hexdigit());
    Pid::from_raw(process.parse().ok().filter(|id| *id > 0 && is_random)?)
}

fn has_ended(process: Pid) -> bool {
    test_kill_process(process) == Err(Errno::SRCH)
}

/// Where daemon and clients of the demo with this folder meet.
fn location(folder: &Path) -> Result<Location, cdcr_shared_types::LocationError> {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let root = Path::new(Location::MEMORY).join(&*name);
    Location::new(&format!("{name}_"), &root)
}

/// Removes the folder and the root folder.
fn remove(folder: &Path, location: &Location) -> io::Result<()> {
    // There is no root folder before the daemon has started.
    for folder in [location.root(), folder] {
        match fs::remove_dir_all(folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            result => result?,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    use cdcr_scratch::Scratch;

    /// The process id of a program that has ended.
    fn ended() -> u32 {
        let mut child = Command::new("true").spawn().expect("it starts");
        child.wait().expect("it ends");
        child.id()
    }

    fn stray(location: &Location) -> PathBuf {
        fs::create_dir(location.root()).expect("made");
        location.root().join("x")
    }

    #[test]
    fn a_private_place_is_private_and_leaves_nothing() {
        let place = PrivatePlace::new("x").expect("a folder");
        let other = PrivatePlace::new("x").expect("another folder");
        assert_ne!(place.location, other.location);
        let stray = stray(place.location());
        fs::write(&stray, "x").expect("written");
        let folder = place.folder.clone();
        assert!(folder.join(PrivatePlace::CONFIG).exists());
        drop(place);
        assert!(!folder.exists() && !stray.exists());
        assert!(!stray.parent().expect("its folder").exists());
        assert!(other.folder.exists());
    }

    #[test]
    fn only_the_folder_of_a_dead_demo_is_abandoned() {
        let [temporary, memory] = [(); 2].map(|()| Scratch::temporary().expect("a folder"));
        let make = |name: &str| {
            let folder = temporary.path().join(name);
            fs::create_dir(&folder).expect("made");
            folder
        };
        let (dead, alive) = (ended(), std::process::id());
        let left = make(&format!("{NAME}{dead}-0123abcd"));
        let held = make(&format!("{NAME}{dead}-11111111"));
        make(&format!("{NAME}{alive}-0123abcd"));
        make(&format!("{NAME}{dead}-results"));
        make(&format!("{NAME}-1-0123abcd"));
        make(&format!("other-{dead}-0123abcd"));
        fs::write(temporary.path().join(format!("{NAME}{dead}-22222222")), "x").expect("written");
        // Its daemon still ends.
        let lock = File::open(&held).expect("opened");
        lock.try_lock().expect("locked");
        let abandoned = || abandoned(temporary.path(), memory.path());
        assert_eq!(abandoned(), std::slice::from_ref(&left));
        drop(lock);
        // Its own folder is gone, and that of another one with a daemon that still ends is not.
        let lonely = format!("{NAME}{dead}-33333333");
        let ending = memory.path().join(format!("{NAME}{dead}-44444444"));
        for root in [&memory.path().join(&lonely), &ending] {
            fs::create_dir(root).expect("made");
        }
        let lock = File::open(&ending).expect("opened");
        lock.try_lock().expect("locked");
        let mut all = abandoned();
        all.sort();
        assert_eq!(all, [left, held, temporary.path().join(lonely)]);
    }

    #[test]
    fn an_abandoned_place_is_removed_with_its_shared_memory() {
        let temporary = Scratch::temporary().expect("a folder");
        let folder = temporary.path().join(format!("{NAME}{}-0123abcd", ended()));
        fs::create_dir(&folder).expect("made");
        let location = location(&folder).expect("legal");
        let stray = stray(&location);
        fs::write(&stray, "x").expect("written");
        remove(&folder, &location).expect("removed");
        assert!(!folder.exists() && !location.root().exists());
    }
}
