use super::*;
use crate::optimizer::{Evaluation, RowStage, Stages};
use crate::wide::Wide;

/// Settings of all tests.
const SETTINGS: GaussNewtonSettings = GaussNewtonSettings {
    steps: 9,
    damping: 1e-9,
    step_tolerance: 0.0,
    is_rough: false,
    residuals_max: 1e-12,
};

/// |r|² with r = (z₀² + z₁ - 1, 10 (z₁ - z₀)): zero at z₀ = z₁ = (√5 - 1)/2.
struct Bowl {
    stages: Stages,
}

fn bowl(unknowns: usize) -> Bowl {
    Bowl {
        stages: Stages::one(unknowns),
    }
}

impl Problem for Bowl {
    fn stages(&self) -> &Stages {
        &self.stages
    }
    fn is_staged(&self) -> bool {
        false
    }
    fn evaluate_below(&self, z: &[f64], _: f64, budget: &mut Budget<'_>) -> Option<Evaluation<1>> {
        let first = z[0] * z[0] + z[1] - 1.0;
        let second = (z[1] - z[0]) * 10.0;
        let evaluation = Evaluation::from_cost(Wide([first * first + second * second]));
        budget.spend(100).then_some(evaluation)
    }
    fn linearise(&self, z: &[f64], model: &mut LinearModel, budget: &mut Budget<'_>) -> bool {
        let bend = z[0] * z[0] + z[1] - 1.0;
        model.push(bend, &[2.0 * z[0], 1.0], RowStage::FIRST_BLOCK);
        model.push(10.0 * (z[1] - z[0]), &[-10.0, 10.0], RowStage::FIRST_BLOCK);
        budget.spend(10)
    }
}

fn refine(problem: &Bowl, half_width: f64, steps: u32) -> (Incumbent, GaussNewtonOutcome) {
    let mut bounds = Bounds::with_capacity(3);
    bounds.set_symmetric(std::iter::repeat_n(half_width, problem.dimension()), 1);
    let mut incumbent = Incumbent::with_capacity(3);
    let start = [0.0; 3];
    let start = &start[..problem.dimension()];
    incumbent.restart(
        start,
        problem
            .evaluate_at(start, &mut Budget::unlimited())
            .as_ref(),
    );
    let settings = GaussNewtonSettings {
        steps,
        step_tolerance: 1e-12,
        ..SETTINGS
    };
    let outcome = GaussNewton::with_capacity(Simd::best(), 3, 3, 2, 0).refine(
        problem,
        &bounds,
        &settings,
        &mut Budget::unlimited(),
        &mut incumbent,
    );
    (incumbent, outcome)
}

#[test]
fn both_forms_of_the_step_find_the_root() {
    let root = (5.0_f64.sqrt() - 1.0) / 2.0;
    for unknowns in [2, 3] {
        let (incumbent, outcome) = refine(&bowl(unknowns), 5.0, 12);
        assert!(outcome.converged, "{outcome:?}");
        assert!(
            (incumbent.z()[0] - root).abs() < 1e-10,
            "{:?}",
            incumbent.z()
        );
        assert!(incumbent.cost() < 1e-18);
    }
}

/// r = (x + y - 1.5, y + 0.5, 3 - 12 y²), with x and y the first unknowns of two blocks. At (1, 0), with the
/// upper bound 1, no first-order step helps, but y = -0.5 does.
struct Ridge {
    stages: Stages,
}

impl Ridge {
    fn residuals(z: &[f64]) -> [f64; 3] {
        [z[0] + z[2] - 1.5, z[2] + 0.5, 3.0 - 12.0 * z[2] * z[2]]
    }
}

impl Problem for Ridge {
    fn stages(&self) -> &Stages {
        &self.stages
    }
    fn is_staged(&self) -> bool {
        true
    }
    fn evaluate_below(&self, z: &[f64], _: f64, _: &mut Budget<'_>) -> Option<Evaluation<1>> {
        let cost = Self::residuals(z).iter().map(|r| r * r).sum();
        Some(Evaluation::from_cost(Wide([cost])))
    }
    fn linearise(&self, z: &[f64], model: &mut LinearModel, _: &mut Budget<'_>) -> bool {
        let [sum, second, ridge] = Self::residuals(z);
        let since_start = RowStage {
            block: 1,
            ..RowStage::FIRST_BLOCK
        };
        let alone = RowStage {
            since_start: false,
            ..since_start
        };
        model.push(sum, &[1.0, 0.0], since_start);
        model.push(second, &[1.0, 0.0], alone);
        model.push(ridge, &[-24.0 * z[2], 0.0], alone);
        true
    }
}

#[test]
fn a_point_that_was_found_on_the_way_to_a_small_step_is_linearised() {
    let problem = Ridge {
        stages: Stages::new(2, 1.0, [1, 1].into_iter()),
    };
    let mut bounds = Bounds::with_capacity(4);
    bounds.set_symmetric([1.0, 1.0].into_iter(), 2);
    // So near the bound that the step to it is small, but not on it.
    let start = [1.0 - 1e-13, 0.0, 0.0, 0.0];
    let mut incumbent = Incumbent::with_capacity(4);
    let budget = &mut Budget::unlimited();
    incumbent.restart(&start, problem.evaluate_at(&start, budget).as_ref());
    let settings = GaussNewtonSettings {
        steps: 20,
        step_tolerance: 1e-12,
        ..SETTINGS
    };
    let outcome = GaussNewton::with_capacity(Simd::best(), 4, 4, 3, 0).refine(
        &problem,
        &bounds,
        &settings,
        budget,
        &mut incumbent,
    );
    assert!(incumbent.z()[2] < -0.4, "{:?}", incumbent.z());
    assert!(outcome.gradient_norm < 1e-4, "{outcome:?}");
    assert!(outcome.converged && outcome.accepted > 1, "{outcome:?}");
}

#[test]
fn a_small_step_is_the_last_one_and_taken() {
    let problem = bowl(2);
    let mut bounds = Bounds::with_capacity(2);
    bounds.set_symmetric(std::iter::repeat_n(1.0, 2), 1);
    let root = (5.0_f64.sqrt() - 1.0) / 2.0;
    let mut incumbent = Incumbent::with_capacity(2);
    let budget = &mut Budget::unlimited();
    let start = [root + 1e-6, root];
    incumbent.restart(&start, problem.evaluate_at(&start, budget).as_ref());
    let settings = GaussNewtonSettings {
        damping: 1e-14,
        step_tolerance: 1e-5,
        ..SETTINGS
    };
    let mut gauss_newton = GaussNewton::with_capacity(Simd::best(), 2, 2, 2, 0);
    let outcome = gauss_newton.refine(&problem, &bounds, &settings, budget, &mut incumbent);
    assert!(outcome.converged && outcome.accepted == 1, "{outcome:?}");
    assert!(incumbent.cost() < 1e-20, "{}", incumbent.cost());
}

#[test]
fn an_active_bound_is_kept_and_the_others_are_solved_for() {
    // With both in [-0.5, 0.5], the minimum is the corner z₀ = z₁ = 0.5.
    let (incumbent, _) = refine(&bowl(2), 0.5, 20);
    assert!((incumbent.z()[0] - 0.5).abs() < 1e-3, "{:?}", incumbent.z());
    assert!(incumbent.z().iter().all(|z| z.abs() <= 0.5));
}

#[test]
fn a_spent_budget_leaves_the_warm_start() {
    let problem = bowl(2);
    let mut bounds = Bounds::with_capacity(2);
    bounds.set_symmetric(std::iter::repeat_n(1.0, 2), 1);
    let mut incumbent = Incumbent::with_capacity(2);
    let start = [0.1, 0.2];
    incumbent.restart(
        &start,
        problem
            .evaluate_at(&start, &mut Budget::unlimited())
            .as_ref(),
    );

    GaussNewton::with_capacity(Simd::best(), 2, 2, 2, 0).refine(
        &problem,
        &bounds,
        &SETTINGS,
        &mut Budget::from_quanta(0),
        &mut incumbent,
    );
    assert_eq!(incumbent.z(), [0.1, 0.2]);
}
