//! Horizons of twenty steps with saturated rates, obstacles around the body, and a limited budget.

use cdcr_controller::nmpc::{Nmpc, SolveInput, SolverKind};
use cdcr_controller::optimizer::{Budget, QUANTUM_NS};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Shape};
use nalgebra::Vector3;

use crate::{input, inside};

mod course;
mod foresight;

use course::{Course, Curve, Outcome, spiral};

const PERIOD_S: f64 = 0.005;
const STEPS: u32 = 20;
/// Nominal time of a solve, less than a period \[ns\].
const BUDGET_NS: u32 = 4_500_000;

const SOLVERS: [SolverKind; 2] = [SolverKind::KpsoRefined, SolverKind::GaussNewton];

const fn quanta(budget_ns: u32) -> u32 {
    budget_ns / QUANTUM_NS
}

/// Time of a period on the spiral at ten times its speed \[s\].
const FAST_S: f64 = 10.0 * PERIOD_S;

/// The spiral ends, or turns back: the extrapolated reference differs from the later one.
const ENDS: Curve = |robot, time_s| spiral(robot, f64::min(time_s, 99.0 * FAST_S));
const STOPS: Curve = |robot, time_s| spiral(robot, f64::min(time_s, 60.0 * FAST_S));
const TURNS: Curve = |robot, time_s| spiral(robot, 50.0 * FAST_S - (time_s - 50.0 * FAST_S).abs());
const STANDS: Curve = |robot, _| spiral(robot, FAST_S);

/// Half a second of a curve at ten times the speed of the spiral, among balls and capsules.
fn fast(solver: SolverKind, reference: Curve, steps: u32) -> Course {
    let course = Course::spiral(solver, 10.0, true).with_capsules(4);
    Course {
        reference,
        ..course.with_steps(steps).lasting(99)
    }
}

/// Name, course and largest mean error of the tip.
type CourseRow = (&'static str, fn(SolverKind) -> Course, f64);

/// On the spiral, a longer horizon accepts an early error for the part after it, which no plan can follow. A
/// horizon that sees the end of the curve follows it all.
#[test]
fn fast_curves_among_obstacles_are_followed_within_the_budget() {
    let rows: [CourseRow; 8] = [
        (
            "five times",
            |solver| Course::spiral(solver, 5.0, true),
            1e-7,
        ),
        (
            "the first cycles",
            |solver| Course::spiral(solver, 10.0, false).lasting(2),
            1e-8,
        ),
        (
            "seen early enough",
            |solver| fast(solver, spiral, 30),
            1.1e-4,
        ),
        ("an end, 35 steps", |solver| fast(solver, ENDS, 35), 1e-9),
        ("a stop", |solver| fast(solver, STOPS, STEPS), 1e-9),
        ("a turn", |solver| fast(solver, TURNS, STEPS), 1e-9),
        ("no motion", |solver| fast(solver, STANDS, STEPS), 1e-9),
        ("an end, 30 steps", |solver| fast(solver, ENDS, 30), 1e-9),
    ];
    for &(name, course, most_m) in crate::cases(7, &rows) {
        for solver in SOLVERS {
            let outcome = course(solver).run(quanta(BUDGET_NS));
            assert!(outcome.mean_m < most_m, "{name}, {solver:?}: {outcome:?}");
            assert!(outcome.spare_m > -1e-9, "{name}, {solver:?}: {outcome:?}");
        }
    }
}

/// 120 unknowns among 16 obstacles, and twice the time that the budget would leave: what one cycle does not
/// do, the next one does.
#[test]
fn the_work_of_a_solve_is_limited_and_the_curve_still_followed() {
    for (solver, most_quanta, most_m) in [
        (SolverKind::GaussNewton, 528, 3e-5),
        (SolverKind::KpsoRefined, 1214, 1e-5),
    ] {
        let outcome = fast(solver, spiral, STEPS).run(2 * quanta(BUDGET_NS));
        assert!(outcome.largest_work <= most_quanta + 1, "{outcome:?}");
        assert!(outcome.mean_m < most_m, "{solver:?}: {outcome:?}");
        assert!(outcome.spare_m > -1e-9, "{solver:?}: {outcome:?}");
    }
}

/// The first cycles at ten times the speed press on bounds in half of the steps. They took 192 quanta with a search.
#[test]
fn a_new_fast_plan_converges_without_a_search() {
    for solver in SOLVERS {
        let course = Course::spiral(solver, 10.0, false).lasting(2);
        let outcome = course.run(quanta(BUDGET_NS));
        assert!(outcome.largest_work < 120, "{solver:?}: {outcome:?}");
        assert!(outcome.mean_m < 1e-12, "{solver:?}: {outcome:?}");
    }
}

/// Blocks of several steps cannot follow a curve: 40 steps in 20 were 2 µm off, with four times the work.
#[test]
fn every_step_of_a_longer_horizon_has_rates_of_its_own() {
    for solver in SOLVERS {
        let [short, long] =
            [20, 40].map(|steps| Course::spiral(solver, 1.0, false).with_steps(steps));
        let [short, long] = [short, long].map(|course| course.run(quanta(BUDGET_NS)));
        assert!(long.mean_m < 1e-10, "{solver:?}: {long:?}");
        assert!(
            long.work < 3 * short.work,
            "{solver:?}: {long:?}, {short:?}"
        );
    }
}

/// A plan at the rounding of the tip's position is neither refined nor searched further.
#[test]
fn work_grows_no_faster_than_the_horizon() {
    for solver in SOLVERS {
        let [short, long] =
            [5, 50].map(|steps| Course::spiral(solver, 1.0, false).with_steps(steps));
        let [short, long] = [short, long].map(|course| course.run(quanta(BUDGET_NS)));
        assert!(long.mean_m < 1e-15, "{solver:?}: {long:?}");
        // N^1.15 at most.
        assert!(
            long.work < 14 * short.work,
            "{solver:?}: {long:?}, {short:?}"
        );
        // 134 quanta per cycle with the search, and 60 with a third step.
        assert!(long.work < 50 * 199, "{solver:?}: {long:?}");
    }
}

#[test]
fn more_time_is_never_worse_and_the_safe_distance_is_kept_with_any() {
    for solver in SOLVERS {
        for &speed in crate::cases(2, &[10.0, 3.0, 5.0, 1.0]) {
            let course = Course::spiral(solver, speed, true);
            let mut best_m = f64::INFINITY;
            for budget_ns in [20_000, 50_000, 100_000, 200_000, 500_000] {
                let outcome = course.run(quanta(budget_ns));
                let what = format!("{solver:?}, {speed} times, {budget_ns} ns: {outcome:?}");
                assert!(outcome.spare_m > -1e-9, "{what}");
                // Differences below a micrometre do not count.
                let most_m = 1.05 * f64::max(best_m, 1e-6);
                assert!(outcome.mean_m <= most_m, "{what}, at most {most_m}");
                best_m = best_m.min(outcome.mean_m);
            }
        }
    }
}

#[test]
fn more_time_brings_the_robot_no_later_to_a_far_point() {
    for solver in SOLVERS {
        let course = Course::jump(solver);
        let mut best_m = f64::INFINITY;
        for budget_ns in [50_000, 100_000, 200_000, 300_000, 500_000] {
            let Outcome { mean_m, .. } = course.run(quanta(budget_ns));
            let what = format!("{solver:?}, {budget_ns} ns: {mean_m} m, {best_m} before");
            assert!(mean_m <= 1.05 * best_m, "{what}");
            best_m = best_m.min(mean_m);
        }
    }
}

#[test]
fn a_budget_that_ends_before_the_way_round_leads_up_to_the_obstacles() {
    for solver in SOLVERS {
        for (speed, capsules, budget_ns) in [
            (5.0, false, 20_000),
            (10.0, false, 20_000),
            (3.0, true, 30_000),
        ] {
            let course = Course::spiral(solver, speed, true);
            let course = if capsules {
                course.with_capsules(4)
            } else {
                course
            };
            let course = Course {
                cycles: if capsules { 199 } else { 20 },
                ..course
            };
            let (outcome, at_rest_m) = (course.run(quanta(budget_ns)), course.mean_at_rest_m());
            let what = format!("{solver:?}, {speed} times: {outcome:?}, {at_rest_m} m at rest");
            assert!(outcome.mean_m < 0.9 * at_rest_m, "{what}");
            assert!(outcome.spare_m > -1e-9, "{what}");
        }
    }
}

/// A new plan among obstacles tries several ways. At any budget it costs no more than rest, reproducibly.
#[test]
fn a_new_plan_is_no_worse_than_rest_and_the_same_again_wherever_the_budget_ends() {
    let course = Course::jump(SolverKind::KpsoRefined);
    let goal_m = (course.reference)(&course.robot, 0.0).position_m;
    let tip_m = course.robot.tip_position(&course.at);
    let up_m = Vector3::new(0.0, 0.0, 0.3);
    let posts: Vec<_> = [-0.04, 0.0, 0.04]
        .map(|aside_m| {
            let start_m = (tip_m + goal_m) / 2.0 + Vector3::new(aside_m, aside_m, -0.15);
            let end_m = start_m + up_m;
            Obstacle::new(Shape::Capsule { start_m, end_m }, 0.005, Vector3::zeros()).unwrap()
        })
        .into();
    let window = [inside(goal_m); STEPS as usize];
    let solved = |quanta| {
        let mut nmpc = Nmpc::new(course.robot.clone(), PERIOD_S, course.settings).unwrap();
        let rest = BendRates::zero(3);
        let input = SolveInput {
            obstacles: &posts,
            seed: 7,
            ..input(&course.at, &rest, &window)
        };
        let (_, report) = nmpc.solve(&input, &mut Budget::from_quanta(quanta));
        (nmpc.plan().to_vec(), report)
    };
    for turn in 0..crate::repetitions(50, 400) {
        let quanta = 3000 * turn / crate::repetitions(50, 400);
        let (plan, report) = solved(quanta);
        assert!(report.cost <= report.warm_cost, "{quanta}: {report:?}");
        assert!(report.quanta <= quanta + 1, "{report:?}");
        let (again, same) = solved(quanta);
        assert_eq!((plan, report.cost), (again, same.cost), "{quanta}");
    }
    assert!(solved(3000).1.cost < 0.5 * solved(20).1.cost);
}

const HELD: [[f64; 2]; 3] = [[0.5, 0.0], [0.3, 1.0], [0.4, 2.0]];

/// A robot holds its tip at a goal for 0.3 s. Balls move towards the middle of its second section:
/// side ±1, initial gap beyond the safe distance (m), speed (m/s).
fn hold(solver: SolverKind, balls: &[(f64, f64, f64)]) -> Course {
    let course = Course::spiral(solver, 1.0, false);
    let (robot, at) = (&course.robot, Configuration::from_bend_angles(&HELD));
    let [before_m, middle_m, after_m] = [0.49, 0.5, 0.51].map(|s| robot.body_point(&at, 1, s));
    let aside = (after_m - before_m).cross(&Vector3::x()).normalize();
    let touching_m = robot.sections()[1].body_radius_m + course.settings.safe_distance_m + 0.01;
    let ball = |&(side, gap_m, speed_m_s): &(f64, f64, f64)| {
        let centre_m = middle_m + aside * side * (touching_m + gap_m);
        Obstacle::new(Shape::Sphere { centre_m }, 0.01, -speed_m_s * side * aside).unwrap()
    };
    Course {
        obstacles: balls.iter().map(ball).collect(),
        at,
        reference: |robot, _| inside(robot.tip_position(&Configuration::from_bend_angles(&HELD))),
        cycles: 60,
        ..course
    }
}

#[test]
fn a_robot_on_its_goal_makes_way() {
    for solver in SOLVERS {
        for budget_ns in [50_000, 200_000, BUDGET_NS] {
            let outcome = hold(solver, &[(1.0, 0.01, 0.1)]).run(quanta(budget_ns));
            let what = format!("{solver:?}, {budget_ns} ns: {outcome:?}");
            assert!(outcome.spare_m > -1e-9, "{what}");
            assert!(outcome.mean_m < 1e-6 && outcome.last_m < 1e-12, "{what}");
        }
    }
}

#[test]
fn a_robot_that_makes_way_sees_what_stands_on_the_other_side() {
    for solver in SOLVERS {
        let course = hold(solver, &[(1.0, 0.01, 0.1), (-1.0, 0.001, 0.0)]);
        for budget_ns in [200_000, BUDGET_NS] {
            let outcome = course.run(quanta(budget_ns));
            let what = format!("{solver:?}, {budget_ns} ns: {outcome:?}");
            assert!(outcome.spare_m > -1e-9, "{what}");
            // A truncated step leaves a fraction of a nanometre.
            let most_m = if budget_ns < BUDGET_NS { 1e-9 } else { 1e-13 };
            assert!(outcome.mean_m < most_m, "{what}");
        }
    }
}

#[test]
fn twenty_microseconds_move_the_robot() {
    for solver in SOLVERS {
        for speed in [1.0, 3.0, 5.0] {
            let outcome = Course::spiral(solver, speed, false).run(quanta(20_000));
            assert!(outcome.mean_m < 1e-6, "{solver:?}, {speed}: {outcome:?}");
        }
        for budget_ns in [20_000, 50_000] {
            let outcome = Course::jump(solver).run(quanta(budget_ns));
            assert!(outcome.last_m < 1e-6, "{solver:?}: {outcome:?}");
        }
        let course = Course::spiral(solver, 1.0, true);
        let at_rest_m = course.mean_at_rest_m();
        let outcome = course.run(quanta(20_000));
        let what = format!("{solver:?}: {outcome:?}, {at_rest_m} m at rest");
        assert!(outcome.mean_m < f64::min(0.01, at_rest_m), "{what}");
    }
}

#[test]
fn twenty_microseconds_move_the_robot_among_capsules() {
    for solver in SOLVERS {
        for speed in [3.0, 5.0, 10.0] {
            for every in [4, 2] {
                let course = Course::spiral(solver, speed, true).with_capsules(every);
                let start_m = course.robot.tip_position(&course.at);
                let outcome = course.run(quanta(20_000));
                let what = format!("{solver:?}, {speed} times, every {every}: {outcome:?}");
                assert!((outcome.tip_m - start_m).norm() > 0.01, "{what}");
                assert!(outcome.spare_m > -1e-9, "{what}");
            }
        }
    }
}

/// A warm start that the budget leaves unevaluated may lead into obstacles, one step further in each cycle.
#[test]
fn with_any_work_at_all_the_safe_distance_is_kept() {
    for solver in SOLVERS {
        for &(speed, every) in crate::cases(1, &[(3.0, 2), (5.0, 4), (10.0, 2), (3.0, 4)]) {
            for quanta in 0..quanta(70_000) {
                let course = Course::spiral(solver, speed, true).with_capsules(every);
                let outcome = course.run(quanta);
                let what = format!("{solver:?}, {speed} times, every {every}, {quanta} quanta");
                assert!(outcome.spare_m > -1e-9, "{what}: {outcome:?}");
            }
        }
    }
}

#[test]
fn an_interior_point_that_time_ends_leaves_what_it_found() {
    let course = Course::spiral(SolverKind::GaussNewton, 5.0, true).lasting(1);
    // With 10 quanta, the evaluated part of the plan costs 6 % less than the plan up to the balls.
    let costs: Vec<_> = (quanta(20_000)..600)
        .step_by(crate::repetitions(3, 1) as usize)
        .map(|quanta| course.run(quanta).first_cost)
        .collect();
    assert!(costs.is_sorted_by(|more, less| more >= less), "{costs:?}");
    let (first, last) = (costs[0], costs[costs.len() - 1]);
    let between = |cost: &&f64| **cost < 0.5 * first && **cost > 2.0 * last;
    let mut steps: Vec<_> = costs.iter().filter(between).collect();
    steps.dedup();
    // The start of the first step, and at least two points of its interior point method.
    assert!(steps.len() >= 3, "{steps:?}");
    assert!(last < 1e-9 * first, "{first} {last}");
}

#[test]
fn a_solve_that_its_budget_ends_anywhere_repeats_to_the_bit() {
    let course = Course::spiral(SolverKind::KpsoRefined, 5.0, true);
    let window: Vec<_> = (1..=STEPS)
        .map(|step| spiral(&course.robot, 5.0 * f64::from(step) * PERIOD_S))
        .collect();
    let rest = BendRates::zero(3);
    let solved = |budget: &mut Budget<'_>| {
        let mut nmpc = Nmpc::new(course.robot.clone(), PERIOD_S, course.settings).unwrap();
        let input = SolveInput {
            obstacles: &course.obstacles,
            seed: 0,
            ..input(&course.at, &rest, &window)
        };
        let (_, report) = nmpc.solve(&input, budget);
        let bits: Vec<_> = nmpc.plan().iter().map(|rate| rate.to_bits()).collect();
        (bits, report)
    };
    for asks_max in (0..400).step_by(7) {
        let mut asks = 0;
        let mut is_spent = || {
            asks += 1;
            asks > asks_max
        };
        let (plan, report) = solved(&mut Budget::new(&mut is_spent));
        let again = solved(&mut Budget::from_quanta(report.quanta));
        assert_eq!(again, (plan, report), "after {asks_max} looks at the clock");
    }
}
