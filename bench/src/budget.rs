//! How much later than its budget a solve ends, and whether its plan is ever worse than the warm start. Before
//! each solve, a loop without work waits for the same budget: its delay is the machine's.

use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use cdcr_controller::nmpc::{NmpcSettings, SolverKind};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::robot::BendRates;
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::chart::{BLUE, GREEN, GREY, Panel, Scale, of_rows};
use crate::closed_loop::{self, End, PlanEvaluator, Scene, timed_solve};
use crate::dataset::Dataset;
use crate::experiment::Task;
use crate::progress::Progress;
use crate::quantiles::{histogram, quantiles};
use crate::solver::Size;
use crate::study::{self, StudyCase};

pub const BUDGETS_US: [u64; 11] = [0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

/// Time around a solve, beyond its budget and the wait before it, approximate \[s\].
const AROUND_S: f64 = 3e-4;
const WAYS: usize = 3;

const CASES: &str = "cases";

#[derive(Debug, Clone, Copy, clap::Args)]
pub struct BudgetOptions {
    /// Rounds over all budgets, 1 to 100; a time is the median over the rounds, a maximum that of all.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// Solves per case and budget in a round, 1 to 1000000.
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

    fn expected_s(&self) -> f64 {
        let of_way_s = BUDGETS_US.map(|us| expected_s(us, self.solves));
        f64::from(self.rounds) * WAYS as f64 * of_way_s.iter().sum::<f64>()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let (ways, solves) = (Way::all()?, self.solves);
        let mut cases = Vec::new();
        for (way, us) in ways.iter().flat_map(|way| BUDGETS_US.map(|us| (way, us))) {
            cases.push(StudyCase {
                table: CASES,
                what: way.name.to_owned(),
                expected_s: expected_s(us, solves),
                measure: Box::new(move |_| Ok(vec![way.measure(us, solves)?])),
            });
        }
        let mut dataset = Dataset::new("budget", include_str!("budget.toml"));
        dataset.add_rounds(CASES, study::run(self.rounds, &cases, progress)?.get(CASES));
        dataset.fact("rounds", self.rounds);
        dataset.plot("budget-overrun", &panels(dataset.rows(CASES)))?;
        Ok(dataset)
    }
}

fn expected_s(budget_us: u64, solves: u64) -> f64 {
    solves as f64 * (2e-6 * budget_us as f64 + AROUND_S)
}

fn panels(rows: &[Value]) -> Vec<Panel> {
    let panel = |rows: &[Value]| {
        let curve = |label, key, colour| of_rows(label, rows, "budget_us", key, colour);
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

struct Way {
    name: &'static str,
    scene: Scene,
    settings: NmpcSettings,
    /// Commands along the curve, the same for every budget.
    commands: Vec<BendRates>,
}

impl Way {
    fn all() -> Result<Vec<Self>> {
        let refined = |task| Size::paper(task, SolverKind::KpsoRefined);
        let default = refined(Task::Spiral { sections: 3 });
        let rate_limit_rad_s = 2.0;
        let cases = [
            ("default", default),
            ("tip-axis", refined(Task::Line { rate_limit_rad_s })),
            ("obstacles", default.among_obstacles()),
        ];
        let way = |(name, size): (_, Size)| {
            let (scene, settings) = (size.scene()?, size.settings);
            let driving = size.with(|it| it.solver = SolverKind::GaussNewton);
            let run = closed_loop::run(&scene, driving.settings)?;
            let commands = run.0.into_iter().map(|sample| sample.rates).collect();
            Ok(Self {
                name,
                scene,
                settings,
                commands,
            })
        };
        cases.into_iter().map(way).collect()
    }

    /// Solves along the curve with this budget. Every solve has another seed and starts from zero rates, so
    /// that work is left. At its end the curve restarts.
    fn measure(&self, budget_us: u64, solves: u64) -> Result<Value> {
        let budget = Duration::from_micros(budget_us);
        let over_ns = |time: Duration| time.saturating_sub(budget).as_nanos() as u64;
        let mut nmpc = self.scene.solver(self.settings)?;
        let mut evaluator = PlanEvaluator::new(&self.scene, self.settings)?;
        let mut closed = self.scene.begin(self.settings)?;
        let [mut own_ns, mut bare_ns] = [histogram(), histogram()];
        let (mut ended_by_budget, mut worse) = (0_u64, 0_u64);
        // Touches all memory that a solve may need.
        nmpc.solve(&closed.input(), &mut Budget::unlimited());
        for solve in 0..solves {
            let mut input = closed.input();
            input.seed = cycle_seed(self.settings.seed, solve);
            bare_ns.saturating_record(over_ns(wait(budget)));
            nmpc.forget_plan();
            let (_, report, time) = timed_solve(&mut nmpc, &input, End::After(budget));
            own_ns.saturating_record(over_ns(time));
            ended_by_budget += u64::from(report.budget_spent);
            let plans = [nmpc.plan(), nmpc.warm_plan()];
            let [plan_cost, warm_cost] = plans.map(|plan| evaluator.cost(&input, plan));
            worse += u64::from(plan_cost > warm_cost);
            closed.advance(&self.commands[solve as usize % self.commands.len()]);
            if closed.cycle() == self.scene.cycles {
                closed = self.scene.begin(self.settings)?;
            }
        }
        let what = format!("{worse} of {solves} plans cost more than the warm start");
        ensure!(worse == 0, "{}, {budget_us} µs: {what}", self.name);
        Ok(json!({
            "case": self.name,
            "budget_us": budget_us,
            "solves": solves,
            "ended_by_budget": ended_by_budget,
            "ended_by_budget_share": ended_by_budget as f64 / solves as f64,
            // Time beyond the budget, of the solve and of the loop without work.
            "over_us": quantiles(&own_ns),
            "bare_over_us": quantiles(&bare_ns),
            "worse_than_warm_start": worse,
        }))
    }
}

fn wait(budget: Duration) -> Duration {
    let begin = Instant::now();
    let mut is_spent = || begin.elapsed() >= budget;
    let mut waiting = Budget::new(&mut is_spent);
    while waiting.begin_quantum() {}
    begin.elapsed()
}
