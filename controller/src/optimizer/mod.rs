//! Minimisers over a box, with a budget.
//!
//! Two algorithms share one `Incumbent`: `Kpso` searches (Eq. 6-7 of the paper), and `GaussNewton` refines.
//! Both are *anytime*: they check a [`Budget`] between small pieces of work. When the budget ends, the best
//! point so far is in the incumbent, whose cost never increases.
//!
//! Invariant: nothing here knows a robot, a reference or a clock. A `Cost` is a function over a box; a
//! `Problem` also has derivatives. Time enters as the closure of the budget. Nothing allocates after
//! construction.

mod bounds;
mod budget;
mod cholesky;
mod gauss_newton;
mod incumbent;
mod kpso;
mod linear_model;
mod products;
mod random;
mod simd;
mod stages;

pub(crate) use bounds::Bounds;
pub use budget::{Budget, QUANTUM_NS};
pub(crate) use gauss_newton::{FoundStep, GaussNewton, GaussNewtonOutcome, GaussNewtonSettings};
pub use incumbent::Candidate;
pub(crate) use incumbent::Incumbent;
pub(crate) use kpso::{Kpso, KpsoSettings, SwarmTask};
pub use kpso::{VelocityRule, cycle_seed};
pub(crate) use linear_model::LinearModel;
pub use simd::Simd;
pub(crate) use simd::run_outlined;
pub(crate) use stages::{BLOCKS_MAX, RowStage, Stages, WIDTH_MAX};

use crate::wide::{Aligned, Wide};

/// Kinds of constraints that a problem can distinguish.
pub(crate) const VIOLATIONS: usize = 2;

/// Result of evaluating a problem at W points at once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Evaluation<const W: usize> {
    /// The cost, penalties included; ≥ 0. It may be infinite or NaN at an invalid point; such a point never
    /// becomes the incumbent.
    pub(crate) cost: Wide<W>,
    /// Violation of each kind of constraint, in the units of the problem; 0: satisfied.
    pub(crate) violations: [Wide<W>; VIOLATIONS],
}

impl<const W: usize> Evaluation<W> {
    /// A cost without constraints.
    #[inline(always)]
    pub(crate) fn from_cost(cost: Wide<W>) -> Self {
        Self {
            cost,
            violations: [Wide::splat(0.0); VIOLATIONS],
        }
    }
}

/// A cost over a box, evaluated at many points, for the swarm.
pub(crate) trait Cost {
    /// Evaluates W points at once; `z(i)` is the i-th unknown of each, and `scratch` has one element for each
    /// unknown. None when `budget` ended the evaluation.
    ///
    /// Implementations are `#[inline(always)]` down to the last operation, or to the functions run [outlined](run_outlined)
    /// with the caller's `instructions`. Each lane must give the bits of W = 1.
    fn evaluate<const W: usize>(
        &self,
        z: impl Fn(usize) -> Wide<W>,
        scratch: &mut [Aligned<W>],
        budget: &mut Budget<'_>,
        instructions: impl pulp::Simd,
    ) -> Option<Evaluation<W>>;
}

/// Region for which constraints are needed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach<'a> {
    /// The step inside the box.
    pub(crate) step: &'a [f64],
    /// Steps are at most this many times as long as `step`,
    pub(crate) times: f64,
    /// or long enough to repair these violations of the base point ([`Evaluation::violations`]).
    pub(crate) violations: [f64; VIOLATIONS],
}

/// A cost over a box, evaluated point by point, with its least-squares structure.
pub(crate) trait Problem {
    /// Number of unknowns d.
    fn dimension(&self) -> usize {
        self.stages().unknowns()
    }

    /// The blocks of the unknowns.
    fn stages(&self) -> &Stages;

    /// Whether the rows are staged: each has a [`RowStage`].
    fn is_staged(&self) -> bool;

    /// Evaluates one point of length d. May stop early once the cost is known to exceed `cost_cutoff`. None when
    /// `budget` ended the evaluation.
    fn evaluate_below(
        &self,
        z: &[f64],
        cost_cutoff: f64,
        budget: &mut Budget<'_>,
    ) -> Option<Evaluation<1>>;

    /// Evaluates one point of length d. None as above.
    fn evaluate_at(&self, z: &[f64], budget: &mut Budget<'_>) -> Option<Evaluation<1>> {
        self.evaluate_below(z, f64::INFINITY, budget)
    }

    /// The cost that rounding leaves. Some only if the cost contains residuals and a weight on the unknowns
    /// but no constraints, and residuals are much cheaper than derivatives.
    fn rounding(&self) -> Option<f64> {
        None
    }

    /// The cost at which a staged problem is solved: what rounding leaves.
    fn least_cost(&self) -> Option<f64> {
        None
    }

    /// Evaluates one point of such a cost. Writes the residuals in the order of the rows of
    /// [`Self::linearise`], up to the length of the slice. None as above.
    fn evaluate_residuals(
        &self,
        _z: &[f64],
        _residuals: &mut [f64],
        _budget: &mut Budget<'_>,
    ) -> Option<Evaluation<1>> {
        None
    }

    /// Evaluates one point up to the place where it violates a constraint more than the incumbent does, or
    /// where `budget` ends; from there on it changes `z`. Returns whether `z` is unchanged. None as above, if
    /// no evaluation is left. A problem without constraints changes nothing. Residuals, of which only a problem
    /// with [`Self::rounding`] has some, are written as by [`Self::evaluate_residuals`] if `z` is unchanged.
    fn evaluate_until_violation(
        &self,
        z: &mut [f64],
        incumbent: &Incumbent,
        residuals: &mut [f64],
        budget: &mut Budget<'_>,
    ) -> Option<(Evaluation<1>, bool)> {
        let evaluation = if residuals.is_empty() {
            self.evaluate_below(z, incumbent.cost(), budget)
        } else {
            self.evaluate_residuals(z, residuals, budget)
        };
        Some((evaluation?, true))
    }

    /// Writes residuals r and Jacobian J with cost(z + Δ) ≈ |r + J Δ|² into `model`. False when `budget`
    /// ended it; then the model is incomplete.
    fn linearise(&self, z: &[f64], model: &mut LinearModel, budget: &mut Budget<'_>) -> bool;

    /// Writes the constraints h + A Δ ≥ 0 into `model`: all that a step in the box can violate, or at least
    /// those within `reach`. False as above. The default has no constraints.
    fn constrain(
        &self,
        _z: &[f64],
        _reach: Option<Reach>,
        _model: &mut LinearModel,
        _budget: &mut Budget<'_>,
    ) -> bool {
        true
    }
}
