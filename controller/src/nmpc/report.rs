use super::{NmpcSettings, limits, obstacles};
use crate::optimizer::{Candidate, GaussNewtonOutcome, Incumbent};

/// Clearance violations up to this value are tolerated \[m\].
const TOLERATED_M: f64 = 1e-6;
/// Limit violations up to this share of the limit are tolerated, because the penalty is soft.
const TOLERATED_PART: f64 = 1e-3;

/// A constraint that a plan can violate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Constraint {
    /// Safe distance between body and obstacles; amounts in metres.
    Clearance,
    /// Limit of a bend, a cable's stroke or a cable's speed; amounts as a share of the limit.
    Limit,
}

/// How a solve ended. None is an error; the cycle handles every one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum SolveStatus {
    /// No solve took place, or the section count of the state or of the last rates differs from the robot's.
    /// The rates are zero.
    #[default]
    Idle,
    /// The last step was below the tolerance, rounding would hide a further gain, or the cost is zero to
    /// working precision.
    Converged,
    /// The budget ended the solve; the incumbent is used.
    BudgetSpent,
    /// All iterations were used, or all work that a long plan may take.
    IterationsSpent,
    /// The best plan violates a constraint within the horizon, and no better plan was found.
    /// [`safety`](crate::safety) still checks the command.
    ConstraintViolated {
        /// The violated constraint; clearance takes precedence over limits.
        constraint: Constraint,
        /// Largest violation, in the unit of the constraint.
        amount: f64,
    },
    /// No plan of finite cost was found, because the state or the reference is not finite. The rates are
    /// zero.
    NonFinite,
}

impl SolveStatus {
    pub(super) fn from_incumbent(
        incumbent: &Incumbent,
        settings: &NmpcSettings,
        refinement: &GaussNewtonOutcome,
        is_budget_spent: bool,
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
        } else if is_budget_spent {
            Self::BudgetSpent
        } else {
            Self::IterationsSpent
        }
    }
}

/// Figures of one solve.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SolveReport {
    /// How it ended.
    pub status: SolveStatus,
    /// Whether the budget ended the solve, whatever the status.
    pub budget_spent: bool,
    /// Cost of the solution, in the scale of the weights; infinite when the budget ended before any plan was
    /// evaluated.
    pub cost: f64,
    /// Cost of the warm start; never below `cost`. Infinite when the budget ended before it was evaluated;
    /// then the solution may be its first part followed by zero rates.
    pub warm_cost: f64,
    /// Norm of the projected gradient where Gauss-Newton last linearised; 0 when it did not run.
    pub gradient_norm: f64,
    /// Cost evaluations.
    pub evaluations: u32,
    /// Budget quanta begun.
    pub quanta: u32,
    /// Swarm iterations.
    pub iterations: u32,
    /// Gauss-Newton steps that improved the solution.
    pub refinements: u32,
    /// Candidate that the solution descends from.
    pub winner: Candidate,
    /// Seed of the swarm, and of the random sides of ways past obstacles.
    pub seed: u64,
}

impl SolveReport {
    /// The figures known from the incumbent.
    pub(super) fn from_incumbent(
        incumbent: &Incumbent,
        settings: &NmpcSettings,
        refinement: &GaussNewtonOutcome,
        is_budget_spent: bool,
    ) -> Self {
        Self {
            status: SolveStatus::from_incumbent(incumbent, settings, refinement, is_budget_spent),
            budget_spent: is_budget_spent,
            cost: incumbent.cost(),
            evaluations: incumbent.evaluations(),
            winner: incumbent.origin(),
            ..Self::default()
        }
    }
}
