use cdcr_client::{Spiral, Trajectory};
use cdcr_controller::robot::{Robot, RobotParameters};

use super::cycle::Cycle;
use crate::backbone::{Position, backbone};

const CURVE_SAMPLES: u32 = 500;

/// The shape of the demo's robot, from base to tip.
#[derive(Debug)]
pub(super) struct Backbone {
    robot: Robot,
}

impl Backbone {
    /// For the paper's robot, which the demo controls.
    pub(super) fn new(sections: usize) -> anyhow::Result<Self> {
        let robot = Robot::new(&RobotParameters::paper(sections))?;
        Ok(Self { robot })
    }

    /// Points on the backbone in a cycle, base first and tip last.
    pub(super) fn points(&self, cycle: &Cycle) -> Vec<Position> {
        backbone(&self.robot, cycle.bend_rad(self.robot.section_count()))
    }
}

pub(super) fn curve(spiral: &Spiral) -> Vec<Position> {
    let step_s = spiral.duration_s / f64::from(CURVE_SAMPLES);
    let point = |k: u32| spiral.position_m(f64::from(k) * step_s);
    (0..=CURVE_SAMPLES).map(point).collect()
}

/// The first cycle of each stretch of `step_s`.
pub(super) fn moments(cycles: &[Cycle], step_s: f64) -> Vec<&Cycle> {
    let stretch = |cycle: &Cycle| (cycle.time_s / step_s).floor();
    let first = cycles.iter().take(1);
    let next = cycles
        .windows(2)
        .filter(|pair| stretch(&pair[0]) < stretch(&pair[1]))
        .map(|pair| &pair[1]);
    first.chain(next).collect()
}

#[cfg(test)]
mod tests {
    use super::super::cycle::tests::synthetic;
    use super::*;
    use crate::standing::distance_m;

    #[test]
    fn the_backbone_leads_from_the_base_to_the_tip_and_has_the_robots_length() {
        let (cycles, _) = synthetic(900);
        let backbone = Backbone::new(3).expect("the paper's");
        let cycle = &cycles[899];
        let points = backbone.points(cycle);
        assert_eq!(points[0], [0.0; 3]);
        // The tip of the synthetic run is 0.2 nm beside the spiral.
        let tip = points[points.len() - 1];
        assert!(distance_m(tip, cycle.tip_m) < 1e-9, "{tip:?}");
        let length: f64 = points
            .windows(2)
            .map(|pair| distance_m(pair[0], pair[1]))
            .sum();
        assert!((length - 0.9).abs() < 1e-4, "{length}");
        assert!(tip[0].hypot(tip[1]) > 0.05, "it is bent: {tip:?}");
    }

    #[test]
    fn there_is_one_moment_in_each_half_second_whatever_is_missing() {
        let (mut cycles, _) = synthetic(994);
        let numbers = |cycles: &[Cycle]| {
            let moments = moments(cycles, 0.5);
            moments.iter().map(|cycle| cycle.number).collect::<Vec<_>>()
        };
        assert_eq!(
            numbers(&cycles),
            [0, 100, 200, 300, 400, 500, 600, 700, 800, 900]
        );
        cycles.drain(95..310);
        assert_eq!(numbers(&cycles), [0, 310, 400, 500, 600, 700, 800, 900]);
        assert!(moments(&[], 0.5).is_empty());
    }
}
