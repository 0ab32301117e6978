//! Files in the root folder whose words outlive the process.
//!
//! The words are memory-mapped: storing one is a memory write, without a system call, a wait or a disk that
//! can be full. The kernel keeps the values even if the process is killed in the next instruction. The folder
//! is in memory, so a restart of the machine clears it.

use std::fs::{DirBuilder, OpenOptions};
use std::io::{Error, Result};
use std::os::unix::fs::{DirBuilderExt, FileExt, MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use rustix::fs::OFlags;

use crate::rt::sys::map_words;

/// Opens the words in the file at `path`; creates a missing file, of zeros, for the user of this process alone.
pub(crate) fn open<const N: usize>(path: &Path) -> Result<&'static [AtomicU64; N]> {
    let file = private().create(true).truncate(false).open(path)?;
    let metadata = file.metadata()?;
    let is_ours = metadata.uid() == rustix::process::geteuid().as_raw();
    if !metadata.is_file() || !is_ours || metadata.nlink() > 1 {
        return Err(Error::other(
            "it is not a regular file of this user with a single link",
        ));
    }
    // A file is shorter if its creator was killed right after creating it.
    let missing = (8 * N).saturating_sub(metadata.len() as usize);
    file.write_all_at(&vec![0; missing], metadata.len())?;
    let words = map_words::<N>(&file)?;
    for word in words {
        // A write, so that the page is resident and no later access needs it; `fetch_or` of zero would be
        // optimised away.
        let value = std::hint::black_box(word.load(Ordering::Relaxed));
        word.store(value, Ordering::Relaxed);
    }
    Ok(words)
}

/// Creates the file at `path` again, with its folder, if it was deleted.
pub(crate) fn make_again(path: &Path, words: &[AtomicU64]) -> Result<()> {
    if path.symlink_metadata().is_ok() {
        return Ok(());
    }
    let folder = path.parent().unwrap_or(path);
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(folder)?;
    let values = words.iter().map(|word| word.load(Ordering::Acquire));
    let bytes: Vec<u8> = values.flat_map(u64::to_ne_bytes).collect();
    let file = private().create_new(true).open(path)?;
    // A part of it would be read as an older state.
    file.write_all_at(&bytes, 0)
        .inspect_err(|_| drop(std::fs::remove_file(path)))
}

/// Options that follow no link and wait for no pipe in the file's place.
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
