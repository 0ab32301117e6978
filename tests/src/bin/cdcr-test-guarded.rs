//! Forbidden and allowed actions of a cycle under its two guards. Each guard ends the process, so the test
//! `a_broken_cycle_ends_the_process` runs this program. Argument: `use-the-heap`, `print` or `work`.

#![allow(
    clippy::unwrap_used,
    reason = "in a helper of a test a panic is the report"
)]

use cdcr_daemon::rt::clock::Clock;
use cdcr_daemon::rt::clock::MonotonicClock;
use cdcr_daemon::rt::sys::{WatchedAllocator, forbid_allocations};
use cdcr_tests::system_calls::forbid_system_calls;

#[global_allocator]
static ALLOCATOR: WatchedAllocator = WatchedAllocator;

fn main() {
    match std::env::args().nth(1).as_deref() {
        Some("use-the-heap") => use_the_heap(),
        Some("print") => print(),
        Some("work") => work(),
        other => panic!("use-the-heap, print or work, not {other:?}"),
    }
}

fn use_the_heap() {
    forbid_allocations(|| std::hint::black_box(vec![1_u8; 100])).clear();
}

fn print() {
    let printing = std::thread::spawn(|| {
        forbid_system_calls();
        println!("a cycle does not print");
    });
    printing.join().unwrap();
}

fn work() {
    let waiting = std::thread::current();
    let working = std::thread::spawn(move || {
        // The first clock read sets up reading without the kernel.
        MonotonicClock.now_ns();
        forbid_system_calls();
        forbid_allocations(|| {
            MonotonicClock.sleep_until(MonotonicClock.now_ns() + 2_000_000);
            waiting.unpark();
        });
    });
    std::thread::park();
    working.join().unwrap();
}
