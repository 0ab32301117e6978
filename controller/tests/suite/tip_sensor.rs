//! Control with a tip sensor only: three sections follow the paper's spiral (Eq. 8), and noisy tip positions
//! are the only measurements.

use cdcr_controller::estimator::{Estimator, Measurement};
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::robot::{BendRates, Configuration, Robot, RobotParameters};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::safety::command;

use crate::{input, inside, number};

const PERIOD_S: f64 = 0.005;

/// Tracking and estimation errors of a run, without its first half second \[mm\].
struct Errors {
    mean_mm: f64,
    max_mm: f64,
}

/// Bends on the spiral at its angle `t` (rad), for the last of `sections`, scaled by `share`.
fn bent(sections: usize, share: f64, t: f64) -> Configuration {
    let mut bends = vec![[0.0; 2]; sections];
    bends[sections - 1] = [share * 2.0 * t / 15.0, t];
    Configuration::from_bend_angles(&bends)
}

/// The initial estimate differs by `beside_rad` in each bend. `noise_m` is the standard deviation of each
/// measured coordinate. The spiral has this `share` of the paper's bends.
fn follow_the_spiral(
    (sections, share): (usize, f64),
    noise_m: f64,
    beside_rad: f64,
    seed: u64,
) -> Errors {
    let robot = Robot::new(&RobotParameters::paper(sections)).unwrap();
    let bent = |t| bent(sections, share, t);
    let settings = NmpcSettings::default();
    let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings).unwrap();
    let begin_s = 5_f64.to_radians();
    let goal = |cycle: u64| robot.tip_position(&bent(begin_s + cycle as f64 * PERIOD_S));
    let mut truth = bent(begin_s);
    let mut assumed = truth;
    for (i, bend) in assumed.as_mut_slice().iter_mut().enumerate() {
        *bend += if i % 2 == 0 { beside_rad } else { -beside_rad };
    }
    let mut estimator = Estimator::new(assumed);
    let mut rates = BendRates::zero(sections);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut errors_mm = Vec::new();
    for cycle in 0..994 {
        // Uniform noise of the same standard deviation.
        let width_m = noise_m * 3_f64.sqrt();
        let noise = Vector3::from_fn(|_, _| random.random_range(-width_m..=width_m));
        let measured = Measurement::TipPosition(robot.tip_position(&truth) + noise);
        let estimate = *estimator.correct(&robot, &measured, 0.0);
        let reference: Vec<_> = (1..=u64::from(settings.horizon_steps))
            .map(|step| inside(goal(cycle + step)))
            .collect();
        let input = SolveInput {
            seed: cycle_seed(settings.seed, cycle),
            ..input(&estimate, &rates, &reference)
        };
        let (desired_rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
        rates = command(&robot, &estimate, &rates, &[], &desired_rates);
        truth = truth.advanced(&rates, PERIOD_S);
        estimator.predict(&rates, PERIOD_S);
        let farthest_rad = truth.as_slice().iter().fold(0.0_f64, |a, b| a.max(b.abs()));
        assert!(
            farthest_rad < 1.5,
            "seed {seed}, cycle {cycle}: {farthest_rad} rad"
        );
        if cycle >= 100 {
            errors_mm.push(1e3 * (robot.tip_position(&truth) - goal(cycle + 1)).norm());
        }
    }
    Errors {
        mean_mm: errors_mm.iter().sum::<f64>() / errors_mm.len() as f64,
        max_mm: errors_mm.iter().copied().fold(0.0, f64::max),
    }
}

/// With one to three sections, begun beside the true shape, and near the straight robot, where the tip
/// determines the bends least. A filter that trusted each position fully diverged by 412 mm here, beyond the
/// bend limit. `CDCR_TIP_RUNS`: runs of each.
#[test]
fn a_noisy_tip_sensor_alone_keeps_the_robot_on_the_spiral() {
    let runs = number("CDCR_TIP_RUNS", crate::repetitions(1, 3).into());
    for (sections, share, noise_mm, beside_rad, mean_max_mm) in [
        (1, 1.0, 0.1, 0.0, 0.1),
        (1, 1.0, 0.5, 0.0, 0.25),
        (1, 0.05, 0.5, 0.0, 0.25),
        (2, 1.0, 0.1, 0.0, 0.1),
        (2, 1.0, 0.5, 0.0, 0.25),
        (2, 0.05, 0.5, 0.0, 0.25),
        (3, 1.0, 0.1, 0.0, 0.1),
        (3, 1.0, 0.1, 0.05, 0.15),
        (3, 1.0, 0.5, 0.0, 0.25),
        (3, 0.05, 0.5, 0.0, 0.25),
    ] {
        let follow = |seed| follow_the_spiral((sections, share), 1e-3 * noise_mm, beside_rad, seed);
        let errors: Vec<_> = (1..=runs).map(follow).collect();
        let mean_mm = errors.iter().map(|run| run.mean_mm).sum::<f64>() / runs as f64;
        let max_mm = errors.iter().map(|run| run.max_mm).fold(0.0, f64::max);
        let name = format!(
            "{sections} sections, {share} of the bends, noise {noise_mm} mm, begun {beside_rad} rad beside"
        );
        println!("{name}: mean {mean_mm:.3}, max {max_mm:.3} mm");
        let is_quiet = (noise_mm, beside_rad) == (0.1, 0.0);
        let max_max_mm = if is_quiet { 0.5 } else { 1.0 };
        assert!(
            mean_mm < mean_max_mm && max_mm < max_max_mm,
            "{name}: {mean_mm}, {max_mm} mm"
        );
    }
}
