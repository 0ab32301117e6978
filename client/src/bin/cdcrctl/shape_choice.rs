//! Which shape `goto` and `jog` bend the robot to, where its present one leaves that open.
//!
//! A straight robot of several sections shortens by bending them against each other, in any plane and to either side. All these
//! shapes bring the tip to the same points, so noise would choose among them, and one may end at a bend limit where another has
//! room. Near the straight robot, position and axis of the tip together determine bends that the position leaves open. So the
//! reference contains the tip axis of the chosen shape, as a preferred one, on the first part of the way; from there on, the robot's shape decides.
//! A required axis would compete with the position, and its end would set the tip free at once.

use cdcr_client::model::obstacle_of;
use cdcr_client::{Orientation, Straight, Trajectory, obstacles};
use cdcr_controller::robot::{Configuration, Obstacle, Robot};
use cdcr_shared_types::Telemetry;
use nalgebra::Vector3;

use crate::bend_limit::BendShare;
use crate::dry_run::robot_and_pose;
use crate::reach::approached;

/// Uncertainty of the bends of each section: play, load, offsets and noise \[rad\].
const UNCERTAIN_RAD: f64 = 0.1;
/// Planes in which the sections are bent against each other, and patterns of their sides.
const PLANES: usize = 16;
const PATTERNS_MAX: usize = 8;
/// Steps of a computed way.
const STEPS: usize = 50;
/// Share of the way with the tip axis.
const GUIDED_SHARE: f64 = 0.5;
/// Shapes have equal room where their bends differ by less than this share of their limits: then the first one is chosen, so that noise does not
/// choose between mirrored shapes.
const EQUAL_SHARE: f64 = 0.02;

/// A straight way of the tip from rest to rest, with the shape that the robot takes.
#[derive(Debug)]
pub(crate) struct Guided {
    way: Straight,
    /// Tip axes of the chosen shape after equal steps of the square root of the share of the way: so the bends of a straight
    /// robot begin. Empty: the present shape decides.
    axes: Vec<[f64; 3]>,
}

/// How the robot's model follows the way.
struct Followed {
    axes: Vec<[f64; 3]>,
    end: Configuration,
    left_m: f64,
    bend_share: BendShare,
    clearance_m: f64,
}

impl Guided {
    /// Where shapes within the uncertainty of the one in `record` lead to different ends, chooses the one with the most room at
    /// the bend limits, of those that end within `allowed_m` of the point and clear of obstacles.
    pub(crate) fn new(record: &Telemetry, way: Straight, allowed_m: f64) -> anyhow::Result<Self> {
        let (robot, here) = robot_and_pose(record)?;
        let robot = robot.enlarged(&here, record.tip_margin_m);
        let known: Vec<Obstacle> = obstacles(record).iter().filter_map(obstacle_of).collect();
        let ends_m = [0.0, way.duration_s()].map(|time_s| {
            Vector3::from(way.position_m(time_s)) - Vector3::from(record.tip_offset_m)
        });
        let followed = |from: &Configuration| followed(&robot, from, ends_m, &known);
        let present = followed(&here);
        let others: Vec<_> = starts(&robot, &here).iter().map(followed).collect();
        // The starts lie this far apart, and a way keeps of it what does not move the tip.
        let apart_rad = 2.0 * UNCERTAIN_RAD * (robot.section_count() as f64).sqrt();
        let bent_rad = here.distance_rad(&present.end).max(apart_rad);
        let is_open = others
            .iter()
            .any(|other| present.end.distance_rad(&other.end) > bent_rad);
        let mut arriving: Vec<_> = others
            .into_iter()
            .filter(|other| {
                let is_clear = other.clearance_m >= record.settings.safe_distance_m;
                is_open && is_clear && other.left_m <= allowed_m
            })
            .collect();
        let share = |other: &Followed| other.bend_share.share();
        let least = arriving.iter().map(share).fold(f64::INFINITY, f64::min);
        arriving.retain(|other| share(other) <= least + EQUAL_SHARE);
        let chosen = arriving.into_iter().next();
        let axes = chosen.map_or_else(Vec::new, |chosen| chosen.axes);
        Ok(Self { way, axes })
    }
}

impl Trajectory for Guided {
    fn name(&self) -> &str {
        self.way.name()
    }

    fn duration_s(&self) -> f64 {
        self.way.duration_s()
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        self.way.position_m(time_s)
    }

    fn orientation(&self, time_s: f64) -> Orientation {
        let share = self.way.share(time_s);
        if self.axes.is_empty() || share > GUIDED_SHARE {
            return Orientation::Free;
        }
        let at = share.sqrt() * STEPS as f64;
        let [from, to] =
            [at.floor(), at.ceil()].map(|step| Vector3::from(self.axes[step as usize]));
        Orientation::Preferred(from.lerp(&to, at.fract()).normalize().into())
    }
}

/// Shapes around `here` whose sections are bent against each other.
fn starts(robot: &Robot, here: &Configuration) -> Vec<Configuration> {
    let sections = robot.section_count();
    // Bit j: section j is on the other side. The opposite of a pattern is the same in the opposite plane, and comes last.
    let alternating = 0b10_1010 & ((1 << sections) - 1);
    let patterns = (0..1_usize << (sections - 1))
        .map(|flipped| flipped ^ alternating)
        .filter(|sides| *sides != 0 && *sides != (1 << sections) - 1)
        .take(PATTERNS_MAX);
    let mut starts = Vec::with_capacity(PATTERNS_MAX * PLANES);
    for sides in patterns {
        for plane in 0..PLANES {
            let (sin, cos) = (core::f64::consts::TAU * plane as f64 / PLANES as f64).sin_cos();
            let mut start = *here;
            for (j, pair) in start.as_mut_slice().chunks_mut(2).enumerate() {
                let side = if sides >> j & 1 == 1 { -1.0 } else { 1.0 };
                pair[0] += side * UNCERTAIN_RAD * cos;
                pair[1] += side * UNCERTAIN_RAD * sin;
            }
            starts.push(start);
        }
    }
    starts
}

/// Leads the tip of the model along the way with small changes of its bends, beginning near `start`.
fn followed(
    robot: &Robot,
    start: &Configuration,
    [from_m, to_m]: [Vector3<f64>; 2],
    known: &[Obstacle],
) -> Followed {
    let mut followed = Followed {
        axes: Vec::with_capacity(STEPS + 1),
        end: *start,
        left_m: 0.0,
        bend_share: BendShare::NONE,
        clearance_m: f64::INFINITY,
    };
    for step in 0..=STEPS {
        let point_m = from_m.lerp(&to_m, (step as f64 / STEPS as f64).powi(2));
        let (shape, left_m) = approached(robot, &followed.end, &point_m);
        let axis = robot.tip_pose(&shape).rotation.column(2).into_owned();
        followed.axes.push(axis.into());
        (followed.end, followed.left_m) = (shape, left_m);
        let bend_share = BendShare::largest(robot, &shape);
        followed.bend_share = followed.bend_share.larger(bend_share);
        let clearance_m = robot.body(&shape).least_clearance_m(known.iter().copied());
        followed.clearance_m = followed.clearance_m.min(clearance_m);
    }
    followed
}

#[cfg(test)]
mod tests;
