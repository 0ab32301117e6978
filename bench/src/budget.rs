//! Whether a solve keeps its budget: how much later than it the solve ends, and that its plan is never
//! worse than the warm start.
//!
//! Before each solve the same budget is waited for without any work. What that loop is late by is the
//! machine's; the rest is the solver's.

use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::robot::BendRates;
use hdrhistogram::Histogram;
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::chart::{BLUE, Curve, GREEN, GREY, Panel, Scale, plot};
use crate::closed_loop::{self, ClosedLoop, PlanEvaluator};
use crate::dataset::{
    Column, Dataset, Sheet, fixed, joined, number, percent, plain, together, word,
};
use crate::experiment::{Solver, Task};
use crate::interrupt;
use crate::progress::Progress;
use crate::quantiles::{Quantiles, histogram};
use crate::scene::Scene;
use crate::solver::Size;

pub const BUDGETS_US: [u64; 11] = [0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

/// What a solve takes beside its budget and the wait before it, about \[s\].
const AROUND_S: f64 = 3e-4;
const CASES: usize = 3;

const EXPLANATION: &str = "\
<p>A solve asks a clock whether its budget is spent, and hands over the best solution so far when it is. \
This is how much later than the budget it ends; 0 where it ended earlier. Before each solve a loop without \
work waits for the same budget in the same way: what that loop is late by is the machine's, the rest the \
solver's. No plan may cost more than the warm start. Times are medians of the rounds, the largest of all \
rounds.</p>\n";

const COLUMNS: [Column; 11] = [
    word("case", "case"),
    plain("budget µs", "budget_us"),
    plain("solves", "solves"),
    percent("ended by it %", "ended_by_budget_share", 1),
    fixed("over p50 µs", "over_us_p50", 2),
    fixed("p99 µs", "over_us_p99", 2),
    fixed("max µs", "over_us_max", 2),
    fixed("bare p50 µs", "bare_over_us_p50", 2),
    fixed("p99 µs", "bare_over_us_p99", 2),
    fixed("max µs", "bare_over_us_max", 2),
    plain("worse than warm start", "worse_than_warm_start"),
];

const COUNTS: [&str; 3] = ["solves", "ended_by_budget", "worse_than_warm_start"];

#[derive(Debug, Clone, Copy, clap::Args)]
pub struct BudgetOptions {
    /// How often all budgets are measured, 1 to 100; a time is the median, the largest of all.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// Solves of each case with each budget in a round, 1 to 1000000.
    #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub solves: u64,
}

impl Benchmark for BudgetOptions {
    fn for_report(&mut self) {
        (self.rounds, self.solves) = (3, 700);
    }

    fn quicken(&mut self) {
        self.solves = 50;
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.rounds
    }

    fn expected_s(&self) -> f64 {
        let budgets = BUDGETS_US.iter().map(|us| of_budget_s(*us, self.solves));
        f64::from(self.rounds) * CASES as f64 * budgets.sum::<f64>()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let cases = cases()?;
        let with_budgets = cases
            .iter()
            .flat_map(|case| BUDGETS_US.map(|us| (case, us)));
        let mut all: Vec<_> = with_budgets
            .map(|(case, us)| (case, us, Vec::new()))
            .collect();
        for round in 1..=self.rounds {
            for (case, budget_us, rounds) in &mut all {
                interrupt::check()?;
                progress.begin(&format!("round {round} of {}", self.rounds));
                rounds.push(case.measure(*budget_us, self.solves)?);
                progress.advance(of_budget_s(*budget_us, self.solves));
            }
        }
        let all = all
            .into_iter()
            .map(|(case, us, rounds)| (case.name, us, rounds));
        dataset(&all.collect::<Vec<_>>(), self.rounds)
    }
}

/// Twice the budget: once without work.
fn of_budget_s(budget_us: u64, solves: u64) -> f64 {
    solves as f64 * (2e-6 * budget_us as f64 + AROUND_S)
}

/// Of each case with each budget \[µs\], and its rounds.
fn dataset(all: &[(&str, u64, Vec<Value>)], rounds: u32) -> Result<Dataset> {
    let mut dataset = Dataset::new(
        "budget",
        "How exactly a solve keeps its budget, offline",
        EXPLANATION,
    );
    let mut rows = Vec::new();
    for (case, budget_us, rounds) in all {
        let path = format!("budget/{case}/{budget_us}us");
        let numbers = [
            ("over_p50", "µs", "over_us_p50"),
            ("over_p99", "µs", "over_us_p99"),
        ];
        dataset.compare(&path, rounds, &numbers);
        let all = together(rounds, &COUNTS);
        let of_all = |key| Some(number(&all, key)? / number(&all, "solves")?);
        let share = json!({ "ended_by_budget_share": of_all("ended_by_budget") });
        let case = json!({ "case": case, "budget_us": budget_us });
        rows.push(joined([case, all, share]));
    }
    dataset.fact("rounds", rounds);
    dataset.plots.push(plot(
        "budget-overrun",
        "How much later than its budget a solve ends, beside a loop that only waits.",
        (2, 520),
        &panels(&rows),
    )?);
    let title = "How much later than its budget a solve ends, beside a loop without work";
    dataset
        .sheets
        .push(Sheet::of(title, &COLUMNS, rows).key("cases").file("budget"));
    Ok(dataset)
}

fn panels(rows: &[Value]) -> Vec<Panel> {
    let panel = |rows: &[Value]| {
        let curve = |label, key, colour| Curve::of_rows(label, rows, "budget_us", key, colour);
        Panel::new(
            format!("Case {}", rows[0]["case"].as_str().unwrap_or_default()),
            ["budget [µs]", "later than the budget [µs]"],
            Scale::Log { floor: 0.01 },
            vec![
                curve("solve, p99", "over_us_p99", BLUE),
                curve("solve, p50", "over_us_p50", GREEN),
                curve("without work, p99", "bare_over_us_p99", GREY),
            ],
        )
    };
    let of_case = rows.chunk_by(|one, other| one["case"] == other["case"]);
    of_case.map(panel).collect()
}

struct Case {
    name: &'static str,
    scene: Scene,
    settings: NmpcSettings,
    /// Commands that lead along the curve, the same for every budget.
    way: Vec<BendRates>,
}

/// The cases: the default, the paper's swarm for an orientation of the tip, and many particles and steps
/// among obstacles.
fn cases() -> Result<[Case; CASES]> {
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
    Ok([
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
    fn measure(&self, budget_us: u64, solves: u64) -> Result<Value> {
        let mut runner = Runner::new(self, Duration::from_micros(budget_us))?;
        let mut closed = ClosedLoop::new(&self.scene, self.settings)?;
        for solve in 0..solves {
            let input = SolveInput {
                seed: cycle_seed(self.settings.seed, solve),
                ..closed.input()
            };
            runner.wait();
            runner.solve(&input);
            closed.advance(&self.way[solve as usize % self.way.len()]);
            if closed.is_over() {
                closed = ClosedLoop::new(&self.scene, self.settings)?;
            }
        }
        let (name, worse) = (self.name, runner.worse);
        ensure!(
            worse == 0,
            "{name}, {budget_us} µs: {worse} of {solves} plans cost more than the warm start"
        );
        Ok(json!({
            "solves": solves,
            // Solves that the budget ended; the others had nothing left to do.
            "ended_by_budget": runner.ended_by_budget,
            // How much later than the budget a solve ended, and the loop without work.
            "over_us": Quantiles::of(&runner.over_ns),
            "bare_over_us": Quantiles::of(&runner.bare_over_ns),
            // Solves whose plan costs more than the warm start.
            "worse_than_warm_start": worse,
        }))
    }
}

struct Runner {
    budget: Duration,
    nmpc: Nmpc,
    evaluator: PlanEvaluator,
    over_ns: Histogram<u64>,
    bare_over_ns: Histogram<u64>,
    ended_by_budget: u64,
    worse: u64,
}

impl Runner {
    fn new(case: &Case, budget: Duration) -> Result<Self> {
        let (robot, period_s) = (case.scene.robot.clone(), case.scene.period_s);
        let mut nmpc = Nmpc::new(robot, period_s, case.settings)?;
        // Touches all memory that a solve may need.
        let closed = ClosedLoop::new(&case.scene, case.settings)?;
        nmpc.solve(&closed.input(), &mut Budget::unlimited());
        Ok(Self {
            budget,
            nmpc,
            evaluator: PlanEvaluator::new(&case.scene, case.settings)?,
            over_ns: histogram()?,
            bare_over_ns: histogram()?,
            ended_by_budget: 0,
            worse: 0,
        })
    }

    /// Asks the budget until it is spent, and does nothing else.
    fn wait(&mut self) {
        let begin = Instant::now();
        let mut is_spent = || begin.elapsed() >= self.budget;
        let mut budget = Budget::new(&mut is_spent);
        while budget.left() {}
        let over = begin.elapsed().saturating_sub(self.budget);
        self.bare_over_ns.saturating_record(over.as_nanos() as u64);
    }

    fn solve(&mut self, input: &SolveInput) {
        self.nmpc.forget_plan();
        let begin = Instant::now();
        let mut is_spent = || begin.elapsed() >= self.budget;
        let mut budget = Budget::new(&mut is_spent);
        let (_, report) = self.nmpc.solve(input, &mut budget);
        let over = begin.elapsed().saturating_sub(self.budget);
        self.over_ns.saturating_record(over.as_nanos() as u64);
        self.ended_by_budget += u64::from(report.budget_spent);
        let [plan_cost, warm_cost] =
            [self.nmpc.plan(), self.nmpc.warm_plan()].map(|plan| self.evaluator.cost(input, plan));
        self.worse += u64::from(plan_cost > warm_cost);
    }
}
