//! A thread that writes and reads a file of bounded size.
//!
//! After each sync the kernel is advised to drop the file's pages, so that reads come from the disk. The
//! kernel may ignore the advice, and in a memory file system there is no disk.

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use anyhow::{Context, Result};
use rustix::fs::{Advice, fadvise};

use super::Done;
use super::task::Signals;

const BLOCK_BYTES: usize = 1 << 20;
/// Blocks of the file; after them, writing restarts at the beginning.
const BLOCKS: u64 = 64;
const SYNC_EVERY: u64 = 4;

/// Writes and reads until the load ends. The file has no name, so nothing is left of it in any case.
pub(super) fn write_and_read(signals: &Signals) -> Result<Done> {
    let file = nameless()?;
    let mut block = vec![0_u8; BLOCK_BYTES];
    let mut done = Done::default();
    let mut turn = 0;
    signals.works();
    while !signals.is_ending() {
        block.fill(turn as u8);
        let offset = turn % BLOCKS * BLOCK_BYTES as u64;
        file.write_all_at(&block, offset)
            .context("the file of the load cannot be written")?;
        turn += 1;
        if turn.is_multiple_of(SYNC_EVERY) {
            file.sync_data()
                .context("the file of the load cannot be synced")?;
            // Only advice: without it, reads come from the page cache.
            let _ = fadvise(&file, 0, None, Advice::DontNeed);
            done.written_bytes += SYNC_EVERY * BLOCK_BYTES as u64;
            done.read_bytes += read(&file, turn, &mut block)?;
        }
    }
    Ok(done)
}

/// Reads as much as was written since the last sync, from another part of the file if there is one.
fn read(file: &File, turn: u64, block: &mut [u8]) -> Result<u64> {
    let written = turn.min(BLOCKS);
    for step in 0..SYNC_EVERY {
        let offset = (turn + step + BLOCKS / 2) % written * BLOCK_BYTES as u64;
        file.read_exact_at(block, offset)
            .context("the file of the load cannot be read")?;
    }
    Ok(SYNC_EVERY * block.len() as u64)
}

/// Creates the file in the user's `TMPDIR`, or in the folder for large temporary files; `/tmp` is often
/// memory.
fn nameless() -> Result<File> {
    let asked = std::env::var_os("TMPDIR").is_some();
    let on_disk = (!asked).then(|| tempfile::tempfile_in(Path::new("/var/tmp")).ok());
    match on_disk.flatten() {
        Some(file) => Ok(file),
        None => tempfile::tempfile().context("a temporary file: set TMPDIR to a folder on a disk"),
    }
}
