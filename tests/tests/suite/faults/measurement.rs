//! Faults of the driver and its measurements.

use std::collections::VecDeque;
use std::time::Duration;

use cdcr_client::{Connection, monotonic_ns};
use cdcr_controller::plant::Flaws;
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{Interface, MeasurementState, Mode, Outcome, Reason, RequestKind};
use cdcr_tests::{Daemon, TIMEOUT, ask_for, refused, reset_here, wait_status, wait_until};

use crate::faults::robot::{Robot, behind_both, is_held_by_a_stall};
use crate::faults::trail::{Trail, assert_ramps_to_rest, is, say};

/// Longer than any stall that keeps the test from measuring.
const TIMEOUT_MS: u64 = 1500;
const HOME_RATE_RAD_S: f64 = 0.2;
/// The largest rate of the default robot.
const RATE_MAX_RAD_S: f64 = 2.0;

/// Age of a measurement up to which its prediction is checked, however many stalls it contains.
const MADE_UP_MAX_NS: u64 = 300_000_000;

/// A daemon with a driver; only the measurement can cause a fault.
pub(super) fn daemon(interface: Interface) -> Daemon {
    daemon_with(interface, "")
}

fn daemon_with(interface: Interface, more: &str) -> Daemon {
    Daemon::start(&format!(
        "[link]\nkind = \"driver\"\ninterface = \"{interface}\"\nmeasurement_timeout_ms = {TIMEOUT_MS}.0\n\
         [motion]\nhome_rate_rad_s = {HOME_RATE_RAD_S}\ndeceleration_rad_s2 = 5.0\n\
         [cycle]\nmiss_limit = 1000000\n{more}"
    ))
}

pub(super) fn state(record: &Telemetry) -> MeasurementState {
    MeasurementState::try_from(record.measurement_state).unwrap()
}

/// Measures until a measurement is used.
fn until_used(trail: &mut Trail, robot: &mut Robot) -> (Telemetry, Telemetry) {
    let is_used = |record: &Telemetry| state(record) == MeasurementState::Used;
    trail.until_while("used", || robot.turn(), is_used)
}

/// Starts homing, and waits until the rate has been steady for a while.
pub(super) fn go_home(
    connection: &Connection,
    trail: &mut Trail,
    mut turn: impl FnMut(),
) -> Option<()> {
    ask_for(connection, RequestKind::Home);
    let mut homing = 0;
    let (_, record) = trail.until_while("homing", &mut turn, |record| {
        homing += u64::from(record.mode == Mode::Homing.code());
        homing > 20 || is_held_by_a_stall(record)
    });
    (!is_held_by_a_stall(&record)).then_some(())
}

/// Checks the fault of missing measurements: in the first cycle whose gather is later than the timeout after
/// the last measurement. Between two gathers at most two periods count.
pub(super) fn assert_lost(trail: &mut Trail, what: &str, meanwhile: impl FnMut()) {
    let (before, now) = trail.until_while("the fault", meanwhile, is(Mode::Faulted));
    assert_eq!(now.reason, Reason::MeasurementLost.code());
    let timeout_ns = TIMEOUT_MS * 1_000_000;
    let history = trail.history();
    let (counted_ns, uncounted_ns) = history.silence_ns(now.gather);
    assert!(history.silence_ns(before.gather).0 <= timeout_ns);
    assert!(counted_ns > timeout_ns);
    let detected_ns = now.start_ns - now.measurement.measured_ns;
    let late_ns = history.late_since_ns(before.gather_ns);
    let bound_ns = timeout_ns + uncounted_ns + 2 * now.period_ns + late_ns;
    say(what, detected_ns, bound_ns);
    assert!(detected_ns <= bound_ns);
    assert_ramps_to_rest(trail, &now, || {});
}

#[test]
fn a_late_measurement_is_moved_on_by_its_age_and_counted() {
    behind_both(|interface| {
        // Exact comparison: only the measurement is used.
        let daemon = daemon_with(interface, "[estimator]\ntime_constant_ms = 0.0\n");
        let connection = daemon.connect();
        let (mut trail, mut robot) = (Trail::new(&connection), Robot::new(&connection, 1.5));
        let delay_ns = 30_000_000;
        let mut under_way = VecDeque::new();
        let mut turn = |robot: &mut Robot| {
            robot.follow();
            under_way.push_back((monotonic_ns(), robot.sensed_rad()));
            while let Some(&(measured_ns, bend_rad)) = under_way.front()
                && measured_ns + delay_ns <= monotonic_ns()
            {
                robot.measure_at(measured_ns, bend_rad);
                under_way.pop_front();
            }
        };
        trail.until_while("holding", || turn(&mut robot), is(Mode::Holding));
        go_home(&connection, &mut trail, || turn(&mut robot))?;
        let mut checked = 0;
        while checked < 50 {
            let (_, record) = trail.until_while("a record", || turn(&mut robot), |_| true);
            if is_held_by_a_stall(&record) {
                return None;
            }
            let age_ns = record.release_ns - record.measurement.measured_ns;
            if state(&record) != MeasurementState::Used || age_ns > MADE_UP_MAX_NS {
                continue;
            }
            // The measurement was there at its gather, which follows the release in a late cycle.
            let gathered_ns = record.gather_ns.max(record.release_ns);
            let least_ns = gathered_ns - record.measurement.measured_ns + 1_000_000;
            assert!(least_ns >= delay_ns, "{least_ns} ns");
            let way_rad = trail.history().way_rad(record.measurement.measured_ns);
            let error = (record.bend_rad[0] - record.measurement.bend_rad[0] - way_rad).abs();
            assert!(error < 1e-9, "{error} rad beside, {age_ns} ns old");
            checked += 1;
        }
        // A pause within the timeout: predicted and counted, without a fault.
        let before = connection
            .status(TIMEOUT)
            .unwrap()
            .since_reset
            .stale_measurements;
        let mut repeated = 0;
        trail.until("repeated", |record| {
            repeated += u64::from(state(record) == MeasurementState::Repeated);
            repeated == 10
        });
        // From here on it measures again, however long the status takes.
        let turned = || turn(&mut robot);
        trail.until_while("used", turned, |r| state(r) == MeasurementState::Used);
        wait_until("they are counted", || {
            turn(&mut robot);
            let status = connection.status(TIMEOUT).unwrap();
            assert_eq!(status.faults, 0);
            status.since_reset.stale_measurements >= before + 10
        });
        Some(())
    });
}

#[test]
fn a_lost_measurement_is_a_fault_after_the_timeout() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let connection = daemon.connect();
        let (mut trail, mut robot) = Robot::held(&connection, 1.0);
        go_home(&connection, &mut trail, || robot.turn())?;
        assert_lost(&mut trail, "measurement lost", || {});
        refused(&connection, RequestKind::Reset);
        // Measurements are back: the reset is accepted.
        until_used(&mut trail, &mut robot);
        ask_for(&connection, RequestKind::Reset);
        Some(())
    });
}

#[test]
fn measurements_that_are_no_numbers_are_refused_until_the_last_good_one_is_lost() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let connection = daemon.connect();
        let (mut trail, mut robot) = Robot::held(&connection, 0.0);
        let mut bad = robot.sensed_rad();
        bad[1] = f64::NAN;
        assert_lost(&mut trail, "measurement not finite, then lost", || {
            robot.measure(bad);
        });
        let code = Outcome::NotFinite.code() as usize;
        wait_status(&connection, |status| status.outcomes[code] > 0);
        Some(())
    });
}

#[test]
fn a_frozen_measurement_is_a_fault_once_the_robot_should_have_moved() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let connection = daemon.connect();
        let (mut trail, mut robot) = Robot::held(&connection, 1.0);
        trail.catch_up();
        ask_for(&connection, RequestKind::Home);
        // One sensor repeats its value with new stamps; the others work.
        let mut measured = robot.sensed_rad();
        let frozen_rad = measured[0];
        let (mut frozen_at_rad, mut way_rad, mut checked_rad) = (None, 0.0, 0.0);
        let (_, now) = trail.until_while(
            "the fault",
            || {
                robot.follow();
                for live in &mut measured[1..6] {
                    *live = if *live > 0.0 { -1e-6 } else { 1e-6 };
                }
                robot.measure(measured);
                std::thread::sleep(Duration::from_millis(1));
            },
            |record| {
                if is_held_by_a_stall(record) {
                    return true;
                }
                if record.measurement.bend_rad[0] == frozen_rad {
                    let from_rad = frozen_at_rad.get_or_insert(record.commanded_rad[0]);
                    way_rad = (record.commanded_rad[0] - *from_rad).abs();
                }
                let is_fault = record.mode == Mode::Faulted.code();
                if state(record) == MeasurementState::Used && !is_fault {
                    checked_rad = way_rad;
                }
                is_fault
            },
        );
        if is_held_by_a_stall(&now) {
            return None;
        }
        assert_eq!(now.reason, Reason::MeasurementFrozen.code());
        let limit_rad = now.measurement_frozen_rad;
        println!(
            "measurement frozen: after {way_rad:.6} rad of commanded way, {limit_rad} are allowed"
        );
        // The previous measurement was within the tolerance, and this one is not.
        assert!(checked_rad <= limit_rad * 1.000_001 && way_rad >= limit_rad * 0.999_999);
        let place = "frozen: bend component x of section 1 is measured with the same bits";
        wait_until("the log names it", || daemon.log().contains(place));
        assert_ramps_to_rest(&mut trail, &now, || {
            robot.measure(measured);
        });
        // At rest, a frozen sensor is not detectable: the reset is accepted.
        robot.measure(measured);
        ask_for(&connection, RequestKind::Reset);
        Some(())
    });
}

/// Sends impossible measurements, one in each cycle, until `is_it`. Returns the number of discarded ones.
fn jump_until(
    trail: &mut Trail,
    robot: &mut Robot,
    mut is_it: impl FnMut(&Telemetry, u32) -> bool,
) -> (Telemetry, Telemetry) {
    let mut far = robot.sensed_rad();
    far[0] += 2.0;
    let (mut sent_ns, mut is_seen, mut jumps) = (0, true, 0);
    let seen = std::cell::Cell::new(0);
    trail.until_while(
        "jumps",
        || {
            is_seen |= seen.get() == sent_ns;
            if is_seen {
                sent_ns = robot.measure(far);
                is_seen = false;
            }
        },
        |record| {
            if state(record) == MeasurementState::Implausible {
                seen.set(record.measurement.measured_ns);
                jumps += 1;
                assert!(record.bend_rad[0] < 0.5, "it moved the estimate");
            }
            is_it(record, jumps)
        },
    )
}

#[test]
fn a_jumping_measurement_is_left_out_and_a_series_is_a_fault() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let connection = daemon.connect();
        let (mut trail, mut robot) = Robot::held(&connection, 0.0);
        // Two are discarded without any other effect.
        let (_, two) = jump_until(&mut trail, &mut robot, |_, jumps| jumps == 2);
        assert_eq!(two.mode, Mode::Holding.code());
        until_used(&mut trail, &mut robot);
        // The third in a row is a fault.
        let mut counted = 0;
        let (before, now) = jump_until(&mut trail, &mut robot, |record, jumps| {
            counted = jumps;
            record.mode == Mode::Faulted.code()
        });
        assert_eq!(now.reason, Reason::MeasurementJump.code());
        assert_eq!(
            (before.mode, counted),
            (Mode::Holding.code(), now.measurement_jump_limit)
        );
        // The third came with this cycle: it is newer than the previous cycle.
        assert!(now.measurement.measured_ns > before.measurement.measured_ns);
        println!("measurement jumping: in the cycle of number {counted} in a row");
        let place = "jumps: bend component x of section 1 is measured as ";
        wait_until("the log names it", || daemon.log().contains(place));
        assert_ramps_to_rest(&mut trail, &now, || robot.turn());
        // The next measurement is used.
        until_used(&mut trail, &mut robot);
        ask_for(&connection, RequestKind::Reset);
        trail.until_while("holding", || robot.turn(), is(Mode::Holding));
        Some(())
    });
}

#[test]
fn a_measurement_that_runs_away_faster_than_the_robot_is_a_fault() {
    behind_both(|interface| {
        // A robot that runs away does not follow, either, which is a separate fault.
        let daemon = daemon_with(interface, "[safety]\nfollowing_fault_rad = 100.0\n");
        let connection = daemon.connect();
        // The bound is exact, relative to the exact position of the last measurement at rest.
        let mut robot = Robot::with_flaws(&connection, 0.0, Flaws::default());
        let mut trail = Trail::new(&connection);
        robot.until_held(&mut trail);
        let rest = until_used(&mut trail, &mut robot);
        // Half as fast again as the robot can move since its last measurement at rest, in small steps.
        let rest_ns = rest.1.measurement.measured_ns;
        let after_s = |measured_ns: u64| (measured_ns - rest_ns) as f64 * 1e-9;
        let mut used_rad = 0.0;
        let (_, now) = trail.until_while(
            "the fault",
            || {
                let measured_ns = monotonic_ns();
                let mut bend_rad = [0.0; 12];
                bend_rad[0] = 1.5 * RATE_MAX_RAD_S * after_s(measured_ns);
                robot.measure_at(measured_ns, bend_rad);
            },
            |record| {
                if state(record) == MeasurementState::Used {
                    let way_rad = RATE_MAX_RAD_S * after_s(record.measurement.measured_ns);
                    used_rad = record.measurement.bend_rad[0] - way_rad;
                    assert!(used_rad <= record.measurement_jump_rad + 1e-9);
                }
                record.mode == Mode::Faulted.code()
            },
        );
        assert_eq!(now.reason, Reason::MeasurementJump.code());
        println!("measurement running away: the last that was used was {used_rad:.6} rad ahead");
        assert_ramps_to_rest(&mut trail, &now, || {});
        Some(())
    });
}

/// Measures the robot at `bend_rad` until `is_it`.
fn measured_at(
    trail: &mut Trail,
    robot: &Robot,
    bend_rad: f64,
    is_it: impl FnMut(&Telemetry) -> bool,
) -> (Telemetry, Telemetry) {
    let bends = core::array::from_fn(|i| if i == 0 { bend_rad } else { 0.0 });
    let measure = || {
        robot.measure(bends);
    };
    trail.until_while("what the measurement does", measure, is_it)
}

#[test]
fn a_bend_that_no_robot_has_is_refused_or_a_fault_in_its_cycle() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let connection = daemon.connect();
        let (mut trail, robot) = (Trail::new(&connection), Robot::new(&connection, 0.0));
        // Finite, but unusable in any computation.
        let mut records = 0;
        let (_, now) = measured_at(&mut trail, &robot, f64::MAX, |_| {
            records += 1;
            records > 50
        });
        assert_eq!(now.mode, Mode::Starting.code());
        let code = Outcome::OutOfRange.code() as usize;
        wait_status(&connection, |status| status.outcomes[code] > 0);
        // Usable, but beyond the largest bend.
        let (before, now) = measured_at(&mut trail, &robot, 3.0, is(Mode::Faulted));
        assert_eq!(
            (before.mode, now.reason),
            (Mode::Starting.code(), Reason::LimitBroken.code())
        );
        assert_eq!(
            (state(&before), state(&now)),
            (MeasurementState::None, MeasurementState::Used)
        );
        println!("limit broken: in the cycle of the measurement");
        let place = "section 1 bends by 3.0000 rad, its bend_max_rad is 2.8";
        wait_until("the log names it", || daemon.log().contains(place));
        daemon
            .place()
            .checked("cdcrctl status", 0, &[place, "\nremedy "]);
        // A robot at rest beyond its limit is not driven back, neither by itself nor by a stop.
        for kind in [None, Some(RequestKind::Stop)] {
            if let Some(kind) = kind {
                ask_for(&connection, kind);
            }
            let mut records = 0;
            measured_at(&mut trail, &robot, 3.0, |record| {
                records += 1;
                assert_eq!(record.mode, Mode::Faulted.code());
                assert_eq!(record.command.bend_rate_rad_s, [0.0; 12]);
                records > 50
            });
        }
        refused(&connection, RequestKind::Reset);
        // Bent back, by the largest step in a cycle.
        let mut bend_rad = 3.0_f64;
        while bend_rad > 2.7 {
            bend_rad -= 0.01;
            measured_at(&mut trail, &robot, bend_rad, |r| {
                (r.measurement.bend_rad[0] - bend_rad).abs() < 1e-9
            });
        }
        // The average over 0.1 s follows.
        let mut records = 0;
        measured_at(&mut trail, &robot, bend_rad, |_| {
            records += 1;
            records > 100
        });
        reset_here(&connection);
        trail.until("holding", is(Mode::Holding));
        Some(())
    });
}

/// Far above offset and noise of the robot's sensors.
pub(super) const SENSED_RAD: f64 = 0.1;
#[test]
fn a_first_measurement_that_is_old_is_refused_and_the_daemon_waits_for_a_fresh_one() {
    behind_both(|interface| {
        let daemon = daemon(interface);
        let connection = daemon.connect();
        let (mut trail, mut robot) = (Trail::new(&connection), Robot::new(&connection, 1.0));
        let mut records = 0;
        let (_, now) = trail.until_while(
            "fifty records",
            || robot.measure_at(monotonic_ns() - 10_000_000_000, [1.0; 12]),
            |record| {
                assert_eq!(record.mode, Mode::Starting.code());
                assert_eq!(state(record), MeasurementState::None);
                records += 1;
                records > 50
            },
        );
        assert_eq!(now.command.header.sequence, 0, "no command has left");
        let code = Outcome::InThePast.code() as usize;
        wait_status(&connection, |status| status.outcomes[code] > 0);
        robot.until_held(&mut trail);
        let begin_ns = now.release_ns;
        let (_, held) = trail.until_while("used", || robot.turn(), |r| r.release_ns > begin_ns);
        assert!((held.measurement.bend_rad[0] - 1.0).abs() < SENSED_RAD);
        Some(())
    });
}
