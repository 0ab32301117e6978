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
