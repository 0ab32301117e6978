//! Candidates known before the search, which make the particle swarm "knowledge-based".

use super::escape;
use super::problem::TrackingProblem;
use crate::optimizer::{Bounds, Budget, Candidate, FoundStep, GaussNewton, Incumbent, Problem};
use crate::robot::COORDINATES_MAX;

/// Candidate plans. The first is the warm start, which is already the incumbent. The swarm evaluates the
/// others together with its own particles.
#[derive(Debug)]
pub(super) struct Knowledge {
    candidates: Vec<f64>,
    origins: Vec<Candidate>,
    scratch: Vec<f64>,
}

/// Step lengths along an escape direction, as shares of the largest step inside the box.
const ESCAPE_SHARES: [f64; 8] = [
    1.0, -1.0, 0.25, -0.25, 0.0625, -0.0625, 0.015_625, -0.015_625,
];
/// Largest number of candidates: warm start, previous command, zero, least squares, escape steps.
const CANDIDATES_MAX: usize = 4 + ESCAPE_SHARES.len() * escape::DIRECTIONS_MAX;

impl Knowledge {
    pub(super) fn with_capacity(dimension: usize) -> Self {
        Self {
            candidates: Vec::with_capacity(CANDIDATES_MAX * dimension),
            origins: Vec::with_capacity(CANDIDATES_MAX),
            scratch: Vec::with_capacity(dimension),
        }
    }

    /// Collects the warm start, the previous command held over the horizon, and zero rates.
    pub(super) fn collect(
        &mut self,
        problem: &TrackingProblem,
        bounds: &Bounds,
        warm_plan: &[f64],
    ) {
        let dimension = problem.dimension();
        self.candidates.clear();
        self.origins.clear();
        self.scratch.clear();
        self.scratch.extend_from_slice(warm_plan);
        self.add(Candidate::WarmStart);

        let held = &problem.previous[..problem.motion.width()];
        for block in self.scratch.chunks_exact_mut(held.len()) {
            block.copy_from_slice(held);
        }
        bounds.project(&mut self.scratch);
        self.add(Candidate::Previous);

        self.scratch.clear();
        self.scratch.resize(dimension, 0.0);
        self.add(Candidate::Zero);
    }

    /// Adds the plan in the scratch memory, if there is space.
    fn add(&mut self, origin: Candidate) {
        if self.origins.len() < CANDIDATES_MAX {
            self.candidates.extend_from_slice(&self.scratch);
            self.origins.push(origin);
        }
    }

    /// Evaluates all collected candidates except the warm start; for solvers without a swarm.
    pub(super) fn evaluate(
        &self,
        problem: &TrackingProblem,
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
    ) {
        let candidates = self.candidates.chunks_exact(problem.dimension());
        for (z, origin) in candidates.zip(&self.origins).skip(1) {
            let cost_cutoff = incumbent.cost();
            if let Some(evaluation) = problem.evaluate_below(z, cost_cutoff, budget) {
                incumbent.offer(|i| z[i], &evaluation, 0, *origin);
            }
        }
    }

    /// Adds the result of one damped least-squares step from the incumbent.
    pub(super) fn add_least_squares(
        &mut self,
        problem: &TrackingProblem,
        bounds: &Bounds,
        damping: f64,
        gauss_newton: &mut GaussNewton,
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
    ) {
        let into = &mut self.scratch;
        let origin = Candidate::LeastSquares;
        match gauss_newton.propose(problem, bounds, damping, budget, incumbent, into) {
            FoundStep::Nothing => {}
            FoundStep::NotEvaluated => self.evaluate_and_add(problem, origin, budget, incumbent),
            FoundStep::Evaluated => self.add(origin),
        }
    }

    /// Adds steps along the Hessian's eigenvectors of negative eigenvalue, constant over the horizon, at
    /// several lengths. For points where the gradient vanishes.
    pub(super) fn add_escape_steps(
        &mut self,
        problem: &TrackingProblem,
        bounds: &Bounds,
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
        base: &mut [f64],
    ) {
        let width = problem.motion.width();
        base.copy_from_slice(incumbent.z());
        let directions = escape::directions(problem, base, budget);
        for direction in &directions.vectors[..directions.count] {
            let mut controls = [0.0; COORDINATES_MAX];
            let controls = &mut controls[..width];
            problem.motion.controls_of(&direction[..width], controls);
            let longest = longest_step(controls, bounds);
            for share in ESCAPE_SHARES {
                for (i, control) in self.scratch.iter_mut().enumerate() {
                    *control = base[i] + share * longest * controls[i % width];
                }
                bounds.project(&mut self.scratch);
                self.evaluate_and_add(problem, Candidate::Eigenvector, budget, incumbent);
            }
        }
    }

    /// `dimension` values for each candidate.
    pub(super) fn candidates(&self) -> &[f64] {
        &self.candidates
    }

    /// Origin of each candidate.
    pub(super) fn origins(&self) -> &[Candidate] {
        &self.origins
    }

    fn evaluate_and_add(
        &mut self,
        problem: &TrackingProblem,
        origin: Candidate,
        budget: &mut Budget<'_>,
        incumbent: &mut Incumbent,
    ) {
        let cost_cutoff = incumbent.cost();
        if let Some(evaluation) = problem.evaluate_below(&self.scratch, cost_cutoff, budget) {
            let scratch = &self.scratch;
            incumbent.offer(|i| scratch[i], &evaluation, 0, origin);
            self.add(origin);
        }
    }
}

/// Largest multiple of `controls` whose components stay below the upper bounds of the first block; at most
/// 1e6.
fn longest_step(controls: &[f64], bounds: &Bounds) -> f64 {
    controls
        .iter()
        .zip(bounds.upper())
        .filter(|(control, _)| **control != 0.0)
        .map(|(control, upper)| upper / control.abs())
        .fold(f64::INFINITY, f64::min)
        .min(1e6)
}
