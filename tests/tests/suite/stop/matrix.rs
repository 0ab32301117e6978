//! A stop in each mode, beside each thing that could keep it out, with and without floods: accepted and at rest within
//! the cycles of the ramp, or an error that is true; never a success that is not.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cdcr_client::{Connection, monotonic_ns};
use cdcr_shared_types::Obstacle;
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_tests::load::{Done, flood_obstacles, flood_references};
use cdcr_tests::{
    Daemon, EndWhenDropped, Place, TIMEOUT, assert_says, text, until_undisturbed, wait_status,
    wait_until,
};

use super::access::{Crowd, die, kill_a_victim};
use crate::faults::reference::track;
use crate::faults::threads::Hung;
use crate::faults::trail::{Trail, assert_ramps_to_rest, is, rests};

/// Modes that one daemon is brought to one after the other.
const MODES: [Mode; 4] = [Mode::Holding, Mode::Tracking, Mode::Homing, Mode::Stopped];
/// From the shell to the answer; judged only where a bare loop beside it and the starts around it were undisturbed.
const STOP_MAX: Duration = Duration::from_millis(300);
/// A machine on which a program starts and ends in this time, and a thread that sleeps wakes up within the other, is not
/// disturbed.
const START_MAX: Duration = Duration::from_millis(80);
const OVERSLEPT_MAX: Duration = Duration::from_millis(10);
/// A stop that the machine disturbed where nobody saw it is tried again so often.
pub(super) const TRIES: usize = 3;
/// A stop that goes as a signal is carried out so long before the program has given up.
const LONG_BEFORE_NS: u64 = 500_000_000;

/// What could keep a stop out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Beside {
    Nothing,
    Crowd,
    DeadNodes,
    HungSupervisor,
    HungExchange,
}

impl Beside {
    fn hung_thread(self) -> Option<&'static str> {
        match self {
            Self::HungSupervisor => Some("cdcrd"),
            Self::HungExchange => Some("cdcr-exchange"),
            Self::Nothing | Self::Crowd | Self::DeadNodes => None,
        }
    }

    /// Slow enough that a robot still moves when the stop arrives. A hung exchange needs room for the records of a second.
    fn configuration(self) -> String {
        let period_ms = if self == Self::HungExchange {
            50.0
        } else {
            5.0
        };
        format!(
            "[cycle]\nperiod_ms = {period_ms:?}\nmiss_limit = 1000000\nwatchdog_ms = 20000.0\n\
             [reference]\nlease_ms = 60000.0\n[motion]\nhome_rate_rad_s = 0.1\n"
        )
    }
}

const BENT: &str = "[link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n";
/// Nobody measures: it keeps starting.
const UNHEARD: &str = "[link]\nkind = \"driver\"\n";

/// A ball in the body of the robot: a fault.
fn ball() -> Obstacle {
    Obstacle {
        id: 63,
        start_m: [0.0, 0.0, 0.02],
        end_m: [0.0, 0.0, 0.02],
        radius_m: 0.02,
        measured_ns: monotonic_ns(),
        ..Obstacle::default()
    }
}

/// What a stop took, and whether the machine was seen to disturb it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Timed {
    pub(super) took: Duration,
    is_undisturbed: bool,
}

impl Timed {
    /// Longer than is promised, and the machine was not seen to disturb it.
    pub(super) fn is_late(&self) -> bool {
        self.is_undisturbed && self.took > STOP_MAX
    }
}

/// A daemon in a mode that is stopped there again and again.
struct Stops<'a> {
    daemon: &'a Daemon,
    connection: &'a Connection,
    beside: Beside,
}

impl Stops<'_> {
    /// Stops it in `mode`, within the time that is promised wherever the machine was not seen to disturb it. Of Starting, which is
    /// left for good, the time is printed and not judged.
    fn stop_in_time(&self, trail: &mut Trail, mode: Mode) {
        if self.beside == Beside::HungExchange {
            until_undisturbed("a stop as a signal", || {
                let timed = self.stop_and_tell(trail, mode);
                timed.is_none_or(|timed| timed.is_undisturbed).then_some(())
            });
            return;
        }
        let tries = if mode == Mode::Starting { 1 } else { TRIES };
        let is_late = |timed: Timed| timed.is_late();
        let late = (0..tries).all(|_| self.stop_and_tell(trail, mode).is_some_and(is_late));
        assert!(
            !late || mode == Mode::Starting,
            "{mode} beside {:?}",
            self.beside
        );
    }

    /// A line of the table.
    fn stop_and_tell(&self, trail: &mut Trail, mode: Mode) -> Option<Timed> {
        let timed = self.stop_in(trail, mode)?;
        let took_ms = timed.took.as_secs_f64() * 1e3;
        let note = if timed.is_undisturbed {
            ""
        } else {
            "  (disturbed: not judged)"
        };
        println!("  {:<10}{took_ms:>7.1} ms{note}", mode.text());
        Some(timed)
    }

    /// Brings a daemon that holds into `mode`, stops it there, and has it hold again. None: the system lets nobody hang.
    fn stop_in(&self, trail: &mut Trail, mode: Mode) -> Option<Timed> {
        let connection = self.connection;
        let feeding = (mode == Mode::Tracking).then(|| track(connection, 100, 40));
        match mode {
            Mode::Homing => drop(connection.request(RequestKind::Home).unwrap()),
            Mode::Stopped => drop(connection.request(RequestKind::Stop).unwrap()),
            _ => {}
        }
        trail.until("the mode", is(mode));
        if mode == Mode::Homing {
            trail.until("moving", |record| !rests(record));
        }
        let hung = match self.beside.hung_thread() {
            Some(name) => Some(Hung::new(self.daemon.id(), name)?),
            None => None,
        };
        let timed = match hung {
            Some(hung) if self.beside == Beside::HungExchange => {
                self.stop_by_signal(trail, mode, hung)
            }
            hung => {
                let timed = self.stop_and_rest(trail, mode);
                drop(hung);
                timed
            }
        };
        drop(feeding);
        if !matches!(mode, Mode::Faulted | Mode::Starting) {
            connection
                .request_within(RequestKind::Reset, TIMEOUT)
                .unwrap();
            trail.until("holding", is(Mode::Holding));
        }
        Some(timed)
    }

    /// The stop is confirmed, and the robot rests from the cycle on that the answer names.
    fn stop_and_rest(&self, trail: &mut Trail, mode: Mode) -> Timed {
        let goal = if mode == Mode::Faulted {
            Mode::Faulted
        } else {
            Mode::Stopped
        };
        let place = self.daemon.place();
        let mut printed = String::new();
        let timed = timed(place, || {
            let parts = format!("the daemon is {}", goal.text());
            printed = assert_says(&place.cdcrctl(&["stop"]), 0, &[&parts]);
        });
        assert_rests_from(trail, accepted_in(&printed), goal);
        timed
    }

    /// Nobody answers, and it is not said that the robot is stopped; it is, long before the program gives up.
    fn stop_by_signal(&self, trail: &mut Trail, mode: Mode, hung: Hung) -> Timed {
        let begin = Instant::now();
        let output = self.daemon.place().cdcrctl(&["stop"]);
        let (took, ended_ns) = (begin.elapsed(), monotonic_ns());
        drop(hung);
        let printed = text(&output);
        assert_eq!(output.status.code(), Some(1), "{printed}");
        assert!(printed.contains("not confirmed"), "{printed}");
        let mut is_undisturbed = true;
        if mode == Mode::Faulted {
            let (_, later) = trail.until("later", |record| record.release_ns > ended_ns);
            assert_eq!(later.mode, Mode::Faulted.code());
        } else {
            let (before, stopped) = trail.until("stopped", is(Mode::Stopped));
            assert_ramps_to_rest(trail, &stopped, || {});
            // A stall may end the reference before the stop comes. What has left its mode for good is not tried again.
            is_undisturbed = matches!(mode, Mode::Starting | Mode::Stopped)
                || before.mode == mode.code()
                    && before.cycle + 1 == stopped.cycle
                    && stopped.release_ns + LONG_BEFORE_NS < ended_ns;
        }
        Timed {
            took,
            is_undisturbed,
        }
    }
}

/// How long `stop` takes, beside a bare loop that sleeps, and between two starts of a program that does nothing.
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

/// The longest time that a sleep of a millisecond took longer.
fn oversleep_until(ending: &AtomicBool) -> Duration {
    const SLEEP: Duration = Duration::from_millis(1);
    let mut longest = Duration::ZERO;
    while !ending.load(Ordering::Relaxed) {
        let begin = Instant::now();
        std::thread::sleep(SLEEP);
        longest = longest.max(begin.elapsed().saturating_sub(SLEEP));
    }
    longest
}

/// The cycle that a client says its request was accepted in.
fn accepted_in(printed: &str) -> u64 {
    let (_, cycle) = printed.split_once("accepted in cycle ").unwrap();
    cycle.split(',').next().unwrap().parse().unwrap()
}

/// From the cycle of the answer on the mode is `goal`, and the rates ramp to zero.
fn assert_rests_from(trail: &mut Trail, cycle: u64, goal: Mode) {
    let (_, first) = trail.until("the cycle of the answer", |record| record.cycle >= cycle);
    assert_eq!(first.mode, goal.code(), "cycle {} of {cycle}", first.cycle);
    assert_ramps_to_rest(trail, &first, || {});
    for _ in 0..20 {
        let (_, later) = trail.until("later", |_| true);
        assert!(rests(&later) && later.mode == goal.code());
    }
}

fn run(beside: Beside, floods: bool) {
    println!(
        "a stop beside {beside:?}{}",
        if floods { " and floods" } else { "" }
    );
    stop_one_daemon(&MODES, beside, floods);
    stop_one_daemon(&[Mode::Faulted], beside, floods);
    stop_one_daemon(&[Mode::Starting], beside, floods);
}

fn stop_one_daemon(modes: &[Mode], beside: Beside, floods: bool) {
    let link = if modes == [Mode::Starting] {
        UNHEARD
    } else {
        BENT
    };
    let daemon = Daemon::start(&format!("{}{link}", beside.configuration()));
    let connection = daemon.connect();
    if modes == [Mode::Faulted] {
        // Before the floods, whose own obstacles may take all the room.
        let obstacles = connection.obstacle_sender().unwrap();
        obstacles.upsert(&[ball()]).unwrap();
        wait_status(&connection, |status| status.mode == Mode::Faulted.code());
    }
    let ending = AtomicBool::new(false);
    let done = Done::default();
    let place: &Place = daemon.place();
    if beside == Beside::DeadNodes {
        kill_a_victim(
            place,
            "stop::matrix::a_stop_in_each_mode_is_carried_out_beside_the_dead",
        );
    }
    std::thread::scope(|scope| {
        if floods {
            scope.spawn(|| flood_references(place, &ending, &done));
            scope.spawn(|| flood_obstacles(place, &ending, &done));
        }
        let _ends = EndWhenDropped(&ending);
        wait_until("the floods begin", || {
            !floods || done.updates.load(Ordering::Relaxed) > 0
        });
        connection.prepare_requests().unwrap();
        // It takes long to come, beside floods.
        let _crowd = (beside == Beside::Crowd).then(|| Crowd::of(place.location()));
        let mut trail = Trail::new(&connection);
        let stops = Stops {
            daemon: &daemon,
            connection: &connection,
            beside,
        };
        for mode in modes {
            stops.stop_in_time(&mut trail, *mode);
        }
    });
}

#[test]
fn a_stop_in_each_mode_is_carried_out() {
    run(Beside::Nothing, false);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_floods() {
    run(Beside::Nothing, true);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_a_crowd_that_floods() {
    run(Beside::Crowd, true);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_beside_the_dead() {
    if die() {
        return;
    }
    run(Beside::DeadNodes, false);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_while_the_supervisor_hangs() {
    run(Beside::HungSupervisor, false);
    run(Beside::HungSupervisor, true);
}

#[test]
fn a_stop_in_each_mode_is_carried_out_and_not_confirmed_while_the_exchange_hangs() {
    run(Beside::HungExchange, false);
}
