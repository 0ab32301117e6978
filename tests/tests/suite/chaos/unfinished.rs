//! Invariant: nobody waits for ever for what a killed process began.
//!
//! iceoryx2 0.10 makes a file in shared memory in two steps: it has no bytes, then its size. One that stays without bytes,
//! because its maker was killed between the steps, has to be removed with the rest of the dead client.

use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use cdcr_tests::Place;

use crate::chaos::CheckResult;

/// How old a file without bytes may become: far longer than any process is stopped in a run.
const AGE_MAX: Duration = Duration::from_secs(10);

/// Looks at the files of a place until `ending`. One that is unfinished for too long ends the run, and is removed so
/// that those who wait for it can end.
pub(crate) fn watch(place: &Place, ending: &AtomicBool) -> CheckResult {
    while !ending.load(Ordering::Relaxed) {
        for path in place.memory_files() {
            if is_unfinished(&path) {
                ending.store(true, Ordering::Relaxed);
                // Somebody may have been faster.
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
