//! A stop outlives the daemon: a word in the root folder says that the robot was stopped or faulted, and what by, until a reset.
//!
//! The word is mapped, so whoever latches or resets the robot writes it as it writes memory: no system call, no wait, no disk
//! that can be full. The kernel keeps it when the process is killed in the next instruction. The folder is in memory, so the
//! word ends with the machine's run.

use std::fs::{DirBuilder, File, OpenOptions};
use std::io::{Error, Result};
use std::os::unix::fs::{DirBuilderExt, FileExt, MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use cdcr_shared_types::codes::{Mode, Reason};
use rustix::fs::OFlags;

use crate::rt::sys::map_word;

const WORD_BYTES: u64 = size_of::<u64>() as u64;
/// No stop, and no fault.
const FREE: u64 = 0;

/// Whether the robot is to stay stopped, whoever is its daemon. The default keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Latch(Option<&'static AtomicU64>);

impl Latch {
    /// The one in the file at `path`, which is made where it is missing: for the user of this process alone.
    pub fn open(path: &Path) -> Result<Self> {
        let file = private().create(true).truncate(false).open(path)?;
        let metadata = file.metadata()?;
        let is_ours = metadata.uid() == rustix::process::geteuid().as_raw();
        if !metadata.is_file() || !is_ours || metadata.nlink() > 1 {
            return Err(Error::other(
                "it is not a regular file of this user with a single link",
            ));
        }
        // Less has one who was killed when he had just made it.
        if metadata.len() < WORD_BYTES {
            write(&file, FREE)?;
        }
        let word = map_word(&file)?;
        // Written, so that the page is there, and none is asked for later; `fetch_or` of zero would be left out.
        word.store(
            std::hint::black_box(word.load(Ordering::Relaxed)),
            Ordering::Relaxed,
        );
        Ok(Self(Some(word)))
    }

    /// Mode and reason that the robot was latched by, in words, if nobody has reset it.
    pub fn told(&self) -> Option<String> {
        let word = self.word();
        let (mode, reason) = (word as u32, (word >> 32) as u32);
        let told = || format!("{} ({})", Mode::text_of(mode), Reason::text_of(reason));
        (word != FREE).then(told)
    }

    /// The robot was stopped or faulted.
    pub fn set(&self, mode: Mode, reason: Reason) {
        self.store(word_of(mode, reason));
    }

    /// It was reset.
    pub fn clear(&self) {
        self.store(FREE);
    }

    /// A stop was asked for, and may find no cycle any more that carries it out.
    pub fn stop_asked(&self) {
        if let Some(word) = self.0 {
            let stopped = word_of(Mode::Stopped, Reason::Request);
            // The cycle may know better meanwhile.
            let _ = word.compare_exchange(FREE, stopped, Ordering::AcqRel, Ordering::Acquire);
        }
    }

    /// Makes the file anew where it was deleted, also with its folder, if the robot is to stay stopped. True: it is not.
    pub(crate) fn leave(&self, path: &Path) -> Result<bool> {
        let word = self.word();
        if word == FREE || path.symlink_metadata().is_ok() {
            return Ok(word == FREE);
        }
        let folder = path.parent().unwrap_or(path);
        DirBuilder::new()
            .recursive(true)
            .mode(0o700)
            .create(folder)?;
        let file = private().create_new(true).open(path)?;
        write(&file, word)?;
        Ok(false)
    }

    fn word(&self) -> u64 {
        self.0.map_or(FREE, |word| word.load(Ordering::Acquire))
    }

    fn store(&self, value: u64) {
        if let Some(word) = self.0 {
            word.store(value, Ordering::Release);
        }
    }
}

/// How the file is opened: no link or pipe in its place leads anywhere.
fn private() -> OpenOptions {
    let mut options = OpenOptions::new();
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    options
        .read(true)
        .write(true)
        .mode(0o600)
        .custom_flags(flags);
    options
}

fn word_of(mode: Mode, reason: Reason) -> u64 {
    u64::from(mode.code()) | u64::from(reason.code()) << 32
}

fn write(file: &File, word: u64) -> Result<()> {
    file.write_all_at(&word.to_ne_bytes(), 0)
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    #[test]
    fn what_was_latched_is_found_again_until_it_is_cleared() {
        let folder = Scratch::in_memory().unwrap();
        let path = folder.path().join("root/a.latch");
        std::fs::create_dir(path.parent().unwrap()).unwrap();
        // Its maker was killed before it wrote anything.
        File::create(&path).unwrap();
        let latch = Latch::open(&path).unwrap();
        assert_eq!(latch.told(), None);
        assert!(latch.leave(&path).unwrap());
        latch.set(Mode::Faulted, Reason::MeasurementLost);
        // A stop that comes later does not change why.
        latch.stop_asked();
        let told = "faulted (the measurement is lost)";
        assert_eq!(Latch::open(&path).unwrap().told().as_deref(), Some(told));
        std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
        assert!(!latch.leave(&path).unwrap());
        let found = Latch::open(&path).unwrap();
        assert_eq!(found.told().as_deref(), Some(told));
        found.clear();
        assert_eq!(Latch::open(&path).unwrap().told(), None);
    }
}
