//! Real-time properties of threads: locked memory, a core of their own, a priority.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::num::NonZeroU64;

use cdcr_shared_types::codes::realtime;
use rustix::mm::MlockAllFlags;
use rustix::thread::{
    CpuSet, disable_transparent_huge_pages, sched_getaffinity, sched_setaffinity,
    set_current_timer_slack,
};

use super::sys;

/// Properties requested for a thread.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ThreadPlan {
    /// Core to which the thread is pinned; `None`: the kernel chooses.
    pub core: Option<usize>,
    /// `SCHED_FIFO` priority; `None`: an ordinary thread.
    pub priority: Option<i32>,
    /// Core that the thread must not use, if there is another one.
    pub keep_off: Option<usize>,
}

/// `SCHED_FIFO` priority of threads outside the real-time core: above ordinary tasks, below all other
/// real-time threads.
const BESIDE_PRIORITY: i32 = 1;

/// Timer slack \[ns\]: delay of wake-ups that the kernel may add for an ordinary thread; 50 µs by default.
const TIMER_SLACK_NS: NonZeroU64 = NonZeroU64::MIN;

/// Stack that a real-time thread touches beforehand.
const STACK_BYTES: usize = 256 * 1024;

/// The last core that the process may use.
pub fn last_core() -> Option<usize> {
    core_affinity::get_core_ids()?.last().map(|core| core.id)
}

impl ThreadPlan {
    pub fn real_time(core: Option<usize>, priority: i32) -> Self {
        Self {
            core,
            priority: Some(priority),
            keep_off: None,
        }
    }

    /// The plan of a thread that works for the real-time threads, off their core.
    pub fn beside(core: Option<usize>) -> Self {
        Self {
            core: None,
            priority: Some(BESIDE_PRIORITY),
            keep_off: core,
        }
    }

    /// Applies the plan to the calling thread, as far as the system permits. Returns the [`realtime`] bits of
    /// missing properties.
    ///
    /// The priority comes before the core: an ordinary thread that is moved to a core with a real-time thread
    /// may starve there.
    pub fn apply(&self) -> u32 {
        let mut missing = 0;
        if let Some(priority) = self.priority
            && let Err(error) = sys::set_fifo(priority)
        {
            tracing::warn!(priority, %error, "SCHED_FIFO refused");
            missing |= realtime::FIFO;
        }
        if let Some(id) = self.core {
            let pinned = core_affinity::set_for_current(core_affinity::CoreId { id });
            if !pinned {
                tracing::warn!(core = id, "cannot pin the thread");
                missing |= realtime::PINNED;
            }
        }
        stay_off_core(self.keep_off);
        wake_up_exactly();
        touch_stack();
        missing
    }
}

/// Minimises the timer slack of the calling thread: wake-ups are punctual without `SCHED_FIFO`, too (which
/// has no slack).
fn wake_up_exactly() {
    if let Err(error) = set_current_timer_slack(Some(TIMER_SLACK_NS)) {
        tracing::info!(%error, "PR_SET_TIMERSLACK refused: ordinary threads may wake up late");
    }
}

/// Excludes the calling thread, and threads started by it later, from the core of the real-time threads, if
/// it may use another one. Ordinary work there would displace the cycle's data from the caches.
///
/// Call it after [`last_core`], which counts the cores that the calling thread may use.
pub fn stay_off_core(core: Option<usize>) {
    let Some(core) = core.filter(|core| *core < CpuSet::MAX_CPU) else {
        return;
    };
    let moved = sched_getaffinity(None).and_then(|mut allowed| {
        if !allowed.is_set(core) || allowed.count() < 2 {
            return Ok(());
        }
        allowed.unset(core);
        sched_setaffinity(None, &allowed)
    });
    if let Err(error) = moved {
        tracing::info!(core, %error, "cannot exclude non-real-time threads from the core of the real-time threads");
    }
}

/// Lets the calling thread, the supervisor, run before all ordinary tasks, and after all other real-time
/// threads.
///
/// The reason is a lock, not urgency. Threads of one process share the lock of their address space, which has
/// no priority inheritance; mapping the memory of a client takes it. A supervisor that holds the lock without
/// getting a crowded core delays the exchange (measured: 45 ms in one mmap of 358 bytes).
pub fn raise_above_ordinary_tasks() {
    if let Err(error) = sys::set_fifo(BESIDE_PRIORITY) {
        tracing::warn!(%error, "the supervisor runs at ordinary priority");
    }
}

/// Locks all present and future memory of the process, and exempts it from transparent huge pages. Returns
/// the missing properties.
pub fn lock_memory() -> u32 {
    sys::keep_freed_memory();
    keep_pages_small();
    match rustix::mm::mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE) {
        Ok(()) => 0,
        Err(error) => {
            tracing::warn!(%error, "memory is not locked");
            realtime::LOCKED
        }
    }
}

/// Exempts the process from transparent huge pages. To build one from small pages, the kernel moves memory in
/// use, also locked memory, and a thread that accesses it meanwhile waits.
fn keep_pages_small() {
    if let Err(error) = disable_transparent_huge_pages(true) {
        tracing::info!(%error, "PR_SET_THP_DISABLE refused: the kernel may create huge pages");
    }
}

/// Prevents deep sleep states of the processor while the file is open: `/dev/cpu_dma_latency` with the value
/// zero (<https://docs.kernel.org/power/pm_qos_interface.html>). `None` if the system refuses it; then
/// wake-ups only take longer.
pub fn prevent_deep_sleep() -> Option<File> {
    let opened = OpenOptions::new().write(true).open("/dev/cpu_dma_latency");
    let held = opened.and_then(|mut file| file.write_all(&0_i32.to_ne_bytes()).map(|()| file));
    match held {
        Ok(file) => Some(file),
        Err(error) => {
            tracing::info!(%error, "/dev/cpu_dma_latency refused: the processor may enter deep sleep");
            None
        }
    }
}

/// Touches the stack of a thread, so that its pages are present before the first cycle.
#[inline(never)]
#[allow(
    clippy::large_stack_arrays,
    reason = "a large array on the stack is the point"
)]
fn touch_stack() {
    let mut stack = [0_u8; STACK_BYTES];
    for byte in stack.iter_mut().step_by(4096) {
        *byte = 1;
    }
    std::hint::black_box(&stack);
}

#[cfg(test)]
mod tests {
    use cdcr_test_skip::{Need, skip};
    use rustix::thread::{current_timer_slack, transparent_huge_pages_are_disabled};

    use super::*;

    /// Runs on a separate thread, whose core affinity affects no other test.
    fn apart<T: Send + 'static>(run: fn() -> T) -> T {
        std::thread::spawn(run).join().unwrap()
    }

    fn cores() -> Vec<usize> {
        let allowed = sched_getaffinity(None).unwrap();
        (0..CpuSet::MAX_CPU)
            .filter(|core| allowed.is_set(*core))
            .collect()
    }

    #[test]
    fn the_supervisor_leaves_the_core_to_the_real_time_threads() {
        let (before, after) = apart(|| {
            let before = cores();
            stay_off_core(before.last().copied());
            (before, cores())
        });
        let (last, others) = before.split_last().unwrap();
        if others.is_empty() {
            skip(
                Need::Cores,
                format_args!("core {last} is the only one that this test may use"),
            );
            return;
        }
        assert_eq!(after, others);
    }

    #[test]
    fn a_thread_on_the_grid_wakes_up_when_it_asked_to() {
        let (before, after) = apart(|| {
            let before = current_timer_slack().unwrap();
            assert_eq!(ThreadPlan::default().apply(), 0);
            (before, current_timer_slack().unwrap())
        });
        assert_eq!(after, TIMER_SLACK_NS.get());
        assert!(before > after, "the kernel gives {before} ns by default");
    }

    #[test]
    fn the_only_core_is_shared() {
        let (only, after) = apart(|| {
            let only = cores()[0];
            assert!(core_affinity::set_for_current(core_affinity::CoreId {
                id: only
            }));
            stay_off_core(Some(only));
            (only, cores())
        });
        assert_eq!(after, [only]);
    }

    #[test]
    fn a_core_that_is_not_there_changes_nothing() {
        let (before, after) = apart(|| {
            let before = cores();
            for core in [None, Some(CpuSet::MAX_CPU - 1), Some(usize::MAX)] {
                stay_off_core(core);
            }
            (before, cores())
        });
        // On a machine with this many cores, the last one may be removed.
        if !before.contains(&(CpuSet::MAX_CPU - 1)) {
            assert_eq!(after, before);
        }
    }

    #[test]
    fn the_process_is_exempt_from_huge_pages() {
        if let Err(error) = disable_transparent_huge_pages(false) {
            skip(
                Need::Kernel,
                format_args!("PR_SET_THP_DISABLE is refused ({error})"),
            );
            return;
        }
        assert!(!transparent_huge_pages_are_disabled().unwrap());
        keep_pages_small();
        assert!(transparent_huge_pages_are_disabled().unwrap());
    }
}
