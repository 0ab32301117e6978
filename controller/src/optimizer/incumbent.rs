use super::{Evaluation, VIOLATIONS};

/// Where a solution comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Candidate {
    /// The warm start: the previous plan, moved on in time.
    #[default]
    WarmStart,
    /// The previous command, held: the first block of the previous solution, which the warm start has moved on
    /// from.
    Previous,
    /// Zero rates.
    Zero,
    /// A damped least-squares step.
    LeastSquares,
    /// A step along an eigenvector of the Hessian, where the gradient vanishes.
    Eigenvector,
    /// A scattered particle.
    Swarm,
}

/// The best solution so far. It only ever gets better.
#[derive(Debug, Clone)]
pub(crate) struct Incumbent {
    z: Vec<f64>,
    cost: f64,
    violations: [f64; VIOLATIONS],
    evaluated: bool,
    origin: Candidate,
    evaluations: u32,
}

impl Incumbent {
    /// No solution yet, room for `capacity` unknowns.
    pub(crate) fn with_capacity(capacity: usize) -> Self {
        Self {
            z: Vec::with_capacity(capacity),
            cost: f64::INFINITY,
            violations: [0.0; VIOLATIONS],
            evaluated: false,
            origin: Candidate::WarmStart,
            evaluations: 0,
        }
    }

    /// Starts anew from the warm start `z`, and what is said of it; None when nothing is, because the
    /// budget was spent before.
    pub(crate) fn restart(&mut self, z: &[f64], evaluation: Option<&Evaluation<1>>) {
        self.z.clear();
        self.z.extend_from_slice(z);
        self.cost = f64::INFINITY;
        self.violations = [0.0; VIOLATIONS];
        self.evaluated = evaluation.is_some();
        self.origin = Candidate::WarmStart;
        self.evaluations = u32::from(self.evaluated);
        if let Some(evaluation) = evaluation
            && !evaluation.cost.0[0].is_nan()
        {
            self.cost = evaluation.cost.0[0];
            self.violations = evaluation.violations.map(|kind| kind.0[0]);
        }
    }

    /// Counts one evaluation, and takes `z` (by its components) if lane `lane` of the `evaluation` is
    /// better. Says whether it was.
    #[inline(always)]
    pub(crate) fn offer<const W: usize>(
        &mut self,
        z: impl Fn(usize) -> f64,
        evaluation: &Evaluation<W>,
        lane: usize,
        origin: Candidate,
    ) -> bool {
        self.evaluations += 1;
        let cost = evaluation.cost.0[lane];
        let better = cost < self.cost;
        if better {
            for (i, target) in self.z.iter_mut().enumerate() {
                *target = z(i);
            }
            self.cost = cost;
            self.violations = evaluation.violations.map(|kind| kind.0[lane]);
            self.evaluated = true;
            self.origin = origin;
        }
        better
    }

    /// Counts the evaluations of another search from the same start, and takes its solution if that is better. Whether it was.
    pub(crate) fn take_better(&mut self, other: &Self) -> bool {
        // Both counted the start.
        self.evaluations += other.evaluations.saturating_sub(1);
        let better = other.cost < self.cost;
        if better {
            self.replace(other);
            self.origin = other.origin;
        }
        better
    }

    /// Takes another solution that descends from it, whatever it costs.
    pub(crate) fn replace(&mut self, other: &Self) {
        self.z.copy_from_slice(&other.z);
        self.cost = other.cost;
        self.violations = other.violations;
        self.evaluated = true;
    }

    /// Counts evaluations that are known not to be better.
    #[inline(always)]
    pub(crate) fn pass_over(&mut self, evaluations: usize) {
        self.evaluations += evaluations as u32;
    }

    /// The solution.
    pub(crate) fn z(&self) -> &[f64] {
        &self.z
    }

    /// Its cost; infinite while no point of finite cost was seen.
    pub(crate) fn cost(&self) -> f64 {
        self.cost
    }

    /// How far it breaks each kind of constraint.
    pub(crate) fn violations(&self) -> [f64; VIOLATIONS] {
        self.violations
    }

    /// Whether it breaks a constraint.
    pub(crate) fn is_violated(&self) -> bool {
        self.violations.iter().any(|violation| *violation > 0.0)
    }

    /// Whether anything was evaluated at all before the budget was spent.
    pub(crate) fn is_evaluated(&self) -> bool {
        self.evaluated
    }

    /// The candidate that it descends from. A refinement keeps the origin of what it refined.
    pub(crate) fn origin(&self) -> Candidate {
        self.origin
    }

    /// Cost evaluations since the restart.
    pub(crate) fn evaluations(&self) -> u32 {
        self.evaluations
    }
}
