//! Invariant: no process waits for ever for a file that a killed process began.
//!
//! iceoryx2 0.10 creates a file in shared memory in two steps: empty, then with its size. If its creator is
//! killed between them, the empty file has to be removed with the rest of the dead client.

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use cdcr_tests::Place;

use crate::chaos::CheckResult;

/// Largest age of an empty file: far longer than any process is stopped in a run.
const AGE_MAX: Duration = Duration::from_secs(10);

/// Checks the files of a place until `ending`. An empty file that is too old ends the run; it is removed so
/// that waiting processes can end.
pub(crate) fn watch(place: &Place, ending: &AtomicBool) -> CheckResult {
    while !ending.load(Ordering::Relaxed) {
        for path in place.memory_files() {
            if is_unfinished(&path) {
                ending.store(true, Ordering::Relaxed);
                // Another process may have been faster.
                let _ = fs::remove_file(&path);
                return Err(format!(
                    "{} has no bytes for {} s",
                    path.display(),
                    AGE_MAX.as_secs()
                ));
            }
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    Ok(())
}

fn is_unfinished(path: &Path) -> bool {
    let Ok(file) = fs::metadata(path) else {
        return false;
    };
    let age = file.modified().ok().and_then(|made| made.elapsed().ok());
    file.len() == 0 && age.is_some_and(|age| age > AGE_MAX)
}
