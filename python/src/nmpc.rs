use std::ops::RangeInclusive;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use cdcr_controller::nmpc::{self, Constraint, SolveInput, SolveStatus};
use cdcr_controller::optimizer::{Budget, Candidate, cycle_seed};
use cdcr_controller::reference::{ReferenceSample, ReferenceState};
use cdcr_controller::robot::BendRates;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{ArrayLike, Doubles, Numbers};
use crate::errors::Failure;
use crate::numbers::{count, until};
use crate::obstacle::{Obstacle, inner};
use crate::robot::Robot;
use crate::settings::{Settings, settings};
use crate::trajectory::orientations;

/// Range of the seeds of a swarm.
pub(crate) const SEEDS: RangeInclusive<u64> = 0..=u64::MAX;

/// Nonlinear model predictive control of one robot: the solver of cdcrd, without its clock. It remembers its last plan, the next warm start.
/// Threads that share a solver are served one after the other.
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct Nmpc {
    robot: Robot,
    solver: Mutex<Solver>,
    period_s: f64,
}

struct Solver {
    inner: nmpc::Nmpc,
    solves: u64,
}

/// Rates, plan and report of a solve.
type Solution = (Doubles, Doubles, SolveReport);

#[pymethods]
impl Nmpc {
    /// A solver for one robot.
    ///
    /// settings: what differs from default_settings(); setting_texts() has the range of each. period_s: 1e-6 to 10 s. Raises ArgumentError for an unknown key and a value outside
    /// its range.
    #[new]
    #[pyo3(signature = (robot, settings: "Settings | None" = None, *, period_s = 0.005))]
    fn new(robot: &Robot, settings: Option<&Bound<'_, PyDict>>, period_s: f64) -> PyResult<Self> {
        let settings = self::settings(settings)?;
        let inner =
            nmpc::Nmpc::new(robot.inner.clone(), period_s, settings).map_err(Failure::from)?;
        Ok(Self {
            robot: robot.clone(),
            solver: Mutex::new(Solver { inner, solves: 0 }),
            period_s,
        })
    }

    /// Finds the rates for the period that begins now.
    ///
    /// bend: (2 n,) [rad], where the robot is. window: (k, 3) [m], the reference 1, 2, ... periods from now; the last row stands for the missing rows of the horizon. obstacles: at most 64, where they are now. quaternion: (k, 4), x, y, z, w, or axis: (k, 3), what the tip's orientation shall be.
    /// budget_s: ends the solve with the best solution so far [s]; budget_quanta: the same after this amount of work (SolveReport.quanta), repeatable.
    /// previous_rates: (2 n,) [rad/s], of the last command; zero if left out. elapsed_periods: since the last solve. seed: of the swarm; by default a
    /// function of the seed in the settings and of how many solves there were.
    /// Returns rates (2 n,) [rad/s], plan (blocks, 2 n) [rad/s] and report. Raises ArgumentError for wrong shapes, NaN, infinite numbers and too many obstacles.
    #[pyo3(signature = (
        bend, window, obstacles: "Sequence[Obstacle]" = Vec::new(), *, quaternion = None,
        axis = None, budget_s = None, budget_quanta = None, previous_rates = None,
        elapsed_periods = 1, seed = None,
    ) -> "tuple[Doubles, Doubles, SolveReport]")]
    #[allow(clippy::too_many_arguments, reason = "each is a name in Python")]
    fn solve(
        &self,
        bend: ArrayLike<'_>,
        window: ArrayLike<'_>,
        obstacles: Vec<Obstacle>,
        quaternion: Option<ArrayLike<'_>>,
        axis: Option<ArrayLike<'_>>,
        budget_s: Option<f64>,
        budget_quanta: Option<i128>,
        previous_rates: Option<ArrayLike<'_>>,
        elapsed_periods: i128,
        seed: Option<i128>,
    ) -> PyResult<Solution> {
        let py = bend.py();
        let sections = self.robot.inner.section_count();
        let configuration = self.robot.configuration(&bend, "bend")?;
        let previous = previous_rates
            .map(|rates| self.robot.configuration(&rates, "previous_rates"))
            .transpose()?;
        let previous_rates = previous
            .and_then(|rates| BendRates::from_slice(rates.as_slice()))
            .unwrap_or(BendRates::zero(sections));
        let reference = samples(window, quaternion, axis)?;
        let seed = seed.map(|seed| count("seed", seed, SEEDS)).transpose()?;
        let elapsed_periods = count("elapsed_periods", elapsed_periods, 0..=u64::from(u32::MAX))?;
        let quanta = budget_quanta.map(|quanta| count("budget_quanta", quanta, 0..=u32::MAX));
        let quanta = quanta.transpose()?;
        let until = budget_s.map(|budget_s| until("budget_s", budget_s));
        let until = until.transpose()?;
        let obstacles = inner(&obstacles)?;
        let (rates, plan, report) = py.detach(|| {
            let mut solver = self.lock();
            let number = solver.solves;
            solver.solves += 1;
            let solver = &mut solver.inner;
            let input = SolveInput {
                configuration: &configuration,
                previous_rates: &previous_rates,
                reference: &reference,
                obstacles: &obstacles,
                tip_offset_m: 0.0,
                elapsed_periods,
                seed: seed.unwrap_or_else(|| cycle_seed(solver.settings().seed, number)),
            };
            let mut is_late = || until.is_some_and(|until| Instant::now() >= until);
            let mut budget = match (until, quanta) {
                (_, Some(quanta)) => Budget::from_quanta(quanta),
                (Some(_), None) => Budget::new(&mut is_late),
                (None, None) => Budget::unlimited(),
            };
            let (rates, report) = solver.solve(&input, &mut budget);
            (rates, solver.plan().to_vec(), report)
        });
        let width = 2 * sections;
        Ok((
            Doubles::new(&[width], &[], rates.as_slice().to_vec()),
            Doubles::new(&[plan.len() / width], &[width], plan),
            SolveReport { inner: report },
        ))
    }

    /// Takes over what differs from the settings in force. Raises ArgumentError, and nothing changes, for an unknown key and a value outside its range.
    #[pyo3(signature = (**changes: "Unpack[Settings]"))]
    fn configure(&self, changes: Option<&Bound<'_, PyDict>>) -> PyResult<()> {
        let Some(changes) = changes else {
            return Ok(());
        };
        let py = changes.py();
        let all = self.settings(py).into_pyobject(py)?;
        all.update(changes.as_mapping())?;
        let settings = settings(Some(&all))?;
        let configured = py.detach(|| self.lock().inner.configure(settings));
        configured.map_err(Failure::from)?;
        Ok(())
    }

    /// Forgets the plan: the next warm start is rest.
    fn forget_plan(&self, py: Python<'_>) {
        py.detach(|| self.lock().inner.forget_plan());
    }

    /// The settings in force.
    #[getter]
    fn settings(&self, py: Python<'_>) -> Settings {
        Settings(py.detach(|| *self.lock().inner.settings()))
    }

    /// Period [s].
    #[getter]
    fn period_s(&self) -> f64 {
        self.period_s
    }

    fn __repr__(&self) -> String {
        let (sections, period_s) = (self.robot.inner.section_count(), self.period_s);
        format!("<Nmpc of {sections} sections, period {period_s} s>")
    }
}

impl Nmpc {
    /// Only without the interpreter's lock: another thread may solve meanwhile.
    fn lock(&self) -> MutexGuard<'_, Solver> {
        self.solver.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a solve did, and how good its solution is.
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct SolveReport {
    inner: nmpc::SolveReport,
}

#[pymethods]
impl SolveReport {
    /// How it ended: "idle", "converged", "budget-spent", "iterations-spent", "clearance-violated", "limit-violated" or "non-finite".
    #[getter]
    fn status(&self) -> &'static str {
        status_word(self.inner.status)
    }

    /// By how much the plan breaks its worst constraint: metres of clearance, or parts of a limit; 0: none is broken.
    #[getter]
    fn violation(&self) -> f64 {
        match self.inner.status {
            SolveStatus::ConstraintViolated { amount, .. } => amount,
            _ => 0.0,
        }
    }

    /// Whether the budget ended it, whatever the status.
    #[getter]
    fn budget_spent(&self) -> bool {
        self.inner.budget_spent
    }

    /// Cost of the solution, in the scale of the weights.
    #[getter]
    fn cost(&self) -> f64 {
        self.inner.cost
    }

    /// Cost of the warm start, never below the cost.
    #[getter]
    fn warm_cost(&self) -> f64 {
        self.inner.warm_cost
    }

    /// Norm of the projected gradient where Gauss-Newton last linearised; 0 when it did not run.
    #[getter]
    fn gradient_norm(&self) -> f64 {
        self.inner.gradient_norm
    }

    /// Cost evaluations.
    #[getter]
    fn evaluations(&self) -> u32 {
        self.inner.evaluations
    }

    /// Work that was begun, for budget_quanta.
    #[getter]
    fn quanta(&self) -> u32 {
        self.inner.quanta
    }

    /// Iterations of the swarm.
    #[getter]
    fn iterations(&self) -> u32 {
        self.inner.iterations
    }

    /// Gauss-Newton steps that improved the solution.
    #[getter]
    fn refinements(&self) -> u32 {
        self.inner.refinements
    }

    /// Candidate that the solution descends from: "warm-start", "previous", "zero", "least-squares", "eigenvector" or "swarm".
    #[getter]
    fn winner(&self) -> &'static str {
        match self.inner.winner {
            Candidate::WarmStart => "warm-start",
            Candidate::Previous => "previous",
            Candidate::Zero => "zero",
            Candidate::LeastSquares => "least-squares",
            Candidate::Eigenvector => "eigenvector",
            Candidate::Swarm => "swarm",
        }
    }

    /// Seed of the swarm.
    #[getter]
    fn seed(&self) -> u64 {
        self.inner.seed
    }

    fn __repr__(&self) -> String {
        let (status, cost, evaluations) = (self.status(), self.cost(), self.evaluations());
        format!("SolveReport(status={status:?}, cost={cost:e}, evaluations={evaluations})")
    }
}

/// A status as one word.
pub(crate) fn status_word(status: SolveStatus) -> &'static str {
    match status {
        SolveStatus::Idle => "idle",
        SolveStatus::Converged => "converged",
        SolveStatus::BudgetSpent => "budget-spent",
        SolveStatus::IterationsSpent => "iterations-spent",
        SolveStatus::ConstraintViolated {
            constraint: Constraint::Clearance,
            ..
        } => "clearance-violated",
        SolveStatus::ConstraintViolated {
            constraint: Constraint::Limit,
            ..
        } => "limit-violated",
        SolveStatus::NonFinite => "non-finite",
    }
}

fn samples(
    window: ArrayLike<'_>,
    quaternion: Option<ArrayLike<'_>>,
    axis: Option<ArrayLike<'_>>,
) -> PyResult<Vec<ReferenceSample>> {
    let positions =
        Numbers::exact(&window, "window", 2, &[3], "x, y, z at each release")?.finite("window")?;
    if positions.count() == 0 {
        return Err(Failure::argument("window is empty", "Give one position at least.").into());
    }
    let orientations = orientations(quaternion, axis, positions.count())?;
    let sample = |(place, orientation): (&[f64], _)| ReferenceSample {
        state: ReferenceState::Inside,
        position_m: [place[0], place[1], place[2]].into(),
        orientation: cdcr_client::model::orientation_of(orientation),
    };
    Ok(positions
        .values()
        .chunks_exact(3)
        .zip(orientations)
        .map(sample)
        .collect())
}
