//! System calls that no safe crate offers. All `unsafe` code of the daemon is here.
//!
//! One operation per block, each with the reason why it is sound.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::fs::File;
use std::io;
use std::mem::MaybeUninit;
use std::os::fd::AsRawFd;
use std::sync::atomic::AtomicU64;

/// Gives the calling thread `SCHED_FIFO` at `priority` (1 ..= 99); `EPERM` without `CAP_SYS_NICE` or a large
/// enough `RLIMIT_RTPRIO`.
pub fn set_fifo(priority: i32) -> io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: priority,
    };
    // SAFETY: pid 0 is the calling thread; `parameters` is a valid sched_param for the whole call,
    // and the kernel only reads it.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
    if result == 0 {
        Ok(())
    } else {
        Err(io::Error::last_os_error())
    }
}

/// Unblocks or blocks `signal` for the calling thread and threads started by it later. The kernel delivers a
/// signal of the process to a thread that accepts it, preferably the main thread; until there is one, the
/// signal stays pending.
pub fn take_signal(signal: i32, takes: bool) {
    let how = if takes {
        libc::SIG_UNBLOCK
    } else {
        libc::SIG_BLOCK
    };
    let mut set = MaybeUninit::<libc::sigset_t>::uninit();
    // SAFETY: `set` is memory for a signal set, which this call initialises.
    unsafe { libc::sigemptyset(set.as_mut_ptr()) };
    // SAFETY: `set` was initialised by the previous call.
    unsafe { libc::sigaddset(set.as_mut_ptr(), signal) };
    // SAFETY: `set` is initialised and only read; the null pointer omits the old mask.
    unsafe { libc::pthread_sigmask(how, set.as_ptr(), std::ptr::null_mut()) };
}

/// Keeps freed memory in the process, so that later allocations rarely need new pages of the kernel.
///
/// Only with glibc; elsewhere this does nothing.
pub fn keep_freed_memory() {
    #[cfg(target_env = "gnu")]
    for (option, value) in [(libc::M_TRIM_THRESHOLD, -1), (libc::M_MMAP_MAX, 0)] {
        // SAFETY: mallopt takes two integers and touches only the allocator's own settings.
        unsafe { libc::mallopt(option, value) };
    }
}

/// Maps the first `N` words of `file`, which must have them, for the life of the process. Written values
/// remain in the file, however the process ends.
pub fn map_words<const N: usize>(file: &File) -> io::Result<&'static [AtomicU64; N]> {
    let access = libc::PROT_READ | libc::PROT_WRITE;
    // SAFETY: the kernel chooses the address, so no mapping is replaced; `file` is open for the whole call.
    let place = unsafe {
        libc::mmap(
            std::ptr::null_mut(),
            size_of::<[AtomicU64; N]>(),
            access,
            libc::MAP_SHARED,
            file.as_raw_fd(),
            0,
        )
    };
    if place == libc::MAP_FAILED {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: the mapping starts at a page boundary, so it is aligned. It is never removed, and any eight
    // bytes are a valid number. Only the user of this process may open the file and shorten it, which would
    // end the process with a signal, not redirect the access.
    Ok(unsafe { &*place.cast::<[AtomicU64; N]>() })
}

/// Reaction of the allocator to the heap operations of a thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Watch {
    Off,
    Count,
    Forbid,
}

thread_local! {
    static WATCH: Cell<Watch> = const { Cell::new(Watch::Off) };
    static OPERATIONS: Cell<u64> = const { Cell::new(0) };
}

/// The system allocator with a watch over the heap operations of one thread, for tests: a daemon does not use it.
///
/// A test binary installs it with `#[global_allocator]` and watches the cycle thread.
#[derive(Debug, Default)]
pub struct WatchedAllocator;

/// Counts the heap operations (allocate, grow, free) of the calling thread in `work`, and returns its result.
/// Zero unless [`WatchedAllocator`] is the global allocator.
pub fn count_allocations<R>(work: impl FnOnce() -> R) -> (u64, R) {
    OPERATIONS.set(0);
    WATCH.set(Watch::Count);
    let result = work();
    WATCH.set(Watch::Off);
    (OPERATIONS.get(), result)
}

/// Runs `work` and aborts the process at the first heap operation of the calling thread, with a message and a
/// backtrace. Only runs `work` unless [`WatchedAllocator`] is the global allocator.
pub fn forbid_allocations<R>(work: impl FnOnce() -> R) -> R {
    WATCH.set(Watch::Forbid);
    let result = work();
    WATCH.set(Watch::Off);
    result
}

fn watch() {
    match WATCH.get() {
        Watch::Off => {}
        Watch::Count => OPERATIONS.set(OPERATIONS.get() + 1),
        Watch::Forbid => {
            // The report may use the heap.
            WATCH.set(Watch::Off);
            let place = std::backtrace::Backtrace::force_capture();
            eprintln!("the heap was used where it is forbidden:\n{place}");
            std::process::abort();
        }
    }
}

// SAFETY: every method reads const-initialised thread-locals without a destructor, which neither allocates
// nor unwinds (or aborts the process). It passes the call on to the system allocator unchanged.
unsafe impl GlobalAlloc for WatchedAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        watch();
        // SAFETY: the caller keeps the contract of `alloc`, which is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        watch();
        // SAFETY: `memory` came from `System` through `alloc` or `realloc` with this layout.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        watch();
        // SAFETY: `memory` came from `System` with this layout; the caller guarantees a valid `new_size`.
        unsafe { System.realloc(memory, layout, new_size) }
    }
}
