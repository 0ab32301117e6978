use super::near::NEAR_MAX;
use super::*;
use crate::robot::{RobotParameters, SECTIONS_MAX, Shape};
use crate::safety::limit;
use crate::safety::stopping::StoppingPath;
use nalgebra::Vector3;
use proptest::prelude::*;

const PERIOD_S: f64 = 0.005;

/// A moment: a robot, its state, what it wants, and what is around it.
#[derive(Debug)]
struct Moment {
    robot: Robot,
    at: Configuration,
    desired_rates: BendRates,
    obstacles: Vec<Obstacle>,
    safe_distance_m: f64,
}

/// Commands that are obeyed for three periods, and a ramp of 40 rad/s².
const STOPPING: Stopping = Stopping {
    moving_s: 3.0 * PERIOD_S,
    deceleration_rad_s2: 40.0,
};

fn path(rates: &BendRates) -> StoppingPath {
    STOPPING.path(fastest(rates))
}

/// That of the fastest rates of the paper's robot.
fn longest_way_s() -> f64 {
    STOPPING.path(2.0).path_s
}

impl Moment {
    fn watch(&self) -> ClearanceGuard<'_> {
        ClearanceGuard {
            robot: &self.robot,
            at: &self.at,
            commanded: None,
            slack: None,
            obstacles: &self.obstacles,
            safe_distance_m: self.safe_distance_m,
            period_s: PERIOD_S,
            stopping: STOPPING,
        }
    }

    fn guard(&self) -> Guarded {
        let limits = Limits::new(&self.robot, &self.at, longest_way_s());
        self.watch().apply(&limits, &self.desired_rates)
    }

    fn guard_ramp(&self) -> Guarded {
        self.watch().scale_down(&self.desired_rates)
    }

    /// What is left of the clearances beyond what must be, at a place of the way \[m\]: and of what may be missing `between`.
    fn margin_m(&self, rates: &BendRates, path_s: f64, between: bool, is_ramp: bool) -> f64 {
        let next = self.at.advanced(rates, path_s);
        let (body, standing) = (self.robot.body(&next), self.robot.body(&self.at));
        // A section that is farther away has nothing to keep.
        let reach_m = [self.safe_distance_m; SECTIONS_MAX];
        let mut least_m = f64::INFINITY;
        for obstacle in &self.obstacles {
            let moved = obstacle.moved(path(rates).time_s(path_s));
            let [now, standing] =
                [&body, &standing].map(|body| body.clearances_in_reach(&moved, &reach_m));
            let may_lack_m = if between {
                1e-3 + PERIOD_S * obstacle.velocity_m_s().norm()
            } else {
                0.0
            };
            for (now_m, standing_m) in now.into_iter().zip(standing) {
                let is_continued = is_ramp && obstacle.velocity_m_s().norm() == 0.0;
                let less_m = if is_continued { 1.001e-3 } else { 0.0 };
                let floor_m = standing_m.min(self.safe_distance_m - less_m) - may_lack_m;
                least_m = least_m.min(now_m - floor_m);
            }
        }
        least_m
    }

    /// The rule of [`ClearanceGuard::apply`], or of [`ClearanceGuard::scale_down`], looked at in many places.
    fn keeps(&self, rates: &BendRates, is_ramp: bool) -> bool {
        let is_exact = |path_s| self.margin_m(rates, path_s, false, is_ramp) >= 0.0;
        let end_s = path(rates).path_s;
        let origins = (0..=100).map(|part| end_s * f64::from(part) / 100.0);
        is_exact(PERIOD_S)
            && is_exact(end_s)
            && origins
                .into_iter()
                .all(|path_s| self.margin_m(rates, path_s, true, is_ramp) >= 0.0)
    }
}

fn trunk(sections: usize) -> Robot {
    Robot::new(&RobotParameters::paper(sections)).unwrap()
}

fn sphere(centre_m: Vector3<f64>, radius_m: f64) -> Obstacle {
    Obstacle::new(Shape::Sphere { centre_m }, radius_m, Vector3::zeros()).unwrap()
}

/// Obstacles beside a point of the body: in direction, at a distance from touching it deep to out of reach.
fn obstacle() -> impl Strategy<Value = (usize, [f64; 9], bool)> {
    (
        0..3_usize,
        prop::array::uniform9(-1.0..1.0_f64),
        any::<bool>(),
    )
}

fn placed(robot: &Robot, at: &Configuration, numbers: (usize, [f64; 9], bool)) -> Obstacle {
    let (section, [s, x, y, z, apart, size, vx, vy, vz], is_capsule) = numbers;
    let section = section % robot.section_count();
    let radius_m = 0.02 + 0.02 * size;
    let side = Vector3::new(x, y, z)
        .try_normalize(1e-3)
        .unwrap_or(Vector3::x());
    let away_m = 0.015 + radius_m + 0.01 + 0.04 * apart;
    let centre_m = robot.body_point(at, section, 0.5 + 0.5 * s) + side * away_m;
    let velocity_m_s = Vector3::new(vx, vy, vz) * if x > 0.0 { 0.0 } else { 0.5 };
    let span_m = side.cross(&Vector3::new(vy, vz, vx)) * 0.2;
    let shape = if is_capsule {
        Shape::Capsule {
            start_m: centre_m - span_m,
            end_m: centre_m + span_m,
        }
    } else {
        Shape::Sphere { centre_m }
    };
    Obstacle::new(shape, radius_m, velocity_m_s).unwrap()
}

/// Robots of 1 to 6 sections with strokes from tight to free, among 1 to 64 obstacles that stand or move.
fn moments() -> impl Strategy<Value = Moment> {
    let obstacles = prop_oneof![
        prop::collection::vec(obstacle(), 1..4),
        prop::collection::vec(obstacle(), 4..16),
        prop::collection::vec(obstacle(), 16..=64),
    ];
    (
        1..=6_usize,
        prop::collection::vec(-1.9..1.9_f64, 12),
        prop::collection::vec(-2.5..2.5_f64, 12),
        obstacles,
        0.0..0.03_f64,
        0.01..0.2_f64,
    )
        .prop_map(
            |(sections, bends, rates, obstacles, safe_distance_m, stroke_m)| {
                let mut parameters = RobotParameters::paper(sections);
                parameters.cable_stroke_max_m = stroke_m;
                let robot = Robot::new(&parameters).unwrap();
                let at = Configuration::from_slice(&bends[..2 * sections]).unwrap();
                let desired_rates = BendRates::from_slice(&rates[..2 * sections]).unwrap();
                let desired_rates = limit(&robot, &at, &desired_rates, longest_way_s()).rates;
                let point = |numbers| placed(&robot, &at, numbers);
                let obstacles = obstacles.into_iter().map(point).collect();
                Moment {
                    robot,
                    at,
                    desired_rates,
                    obstacles,
                    safe_distance_m,
                }
            },
        )
}

/// As many as `PROPTEST_CASES` asks for, or a thousand with `CDCR_WHOLE`.
fn cases() -> ProptestConfig {
    let is_set = |name| std::env::var_os(name).is_some();
    if is_set("PROPTEST_CASES") {
        ProptestConfig::default()
    } else {
        ProptestConfig::with_cases(if is_set("CDCR_WHOLE") { 1000 } else { 150 })
    }
}

proptest! {
    /// What a plane between a section and a moving obstacle allows for; and where the way is halved in time.
    #[test]
    fn time_is_a_quarter_of_its_span_at_most_beside_what_is_even(
        moving_s in 0.0..0.05_f64,
        fastest_rad_s in 0.0..8.0_f64,
        deceleration_rad_s2 in 5.0..500.0_f64,
        mut shares in prop::array::uniform3(0.0..=1.0_f64),
    ) {
        let way = Stopping { moving_s, deceleration_rad_s2 }.path(fastest_rad_s);
        shares.sort_by(f64::total_cmp);
        let [from, between, to] = shares.map(|share| (share * way.path_s, way.time_s(share * way.path_s)));
        let span_s = to.1 - from.1;
        let even_s = from.1 + span_s * (between.0 - from.0) / (to.0 - from.0).max(1e-12);
        prop_assert!((between.1 - even_s).abs() <= 0.25 * span_s + 1e-9, "{shares:?}");
        prop_assert!((way.path_after_s(between.1) - between.0).abs() <= 1e-12);
    }
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn what_leaves_keeps_clear_and_inside_the_limits(moment in moments()) {
        let guarded = moment.guard();
        prop_assert!(moment.keeps(&guarded.rates, false));
        let ramp = moment.guard_ramp();
        prop_assert!(moment.keeps(&ramp.rates, true));
        for (rate, desired_rates) in ramp.rates.as_slice().iter().zip(moment.desired_rates.as_slice()) {
            prop_assert!(rate.abs() <= desired_rates.abs() && rate * desired_rates >= 0.0);
        }
        prop_assert!(guarded.hit || moment.keeps(&moment.desired_rates, false));
        let again = limit(&moment.robot, &moment.at, &guarded.rates, longest_way_s());
        for (rate, limited) in guarded.rates.as_slice().iter().zip(again.rates.as_slice()) {
            prop_assert!((rate - limited).abs() < 1e-9);
        }
        prop_assert!(fastest(&guarded.rates) <= fastest(&moment.desired_rates));
        let least_m = moment.obstacles.iter().map(|o| moment.robot.clearance_m(&moment.at, o));
        prop_assert_eq!(guarded.clearance_m, least_m.fold(f64::INFINITY, f64::min));
    }

    #[test]
    fn the_same_moment_gives_the_same_bits(moment in moments()) {
        let (once, again) = (moment.guard(), moment.guard());
        let bits = |guarded: &Guarded| guarded.rates.as_slice().iter().map(|r| r.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&once), bits(&again));
    }

    #[test]
    fn far_from_everything_nothing_changes(mut moment in moments(), away in 1.2..1000.0_f64) {
        moment.obstacles = vec![sphere(Vector3::new(away, 0.0, 0.0), 0.05); 3];
        let guarded = moment.guard();
        prop_assert_eq!((guarded.rates, guarded.hit), (moment.desired_rates, false));
    }
}

/// A command that keeps D = 10 mm.
fn guard(
    robot: &Robot,
    at: &Configuration,
    desired_rates: &BendRates,
    obstacles: &[Obstacle],
) -> Guarded {
    let limits = Limits::new(robot, at, longest_way_s());
    let guard = ClearanceGuard {
        robot,
        at,
        commanded: None,
        slack: None,
        obstacles,
        safe_distance_m: 0.01,
        period_s: PERIOD_S,
        stopping: STOPPING,
    };
    guard.apply(&limits, desired_rates)
}

#[test]
fn a_robot_that_obeys_positions_keeps_clear_from_where_its_motors_go() {
    // The tip is behind; where it is sent, it is at the border.
    let robot = trunk(1);
    let (at, commanded) = ([0.0, 0.0], [0.3, 0.0]);
    let [at, commanded] = [at, commanded].map(|bends| Configuration::from_slice(&bends).unwrap());
    let centre_m = robot.tip_position(&commanded) + Vector3::new(0.0451, 0.0, 0.0);
    let obstacles = [sphere(centre_m, 0.02)];
    let desired_rates = BendRates::from_slice(&[1.0, 0.0]).unwrap();
    let guard = |commanded| ClearanceGuard {
        robot: &robot,
        at: &at,
        commanded,
        slack: None,
        obstacles: &obstacles,
        safe_distance_m: 0.01,
        period_s: PERIOD_S,
        stopping: STOPPING,
    };
    let limits = Limits::new(&robot, &at, longest_way_s());
    assert!(!guard(None).apply(&limits, &desired_rates).hit);
    let kept = guard(Some(&commanded)).apply(&limits, &desired_rates);
    let sent = commanded.advanced(&kept.rates, path(&kept.rates).path_s);
    assert!(kept.hit && robot.clearance_m(&sent, &obstacles[0]) >= 0.01);
}

/// A robot that wants to bend towards a ball for a second.
fn push(sections: usize, sphere: &Obstacle, rates: &[f64]) -> (Vec<f64>, Configuration) {
    let robot = trunk(sections);
    let mut at = Configuration::straight(sections);
    let mut clearances_m = Vec::new();
    for _ in 0..200 {
        let desired_rates = BendRates::from_slice(rates).unwrap();
        let guarded = guard(&robot, &at, &desired_rates, &[sphere.moved(0.0)]);
        at = at.advanced(&guarded.rates, PERIOD_S);
        clearances_m.push(robot.clearance_m(&at, sphere));
    }
    (clearances_m, at)
}

#[test]
fn head_on_the_body_comes_to_the_safe_distance_and_stays() {
    let (clearances_m, _) = push(1, &sphere(Vector3::new(0.12, 0.0, 0.28), 0.02), &[1.0, 0.0]);
    let least_m = clearances_m.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(least_m >= 0.01, "{least_m}");
    let last_m = clearances_m[clearances_m.len() - 1];
    assert!(last_m < 0.0101, "it stops at the border: {last_m}");
}

#[test]
fn at_an_angle_the_body_slides_along() {
    let obstacle = sphere(Vector3::new(0.12, 0.02, 0.28), 0.02);
    let (clearances_m, at) = push(1, &obstacle, &[1.0, -0.3]);
    assert!(clearances_m.iter().all(|clearance_m| *clearance_m >= 0.01));
    assert!(at.as_slice()[1] < -0.25, "it goes on sideways: {at:?}");
}

/// More than are linearised anew where nothing else is found.
#[test]
fn along_a_wall_of_many_balls_the_body_slides_as_fast() {
    let robot = trunk(1);
    let at = Configuration::straight(1);
    let wall: Vec<_> = (0..40)
        .map(|i| {
            let (across, along) = (f64::from(i % 5) - 2.0, f64::from(i / 5));
            // Next to nothing is left before the safe distance.
            sphere(
                Vector3::new(0.0271, 5e-3 * across, 0.14 + 0.02 * along),
                2e-3,
            )
        })
        .collect();
    let desired_rates = BendRates::from_slice(&[1.0, -0.6]).unwrap();
    let guarded = guard(&robot, &at, &desired_rates, &wall);
    assert!(guarded.hit);
    let rates = guarded.rates.as_slice();
    assert!(rates[1] < -0.5, "it goes on sideways: {rates:?}");
}

#[test]
fn what_appears_inside_the_safe_distance_never_gets_nearer_by_our_own_motion() {
    let robot = trunk(2);
    let mut at = Configuration::from_slice(&[0.5, 0.0, 0.2, 0.0]).unwrap();
    let tip_m = robot.tip_position(&at);
    let obstacle = sphere(tip_m + Vector3::new(0.038, 0.0, 0.0), 0.02);
    let mut before_m = robot.clearance_m(&at, &obstacle);
    assert!(before_m < 0.01 && before_m > 0.0);
    for _ in 0..200 {
        let desired_rates = BendRates::from_slice(&[1.0, 0.2, 1.0, -0.1]).unwrap();
        let guarded = guard(&robot, &at, &desired_rates, &[obstacle]);
        at = at.advanced(&guarded.rates, PERIOD_S);
        let after_m = robot.clearance_m(&at, &obstacle);
        assert!(after_m >= before_m.min(0.01), "{after_m} after {before_m}");
        before_m = after_m;
    }
}

#[test]
fn a_robot_at_rest_stays_at_rest_whatever_comes() {
    let robot = trunk(2);
    let at = Configuration::straight(2);
    let towards = Vector3::new(-1.0, 0.0, 0.0);
    let shape = Shape::Sphere {
        centre_m: Vector3::new(0.05, 0.0, 0.5),
    };
    let obstacle = Obstacle::new(shape, 0.02, towards).unwrap();
    let standing = BendRates::zero(2);
    let guarded = guard(&robot, &at, &standing, &[obstacle]);
    assert_eq!((guarded.rates, guarded.hit), (standing, false));
    assert!((guarded.clearance_m - 0.015).abs() < 1e-15);
}

#[test]
fn a_state_that_is_not_finite_and_too_many_obstacles_stand_still() {
    let robot = trunk(1);
    let desired_rates = BendRates::from_slice(&[0.1, 0.0]).unwrap();
    let near = sphere(Vector3::new(0.03, 0.0, 0.3), 0.01);
    let lost = Configuration::from_slice(&[f64::NAN, 0.0]).unwrap();
    let guarded = guard(&robot, &lost, &desired_rates, &[near]);
    assert_eq!((guarded.rates, guarded.hit), (BendRates::zero(1), true));
    assert!(guarded.clearance_m.is_nan());
    let many = vec![near; NEAR_MAX + 1];
    let at = Configuration::straight(1);
    let guarded = guard(&robot, &at, &desired_rates, &many);
    assert_eq!((guarded.rates, guarded.hit), (BendRates::zero(1), true));
}

/// A command that is shortened stops sooner, so on the last part of its way it is later than the desired rates would be there:
/// a ball that crosses behind those meets the robot that stops.
#[test]
fn a_shortened_command_keeps_clear_in_its_own_time() {
    let mut parameters = RobotParameters::paper(1);
    parameters.sections[0].rate_max_rad_s = 8.0;
    let stands = sphere(Vector3::new(0.14, 0.0, 0.28), 0.02);
    let mut moment = Moment {
        robot: Robot::new(&parameters).unwrap(),
        at: Configuration::straight(1),
        desired_rates: BendRates::from_slice(&[8.0, 0.0]).unwrap(),
        obstacles: vec![stands],
        safe_distance_m: 0.01,
    };
    let shortened = moment.guard().rates;
    assert!(fastest(&shortened) < 7.0 && moment.keeps(&shortened, false));
    let end_s = path(&shortened).path_s;
    let end = moment.at.advanced(&shortened, end_s);
    // 20 mm behind the tip when that rests, where it comes from the side at 1 m/s.
    let rests_s = path(&shortened).time_s(end_s);
    let centre_m = moment.robot.tip_position(&end) - Vector3::new(0.02, rests_s, 0.0);
    let crosses = Obstacle::new(Shape::Sphere { centre_m }, 0.001, Vector3::y()).unwrap();
    moment.obstacles.push(crosses);
    // In the time of the desired rates it would keep clear of the ball, too; in its own it does not.
    let clearance_m = |way: StoppingPath| {
        let predicted = crosses.moved(way.time_s(end_s));
        moment.robot.clearance_m(&end, &predicted)
    };
    assert!(clearance_m(path(&moment.desired_rates)) > 0.01);
    assert!(clearance_m(path(&shortened)) < 0.005 && !moment.keeps(&shortened, false));
    let kept = moment.guard().rates;
    assert!(moment.keeps(&kept, false) && fastest(&kept) > 1.0);
}

#[test]
fn without_obstacles_there_is_no_clearance() {
    let desired_rates = BendRates::from_slice(&[0.1, 0.0]).unwrap();
    let guarded = guard(&trunk(1), &Configuration::straight(1), &desired_rates, &[]);
    assert_eq!(guarded.clearance_m, f64::INFINITY);
    assert!(!guarded.hit);
}
