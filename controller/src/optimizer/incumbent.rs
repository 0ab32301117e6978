use super::{Judged, VIOLATIONS};

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
pub struct Incumbent {
    z: Vec<f64>,
    cost: f64,
    violations: [f64; VIOLATIONS],
    judged: bool,
    origin: Candidate,
    evaluations: u32,
}

impl Incumbent {
    /// No solution yet, room for `capacity` unknowns.
    pub fn with_capacity(capacity: usize) -> Self {
        Self {
            z: Vec::with_capacity(capacity),
            cost: f64::INFINITY,
            violations: [0.0; VIOLATIONS],
            judged: false,
            origin: Candidate::WarmStart,
            evaluations: 0,
        }
    }

    /// Starts anew from the warm start `z`, and what is said of it; None when nothing is, because the
    /// budget was spent before.
    pub fn restart(&mut self, z: &[f64], judged: Option<&Judged<1>>) {
        self.z.clear();
        self.z.extend_from_slice(z);
        self.cost = f64::INFINITY;
        self.violations = [0.0; VIOLATIONS];
        self.judged = judged.is_some();
        self.origin = Candidate::WarmStart;
        self.evaluations = u32::from(self.judged);
        if let Some(judged) = judged
            && !judged.cost.0[0].is_nan()
        {
            self.cost = judged.cost.0[0];
            self.violations = judged.violations.map(|kind| kind.0[0]);
        }
    }

    /// Counts one evaluation, and takes `z` (by its components) if lane `lane` of what was `judged` is
    /// better. Says whether it was.
    #[inline(always)]
    pub fn offer<const W: usize>(
        &mut self,
        z: impl Fn(usize) -> f64,
        judged: &Judged<W>,
        lane: usize,
        origin: Candidate,
    ) -> bool {
        self.evaluations += 1;
        let cost = judged.cost.0[lane];
        let better = cost < self.cost;
        if better {
            for (i, target) in self.z.iter_mut().enumerate() {
                *target = z(i);
            }
            self.cost = cost;
            self.violations = judged.violations.map(|kind| kind.0[lane]);
            self.judged = true;
            self.origin = origin;
        }
        better
    }

    /// Counts evaluations that are known not to be better.
    #[inline(always)]
    pub fn pass_over(&mut self, evaluations: usize) {
        self.evaluations += evaluations as u32;
    }

    /// The solution.
    pub fn z(&self) -> &[f64] {
        &self.z
    }

    /// Its cost; infinite while no point of finite cost was seen.
    pub fn cost(&self) -> f64 {
        self.cost
    }

    /// How far it breaks each kind of constraint.
    pub fn violations(&self) -> [f64; VIOLATIONS] {
        self.violations
    }

    /// Whether anything was judged at all before the budget was spent.
    pub fn is_judged(&self) -> bool {
        self.judged
    }

    /// The candidate that it descends from. A refinement keeps the origin of what it refined.
    pub fn origin(&self) -> Candidate {
        self.origin
    }

    /// Cost evaluations since the restart.
    pub fn evaluations(&self) -> u32 {
        self.evaluations
    }
}
