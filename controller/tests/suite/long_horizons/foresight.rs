//! Plans that are continued beyond their horizon.

use super::{BUDGET_NS, Course, SOLVERS, quanta};
use cdcr_controller::nmpc::SolverKind;

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
