/// Where a solution comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Candidate {
    /// The warm start: the previous plan, moved on in time.
    #[default]
    WarmStart,
    /// The previous command, held.
    Previous,
    /// Zero rates.
    Zero,
    /// A damped least-squares step.
    LeastSquares,
    /// A scattered particle.
    Swarm,
}

/// The best solution so far. It only ever gets better.
#[derive(Debug, Clone)]
pub struct Incumbent {
    z: Vec<f64>,
    cost: f64,
    origin: Candidate,
    evaluations: u32,
}

impl Incumbent {
    /// No solution yet, room for `capacity` unknowns.
    pub fn with_capacity(capacity: usize) -> Self {
        Self {
            z: Vec::with_capacity(capacity),
            cost: f64::INFINITY,
            origin: Candidate::WarmStart,
            evaluations: 0,
        }
    }

    /// Starts anew from the warm start `z` of the given cost.
    pub fn restart(&mut self, z: &[f64], cost: f64) {
        self.z.clear();
        self.z.extend_from_slice(z);
        self.cost = if cost.is_nan() { f64::INFINITY } else { cost };
        self.origin = Candidate::WarmStart;
        self.evaluations = 1;
    }

    /// Counts one evaluation, and takes `z` (by its components) if it is better. Says whether it was.
    #[inline]
    pub fn offer(&mut self, z: impl Fn(usize) -> f64, cost: f64, origin: Candidate) -> bool {
        self.evaluations += 1;
        let better = cost < self.cost;
        if better {
            for (i, target) in self.z.iter_mut().enumerate() {
                *target = z(i);
            }
            self.cost = cost;
            self.origin = origin;
        }
        better
    }

    /// The solution.
    pub fn z(&self) -> &[f64] {
        &self.z
    }

    /// Its cost; infinite while no point of finite cost was seen.
    pub fn cost(&self) -> f64 {
        self.cost
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
