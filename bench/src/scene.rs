//! Simulated scenes: a robot, the curve for its tip, and obstacles.

use std::f64::consts::{FRAC_PI_2, TAU};

use anyhow::Result;
use cdcr_client::{Circle, Line, Spiral, Trajectory};
use cdcr_controller::robot::{Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;

pub const PERIOD_S: f64 = 0.005;
pub const SPIRAL_SAMPLES: u64 = 994;
pub const LINE_SAMPLES: u64 = 510;
/// Samples of the circle: one turn, and 0.7 s in which the straight robot approaches it.
pub const CIRCLE_SAMPLES: u64 = 1400;
/// Duration of a curve beyond the samples \[s\]: the longest horizon is 50 steps.
const BEYOND_S: f64 = 1.0;

pub struct Scene {
    pub robot: Robot,
    pub start: Configuration,
    /// The curve. Time 0 is the first release; it lasts longer than the samples.
    pub curve: Box<dyn Trajectory + Send>,
    /// Obstacles at time 0; each moves at its velocity.
    pub obstacles: Vec<Obstacle>,
    pub cycles: u64,
    pub period_s: f64,
}

impl Scene {
    /// The paper's simulation 1 (Eq. 8): the spiral of the last of these sections, from its first point.
    pub fn spiral(sections: usize) -> Result<Self> {
        let parameters = RobotParameters::paper(sections);
        let curve = Spiral {
            duration_s: Spiral::DURATION_S + BEYOND_S,
            ..Spiral::for_sections(&lengths_m(&parameters))
        };
        let last = curve.start_bend_rad();
        let mut scene = Self::from_straight(&parameters, curve, SPIRAL_SAMPLES)?;
        scene.start.as_mut_slice()[2 * sections - 2..].copy_from_slice(&last);
        Ok(scene)
    }

    /// The paper's simulation 2 (Eq. 9): the line of three sections from the straight robot, tip axis along
    /// z, with this limit on the rates.
    pub fn line(rate_max_rad_s: f64) -> Result<Self> {
        let mut parameters = RobotParameters::paper(3);
        for section in &mut parameters.sections {
            section.rate_max_rad_s = rate_max_rad_s;
        }
        let curve = Line {
            duration_s: Line::DURATION_S + BEYOND_S,
            tip_axis: Some([0.0, 0.0, 1.0]),
            ..Line::for_sections(&lengths_m(&parameters))
        };
        Self::from_straight(&parameters, curve, LINE_SAMPLES)
    }

    /// The paper's simulation 3: the circle of one section from the straight robot, and a point on it at t =
    /// π/2. Body and point have no radius, so clearance is the distance from the backbone.
    pub fn circle() -> Result<Self> {
        let mut parameters = RobotParameters::paper(1);
        parameters.sections[0].body_radius_m = 0.0;
        let curve = Circle {
            duration_s: TAU + 2.0 * BEYOND_S,
            ..Circle::for_sections(&lengths_m(&parameters))
        };
        let point = Shape::Sphere {
            centre_m: Vector3::from(curve.position_m(FRAC_PI_2)),
        };
        let obstacles = vec![Obstacle::new(point, 0.0, Vector3::zeros())?];
        let scene = Self::from_straight(&parameters, curve, CIRCLE_SAMPLES)?;
        Ok(scene.with_obstacles(obstacles))
    }

    fn from_straight(
        parameters: &RobotParameters,
        curve: impl Trajectory + Send + 'static,
        cycles: u64,
    ) -> Result<Self> {
        Ok(Self {
            robot: Robot::new(parameters)?,
            start: Configuration::straight(parameters.sections.len()),
            curve: Box::new(curve),
            obstacles: Vec::new(),
            cycles,
            period_s: PERIOD_S,
        })
    }

    #[must_use]
    pub fn with_obstacles(self, obstacles: Vec<Obstacle>) -> Self {
        Self { obstacles, ..self }
    }

    #[must_use]
    pub fn at_most(self, cycles: u64) -> Self {
        Self {
            cycles: self.cycles.min(cycles),
            ..self
        }
    }

    pub fn time_s(&self, cycle: u64) -> f64 {
        cycle as f64 * self.period_s
    }

    pub fn point_m(&self, cycle: u64) -> Vector3<f64> {
        Vector3::from(self.curve.position_m(self.time_s(cycle)))
    }
}

fn lengths_m(parameters: &RobotParameters) -> Vec<f64> {
    let sections = parameters.sections.iter();
    sections.map(|section| section.length_m).collect()
}
