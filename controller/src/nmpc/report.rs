use super::{NmpcSettings, limits, obstacles};
use crate::optimizer::{Candidate, GaussNewtonOutcome, Incumbent};

/// A clearance broken by less than this \[m\] is kept.
const TOLERATED_M: f64 = 1e-6;
/// A limit broken by less than this part of it is kept: its penalty is soft.
const TOLERATED_PART: f64 = 1e-3;

/// A constraint that a plan can break.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Constraint {
    /// The body comes nearer to an obstacle than the safe distance; measured in metres.
    Clearance,
    /// A bend, a cable's stroke or a cable's speed goes beyond its limit; measured in parts of the limit.
    Limit,
}

/// How a solve ended. The loop has an answer to every one; none is an error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum SolveStatus {
    /// No solve took place, or state or last rates have another section count than the robot. The rates are zero.
    #[default]
    Idle,
    /// The last step was below the tolerance, rounding would hide what another gains, or the cost is zero to working precision.
    Converged,
    /// The budget ended it; the best solution so far is used.
    BudgetSpent,
    /// All iterations were used.
    IterationsSpent,
    /// The best plan breaks a constraint somewhere on the horizon: nothing better was found. What leaves is
    /// still checked by [`safety`](crate::safety).
    ConstraintViolated {
        /// Which: clearance before limits.
        constraint: Constraint,
        /// By how much at worst, in the unit of the constraint.
        amount: f64,
    },
    /// No point of finite cost was found: state or reference are not finite. The rates are zero.
    NonFinite,
}

impl SolveStatus {
    pub(super) fn from_incumbent(
        incumbent: &Incumbent,
        settings: &NmpcSettings,
        refinement: &GaussNewtonOutcome,
        budget_is_over: bool,
    ) -> Self {
        if !incumbent.is_evaluated() {
            return Self::BudgetSpent;
        }
        if !incumbent.cost().is_finite() {
            return Self::NonFinite;
        }
        let violations = incumbent.violations();
        for (constraint, amount, tolerated) in [
            (
                Constraint::Clearance,
                violations[obstacles::CLEARANCE],
                TOLERATED_M,
            ),
            (
                Constraint::Limit,
                violations[limits::LIMITS],
                TOLERATED_PART,
            ),
        ] {
            if amount > tolerated {
                return Self::ConstraintViolated { constraint, amount };
            }
        }
        if incumbent.cost() <= settings.cost_tolerance() || refinement.converged {
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
    /// Whether the budget ended it, whatever the status.
    pub budget_spent: bool,
    /// Cost of the solution, in the scale of the weights; infinite when the budget was spent before any plan was evaluated.
    pub cost: f64,
    /// Cost of the warm start; never below `cost`. Infinite when the budget was spent before it was evaluated: the solution may be
    /// its beginning, with rest after it.
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
    /// Seed of the swarm, and of the sides of ways past obstacles.
    pub seed: u64,
}

impl SolveReport {
    /// What the incumbent says.
    pub(super) fn from_incumbent(
        incumbent: &Incumbent,
        settings: &NmpcSettings,
        refinement: &GaussNewtonOutcome,
        budget_is_over: bool,
    ) -> Self {
        Self {
            status: SolveStatus::from_incumbent(incumbent, settings, refinement, budget_is_over),
            budget_spent: budget_is_over,
            cost: incumbent.cost(),
            evaluations: incumbent.evaluations(),
            winner: incumbent.origin(),
            ..Self::default()
        }
    }
}
