//! Whether a solve keeps its budget: how much later than it the solve ends, and that its plan is never
//! worse than the warm start.
//!
//! Before each solve the same budget is waited for without any work. What that loop is late by is the
//! machine's; the rest is the solver's.

use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput, SolverKind};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::robot::BendRates;
use hdrhistogram::Histogram;
use serde::Serialize;

use crate::closed_loop::{self, ClosedLoop, histogram, quantile_us};
use crate::experiment::{Solver, Task};
use crate::scene::Scene;
use crate::solver::Size;

pub const BUDGETS_US: [u64; 11] = [0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

/// One line: one case with one budget.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    pub case: &'static str,
    pub budget_us: u64,
    pub solves: u64,
    /// Share of the solves that the budget ended; the others had nothing left to do.
    pub ended_by_budget_share: f64,
    /// How much later than the budget a solve ended \[µs\].
    pub over_us: Overrun,
    /// How much later the loop without work ended \[µs\].
    pub bare_over_us: Overrun,
    /// Solves whose plan costs more than the warm start.
    pub worse_than_warm_start: u64,
}

/// How much later than a budget something ended \[µs\]; 0 where it ended earlier.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Overrun {
    pub p50: f64,
    pub p99: f64,
    pub max: f64,
}

impl Overrun {
    fn of(times_ns: &Histogram<u64>) -> Self {
        let us = |quantile| quantile_us(times_ns, quantile);
        Self {
            p50: us(0.5),
            p99: us(0.99),
            max: us(1.0),
        }
    }
}

/// A robot on its way along a curve, and what solves there.
pub struct Case {
    name: &'static str,
    scene: Scene,
    settings: NmpcSettings,
    /// Commands that lead along the curve, the same for every budget.
    way: Vec<BendRates>,
}

/// The cases: the default, the paper's swarm for an orientation of the tip, and many particles and steps
/// among obstacles.
pub fn cases() -> Result<Vec<Case>> {
    let default = Size::paper(Task::Spiral { sections: 3 }, Solver::KpsoRefined);
    let line = Task::Line {
        rate_limit_rad_s: 2.0,
    };
    let obstacles = Size {
        swarm: 64,
        horizon: 20,
        obstacles: 16,
        ..default
    };
    Ok(vec![
        Case::new("default", &default)?,
        Case::new("tip-axis", &Size::paper(line, Solver::KpsoRefined))?,
        Case::new("obstacles", &obstacles)?,
    ])
}

impl Case {
    fn new(name: &'static str, size: &Size) -> Result<Self> {
        let (scene, settings) = (size.scene()?, size.settings());
        let samples = closed_loop::run(&scene, Solver::GaussNewton.of(settings))?;
        Ok(Self {
            name,
            scene,
            settings,
            way: samples.into_iter().map(|sample| sample.rates).collect(),
        })
    }

    /// Solves along the way with this budget. Every solve has another seed and starts from zero rates, so
    /// that work is left; the way begins anew at its end.
    pub fn measure(&self, budget_us: u64, solves: u64) -> Result<Row> {
        let mut runner = Runner::new(self, Duration::from_micros(budget_us))?;
        let mut closed = ClosedLoop::new(&self.scene, self.settings);
        for solve in 0..solves {
            let input = SolveInput {
                seed: cycle_seed(self.settings.seed, solve),
                ..closed.input()
            };
            runner.wait();
            runner.solve(&input);
            closed.advance(&self.way[solve as usize % self.way.len()]);
            if closed.is_over() {
                closed = ClosedLoop::new(&self.scene, self.settings);
            }
        }
        let (name, worse) = (self.name, runner.worse);
        ensure!(
            worse == 0,
            "{name}, {budget_us} µs: {worse} of {solves} plans cost more than the warm start"
        );
        Ok(Row {
            case: name,
            budget_us,
            solves,
            ended_by_budget_share: runner.ended_by_budget as f64 / solves as f64,
            over_us: Overrun::of(&runner.over_ns),
            bare_over_us: Overrun::of(&runner.bare_over_ns),
            worse_than_warm_start: worse,
        })
    }
}

/// Who solves, who judges, and what was counted.
struct Runner {
    budget: Duration,
    nmpc: Nmpc,
    judge: Nmpc,
    over_ns: Histogram<u64>,
    bare_over_ns: Histogram<u64>,
    ended_by_budget: u64,
    worse: u64,
}

impl Runner {
    fn new(case: &Case, budget: Duration) -> Result<Self> {
        let (robot, period_s) = (&case.scene.robot, case.scene.period_s);
        let judging = NmpcSettings {
            solver: SolverKind::GaussNewton,
            refinement_steps: 0,
            ..case.settings
        };
        let mut nmpc = Nmpc::new(robot.clone(), period_s, case.settings)?;
        // Touches all memory that a solve may need.
        let closed = ClosedLoop::new(&case.scene, case.settings);
        nmpc.solve(&closed.input(), &mut Budget::unlimited());
        Ok(Self {
            budget,
            nmpc,
            judge: Nmpc::new(robot.clone(), period_s, judging)?,
            over_ns: histogram()?,
            bare_over_ns: histogram()?,
            ended_by_budget: 0,
            worse: 0,
        })
    }

    /// Asks the budget until it is spent, and does nothing else.
    fn wait(&mut self) {
        let begin = Instant::now();
        let mut budget = Budget::new(|| begin.elapsed() >= self.budget);
        while budget.left() {}
        let over = begin.elapsed().saturating_sub(self.budget);
        self.bare_over_ns.saturating_record(over.as_nanos() as u64);
    }

    fn solve(&mut self, input: &SolveInput) {
        self.nmpc.forget_plan();
        let begin = Instant::now();
        let mut budget = Budget::new(|| begin.elapsed() >= self.budget);
        let (_, report) = self.nmpc.solve(input, &mut budget);
        let over = begin.elapsed().saturating_sub(self.budget);
        self.over_ns.saturating_record(over.as_nanos() as u64);
        self.ended_by_budget += u64::from(report.budget_spent);
        let [plan_cost, warm_cost] = [self.nmpc.plan(), self.nmpc.warm_plan()]
            .map(|plan| cost(&mut self.judge, input, plan));
        self.worse += u64::from(plan_cost > warm_cost);
    }
}

/// What a plan costs, by a solver without a budget: a short one judges not even the warm start.
fn cost(judge: &mut Nmpc, input: &SolveInput, plan: &[f64]) -> f64 {
    judge.restore_plan(plan);
    let input = SolveInput {
        elapsed_periods: 0,
        ..*input
    };
    judge.solve(&input, &mut Budget::unlimited()).1.warm_cost
}
