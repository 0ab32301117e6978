//! A robot that a load keeps beside its motors is stopped and reset.

use super::*;

const SAG_RAD: f64 = 0.12;
/// The motors of the stopped robot.
const MOTORS_RAD: f64 = 0.8;
/// Cycle of the reset.
const RESET: u64 = 1000;

fn in_mode(mode: Mode, cycle: u64, u_rad: f64) -> Command {
    Command {
        mode: mode.code(),
        ..position(cycle, u_rad)
    }
}

/// A measurement in the middle of cycle `cycle` of a robot bent by `u_rad`.
fn measured(kind: MeasurementKind, cycle: u64, u_rad: f64) -> Measurement {
    let position = position(cycle, u_rad);
    let mut measured = Measurement {
        kind: kind.code(),
        sections: 1,
        measured_ns: position.release_ns + PERIOD_NS / 2,
        ..Measurement::default()
    };
    match kind {
        MeasurementKind::Configuration => measured.bend_rad = position.bend_target_rad,
        _ => measured.cable_length_m = position.cable_length_m,
    }
    measured
}

/// A follower of a robot that was homed, stood and was stopped at [`MOTORS_RAD`]. `bend_rad` of the motors' bend and the cycle
/// is measured.
fn stopped(kind: MeasurementKind, bend_rad: impl Fn(f64, u64) -> f64) -> CommandFollower {
    let mut follower = CommandFollower::new(&robot(), Interface::Position);
    for cycle in 1..RESET {
        let mode = if cycle < 900 {
            Mode::Holding
        } else {
            Mode::Stopped
        };
        let motors_rad = MOTORS_RAD.min(0.002 * cycle as f64);
        take(&mut follower, &in_mode(mode, cycle, motors_rad)).unwrap();
        follower.tell_measured(&measured(kind, cycle, bend_rad(motors_rad, cycle)));
    }
    follower
}

/// Bend of the motors after a reset that moves the commanded position to the measured one.
fn reset(follower: &mut CommandFollower) -> f64 {
    let kind = MeasurementKind::try_from(follower.measured.unwrap().kind).unwrap();
    let is_of_bends = kind == MeasurementKind::Configuration;
    let last = follower.measured.unwrap();
    let goal_rad = if is_of_bends {
        last.bend_rad[0]
    } else {
        (LENGTH_M - last.cable_length_m[0]) / 0.0125
    };
    for cycle in RESET..RESET + 200 {
        let part = ((cycle - RESET) as f64 / 100.0).min(1.0);
        let u_rad = MOTORS_RAD + part * (goal_rad - MOTORS_RAD);
        take(follower, &in_mode(Mode::Holding, cycle, u_rad)).unwrap();
    }
    sampled_at(follower, (RESET + 200) as f64).0
}

const KINDS: [MeasurementKind; 2] = [
    MeasurementKind::Configuration,
    MeasurementKind::CableLengths,
];

#[test]
fn the_motors_of_a_robot_that_sags_stay_at_each_reset() {
    for kind in KINDS {
        let mut follower = stopped(kind, |motors_rad, _| motors_rad - SAG_RAD);
        let motors_rad = reset(&mut follower);
        assert!((motors_rad - MOTORS_RAD).abs() < 1e-12, "{motors_rad}");
        let offset_rad = follower.offset().unwrap().bend_rad[0];
        assert!((offset_rad - SAG_RAD).abs() < 1e-12, "{offset_rad}");
        // From there they move as the position does.
        let moved_rad = MOTORS_RAD - SAG_RAD + 0.005;
        let cycle = RESET + 200;
        take(&mut follower, &in_mode(Mode::Tracking, cycle, moved_rad)).unwrap();
        let (now_rad, _) = sampled_at(&follower, cycle as f64 + 1.0);
        assert!((now_rad - MOTORS_RAD - 0.005).abs() < 1e-12, "{now_rad}");
    }
}

/// The motors come to a robot that somebody has moved, that has jammed, or that is too far away for any load.
#[test]
fn motors_follow_a_reset_where_no_load_explains_the_distance() {
    let by_hand = |motors_rad: f64, cycle: u64| {
        let moved_rad = if cycle > 950 { 0.1 } else { 0.0 };
        motors_rad - SAG_RAD + moved_rad
    };
    // In the last 0.4 s before the stop.
    let jams = |motors_rad: f64, cycle: u64| {
        let jammed = cycle.clamp(820, 900) - 820;
        motors_rad - 0.0015 * jammed as f64
    };
    let far = |motors_rad: f64, _: u64| motors_rad - 0.25;
    for kind in KINDS {
        for bend_rad in [&by_hand as &dyn Fn(f64, u64) -> f64, &jams, &far] {
            let mut follower = stopped(kind, bend_rad);
            let goal_rad = bend_rad(MOTORS_RAD, RESET - 1);
            let motors_rad = reset(&mut follower);
            assert!(
                (motors_rad - goal_rad).abs() < 1e-9,
                "{motors_rad}, {goal_rad}"
            );
        }
    }
}

#[test]
fn measurements_that_are_no_numbers_are_no_load() {
    for kind in KINDS {
        let noisy = |motors_rad: f64, cycle: u64| match cycle % 7 {
            3 => f64::NAN,
            _ => motors_rad - SAG_RAD,
        };
        let motors_rad = reset(&mut stopped(kind, noisy));
        assert!((motors_rad - MOTORS_RAD).abs() < 1e-12, "{motors_rad}");
    }
}

/// A driver that measures the bends and the cables by turns.
#[test]
fn each_kind_of_measurement_has_an_average_of_its_own() {
    let jams =
        |motors_rad: f64, cycle: u64| motors_rad - 0.0015 * (cycle.clamp(820, 900) - 820) as f64;
    let mut follower = CommandFollower::new(&robot(), Interface::Position);
    for cycle in 1..RESET {
        let mode = if cycle < 900 {
            Mode::Holding
        } else {
            Mode::Stopped
        };
        let motors_rad = MOTORS_RAD.min(0.002 * cycle as f64);
        take(&mut follower, &in_mode(mode, cycle, motors_rad)).unwrap();
        for kind in KINDS {
            follower.tell_measured(&measured(kind, cycle, jams(motors_rad, cycle)));
        }
    }
    let motors_rad = reset(&mut follower);
    assert!(
        (motors_rad - jams(MOTORS_RAD, RESET)).abs() < 1e-9,
        "{motors_rad}"
    );
}
