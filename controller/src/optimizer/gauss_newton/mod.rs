//! Damped Gauss-Newton steps, projected on the box.

mod dense;
mod derivative_reuse;
mod interior_point;
mod riccati;
mod smoother;
mod step;
mod trial;

use derivative_reuse::{LinearisedStep, REUSE_ROUNDINGS, is_rounding};
use interior_point::InteriorPoint;
use riccati::Riccati;
use smoother::{QuadraticTerm, Smoother};
pub(crate) use trial::FoundStep;
use trial::Trial;

use super::products::dot;
use super::{Bounds, Budget, Candidate, Incumbent, LinearModel, Problem, Simd};

/// Settings of [`GaussNewton`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GaussNewtonSettings {
    /// Largest number of steps.
    pub(crate) steps: u32,
    /// Damping λ, in the scale of JᵀJ.
    pub(crate) damping: f64,
    /// A step whose largest component is at most this counts as converged.
    pub(crate) step_tolerance: f64,
    /// Whether another refinement follows. Then the interior point ends with the first step that is better,
    /// and the refinement ends when steps gain next to nothing.
    pub(crate) is_rough: bool,
    /// Largest sum of squared residuals, beside a weight on the unknowns, for which old derivatives are
    /// accurate enough.
    pub(crate) residuals_max: f64,
}

/// Outcome of a refinement.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct GaussNewtonOutcome {
    /// Steps that improved the incumbent.
    pub(crate) accepted: u32,
    /// Whether the last step was below the tolerance, or rounding would hide a further gain.
    pub(crate) converged: bool,
    /// Norm of the projected gradient at the last linearisation.
    pub(crate) gradient_norm: f64,
    /// Whether that gradient nearly vanishes in relation to the residuals, so that no first-order step helps.
    pub(crate) is_stationary: bool,
}

/// Minimum-norm damped steps Δ = -Jᵀ(J Jᵀ + λI)⁻¹ r, or the equal Δ = -(JᵀJ + λI)⁻¹ Jᵀ r when there are more
/// residuals than unknowns. This is Levenberg-Marquardt (Nocedal & Wright, *Numerical Optimization*, ch. 10),
/// with an active set for the box.
///
/// The minimum-norm form has no weight on the unknowns. So the cost can reach zero, and the motion is spread
/// over all sections.
#[derive(Debug)]
pub(crate) struct GaussNewton {
    model: LinearModel,
    gradient: Vec<f64>,
    /// Upper bound of half the norm of the gradient, from the norms of J and r.
    gradient_scale: f64,
    /// Unknowns at a bound with the gradient pointing out of the box; they stay there.
    at_active_bound: Vec<bool>,
    /// Unknowns of the linear system.
    free: Vec<usize>,
    /// For each of them, the ratio of step and distance to the bound (`excess`), from the last `excess_max` that looked at all.
    excesses: Vec<f64>,
    step: Vec<f64>,
    /// The point of linearisation.
    base: Vec<f64>,
    trial_point: Vec<f64>,
    /// The residuals of the last evaluated point.
    trial_residuals: Vec<f64>,
    /// Whether that point is the incumbent.
    has_trial_residuals: bool,
    residuals: Vec<f64>,
    right_side: Vec<f64>,
    matrix: Vec<f64>,
    /// Number of free unknowns in the factorised matrix.
    factored: usize,
    /// The columns of the free unknowns, when there are at most as many rows.
    columns: Vec<f64>,
    /// JᵀJ of the cost's rows, computed when first needed.
    gram: Vec<f64>,
    gram_is_current: bool,
    /// Linear solver for staged rows.
    smoother: Smoother,
    /// Faster linear solver for staged rows, for unknowns with a sufficient weight.
    riccati: Riccati,
    /// For staged steps that violate constraints.
    interior_point: InteriorPoint,
}

/// Largest number of halvings in the line search.
const HALVINGS: u32 = 4;
/// A gradient below this share of its upper bound counts as vanished.
const STATIONARY_SHARE: f64 = 0.05;
/// A rough refinement continues while steps reduce the cost by this share.
const ROUGH_GAIN: f64 = 1e-3;
/// Factor on the damping after a step without improvement.
const DAMPING_GROWTH: f64 = 1e3;

impl GaussNewton {
    /// Memory for problems of up to `dimension` unknowns, `dense` of them in dense rows, `rows` residuals and
    /// `constraints`, solved with the instructions of `simd`.
    pub(crate) fn with_capacity(
        simd: Simd,
        dimension: usize,
        dense: usize,
        rows: usize,
        constraints: usize,
    ) -> Self {
        let all_rows = rows + constraints;
        let order = dense.min(all_rows);
        Self {
            model: LinearModel::with_capacity(rows, constraints, dense, dimension),
            gradient: vec![0.0; dimension],
            gradient_scale: 0.0,
            at_active_bound: vec![false; dimension],
            free: Vec::with_capacity(dimension),
            excesses: Vec::with_capacity(dimension),
            step: vec![0.0; dimension],
            base: Vec::with_capacity(dimension),
            trial_point: Vec::with_capacity(dimension),
            trial_residuals: vec![0.0; rows],
            has_trial_residuals: false,
            residuals: vec![0.0; all_rows],
            right_side: vec![0.0; order],
            matrix: vec![0.0; order * order],
            factored: 0,
            columns: vec![0.0; order * dense],
            gram: vec![0.0; dense * dense],
            gram_is_current: false,
            smoother: Smoother::with_capacity(simd, all_rows),
            riccati: Riccati::with_capacity(dimension),
            interior_point: InteriorPoint::with_capacity(dimension, constraints),
        }
    }

    /// Improves the incumbent by at most `settings.steps` steps while the budget lasts.
    pub(crate) fn refine<P: Problem>(
        &mut self,
        problem: &P,
        bounds: &Bounds,
        settings: &GaussNewtonSettings,
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
    ) -> GaussNewtonOutcome {
        let mut outcome = GaussNewtonOutcome::default();
        let mut damping = settings.damping;
        let mut model_is_current = false;
        let (rounding, least) = (problem.rounding(), problem.least_cost());
        let is_solved = |cost| match least {
            Some(least) => cost <= least,
            None => is_rounding(rounding, cost),
        };
        for _ in 0..settings.steps {
            if is_solved(incumbent.cost()) || !budget.begin_quantum() {
                break;
            }
            if !model_is_current {
                if !self.linearise(problem, bounds, incumbent.z(), budget) {
                    break;
                }
                outcome.gradient_norm = self.gradient_norm(problem.dimension());
                outcome.is_stationary = self.is_gradient_vanished(outcome.gradient_norm);
            }
            let origin = incumbent.origin();
            let before = incumbent.cost();
            let context = (problem, bounds, rounding);
            let mut gain = 0.0;
            let is_last = self.with_trial(context, incumbent, origin, |own, trial| {
                trial.step_tolerance = settings.step_tolerance;
                trial.is_followed = true;
                trial.is_rough = settings.is_rough;
                let found = own.find_step(trial, damping, budget);
                let step = &own.step[..trial.base.len()];
                gain = own.gain(step.len());
                let is_gain_rounding =
                    found == FoundStep::NotEvaluated && trial.is_gain_rounding(step, gain);
                let is_small = is_gain_rounding || trial.is_small(step);
                // The point found on the way to a small step has not been linearised.
                let is_last =
                    found != FoundStep::Nothing && is_small && trial.incumbent.cost() >= before;
                if found == FoundStep::NotEvaluated && !is_small {
                    let _ = trial.backtrack(step, 1.0, HALVINGS, budget);
                } else if is_last && !is_gain_rounding && !own.model.is_staged() {
                    // The tip error may still be 10⁻¹⁵ m.
                    let _ = trial.backtrack(step, 1.0, 0, budget);
                }
                is_last
            });
            let improved = incumbent.cost() < before;
            outcome.accepted += u32::from(improved);
            if is_last {
                outcome.converged = true;
                break;
            }
            if improved {
                let linearised = LinearisedStep {
                    before,
                    gain,
                    solved: least.or(rounding.map(|cost| REUSE_ROUNDINGS * cost)),
                    damping,
                    residuals_max: settings.residuals_max,
                };
                let (accepted, converged) =
                    self.reuse_derivatives(context, linearised, budget, incumbent);
                outcome.accepted += accepted;
                if converged {
                    outcome.converged = true;
                    break;
                }
            }
            let gains = incumbent.cost() < (1.0 - ROUGH_GAIN) * before;
            if settings.is_rough && !gains && (improved || damping > settings.damping) {
                break;
            }
            model_is_current = !improved;
            damping = if improved {
                settings.damping
            } else {
                damping * DAMPING_GROWTH
            };
        }
        outcome.converged |= is_solved(incumbent.cost());
        outcome
    }

    /// One damped step from the incumbent, for the least-squares particle of the swarm. The incumbent adopts
    /// better points evaluated on the way. `into` is unchanged when no step was found.
    pub(crate) fn propose<P: Problem>(
        &mut self,
        problem: &P,
        bounds: &Bounds,
        damping: f64,
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
        into: &mut [f64],
    ) -> FoundStep {
        if !self.linearise(problem, bounds, incumbent.z(), budget) {
            return FoundStep::Nothing;
        }
        let origin = Candidate::LeastSquares;
        self.with_trial((problem, bounds, None), incumbent, origin, |own, trial| {
            let found = own.find_step(trial, damping, budget);
            if found != FoundStep::Nothing {
                trial.compute_point(&own.step[..into.len()], 1.0);
                into.copy_from_slice(trial.point);
            }
            found
        })
    }

    /// Calls `tried` with a trial from the incumbent. The trial has residuals if the problem has a
    /// `rounding`.
    fn with_trial<P: Problem, R>(
        &mut self,
        (problem, bounds, rounding): (&P, &Bounds, Option<f64>),
        incumbent: &mut Incumbent,
        origin: Candidate,
        tried: impl FnOnce(&mut Self, &mut Trial<P>) -> R,
    ) -> R {
        let vectors = [
            &mut self.base,
            &mut self.trial_point,
            &mut self.trial_residuals,
        ];
        let [mut base, mut point, mut trial_residuals] = vectors.map(core::mem::take);
        let rows = self.model.cost_rows();
        base.clear();
        base.extend_from_slice(incumbent.z());
        let mut trial = Trial {
            problem,
            bounds,
            base: &base,
            point: &mut point,
            incumbent,
            origin,
            step_tolerance: 0.0,
            is_followed: false,
            is_rough: false,
            residuals: rounding.map(|_| &mut trial_residuals[..rows]),
            is_last_better: false,
        };
        let result = tried(self, &mut trial);
        self.has_trial_residuals = trial.is_last_better;
        (self.base, self.trial_point, self.trial_residuals) = (base, point, trial_residuals);
        result
    }

    /// Linearises at `z` and marks the unknowns pressed on a bound. False: the budget was spent.
    fn linearise<P: Problem>(
        &mut self,
        problem: &P,
        bounds: &Bounds,
        z: &[f64],
        budget: &mut Budget<'_>,
    ) -> bool {
        let dimension = z.len();
        self.model.clear(problem.stages(), problem.is_staged());
        self.gram_is_current = false;
        // For staged rows, constraints are requested once the size of the step is known.
        let is_left = problem.linearise(z, &mut self.model, budget)
            && (problem.is_staged() || problem.constrain(z, None, &mut self.model, budget));
        if !is_left {
            return false;
        }
        let gradient = &mut self.gradient[..dimension];
        let Some(scale) = self.model.gradient(gradient, budget) else {
            return false;
        };
        self.gradient_scale = scale;
        for i in 0..dimension {
            let at_lower = z[i] <= bounds.lower()[i] && self.gradient[i] > 0.0;
            let at_upper = z[i] >= bounds.upper()[i] && self.gradient[i] < 0.0;
            self.at_active_bound[i] = at_lower || at_upper;
        }
        true
    }

    /// Whether the gradient at `z` nearly vanishes in relation to the residuals. False also when the budget
    /// was spent.
    pub(crate) fn is_stationary_at<P: Problem>(
        &mut self,
        problem: &P,
        bounds: &Bounds,
        budget: &mut Budget<'_>,
        z: &[f64],
    ) -> bool {
        self.linearise(problem, bounds, z, budget) && {
            let norm = self.gradient_norm(z.len());
            self.is_gradient_vanished(norm)
        }
    }

    /// Decrease of the cost by the step, according to the model.
    fn gain(&self, dimension: usize) -> f64 {
        -dot(&self.gradient[..dimension], &self.step[..dimension])
    }

    fn is_gradient_vanished(&self, gradient_norm: f64) -> bool {
        gradient_norm <= STATIONARY_SHARE * 2.0 * self.gradient_scale
    }

    /// Norm of the gradient 2 Jᵀr without the unknowns pressed on a bound.
    fn gradient_norm(&self, dimension: usize) -> f64 {
        let entries = self.gradient[..dimension].iter().zip(&self.at_active_bound);
        let squares = entries
            .filter(|(_, at_active_bound)| !**at_active_bound)
            .map(|(g, _)| g * g);
        2.0 * squares.sum::<f64>().sqrt()
    }
}

#[cfg(test)]
mod tests;
