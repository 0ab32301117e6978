use std::cell::OnceCell;

use cdcr_client::model::{orientation_of, robot_of};
use cdcr_controller::closed_loop::{ClosedLoop, Driven, Sensor};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::plant::Flaws;
use cdcr_controller::reference::{
    Approach, ApproachLimits, Interpolation, ReferencePoint, ReferenceSample, Trajectory as Points,
};
use cdcr_controller::robot::{BendRates, Pose};

use super::*;
use crate::dry_run::tests::robot;
use crate::feed::within;

const PERIOD_NS: u64 = 5_000_000;
const PERIOD_S: f64 = 0.005;
/// In this point, the robot below has shapes that bend a section by 1.67 to 1.84 rad.
const GOAL_M: [f64; 3] = [0.06, 0.0, 0.3976];
const ALLOWED_M: f64 = 2e-3;

/// A robot of 0.25 + 0.2 m at rest, with these bends and this largest bend.
fn at_rest(bends_rad: &[f64], bend_max_rad: f64) -> Telemetry {
    let mut record = Telemetry {
        period_ns: PERIOD_NS,
        acceleration_rad_s2: 50.0,
        deceleration_rad_s2: 50.0,
        robot: robot(2),
        ..Telemetry::default()
    };
    for (section, length_m) in record.robot.section.iter_mut().zip([0.25, 0.2]) {
        section.length_m = length_m;
        (section.bend_max_rad, section.rate_max_rad_s) = (bend_max_rad, 1.5);
    }
    record.bend_rad[..bends_rad.len()].copy_from_slice(bends_rad);
    record
}

fn way(record: &Telemetry, goal_m: [f64; 3]) -> Straight {
    let (robot, here) = robot_and_pose(record).unwrap();
    let start_m = robot.tip_position(&here) + Vector3::from(record.tip_offset_m);
    Straight::new(within(start_m.into(), robot.reach_m()), goal_m, 0.06, 0.5)
}

/// A robot that is not its model: lag, play, droop, offset, noise, and a tip sensor 20 mm beside the tip.
fn flawed(seed: u64) -> Driven {
    let actuator = Actuator {
        delay_s: 0.015,
        time_constant_s: 0.03,
        play_m: 1e-3,
    };
    Driven {
        flaws: Flaws {
            actuator,
            droop_m: 3e-4,
            offset_m: 1e-4,
            noise_m: 5e-5,
            tip_noise_m: 3e-4,
            tip_bias_m: [0.02, 0.0, 0.0],
            ..Flaws::default()
        },
        actuator,
        time_constant_s: 0.18,
        obeys_positions: true,
        sensor: Sensor::CablesAndTip { every: 2 },
        without: None,
        seed,
    }
}

/// How the tip of the flawed robot went.
struct Sent {
    /// Measured distance from the point at the end \[m\].
    left_m: f64,
    /// Largest distance from the way \[m\], and largest speed \[m/s\], of the whole way.
    off_m: f64,
    speed_m_s: f64,
    end: Configuration,
}

/// Sends the tip of the flawed robot from home to the point, as `goto` does.
fn sent(seed: u64, is_guided: bool) -> Sent {
    /// Rest before, and between the request and the first point \[s\].
    const BEFORE_S: f64 = 1.0;
    const LEAD_S: f64 = 0.5;
    let straight = Configuration::straight(2);
    let mut record = at_rest(&[], 1.8);
    let robot = robot_of(&record.robot).unwrap();
    let followed = OnceCell::<(Points, Approach)>::new();
    let at_s = |time_s: f64| {
        let Some((points, approach)) = followed.get() else {
            return ReferenceSample::default();
        };
        let [asked_ns, begun_ns] =
            [BEFORE_S, BEFORE_S + LEAD_S].map(|begin_s| ((time_s - begin_s).max(0.0) * 1e9) as u64);
        approach.followed_sample(&points.sample(begun_ns), asked_ns)
    };
    let settings = NmpcSettings::default();
    let driven = flawed(seed);
    let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, straight, &[], at_s)
        .unwrap()
        .with_acceleration(record.acceleration_rad_s2)
        .with_driven(driven)
        .unwrap();
    while closed.time_s() < BEFORE_S {
        closed.advance(&BendRates::zero(2));
    }

    let beside_m = Vector3::from(driven.flaws.tip_bias_m);
    let here = *closed.configuration();
    let start_m = closed.tip_m() + beside_m;
    record.bend_rad[..4].copy_from_slice(here.as_slice());
    record.tip_offset_m = (start_m - robot.tip_position(&here)).into();
    let straight = way(&record, GOAL_M);
    let guided = Guided::new(&record, straight, ALLOWED_M).unwrap();
    let trajectory: &dyn Trajectory = if is_guided { &guided } else { &straight };
    let count = (trajectory.duration_s() / PERIOD_S) as u64;
    let point = |k: u64| ReferencePoint {
        time_ns: k * PERIOD_NS,
        position_m: trajectory.position_m(k as f64 * PERIOD_S).into(),
        orientation: orientation_of(trajectory.orientation(k as f64 * PERIOD_S)),
        interpolation: Interpolation::Cubic,
    };
    let mut points = Points::with_capacity(4096, robot.reach_m());
    points.replace((0..=count).map(point)).unwrap();
    let limits = ApproachLimits {
        speed_m_s: 0.1,
        acceleration_m_s2: 0.5,
        excursion_m: 0.02 * robot.reach_m(),
        turn_rad_s: 0.5,
    };
    let tip = Pose {
        position_m: start_m,
        ..robot.tip_pose(&here)
    };
    let rest = Vector3::zeros();
    let first = points.sample(0);
    let approach = Approach::plan(&limits, 0, (&tip, &rest), (&first, &rest), PERIOD_NS);
    followed.set((points, approach)).unwrap();
    let mut nmpc = closed.solver().unwrap();
    let mut tips_m = vec![start_m];
    while closed.time_s() < BEFORE_S + LEAD_S + trajectory.duration_s() {
        closed.step(&mut nmpc);
        tips_m.push(closed.tip_m() + beside_m);
    }
    let goal_m = Vector3::from(GOAL_M);
    let along = (goal_m - start_m).normalize();
    let off_m = |tip_m: &Vector3<f64>| (tip_m - start_m).cross(&along).norm();
    let speeds_m_s = tips_m
        .windows(5)
        .map(|tips_m| (tips_m[4] - tips_m[0]).norm() / (4.0 * PERIOD_S));
    Sent {
        left_m: (tips_m[tips_m.len() - 1] - goal_m).norm(),
        off_m: tips_m.iter().map(off_m).fold(0.0, f64::max),
        speed_m_s: speeds_m_s.fold(0.0, f64::max),
        end: *closed.configuration(),
    }
}

#[test]
fn from_home_the_same_point_is_reached_in_the_same_shape_whatever_the_noise() {
    let [plain, guided] = [false, true].map(|is_guided| {
        let runs: Vec<_> = (1..=8).map(|seed| sent(seed, is_guided)).collect();
        let arrived = runs.iter().filter(|sent| sent.left_m < ALLOWED_M).count();
        let pairs = (0..runs.len()).flat_map(|one| (0..one).map(move |other| (one, other)));
        let apart_rad = pairs.map(|(one, other)| runs[one].end.distance_rad(&runs[other].end));
        let largest = |of: fn(&Sent) -> f64| runs.iter().map(of).fold(0.0, f64::max);
        let (off_m, speed_m_s) = (largest(|sent| sent.off_m), largest(|sent| sent.speed_m_s));
        (arrived, apart_rad.fold(0.0, f64::max), off_m, speed_m_s)
    });
    println!("(arrived, apart, off, speed): {plain:?}, {guided:?} with the chosen shape");
    assert!(plain.0 < 8 && plain.1 > 2.0, "the noise chooses: {plain:?}");
    assert!(guided.0 == 8 && guided.1 < 1.0, "{guided:?}");
    // The shape is chosen beside the way, not instead of it: neither the way nor its end moves the tip aside.
    assert!(guided.2 < 5e-3 && guided.3 < 0.075, "{guided:?}");
}

#[test]
fn a_bent_robot_and_one_with_a_single_shape_stay_free() {
    let bent = [
        [-0.06, 0.42, 0.97, -1.4],
        [0.67, -0.28, -1.54, 0.99],
        [-0.1, 0.0, 0.5, 0.0],
        [0.3, 0.0, -0.6, 0.0],
    ];
    for bends_rad in &bent {
        let record = at_rest(bends_rad, 2.0);
        for goal_m in [GOAL_M, [0.07, 0.02, 0.37], [0.0, 0.05, 0.40]] {
            let guided = Guided::new(&record, way(&record, goal_m), ALLOWED_M).unwrap();
            assert!(guided.axes.is_empty(), "{bends_rad:?} {goal_m:?}");
        }
    }
    let mut one = at_rest(&[], 2.0);
    one.robot.sections = 1;
    let guided = Guided::new(&one, way(&one, [0.02, 0.0, 0.24]), ALLOWED_M).unwrap();
    assert!(guided.axes.is_empty());
}

#[test]
fn a_short_way_of_a_bent_robot_of_many_sections_is_free() {
    for sections in 3..=6 {
        let mut record = at_rest(&[], 2.0);
        record.robot = robot(sections);
        for j in 0..sections as usize {
            record.bend_rad[2 * j] = 0.4;
        }
        let (model, here) = robot_and_pose(&record).unwrap();
        let start_m = model.tip_position(&here);
        for step_m in [0.001, 0.02] {
            let goal_m = [start_m.x, start_m.y + step_m, start_m.z];
            let guided = Guided::new(&record, way(&record, goal_m), ALLOWED_M).unwrap();
            assert!(guided.axes.is_empty(), "{sections} sections, {step_m} m");
        }
    }
}

#[test]
fn a_shape_that_would_meet_an_obstacle_is_not_chosen() {
    let mut record = at_rest(&[], 2.0);
    record.settings.safe_distance_m = 0.01;
    let last_axis = |record: &Telemetry| {
        let guided = Guided::new(record, way(record, GOAL_M), ALLOWED_M).unwrap();
        guided.axes[STEPS]
    };
    // Its first section bends towards +y, its last one towards -y.
    let free = last_axis(&record);
    assert!(free[1] < -0.3, "{free:?}");
    record.obstacle_count = 1;
    record.obstacles[0] = cdcr_shared_types::Obstacle {
        start_m: [-0.02, 0.09, 0.24],
        radius_m: 0.03,
        ..Default::default()
    };
    let beside = last_axis(&record);
    assert!(beside[1] > free[1] + 0.2, "{beside:?}, not {free:?}");
}
