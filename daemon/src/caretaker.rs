//! The caretaker checks once a second that clients still find the daemon, and clears the leftovers of dead
//! clients. It also reloads the configuration on request.
//!
//! Invariant: no other thread waits for this one, beyond [`END_MAX`] at the end. It may take long, or hang on
//! a file.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use crate::handover::Shared;
use crate::instance::{PlaceCheck, PlaceWatch};
use crate::reload::Reload;

const CHECK_INTERVAL: Duration = Duration::from_secs(1);
/// Dead processes cleared per check. One takes about 5 ms of processor time.
const DEAD_NODES: usize = 8;
/// iceoryx2 lists its nodes with large arrays on the stack.
const STACK_BYTES: usize = 1024 * 1024;
/// Longest wait for the thread at the end.
const END_MAX: Duration = Duration::from_secs(1);

/// Handle of the thread; dropping it ends the thread.
#[derive(Debug)]
pub(crate) struct Caretaker {
    lost: Arc<OnceLock<PathBuf>>,
    ends: Arc<AtomicBool>,
    /// A reload of the configuration was requested.
    asked: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Caretaker {
    /// Starts the thread with the priority and the cores of the calling thread.
    pub(crate) fn start(
        place: PlaceWatch,
        mut reload: Reload,
        shared: Arc<Shared>,
    ) -> Result<Self> {
        let lost = Arc::new(OnceLock::new());
        let ends = Arc::new(AtomicBool::new(false));
        let (their_lost, their_ends) = (Arc::clone(&lost), Arc::clone(&ends));
        let asked = reload.asked();
        let thread = Builder::new()
            .name("cdcr-caretaker".to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || run_checks(&place, &mut reload, &shared, &their_lost, &their_ends))
            .context("the thread cdcr-caretaker")?;
        Ok(Self {
            lost,
            ends,
            asked,
            thread,
        })
    }

    /// The deleted or replaced file, if clients cannot find the daemon any more.
    pub(crate) fn lost(&self) -> Option<&Path> {
        self.lost.get().map(PathBuf::as_path)
    }

    /// Wakes the thread if a reload was requested. Call it every few hundredths of a second: before its
    /// request, systemd sets the mode of the root folder to `RuntimeDirectoryMode`, which excludes the group
    /// until the next check.
    pub(crate) fn wake_if_asked(&self) {
        if self.asked.load(Ordering::Relaxed) {
            self.thread.thread().unpark();
        }
    }
}

impl Drop for Caretaker {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.thread().unpark();
        let begin = Instant::now();
        while !self.thread.is_finished() && begin.elapsed() < END_MAX {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

fn run_checks(
    place: &PlaceWatch,
    reload: &mut Reload,
    shared: &Shared,
    lost: &OnceLock<PathBuf>,
    ends: &AtomicBool,
) {
    loop {
        match place.check() {
            PlaceCheck::Whole => {}
            PlaceCheck::Restored => tracing::warn!("recreated the lock file: it had been deleted"),
            // At the end the services are removed with their ports.
            PlaceCheck::Lost { .. } if shared.is_ending() => return,
            PlaceCheck::Lost { path } => {
                tracing::error!(
                    path = %path.display(),
                    "was deleted or replaced, so clients cannot reach this daemon: the robot comes to rest"
                );
                // Set only once.
                let _ = lost.set(path);
                return;
            }
        }
        reload.start_if_wanted();
        place.disconnect_clients();
        place.location().clear_dead_nodes(DEAD_NODES);
        if !wait_for_next_check(ends, || reload.is_wanted()) {
            return;
        }
    }
}

/// Waits until the next check, which is immediate if requested and this thread is woken. False at the end.
fn wait_for_next_check(ends: &AtomicBool, is_wanted: impl Fn() -> bool) -> bool {
    let begin = Instant::now();
    while !ends.load(Ordering::Relaxed) {
        let left = CHECK_INTERVAL.saturating_sub(begin.elapsed());
        if left.is_zero() || is_wanted() {
            return true;
        }
        std::thread::park_timeout(left);
    }
    false
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn the_next_look_comes_when_it_is_wanted_and_none_at_the_end() {
        let ends = AtomicBool::new(false);
        let asks = || {
            let asked = Cell::new(0);
            let is_wanted = || {
                // A request wakes the thread.
                std::thread::current().unpark();
                asked.replace(asked.get() + 1) == 2
            };
            assert!(wait_for_next_check(&ends, is_wanted));
            asked.get()
        };
        // Fewer calls if the whole wait passed in a stall, as without a wake-up.
        assert!((0..5).any(|_| asks() == 3));
        let begin = Instant::now();
        assert!(wait_for_next_check(&ends, || false));
        assert!(begin.elapsed() >= CHECK_INTERVAL);
        ends.store(true, Ordering::Relaxed);
        assert!(!wait_for_next_check(&ends, || true));
    }
}
