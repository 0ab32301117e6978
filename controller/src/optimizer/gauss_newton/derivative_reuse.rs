//! Steps with the derivatives of an earlier point, for a tenth to a third of the time of others. They follow a step
//! that has nearly converged.

use super::{GaussNewton, dot};
use crate::optimizer::{Bounds, Budget, Incumbent, Problem};

/// Derivatives are used again if the step reduced the cost to this share: the residuals to a thousandth. With
/// a weight on the unknowns, it is the largest share of a step's gain that the next step may have.
const REUSE_SHARE: f64 = 1e-6;
/// Largest number of such steps after a linearised one.
const REUSED_STEPS_MAX: u32 = 3;
/// A cost below this multiple of the rounding cost needs no further linearisation,
const LINEARISED_ROUNDINGS: f64 = 4.0;
/// and below this multiple no further step.
pub(super) const REUSE_ROUNDINGS: f64 = 0.25;

/// The step whose derivatives are used again.
#[derive(Clone, Copy)]
pub(super) struct LinearisedStep {
    /// The cost at the linearisation.
    pub before: f64,
    /// The decrease of the cost predicted by the model.
    pub gain: f64,
    /// The cost below which no further step is taken. None: derivatives are not used again.
    pub solved: Option<f64>,
    pub damping: f64,
    /// [`GaussNewtonSettings::residuals_max`](super::GaussNewtonSettings::residuals_max).
    pub residuals_max: f64,
}

/// Whether the cost is at the level of rounding.
pub(super) fn is_rounding(rounding: Option<f64>, cost: f64) -> bool {
    rounding.is_some_and(|rounding| cost <= LINEARISED_ROUNDINGS * rounding)
}

impl GaussNewton {
    /// Continues after a linearised step. Returns the number of steps that improved the incumbent, and
    /// whether a further step would gain nothing.
    pub(super) fn reuse_derivatives<P: Problem>(
        &mut self,
        context: (&P, &Bounds, Option<f64>),
        linearised: LinearisedStep,
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
    ) -> (u32, bool) {
        let LinearisedStep {
            mut before,
            mut gain,
            solved,
            damping,
            residuals_max,
        } = linearised;
        let (Some(rounding), Some(solved)) = (context.2, solved) else {
            return (0, false);
        };
        let is_weighted = self.model.regulariser().is_some();
        if is_weighted {
            self.model.move_weighted_point(incumbent.z());
        }
        // With large remaining residuals, their curvature determines the minimum, and these derivatives do
        // not include it.
        let left = |(weight, distances)| incumbent.cost() - weight * dot(distances, distances);
        if self.model.regulariser().map_or(0.0, left) > residuals_max {
            return (0, false);
        }
        let is_reusable = |before: f64, cost: f64| {
            let serves = cost <= REUSE_SHARE * before || is_rounding(Some(rounding), cost);
            serves && cost > solved
        };
        let (mut accepted, mut converged) = (0, false);
        while accepted < REUSED_STEPS_MAX
            && self.has_trial_residuals
            && (is_weighted || is_reusable(before, incumbent.cost()))
        {
            before = incumbent.cost();
            let origin = incumbent.origin();
            let residuals = self.model.residuals_mut();
            residuals.copy_from_slice(&self.trial_residuals[..residuals.len()]);
            let is_better = self.with_trial(context, incumbent, origin, |own, trial| {
                let dimension = trial.base.len();
                if is_weighted {
                    own.model.move_weighted_point(trial.base);
                    own.model.gradient(&mut own.gradient[..dimension], budget)?;
                }
                own.solve_with_last_factors(dimension, damping, budget)
                    .then_some(())?;
                if is_weighted {
                    let most = REUSE_SHARE * gain;
                    gain = own.gain(dimension);
                    let is_gain_rounding = trial.is_gain_rounding(&own.step[..dimension], gain);
                    // An unknown at a bound may have to leave it, which requires new derivatives.
                    converged = is_gain_rounding && own.free.len() == dimension;
                    (!is_gain_rounding && gain <= most).then_some(())?;
                }
                trial.offer(&own.step[..dimension], 1.0, budget)
            });
            if is_better != Some(true) {
                break;
            }
            accepted += 1;
        }
        (accepted, converged)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::optimizer::gauss_newton::GaussNewtonSettings;
    use crate::optimizer::{Evaluation, LinearModel, RowStage, Simd, Stages};
    use crate::wide::Wide;

    /// r = (z₀ + 0.1 z₁² - 0.3, z₁ - 0.2 z₀² - 0.1, l + l z₀²), whose last residual remains, with a count of
    /// linearisations.
    struct Curved {
        left: f64,
        stages: Stages,
        is_staged: bool,
        rounding: Option<f64>,
        weight: f64,
        linearised: Cell<u32>,
    }

    impl Curved {
        fn residuals(&self, z: &[f64]) -> [f64; 3] {
            [
                z[0] + 0.1 * z[1] * z[1] - 0.3,
                z[1] - 0.2 * z[0] * z[0] - 0.1,
                self.left * (1.0 + z[0] * z[0]),
            ]
        }
    }

    impl Problem for Curved {
        fn stages(&self) -> &Stages {
            &self.stages
        }
        fn is_staged(&self) -> bool {
            self.is_staged
        }
        fn evaluate_below(&self, z: &[f64], _: f64, _: &mut Budget<'_>) -> Option<Evaluation<1>> {
            let squared = self.residuals(z).map(|residual| residual * residual);
            let rates = self.weight * (z[0] * z[0] + z[1] * z[1]);
            let cost = squared.iter().sum::<f64>() + rates;
            Some(Evaluation::from_cost(Wide([cost])))
        }
        fn rounding(&self) -> Option<f64> {
            self.rounding
        }
        fn least_cost(&self) -> Option<f64> {
            self.rounding.filter(|_| self.is_staged)
        }
        fn evaluate_residuals(
            &self,
            z: &[f64],
            residuals: &mut [f64],
            budget: &mut Budget<'_>,
        ) -> Option<Evaluation<1>> {
            residuals.copy_from_slice(&self.residuals(z));
            self.evaluate_at(z, budget)
        }
        fn linearise(&self, z: &[f64], model: &mut LinearModel, _: &mut Budget<'_>) -> bool {
            self.linearised.set(self.linearised.get() + 1);
            let [first, second, last] = self.residuals(z);
            model.push(first, &[1.0, 0.2 * z[1]], RowStage::FIRST_BLOCK);
            model.push(second, &[-0.4 * z[0], 1.0], RowStage::FIRST_BLOCK);
            model.push(last, &[2.0 * self.left * z[0], 0.0], RowStage::FIRST_BLOCK);
            if self.weight > 0.0 {
                model.weight_unknowns(self.weight, &[0.0; 2], z);
            }
            true
        }
    }

    /// Final cost from a start at this distance from the root, accepted steps, and linearisations.
    fn refined(beside: f64, others: [f64; 2], rounding: Option<f64>) -> (f64, u32, u32) {
        refined_as(false, beside, others, rounding)
    }

    fn refined_as(
        is_staged: bool,
        beside: f64,
        [weight, left]: [f64; 2],
        rounding: Option<f64>,
    ) -> (f64, u32, u32) {
        let problem = Curved {
            left,
            stages: Stages::one(2),
            is_staged,
            rounding,
            weight,
            linearised: Cell::new(0),
        };
        let mut bounds = Bounds::with_capacity(2);
        bounds.set_symmetric(std::iter::repeat_n(1.0, 2), 1);
        let start = [0.2986 + beside, 0.1178];
        let mut incumbent = Incumbent::with_capacity(2);
        let budget = &mut Budget::unlimited();
        incumbent.restart(&start, problem.evaluate_at(&start, budget).as_ref());
        let settings = GaussNewtonSettings {
            steps: 60,
            damping: 1e-14,
            step_tolerance: 0.0,
            is_rough: false,
            residuals_max: 1e-12,
        };
        let outcome = GaussNewton::with_capacity(Simd::best(), 2, 3, 3, 0).refine(
            &problem,
            &bounds,
            &settings,
            budget,
            &mut incumbent,
        );
        assert!(outcome.converged || rounding.is_none());
        (incumbent.cost(), outcome.accepted, problem.linearised.get())
    }

    #[test]
    fn near_the_end_derivatives_serve_more_than_once() {
        let rounding = f64::EPSILON * f64::EPSILON;
        for (is_staged, most) in [(false, LINEARISED_ROUNDINGS), (true, 1.0)] {
            for beside in [1e-4, -1e-4, 1e-3, 1e-2, 0.3] {
                let of = |rounding| refined_as(is_staged, beside, [0.0; 2], rounding);
                let (cost, accepted, linearised) = of(Some(rounding));
                assert!(cost <= most * rounding, "{beside}: {cost}");
                assert!(accepted > linearised, "{beside}: {linearised} times");
                let (_, _, each) = of(None);
                assert!(linearised < each, "{beside}: {linearised} of {each} times");
            }
        }
    }

    #[test]
    fn with_a_weight_on_the_unknowns_they_lead_to_the_least_cost_likewise() {
        let rounding = f64::EPSILON * f64::EPSILON;
        for (is_staged, beside) in [false, true]
            .into_iter()
            .flat_map(|staged| [1e-4, -1e-4, 1e-3, 1e-2, 0.3].map(|beside| (staged, beside)))
        {
            let of = |rounding| refined_as(is_staged, beside, [1e-8, 0.0], rounding);
            let (cost, _, linearised) = of(Some(rounding));
            let (least, _, each) = of(None);
            assert!(cost - least <= 1e-8 * least, "{beside}: {cost} {least}");
            assert!(linearised < each, "{beside}: {linearised} of {each} times");
        }
    }

    #[test]
    fn where_residuals_stay_old_derivatives_do_not_end_it() {
        let rounding = f64::EPSILON * f64::EPSILON;
        for beside in [1e-4, -1e-4, 1e-3, 1e-2, 0.3] {
            let (cost, ..) = refined(beside, [1e-8, 0.3], Some(rounding));
            let (least, ..) = refined(beside, [1e-8, 0.3], None);
            assert!(cost - least <= 1e-15 * least, "{beside}: {cost} {least}");
        }
    }

    #[test]
    fn what_is_at_its_end_is_not_linearised() {
        let (_, accepted, linearised) = refined(0.0, [0.0; 2], Some(1.0));
        assert_eq!([accepted, linearised], [0, 0]);
    }
}
