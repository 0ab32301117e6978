//! Measurements and their senders.

use cdcr_controller::estimator::Measurement;
use cdcr_controller::robot::Configuration;
use cdcr_shared_types::codes::{Mode, Outcome};

use super::{MS, PERIOD_NS, Rig, TIMEOUT_MS, homing};

#[test]
fn a_measurement_that_is_old_at_its_arrival_is_refused_also_the_first() {
    let mut rig = Rig::new("");
    rig.measure(1, 0.5, 10_000);
    assert_eq!(rig.gather().measurement, None);
    rig.measure(1, 0.5, TIMEOUT_MS + 1);
    assert_eq!(rig.gather().measurement, None);
    assert_eq!(rig.counted(Outcome::InThePast), 2);
    rig.measure(1, 0.5, TIMEOUT_MS - 1);
    assert!(rig.gather().measurement.is_some());
}

#[test]
fn a_stamp_in_the_future_and_one_that_is_not_newer_are_refused() {
    let mut rig = Rig::new("");
    rig.measure_at(1, 0.5, rig.gather_ns() + 2 * MS);
    assert_eq!(rig.gather().measurement, None);
    assert_eq!(rig.counted(Outcome::InTheFuture), 1);
    let measured_ns = rig.gather_ns();
    for before_ns in [0, 0, MS] {
        rig.measure_at(1, 0.5, measured_ns - before_ns);
    }
    assert_eq!(rig.gather().measurement.unwrap().measured_ns, measured_ns);
    assert_eq!(rig.counted(Outcome::Stale), 2);
}

#[test]
fn a_robot_has_one_driver_until_that_is_lost() {
    let mut rig = Rig::new("");
    rig.measure(1, 0.5, 0);
    rig.gather();
    for _ in 0..10 {
        rig.measure(2, 1.0, 0);
        rig.measure(1, 0.5, 0);
        let measurement = rig.gather().measurement.unwrap().measurement;
        let bends = [0.5, 0.0, 0.0, 0.0, 0.0, 0.0];
        let first = Configuration::from_slice(&bends).unwrap();
        assert_eq!(measurement, Measurement::Configuration(first));
    }
    assert_eq!(rig.counted(Outcome::OtherDriver), 10);
    let turn = |rig: &mut Rig| {
        rig.measure(2, 1.0, 0);
        rig.gather();
        rig.run(rig.next_cycle - 1, None);
        rig.publish();
    };
    rig.measure(1, 0.5, 0);
    turn(&mut rig);
    // Refused measurements do not keep a driver bound: first the robot is lost, then another driver is
    // accepted.
    let (mut silent_ns, last_ns) = (0, rig.now_ns());
    while rig.exchange.measurements.newest().unwrap().measured_ns <= last_ns {
        silent_ns = rig.now_ns() - last_ns;
        turn(&mut rig);
    }
    assert!(silent_ns > TIMEOUT_MS * MS, "{silent_ns}");
    assert!(silent_ns <= TIMEOUT_MS * MS + 3 * PERIOD_NS, "{silent_ns}");
    rig.measure(1, 0.5, 0);
    rig.gather();
    assert_eq!(
        rig.exchange.measurements.newest().unwrap().measured_ns,
        rig.now_ns() - PERIOD_NS
    );
}

#[test]
fn another_driver_waits_until_the_cycle_has_seen_that_the_first_is_lost() {
    let mut rig = Rig::new("");
    rig.measure(1, 0.5, 0);
    rig.gather();
    // No cycle runs, and inputs are replaced unread.
    for _ in 0..3 * TIMEOUT_MS * MS / PERIOD_NS {
        rig.measure(2, 1.0, 0);
        rig.gather();
    }
    let last = rig.exchange.measurements.newest().unwrap().measurement;
    let bends = [0.5, 0.0, 0.0, 0.0, 0.0, 0.0];
    let first = Configuration::from_slice(&bends).unwrap();
    assert_eq!(last, Measurement::Configuration(first));
}

/// The first driver is lost while its robot moves: the fault alone does not let another driver in, the rest does.
#[test]
fn another_driver_waits_until_the_robot_of_a_fault_rests() {
    let mut rig = homing("[motion]\ndeceleration_rad_s2 = 2.0\n");
    let mut moving = 0;
    for cycle in 3..500 {
        // The other driver measures on, the first one never again.
        rig.measure(2, 1.0, 0);
        rig.next_cycle = cycle;
        rig.gather();
        let is_accepted = rig.exchange.measurements.driver_id() == Some(2);
        let (mode, rests) = (rig.exchange.newest.mode, rig.exchange.newest.rests);
        assert_eq!(is_accepted, mode == Mode::Faulted && rests, "cycle {cycle}");
        if is_accepted {
            break;
        }
        moving += u32::from(mode == Mode::Faulted && !rests);
        rig.run(cycle, None);
        rig.publish();
    }
    // 0.5 rad/s end after a quarter of a second.
    assert!(moving > 20, "{moving} cycles in motion");
    assert_eq!(rig.exchange.measurements.driver_id(), Some(2));
}
