//! Plans that are continued beyond their horizon.

use super::{BUDGET_NS, Course, PERIOD_S, SOLVERS, quanta, spiral};
use cdcr_controller::nmpc::SolverKind;
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::Robot;

/// Without foresight, twenty steps are 0.7 mm off: plans cost nothing until it is too late to turn.
#[test]
fn of_plans_that_cost_nothing_the_one_that_leads_on_is_taken() {
    for solver in SOLVERS {
        for &every in crate::cases(1, &[4, 17]) {
            let course = Course::spiral(solver, 10.0, true)
                .with_capsules(every)
                .lasting(99);
            let outcome = course.run(quanta(BUDGET_NS));
            assert!(outcome.mean_m < 5e-5, "{solver:?}, {every}: {outcome:?}");
            // Without foresight 534 and 1273 quanta per cycle; 969 with a search wherever an error is left.
            let most = if solver == SolverKind::GaussNewton {
                534
            } else {
                700
            };
            assert!(outcome.work < 99 * most, "{solver:?}, {every}: {outcome:?}");
            assert!(outcome.spare_m > -1e-9, "{solver:?}, {every}: {outcome:?}");
        }
    }
}

/// The extrapolated reference may differ from the later one.
#[test]
fn a_fast_curve_that_stops_or_turns_back_is_followed_all_the_same() {
    const PERIODS: f64 = 10.0 * PERIOD_S;
    let stops: fn(&Robot, f64) -> ReferenceSample =
        |robot, time_s| spiral(robot, f64::min(time_s, 60.0 * PERIODS));
    let turns: fn(&Robot, f64) -> ReferenceSample = |robot, time_s| {
        let until_s = 50.0 * PERIODS;
        spiral(robot, until_s - (time_s - until_s).abs())
    };
    let stands: fn(&Robot, f64) -> ReferenceSample = |robot, _| spiral(robot, PERIODS);
    for solver in SOLVERS {
        for reference in [stops, turns, stands] {
            let course = Course::spiral(solver, 10.0, true).with_capsules(4);
            let course = Course {
                reference,
                cycles: 99,
                ..course
            };
            let outcome = course.run(quanta(BUDGET_NS));
            assert!(outcome.mean_m < 1e-9, "{solver:?}: {outcome:?}");
            assert!(outcome.spare_m > -1e-9, "{solver:?}: {outcome:?}");
        }
    }
}
