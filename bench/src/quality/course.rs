//! Courses: the paper's simulations, and harder scenes.

use anyhow::Result;
use cdcr_controller::nmpc::{NmpcSettings, SolverKind};
use cdcr_controller::robot::Configuration;

use crate::closed_loop::Scene;
use crate::experiment::{CIRCLE_DISTANCES_M, LINE_RATES_RAD_S, Task};
use crate::named::named;

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
    pub fn scene(self) -> Result<Scene> {
        Ok(match self {
            Self::Gap => Scene::gap()?,
            Self::Crossing => Scene::crossing()?,
            Self::Jump => Scene::jump()?,
            Self::Spiral => Scene::spiral(3)?.at_most(150),
            Self::Line => Scene::line(LINE_RATES_RAD_S[0])?.at_most(150),
            // On the curve: the paper's approach from the straight robot would dominate the mean error. The tip meets
            // the point after 314 cycles and then passes it.
            Self::Circle => Scene {
                start: Configuration::from_bend_angles(&[[75_f64.to_radians(), 0.0]]),
                ..Scene::circle()?.at_most(380)
            },
        })
    }

    /// The paper's for its scenes, otherwise separate controls for each step: with blocks of several steps, the plan of
    /// one cycle does not fit the next, and the robot misses the gap.
    pub fn settings(self) -> NmpcSettings {
        let rate_limit_rad_s = LINE_RATES_RAD_S[0];
        let safe_distance_m = CIRCLE_DISTANCES_M[1];
        let task = match self {
            Self::Spiral => Task::Spiral { sections: 3 },
            Self::Line => Task::Line { rate_limit_rad_s },
            Self::Circle => Task::Circle { safe_distance_m },
            Self::Gap | Self::Crossing | Self::Jump => {
                return NmpcSettings {
                    horizon_steps: if self == Self::Gap { 5 } else { 10 },
                    control_blocks: 0,
                    safe_distance_m: Scene::SAFE_DISTANCE_M,
                    ..NmpcSettings::default()
                };
            }
        };
        task.settings(SolverKind::KpsoRefined)
    }
}
