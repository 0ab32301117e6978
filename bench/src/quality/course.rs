//! Courses: the paper's simulations, and harder scenes.

use std::f64::consts::PI;

use anyhow::Result;
use cdcr_client::Trajectory;
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::robot::{Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;

use crate::closed_loop::Scene;
use crate::experiment::{CIRCLE_DISTANCES_M, LINE_RATES_RAD_S, Solver, Task};
use crate::named::named;

/// Safe distance of the gap and the crossing \[m\].
const SAFE_DISTANCE_M: f64 = 0.01;
const BODY_RADIUS_M: f64 = 0.015;
/// Radius of a post of the gap \[m\].
const POST_RADIUS_M: f64 = 0.02;
/// Space left by the gap on either side, beyond the body and its safe distance \[m\].
const GAP_SLACK_M: f64 = 0.004;

named! {
    pub enum Course {
        Spiral = "spiral",
        /// The paper's line with the tip's axis, rates up to 2 rad/s.
        Line = "line",
        /// The paper's circle of one section with a point on it, from its first point to past the obstacle.
        Circle = "circle",
        /// The tip moves through a gap between two posts, then to one side: the body has to turn in the gap.
        Gap = "gap",
        /// A ball crosses the robot below its tip while the tip follows a line: the body has to give way.
        Crossing = "crossing",
        /// The reference jumps by 0.15 m and back, so that the rates saturate.
        Jump = "jump",
    }
}

impl Course {
    /// The paper's simulation that it is the start of, and its cycles.
    fn paper(self) -> Option<(Task, u64)> {
        let rate_limit_rad_s = LINE_RATES_RAD_S[0];
        let safe_distance_m = CIRCLE_DISTANCES_M[1];
        Some(match self {
            Self::Spiral => (Task::Spiral { sections: 3 }, 150),
            Self::Line => (Task::Line { rate_limit_rad_s }, 150),
            // The tip meets the point after 314 cycles and then passes it.
            Self::Circle => (Task::Circle { safe_distance_m }, 380),
            Self::Gap | Self::Crossing | Self::Jump => return None,
        })
    }

    pub fn scene(self) -> Result<Scene> {
        if let Some((task, cycles)) = self.paper() {
            let mut scene = task.scene()?.at_most(cycles);
            if self == Self::Circle {
                // On the curve: the paper's approach from the straight robot would dominate the mean error.
                scene.start = Configuration::from_bend_angles(&[[75.0 * PI / 180.0, 0.0]]);
            }
            return Ok(scene);
        }
        let at = Vector3::new;
        let robot = Robot::new(&RobotParameters::paper(3))?;
        let start = Configuration::from_bend_angles(&match self {
            Self::Gap => [[0.1, 0.5], [0.1, -0.5], [0.15, 0.0]],
            Self::Crossing => [[0.4, 0.0]; 3],
            _ => [[0.4, 0.0], [0.4, 0.5], [0.4, 1.0]],
        });
        let tip_m = robot.tip_pose(&start).position_m;
        let far_m = tip_m + at(-0.1, 0.1, -0.05);
        let within = [(0.3, at(0.19, 0.0, 0.83)), (1.0, at(0.34, 0.0, 0.74))];
        let aside = (1.6, at(0.42, -0.12, 0.64));
        let (way, cycles) = match self {
            Self::Gap => ([&within[..], &[aside]].concat(), 340),
            Self::Crossing => (vec![(1.6, at(0.4, 0.0, 0.7))], 300),
            _ => (
                vec![(0.2, tip_m), (0.2, far_m), (0.7, far_m), (0.7, tip_m)],
                240,
            ),
        };
        let curve = Box::new(Legs([vec![(0.0, tip_m)], way].concat()));
        let obstacles = self.obstacles()?;
        Ok(Scene {
            robot,
            start,
            curve,
            obstacles,
            cycles,
        })
    }

    fn obstacles(self) -> Result<Vec<Obstacle>> {
        let y_m = BODY_RADIUS_M + SAFE_DISTANCE_M + GAP_SLACK_M + POST_RADIUS_M;
        let post = |y_m: f64| {
            let [start_m, end_m] = [0.55, 0.95].map(|z_m| Vector3::new(0.26, y_m, z_m));
            let shape = Shape::Capsule { start_m, end_m };
            Obstacle::new(shape, POST_RADIUS_M, Vector3::zeros())
        };
        let centre_m = Vector3::new(0.36, -0.16, 0.65);
        let ball = Shape::Sphere { centre_m };
        Ok(match self {
            Self::Gap => vec![post(y_m)?, post(-y_m)?],
            Self::Crossing => vec![Obstacle::new(ball, 0.03, Vector3::new(0.0, 0.2, 0.0))?],
            _ => Vec::new(),
        })
    }

    /// The paper's for its scenes, otherwise separate controls for each step: with blocks of several steps, the plan of
    /// one cycle does not fit the next, and the robot misses the gap.
    pub fn settings(self) -> NmpcSettings {
        if let Some((task, _)) = self.paper() {
            return task.settings(Solver::KpsoRefined);
        }
        NmpcSettings {
            horizon_steps: if self == Self::Gap { 5 } else { 10 },
            control_blocks: 0,
            safe_distance_m: SAFE_DISTANCE_M,
            ..NmpcSettings::default()
        }
    }
}

/// A curve through points at given times (s, m), in order, at rest in each of them. Two points at one time
/// are a jump. The last point is held.
struct Legs(Vec<(f64, Vector3<f64>)>);

impl Trajectory for Legs {
    fn name(&self) -> &'static str {
        "legs"
    }

    fn duration_s(&self) -> f64 {
        self.0.last().map_or(0.0, |knot| knot.0)
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        let next = self.0.partition_point(|knot| knot.0 <= time_s);
        let (from_s, from_m) = self.0[next.saturating_sub(1)];
        let Some(&(to_s, to_m)) = self.0.get(next).filter(|_| next > 0) else {
            return from_m.into();
        };
        let share = (time_s - from_s) / (to_s - from_s);
        (from_m + (to_m - from_m) * (0.5 - 0.5 * (PI * share).cos())).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_course_starts_on_its_curve_clear_of_its_obstacles() {
        for course in Course::ALL {
            let scene = course.scene().unwrap();
            let settings = course.settings();
            let clearance_m = scene.robot.body(&scene.start);
            let clearance_m = clearance_m.least_clearance_m(scene.obstacles.iter().copied());
            let is_clear = clearance_m > settings.safe_distance_m;
            assert!(is_clear, "{course:?}: {clearance_m}");
            // The constants of the paper's circle are rounded.
            let tip_m = scene.robot.tip_pose(&scene.start).position_m;
            let off_m = (tip_m - scene.point_m(0)).norm();
            assert!(off_m < 1e-5, "{course:?}: {off_m}");
        }
    }
}
