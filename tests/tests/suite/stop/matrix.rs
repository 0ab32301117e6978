//! A stop in each mode, under each condition that could prevent it, with and without floods. Either it is
//! accepted and the robot rests within the cycles of the ramp, or the error is true and the robot rests
//! nevertheless. A false success never occurs.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use cdcr_client::{Connection, monotonic_ns};
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_shared_types::{Obstacle, Telemetry};
use cdcr_testbed::quantiles::{histogram, quantile_us};
use cdcr_tests::load::{Done, flood_obstacles, flood_references};
use cdcr_tests::{
    Daemon, EndWhenDropped, Place, ask_for, asked, assert_output, ball, oversleep_until, text,
    wait_status, wait_until,
};

use super::access::{Crowd, die};
use super::beside::Beside;
use crate::faults::reference::track;
use crate::faults::trail::{Trail, assert_ramps_to_rest, is, rests};
use crate::own_mounts::name_of;

/// Modes that one daemon is brought to one after the other.
const MODES: [Mode; 4] = [Mode::Holding, Mode::Tracking, Mode::Homing, Mode::Stopped];
/// Time limit from the shell to the answer. Checked only when a bare loop meanwhile and the starts before and
/// after were undisturbed.
const STOP_MAX: Duration = Duration::from_millis(300);
/// Without an answer, a client sends the signal after the first time, and gives up after both.
const UNANSWERED: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(1)];
/// An undisturbed machine starts and ends a program within this time, and wakes a sleeping thread within the
/// next one.
const START_MAX: Duration = Duration::from_millis(80);
const OVERSLEPT_MAX: Duration = Duration::from_millis(10);
/// Attempts for a stop that is late without an observed disturbance.
pub(super) const TRIES: usize = 3;

const BENT: &str = "[link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n";
/// Without measurements, the daemon keeps starting.
const UNHEARD: &str = "[link]\nkind = \"driver\"\n";

/// Inside the robot's body: a fault.
fn ball_inside() -> Obstacle {
    ball(63, [0.0, 0.0, 0.02])
}

/// Duration of a stop, and whether a disturbance of the machine was observed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Timed {
    pub(super) took: Duration,
    is_undisturbed: bool,
}

impl Timed {
    /// Whether it took longer than guaranteed without an observed disturbance.
    pub(super) fn is_late(&self) -> bool {
        self.is_longer_than(STOP_MAX)
    }

    fn is_longer_than(&self, most: Duration) -> bool {
        self.is_undisturbed && self.took > most
    }
}

/// A row of the table: a condition, and the durations of its stops.
struct StopRow {
    beside: Beside,
    has_floods: bool,
    /// From the request to the answer.
    answers: Vec<Duration>,
    /// From the request to the release of the first command in a stopping mode, if the mode before was
    /// another one.
    stopped: Vec<Duration>,
}

impl StopRow {
    /// Stops a daemon in `mode`, and makes it hold again if possible. Returns false if the stop was late
    /// without an observed disturbance, `None` if the system does not permit the condition.
    fn stop_in(&mut self, stage: &mut Stage<'_>, mode: Mode) -> Option<bool> {
        let connection = stage.connection;
        let feeding = (mode == Mode::Tracking).then(|| track(connection, 100, 40));
        match mode {
            Mode::Homing => drop(ask_for(connection, RequestKind::Home)),
            Mode::Stopped => drop(ask_for(connection, RequestKind::Stop)),
            _ => {}
        }
        stage.trail.until("the mode", is(mode));
        if mode == Mode::Homing {
            stage.trail.until("moving", |record| !rests(record));
        }
        let obstruction = self.beside.obstruct(stage.daemon)?;
        let place: &Place = stage.daemon.place();
        // A stop without an answer takes as long as the queue of the trail lasts.
        let (timed, output, begin_ns) = stage.trail.keep_while(|| {
            let (mut output, mut begin_ns) = (None, 0);
            let timed = timed(place, || {
                begin_ns = monotonic_ns();
                output = Some(place.cdcrctl(&["stop"]));
            });
            (timed, output.unwrap(), begin_ns)
        });
        drop(obstruction);
        let first = match self.beside.unconfirmed() {
            Some(words) if !(self.beside.may_have_room() && output.status.success()) => {
                stage.not_confirmed(&output, mode, words)
            }
            _ => Some(stage.confirmed(&output, mode)),
        };
        let stopped = first.map(|first| first.release_ns.saturating_sub(begin_ns));
        let stopped = stopped.map(Duration::from_nanos);
        let is_late = self.note(mode, timed, stopped);
        drop(feeding);
        if !(matches!(mode, Mode::Faulted | Mode::Starting) || self.beside == Beside::EmptiedRoot) {
            ask_for(connection, RequestKind::Reset);
            stage.trail.until("holding", is(Mode::Holding));
        }
        Some(!is_late)
    }

    /// Prints a line. Returns whether the stop was late.
    fn note(&mut self, mode: Mode, timed: Timed, stopped: Option<Duration>) -> bool {
        let note = if timed.is_undisturbed {
            ""
        } else {
            "  (disturbed: not evaluated)"
        };
        println!(
            "  {:<10}{:>7.1?} to the answer, {stopped:.1?} to the first command{note}",
            mode.text(),
            timed.took
        );
        self.answers.push(timed.took);
        self.stopped.extend(stopped);
        let [signal_after, give_up_after] = UNANSWERED;
        let (answer_max, stopped_max) = match self.beside {
            Beside::HungExchange => (
                STOP_MAX + signal_after + give_up_after,
                STOP_MAX + signal_after,
            ),
            _ => (STOP_MAX, STOP_MAX),
        };
        let stopped = Timed {
            took: stopped.unwrap_or_default(),
            ..timed
        };
        timed.is_longer_than(answer_max) || stopped.is_longer_than(stopped_max)
    }

    /// Stops daemons in all modes.
    fn stop_in_all(&mut self, test: &str) {
        if self.has_floods && !self.beside.is_flooded_in_each_mode() && !is_whole() {
            return self.stop_daemons(&[Mode::Tracking], test);
        }
        let last = [Mode::Faulted, Mode::Starting];
        // An emptied folder ends each daemon.
        let parts = if self.beside == Beside::EmptiedRoot {
            MODES.chunks(1)
        } else {
            MODES.chunks(MODES.len())
        };
        for modes in parts.chain(last.chunks(1)) {
            self.stop_daemons(modes, test);
        }
    }

    /// Repeats the modes with a late stop.
    fn stop_daemons(&mut self, modes: &[Mode], test: &str) {
        let mut left = modes.to_vec();
        for _ in 0..TRIES {
            left = self.stop_one_daemon(&left, test);
            if left.is_empty() {
                return;
            }
        }
        panic!("{left:?} beside {:?}", self.beside);
    }

    /// Returns the modes with a late stop.
    fn stop_one_daemon(&mut self, modes: &[Mode], test: &str) -> Vec<Mode> {
        let link = if modes == [Mode::Starting] {
            UNHEARD
        } else {
            BENT
        };
        let (mut daemon, _log) = self.beside.start(link);
        let connection = daemon.connect();
        if modes == [Mode::Faulted] {
            // Before the floods, whose obstacles may take all the space.
            let obstacles = connection.obstacle_sender().unwrap();
            obstacles.upsert_anywhere(&[ball_inside()]).unwrap();
            wait_status(&connection, |status| status.mode == Mode::Faulted.code());
        }
        let ending = AtomicBool::new(false);
        let done = Done::default();
        self.beside.prepare(&daemon, test);
        let late = std::thread::scope(|scope| {
            let place: &Place = daemon.place();
            if self.has_floods {
                scope.spawn(|| flood_references(place, &ending, &done));
                scope.spawn(|| flood_obstacles(place, &ending, &done));
            }
            let _ends = EndWhenDropped(&ending);
            wait_until("the floods begin", || {
                let begun = |done: &AtomicU64| done.load(Ordering::Relaxed) > 0;
                !self.has_floods || begun(&done.updates) && begun(&done.chunks)
            });
            connection.prepare_requests().unwrap();
            // Its clients need a long time to connect beside floods.
            let _crowd = (self.beside == Beside::Crowd).then(|| Crowd::connect(place.location()));
            let mut stage = Stage {
                daemon: &daemon,
                connection: &connection,
                trail: Trail::new(&connection),
                may_end: self.beside == Beside::EmptiedRoot,
            };
            let mut is_late = |mode: &&Mode| self.stop_in(&mut stage, **mode) == Some(false);
            modes.iter().filter(|mode| is_late(mode)).copied().collect()
        });
        if self.beside == Beside::EmptiedRoot {
            assert_eq!(daemon.stop_after_signal().code(), Some(83));
        }
        late
    }
}

/// The daemon of a stop.
struct Stage<'a> {
    daemon: &'a Daemon,
    connection: &'a Connection,
    trail: Trail,
    may_end: bool,
}

impl Stage<'_> {
    /// Checks that the robot rests from the cycle in the answer on, and returns the record of that cycle.
    fn confirmed(&mut self, output: &std::process::Output, mode: Mode) -> Telemetry {
        let goal = if mode == Mode::Faulted {
            Mode::Faulted
        } else {
            Mode::Stopped
        };
        let parts = format!("the daemon is {}", goal.text());
        let printed = assert_output(output, 0, &[&parts]);
        let cycle = accepted_in(&printed);
        let trail = &mut self.trail;
        let (_, first) = trail.until("the cycle of the answer", |record| record.cycle >= cycle);
        assert_eq!(first.mode, goal.code(), "cycle {} of {cycle}", first.cycle);
        assert_ramps_to_rest(trail, &first, || {});
        for _ in 0..20 {
            let (_, later) = trail.until("later", |_| true);
            assert!(rests(&later) && later.mode == goal.code());
        }
        first
    }

    /// Checks that there is no answer, that the output does not claim a stopped robot, and that the robot
    /// rests. Returns the record of the first cycle that stops it, unless it was at rest before.
    fn not_confirmed(
        &mut self,
        output: &std::process::Output,
        mode: Mode,
        words: &str,
    ) -> Option<Telemetry> {
        let printed = text(output);
        assert_eq!(output.status.code(), Some(1), "{printed}");
        // If the daemon detects its emptied folder before the stop, it comes to rest and ends; its exit
        // status is checked later.
        let has_ended = self.may_end && printed.contains("no daemon is running");
        for words in ["not confirmed", words] {
            assert!(has_ended || printed.contains(words), "{words}: {printed}");
        }
        if Mode::is_latched(mode.code()) {
            return None;
        }
        let (_, stopped) = self.trail.until("stopped", is(Mode::Stopped));
        assert_ramps_to_rest(&mut self.trail, &stopped, || {});
        Some(stopped)
    }
}

/// Duration of `stop`, measured beside a sleeping bare loop and between two starts of a program that does
/// nothing.
pub(super) fn timed(place: &Place, stop: impl FnOnce()) -> Timed {
    let started = start_a_program(place);
    let ending = AtomicBool::new(false);
    let (took, overslept) = std::thread::scope(|scope| {
        let bare = scope.spawn(|| oversleep_until(&ending));
        let begin = Instant::now();
        {
            let _ends = EndWhenDropped(&ending);
            stop();
        }
        (begin.elapsed(), bare.join().unwrap())
    });
    let started = started.max(start_a_program(place));
    Timed {
        took,
        is_undisturbed: started < START_MAX && overslept < OVERSLEPT_MAX,
    }
}

fn start_a_program(place: &Place) -> Duration {
    let begin = Instant::now();
    assert!(place.cdcrctl(&["--version"]).status.success());
    begin.elapsed()
}

/// The cycle that accepted the request, according to the client.
fn accepted_in(printed: &str) -> u64 {
    let (_, cycle) = printed.split_once("accepted in cycle ").unwrap();
    cycle.split(',').next().unwrap().parse().unwrap()
}

/// Number of rounds of stops, for a table of their durations.
fn rounds() -> usize {
    asked("CDCR_STOP_ROUNDS").unwrap_or(1)
}

/// Whether each row is flooded in each mode: floods take the cores from parallel tests.
fn is_whole() -> bool {
    let asks = |key: &str| std::env::var_os(key).is_some();
    asks("CDCR_WHOLE") || asks("CDCR_STOP_ROUNDS")
}

/// Runs a row, without floods and with them, and prints it.
fn run<T: Fn()>(beside: Beside, test: &T) {
    run_with(beside, &[false, true], test);
}

fn run_with<T: Fn()>(beside: Beside, floods: &[bool], test: &T) {
    let test = &name_of(test);
    if die() || !beside.is_ready(test) {
        return;
    }
    for &has_floods in floods {
        println!("a stop beside {beside:?}, floods: {has_floods}");
        let mut row = StopRow {
            beside,
            has_floods,
            answers: Vec::new(),
            stopped: Vec::new(),
        };
        (0..rounds()).for_each(|_| row.stop_in_all(test));
        let of = |times: &[Duration]| {
            if times.is_empty() {
                return "0 | - | -".to_owned();
            }
            let mut times_ns = histogram();
            for time in times {
                times_ns.saturating_record(time.as_nanos() as u64);
            }
            let [median, largest] = [0.5, 1.0].map(|part| 1e-3 * quantile_us(&times_ns, part));
            format!("{} | {median:.0} | {largest:.0}", times.len())
        };
        let floods = if has_floods { "yes" } else { "no" };
        let (answers, stopped) = (of(&row.answers), of(&row.stopped));
        println!("| {beside:?} | {floods} | {answers} | {stopped} |");
    }
}

#[test]
fn a_stop_in_each_mode_is_carried_out() {
    run(Beside::Nothing, &a_stop_in_each_mode_is_carried_out);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_a_crowd() {
    run_with(
        Beside::Crowd,
        &[false],
        &a_stop_in_each_mode_is_carried_out_beside_a_crowd,
    );
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_a_crowd_and_floods() {
    run_with(
        Beside::Crowd,
        &[true],
        &a_stop_in_each_mode_is_carried_out_beside_a_crowd_and_floods,
    );
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_the_dead() {
    run(
        Beside::DeadNodes,
        &a_stop_in_each_mode_is_carried_out_beside_the_dead,
    );
}

#[test]
fn a_stop_in_each_mode_is_carried_out_while_the_supervisor_hangs() {
    run(
        Beside::HungSupervisor,
        &a_stop_in_each_mode_is_carried_out_while_the_supervisor_hangs,
    );
}

#[test]
fn a_stop_in_each_mode_is_carried_out_and_not_confirmed_while_the_exchange_hangs() {
    run(
        Beside::HungExchange,
        &a_stop_in_each_mode_is_carried_out_and_not_confirmed_while_the_exchange_hangs,
    );
}

#[test]
fn a_stop_in_each_mode_is_carried_out_and_not_confirmed_without_memory() {
    run(
        Beside::FullMemory,
        &a_stop_in_each_mode_is_carried_out_and_not_confirmed_without_memory,
    );
}

#[test]
fn a_stop_in_each_mode_is_carried_out_and_not_confirmed_without_inodes() {
    run(
        Beside::FewInodes,
        &a_stop_in_each_mode_is_carried_out_and_not_confirmed_without_inodes,
    );
}

#[test]
fn a_stop_in_each_mode_is_not_confirmed_in_an_emptied_folder_and_the_daemon_ends_at_rest() {
    run(
        Beside::EmptiedRoot,
        &a_stop_in_each_mode_is_not_confirmed_in_an_emptied_folder_and_the_daemon_ends_at_rest,
    );
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_a_log_that_nobody_reads() {
    run(
        Beside::FullStderr,
        &a_stop_in_each_mode_is_carried_out_beside_a_log_that_nobody_reads,
    );
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_a_journal_that_stands_still() {
    run(
        Beside::FullJournal,
        &a_stop_in_each_mode_is_carried_out_beside_a_journal_that_stands_still,
    );
}
