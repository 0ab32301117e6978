//! The speed limit of the section ends, in the closed loop: a reference that is faster, and sensors that lead the robot
//! astray.

use cdcr_controller::closed_loop::{ClosedLoop, Driven, Sensor};
use cdcr_controller::nmpc::{NmpcSettings, RateWeight};
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;

use crate::inside;
use crate::robustness::driven;

const PERIOD_S: f64 = 0.005;
const ACCELERATION_RAD_S2: f64 = 40.0;

fn robot(tip_speed_max_m_s: f64) -> Robot {
    Robot::new(&RobotParameters {
        tip_speed_max_m_s,
        ..RobotParameters::paper(3)
    })
    .unwrap()
}

fn start() -> Configuration {
    Configuration::from_slice(&[0.5, 0.1, 0.3, -0.2, 0.4, 0.2]).unwrap()
}

/// What a robot does.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    /// Fastest commanded section end (m/s).
    commanded_m_s: f64,
    /// Fastest true tip, over 50 ms, once the motors have taken over (m/s).
    true_m_s: f64,
    /// Largest distance of the true tip from the reference (m).
    error_max_m: f64,
    /// That at the end (m).
    error_end_m: f64,
    /// Largest distance from the straight line between the first and the last reference (m).
    aside_m: f64,
    /// Cycles that the limit changed.
    limited: u32,
}

/// Speed of the fastest section end, by differences.
fn fastest_end_m_s(robot: &Robot, at: &Configuration, rates: &BendRates) -> f64 {
    const STEP_S: f64 = 1e-6;
    let [before, after] = [-0.5, 0.5].map(|part| {
        let at = at.advanced(rates, part * STEP_S);
        robot.section_frames(&at).map(|frame| frame.position_m)
    });
    let pairs = before.iter().zip(after);
    let moved_m = pairs.map(|(before, after)| (after - before).norm());
    moved_m.fold(0.0, f64::max) / STEP_S
}

/// Follows a reference for `until_s`.
fn follow(
    limit_m_s: f64,
    robot_that: Option<&Driven>,
    obstacles: &[Obstacle],
    until_s: f64,
    position_m: impl Fn(f64) -> Vector3<f64>,
) -> Seen {
    let robot = robot(limit_m_s);
    let settings = NmpcSettings {
        rate_weight: RateWeight::Of(1e-10),
        ..NmpcSettings::default()
    };
    let from_m = position_m(0.0);
    let along = (position_m(until_s) - from_m).normalize();
    let reference_at = |time_s| inside(position_m(time_s));
    let closed = ClosedLoop::new(&robot, PERIOD_S, settings, start(), obstacles, reference_at);
    let mut closed = closed.unwrap().with_acceleration(ACCELERATION_RAD_S2);
    if let Some(driven) = robot_that {
        closed = closed.with_driven(*driven).unwrap();
    }
    let mut nmpc = closed.solver().unwrap();
    let (mut seen, mut tips_m) = (Seen::default(), Vec::new());
    while closed.time_s() < until_s {
        let before = *closed.configuration();
        closed.step(&mut nmpc);
        let command = closed.command();
        let speed_m_s = fastest_end_m_s(&robot, &before, &command.rates);
        seen.commanded_m_s = seen.commanded_m_s.max(speed_m_s);
        seen.limited += u32::from(command.limits_hit.tip_speed);
        seen.error_max_m = seen.error_max_m.max(closed.error_m());
        let beside_m = closed.tip_m() - from_m;
        let aside_m = (beside_m - along * along.dot(&beside_m)).norm();
        seen.aside_m = seen.aside_m.max(aside_m);
        tips_m.push(closed.tip_m());
        if let Some(earlier) = tips_m
            .len()
            .checked_sub(11)
            .filter(|earlier| *earlier > 100)
        {
            let moved_m = (closed.tip_m() - tips_m[earlier]).norm();
            seen.true_m_s = seen.true_m_s.max(moved_m / (10.0 * PERIOD_S));
        }
    }
    seen.error_end_m = closed.error_m();
    println!("{limit_m_s} m/s: {seen:?}");
    seen
}

fn tip_m() -> Vector3<f64> {
    robot(0.0).tip_position(&start())
}

/// A robot with lag, droop, offsets and noise. Its reference moves at 0.34 m/s for half a second and then rests. At a
/// limit of 0.05 m/s the tip follows on the straight line, and arrives after the time that the limit leaves it.
#[test]
fn a_reference_above_the_limit_is_followed_straight_at_the_limit_and_reached() {
    let motion = Vector3::new(-0.12, 0.12, 0.02);
    let line = |time_s: f64| tip_m() + motion * (2.0 * time_s).min(1.0);
    let laboratory = driven(Flaws {
        droop_m: 2e-4,
        ..RobotPreset::Laboratory.flaws()
    });
    let limit_m_s = 0.05;
    let until_s = motion.norm() / limit_m_s + 0.3;
    let slow = follow(limit_m_s, Some(&laboratory), &[], until_s, line);
    assert!(slow.commanded_m_s <= limit_m_s * (1.0 + 1e-6));
    assert!(slow.true_m_s <= 1.02 * limit_m_s);
    let free = follow(0.0, Some(&laboratory), &[], until_s, line);
    assert!(free.commanded_m_s > 0.4 && free.limited == 0);
    // The offsets of the encoders stay, with and without the limit.
    assert!(slow.error_end_m < free.error_end_m + 5e-4);
    assert!(slow.aside_m < free.aside_m + 3e-3);
}

/// A camera that measures 0.2 s late, unknown to the controller, beside the cables: a reference of 0.075 m/s. The limit
/// bounds the motion, and a robot that is not led astray is the same with and without it.
#[test]
fn a_late_camera_moves_the_robot_at_the_limit_at_most() {
    let circle = |time_s: f64| {
        let (sin, cos) = (0.075 / 0.05 * time_s).sin_cos();
        tip_m() + 0.05 * Vector3::new(cos - 1.0, sin, 0.0)
    };
    let seen = |delay_s, limit_m_s| {
        let mut flaws = RobotPreset::Laboratory.flaws();
        (flaws.tip.delay_s, flaws.tip_noise_m) = (delay_s, 3e-4);
        let late = Driven {
            sensor: Sensor::CablesAndTip { every: 4 },
            ..driven(flaws)
        };
        follow(limit_m_s, Some(&late), &[], 15.0, circle)
    };
    let [late, slow] = [0.0, 0.1].map(|limit_m_s| seen(0.2, limit_m_s));
    assert!(late.true_m_s > 0.15, "the camera leads nothing astray");
    assert!(slow.commanded_m_s <= 0.1 * (1.0 + 1e-6) && slow.true_m_s < 0.102);
    assert!(slow.error_max_m < 1.1 * late.error_max_m);
    let [punctual, slow] = [0.0, 0.1].map(|limit_m_s| seen(0.0, limit_m_s));
    assert!((punctual.error_end_m - slow.error_end_m).abs() < 1e-4);
}

/// A ball crosses the way and leaves: the tip, which waited, catches up at the limit.
#[test]
fn a_tip_that_an_obstacle_held_back_catches_up_at_the_limit() {
    let motion = Vector3::new(-0.12, 0.12, 0.02);
    let line = |time_s: f64| tip_m() + motion * (time_s / 2.0).min(1.0);
    let velocity = Vector3::new(0.2, 0.2, 0.0);
    let shape = Shape::Sphere {
        centre_m: tip_m() + 0.9 * motion - 2.0 * velocity,
    };
    let ball = Obstacle::new(shape, 0.08, velocity).unwrap();
    let [free, slow] = [0.0, 0.1].map(|limit_m_s| follow(limit_m_s, None, &[ball], 6.0, line));
    assert!(free.commanded_m_s > 0.2);
    assert!(slow.commanded_m_s <= 0.1 * (1.0 + 1e-6) && slow.limited > 100);
    assert!(slow.error_max_m > 0.04);
    assert!(slow.error_end_m < 1e-6 && free.error_end_m < 1e-6);
}
