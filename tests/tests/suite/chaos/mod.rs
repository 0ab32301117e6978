//! The randomised run: random actions on a daemon from a seed, while the invariants are checked on every
//! record. `docs/testing.md` describes longer runs and how to repeat a run.

mod action;
mod checker;
mod clearance;
mod crowd;
mod cycles;
pub(crate) mod dice;
mod director;
mod feeder;
mod grid;
pub(crate) mod integral;
pub(crate) mod limits;
mod modes;
mod obstacles;
pub(crate) mod ramp;
mod records;
mod tally;
mod unfinished;

use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use cdcr_client::FeedOptions;
use cdcr_controller::plant::RobotPreset;
use cdcr_shared_types::codes::{Interface, Mode};
use cdcr_tests::driver::DriverProcess;
use cdcr_tests::{Daemon, EndWhenDropped, TIMEOUT, asked, paper_line, wait_mode, wait_until};

use action::ROUND;
use checker::{Checker, View};
use dice::Dice;
use director::Director;
use tally::Tally;

/// Whether an invariant holds, or how it is broken.
pub(crate) type CheckResult = Result<(), String>;

/// Fails with the text of `broken` unless `condition` holds.
pub(crate) fn ensure(condition: bool, broken: impl FnOnce() -> String) -> CheckResult {
    if condition { Ok(()) } else { Err(broken()) }
}

/// As in operation, with these exceptions. Cable limits become active, and the lease is short. The leaky
/// bucket is not filled by stalls, because a machine with one bad release in ten never drains it. Commands
/// are valid while an exchange on a busy core is delayed. The watchdog tolerates a stalled machine.
const CONFIGURATION: &str = "[robot]\ncable_speed_max_m_s = 0.06\ncable_stroke_max_m = 0.06\ntip_speed_max_m_s = 0.3\n\
    [cycle]\nmiss_limit = 1000000\nwatchdog_ms = 10000.0\n[reference]\nlease_ms = 200.0\n";

/// A run of this length must contain every kind of bad message.
const KINDS_TAKE: Duration = Duration::from_secs(25);

/// The given seed of the run, or the time.
fn seed() -> u64 {
    let now = || SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    asked("CDCR_CHAOS_SEED").unwrap_or_else(|| now().as_millis() as u64)
}

/// Half of the duration: the other half is for the other robot.
fn half() -> Duration {
    Duration::from_secs(asked("CDCR_CHAOS_S").unwrap_or(16)) / 2
}

#[test]
fn whatever_happens_with_a_simulated_robot_the_invariants_hold() {
    run("simulated");
}

#[test]
fn whatever_happens_behind_a_driver_the_invariants_hold() {
    run("driver");
}

fn run(link: &str) {
    let (seed, duration) = (seed(), half());
    let mut dice = Dice::new(seed);
    let interface = dice.pick(&[Interface::Velocity, Interface::Position]);
    let preset = dice.pick(&RobotPreset::ALL).name();
    println!(
        "{link}, {interface}, {preset}: CDCR_CHAOS_SEED={seed}, {} s",
        duration.as_secs()
    );
    let mut daemon = Daemon::start(&format!(
        "[link]\nkind = \"{link}\"\ninterface = \"{interface}\"\nsimulated = \"{preset}\"\ncommand_valid_ms = 100.0\n{CONFIGURATION}"
    ));
    let has_driver = link == "driver";
    let driver = has_driver.then(|| DriverProcess::start(daemon.place()));
    let (view, tally, ending) = (
        View::new(duration),
        Tally::default(),
        AtomicBool::new(false),
    );
    let (seen, driver) = std::thread::scope(|scope| {
        let (checking, feeding) = (daemon.place(), daemon.place());
        let checker = scope.spawn(|| {
            let connection = cdcr_tests::load::connect(checking);
            Checker::new(connection, &view).run(&ending)
        });
        let files = scope.spawn(|| unfinished::watch(checking, &ending));
        let dice_of_feeder = dice.split();
        let feeder = scope.spawn(|| {
            let connection = cdcr_tests::load::connect(feeding);
            feeder::feed(&connection, dice_of_feeder, &tally, &ending);
        });
        let director = Director::new(&daemon, driver, &view, &tally, dice);
        let driver = {
            let _ends = EndWhenDropped(&ending);
            director.run(duration, &ending)
        };
        feeder.join().unwrap();
        let seen = checker.join().unwrap();
        (files.join().unwrap().and(seen), driver)
    });
    let again = format!("repeat it with CDCR_CHAOS_SEED={seed}; the daemon's log:");
    let log = daemon.log();
    let seen = seen.unwrap_or_else(|broken| panic!("{broken}\n{again}\n{log}"));
    let driver = driver.unwrap_or_else(|broken| panic!("{broken}\n{again}\n{log}"));
    println!("{}{seen:#?}", tally.table());
    assert_it_happened(&tally, has_driver, duration);
    assert_eq!(seen.missing(duration), None);
    assert!(daemon.runs(), "the daemon is gone\n{again}\n{log}");
    assert!(driver.is_none_or(|mut driver| driver.runs()));
    // The robot gets a new driver.
    let driver = has_driver.then(|| DriverProcess::start(daemon.place()));
    come_back(&daemon);
    drop(driver);
    daemon.end_clean();
}

/// Checks that the actions had effects; otherwise the run proves nothing.
fn assert_it_happened(tally: &Tally, has_driver: bool, duration: Duration) {
    for (action, _) in ROUND {
        let happened = tally.get(&format!("action: {action:?}")) > 0;
        let possible = has_driver || !action.needs_driver();
        assert!(happened == possible, "{action:?} did not happen");
    }
    let with_lease = tally.get("bad or late points: with the lease");
    assert!(with_lease > 0 || duration < KINDS_TAKE);
}

/// Afterwards the daemon works as before: it can be reset, tracks to the end, and has no obstacle.
fn come_back(daemon: &Daemon) {
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    let line = paper_line(0.3);
    let options = FeedOptions {
        track: true,
        ..FeedOptions::default()
    };
    // Remaining load of the machine may stop it once more.
    wait_until("it tracks again", || {
        let track = || {
            connection.reset_within(true, TIMEOUT)?;
            connection
                .feed(&line, options)?
                .run(|_| ControlFlow::Continue(()))
        };
        match track() {
            Ok(report) if report.tracked => true,
            other => {
                println!("not yet: {other:?}");
                false
            }
        }
    });
    let record = wait_mode(&mut telemetry, Mode::Tracking);
    assert_eq!(record.obstacle_count, 0);
}
