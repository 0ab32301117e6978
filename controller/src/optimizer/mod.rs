//! Minimisers over a box, with a budget.
//!
//! Two algorithms that share one `Incumbent`: `Kpso` searches (Eq. 6-7 of the paper), and
//! `GaussNewton` finishes. Both are *anytime*: they check a [`Budget`] between small pieces of work
//! and whatever is best when it is spent stays in the incumbent, which never gets worse.
//!
//! Invariant: nothing here knows a robot, a reference or a clock. A `Cost` is a function over a box, a
//! `Problem` has derivatives, too; time comes in as the closure of the budget. Nothing allocates after construction.

mod bounds;
mod budget;
mod cholesky;
mod gauss_newton;
mod incumbent;
mod kpso;
mod linear_model;
mod random;
mod simd;
mod stages;

pub(crate) use bounds::Bounds;
pub use budget::{Budget, QUANTUM_NS};
pub(crate) use gauss_newton::{Found, GaussNewton, GaussNewtonOutcome, GaussNewtonSettings};
pub use incumbent::Candidate;
pub(crate) use incumbent::Incumbent;
pub(crate) use kpso::{Kpso, KpsoSettings, Task};
pub use kpso::{VelocityRule, cycle_seed};
pub(crate) use linear_model::{LinearModel, Place};
pub use simd::Simd;
pub(crate) use simd::apart;
pub(crate) use stages::{BLOCKS_MAX, Stages, WIDTH_MAX};

use crate::wide::{Aligned, Wide};

/// Kinds of constraints that a problem may tell apart.
pub(crate) const VIOLATIONS: usize = 2;

/// What the evaluation of a problem gives for W points side by side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Evaluation<const W: usize> {
    /// The cost, penalties included; ≥ 0. It may be infinite or NaN where a point makes no sense; such
    /// a point never becomes the incumbent.
    pub(crate) cost: Wide<W>,
    /// How far each kind of constraint is broken, in units of the problem's; 0: it holds.
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

/// A cost over a box, for many points: what a swarm searches.
pub(crate) trait Cost {
    /// Evaluates W points side by side, `z(i)` being the i-th unknown of each, with memory for as many numbers of each as there are
    /// unknowns. None when `budget` was spent on the way.
    ///
    /// Implementations are `#[inline(always)]` down to the last operation, or to what they run [`apart`] with
    /// `instructions`: these are those of the caller. Each lane must give the bits of W = 1.
    fn evaluate<const W: usize>(
        &self,
        z: impl Fn(usize) -> Wide<W>,
        scratch: &mut [Aligned<W>],
        budget: &mut Budget<'_>,
        instructions: impl pulp::Simd,
    ) -> Option<Evaluation<W>>;
}

/// How far the steps go that are to keep the constraints.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach<'a> {
    /// The step in the box.
    pub(crate) step: &'a [f64],
    /// They go at most so many times as far as that one,
    pub(crate) times: f64,
    /// or as far as mends what their start breaks: [`Evaluation::violations`].
    pub(crate) violations: [f64; VIOLATIONS],
}

/// A cost over a box, point by point, and its least-squares structure.
pub(crate) trait Problem {
    /// Number of unknowns d.
    fn dimension(&self) -> usize {
        self.stages().unknowns()
    }

    /// The blocks of its unknowns.
    fn stages(&self) -> &Stages;

    /// Whether its rows are to be kept staged: each has a [`Place`].
    fn is_staged(&self) -> bool;

    /// Evaluates one point of length d; one that costs more than `enough` perhaps only so far that this is known. None when `budget` was spent
    /// on the way.
    fn evaluate_below(
        &self,
        z: &[f64],
        enough: f64,
        budget: &mut Budget<'_>,
    ) -> Option<Evaluation<1>>;

    /// Evaluates one point of length d. None as above.
    fn evaluate_at(&self, z: &[f64], budget: &mut Budget<'_>) -> Option<Evaluation<1>> {
        self.evaluate_below(z, f64::INFINITY, budget)
    }

    /// The cost that rounding alone leaves, where a cost is that of residuals and perhaps of a weight on the unknowns, without constraints, and residuals take little time beside their derivatives. None: it is not.
    fn rounding(&self) -> Option<f64> {
        None
    }

    /// Evaluates one point of such a cost, and writes its residuals in the order of the rows of [`Self::linearise`], as far as there is room. None as above.
    fn evaluate_residuals(
        &self,
        _z: &[f64],
        _residuals: &mut [f64],
        _budget: &mut Budget<'_>,
    ) -> Option<Evaluation<1>> {
        None
    }

    /// Evaluates one point as far as it breaks no constraint by more than the incumbent does, and `budget` lasts: what is beyond that is changed in `z`. Says
    /// whether `z` stays as it is; None as above, where that leaves nothing. A problem without constraints changes nothing.
    fn evaluate_to_contact(
        &self,
        z: &mut [f64],
        incumbent: &Incumbent,
        budget: &mut Budget<'_>,
    ) -> Option<(Evaluation<1>, bool)> {
        let evaluation = self.evaluate_below(z, incumbent.cost(), budget)?;
        Some((evaluation, true))
    }

    /// Writes residuals r and Jacobian J with cost(z + Δ) ≈ |r + J Δ|² into `model`. False when `budget` was spent on the way; the model is
    /// then not complete.
    fn linearise(&self, z: &[f64], model: &mut LinearModel, budget: &mut Budget<'_>) -> bool;

    /// Writes the constraints h + A Δ ≥ 0 into `model`: all that a step in the box can break, or at least those within `reach`.
    /// False as above. A problem has none unless it says so.
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
