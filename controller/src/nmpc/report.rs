use super::NmpcSettings;
use crate::optimizer::{Candidate, GaussNewtonOutcome, Incumbent};

/// How a solve ended. The loop has an answer to every one; none is an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SolveStatus {
    /// No solve took place.
    #[default]
    Idle,
    /// The last step was below the tolerance, or the cost is zero to working precision.
    Converged,
    /// The budget ended it; the best solution so far is used.
    BudgetSpent,
    /// All iterations were used.
    IterationsSpent,
    /// No point of finite cost was found: state or reference are not finite. The rates are zero.
    NonFinite,
}

impl SolveStatus {
    pub(super) fn of(
        incumbent: &Incumbent,
        settings: &NmpcSettings,
        refinement: &GaussNewtonOutcome,
        budget_is_over: bool,
    ) -> Self {
        if !incumbent.cost().is_finite() {
            Self::NonFinite
        } else if incumbent.cost() <= settings.cost_tolerance() || refinement.converged {
            Self::Converged
        } else if budget_is_over {
            Self::BudgetSpent
        } else {
            Self::IterationsSpent
        }
    }
}

/// What a solve did, and how good its solution is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SolveReport {
    /// How it ended.
    pub status: SolveStatus,
    /// Cost of the solution, in the scale of the weights.
    pub cost: f64,
    /// Cost of the warm start; never below `cost`.
    pub warm_cost: f64,
    /// Norm of the projected gradient where Gauss-Newton last linearised; 0 when it did not run.
    pub gradient_norm: f64,
    /// Cost evaluations.
    pub evaluations: u32,
    /// Quanta of the budget that were begun.
    pub quanta: u32,
    /// Swarm iterations.
    pub iterations: u32,
    /// Gauss-Newton steps that improved the solution.
    pub refinements: u32,
    /// Candidate that the solution descends from.
    pub winner: Candidate,
    /// Seed of the swarm.
    pub seed: u64,
}
