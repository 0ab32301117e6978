//! Time: deadline misses, a starved core, clocks that jump, results that are NaN.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use cdcr_client::{Connection, monotonic_ns};
use cdcr_controller::reference::{Interpolation, Orientation, ReferencePoint, Trajectory};
use cdcr_controller::safety::{LeaseState, Mode as InnerMode, Reason as InnerReason, Request};
use cdcr_daemon::config::{Config, Validated};
use cdcr_daemon::cycle::Cycle;
use cdcr_daemon::handover::{
    CycleInputs, CycleRecord, CycleRequest, RuntimeSettings, TimedMeasurement,
};
use cdcr_daemon::link::CycleRobot;
use cdcr_daemon::rt::clock::ManualClock;
use cdcr_daemon::rt::schedule::Release;
use cdcr_daemon::rt::suspend::SuspendWatch;
use cdcr_daemon::rt::sys::set_fifo;
use cdcr_shared_types::codes::{LateCause, Mode, Reason, RequestKind, timing};
use cdcr_test_skip::{Need, skip};
use cdcr_testbed::system::thread::pin;
use cdcr_tests::{Daemon, TIMEOUT, wait_status};
use rustix::process::Signal;
use rustix::time::{ClockId, Timespec, clock_gettime, clock_settime};

use crate::faults::trail::{Trail, alone, is, say};

/// A daemon that stops its robot after `periods` without a command.
fn tolerant_for(periods: u32) -> Daemon {
    Daemon::start(&format!("[cycle]\nmiss_limit = {periods}\n"))
}

/// Checks that the cycle after the one that filled the leaky bucket stops the robot.
fn assert_stops(trail: &mut Trail, what: &str) {
    let (before, now) = trail.until("the stop", is(Mode::Stopped));
    assert_eq!(now.reason, Reason::DeadlineMisses.code());
    assert!(before.miss_bucket >= before.miss_limit);
    let detected_ns = now.start_ns - before.handed_over_ns;
    let bound_ns = now.start_ns - before.release_ns;
    println!(
        "{what}: bucket at {} of {} in cycle {}",
        before.miss_bucket, before.miss_limit, before.cycle
    );
    say("  overflow to stop", detected_ns, bound_ns);
    assert_eq!(now.cycle, before.cycle + 1 + u64::from(now.skipped_periods));
}

/// With good releases, a bucket of the tests is empty after a quarter of this time.
const DRAINS_IN: Duration = Duration::from_secs(20);

/// Resets, which is accepted when the bucket is below its limit after good releases. Returns false if at
/// least one release in ten was bad, so that it was never accepted.
fn reset(connection: &Connection, trail: &mut Trail) -> bool {
    let begin = Instant::now();
    let (mut releases, mut bad) = (0, 0);
    while connection.request(RequestKind::Reset).is_err() {
        while let Some(record) = trail.next_waiting() {
            let is_bad = record.timing_flags & (timing::DEADLINE_MISS | timing::STALE_INPUTS) != 0;
            releases += 1 + record.skipped_periods;
            bad += u32::from(is_bad) + record.skipped_periods;
        }
        if begin.elapsed() > DRAINS_IN {
            assert!(10 * bad >= releases, "{bad} of {releases} were bad");
            return false;
        }
    }
    trail.until("holding", is(Mode::Holding));
    true
}

/// Reports why a test ends early.
fn skip_never_drained() {
    skip(
        Need::OnTime,
        "more than one release in ten is bad here, so the leaky bucket never drains",
    );
}

#[test]
fn a_machine_that_stands_still_for_too_long_stops_the_robot() {
    let daemon = tolerant_for(60);
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    // A stall at the start may have stopped it.
    if !reset(&connection, &mut trail) {
        return skip_never_drained();
    }
    daemon.signal(Signal::STOP);
    std::thread::sleep(Duration::from_millis(800));
    daemon.signal(Signal::CONT);
    assert_stops(&mut trail, "process stopped for 0.8 s");
    if !reset(&connection, &mut trail) {
        skip_never_drained();
    }
}

/// More periods than the limit of misses in the test.
const HOGGED: Duration = Duration::from_millis(180);

/// Occupies `core` for `time`, at the highest priority that `packaging/limits.conf` grants.
fn hog(core: usize, time: Duration) {
    assert!(pin(core));
    set_fifo(90).unwrap();
    let begin = Instant::now();
    while begin.elapsed() < time {
        std::hint::spin_loop();
    }
}

#[test]
fn a_core_that_another_task_takes_stops_the_robot_and_names_the_load() {
    let daemon = tolerant_for(20);
    let connection = daemon.connect();
    let status = wait_status(&connection, |status| status.cycles > 5);
    if status.realtime_missing != 0 {
        skip(
            Need::Realtime,
            "the daemon is not real-time, so that nobody can take its core for good",
        );
        return;
    }
    let _alone = alone();
    let mut trail = Trail::new_alone(&connection);
    // A stall at the start may have stopped it.
    if !reset(&connection, &mut trail) {
        return skip_never_drained();
    }
    let core = status.core as usize;
    let hogging = std::thread::spawn(move || hog(core, HOGGED));
    assert_stops(&mut trail, "core taken for 0.18 s");
    hogging.join().unwrap();
    let load = LateCause::Load.code() as usize;
    wait_status(&connection, |status| status.since_reset.causes[load] > 0);
}

/// Sets the wall clock by `hours` and back.
fn jump_wall_clock(hours: i64, meanwhile: impl FnOnce()) {
    let begin = monotonic_ns();
    let right = clock_gettime(ClockId::Realtime);
    let moved = |seconds, nanoseconds| Timespec {
        tv_sec: right.tv_sec + seconds,
        tv_nsec: nanoseconds,
    };
    clock_settime(ClockId::Realtime, moved(hours * 3600, right.tv_nsec)).unwrap();
    meanwhile();
    let passed = right.tv_nsec + (monotonic_ns() - begin).cast_signed();
    let back = moved(passed / 1_000_000_000, passed % 1_000_000_000);
    clock_settime(ClockId::Realtime, back).unwrap();
}

#[test]
fn a_wall_clock_that_jumps_is_not_noticed() {
    if std::env::var_os("CDCR_TEST_SET_CLOCK").is_none() {
        skip(
            Need::Clock,
            "it sets the clock of the machine; CDCR_TEST_SET_CLOCK=1 allows it",
        );
        return;
    }
    let daemon = Daemon::start("[cycle]\nmiss_limit = 1000000\n");
    let connection = daemon.connect();
    let mut trail = Trail::new(&connection);
    let (_, first) = trail.until("holding", is(Mode::Holding));
    let mut look = || {
        let mut records = 0;
        trail.until("the next record", |record| {
            let passed = (record.cycle - first.cycle) * record.period_ns;
            assert_eq!(
                record.release_ns,
                first.release_ns + passed,
                "the grid stays"
            );
            records += 1;
            records > 40
        });
        assert!(connection.status(TIMEOUT).is_ok(), "the status is fresh");
    };
    jump_wall_clock(25, &mut look);
    jump_wall_clock(-25, &mut look);
    look();
    assert_eq!(connection.status(TIMEOUT).unwrap().faults, 0);
}

/// All Rust files below a folder.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().flatten();
    let mut files = Vec::new();
    for path in entries.map(|entry| entry.path()) {
        if path.is_dir() {
            files.extend(sources(&path));
        } else if path.extension().is_some_and(|end| end == "rs") {
            files.push(path);
        }
    }
    files
}

#[test]
fn nothing_that_controls_looks_at_the_wall_clock() {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut looked = 0;
    for folder in [
        "controller/src",
        "shared-types/src",
        "daemon/src",
        "client/src",
    ] {
        for path in sources(&workspace.join(folder)) {
            // A recording has the date as a stamp, and controls nothing.
            if path.ends_with("cdcrctl/recording/when.rs") {
                continue;
            }
            looked += 1;
            let text = std::fs::read_to_string(&path).unwrap();
            for clock in [
                "SystemTime",
                "CLOCK_REALTIME",
                "ClockId::Realtime",
                "UNIX_EPOCH",
            ] {
                assert!(!text.contains(clock), "{} uses {clock}", path.display());
            }
        }
    }
    assert!(looked > 100, "{looked} files");
}

const PERIOD_NS: u64 = 5_000_000;

/// Inputs that no message can contain: they bypass all checks.
fn unchecked_inputs(settings: RuntimeSettings, position_m: f64) -> CycleInputs {
    let mut trajectory = Trajectory::with_capacity(10, f64::INFINITY);
    let points = (0..10).map(|k| ReferencePoint {
        time_ns: k * 10 * PERIOD_NS,
        position_m: nalgebra::Vector3::new(position_m, 0.0, 0.89),
        orientation: Orientation::Free,
        interpolation: Interpolation::Linear,
    });
    trajectory.replace(points).unwrap();
    let mut inputs = CycleInputs::new(settings);
    inputs
        .window
        .fill(&trajectory, 1, PERIOD_NS, PERIOD_NS, 2, 0);
    inputs.lease = LeaseState::Held;
    inputs
}

/// Runs the cycle of this number on time. The first one gets a request to track.
fn run(
    cycle: &mut Cycle,
    number: u64,
    inputs: &mut CycleInputs,
    validated: &Validated,
) -> CycleRecord {
    let release_ns = number * PERIOD_NS;
    inputs.measurement = Some(TimedMeasurement {
        measurement: cdcr_controller::estimator::Measurement::Configuration(validated.initial),
        measured_ns: release_ns - 1,
        rested_ns: [0; 2],
    });
    let release = Release {
        cycle: number,
        release_ns,
        due_ns: release_ns,
        start_ns: release_ns,
        skipped: 0,
    };
    let mut request = (number == 1).then_some(CycleRequest {
        ticket: 1,
        request: Request::Track { lease_number: 0 },
        asked_ns: release_ns,
        stops: 0,
    });
    let clock = ManualClock::new(release_ns);
    cycle.run(release, inputs, || request.take(), &clock)
}

#[test]
fn a_solver_that_finds_no_number_is_a_fault_in_its_cycle_and_commands_the_ramp() {
    let validated = Config::parse("[link]\nkind = \"driver\"\n", Path::new("robot.toml")).unwrap();
    for (position_m, expected) in [
        (0.01, InnerMode::Tracking { begun: false }),
        (
            f64::NAN,
            InnerMode::Faulted {
                reason: InnerReason::NonFinite,
            },
        ),
    ] {
        let mut cycle = Cycle::new(&validated, CycleRobot::Driver).unwrap();
        let mut inputs = unchecked_inputs(RuntimeSettings::new(&validated.config), position_m);
        let record = run(&mut cycle, 1, &mut inputs, &validated);
        assert_eq!(record.mode, expected);
        assert!(record.rates.as_slice().iter().all(|rate| rate.is_finite()));
        let is_fault = matches!(record.mode, InnerMode::Faulted { .. });
        assert!(!is_fault || record.rates.as_slice().iter().all(|rate| *rate == 0.0));
    }
}

#[test]
fn a_machine_that_slept_stops_the_robot_in_the_first_cycle_that_knows_it() {
    // A test cannot suspend its machine: the two clock values are given, the rest is the daemon's code.
    let mut watch = SuspendWatch::default();
    let validated = Config::parse("[link]\nkind = \"driver\"\n", Path::new("robot.toml")).unwrap();
    let mut cycle = Cycle::new(&validated, CycleRobot::Driver).unwrap();
    let mut inputs = unchecked_inputs(RuntimeSettings::new(&validated.config), 0.01);
    for (number, slept_ns, expected) in [
        (1, 60_000_000_000, InnerMode::Tracking { begun: false }),
        (2, 60_000_000_000, InnerMode::Tracking { begun: true }),
        (
            3,
            61_000_000_000,
            InnerMode::Stopped {
                reason: InnerReason::Suspended,
            },
        ),
    ] {
        inputs.gather = number;
        inputs.suspends = watch.update(&(slept_ns..=slept_ns));
        let record = run(&mut cycle, number, &mut inputs, &validated);
        assert_eq!(record.mode, expected, "cycle {number}");
    }
}
