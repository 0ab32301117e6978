//! Clearance against an independent oracle (the curve sampled by forward kinematics, each sample's distance to the obstacle
//! in closed form, then refined), against geometry that is known, and its derivatives against differences.

#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use core::f64::consts::{FRAC_PI_2, PI, TAU};

use cdcr_controller::robot::{
    BodyWide, COORDINATES_MAX, Configuration, Nearest, Obstacle, Robot, RobotParameters,
    SECTIONS_MAX, Shape, ranges,
};
use cdcr_controller::wide::{LANES, Wide};
use nalgebra::Vector3;
use proptest::prelude::*;

/// What the answer may differ from the oracle (m): the oracle's own refinement is good to about 1e-12 m, and 1e-9 m is the
/// promise to keep.
const TOLERANCE_M: f64 = 1e-11;

// The oracle.

/// Distance from a point to the axis of an obstacle (m): closed form.
fn axis_distance_m(shape: &Shape, point_m: Vector3<f64>) -> f64 {
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

/// Least value of `f` near the middle of [low, high], by golden section.
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

/// Clearance by 600 samples of each section, of which every local minimum is refined.
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
        // A minimum between an end and its neighbour.
        distance_m = distance_m.min(refined(at, 0.0, share(1)));
        distance_m = distance_m.min(refined(at, share(SAMPLES - 1), 1.0));
        best = best.min(distance_m - section.body_radius_m);
    }
    best - obstacle.radius_m()
}

// What is drawn.

fn still(shape: Shape, radius_m: f64) -> Obstacle {
    Obstacle::new(shape, radius_m, Vector3::zeros()).unwrap()
}

fn sphere(centre_m: Vector3<f64>, radius_m: f64) -> Obstacle {
    still(Shape::Sphere { centre_m }, radius_m)
}

fn capsule(start_m: Vector3<f64>, end_m: Vector3<f64>, radius_m: f64) -> Obstacle {
    still(Shape::Capsule { start_m, end_m }, radius_m)
}

/// Robots of 1 to 6 different sections: bent, strongly bent, half a circle and more, nearly straight, straight.
fn robots_and_shapes() -> impl Strategy<Value = (Robot, Configuration)> {
    let bend_rad = prop_oneof![
        6 => 0.0..2.8_f64,
        2 => 2.8..PI,
        1 => Just(PI),
        1 => -12.0..-2.0_f64, // the exponent of ten
        1 => Just(0.0),
        // Beyond what a robot can do.
        1 => PI..8.0,
    ];
    let bend_rad = bend_rad.prop_map(|x: f64| if x < 0.0 { 10_f64.powf(x) } else { x });
    let section = (0.05..0.5_f64, bend_rad, -3.2..3.2_f64, 0.0..0.03_f64);
    prop::collection::vec(section, 1..=SECTIONS_MAX).prop_map(|sections| {
        let mut parameters = RobotParameters::paper(sections.len());
        for (target, (length_m, _, _, body_radius_m)) in
            parameters.sections.iter_mut().zip(&sections)
        {
            target.length_m = *length_m;
            target.body_radius_m = *body_radius_m;
        }
        let angles: Vec<[f64; 2]> = sections
            .iter()
            .map(|section| [section.1, section.2])
            .collect();
        (
            Robot::new(&parameters).unwrap(),
            Configuration::from_bend_angles(&angles),
        )
    })
}

fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
    prop::array::uniform3(-size..size).prop_map(Vector3::from)
}

/// How an obstacle is placed relative to the robot it is for, so that special positions are met.
#[derive(Debug, Clone, Copy)]
enum Place {
    /// Anywhere around.
    Around(Vector3<f64>, Vector3<f64>),
    /// From near one point of the body towards any place.
    AtBody(usize, f64, Vector3<f64>, Vector3<f64>),
    /// Through two points of the body.
    Through([usize; 2], [f64; 2]),
    /// Near the centre of a section's circle, along directions given in that section's axes; flat means in its plane.
    AtCentre(usize, Vector3<f64>, Vector3<f64>, bool),
    /// Along the start of a section.
    Along(usize, Vector3<f64>),
}

fn places() -> impl Strategy<Value = Place> {
    let section = 0..SECTIONS_MAX;
    let share = 0.0..1.0_f64;
    let offset = prop_oneof![vector(0.1), vector(1e-4), Just(Vector3::zeros())];
    prop_oneof![
        (vector(1.0), vector(1.0)).prop_map(|(a, b)| Place::Around(a, b)),
        (section.clone(), share.clone(), offset.clone(), vector(0.6))
            .prop_map(|(j, s, a, b)| Place::AtBody(j, s, a, b)),
        ([section.clone(), section.clone()], [share.clone(), share])
            .prop_map(|(j, s)| Place::Through(j, s)),
        (section.clone(), offset.clone(), vector(0.3), any::<bool>())
            .prop_map(|(j, a, b, flat)| Place::AtCentre(j, a, b, flat)),
        (section, offset).prop_map(|(j, a)| Place::Along(j, a)),
    ]
}

/// The segment that a place means; its start is where a sphere goes.
fn segment(robot: &Robot, shape: &Configuration, place: Place) -> [Vector3<f64>; 2] {
    let n = robot.section_count();
    let frames = robot.section_frames(shape);
    match place {
        Place::Around(a, b) => [a, b],
        Place::AtBody(j, s, offset, b) => [robot.body_point(shape, j % n, s) + offset, b],
        Place::Through(j, s) => [0, 1].map(|i| robot.body_point(shape, j[i] % n, s[i])),
        Place::AtCentre(j, offset, direction, flat) => {
            let j = j % n;
            let (sin, cos) = shape.direction_rad(j).sin_cos();
            let radius_m = robot.sections()[j].length_m / shape.bend_rad(j).max(0.2);
            let across = Vector3::new(cos, sin, 0.0);
            let mut direction = across * direction.x
                + Vector3::new(-sin, cos, 0.0) * direction.y
                + Vector3::z() * direction.z;
            if flat {
                direction -=
                    Vector3::new(-sin, cos, 0.0) * direction.dot(&Vector3::new(-sin, cos, 0.0));
            }
            let centre_m = frames[j].position_m + frames[j].rotation * (across * radius_m) + offset;
            let direction = frames[j].rotation * direction;
            [centre_m - direction * 0.7, centre_m + direction]
        }
        Place::Along(j, offset) => {
            let (frame, length_m) = (frames[j % n], robot.sections()[j % n].length_m);
            let along = frame.rotation.column(2).into_owned();
            let start_m = frame.position_m + offset - along * (0.3 * length_m);
            [start_m, start_m + along * (1.1 * length_m)]
        }
    }
}

/// All that a [`Nearest`] claims about itself.
fn check_consistent(robot: &Robot, shape: &Configuration, obstacle: &Obstacle, nearest: &Nearest) {
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
        // Exactly the step, but for the curvature that rounding of the nearest point lets in.
        assert!(
            (gain_m - step_m).abs() < 1e-3 * step_m,
            "{gain_m:e} of {step_m:e} m"
        );
    }
}

fn check_against_oracle(robot: &Robot, shape: &Configuration, obstacle: &Obstacle) {
    let nearest = robot.nearest(shape, obstacle);
    let expected_m = sampled_clearance_m(robot, shape, obstacle);
    let error_m = nearest.clearance_m - expected_m;
    assert!(
        error_m.abs() < TOLERANCE_M,
        "off by {error_m:e} m of {expected_m}"
    );
    check_consistent(robot, shape, obstacle, &nearest);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn spheres_agree_with_the_sampled_curve(
        (robot, shape) in robots_and_shapes(), place in places(), radius_m in 0.0..0.1_f64,
    ) {
        let [centre_m, _] = segment(&robot, &shape, place);
        check_against_oracle(&robot, &shape, &sphere(centre_m, radius_m));
    }

    #[test]
    fn capsules_agree_with_the_sampled_curve(
        (robot, shape) in robots_and_shapes(), place in places(), radius_m in 0.0..0.1_f64,
    ) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        check_against_oracle(&robot, &shape, &capsule(start_m, end_m, radius_m));
        check_against_oracle(&robot, &shape, &capsule(end_m, start_m, radius_m));
    }

    #[test]
    fn both_curves_sampled_are_never_nearer((robot, shape) in robots_and_shapes(), place in places()) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let clearance_m = robot.clearance_m(&shape, &capsule(start_m, end_m, 0.0));
        for (j, section) in robot.sections().iter().enumerate() {
            for i in 0..=40 {
                let body_m = robot.body_point(&shape, j, f64::from(i) / 40.0);
                for k in 0..=40 {
                    let axis_m = start_m + (end_m - start_m) * (f64::from(k) / 40.0);
                    let sampled_m = (body_m - axis_m).norm() - section.body_radius_m;
                    prop_assert!(clearance_m <= sampled_m + 1e-13);
                }
            }
        }
    }

    #[test]
    fn a_capsule_without_length_is_a_sphere(
        (robot, shape) in robots_and_shapes(), place in places(), radius_m in 0.0..0.1_f64,
    ) {
        let [centre_m, _] = segment(&robot, &shape, place);
        let ball = robot.nearest(&shape, &sphere(centre_m, radius_m));
        prop_assert_eq!(ball, robot.nearest(&shape, &capsule(centre_m, centre_m, radius_m)));
    }

    #[test]
    fn a_sphere_along_a_capsule_is_never_nearer((robot, shape) in robots_and_shapes(), place in places(), t in 0.0..1.0_f64) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let whole_m = robot.clearance_m(&shape, &capsule(start_m, end_m, 0.01));
        let part_m = robot.clearance_m(&shape, &sphere(start_m + (end_m - start_m) * t, 0.01));
        prop_assert!(whole_m <= part_m + 1e-13);
    }

    #[test]
    fn frames_computed_before_give_the_same((robot, shape) in robots_and_shapes(), place in places()) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let body = robot.body_from_frames(shape.as_slice(), &robot.section_frames(&shape));
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.02)] {
            prop_assert_eq!(body.nearest(&obstacle), robot.nearest(&shape, &obstacle));
            prop_assert_eq!(body.clearance_m(&obstacle), robot.clearance_m(&shape, &obstacle));
        }
    }

    #[test]
    fn what_is_out_of_reach_is_further_than_the_travel(
        (robot, shape) in robots_and_shapes(), place in places(), travel_m in -0.1..1.0_f64,
    ) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.02)] {
            let clearance_m = robot.clearance_m(&shape, &obstacle);
            if !robot.reaches(&shape, &obstacle, travel_m) {
                prop_assert!(clearance_m > travel_m);
            }
            // Within the diameter of the largest ball the bound has to let go.
            let largest_m = robot.sections().iter().map(|section| section.length_m).fold(0.0, f64::max);
            prop_assert!(robot.reaches(&shape, &obstacle, clearance_m));
            prop_assert!(!robot.reaches(&shape, &obstacle, clearance_m - largest_m - 1e-9));
        }
    }

    #[test]
    fn the_jacobian_of_a_body_point_is_its_derivative(
        (robot, shape) in robots_and_shapes(), section in 0..SECTIONS_MAX + 1, s in -0.1..1.1_f64,
    ) {
        const STEP_RAD: f64 = 1e-3;
        let mut jacobian = [[f64::NAN; 3]; COORDINATES_MAX];
        let point_m = robot.body_point_jacobian(shape.as_slice(), section, s, &mut jacobian);
        prop_assert!((point_m - robot.body_point(&shape, section, s)).norm() < 1e-15);
        for (i, column) in jacobian.iter().enumerate() {
            let at = |steps: f64| {
                let mut moved = shape;
                if let Some(component) = moved.as_mut_slice().get_mut(i) {
                    *component += steps * STEP_RAD;
                }
                robot.body_point(&moved, section, s)
            };
            // Fourth order: truncation near 1e-13, rounding near 1e-12.
            let expected = ((at(1.0) - at(-1.0)) * 8.0 - (at(2.0) - at(-2.0))) / (12.0 * STEP_RAD);
            let error = (Vector3::from(*column) - expected).norm();
            prop_assert!(error < 1e-11, "column {i}: off by {error:e}");
            if i / 2 > section || i >= robot.coordinate_count() {
                prop_assert_eq!(*column, [0.0; 3]);
            }
        }
    }

    #[test]
    fn the_gradient_of_clearance_is_direction_times_jacobian(
        (robot, shape) in robots_and_shapes(), place in places(), is_capsule in any::<bool>(),
    ) {
        const STEP_RAD: f64 = 1e-6;
        let [start_m, end_m] = segment(&robot, &shape, place);
        let obstacle = if is_capsule { capsule(start_m, end_m, 0.01) } else { sphere(start_m, 0.01) };
        let nearest = robot.nearest(&shape, &obstacle);
        // Distance has a kink at zero.
        if axis_distance_m(obstacle.shape(), nearest.point_m) < 1e-2 {
            return Ok(());
        }
        let mut jacobian = [[0.0; 3]; COORDINATES_MAX];
        robot.body_point_jacobian(shape.as_slice(), nearest.section, nearest.s, &mut jacobian);
        for i in 0..robot.coordinate_count() {
            let at = |steps: f64| {
                let mut moved = shape;
                moved.as_mut_slice()[i] += steps * STEP_RAD;
                robot.nearest(&moved, &obstacle)
            };
            let (ahead, behind) = (at(1.0), at(-1.0));
            // Where the nearest place jumps there is a kink too.
            let stays = |other: &Nearest| (other.point_m - nearest.point_m).norm() < 1e-3;
            if !(stays(&ahead) && stays(&behind)) {
                continue;
            }
            let expected = (ahead.clearance_m - behind.clearance_m) / (2.0 * STEP_RAD);
            let column = Vector3::from(jacobian[i]);
            let found = column.dot(&nearest.direction);
            // The difference is a mean of gradients between the two: it may differ as much as they do.
            let spread = [ahead, behind].map(|other| {
                let turn = (other.direction - nearest.direction).norm();
                turn * column.norm() + 2.0 * (other.point_m - nearest.point_m).norm()
            });
            let tolerance = 1e-6 * robot.reach_m() + spread[0].max(spread[1]);
            prop_assert!((found - expected).abs() < tolerance, "{i}: {found} for {expected}");
        }
    }

    #[test]
    fn clearance_is_continuous_in_the_bends_and_in_the_obstacle(
        (robot, shape) in robots_and_shapes(), place in places(),
        bends in prop::array::uniform12(-1.0..1.0_f64), by in vector(1.0), exponent in -14.0..-3.0_f64,
    ) {
        let [start_m, end_m] = segment(&robot, &shape, place);
        let size = 10_f64.powf(exponent);
        let mut moved = shape;
        for (component, bend) in moved.as_mut_slice().iter_mut().zip(bends) {
            *component += size * bend;
        }
        // No body point moves faster than the reach, per radian; each section moves by at most √2 size.
        let travel_m = size * (by.norm() + 1.5 * robot.reach_m() * robot.section_count() as f64) + 1e-14;
        for (before, after) in [
            (sphere(start_m, 0.01), sphere(start_m + by * size, 0.01)),
            (capsule(start_m, end_m, 0.01), capsule(start_m + by * size, end_m + by * size, 0.01)),
        ] {
            let change_m = robot.clearance_m(&moved, &after) - robot.clearance_m(&shape, &before);
            prop_assert!(change_m.abs() <= travel_m, "{change_m:e} for {travel_m:e} m");
        }
    }

    #[test]
    fn a_straight_robot_is_a_segment(n in 1..=SECTIONS_MAX, centre_m in vector(1.5), end_m in vector(1.5)) {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        let shape = Configuration::straight(n);
        let tip_m = Vector3::z() * robot.reach_m();
        let backbone = Shape::Capsule { start_m: Vector3::zeros(), end_m: tip_m };
        let found_m = robot.clearance_m(&shape, &sphere(centre_m, 0.02));
        prop_assert!((found_m - (axis_distance_m(&backbone, centre_m) - 0.035)).abs() < 1e-15);
        // Two segments: the common perpendicular if it meets both, else an end of one.
        let obstacle = Shape::Capsule { start_m: centre_m, end_m };
        let span = end_m - centre_m;
        let normal = span.cross(&Vector3::z());
        let t = -centre_m.xy().dot(&span.xy()) / span.xy().norm_squared();
        let z = centre_m.z + t * span.z;
        let ends = [
            axis_distance_m(&obstacle, Vector3::zeros()), axis_distance_m(&obstacle, tip_m),
            axis_distance_m(&backbone, centre_m), axis_distance_m(&backbone, end_m),
        ];
        let mut expected_m = ends.into_iter().fold(f64::INFINITY, f64::min);
        if (0.0..=1.0).contains(&t) && (0.0..=tip_m.z).contains(&z) {
            expected_m = expected_m.min(centre_m.dot(&normal).abs() / normal.norm());
        }
        let found_m = robot.clearance_m(&shape, &capsule(centre_m, end_m, 0.02));
        prop_assert!((found_m - (expected_m - 0.035)).abs() < 1e-13);
    }
}

// Side by side.

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

/// The largest bend of any section (rad).
fn bend_max_rad(shape: &Configuration) -> f64 {
    (0..shape.section_count())
        .map(|j| shape.bend_rad(j))
        .fold(0.0, f64::max)
}

/// The clearance of one section alone (m), up to `enough_m`.
fn section_below(
    robot: &Robot,
    shape: &Configuration,
    obstacle: &Obstacle,
    enough_m: f64,
    section: usize,
) -> f64 {
    let body = robot.body_wide(|i| Wide([shape.as_slice()[i]]));
    body.clearance_below(obstacle, enough_m, 1 << section).0[0]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

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

    #[test]
    fn no_point_moves_further_than_the_travel_and_no_section_out_of_reach_comes_near(
        (robot, shape) in robots_and_shapes(), place in places(), safe_m in 0.0..0.1_f64,
        changes in prop::array::uniform6((0.0..1.0_f64, -PI..PI, prop::bool::weighted(0.3))),
    ) {
        let mut moved = shape;
        for (j, (size, phi, is_along)) in changes.iter().enumerate().take(robot.section_count()) {
            // Along the bend an arc's end moves fastest.
            let phi = if *is_along { shape.direction_rad(j) } else { *phi };
            moved.as_mut_slice()[2 * j] += size * phi.cos();
            moved.as_mut_slice()[2 * j + 1] += size * phi.sin();
        }
        let travel_m = robot.travel_m(&changes.map(|(size, _, _)| size));
        let reach_m = travel_m.map(|travel_m| travel_m + safe_m);
        let [start_m, end_m] = segment(&robot, &shape, place);
        let obstacles = [sphere(start_m, 0.02), capsule(start_m, end_m, 0.01)];
        let sections = obstacles.map(|obstacle| robot.body(shape.as_slice()).sections_in_reach(&obstacle, &reach_m));
        for (j, parameters) in robot.sections().iter().enumerate() {
            for i in 0..=20 {
                let [before_m, after_m] = [shape, moved].map(|shape| robot.body_point(&shape, j, f64::from(i) / 20.0));
                let moved_m = (after_m - before_m).norm();
                prop_assert!(moved_m <= travel_m[j] + 1e-14, "section {j}: {moved_m} of {} m", travel_m[j]);
                for (obstacle, sections) in obstacles.iter().zip(sections) {
                    let radii_m = parameters.body_radius_m + obstacle.radius_m();
                    let clearance_m = axis_distance_m(obstacle.shape(), after_m) - radii_m;
                    prop_assert!(sections & (1 << j) != 0 || clearance_m > safe_m);
                }
            }
        }
        prop_assert_eq!(travel_m[robot.section_count()..].iter().sum::<f64>(), 0.0);
    }

    #[test]
    fn a_section_is_in_reach_just_where_its_clearance_is_below_the_travel(
        (robot, shape) in robots_and_shapes(), place in places(), travel_m in prop::array::uniform6(0.0..0.5_f64),
    ) {
        prop_assume!(bend_max_rad(&shape) <= PI);
        let [start_m, end_m] = segment(&robot, &shape, place);
        for obstacle in [sphere(start_m, 0.02), capsule(start_m, end_m, 0.01)] {
            let sections = robot.body(shape.as_slice()).sections_in_reach(&obstacle, &travel_m);
            for j in 0..robot.section_count() {
                let clearance_m = section_below(&robot, &shape, &obstacle, 1e3, j);
                let is_in_reach = sections & (1 << j) != 0;
                let beyond_m = clearance_m - travel_m[j];
                prop_assert!((is_in_reach && beyond_m < 1e-11) || (!is_in_reach && beyond_m > 0.0));
            }
            prop_assert_eq!(sections >> robot.section_count(), 0);
        }
    }
}

#[test]
fn what_is_unknown_or_moves_without_bound_is_in_reach() {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let far = sphere(Vector3::repeat(1e3), 0.0);
    let straight = [0.0; 6];
    let body = robot.body(&straight);
    assert_eq!(body.sections_in_reach(&far, &[1.0; SECTIONS_MAX]), 0);
    let travel_m = robot.travel_m(&[0.0, f64::INFINITY, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(body.sections_in_reach(&far, &travel_m), 0b110);
    let travel_m = robot.travel_m(&[f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0]);
    assert_eq!(body.sections_in_reach(&far, &travel_m), 0b111);
    let unknown = [0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0];
    let body = robot.body(&unknown);
    assert_eq!(body.sections_in_reach(&far, &[1.0; SECTIONS_MAX]), 0b110);
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

// Known cases.

/// One section of 0.3 m without thickness.
fn line_robot() -> Robot {
    let mut parameters = RobotParameters::paper(1);
    parameters.sections[0].body_radius_m = 0.0;
    Robot::new(&parameters).unwrap()
}

fn bent(theta: f64, phi: f64) -> Configuration {
    Configuration::from_bend_angles(&[[theta, phi]])
}

#[test]
fn the_papers_circle_has_the_routes_of_the_model() {
    let robot = line_robot();
    // The reference at t = π/2: the tip of θ = 75°, φ = π/2.
    let reference = bent(75_f64.to_radians(), FRAC_PI_2);
    let obstacle = sphere(robot.tip_position(reference.as_slice()), 0.0);
    let clearance_m = |deg: f64| robot.clearance_m(&bent(deg.to_radians(), FRAC_PI_2), &obstacle);
    let tip_m = |deg: f64| {
        let tip = robot.tip_position(bent(deg.to_radians(), FRAC_PI_2).as_slice());
        axis_distance_m(obstacle.shape(), tip)
    };
    // Where `distance_m` passes D between an angle with less and one with more.
    let crossing_deg =
        |distance_m: &dyn Fn(f64) -> f64, wanted_m: f64, mut less: f64, mut more: f64| {
            for _ in 0..60 {
                let middle = 0.5 * (less + more);
                if distance_m(middle) < wanted_m {
                    less = middle;
                } else {
                    more = middle;
                }
            }
            more
        };
    // The model gives tenths of a degree rounded to the safe side, the tip's to the nearest. The digits here are those of a
    // sampled curve (Python, 4001 samples, bisection).
    for (safe_m, inside, outside, tip_alone) in [
        (0.01, (71.0029, 71.0), (79.5174, 79.6), (79.0177, 79.0)),
        (0.02, (67.0228, 67.0), (84.2634, 84.3), (83.0596, 83.1)),
        (0.04, (59.1007, 59.1), (94.6050, 94.7), (91.2316, 91.2)),
    ] {
        let check = |found: f64, expected: (f64, f64), round: fn(f64) -> f64| {
            assert!((found - expected.0).abs() < 1e-4, "{found}, D = {safe_m} m");
            assert_eq!(round(found * 10.0) / 10.0, expected.1, "D = {safe_m} m");
        };
        check(
            crossing_deg(&clearance_m, safe_m, 75.0, 30.0),
            inside,
            f64::floor,
        );
        check(
            crossing_deg(&clearance_m, safe_m, 75.0, 130.0),
            outside,
            f64::ceil,
        );
        check(
            crossing_deg(&tip_m, safe_m, 75.0, 130.0),
            tip_alone,
            f64::round,
        );
    }
}

#[test]
fn half_a_circle_and_more_know_their_centre_their_gap_and_their_back() {
    let robot = line_robot();
    for theta in [FRAC_PI_2, 3.0, PI, 3.3, 5.0, TAU, 9.0] {
        let shape = bent(theta, 0.0);
        let radius_m = 0.3 / theta;
        let at = |a: f64, share: f64, y: f64| {
            Vector3::new(
                radius_m * (1.0 - share * a.cos()),
                y,
                radius_m * share * a.sin(),
            )
        };
        let distance_m = |point_m| robot.clearance_m(&shape, &sphere(point_m, 0.0));
        assert!(
            (distance_m(at(0.0, 0.0, 0.0)) - radius_m).abs() < 1e-15,
            "centre at {theta}"
        );
        for i in 0..200 {
            let a = TAU * f64::from(i) / 200.0;
            for (share, y) in [(0.3, 0.0), (0.9, 0.02), (1.7, -0.1)] {
                let found_m = distance_m(at(a, share, y));
                // On the arc the circle's distance, in the gap the nearer end by the law of cosines.
                let beyond = if a <= theta {
                    0.0
                } else {
                    (a - theta).min(TAU - a)
                };
                let across = 1.0 + share * share - 2.0 * share * beyond.cos();
                let expected_m = (radius_m * radius_m * across + y * y).sqrt();
                assert!(
                    (found_m - expected_m).abs() < 1e-14,
                    "{theta} {a} {share}: {found_m} {expected_m}"
                );
            }
        }
    }
}

#[test]
fn an_obstacle_at_the_centre_of_the_circle_still_has_a_nearest_point_on_the_arc() {
    // A regression: within rounding of the centre, the point was computed with none of its digits left.
    let robot = line_robot();
    for theta in [0.8, 2.0, 2.8, PI, 4.0, TAU, 8.0] {
        for phi in [0.0, 0.7, -2.0] {
            let shape = bent(theta, phi);
            let centre_m = Vector3::new(phi.cos(), phi.sin(), 0.0) * (0.3 / theta);
            for i in 0..12 {
                let (sin, cos) = (TAU * f64::from(i) / 12.0).sin_cos();
                for size in [0.0, 1e-17, 1e-16, 1e-15, 1e-12] {
                    let off_m = Vector3::new(cos * phi.cos(), cos * phi.sin(), sin) * size;
                    let ball = sphere(centre_m + off_m, 0.0);
                    check_against_oracle(&robot, &shape, &ball);
                }
            }
        }
    }
}

#[test]
fn of_two_equally_near_places_one_is_found_and_clearance_does_not_jump() {
    // A capsule across the mouth of an arc: two minima, one on either side. As it shifts, the nearest place changes sides.
    let robot = line_robot();
    let shape = bent(2.8, 0.0);
    let middle_m = robot.body_point(&shape, 0, 0.5);
    let centre_m = Vector3::new(0.3 / 2.8, 0.0, 0.0);
    let inwards = (centre_m - middle_m).normalize();
    let side = inwards.cross(&Vector3::y());
    let mut last_m: Option<f64> = None;
    for i in -100..=100 {
        let shift = f64::from(i) * 1e-4;
        let at_m = middle_m + inwards * 0.06 + side * shift + Vector3::y() * 0.01;
        let obstacle = capsule(at_m - side * 0.085, at_m + side * 0.085, 0.0);
        check_against_oracle(&robot, &shape, &obstacle);
        let clearance_m = robot.clearance_m(&shape, &obstacle);
        if let Some(last_m) = last_m.replace(clearance_m) {
            assert!((clearance_m - last_m).abs() < 1.01e-4);
        }
    }
}

#[test]
fn it_is_smooth_through_straight() {
    let robot = line_robot();
    let obstacles = [
        sphere(Vector3::new(0.05, 0.02, 0.2), 0.01),
        sphere(Vector3::new(0.05, 0.02, 0.4), 0.01),
        sphere(Vector3::new(0.0, 0.0, 0.1), 0.01),
        capsule(
            Vector3::new(0.05, -0.2, 0.1),
            Vector3::new(0.1, 0.3, 0.25),
            0.01,
        ),
        capsule(
            Vector3::new(0.05, 0.0, -0.1),
            Vector3::new(0.05, 0.0, 0.5),
            0.01,
        ),
    ];
    for obstacle in &obstacles {
        let straight_m = robot.clearance_m(&Configuration::straight(1), obstacle);
        for exponent in 1..330 {
            let theta = 10_f64.powi(-exponent);
            for phi in [0.0, 1.0, 2.5, -2.0] {
                let shape = bent(theta, phi);
                let change_m = robot.clearance_m(&shape, obstacle) - straight_m;
                assert!(
                    change_m.abs() <= 0.15 * theta + 1e-16,
                    "{theta:e}: {change_m:e}"
                );
                check_consistent(&robot, &shape, obstacle, &robot.nearest(&shape, obstacle));
            }
        }
    }
}

#[test]
fn where_backbone_and_obstacle_meet_the_direction_leads_away() {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let bends = [[0.0, 0.0], [1.1, 0.4], [2.0, -2.0]];
    let shape = Configuration::from_bend_angles(&bends);
    for (section, s) in [(0, 0.5), (1, 0.0), (1, 0.3), (2, 1.0), (2, 0.7)] {
        let centre_m = robot.body_point(&shape, section, s);
        let tangent = (robot.body_point(&shape, section, (s + 1e-4).min(1.0))
            - robot.body_point(&shape, section, (s - 1e-4).max(0.0)))
        .normalize();
        for span in [Vector3::zeros(), Vector3::x() * 0.1, tangent * 0.02] {
            let obstacle = capsule(centre_m - span, centre_m + span, 0.01);
            let nearest = robot.nearest(&shape, &obstacle);
            assert!((nearest.clearance_m + 0.025).abs() < 1e-5);
            check_consistent(&robot, &shape, &obstacle, &nearest);
            assert!(nearest.direction.dot(&tangent).abs() < 0.05);
        }
    }
}

#[test]
fn the_thicker_section_is_nearer_at_equal_distance() {
    let mut parameters = RobotParameters::paper(2);
    parameters.sections[1].body_radius_m = 0.03;
    let robot = Robot::new(&parameters).unwrap();
    let beside_the_joint = sphere(Vector3::new(0.1, 0.0, 0.29), 0.01);
    let nearest = robot.nearest(&Configuration::straight(2), &beside_the_joint);
    assert_eq!((nearest.section, nearest.s), (1, 0.0));
    assert!((nearest.clearance_m - (0.1_f64.hypot(0.01) - 0.04)).abs() < 1e-15);
}

#[test]
fn a_moving_obstacle_arrives_when_it_should() {
    let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
    let shape = Configuration::straight(1);
    let centre_m = Vector3::new(0.2, 0.0, 0.1);
    let velocity_m_s = Vector3::new(-0.5, 0.0, 0.0);
    let obstacle = Obstacle::new(Shape::Sphere { centre_m }, 0.025, velocity_m_s).unwrap();
    for (after_s, expected_m) in [
        (0.0, 0.16),
        (0.2, 0.06),
        (0.32, 0.0),
        (0.4, -0.04),
        (0.5, 0.01),
    ] {
        let found_m = robot.clearance_m(&shape, &obstacle.moved(after_s));
        assert!(
            (found_m - expected_m).abs() < 1e-15,
            "after {after_s} s: {found_m} m"
        );
    }
}

#[test]
fn a_nan_is_never_a_clearance() {
    for n in ranges::SECTION_COUNT {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        let mut shape = Configuration::from_bend_angles(&vec![[0.4, 0.3]; n]);
        for i in 0..2 * n {
            for value in [f64::NAN, f64::INFINITY] {
                let before = std::mem::replace(&mut shape.as_mut_slice()[i], value);
                for obstacle in [
                    sphere(Vector3::x(), 0.01),
                    capsule(Vector3::x(), Vector3::y(), 0.01),
                ] {
                    assert!(
                        robot.clearance_m(&shape, &obstacle).is_nan(),
                        "{n} {i} {value}"
                    );
                    assert!(robot.nearest(&shape, &obstacle).clearance_m.is_nan());
                    assert!(robot.reaches(&shape, &obstacle, 0.0));
                }
                shape.as_mut_slice()[i] = before;
            }
        }
    }
}

#[test]
fn the_largest_numbers_allowed_overflow_nothing() {
    let robot = Robot::new(&RobotParameters::paper(6)).unwrap();
    let far_m = Vector3::repeat(1e6);
    for theta in [0.0, 1e-15, 1e-6, 2.8] {
        let shape = Configuration::from_bend_angles(&[[theta, 1.0]; 6]);
        let away = robot.nearest(&shape, &sphere(far_m, 1e6));
        assert!((away.clearance_m - (3_f64.sqrt() - 1.0) * 1e6).abs() < 3.0);
        // Six orders of magnitude longer than the robot: six digits of the distance go.
        let through = robot.nearest(&shape, &capsule(-far_m, far_m, 0.0));
        assert!(
            (through.clearance_m + 0.015).abs() < 1e-9,
            "{}",
            through.clearance_m
        );
    }
}
