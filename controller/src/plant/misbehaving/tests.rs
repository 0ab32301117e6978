use super::*;
use crate::estimator::Actuator;
use crate::plant::FlawError;
use crate::plant::RobotPreset;
use crate::robot::RobotParameters;
use crate::robot::{BendRates, Shape};

const STEP_S: f64 = 0.001;

fn model() -> Robot {
    Robot::new(&RobotParameters::paper(2)).unwrap()
}

fn bent(bend_rad: [f64; 4]) -> Configuration {
    Configuration::from_slice(&bend_rad).unwrap()
}

fn robot(flaws: Flaws) -> MisbehavingRobot {
    MisbehavingRobot::new(&model(), &bent([0.5, -0.2, 0.1, 0.0]), flaws, 7).unwrap()
}

fn lengths(bend_rad: [f64; 4]) -> MotorOrder {
    MotorOrder::Lengths(model().cable_lengths(&bent(bend_rad)))
}

fn speeds(rad_s: [f64; 4]) -> MotorOrder {
    let rates = BendRates::from_slice(&rad_s).unwrap();
    MotorOrder::Speeds(model().cable_speeds(&rates))
}

fn lagging(delay_s: f64, time_constant_s: f64) -> Flaws {
    Flaws {
        actuator: Actuator {
            delay_s,
            time_constant_s,
            play_m: 0.0,
        },
        ..Flaws::default()
    }
}

fn near(robot: &MisbehavingRobot, expected: [f64; 4], within_rad: f64) {
    let found = robot.configuration();
    for (found, expected) in found.as_slice().iter().zip(expected) {
        assert!(
            (found - expected).abs() <= within_rad,
            "{found}, {expected}"
        );
    }
}

fn run(robot: &mut MisbehavingRobot, order: MotorOrder, steps: u32, step_s: f64) {
    for _ in 0..steps {
        robot.order(order);
        robot.advance(step_s);
    }
}

#[test]
fn the_ideal_robot_follows_orders_at_once_and_measures_exactly() {
    let mut robot = robot(RobotPreset::Ideal.flaws());
    near(&robot, [0.5, -0.2, 0.1, 0.0], 1e-12);
    run(&mut robot, lengths([0.1, 0.2, 0.3, 0.4]), 1, STEP_S);
    near(&robot, [0.1, 0.2, 0.3, 0.4], 1e-12);
    run(&mut robot, speeds([1.0, 0.0, -2.0, 0.0]), 1, 0.1);
    near(&robot, [0.2, 0.2, 0.1, 0.4], 1e-12);
    let before = robot.measure_cables().unwrap();
    run(&mut robot, MotorOrder::Stop, 1, 1.0);
    assert_eq!(robot.measure_cables().unwrap(), before);
    let measured = model().bend_from_cable_lengths(&before);
    near(
        &robot,
        core::array::from_fn(|i| measured.as_slice()[i]),
        1e-12,
    );
    let tip_m = model().tip_position(&robot.configuration());
    assert!((robot.measure_tip().unwrap() - tip_m).norm() < 1e-15);
}

#[test]
fn motors_lag_by_their_time_constant_whatever_the_step() {
    let lag_s = 0.02;
    for steps in [1, 7, 100] {
        let mut robot = robot(lagging(0.0, lag_s));
        let step_s = 0.1 / f64::from(steps);
        run(&mut robot, speeds([1.0, 0.0, 0.0, 0.0]), steps, step_s);
        let behind = lag_s * (1.0 - (-0.1 / lag_s).exp());
        near(&robot, [0.6 - behind, -0.2, 0.1, 0.0], 1e-12);
        // After the order to stand, the motor runs on for a while.
        run(&mut robot, MotorOrder::Stop, 1, 10.0);
        near(&robot, [0.6, -0.2, 0.1, 0.0], 1e-12);
        run(&mut robot, lengths([0.0; 4]), 1, lag_s);
        let left = (-1.0_f64).exp();
        near(&robot, [0.6 * left, -0.2 * left, 0.1 * left, 0.0], 1e-12);
    }
}

#[test]
fn orders_take_effect_after_the_delay_whatever_the_step() {
    for (step_s, delay_s) in [
        (0.0005, 0.015),
        (STEP_S, 0.015),
        (0.005, 0.015),
        (0.0001, 0.05),
    ] {
        let mut robot = robot(lagging(delay_s, 0.0));
        let steps = (0.1 / step_s).round() as u32;
        run(&mut robot, speeds([1.0, 0.0, 0.0, 0.0]), steps, step_s);
        near(&robot, [0.5 + 0.1 - delay_s, -0.2, 0.1, 0.0], 1e-12);
        run(&mut robot, MotorOrder::Stop, steps, step_s);
        near(&robot, [0.5 + 0.1, -0.2, 0.1, 0.0], 1e-12);
    }
}

#[test]
fn a_cable_follows_beyond_half_of_the_play() {
    let mut robot = robot(Flaws {
        actuator: Actuator {
            play_m: 1e-3,
            ..Actuator::IDEAL
        },
        ..Flaws::default()
    });
    let straight = model().cable_strokes(&bent([0.5, -0.2, 0.1, 0.0]));
    let mut pulled = model().cable_lengths(&bent([0.5, -0.2, 0.1, 0.0]));
    pulled[0] += 2e-3;
    run(&mut robot, MotorOrder::Lengths(pulled), 1, STEP_S);
    assert!((robot.cable_m[0] - straight[0] - 1.5e-3).abs() < 1e-15);
    pulled[0] -= 0.9e-3;
    run(&mut robot, MotorOrder::Lengths(pulled), 1, STEP_S);
    assert!(
        (robot.cable_m[0] - straight[0] - 1.5e-3).abs() < 1e-15,
        "in its play"
    );
    pulled[0] -= 0.3e-3;
    run(&mut robot, MotorOrder::Lengths(pulled), 1, STEP_S);
    assert!((robot.cable_m[0] - straight[0] - 1.3e-3).abs() < 1e-15);
}

#[test]
fn geometry_errors_and_a_load_change_the_bends() {
    let mut longer = robot(Flaws {
        length_error: 0.05,
        cable_radius_error: -0.5,
        payload_rad: [0.01, 0.0],
        ..Flaws::default()
    });
    run(&mut longer, lengths([0.1, 0.0, 0.0, 0.0]), 1, STEP_S);
    // Half the radius gives twice the bend, which its encoders cannot detect.
    near(&longer, [0.2 + 0.012, 0.0, 0.01, 0.0], 1e-12);
    let measured = model().bend_from_cable_lengths(&longer.measure_cables().unwrap());
    assert!((measured.as_slice()[0] - 0.1).abs() < 1e-12);
    assert!((longer.truth().reach_m() - 0.63).abs() < 1e-12);
}

#[test]
fn sensors_have_the_given_noise_and_are_reproducible() {
    let flaws = Flaws {
        droop_m: 0.0,
        tick_m: 0.0,
        ..RobotPreset::Laboratory.flaws()
    };
    let (mut one, mut other) = (robot(flaws), robot(flaws));
    let first = one.measure_cables().unwrap();
    assert_eq!(first, other.measure_cables().unwrap());
    assert_ne!(first, one.measure_cables().unwrap());
    let true_m = model().cable_lengths(&one.configuration());
    let far = |measured: [f64; CABLES_MAX], cable: usize| (measured[cable] - true_m[cable]).abs();
    let most = (0..1000)
        .map(|_| far(other.measure_cables().unwrap(), 2))
        .fold(0.0, f64::max);
    assert!((2.9e-5..=3.0001e-5).contains(&most), "{most}");
    let mean = (0..1000)
        .map(|_| other.measure_cables().unwrap()[3] - true_m[3])
        .sum::<f64>()
        / 1000.0;
    assert!((mean - 1e-4).abs() < 2e-6, "{mean}");
    let tip_m = one.tip_m();
    let squares = (0..10_000).map(|_| (one.measure_tip().unwrap() - tip_m).norm_squared());
    let deviation_m = (squares.sum::<f64>() / 30_000.0).sqrt();
    assert!((deviation_m / 3e-4 - 1.0).abs() < 0.02, "{deviation_m}");
    let mut counted = robot(Flaws {
        tick_m: 1e-3,
        ..Flaws::default()
    });
    let ticks = (counted.measure_cables().unwrap()[0] - 0.3) / 1e-3;
    assert!((ticks - ticks.round()).abs() < 1e-9);
}

#[test]
fn a_quantised_tip_sensor_reports_whole_steps() {
    let mut counted = robot(Flaws {
        tip_noise_m: 3e-4,
        tip_tick_m: 1e-3,
        ..Flaws::default()
    });
    let tip_m = counted.tip_m();
    for _ in 0..100 {
        let measured_m = counted.measure_tip().unwrap();
        assert!((measured_m - tip_m).amax() < 0.5e-3 + 6.0 * 3e-4);
        assert!(
            measured_m
                .iter()
                .all(|m| (m / 1e-3 - (m / 1e-3).round()).abs() < 1e-9)
        );
    }
}

/// Encoders are on the motors: they detect no fault.
#[test]
fn slack_or_broken_cables_bend_less_and_no_encoder_detects_it() {
    for (flaw, value) in [("slack_m", 2e-3), ("broken_cable", 1.0)] {
        let mut loose = robot(Flaws::default().with(flaw, value).unwrap());
        run(&mut loose, lengths([0.5, 0.0, 0.0, 0.0]), 1, STEP_S);
        let bent_rad = loose.configuration().bend_rad(0);
        assert!(bent_rad < 0.35, "{flaw}: {bent_rad}");
        let measured = model().bend_from_cable_lengths(&loose.measure_cables().unwrap());
        assert!((measured.as_slice()[0] - 0.5).abs() < 1e-12);
    }
}

#[test]
fn sections_may_have_lengths_and_cables_of_their_own() {
    let truth = true_robot(&model(), &[[0.31, 0.013, 0.1]]).unwrap();
    assert!((truth.reach_m() - 0.61).abs() < 1e-12);
    let [first, second] = truth.sections() else {
        panic!("two sections")
    };
    assert_eq!((first.cable_radius_m, first.cable_offset_rad), (0.013, 0.1));
    assert_eq!(*second, model().sections()[1]);
    assert!(true_robot(&model(), &[[-0.3, 0.0125, 0.0]]).is_err());
}

#[test]
fn sections_have_mechanical_ends_and_motors_a_largest_speed() {
    for order in [speeds([3.0, 4.0, 0.0, 0.0]), lengths([3.0, 4.0, 0.1, 0.0])] {
        let mut robot = robot(lagging(0.0, 0.02));
        run(&mut robot, order, 10_000, STEP_S);
        let [u, v, w, ..] = *robot.configuration().as_slice() else {
            unreachable!("two sections")
        };
        assert!((u.hypot(v) - 2.8).abs() < 1e-9);
        assert!((w - 0.1).abs() < 1e-9 && v > u);
    }
    let mut slow = robot(Flaws {
        motor_speed_max_m_s: 0.01,
        ..Flaws::default()
    });
    let before = slow.motor_m;
    run(&mut slow, lengths([0.0; 4]), 10, STEP_S);
    let most = (0..6).map(|cable| (slow.motor_m[cable] - before[cable]).abs());
    assert!((most.fold(0.0, f64::max) - 1e-4).abs() < 1e-15);
}

#[test]
fn a_pulled_cable_stretches_and_friction_holds_it_back_the_more_the_body_is_bent() {
    let mut stretched = robot(Flaws {
        stretch: 0.1,
        ..Flaws::default()
    });
    run(&mut stretched, lengths([0.3, 0.0, 0.0, 0.0]), 1, STEP_S);
    let bent_rad = stretched.configuration().bend_rad(0);
    assert!((0.26..0.2999).contains(&bent_rad), "{bent_rad}");

    let rubbing = Flaws {
        friction_m_per_rad: 1e-3,
        ..Flaws::default()
    };
    let behind_m = |to_rad: f64| {
        let mut robot = robot(rubbing);
        run(&mut robot, lengths([to_rad, 0.0, 0.0, 0.0]), 1, STEP_S);
        (robot.cable_m[0] - robot.motor_m[0]).abs()
    };
    assert!((behind_m(1.0) - 1e-3).abs() < 1e-15);
    assert!((behind_m(2.0) - 2e-3).abs() < 1e-15);
    assert!(behind_m(0.0) < 1e-15, "a straight body holds no cable");
}

#[test]
fn sensors_have_the_given_delay_interval_dropout_and_bias() {
    let sampling = |delay_s, interval_s, dropout| Sampling {
        delay_s,
        interval_s,
        dropout,
    };
    let mut late = robot(Flaws {
        cables: sampling(0.02, 0.0, 0.0),
        tip: sampling(0.0, 0.01, 0.0),
        tip_bias_m: [1e-3, 0.0, 0.0],
        ..Flaws::default()
    });
    let first = late.measure_cables().unwrap();
    let straight_m = model().cable_lengths(&bent([0.5, -0.2, 0.1, 0.0]));
    assert_eq!(first, straight_m);
    let mut tips = 0;
    let moving = speeds([1.0, 0.0, 0.0, 0.0]);
    for _ in 0..100 {
        run(&mut late, moving, 1, STEP_S);
        if let Some(tip_m) = late.measure_tip() {
            tips += 1;
            assert!((tip_m - late.tip_m() - Vector3::new(1e-3, 0.0, 0.0)).norm() < 1e-15);
        }
    }
    assert_eq!(tips, 11, "one when it is asked first, and one in 10 ms");
    let seen = model().bend_from_cable_lengths(&late.measure_cables().unwrap());
    assert!((seen.as_slice()[0] - 0.58).abs() < 1e-9, "{seen:?}");

    let mut lossy = robot(Flaws {
        cables: sampling(0.0, 0.0, 0.3),
        ..Flaws::default()
    });
    let came = (0..10_000).filter(|_| lossy.measure_cables().is_some());
    assert!((6_800..7_200).contains(&came.count()));
}

#[test]
fn a_moved_base_moves_tip_and_body() {
    let beside = Flaws {
        base_m: [0.01, 0.0, 0.0],
        base_turn_rad: [0.0, 0.0, 0.1],
        ..Flaws::default()
    };
    let (straight, elsewhere) = (robot(Flaws::default()), robot(beside));
    let base = Isometry3::new(beside.base_m.into(), beside.base_turn_rad.into());
    let tip_m = base * Point3::from(straight.tip_m());
    assert!((elsewhere.tip_m() - tip_m.coords).norm() < 1e-15);
    let ball = |centre_m| Obstacle::new(Shape::Sphere { centre_m }, 0.01, Vector3::zeros());
    let centre_m = Point3::new(0.2, 0.1, 0.4);
    let here = straight.clearance_m([ball(centre_m.coords).unwrap()].into_iter());
    let there = (base * centre_m).coords;
    let moved = elsewhere.clearance_m([ball(there).unwrap()].into_iter());
    assert!((here - moved).abs() < 1e-12, "{here} {moved}");
}

#[test]
fn each_flaw_has_a_name_and_a_range() {
    for name in Flaws::names() {
        let mut set = Flaws::default().with(name, 0.05);
        if let Err(FlawError::OutOfRange { allowed, .. }) = set {
            set = Flaws::default().with(name, *allowed.end());
        }
        assert_ne!(set.unwrap(), Flaws::default(), "{name}");
        assert!(Flaws::default().with(name, -1.0).is_err(), "{name}");
        assert!(Flaws::default().with(name, f64::NAN).is_err(), "{name}");
    }
    let unknown = Flaws::default().with("tip_delay", 0.0).unwrap_err();
    assert!(unknown.to_string().contains("tip_delay_s"), "{unknown}");
}
