//! Inputs that once caused a failure or that reach a corner case: kept as files and always replayed first.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

/// Runs `test` on each file of a target's corpus, and reports all failing ones.
pub(crate) fn replay(target: &str, test: impl Fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("corpus")
        .join(target);
    let entries = std::fs::read_dir(&folder).unwrap();
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
