//! Bodies side by side are bit-identical to single ones.

use core::f64::consts::TAU;

use super::*;
use crate::robot::{self, COORDINATES_MAX, Configuration, RobotParameters};
use crate::wide::LANES;
use nalgebra::Vector3;
use proptest::prelude::*;
use scene::{bend_max_rad, capsule, places, robots_and_shapes, segment, sphere};

// Strategies shared with the tests of the public clearances.
#[path = "../../../tests/suite/clearance/scene.rs"]
mod scene;

/// Bends of each lane as a share of the drawn shape; includes the shape itself, straight and nearly straight.
const SHARES: [f64; LANES] = [1.0, 0.5, 0.0, -1.0, 1e-9, 0.9, 0.999, 1e-16];

fn lane_shape(shape: &Configuration, lane: usize) -> Configuration {
    let mut shape = *shape;
    for bend in shape.as_mut_slice() {
        *bend *= SHARES[lane];
    }
    shape
}

fn lane_bends(shape: &Configuration, i: usize) -> Wide<LANES> {
    Wide::from_fn(|lane| shape.as_slice()[i] * SHARES[lane])
}

/// The clearance of each section of W bodies up to `cutoff_m`.
#[inline(always)]
fn clearances_below<const W: usize>(
    robot: &Robot,
    bends: impl Fn(usize) -> Wide<W>,
    obstacle: &Obstacle,
    cutoff_m: f64,
) -> [Wide<W>; SECTIONS_MAX] {
    let body = robot.body_wide(bends);
    let mut clearances_m = [Wide::splat(cutoff_m); SECTIONS_MAX];
    for j in 0..SECTIONS_MAX {
        if let Some(beyond) = body.section_is_beyond(j, obstacle, cutoff_m) {
            clearances_m[j] = body.section_clearance_below(j, obstacle, cutoff_m, beyond);
        }
    }
    clearances_m
}

/// The same clearances as work compiled for each SIMD instruction set; lane 0 is the drawn shape.
struct ClearanceKernel<'a> {
    robot: &'a Robot,
    bends: [Wide<LANES>; COORDINATES_MAX],
    obstacle: &'a Obstacle,
    cutoff_m: f64,
}

impl<'a> ClearanceKernel<'a> {
    fn new(robot: &'a Robot, shape: &Configuration, obstacle: &'a Obstacle, cutoff_m: f64) -> Self {
        let mut bends = [Wide::splat(0.0); COORDINATES_MAX];
        for (i, bends) in bends[..robot.coordinate_count()].iter_mut().enumerate() {
            *bends = lane_bends(shape, i);
        }
        Self {
            robot,
            bends,
            obstacle,
            cutoff_m,
        }
    }

    /// Not inlined, so that it is compiled once.
    #[inline(never)]
    fn evaluate(self) -> [Wide<LANES>; SECTIONS_MAX] {
        pulp::NullaryFnOnce::call(self)
    }
}

impl pulp::NullaryFnOnce for ClearanceKernel<'_> {
    type Output = [Wide<LANES>; SECTIONS_MAX];

    #[inline(always)]
    fn call(self) -> Self::Output {
        clearances_below(self.robot, |i| self.bends[i], self.obstacle, self.cutoff_m)
    }
}

/// The clearances of one lane alone.
#[inline(never)]
fn alone_below(
    robot: &Robot,
    shape: &Configuration,
    obstacle: &Obstacle,
    cutoff_m: f64,
) -> [Wide<1>; SECTIONS_MAX] {
    clearances_below(robot, |i| Wide([shape.as_slice()[i]]), obstacle, cutoff_m)
}

fn bits(clearances_m: &[Wide<LANES>; SECTIONS_MAX]) -> [[u64; LANES]; SECTIONS_MAX] {
    clearances_m.map(|wide| wide.0.map(f64::to_bits))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn wide_bodies_equal_single_lanes_bit_for_bit_and_the_scalar_body(
        (robot, shape) in robots_and_shapes(), place in places(), cutoff_m in -0.05..0.3_f64,
    ) {
        prop_assume!(bend_max_rad(&shape) <= TAU);
        // Error of the series (rad) times the robot's reach, plus rounding of a metre. Beyond π, outside the range of a
        // robot, a nearly closed circle multiplies the error.
        let series_rad = if bend_max_rad(&shape) <= PI { 2e-15 } else { 1e-8 };
        let tolerance_m = 1e-14 + series_rad * robot.reach_m();
        let [start_m, end_m] = segment(&robot, &shape, place);
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.01), capsule(start_m, start_m, 0.0)] {
            let [all, below] = [1e3, cutoff_m].map(|cutoff_m| ClearanceKernel::new(&robot, &shape, &obstacle, cutoff_m).evaluate());
            for lane in 0..LANES {
                let shape = lane_shape(&shape, lane);
                let body = robot.body(&shape);
                let [all_alone, below_alone] = [1e3, cutoff_m].map(|cutoff_m| alone_below(&robot, &shape, &obstacle, cutoff_m));
                for j in 0..robot.section_count() {
                    let [all, below] = [all, below].map(|wide| wide[j].0[lane]);
                    prop_assert_eq!(all.to_bits(), all_alone[j].0[0].to_bits());
                    prop_assert_eq!(below.to_bits(), below_alone[j].0[0].to_bits());
                    let off_m = all - body.clearance_of(j, &obstacle);
                    prop_assert!(off_m.abs() < tolerance_m, "lane {lane}, section {j}: off by {off_m:e} m");
                    prop_assert_eq!(below, all.min(cutoff_m));
                }
            }
        }
    }

    #[test]
    fn a_non_finite_lane_changes_no_other_lane(
        (robot, shape) in robots_and_shapes(), place in places(), component in 0..COORDINATES_MAX, bad_lane in 0..LANES,
        value in prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY)],
    ) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let far_m = Vector3::repeat(1e3);
        for obstacle in [sphere(start_m, 0.02), sphere(far_m, 0.02), capsule(start_m, end_m, 0.01), capsule(far_m, -far_m, 0.0)] {
            let kernel = || ClearanceKernel::new(&robot, &shape, &obstacle, 0.05);
            let good = bits(&kernel().evaluate());
            let mut bad = kernel();
            bad.bends[component % robot.coordinate_count()].0[bad_lane] = value;
            let bad = bits(&bad.evaluate());
            for lane in (0..LANES).filter(|lane| *lane != bad_lane) {
                for j in 0..SECTIONS_MAX {
                    prop_assert_eq!(bad[j][lane], good[j][lane]);
                }
            }
        }
    }
}

#[test]
#[cfg(target_arch = "x86_64")]
fn every_processor_gives_the_same_bits() {
    for n in 1..=SECTIONS_MAX {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        let shape = Configuration::from_bend_angles(&vec![[1.1, 0.4]; n]);
        let near_m = robot.body_point(&shape, n - 1, 0.4) + Vector3::new(0.04, -0.03, 0.05);
        let [start_m, end_m] = [-Vector3::x() * 0.2, Vector3::y() * 0.1].map(|way| near_m + way);
        for obstacle in [sphere(near_m, 0.02), capsule(start_m, end_m, 0.0)] {
            let kernel = || ClearanceKernel::new(&robot, &shape, &obstacle, 0.1);
            let expected = kernel().evaluate();
            assert!(expected[n - 1].0[0] < 0.1);
            if let Some(avx2) = pulp::x86::V3::try_new() {
                assert_eq!(bits(&avx2.vectorize(kernel())), bits(&expected));
            }
            if let Some(avx512) = pulp::x86::V4::try_new() {
                assert_eq!(bits(&avx512.vectorize(kernel())), bits(&expected));
            }
        }
    }
}
