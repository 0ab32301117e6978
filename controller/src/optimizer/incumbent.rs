use super::{Evaluation, VIOLATIONS};

/// Origin of a solution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Candidate {
    /// The warm start: the previous plan, shifted in time.
    #[default]
    WarmStart,
    /// The previous command, held over the horizon: the first block of the previous plan, which the shift
    /// removed.
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

/// The best solution so far. Its cost never increases until a restart or [`Self::replace`].
#[derive(Debug)]
pub(crate) struct Incumbent {
    z: Vec<f64>,
    cost: f64,
    violations: [f64; VIOLATIONS],
    evaluated: bool,
    origin: Candidate,
    evaluations: u32,
}

impl Incumbent {
    /// No solution yet, with memory for `capacity` unknowns.
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

    /// Restarts from the warm start `z` with its evaluation; None if the budget ended before it was
    /// evaluated.
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

    /// Counts one evaluation. Adopts `z` (given by components) if lane `lane` of `evaluation` has a lower
    /// cost, and returns whether it did.
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

    /// Counts the evaluations of another search from the same start. Adopts its solution if the cost is
    /// lower, and returns whether it did.
    pub(crate) fn take_better(&mut self, other: &Self) -> bool {
        // Both counts include the start.
        self.evaluations += other.evaluations.saturating_sub(1);
        let better = other.cost < self.cost;
        if better {
            self.replace(other);
            self.origin = other.origin;
        }
        better
    }

    /// Adopts a solution refined from the incumbent, whatever its cost. The origin stays.
    pub(crate) fn replace(&mut self, other: &Self) {
        self.z.copy_from_slice(&other.z);
        self.cost = other.cost;
        self.violations = other.violations;
        self.evaluated = true;
    }

    /// Counts evaluations of points that are not better.
    #[inline(always)]
    pub(crate) fn count_evaluations(&mut self, evaluations: usize) {
        self.evaluations += evaluations as u32;
    }

    /// Unknowns of the best candidate so far.
    pub(crate) fn z(&self) -> &[f64] {
        &self.z
    }

    /// Its cost; infinite while no point of finite cost was found.
    pub(crate) fn cost(&self) -> f64 {
        self.cost
    }

    /// Its violation of each kind of constraint.
    pub(crate) fn violations(&self) -> [f64; VIOLATIONS] {
        self.violations
    }

    /// Whether it violates a constraint.
    pub(crate) fn is_violated(&self) -> bool {
        self.violations.iter().any(|violation| *violation > 0.0)
    }

    /// Whether any point was evaluated before the budget was spent.
    pub(crate) fn is_evaluated(&self) -> bool {
        self.evaluated
    }

    /// The candidate from which it was refined.
    pub(crate) fn origin(&self) -> Candidate {
        self.origin
    }

    /// Cost evaluations since the restart.
    pub(crate) fn evaluations(&self) -> u32 {
        self.evaluations
    }
}
