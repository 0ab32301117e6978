//! Liveness under limits and clearance guard: a robot that can move on does so.

use cdcr_controller::closed_loop::ClosedLoop;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use cdcr_controller::safety::{Situation, homing_rates, ramp_to_zero, safe_command};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use crate::{input, inside};

const PERIOD_S: f64 = 0.005;
const SAFE_M: f64 = 0.01;

/// Limit of the growth of rates, and deceleration to rest \[rad/s²\].
const ACCELERATION_RAD_S2: f64 = 40.0;

fn situation<'a>(
    robot: &'a Robot,
    at: &'a Configuration,
    previous: &'a BendRates,
    obstacles: &'a [Obstacle],
) -> Situation<'a> {
    Situation {
        robot,
        at,
        lag: None,
        commanded: None,
        slack: None,
        previous,
        obstacles,
        safe_distance_m: SAFE_M,
        tip_offset_m: 0.0,
        acceleration_rad_s2: ACCELERATION_RAD_S2,
        period_s: PERIOD_S,
        moving_s: 3.0 * PERIOD_S,
        deceleration_rad_s2: ACCELERATION_RAD_S2,
        comes_to_rest: false,
    }
}

/// The command of the daemon for this situation.
pub(crate) fn command(
    robot: &Robot,
    at: &Configuration,
    previous: &BendRates,
    obstacles: &[Obstacle],
    desired: &BendRates,
) -> BendRates {
    safe_command(&situation(robot, at, previous, obstacles), desired).rates
}

/// Largest decrease of the fastest component in a cycle on the way from `rates` to rest \[rad/s²\].
fn largest_deceleration_rad_s2(
    robot: &Robot,
    at: &Configuration,
    rates: &BendRates,
    obstacles: &[Obstacle],
) -> f64 {
    let (mut at, mut rates, mut largest_rad_s2) = (*at, *rates, 0.0_f64);
    while fastest(&rates) > 0.0 {
        let desired = ramp_to_zero(&rates, ACCELERATION_RAD_S2, PERIOD_S);
        let ramp = Situation {
            comes_to_rest: true,
            ..situation(robot, &at, &rates, obstacles)
        };
        let next = safe_command(&ramp, &desired).rates;
        largest_rad_s2 = largest_rad_s2.max((fastest(&rates) - fastest(&next)) / PERIOD_S);
        at = at.advanced(&next, PERIOD_S);
        rates = next;
    }
    largest_rad_s2
}

fn fastest(rates: &BendRates) -> f64 {
    let components = rates.as_slice().iter();
    components.fold(0.0, |most, rate| rate.abs().max(most))
}

fn norm(rates: &BendRates) -> f64 {
    rates
        .as_slice()
        .iter()
        .map(|rate| rate * rate)
        .sum::<f64>()
        .sqrt()
}

/// Distance from the straight robot in bends.
fn from_home_rad(at: &Configuration) -> f64 {
    at.as_slice()
        .iter()
        .map(|bend| bend * bend)
        .sum::<f64>()
        .sqrt()
}

fn largest_stroke_m(robot: &Robot, at: &Configuration) -> f64 {
    let strokes_m = robot.cable_strokes(at);
    strokes_m
        .iter()
        .fold(0.0, |most, stroke_m| stroke_m.abs().max(most))
}

/// A configuration with all strokes inside `share` of their limit.
fn inside_strokes(robot: &Robot, random: &mut Xoshiro256PlusPlus, share: f64) -> Configuration {
    loop {
        let bends: Vec<f64> = (0..robot.coordinate_count())
            .map(|_| random.random_range(-1.5..1.5))
            .collect();
        let at = Configuration::from_slice(&bends).unwrap();
        let largest_m = largest_stroke_m(robot, &at);
        if largest_m < share * robot.cable_stroke_max_m()
            && largest_m > 0.7 * robot.cable_stroke_max_m()
        {
            return at;
        }
    }
}

#[test]
fn short_strokes_do_not_freeze_a_robot_that_tracks() {
    let mut parameters = RobotParameters::paper(3);
    parameters.cable_stroke_max_m = 0.015;
    let robot = Robot::new(&parameters).unwrap();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, NmpcSettings::default()).unwrap();
    let mut at = Configuration::straight(3);
    let mut rates = BendRates::zero(3);
    let (mut frozen, mut last_mm) = (0, Vec::new());
    for goal in 0..10 {
        let goal_m = robot.tip_position(&inside_strokes(&robot, &mut random, 0.95));
        for cycle in 0..200 {
            let reference = [inside(goal_m); 2];
            let input = SolveInput {
                seed: cycle_seed(1, 1000 * goal + cycle),
                ..input(&at, &rates, &reference)
            };
            let (desired_rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
            rates = command(&robot, &at, &rates, &[], &desired_rates);
            frozen += u32::from(
                norm(&rates) < 0.01 * norm(&desired_rates) && norm(&desired_rates) > 0.01,
            );
            at = at.advanced(&rates, PERIOD_S);
            assert!(largest_stroke_m(&robot, &at) <= 0.015 + 1e-15);
        }
        last_mm.push(1e3 * (robot.tip_position(&at) - goal_m).norm());
    }
    let mean_mm = last_mm.iter().sum::<f64>() / last_mm.len() as f64;
    println!("frozen in {frozen} of 2000 cycles, {mean_mm:.1} mm from the goals: {last_mm:.1?}");
    assert!(frozen < 20 && mean_mm < 15.0);
}

/// Slower commands have shorter stopping paths; the fastest one that stops at the limit is found. One
/// section, 40 rad/s², commands executed for 15 ms.
#[test]
fn a_command_towards_a_limit_is_the_fastest_that_stops_there() {
    let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
    let bend_max_rad = robot.sections()[0].bend_max_rad;
    let desired = BendRates::from_slice(&[2.0, 0.0]).unwrap();
    for room_rad in [0.005, 0.01, 0.02, 0.04] {
        let at = Configuration::from_slice(&[bend_max_rad - room_rad, 0.0]).unwrap();
        let rate_rad_s = command(&robot, &at, &desired, &[], &desired).as_slice()[0];
        // rate · 15 ms + rate² / (2 · 40 rad/s²) = distance to the limit
        let moving_s = 3.0 * PERIOD_S;
        let exact_rad_s = ACCELERATION_RAD_S2
            * ((moving_s * moving_s + 2.0 * room_rad / ACCELERATION_RAD_S2).sqrt() - moving_s);
        println!("{room_rad} rad left: {rate_rad_s} of {exact_rad_s} rad/s");
        assert!(((1.0 - 1e-6) * exact_rad_s..=exact_rad_s).contains(&rate_rad_s));
    }
}

/// The plan ends inside its limits: where they keep the robot from its goal, the safety check changes no
/// command permanently.
#[test]
fn a_plan_that_rests_at_a_limit_is_not_cut() {
    let limited: [fn(&mut RobotParameters); 2] = [
        |p| p.sections.iter_mut().for_each(|s| s.bend_max_rad = 0.5),
        |p| p.cable_stroke_max_m = 0.006,
    ];
    for (index, limit) in limited.into_iter().enumerate() {
        let mut parameters = RobotParameters::paper(2);
        limit(&mut parameters);
        let robot = Robot::new(&parameters).unwrap();
        let settings = NmpcSettings::default();
        let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings).unwrap();
        let goal = |_| inside(Vector3::new(0.25, 0.0, 0.0));
        let start = Configuration::from_slice(&[0.1, 0.0, 0.1, 0.0]).unwrap();
        let mut closed = ClosedLoop::new(&robot, PERIOD_S, settings, start, &[], goal).unwrap();
        for cycle in 0..600 {
            closed.step(&mut nmpc);
            let hit = closed.command().limits_hit;
            assert!(
                cycle < 500 || !hit.bend && !hit.cable_stroke,
                "{index}, {cycle}: {hit:?}"
            );
        }
        let at = closed.configuration();
        let left = match index {
            0 => 0.5 - at.bend_rad(0).max(at.bend_rad(1)),
            _ => 0.006 - largest_stroke_m(&robot, at),
        };
        assert!((1e-8..2e-6).contains(&left), "{index}: {left}");
    }
}

/// The measured tip turns out beside the model's, with an obstacle nearer than this offset allows. The robot
/// comes no nearer and may leave; a robot at rest stays. A ramp that began before the measurement continues
/// if it leads away.
#[test]
fn a_margin_that_appears_neither_moves_nor_freezes_the_robot() {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let at = Configuration::from_slice(&[0.3, 0.0, 0.2, 0.0, 0.3, 0.0]).unwrap();
    // Beside the tip, in the direction in which the bend grows.
    let centre_m = robot.tip_position(&at) + Vector3::new(0.05, 0.0, -0.02);
    let ball = [Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap()];
    let clear_m = |at: &Configuration| robot.clearance_m(at, &ball[0]);
    assert!((SAFE_M..0.025).contains(&clear_m(&at)), "{}", clear_m(&at));
    let rest = BendRates::zero(3);
    let [towards, away] = [1.0, -1.0].map(|sign| {
        let rates = [0.1, 0.0, 0.1, 0.0, 0.1, 0.0].map(|rate| sign * rate);
        BendRates::from_slice(&rates).unwrap()
    });
    let moving = Situation {
        tip_offset_m: 0.03,
        ..situation(&robot, &at, &rest, &ball)
    };
    let safe = |desired: &BendRates| safe_command(&moving, desired).rates;
    let unmeasured = Situation {
        tip_offset_m: 0.0,
        ..moving
    };
    assert_eq!(safe_command(&unmeasured, &towards).rates, towards);
    let next = at.advanced(&safe(&towards), PERIOD_S);
    assert!(clear_m(&next) >= clear_m(&at) - 1e-9);
    assert_eq!(safe(&away), away);
    assert_eq!(safe(&rest), rest);
    let ramp = Situation {
        previous: &away,
        comes_to_rest: true,
        ..moving
    };
    let slower = ramp_to_zero(&away, 10.0, PERIOD_S);
    assert_eq!(safe_command(&ramp, &slower).rates, slower);
    // An offset of NaN does not count as 0: nothing moves.
    let unknown = Situation {
        tip_offset_m: f64::NAN,
        ..moving
    };
    for desired in [&towards, &away] {
        assert_eq!(safe_command(&unknown, desired).rates, rest);
    }
    // The reported clearance is that of the thickened body.
    let reported_m = safe_command(&moving, &rest).clearance_m;
    assert!(
        (reported_m - (clear_m(&at) - 0.03)).abs() < 1e-9,
        "{reported_m}"
    );
}

/// A section that moves further in a period than an obstacle is thick does not jump over it. Both ends of the
/// period keep D; the motion between them passes through. (Six sections at 2 rad/s, three at 8 rad/s.)
#[test]
fn no_wire_is_jumped_over_within_a_period() {
    for (sections, rate_rad_s) in [(6, 2.0), (3, 8.0)] {
        let mut parameters = RobotParameters::paper(sections);
        parameters.cable_speed_max_m_s = 10.0;
        for section in &mut parameters.sections {
            section.rate_max_rad_s = rate_rad_s;
            section.body_radius_m = 0.01;
        }
        let robot = Robot::new(&parameters).unwrap();
        let at = Configuration::straight(sections);
        let bending: Vec<f64> = [rate_rad_s, 0.0].repeat(sections);
        let desired = BendRates::from_slice(&bending).unwrap();
        let after = |rates: &BendRates, way_s| at.advanced(rates, way_s);
        let middle_m = robot.tip_position(&after(&desired, 0.5 * PERIOD_S));
        let across = Vector3::new(0.0, 0.3, 0.0);
        let shape = Shape::Capsule {
            start_m: middle_m - across,
            end_m: middle_m + across,
        };
        let wire = [Obstacle::new(shape, 0.0005, Vector3::zeros()).unwrap()];
        let clear_m = |rates: &BendRates, way_s| robot.clearance_m(&after(rates, way_s), &wire[0]);
        let moving = Situation {
            safe_distance_m: 0.005,
            acceleration_rad_s2: f64::INFINITY,
            // Only the period counts.
            moving_s: PERIOD_S,
            deceleration_rad_s2: f64::INFINITY,
            ..situation(&robot, &at, &desired, &wire)
        };
        let [start_m, middle_m, end_m] =
            [0.0, 0.5, 1.0].map(|part| clear_m(&desired, part * PERIOD_S));
        println!("{sections} sections, asked for: {start_m}, {middle_m}, {end_m} m");
        assert!(start_m >= 0.005 && middle_m < -0.005 && end_m >= 0.005);
        let kept = safe_command(&moving, &desired).rates;
        let way = (0..=100).map(|part| clear_m(&kept, PERIOD_S * f64::from(part) / 100.0));
        let least_m = way.fold(f64::INFINITY, f64::min);
        println!(
            "{} of {rate_rad_s} rad/s, {least_m} m on the way",
            fastest(&kept)
        );
        assert!(least_m >= 0.004 && clear_m(&kept, PERIOD_S) >= 0.005);
    }
}

/// A mast beside the base is permanently nearer than D to the first section; the tip, which bends towards it,
/// keeps the whole of D.
#[test]
fn an_obstacle_at_the_base_lowers_no_floor_of_the_tip() {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let shape = Shape::Capsule {
        start_m: Vector3::new(0.04, 0.0, 0.0),
        end_m: Vector3::new(0.4, 0.0, 0.6),
    };
    let mast = [Obstacle::new(shape, 0.01, Vector3::zeros()).unwrap()];
    let clear_m = |at: &Configuration, section| robot.body(at).clearance_of(section, &mast[0]);
    let mut at = Configuration::straight(3);
    let desired = BendRates::from_slice(&[0.0, 0.0, 0.5, 0.0, 0.5, 0.0]).unwrap();
    let mut rates = BendRates::zero(3);
    let base_m = clear_m(&at, 0);
    assert!(base_m < 0.016, "{base_m}");
    let mut least_m = f64::INFINITY;
    for _ in 0..800 {
        let moving = Situation {
            safe_distance_m: 0.03,
            ..situation(&robot, &at, &rates, &mast)
        };
        rates = safe_command(&moving, &desired).rates;
        at = at.advanced(&rates, PERIOD_S);
        least_m = least_m.min(clear_m(&at, 1)).min(clear_m(&at, 2));
    }
    println!("the base {base_m} m, the other sections {least_m} m at least");
    assert!((0.03..0.0301).contains(&least_m));
}

/// Runs of a robot with `sections` that moves to the straight shape past `balls` balls beside its body, one
/// of them in its way. Counts the arrivals, and the stops before. Each command allows the robot to come to
/// rest with the allowed deceleration, and no faster. It never circles: each half second brings it nearer to
/// the goal.
fn homing(sections: usize, balls: usize, runs: u32) -> (u32, u32, u32) {
    let robot = Robot::new(&RobotParameters::paper(sections)).unwrap();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(balls as u64);
    let (mut blocked, mut arrived, mut stood) = (0, 0, 0);
    while blocked < runs {
        let bends: Vec<f64> = (0..2 * sections)
            .map(|_| random.random_range(-1.5..1.5))
            .collect();
        let begin = Configuration::from_slice(&bends).unwrap();
        let obstacles: Vec<Obstacle> = (0..balls)
            .map(|_| {
                let part = random.random_range(0.2..0.8);
                let between: Vec<f64> = bends.iter().map(|bend| part * bend).collect();
                let between = Configuration::from_slice(&between).unwrap();
                let section = random.random_range(0..sections);
                let side = Vector3::from_fn(|_, _| random.random_range(-0.03..0.03));
                let centre_m = robot.body_point(&between, section, 1.0) + side;
                Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap()
            })
            .collect();
        let clear = |at: &Configuration| {
            obstacles
                .iter()
                .map(|o| robot.clearance_m(at, o))
                .fold(f64::INFINITY, f64::min)
        };
        let straight = Configuration::straight(sections);
        let path = (0..=50).map(|part| {
            let bends: Vec<f64> = bends
                .iter()
                .map(|bend| bend * f64::from(part) / 50.0)
                .collect();
            clear(&Configuration::from_slice(&bends).unwrap())
        });
        if clear(&begin) < 1.5 * SAFE_M
            || clear(&straight) < 1.5 * SAFE_M
            || path.fold(1.0, f64::min) > 0.0
        {
            continue;
        }
        blocked += 1;
        let (mut at, mut rates) = (begin, BendRates::zero(sections));
        let mut left_rad = f64::INFINITY;
        for cycle in 0..3000 {
            let change_rad_s = ACCELERATION_RAD_S2 * PERIOD_S;
            let desired = homing_rates(&robot, &at, &rates, 0.5, change_rad_s, PERIOD_S);
            let before = (at, rates);
            rates = command(&robot, &at, &rates, &obstacles, &desired);
            at = at.advanced(&rates, PERIOD_S);
            if (at, rates) == before {
                break; // It stands, and all that follows is the same.
            }
            assert!(clear(&at) >= SAFE_M);
            if cycle % 100 == 0 {
                assert!(from_home_rad(&at) < left_rad, "{cycle}: {left_rad} rad");
                left_rad = from_home_rad(&at);
            }
            if cycle % 10 == 3 {
                let found_rad_s2 = largest_deceleration_rad_s2(&robot, &at, &rates, &obstacles);
                assert!(found_rad_s2 <= ACCELERATION_RAD_S2 * (1.0 + 1e-9));
            }
        }
        let is_home = at.as_slice().iter().all(|bend| bend.abs() < 1e-3);
        arrived += u32::from(is_home);
        stood += u32::from(!is_home && norm(&rates) < 1e-6);
    }
    (blocked, arrived, stood)
}

#[test]
fn balls_on_the_way_home_are_passed() {
    let runs = crate::number("CDCR_HOMING_RUNS", crate::repetitions(20, 40).into()) as u32;
    for &(sections, balls, tenths) in crate::cases(1, &[(3, 1, 10), (3, 4, 8), (3, 8, 6)]) {
        let (blocked, arrived, stood) = homing(sections, balls, runs);
        println!(
            "{sections} sections, {balls} balls: {arrived} of {blocked} arrive, {stood} stand still"
        );
        assert!(10 * arrived >= tenths * runs);
    }
    if std::env::var_os("CDCR_WHOLE").is_some() {
        let (blocked, arrived, stood) = homing(6, 32, runs / 10);
        println!("6 sections, 32 balls: {arrived} of {blocked} arrive, {stood} stand still");
        assert_eq!(stood, 0);
    }
}
