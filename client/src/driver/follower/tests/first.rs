//! The first position of a driver that was started beside a daemon that runs.

use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::{Interface, MeasurementKind, Mode};

use super::*;

const MEASURED_RAD: f64 = 0.54;
const COMMANDED_RAD: f64 = 0.5;

fn in_mode(mode: Mode, cycle: u64) -> Command {
    Command {
        mode: mode.code(),
        ..position(cycle, COMMANDED_RAD)
    }
}

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
                take(&mut follower, &in_mode(mode, cycle)).unwrap();
                assert_eq!(follower.position_at(cycle * PERIOD_NS + PERIOD_NS), None);
            }
            take(&mut follower, &in_mode(Mode::Holding, 50)).unwrap();
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

#[test]
fn cables_move_from_where_they_are_measured_to_a_first_position_in_a_second() {
    let mut follower = started(MeasurementKind::CableLengths);
    let [measured_m, commanded_m] =
        [MEASURED_RAD, COMMANDED_RAD].map(|bend_rad| LENGTH_M - 0.0125 * bend_rad);
    let mut last_m = measured_m;
    for cycle in 50..260 {
        take(&mut follower, &in_mode(Mode::Holding, cycle)).unwrap();
        let cable_m = at(&follower, cycle as f64 + 1.0).1;
        let step_m = cable_m - last_m;
        let most_m = 1.01 * (commanded_m - measured_m) / 200.0;
        assert!((-1e-12..=most_m).contains(&step_m), "{cycle}: {step_m}");
        last_m = cable_m;
    }
    assert!((last_m - commanded_m).abs() < 1e-12, "{last_m}");
    // Bends are measured on the robot, whose loaded motors stand where they are commanded.
    let mut follower = started(MeasurementKind::Configuration);
    take(&mut follower, &in_mode(Mode::Holding, 50)).unwrap();
    assert_eq!(at(&follower, 50.5), (COMMANDED_RAD, commanded_m));
}
