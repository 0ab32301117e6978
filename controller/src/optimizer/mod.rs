//! Minimisers over a box, with a budget.
//!
//! Two algorithms that share one [`Incumbent`]: [`Kpso`] searches (Eq. 6-7 of the paper), and
//! [`GaussNewton`] finishes. Both are *anytime*: they check a [`Budget`] between small pieces of work
//! and whatever is best when it is spent stays in the incumbent, which never gets worse.
//!
//! Invariant: nothing here knows a robot, a reference or a clock. A [`Problem`] is a cost over a box;
//! time comes in as the closure of the budget. Nothing allocates after construction.

mod bounds;
mod budget;
mod cholesky;
mod gauss_newton;
mod incumbent;
mod kpso;
mod path;
mod random;

pub use bounds::Bounds;
pub use budget::{Budget, QUANTUM_NS};
pub use gauss_newton::{GaussNewton, GaussNewtonOutcome, GaussNewtonSettings, LinearModel};
pub use incumbent::{Candidate, Incumbent};
pub use kpso::{Kpso, KpsoSettings, Task, VelocityRule, cycle_seed};
pub use path::Path;

use crate::wide::Wide;

/// A cost over a box, and its least-squares structure.
pub trait Problem {
    /// Number of unknowns d.
    fn dimension(&self) -> usize;

    /// Upper bound of the rows that [`Problem::linearise`] writes.
    fn rows(&self) -> usize;

    /// The cost at W points side by side, `z(i)` being the i-th unknown of each; ≥ 0. It may be
    /// infinite or NaN where a point makes no sense; such a point never becomes the incumbent.
    ///
    /// Implementations are `#[inline(always)]` down to the last operation, so that the swarm's path
    /// decides the instructions; each lane must give the bits of W = 1.
    fn cost<const W: usize>(&self, z: impl Fn(usize) -> Wide<W>) -> Wide<W>;

    /// The cost at one point of length d.
    fn cost_at(&self, z: &[f64]) -> f64 {
        self.cost(|i| Wide([z[i]])).0[0]
    }

    /// Writes residuals r and Jacobian J with cost(z + Δ) ≈ |r + J Δ|² into `model`. False when
    /// `budget` was spent on the way; the model is then not complete.
    fn linearise<F: FnMut() -> bool>(
        &self,
        z: &[f64],
        model: &mut LinearModel,
        budget: &mut Budget<F>,
    ) -> bool;

    /// Nominal time of one evaluation of W points side by side \[ns\], for the budget.
    fn evaluation_ns(&self) -> u32;
}
