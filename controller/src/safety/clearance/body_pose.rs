//! A configuration of the robot with the geometry that the guard derives from it.

use core::cell::OnceCell;

use crate::robot::{Body, BodyMotion, Configuration, Pose, Robot, SECTIONS_MAX};

/// A configuration with its derived geometry.
pub(super) struct BodyPose {
    pub(super) at: Configuration,
    frames: [Pose; SECTIONS_MAX + 1],
    pub(super) body: Body,
    motion: OnceCell<BodyMotion>,
}

impl BodyPose {
    pub(super) fn new(robot: &Robot, at: &Configuration) -> Self {
        let frames = robot.section_frames(at);
        Self {
            at: *at,
            frames,
            body: robot.body_from_frames(at, &frames),
            motion: OnceCell::new(),
        }
    }

    /// Motion of the body's points by the rates.
    pub(super) fn motion(&self, robot: &Robot) -> &BodyMotion {
        self.motion.get_or_init(|| robot.body_motion(&self.at))
    }

    /// Upper bound of the distance of each section's points from their position in another pose \[m\].
    pub(super) fn displacement_m(&self, robot: &Robot, other: &Self) -> [f64; SECTIONS_MAX] {
        robot.displacement_m((&other.at, &other.frames), (&self.at, &self.frames))
    }
}
