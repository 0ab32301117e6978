//! Bodies side by side, to the bit those of one lane.

use core::f64::consts::{PI, TAU};

use cdcr_controller::robot::{
    BodyWide, COORDINATES_MAX, Configuration, Obstacle, Robot, RobotParameters, SECTIONS_MAX,
};
use cdcr_controller::wide::{LANES, Wide};
use nalgebra::Vector3;
use proptest::prelude::*;

use crate::clearance::scene::{bend_max_rad, capsule, places, robots_and_shapes, segment, sphere};

/// Bends of lane `lane` as a share of the shape that was drawn: among them the shape itself, straight and nearly straight.
const SHARES: [f64; LANES] = [1.0, 0.5, 0.0, -1.0, 1e-9, 0.9, 0.999, 1e-16];

fn lane_shape(shape: &Configuration, lane: usize) -> Configuration {
    let bends: Vec<f64> = shape
        .as_slice()
        .iter()
        .map(|bend| bend * SHARES[lane])
        .collect();
    Configuration::from_slice(&bends).unwrap()
}

fn lane_bends(shape: &Configuration, i: usize) -> Wide<LANES> {
    Wide::from_fn(|lane| shape.as_slice()[i] * SHARES[lane])
}

fn lane_body(robot: &Robot, shape: &Configuration) -> BodyWide<LANES> {
    robot.body_wide(|i| lane_bends(shape, i))
}

fn bits<const W: usize>(wide: Wide<W>) -> [u64; W] {
    wide.0.map(f64::to_bits)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(crate::repetitions(100, 400)))]

    #[test]
    fn bodies_side_by_side_are_those_of_one_lane_to_the_bit_and_of_the_scalar_body(
        (robot, shape) in robots_and_shapes(), place in places(), enough_m in -0.05..0.3_f64,
    ) {
        prop_assume!(bend_max_rad(&shape) <= TAU);
        // What the series may be off (rad), over the robot's reach; and a metre's rounding. Beyond π, which no robot bends, a
        // nearly closed circle multiplies it.
        let series_rad = if bend_max_rad(&shape) <= PI { 2e-15 } else { 1e-8 };
        let tolerance_m = 1e-14 + series_rad * robot.reach_m();
        let [start_m, end_m] = segment(&robot, &shape, place);
        let body = lane_body(&robot, &shape);
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.01), capsule(start_m, start_m, 0.0)] {
            let (all, below) = (body.clearance_below(&obstacle, 1e3, 0xff), body.clearance_below(&obstacle, enough_m, 0xff));
            for lane in 0..LANES {
                let shape = lane_shape(&shape, lane);
                let narrow = robot.body_wide(|i| Wide([shape.as_slice()[i]]));
                let expected_m = robot.clearance_m(&shape, &obstacle);
                let [all, below] = [(all, 1e3), (below, enough_m)].map(|(wide, enough_m)| {
                    let alone = narrow.clearance_below(&obstacle, enough_m, 0xff);
                    assert_eq!(wide.0[lane].to_bits(), alone.0[0].to_bits());
                    wide.0[lane]
                });
                prop_assert!((all - expected_m).abs() < tolerance_m, "lane {lane}: off by {:e} m", all - expected_m);
                prop_assert_eq!(below, all.min(enough_m));
            }
        }
    }

    #[test]
    fn only_the_chosen_sections_count((robot, shape) in robots_and_shapes(), place in places(), enough_m in 0.0..0.3_f64) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let body = lane_body(&robot, &shape);
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.01)] {
            let alone = |j: usize| body.clearance_below(&obstacle, enough_m, 1 << j);
            for sections in 0..1_u8 << robot.section_count() {
                let expected = (0..robot.section_count())
                    .filter(|j| sections & (1 << j) != 0)
                    .fold(Wide::splat(enough_m), |least_m, j| least_m.min(alone(j)));
                prop_assert_eq!(bits(body.clearance_below(&obstacle, enough_m, sections)), bits(expected));
            }
        }
    }

    #[test]
    fn a_nan_in_one_lane_is_nan_there_and_nothing_elsewhere(
        (robot, shape) in robots_and_shapes(), place in places(), component in 0..COORDINATES_MAX, bad_lane in 0..LANES,
        value in prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY)], sections in any::<u8>(),
    ) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let component = component % robot.coordinate_count();
        let body = lane_body(&robot, &shape);
        let bad = robot.body_wide(|i| {
            let mut bends = lane_bends(&shape, i);
            if i == component {
                bends.0[bad_lane] = value;
            }
            bends
        });
        let far_m = Vector3::repeat(1e3);
        for obstacle in [sphere(start_m, 0.02), sphere(far_m, 0.02), capsule(start_m, end_m, 0.01), capsule(far_m, -far_m, 0.0)] {
            let (good, bad) = [&body, &bad].map(|body| body.clearance_below(&obstacle, 0.05, sections)).into();
            for lane in 0..LANES {
                if lane == bad_lane {
                    prop_assert!(bad.0[lane].is_nan());
                } else {
                    prop_assert_eq!(bad.0[lane].to_bits(), good.0[lane].to_bits());
                }
            }
        }
    }
}

/// The whole question about one robot, for a processor's instructions.
#[cfg(target_arch = "x86_64")]
struct Question<'a>(&'a Robot, &'a Configuration, &'a Obstacle);

#[cfg(target_arch = "x86_64")]
impl pulp::NullaryFnOnce for Question<'_> {
    type Output = Wide<LANES>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self(robot, shape, obstacle) = self;
        lane_body(robot, shape).clearance_below(obstacle, 0.1, 0xff)
    }
}

#[test]
#[cfg(target_arch = "x86_64")]
fn every_processor_gives_the_same_bits() {
    for n in 1..=SECTIONS_MAX {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        let shape = Configuration::from_bend_angles(&vec![[1.1, 0.4]; n]);
        let near_m = robot.body_point(&shape, n - 1, 0.4) + Vector3::new(0.04, -0.03, 0.05);
        for obstacle in [
            sphere(near_m, 0.02),
            capsule(
                near_m - Vector3::x() * 0.2,
                near_m + Vector3::y() * 0.1,
                0.0,
            ),
        ] {
            let question = || Question(&robot, &shape, &obstacle);
            let expected = pulp::NullaryFnOnce::call(question());
            assert!(expected.0[0] < 0.1);
            if let Some(avx2) = pulp::x86::V3::try_new() {
                assert_eq!(bits(avx2.vectorize(question())), bits(expected));
            }
            if let Some(avx512) = pulp::x86::V4::try_new() {
                assert_eq!(bits(avx512.vectorize(question())), bits(expected));
            }
        }
    }
}
