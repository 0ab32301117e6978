//! Proof, not hope: the cycle thread of a whole daemon runs under an allocator that ends the process when the
//! cycle uses the heap, and under a filter of the kernel that ends it when the cycle makes a system call that
//! is not its own; for 20 000 cycles, while clients come and go, flood and change settings.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

mod solver;

use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError, RwLock};

use cdcr_daemon::app::run_until;
use cdcr_daemon::config::Config;
use cdcr_daemon::rt::sys::{WatchedAllocator, count_allocations, forbid_allocations};
use cdcr_tests::load::{self, Done};
use cdcr_tests::system_calls::forbid_system_calls;
use cdcr_tests::{Place, binary};

#[global_allocator]
static ALLOCATOR: WatchedAllocator = WatchedAllocator;

/// Cycles under guard.
const CYCLES: u64 = 20_000;

/// Two daemons on one core would be each other's load.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Lives of cycle threads that came to their end under guard.
static GUARDED_LIVES: AtomicU64 = AtomicU64::new(0);

#[test]
fn twenty_thousand_cycles_under_guard_with_a_simulated_robot() {
    run_guarded("", |place, _, done| load::keep_busy(place, CYCLES, done));
}

#[test]
fn twenty_thousand_cycles_under_guard_with_a_driver() {
    run_guarded("[link]\nkind = \"driver\"\n", |place, ending, done| {
        std::thread::scope(|scope| {
            scope.spawn(|| load::drive(place, ending));
            let counts = load::keep_busy(place, CYCLES, done);
            ending.store(true, Ordering::Relaxed);
            counts
        })
    });
}

/// Runs a whole daemon whose cycle thread is guarded, under load. `work` returns the cycles that it saw, and
/// how many of them tracked.
fn run_guarded(link: &str, work: impl FnOnce(&Place, &AtomicBool, &Done) -> (u64, u64)) {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let place = Place::new();
    // Short periods, so that the cycles are soon over; everything else as in service.
    let text = format!(
        "{link}[cycle]\nperiod_ms = 1.0\ngather_lead_ms = 0.2\nmiss_limit = 1000000\nwatchdog_ms = 60000.0\n\
         [transport]\nprefix = \"{}\"\nroot = \"{}\"\n",
        place.location().prefix(),
        place.location().root().display()
    );
    let validated = Config::parse(&text, &place.folder().join("robot.toml")).unwrap();
    let (ending, done) = (AtomicBool::new(false), Done::default());
    let gate = RwLock::new(());
    let lives = GUARDED_LIVES.load(Ordering::Acquire);
    std::thread::scope(|scope| {
        let daemon = scope.spawn(|| {
            run_until(
                &validated,
                || ending.load(Ordering::Relaxed),
                |life| {
                    forbid_system_calls();
                    forbid_allocations(life);
                    GUARDED_LIVES.fetch_add(1, Ordering::AcqRel);
                },
            )
        });
        for _ in 0..load::COMERS {
            scope.spawn(|| load::come_and_go(&place, &gate, &ending, &done));
        }
        scope.spawn(|| load::flood_references(&place, &ending, &done));
        scope.spawn(|| load::flood_obstacles(&place, &ending, &done));
        let (cycles, tracked) = work(&place, &ending, &done);
        ending.store(true, Ordering::Relaxed);
        daemon.join().unwrap().unwrap();
        println!("{cycles} cycles, {tracked} of them tracked, beside {done:?}");
        assert!(
            cycles >= CYCLES && tracked > CYCLES / 20,
            "{tracked} of {cycles} cycles tracked"
        );
    });
    assert!(GUARDED_LIVES.load(Ordering::Acquire) > lives);
    // There was a load: half of what was meant, because machines stall.
    let meant_s = CYCLES / 1000;
    assert!(done.connections.into_inner() > meant_s * 30 / 2);
    assert!(done.chunks.into_inner() > meant_s * 10_000 / 2);
    assert!(done.updates.into_inner() > meant_s * 10_000 / 2);
    assert!(done.settings.into_inner() > 0);
}

#[test]
fn the_counter_counts() {
    let (operations, text) = count_allocations(|| vec![1_u8; 100]);
    assert_eq!((operations, text.len()), (1, 100));
    assert_eq!(count_allocations(|| drop(text)).0, 1);
}

/// A process that does `what` under guard.
fn guarded(what: &str) -> Output {
    Command::new(binary("cdcr-test-guarded"))
        .arg(what)
        .output()
        .unwrap()
}

#[test]
fn a_broken_cycle_ends_the_process() {
    let heap = guarded("use-the-heap");
    let said = String::from_utf8_lossy(&heap.stderr);
    assert_eq!(heap.status.signal(), Some(libc::SIGABRT), "{said}");
    assert!(
        said.contains("the heap was used where it is forbidden"),
        "{said}"
    );
    let call = guarded("print");
    assert_eq!(call.status.signal(), Some(libc::SIGSYS));
    let good = guarded("work");
    assert!(good.status.success(), "{good:?}");
}
