//! A robot that a load keeps beside its motors is stopped and reset.

use super::*;

const SAG_RAD: f64 = 0.12;
/// The motors of the stopped robot.
const MOTORS_RAD: f64 = 0.8;
/// Cycle of the reset.
const RESET: u64 = 1000;

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

/// A follower of a robot that was moved to [`MOTORS_RAD`], stood, and was stopped. `bend_rad` of the motors' bend and the cycle
/// is measured.
fn stopped(kind: MeasurementKind, bend_rad: impl Fn(f64, u64) -> f64) -> CommandFollower {
    let mut follower = CommandFollower::new(&robot(), Interface::Position);
    for cycle in 1..RESET {
        let mode = if cycle < 900 {
            Mode::Holding
        } else {
            Mode::Stopped
        };
        // At rest in the first second.
        let motors_rad = MOTORS_RAD.min(0.0014 * cycle.saturating_sub(250) as f64);
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

/// The motors come to a robot that somebody has moved, that presses against something, or that is too far away for any load.
#[test]
fn motors_follow_a_reset_where_no_load_explains_the_distance() {
    let by_hand = |motors_rad: f64, cycle: u64| {
        let moved_rad = if cycle > 950 { 0.1 } else { 0.0 };
        motors_rad - SAG_RAD + moved_rad
    };
    // From half a second after the start, for the rest of the time.
    let presses = |motors_rad: f64, _: u64| motors_rad.min(MOTORS_RAD - 0.15);
    let far = |motors_rad: f64, _: u64| motors_rad - 0.25;
    for kind in KINDS {
        for bend_rad in [&by_hand as &dyn Fn(f64, u64) -> f64, &presses, &far] {
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

/// Not known: the driver was opened, or forgot, less than a second before.
#[test]
fn no_load_is_known_at_first() {
    let sags = |motors_rad: f64, _: u64| motors_rad - SAG_RAD;
    let mut follower = stopped(MeasurementKind::Configuration, sags);
    follower.forget();
    for cycle in RESET..RESET + 100 {
        let mode = if cycle < RESET + 50 {
            Mode::Holding
        } else {
            Mode::Stopped
        };
        // A first position is beside the measured one.
        take(&mut follower, &in_mode(mode, cycle, MOTORS_RAD - SAG_RAD)).unwrap();
        let at = measured(
            MeasurementKind::Configuration,
            cycle,
            MOTORS_RAD - 2.0 * SAG_RAD,
        );
        follower.tell_measured(&at);
    }
    for cycle in RESET + 100..RESET + 200 {
        take(
            &mut follower,
            &in_mode(Mode::Holding, cycle, MOTORS_RAD - SAG_RAD - 0.1),
        )
        .unwrap();
    }
    let (motors_rad, _) = sampled_at(&follower, (RESET + 300) as f64);
    assert!(
        (motors_rad - MOTORS_RAD + SAG_RAD + 0.1).abs() < 1e-9,
        "{motors_rad}"
    );
}

/// The machine stalls for longer than a command is valid while the commanded position moves to the robot.
#[test]
fn the_motors_stay_through_gaps_on_the_way() {
    let sags = |motors_rad: f64, _: u64| motors_rad - SAG_RAD;
    let mut follower = stopped(MeasurementKind::Configuration, sags);
    for cycle in RESET..RESET + 200 {
        if cycle % 20 > 8 {
            continue;
        }
        let part = ((cycle - RESET) as f64 / 100.0).min(1.0);
        let command = in_mode(Mode::Holding, cycle, MOTORS_RAD - part * SAG_RAD);
        take(&mut follower, &command).unwrap();
        let at = measured(MeasurementKind::Configuration, cycle, MOTORS_RAD - SAG_RAD);
        follower.tell_measured(&at);
    }
    let (motors_rad, _) = sampled_at(&follower, (RESET + 200) as f64);
    assert!((motors_rad - MOTORS_RAD).abs() < 1e-12, "{motors_rad}");
}

/// The sag in the plane of v grows with the bend in the plane of u, and the motors never move v.
#[test]
fn a_sag_across_the_motion_is_known() {
    const LAST: u64 = 8000;
    let mut follower = CommandFollower::new(&robot(), Interface::Position);
    // Five times from one end of 0 to 1.2 rad to the other, and to rest there.
    let u_rad = |cycle: u64| {
        let ways = 7e-4 * cycle.min(7392).saturating_sub(250) as f64;
        0.6 - 0.6 * (ways * core::f64::consts::PI).cos()
    };
    let sag_rad = |cycle: u64| [0.0, 0.12 * u_rad(cycle).sin()];
    let mut take_in = |mode, cycle, bends: [f64; 2]| {
        let mut command = in_mode(mode, cycle, bends[0]);
        command.bend_target_rad[1] = bends[1];
        take(&mut follower, &command).unwrap();
        let mut measured = measured(MeasurementKind::Configuration, cycle, u_rad(cycle));
        measured.bend_rad[1] = -sag_rad(cycle)[1];
        follower.tell_measured(&measured);
        follower.position_at(u64::MAX).unwrap().bend_rad[1]
    };
    for cycle in 1..LAST {
        let mode = if cycle < 7600 {
            Mode::Holding
        } else {
            Mode::Stopped
        };
        take_in(mode, cycle, [u_rad(cycle), 0.0]);
    }
    let mut v_rad = 0.0;
    for cycle in LAST..LAST + 200 {
        let part = ((cycle - LAST) as f64 / 100.0).min(1.0);
        v_rad = take_in(
            Mode::Holding,
            cycle,
            [u_rad(cycle), -part * sag_rad(cycle)[1]],
        );
    }
    assert!(v_rad.abs() < 1e-12, "{v_rad}");
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

/// One section of three is moved by hand, or none; cables are measured, which the proximal sections pull, too.
#[cfg(feature = "model")]
#[test]
fn each_section_counts_by_itself() {
    use cdcr_controller::robot::Configuration;

    let mut robot = robot();
    robot.sections = 3;
    robot.section = [robot.section[0]; 6];
    let exact = crate::model::robot_of(&robot).unwrap();
    let at = |mode, cycle, bends: [f64; 6]| {
        let mut command = Command {
            mode: Mode::code(mode),
            sections: 3,
            ..position(cycle, 0.0)
        };
        command.bend_target_rad[..6].copy_from_slice(&bends);
        command.cable_length_m = exact.cable_lengths(&Configuration::from_slice(&bends).unwrap());
        command
    };
    for (section, moved_rad) in [(0, 0.0), (0, 0.1), (1, 0.1), (2, 0.1), (2, 0.06)] {
        let mut follower = CommandFollower::new(&robot, Interface::Position);
        let (motors, mut bends) = ([0.4; 6], [0.4 - SAG_RAD; 6]);
        for cycle in 1..700 {
            let mode = if cycle < 400 {
                Mode::Holding
            } else {
                Mode::Stopped
            };
            if cycle == 500 {
                bends[2 * section] += moved_rad;
            }
            let measured = Measurement {
                kind: MeasurementKind::CableLengths.code(),
                measured_ns: cycle * PERIOD_NS + PERIOD_NS / 2,
                cable_length_m: at(mode, cycle, bends).cable_length_m,
                ..Measurement::default()
            };
            take(&mut follower, &at(mode, cycle, motors)).unwrap();
            follower.tell_measured(&measured);
        }
        for cycle in 700..900 {
            let part = ((cycle - 700) as f64 / 100.0).min(1.0);
            let way = core::array::from_fn(|i| motors[i] + part * (bends[i] - motors[i]));
            take(&mut follower, &at(Mode::Holding, cycle, way)).unwrap();
        }
        let reached = follower.position_at(901 * PERIOD_NS).unwrap().bend_rad;
        let goal = if moved_rad == 0.0 { motors } else { bends };
        for (reached, goal) in reached.iter().zip(goal) {
            assert!(
                (reached - goal).abs() < 1e-9,
                "section {section} by {moved_rad}: {reached}"
            );
        }
    }
}
