//! The first position of a driver that was started beside a daemon that runs.

use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode};

use super::*;

const MEASURED_RAD: f64 = 0.54;
const COMMANDED_RAD: f64 = 0.5;

/// A driver that measured its robot 0.04 rad beside the commanded position.
fn started(kind: MeasurementKind) -> CommandFollower {
    let mut follower = CommandFollower::new(&robot(), Interface::Position);
    let mut measurement = Measurement {
        kind: kind.code(),
        cable_length_m: position(1, MEASURED_RAD).cable_length_m,
        ..Measurement::default()
    };
    measurement.bend_rad[0] = MEASURED_RAD;
    follower.tell_measured(&measurement);
    follower
}

#[test]
fn motors_hold_until_the_reset_when_their_driver_starts_in_stopped_or_faulted() {
    for kind in [
        MeasurementKind::CableLengths,
        MeasurementKind::Configuration,
    ] {
        for mode in [Mode::Stopped, Mode::Faulted] {
            let mut follower = started(kind);
            for cycle in 1..50 {
                take(&mut follower, &in_mode(mode, cycle, COMMANDED_RAD)).unwrap();
                assert_eq!(follower.position_at(cycle * PERIOD_NS + PERIOD_NS), None);
            }
            take(&mut follower, &in_mode(Mode::Holding, 50, COMMANDED_RAD)).unwrap();
            assert!(follower.position_at(51 * PERIOD_NS).is_some());
        }
    }
    // A robot elsewhere is still reported.
    let mut follower = started(MeasurementKind::CableLengths);
    let far = Command {
        mode: Mode::Stopped.code(),
        ..position(1, 0.0)
    };
    let refused = take(&mut follower, &far);
    assert!(matches!(refused, Err(CommandRefusal::Elsewhere { .. })));
}

/// A robot that sags is measured elsewhere than its motors stand: they stay, and move as the positions do.
#[test]
fn a_driver_that_states_where_its_motors_stand_moves_no_loaded_robot() {
    const SAG_RAD: f64 = 0.12;
    let place = |u_rad| CommandedPosition::from_command(&position(1, u_rad));
    let stands_rad = COMMANDED_RAD + SAG_RAD;
    for kind in [
        MeasurementKind::CableLengths,
        MeasurementKind::Configuration,
    ] {
        let mut follower = started(kind);
        follower.stand_at(place(stands_rad)).unwrap();
        take(&mut follower, &in_mode(Mode::Stopped, 1, COMMANDED_RAD)).unwrap();
        assert!(follower.position_at(2 * PERIOD_NS).is_none(), "it holds");
        for cycle in 2..20 {
            take(&mut follower, &in_mode(Mode::Holding, cycle, COMMANDED_RAD)).unwrap();
            for part in [0.2, 0.5, 1.0] {
                let (bend_rad, length_m) = sampled_at(&follower, cycle as f64 + part);
                assert!((bend_rad - stands_rad).abs() < 1e-12, "{bend_rad}");
                let stands_m = place(stands_rad).cable_length_m[0];
                assert!((length_m - stands_m).abs() < 1e-12, "{length_m}");
            }
        }
        let offset_rad = follower.offset().unwrap().bend_rad[0];
        assert!((offset_rad - SAG_RAD).abs() < 1e-12, "{offset_rad}");
        take(&mut follower, &position(20, COMMANDED_RAD + 0.003)).unwrap();
        let (bend_rad, _) = sampled_at(&follower, 21.0);
        assert!((bend_rad - stands_rad - 0.003).abs() < 1e-12, "{bend_rad}");
        // No load keeps it so far aside: the place is wrong, or something holds the robot.
        let mut follower = started(kind);
        follower.stand_at(place(MEASURED_RAD + 0.25)).unwrap();
        let refused = take(&mut follower, &in_mode(Mode::Holding, 1, COMMANDED_RAD));
        assert!(matches!(refused, Err(CommandRefusal::Held { .. })));
        follower.forget();
        take(&mut follower, &in_mode(Mode::Holding, 2, COMMANDED_RAD)).unwrap();
        assert_eq!(sampled_at(&follower, 3.0).0, COMMANDED_RAD);
        // They have moved: it is too late, and nothing is kept for later.
        let late = follower.stand_at(place(stands_rad));
        assert_eq!(late, Err(CommandRefusal::Begun));
        take(&mut follower, &in_mode(Mode::Holding, 3, COMMANDED_RAD)).unwrap();
        assert_eq!(sampled_at(&follower, 4.0).0, COMMANDED_RAD);
    }
}

/// A place is kept in a file, which may be another robot's, or in other units.
#[test]
fn a_stated_place_that_is_no_position_of_the_robot_is_refused() {
    let mut follower = started(MeasurementKind::Configuration);
    let good = CommandedPosition::from_command(&position(1, COMMANDED_RAD));
    let wrong = |change: fn(&mut CommandedPosition)| {
        let mut place = good;
        change(&mut place);
        place
    };
    for place in [
        wrong(|place| place.bend_rad[0] = f64::NAN),
        wrong(|place| place.cable_length_m[0] = f64::INFINITY),
        wrong(|place| place.cable_length_m = place.cable_length_m.map(|m| 1e3 * m)),
        wrong(|place| place.cable_length_m = place.cable_length_m.map(|_| 0.0)),
        wrong(|place| place.bend_rad[0] += 0.1),
        wrong(|place| place.cable_length_m = place.cable_length_m.map(|m| m + 0.01)),
    ] {
        follower.stand_at(place).unwrap_err();
        take(&mut follower, &in_mode(Mode::Holding, 1, COMMANDED_RAD)).unwrap();
        assert_eq!(sampled_at(&follower, 2.0).0, COMMANDED_RAD);
        follower.forget();
    }
    follower.stand_at(good).unwrap();
}
