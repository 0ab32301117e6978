//! What is known before the search: the candidates that make a particle swarm "knowledge-based".

use super::SolveInput;
use crate::optimizer::{Bounds, Budget, Candidate, GaussNewton, Incumbent, Problem};

/// Candidates, each judged when it is gathered. The warm start is the incumbent already.
#[derive(Debug, Clone)]
pub(super) struct Knowledge {
    candidates: Vec<f64>,
    scratch: Vec<f64>,
}

/// Candidates at most: warm start, previous command, zero, least squares.
const CANDIDATES_MAX: usize = 4;

impl Knowledge {
    pub(super) fn with_capacity(dimension: usize) -> Self {
        Self {
            candidates: Vec::with_capacity(CANDIDATES_MAX * dimension),
            scratch: Vec::with_capacity(dimension),
        }
    }

    /// The warm start, the previous command held, and zero rates.
    pub(super) fn gather<P: Problem, F: FnMut() -> bool>(
        &mut self,
        problem: &P,
        bounds: &Bounds,
        input: &SolveInput,
        budget: &mut Budget<F>,
        incumbent: &mut Incumbent,
    ) {
        let dimension = problem.dimension();
        self.candidates.clear();
        self.candidates.extend_from_slice(incumbent.z());

        let held = input.previous_rates.as_slice();
        self.scratch.clear();
        self.scratch
            .extend((0..dimension).map(|i| held[i % held.len()]));
        bounds.project(&mut self.scratch);
        self.judge(problem, Candidate::Previous, budget, incumbent);

        self.scratch.fill(0.0);
        self.judge(problem, Candidate::Zero, budget, incumbent);
    }

    /// One damped least-squares step from the best candidate so far.
    pub(super) fn add_least_squares<P: Problem, F: FnMut() -> bool>(
        &mut self,
        problem: &P,
        bounds: &Bounds,
        damping: f64,
        gauss_newton: &mut GaussNewton,
        budget: &mut Budget<F>,
        incumbent: &mut Incumbent,
    ) {
        self.scratch.resize(problem.dimension(), 0.0);
        let (z, into) = (incumbent.z(), &mut self.scratch);
        if gauss_newton.propose(problem, bounds, damping, budget, z, into) {
            self.judge(problem, Candidate::LeastSquares, budget, incumbent);
        }
    }

    /// `dimension` values for each candidate.
    pub(super) fn candidates(&self) -> &[f64] {
        &self.candidates
    }

    fn judge<P: Problem, F: FnMut() -> bool>(
        &mut self,
        problem: &P,
        origin: Candidate,
        budget: &mut Budget<F>,
        incumbent: &mut Incumbent,
    ) {
        if budget.spend(problem.evaluation_ns()) {
            let scratch = &self.scratch;
            incumbent.offer(|i| scratch[i], problem.cost_at(scratch), origin);
            self.candidates.extend_from_slice(&self.scratch);
        }
    }
}
