//! Guards for the cycle thread of a whole daemon. An allocator ends the process when the cycle uses the heap,
//! and a kernel filter ends it at any system call that is not allowed. Meanwhile clients connect and leave,
//! flood and change settings. `CDCR_GUARD_CYCLES` sets the number of cycles.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError, RwLock};

use cdcr_daemon::app::run_until;
use cdcr_daemon::config::Config;
use cdcr_daemon::rt::sys::{WatchedAllocator, forbid_allocations};
use cdcr_tests::load::{self, Done};
use cdcr_tests::system_calls::forbid_system_calls;
use cdcr_tests::{Place, asked, binary};

#[global_allocator]
static ALLOCATOR: WatchedAllocator = WatchedAllocator;

/// Cycles under guard: `CDCR_GUARD_CYCLES`, or 5 000.
fn guarded_cycles() -> u64 {
    asked("CDCR_GUARD_CYCLES").unwrap_or(5_000)
}

/// Two daemons on one core would load each other.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Number of cycle threads that ended under guard.
static GUARDED_LIVES: AtomicU64 = AtomicU64::new(0);

#[test]
fn cycles_under_guard_with_a_simulated_robot() {
    run_guarded("", |place, _, busy| busy(place));
}

#[test]
fn cycles_under_guard_with_a_driver() {
    let prefer = "[realtime]\nmode = \"prefer\"\n";
    run_guarded(
        &format!("[link]\nkind = \"driver\"\n{prefer}"),
        |place, ending, busy| {
            std::thread::scope(|scope| {
                scope.spawn(|| load::drive(place, ending));
                let counts = busy(place);
                ending.store(true, Ordering::Relaxed);
                counts
            })
        },
    );
}

/// Keeps a daemon busy, and returns the numbers of its cycles and of its tracking cycles.
type Busy<'a> = &'a dyn Fn(&Place) -> (u64, u64);

/// Runs a whole daemon with a guarded cycle thread under load, until the number of cycles and half of the
/// nominal load are reached.
fn run_guarded(link: &str, work: impl FnOnce(&Place, &AtomicBool, Busy<'_>) -> (u64, u64)) {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let place = Place::new();
    // Short periods, so that the cycles take little time; everything else as in operation.
    let text = format!(
        "{link}[cycle]\nperiod_ms = 1.0\ngather_lead_ms = 0.2\nmiss_limit = 1000000\nwatchdog_ms = 60000.0\n\
         [transport]\nprefix = \"{}\"\nroot = \"{}\"\n",
        place.location().prefix(),
        place.location().root().display()
    );
    let validated = Config::parse(&text, &place.folder().join("robot.toml")).unwrap();
    let (ending, done) = (AtomicBool::new(false), Done::default());
    let cycles = guarded_cycles();
    let least = Done::part_of(cycles / 1000, 2);
    let busy = |place: &Place| load::keep_busy(place, cycles, &least, &done);
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
        let (ran, tracked) = work(&place, &ending, &busy);
        ending.store(true, Ordering::Relaxed);
        daemon.join().unwrap().unwrap();
        println!("{ran} cycles, {tracked} of them tracked, beside {done:?}");
        assert!(ran >= cycles && tracked > cycles / 20);
    });
    assert!(GUARDED_LIVES.load(Ordering::Acquire) > lives);
    assert!(done.reaches(&least), "{done:?} instead of {least:?}");
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
    let printed = String::from_utf8_lossy(&heap.stderr);
    assert_eq!(heap.status.signal(), Some(libc::SIGABRT), "{printed}");
    assert!(
        printed.contains("the heap was used where it is forbidden"),
        "{printed}"
    );
    let call = guarded("print");
    assert_eq!(call.status.signal(), Some(libc::SIGSYS));
    let good = guarded("work");
    assert!(good.status.success(), "{good:?}");
}
