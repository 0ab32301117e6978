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

pub use bounds::Bounds;
pub use budget::Budget;
pub use gauss_newton::{GaussNewton, GaussNewtonOutcome, GaussNewtonSettings, LinearModel};
pub use incumbent::{Candidate, Incumbent};
pub use kpso::{Kpso, KpsoSettings, VelocityRule, cycle_seed};

/// A cost over a box, and its least-squares structure.
pub trait Problem {
    /// Number of unknowns d.
    fn dimension(&self) -> usize;

    /// Upper bound of the rows that [`Problem::linearise`] writes.
    fn rows(&self) -> usize;

    /// The cost at `z` (length d), ≥ 0. It may be infinite or NaN where `z` makes no sense; such a
    /// point never becomes the incumbent.
    fn cost(&self, z: &[f64]) -> f64;

    /// Writes residuals r and Jacobian J with cost(z + Δ) ≈ |r + J Δ|² into `model`.
    fn linearise(&self, z: &[f64], model: &mut LinearModel);

    /// Cost evaluations that fit between two looks at the budget, ≥ 1. A problem with an expensive
    /// cost answers 1, so that the overrun of a budget stays a few microseconds.
    fn evaluations_per_quantum(&self) -> usize;
}
