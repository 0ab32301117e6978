//! Motors that lag among obstacles that stand or move: they average the commanded path, and so lead the body past its
//! corners.

use cdcr_controller::closed_loop::{ClosedLoop, Driven, Sensor};
use cdcr_controller::nmpc::{NmpcSettings, RateWeight};
use cdcr_controller::plant::Flaws;
use cdcr_controller::robot::{Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;

use crate::inside;
use crate::robustness::{actuator, lagging};

const PERIOD_S: f64 = 0.005;

fn ball(centre: [f64; 3], velocity: [f64; 3]) -> Obstacle {
    let centre_m = Vector3::from(centre);
    Obstacle::new(Shape::Sphere { centre_m }, 0.03, Vector3::from(velocity)).unwrap()
}

/// Across the way of the tip.
fn bar([x, z]: [f64; 2], velocity: [f64; 3]) -> Obstacle {
    let [start_m, end_m] = [-0.2, 0.2].map(|y| Vector3::new(x, y, z));
    let shape = Shape::Capsule { start_m, end_m };
    Obstacle::new(shape, 0.01, Vector3::from(velocity)).unwrap()
}

/// What a robot does beside obstacles.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Scene {
    /// Its tip moves at 0.3 m/s to where the obstacle is on the way, or crosses it, comes, or goes ahead.
    Crossed,
    Met,
    Behind,
    BarMet,
    Several,
    /// It stands, and a ball comes to its tip from the side or from ahead, or to its middle.
    Side,
    Ahead,
    Middle,
}

impl Scene {
    const ALL: [Self; 8] = [
        Self::Crossed,
        Self::Met,
        Self::Behind,
        Self::BarMet,
        Self::Several,
        Self::Side,
        Self::Ahead,
        Self::Middle,
    ];

    fn moves_the_robot(self) -> bool {
        !matches!(self, Self::Side | Self::Ahead | Self::Middle)
    }

    /// Obstacles at a speed (m/s). Those on the way are where the tip is in a second.
    fn obstacles(self, tip_m: Vector3<f64>, v: f64) -> Vec<Obstacle> {
        let crossing = ball([0.15, -v, 0.85], [0.0, v, 0.0]);
        match self {
            Self::Crossed => vec![crossing],
            Self::Met => vec![ball([0.2 + v, 0.0, 0.82], [-v, 0.0, 0.0])],
            Self::Behind => vec![ball([0.12, 0.005, 0.85], [v, 0.0, 0.0])],
            Self::BarMet => vec![bar([0.15 + v, 0.85], [-v, 0.0, 0.0])],
            Self::Several => vec![crossing, ball([0.25 + v, 0.03, 0.8], [-v, 0.0, 0.0])],
            Self::Side => {
                let begin_m = tip_m + Vector3::new(0.002, -0.15, 0.0);
                vec![ball(begin_m.into(), [0.0, v, 0.0])]
            }
            Self::Ahead => {
                let begin_m = tip_m + Vector3::new(0.15, 0.004, -0.05);
                vec![ball(begin_m.into(), [-v, 0.0, 0.0])]
            }
            Self::Middle => vec![ball([0.42, 0.01, 0.5], [-v, 0.0, 0.0])],
        }
    }

    /// Least clearance, mean error of the tip, and error at the end (m).
    fn run(self, speed_m_s: f64, driven: &Driven) -> [f64; 3] {
        let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
        let bent = Configuration::from_bend_angles(&[[0.4, 0.0]; 3]);
        let tip_m = robot.tip_position(&bent);
        let [from_m, to_m] = [Vector3::new(0.0, 0.0, 0.9), Vector3::new(0.3, 0.0, 0.75)];
        let reference = |time_s: f64| {
            let share: f64 = 0.3 * time_s / (to_m - from_m).norm();
            inside(if self.moves_the_robot() {
                from_m + share.min(1.0) * (to_m - from_m)
            } else {
                tip_m
            })
        };
        let settings = NmpcSettings {
            rate_weight: RateWeight::MEASURED,
            ..NmpcSettings::default()
        };
        let start = if self.moves_the_robot() {
            Configuration::straight(3)
        } else {
            bent
        };
        let obstacles = self.obstacles(tip_m, speed_m_s);
        let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, start, &obstacles, reference)
            .unwrap()
            .with_acceleration(40.0)
            .with_driven(*driven)
            .unwrap();
        let mut nmpc = closed.solver().unwrap();
        // Until the obstacle has gone by.
        let until_s = if speed_m_s > 0.0 {
            2.0 + 0.3 / speed_m_s
        } else {
            5.0
        };
        let (mut nearest_m, mut errors_m) = (f64::INFINITY, 0.0);
        while closed.time_s() < until_s {
            closed.step(&mut nmpc);
            nearest_m = nearest_m.min(closed.clearance_m());
            errors_m += closed.error_m();
        }
        let mean_m = errors_m / closed.cycle() as f64;
        println!(
            "{self:?} at {speed_m_s} m/s, {:?}, positions {}: {:.2} mm, error {:.2} mm, {:.2e} mm at the end",
            driven.actuator,
            driven.obeys_positions,
            nearest_m * 1e3,
            mean_m * 1e3,
            closed.error_m() * 1e3
        );
        [nearest_m, mean_m, closed.error_m()]
    }
}

/// Time constant and delay (s).
const MOTORS: [(f64, f64); 4] = [(0.2, 0.15), (0.1, 0.3), (0.1, 0.03), (0.02, 0.0)];

/// With the estimate exact, it is the lag rule alone that is measured.
#[test]
fn motors_that_lag_lead_the_body_around_obstacles_at_the_safe_distance() {
    let safe_distance_m = NmpcSettings::default().safe_distance_m;
    for &(time_constant_s, delay_s) in crate::cases(2, &MOTORS) {
        for (number, scene) in Scene::ALL.into_iter().enumerate() {
            for (turn, speed_m_s) in [0.05, 0.1, 0.0].into_iter().enumerate() {
                let is_taken = crate::cases(1, &[0, 1, 2]).contains(&((number + turn) % 3));
                if !is_taken || speed_m_s == 0.0 && !scene.moves_the_robot() {
                    continue;
                }
                for &obeys_positions in crate::cases(1, &[number % 2 == 0, number % 2 == 1]) {
                    let motors = actuator(delay_s, time_constant_s);
                    let [nearest_m, mean_m, end_m] =
                        scene.run(speed_m_s, &lagging(motors, obeys_positions));
                    assert!(nearest_m > safe_distance_m - 1e-3, "{nearest_m} m");
                    // It goes on beside the obstacle, and arrives on its other side.
                    assert!(mean_m < 0.02, "{mean_m} m");
                    assert!(end_m < 1e-3, "{end_m} m");
                }
            }
        }
    }
}

/// A load, encoders with an offset, and noise: the tip's measurement tells how far the body may be beside its bends.
#[test]
fn motors_that_lag_keep_away_from_what_moves_although_the_model_is_wrong() {
    let safe_distance_m = NmpcSettings::default().safe_distance_m;
    for &scene in crate::cases(2, &[Scene::Crossed, Scene::Side, Scene::Behind, Scene::Met]) {
        for &(time_constant_s, delay_s) in crate::cases(1, &MOTORS) {
            let known = lagging(actuator(delay_s, time_constant_s), true);
            let driven = Driven {
                flaws: Flaws {
                    offset_m: 1e-4,
                    droop_m: 1e-4,
                    noise_m: 3e-5,
                    tip_noise_m: 3e-4,
                    ..known.flaws
                },
                sensor: Sensor::CablesAndTip { every: 2 },
                ..known
            };
            for &speed_m_s in crate::cases(1, &[0.1, 0.05]) {
                let [nearest_m, _, end_m] = scene.run(speed_m_s, &driven);
                assert!(nearest_m > safe_distance_m - 2e-3, "{nearest_m} m");
                assert!(end_m < 1e-3, "{end_m} m");
            }
        }
    }
}
