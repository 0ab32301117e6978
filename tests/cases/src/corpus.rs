//! Inputs that once caused a failure or that reach a corner case: kept as files and always replayed first.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Runs `test` on each file of the folder of a corpus, and reports all failing ones.
pub fn replay(folder: impl AsRef<Path>, test: impl Fn(&[u8])) {
    let folder = folder.as_ref();
    let entries = std::fs::read_dir(folder).unwrap();
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(!paths.is_empty(), "{} is empty", folder.display());
    let fails = |path: &&std::path::PathBuf| {
        println!("replays {}", path.display());
        let bytes = std::fs::read(path).unwrap();
        catch_unwind(AssertUnwindSafe(|| test(&bytes))).is_err()
    };
    let failed: Vec<_> = paths.iter().filter(fails).collect();
    assert!(failed.is_empty(), "these kept inputs fail: {failed:#?}");
}
