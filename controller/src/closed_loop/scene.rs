//! Scenes: the paper's three simulations, and three harder ones. Tests of the controller and the benchmarks use them.

use core::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;

use super::ClosedLoop;
use crate::nmpc::{Nmpc, NmpcSettings, SettingsError};
use crate::reference::{Orientation, ReferenceSample};
use crate::robot::{
    Configuration, Obstacle, ObstacleError, Robot, RobotError, RobotParameters, Shape,
};

/// Radius and height of the paper's circle (m), rounded as printed.
const CIRCLE_M: [f64; 2] = [0.169_86, 0.221_37];
const POST_RADIUS_M: f64 = 0.02;
/// Radius of the body of the paper's robot (m).
const BODY_RADIUS_M: f64 = 0.015;
/// What the body has to spare on each side of the gap (m).
const GAP_SPARE_M: f64 = 0.004;
/// Distance of the axes of the two posts of [`Scene::gap`] from the middle (m).
const POST_BESIDE_M: f64 = BODY_RADIUS_M + Scene::SAFE_DISTANCE_M + GAP_SPARE_M + POST_RADIUS_M;
/// Radius of an obstacle of [`Scene::crowded`] (m).
const BALL_RADIUS_M: f64 = 0.01;

/// A robot at rest, the reference of its tip, and obstacles.
pub struct Scene {
    /// The robot that moves in the scene, at rest at time 0.
    pub robot: Robot,
    /// Its shape at time 0.
    pub start: Configuration,
    /// The reference at a time (s) since the first release.
    pub reference_at: Box<dyn Fn(f64) -> ReferenceSample>,
    /// The obstacles at time 0; each moves at its velocity.
    pub obstacles: Vec<Obstacle>,
    /// Number of cycles.
    pub cycles: u64,
}

/// Reason why a scene is impossible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// No robot has these parameters.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// No obstacle has these.
    #[error(transparent)]
    Obstacle(#[from] ObstacleError),
}

/// The closed loop of a [`Scene`].
pub type SceneLoop<'a> = ClosedLoop<&'a dyn Fn(f64) -> ReferenceSample>;

impl Scene {
    /// Period of the cycles (s).
    pub const PERIOD_S: f64 = 0.005;
    /// Safe distance for which the gap and the crossing are made (m).
    pub const SAFE_DISTANCE_M: f64 = 0.01;

    /// Simulation 1 of the paper (Eq. 8): the last section bends by θ = 2t/15 towards φ = t, from t = 5°; the others are
    /// straight.
    ///
    /// # Errors
    /// For a number of sections that no robot has.
    pub fn spiral(sections: usize) -> Result<Self, SceneError> {
        let robot = Robot::new(&RobotParameters::paper(sections))?;
        let model = robot.clone();
        let tip_m = move |time_s| model.tip_position(&spiral_shape(sections, time_s));
        let reference_at = Box::new(move |time_s| ReferenceSample::at_position(tip_m(time_s)));
        let start = spiral_shape(sections, 0.0);
        Ok(Self::new(robot, start, reference_at, 994))
    }

    /// Simulation 2 of the paper (Eq. 9): the tip of the straight robot moves 30 mm/s sideways and 10 mm/s down, and
    /// stays vertical. The paper does not tell the largest rates.
    ///
    /// # Errors
    /// For rates that no robot has.
    pub fn line(rate_max_rad_s: f64) -> Result<Self, SceneError> {
        let mut parameters = RobotParameters::paper(3);
        for section in &mut parameters.sections {
            section.rate_max_rad_s = rate_max_rad_s;
        }
        let robot = Robot::new(&parameters)?;
        let reach_m = robot.reach_m();
        let reference_at = move |time_s: f64| ReferenceSample {
            orientation: Orientation::Axis(Vector3::z_axis()),
            ..ReferenceSample::at_position(Vector3::new(
                0.03 * time_s,
                0.0,
                reach_m - 0.01 * time_s,
            ))
        };
        let start = Configuration::straight(3);
        Ok(Self::new(robot, start, Box::new(reference_at), 510))
    }

    /// Simulation 3 of the paper: one section, from the straight robot to a circle and once around. A point on it at
    /// t = π/2 is an obstacle. Point and body have no radius, so the clearance is the distance from the backbone.
    ///
    /// # Errors
    /// [`SceneError`], which does not occur for the paper's robot.
    pub fn circle() -> Result<Self, SceneError> {
        let mut parameters = RobotParameters::paper(1);
        parameters.sections[0].body_radius_m = 0.0;
        let reference_at = |time_s: f64| {
            let ([radius_m, height_m], (sin, cos)) = (CIRCLE_M, time_s.sin_cos());
            ReferenceSample::at_position(Vector3::new(radius_m * cos, radius_m * sin, height_m))
        };
        let centre_m = reference_at(FRAC_PI_2).position_m;
        let start = Configuration::straight(1);
        // A round, and 0.7 s to approach the circle.
        let scene = Self::new(
            Robot::new(&parameters)?,
            start,
            Box::new(reference_at),
            1400,
        );
        scene.among([(Shape::Sphere { centre_m }, 0.0, Vector3::zeros())])
    }

    /// The tip moves through a gap between two posts, then to one side: the body has to turn in the gap.
    ///
    /// # Errors
    /// [`SceneError`], which does not occur for the paper's robot.
    pub fn gap() -> Result<Self, SceneError> {
        let at = Vector3::new;
        let way = [
            (0.3, at(0.19, 0.0, 0.83)),
            (1.0, at(0.34, 0.0, 0.74)),
            (1.6, at(0.42, -0.12, 0.64)),
        ];
        let post = |y_m| {
            let [start_m, end_m] = [0.55, 0.95].map(|z_m| at(0.26, y_m, z_m));
            (
                Shape::Capsule { start_m, end_m },
                POST_RADIUS_M,
                at(0.0, 0.0, 0.0),
            )
        };
        let scene = Self::along(
            [[0.1, 0.5], [0.1, -0.5], [0.15, 0.0]],
            |_| way.to_vec(),
            340,
        )?;
        scene.among([post(POST_BESIDE_M), post(-POST_BESIDE_M)])
    }

    /// A ball crosses the robot below its tip while the tip follows a line: the body has to give way.
    ///
    /// # Errors
    /// [`SceneError`], which does not occur for the paper's robot.
    pub fn crossing() -> Result<Self, SceneError> {
        let way = |_| vec![(1.6, Vector3::new(0.4, 0.0, 0.7))];
        let centre_m = Vector3::new(0.36, -0.16, 0.65);
        let ball = (
            Shape::Sphere { centre_m },
            0.03,
            Vector3::new(0.0, 0.2, 0.0),
        );
        Self::along([[0.4, 0.0]; 3], way, 300)?.among([ball])
    }

    /// The reference jumps by 0.15 m and back, so that the rates saturate.
    ///
    /// # Errors
    /// [`SceneError`], which does not occur for the paper's robot.
    pub fn jump() -> Result<Self, SceneError> {
        let way = |tip_m: Vector3<f64>| {
            let far_m = tip_m + Vector3::new(-0.1, 0.1, -0.05);
            vec![(0.2, tip_m), (0.2, far_m), (0.7, far_m), (0.7, tip_m)]
        };
        Self::along([[0.4, 0.0], [0.4, 0.5], [0.4, 1.0]], way, 240)
    }

    /// Three sections whose tip follows the points of `way`, which gets its first position.
    fn along(
        bend_angles: [[f64; 2]; 3],
        way: impl FnOnce(Vector3<f64>) -> Vec<TimedPoint>,
        cycles: u64,
    ) -> Result<Self, SceneError> {
        let robot = Robot::new(&RobotParameters::paper(3))?;
        let start = Configuration::from_bend_angles(&bend_angles);
        let tip_m = robot.tip_pose(&start).position_m;
        let knots = [vec![(0.0, tip_m)], way(tip_m)].concat();
        let reference_at =
            Box::new(move |time_s| ReferenceSample::at_position(on_legs(&knots, time_s)));
        Ok(Self::new(robot, start, reference_at, cycles))
    }

    fn new(
        robot: Robot,
        start: Configuration,
        reference_at: Box<dyn Fn(f64) -> ReferenceSample>,
        cycles: u64,
    ) -> Self {
        Self {
            robot,
            start,
            reference_at,
            obstacles: Vec::new(),
            cycles,
        }
    }

    fn among(
        mut self,
        obstacles: impl IntoIterator<Item = (Shape, f64, Vector3<f64>)>,
    ) -> Result<Self, SceneError> {
        for (shape, radius_m, velocity_m_s) in obstacles {
            self.obstacles
                .push(Obstacle::new(shape, radius_m, velocity_m_s)?);
        }
        Ok(self)
    }

    /// The same with at most this number of cycles.
    #[must_use]
    pub fn at_most(mut self, cycles: u64) -> Self {
        self.cycles = self.cycles.min(cycles);
        self
    }

    /// The same with a reference that is `times` as fast.
    #[must_use]
    pub fn faster(mut self, times: f64) -> Self {
        let reference_at = self.reference_at;
        self.reference_at = Box::new(move |time_s| reference_at(times * time_s));
        self
    }

    /// The same with `count` obstacles at rest beside the lower quarter of the last section, 16 mm beyond the body and its
    /// safe distance (m): within reach, and off the path of the spiral in its first second. Every `capsule_every`-th is
    /// an upright capsule, the others are spheres; 0: none is.
    ///
    /// # Errors
    /// [`SceneError::Obstacle`] for an infinite distance.
    pub fn crowded(
        self,
        count: usize,
        safe_distance_m: f64,
        capsule_every: usize,
    ) -> Result<Self, SceneError> {
        let sections = self.robot.sections();
        let last = sections[sections.len() - 1];
        let base_m: f64 = sections
            .iter()
            .rev()
            .skip(1)
            .map(|below| below.length_m)
            .sum();
        let apart_m = last.body_radius_m + safe_distance_m + 0.016 + BALL_RADIUS_M;
        let obstacle = |i: usize| {
            // The golden angle: no two in one direction.
            let (sin, cos) = (2.4 * i as f64).sin_cos();
            let up_m = base_m + (0.05 + 0.2 * i as f64 / count as f64) * last.length_m;
            let start_m = Vector3::new(apart_m * cos, apart_m * sin, up_m);
            let end_m = start_m + Vector3::new(0.0, 0.0, 0.03);
            let shape = if capsule_every > 0 && (i + 1).is_multiple_of(capsule_every) {
                Shape::Capsule { start_m, end_m }
            } else {
                Shape::Sphere { centre_m: start_m }
            };
            (shape, BALL_RADIUS_M, Vector3::zeros())
        };
        self.among((0..count).map(obstacle))
    }

    /// Position of the reference at the end of a cycle (m).
    pub fn point_m(&self, cycle: u64) -> Vector3<f64> {
        (self.reference_at)(cycle as f64 * Self::PERIOD_S).position_m
    }

    /// A solver for the robot.
    ///
    /// # Errors
    /// As [`Nmpc::new`].
    pub fn solver(&self, settings: NmpcSettings) -> Result<Nmpc, SettingsError> {
        Nmpc::new(self.robot.clone(), Self::PERIOD_S, settings)
    }

    /// The closed loop at time 0. No command is lost, and the robot stops at once, so the clearance guard checks each
    /// command for one period.
    ///
    /// # Errors
    /// As [`ClosedLoop::new`].
    pub fn begin(&self, settings: NmpcSettings) -> Result<SceneLoop<'_>, SettingsError> {
        let (robot, start, obstacles) = (&self.robot, self.start, &self.obstacles);
        ClosedLoop::new(
            robot,
            Self::PERIOD_S,
            settings,
            start,
            obstacles,
            &*self.reference_at,
        )
    }
}

/// The shape on the paper's spiral.
pub(super) fn spiral_shape(sections: usize, time_s: f64) -> Configuration {
    let t = 5_f64.to_radians() + time_s;
    let mut bend_angles = vec![[0.0; 2]; sections];
    bend_angles[sections - 1] = [2.0 * t / 15.0, t];
    Configuration::from_bend_angles(&bend_angles)
}

/// A time (s) and a position (m).
type TimedPoint = (f64, Vector3<f64>);

/// The position on a curve through points, at rest in each of them. Two points at one time are a jump. The last point
/// is held.
fn on_legs(knots: &[TimedPoint], time_s: f64) -> Vector3<f64> {
    let next = knots.partition_point(|knot| knot.0 <= time_s);
    let (from_s, from_m) = knots[next.saturating_sub(1)];
    let Some((to_s, to_m)) = knots.get(next).filter(|_| next > 0) else {
        return from_m;
    };
    let share = (time_s - from_s) / (to_s - from_s);
    from_m + (to_m - from_m) * (0.5 - 0.5 * (PI * share).cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scene_starts_on_its_curve_clear_of_its_obstacles() {
        let mut circle = Scene::circle().unwrap();
        // The straight robot first has to approach the circle, whose printed numbers are rounded.
        let off_m =
            |scene: &Scene| (scene.robot.tip_position(&scene.start) - scene.point_m(0)).norm();
        assert!(off_m(&circle) > 0.1);
        circle.start = Configuration::from_bend_angles(&[[75_f64.to_radians(), 0.0]]);
        let quarter = (FRAC_PI_2 / Scene::PERIOD_S).round() as u64;
        let Shape::Sphere { centre_m } = circle.obstacles[0].shape() else {
            panic!("a point");
        };
        assert!((circle.point_m(quarter) - centre_m).norm() < 0.001);
        let scenes = [
            (Scene::spiral(3).unwrap(), 1e-12),
            (Scene::line(2.0).unwrap(), 1e-12),
            (Scene::gap().unwrap(), 1e-12),
            (Scene::crossing().unwrap(), 1e-12),
            (Scene::jump().unwrap(), 1e-12),
            (circle, 1e-5),
        ];
        for (number, (scene, off_max_m)) in scenes.into_iter().enumerate() {
            let clearance_m = scene.robot.body(&scene.start);
            let clearance_m = clearance_m.least_clearance_m(scene.obstacles.iter().copied());
            assert!(
                clearance_m > Scene::SAFE_DISTANCE_M,
                "{number}: {clearance_m}"
            );
            let off_m = off_m(&scene);
            assert!(off_m < off_max_m, "{number}: {off_m}");
        }
    }
}
