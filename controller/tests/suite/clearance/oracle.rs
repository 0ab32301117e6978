//! The oracle, a sampled curve, and the comparison with it.

use cdcr_controller::robot::{Configuration, Nearest, Obstacle, Robot, Shape};
use nalgebra::Vector3;

/// Tolerance against the oracle (m). The oracle's refinement is accurate to about 1e-12 m; the guarantee is
/// 1e-9 m.
pub(crate) const TOLERANCE_M: f64 = 1e-11;

/// Distance from a point to the axis of an obstacle (m): closed form.
pub(crate) fn axis_distance_m(shape: &Shape, point_m: Vector3<f64>) -> f64 {
    match *shape {
        Shape::Sphere { centre_m } => (point_m - centre_m).norm(),
        Shape::Capsule { start_m, end_m } => {
            let span = end_m - start_m;
            let square = span.norm_squared();
            let t = if square > 0.0 {
                ((point_m - start_m).dot(&span) / square).clamp(0.0, 1.0)
            } else {
                0.0
            };
            (point_m - start_m - span * t).norm()
        }
    }
}

/// Minimum of `f` near the middle of [low, high], by golden section search.
fn refined(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    const SHARE: f64 = 0.618_033_988_749_894_9;
    let (mut a, mut b) = (high - SHARE * (high - low), low + SHARE * (high - low));
    let (mut f_a, mut f_b) = (f(a), f(b));
    for _ in 0..60 {
        if f_a < f_b {
            (high, b, f_b) = (b, a, f_a);
            a = high - SHARE * (high - low);
            f_a = f(a);
        } else {
            (low, a, f_a) = (a, b, f_b);
            b = low + SHARE * (high - low);
            f_b = f(b);
        }
    }
    f_a.min(f_b)
}

/// Clearance from 600 samples of each section, with every local minimum refined.
fn sampled_clearance_m(robot: &Robot, shape: &Configuration, obstacle: &Obstacle) -> f64 {
    const SAMPLES: u32 = 600;
    let mut best = f64::INFINITY;
    for (j, section) in robot.sections().iter().enumerate() {
        let at = |s: f64| axis_distance_m(obstacle.shape(), robot.body_point(shape, j, s));
        let share = |i: u32| f64::from(i) / f64::from(SAMPLES);
        let samples: Vec<f64> = (0..=SAMPLES).map(|i| at(share(i))).collect();
        let least = samples.iter().copied().fold(f64::INFINITY, f64::min);
        let spacing_m = section.length_m / f64::from(SAMPLES);
        let mut distance_m = least;
        for i in 1..SAMPLES {
            let here = samples[i as usize];
            let is_low = here <= samples[i as usize - 1] && here <= samples[i as usize + 1];
            if is_low && here < least + spacing_m {
                distance_m = distance_m.min(refined(at, share(i - 1), share(i + 1)));
            }
        }
        // A minimum between an end and the next sample.
        distance_m = distance_m.min(refined(at, 0.0, share(1)));
        distance_m = distance_m.min(refined(at, share(SAMPLES - 1), 1.0));
        best = best.min(distance_m - section.body_radius_m);
    }
    best - obstacle.radius_m()
}

/// Checks the consistency of a [`Nearest`].
pub(crate) fn check_consistent(
    robot: &Robot,
    shape: &Configuration,
    obstacle: &Obstacle,
    nearest: &Nearest,
) {
    assert!(nearest.section < robot.section_count() && (0.0..=1.0).contains(&nearest.s));
    let point_m = robot.body_point(shape, nearest.section, nearest.s);
    let off_m = (point_m - nearest.point_m).norm();
    assert!(off_m < TOLERANCE_M, "point_m is {off_m:e} m from s");
    let distance_m = axis_distance_m(obstacle.shape(), nearest.point_m);
    let body_radius_m = robot.sections()[nearest.section].body_radius_m;
    let clearance_m = distance_m - body_radius_m - obstacle.radius_m();
    assert!((clearance_m - nearest.clearance_m).abs() < TOLERANCE_M);
    assert!((nearest.direction.norm() - 1.0).abs() < 1e-14);
    assert_eq!(nearest.clearance_m, robot.clearance_m(shape, obstacle));
    for step_m in [1e-3, 1e-5] {
        let moved = nearest.point_m + nearest.direction * step_m;
        let gain_m = axis_distance_m(obstacle.shape(), moved) - distance_m;
        // Exactly the step, except for the curvature within the rounding of the nearest point.
        assert!(
            (gain_m - step_m).abs() < 1e-3 * step_m,
            "{gain_m:e} of {step_m:e} m"
        );
    }
}

pub(crate) fn check_against_oracle(robot: &Robot, shape: &Configuration, obstacle: &Obstacle) {
    let nearest = robot.nearest(shape, obstacle);
    let expected_m = sampled_clearance_m(robot, shape, obstacle);
    let error_m = nearest.clearance_m - expected_m;
    assert!(
        error_m.abs() < TOLERANCE_M,
        "off by {error_m:e} m of {expected_m}"
    );
    check_consistent(robot, shape, obstacle, &nearest);
}
