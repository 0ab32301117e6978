//! Subnormal numbers do not slow a solve down, so flushing them to zero is not needed
//! (docs/decisions/0008-subnormal-numbers.md).

use std::time::{Duration, Instant};

use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Configuration, Robot, RobotParameters};
use nalgebra::Vector3;

use crate::{input, inside};

/// A solve at a configuration of about `bend_rad` with a tip error of about `error_m`.
struct Scene {
    nmpc: Nmpc,
    configuration: Configuration,
    rates: BendRates,
    reference: [ReferenceSample; 2],
}

impl Scene {
    fn new(bend_rad: f64, error_m: f64) -> Self {
        let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
        let shape = [1.0, -0.5, 0.3, 1.0, 0.2, 0.7].map(|part| part * bend_rad);
        let configuration = Configuration::from_slice(&shape).unwrap();
        let tip_m = robot.tip_position(&configuration);
        let sample = |step: f64| inside(tip_m + Vector3::new(step, -0.5 * step, -0.1) * error_m);
        Self {
            nmpc: Nmpc::new(robot, 0.005, NmpcSettings::default()).unwrap(),
            configuration,
            rates: BendRates::from_slice(&shape.map(|bend| 0.1 * bend)).unwrap(),
            reference: [sample(1.0), sample(2.0)],
        }
    }

    fn solve(&mut self, seed: u64) -> Duration {
        let input = SolveInput {
            seed,
            ..input(&self.configuration, &self.rates, &self.reference)
        };
        let begin = Instant::now();
        std::hint::black_box(self.nmpc.solve(&input, &mut Budget::unlimited()));
        begin.elapsed()
    }
}

#[test]
fn subnormal_numbers_cost_no_more_than_zeros() {
    // A straight robot is singular, with zeros as well as with numbers near zero.
    let mut straight = Scene::new(0.0, 1e-3);
    let mut subnormal = Scene::new(1e-310, 1e-3);
    assert!(subnormal.configuration.as_slice()[0].is_subnormal());
    // Interleaved, so that a stall affects both.
    let (mut of_zeros, mut of_subnormal): (Vec<_>, Vec<_>) = (0..401)
        .map(|seed| (straight.solve(seed), subnormal.solve(seed)))
        .unzip();
    of_zeros.sort();
    of_subnormal.sort();
    let (zeros, tiny) = (of_zeros[200], of_subnormal[200]);
    assert!(tiny <= 2 * zeros, "{tiny:?} against {zeros:?}");
}
