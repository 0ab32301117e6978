//! Solve time on every SIMD path and its growth with each size; times of the estimate before a solve and of the
//! safety checks after it.

pub mod estimate;
pub mod growth;
pub mod guard;
pub mod hard;

use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolverKind};
use cdcr_controller::optimizer::Simd;
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::chart::{Curve, Panel, Scale, of_solvers};
use crate::closed_loop::{End, PERIOD_S, Scene, timed_solve};
use crate::dataset::Dataset;
use crate::experiment::Task;
use crate::progress::Progress;
use crate::quantiles::{histogram, quantile_us};
use crate::study::{self, StudyCase};

const CYCLES_MAX: u64 = 400;
/// In the first second the robot bends little: all obstacles stay within reach and off its path.
const OBSTACLE_CYCLES_MAX: u64 = 200;
/// Approximate time of one size, unless `CYCLES_MIN` take longer.
const SIZE_TIME: Duration = Duration::from_millis(1200);
/// Uncounted cycles at the start of a case.
const WARM_UP: u64 = 10;
const CYCLES_MIN: u64 = 2 * WARM_UP;

/// Approximate time of one size \[s\].
const SIZE_S: f64 = 1.0;

const CASES: &str = "cases";

/// A table, its duration \[s\], and its rows; with a divisor above 1 only a part of them.
type Measured = (&'static str, f64, fn(u64) -> Result<Vec<Value>>);

const BESIDE: [Measured; 4] = [
    ("hard", 10.0, hard::measure),
    ("hard_deadlines", 6.0, hard::measure_by_deadlines),
    ("guard", 3.0, guard::measure),
    ("estimate", 1.0, estimate::measure),
];
const SHORTENED: u64 = 20;

#[derive(Debug, Clone, Copy, clap::Args)]
pub struct SolverOptions {
    /// Rounds over all sizes, 1 to 100; results are medians.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// Only the smallest robot, no hard problems, and a part of the moments.
    #[arg(skip)]
    is_short: bool,
}

impl SolverOptions {
    fn cases(&self) -> Vec<StudyCase<'static>> {
        let is_measured = |size: &Size| !self.is_short || size.task == Task::Spiral { sections: 1 };
        let of_size = |size: Size| StudyCase {
            table: CASES,
            what: size.solver.name().to_owned(),
            expected_s: SIZE_S,
            measure: Box::new(move |_| measure(&size)),
        };
        let divisor = if self.is_short { SHORTENED } else { 1 };
        let of_table = |(table, whole_s, measure): Measured| StudyCase {
            table,
            what: table.replace('_', " "),
            expected_s: whole_s / divisor as f64,
            measure: Box::new(move |_| measure(divisor)),
        };
        let of_sizes = sizes().into_iter().filter(is_measured).map(of_size);
        of_sizes.chain(BESIDE.map(of_table)).collect()
    }
}

impl Benchmark for SolverOptions {
    fn for_report(&mut self) {
        self.rounds = 3;
    }

    fn quicken(&mut self) {
        self.is_short = true;
    }

    fn expected_s(&self) -> f64 {
        study::expected_s(self.rounds, &self.cases())
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let found = study::run(self.rounds, &self.cases(), progress)?;
        let mut dataset = Dataset::new("solver", include_str!("solver/solver.toml"));
        dataset.fact("rounds", self.rounds);
        dataset.add_rounds(CASES, found.get(CASES));
        for (table, ..) in BESIDE {
            dataset.add_rounds(table, found.get(table));
        }
        // The paper's size is part of every series.
        let metrics = &mut dataset.metrics;
        metrics.sort_by(|one, other| one.name.cmp(&other.name));
        metrics.dedup_by(|one, other| one.name == other.name);
        let cases = dataset.rows(CASES).to_vec();
        dataset.add("growth", growth::rows(&cases));
        dataset.plot("solver-sections", &[panel(&cases)])?;
        Ok(dataset)
    }
}

fn panel(cases: &[Value]) -> Panel {
    let curves = of_solvers(|solver, colour| {
        let points = growth::series(cases, solver, growth::SECTION);
        Curve::line(solver.name(), points, colour)
    });
    let title = "Median of a solve on the fastest path";
    let scale = Scale::Log { floor: 0.1 };
    Panel::new(title, ["sections", "time [µs]"], scale, curves)
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    pub task: Task,
    pub solver: SolverKind,
    pub settings: NmpcSettings,
    pub obstacles: usize,
}

/// The measured sizes: the paper's, and variations of one quantity at a time.
pub fn sizes() -> Vec<Size> {
    let base = Size::paper(Task::Spiral { sections: 3 }, SolverKind::Kpso);
    let refined = Size::paper(base.task, SolverKind::KpsoRefined);
    let newton = Size::paper(base.task, SolverKind::GaussNewton);
    let mut sizes = Vec::new();
    for size in [base, refined, newton] {
        let tasks = (1..=6).map(|sections| Task::Spiral { sections });
        sizes.extend(tasks.map(|task| Size { task, ..size }));
        sizes.extend([1, 5, 10, 20, 50].map(|steps| size.with(|it| it.horizon_steps = steps)));
        sizes.extend([1, 4, 16, 64].map(|obstacles| Size { obstacles, ..size }));
    }
    sizes.extend([16, 64, 256, 512].map(|count| base.with(|it| it.swarm_size = count)));
    sizes.extend([10, 100].map(|count| base.with(|it| it.swarm_iterations = count)));
    let rate_limit_rad_s = 2.0;
    let line = Task::Line { rate_limit_rad_s };
    sizes.push(Size::paper(line, SolverKind::KpsoRefined));
    sizes.push(refined.among_obstacles());
    sizes
}

impl Size {
    pub(crate) fn paper(task: Task, solver: SolverKind) -> Self {
        Self {
            task,
            solver,
            settings: task.settings(solver),
            obstacles: 0,
        }
    }

    pub(crate) fn with(mut self, change: impl FnOnce(&mut NmpcSettings)) -> Self {
        change(&mut self.settings);
        self
    }

    pub(crate) fn among_obstacles(mut self) -> Self {
        (self.settings.swarm_size, self.settings.horizon_steps) = (64, 20);
        self.obstacles = 16;
        self
    }

    pub(crate) fn scene(&self) -> Result<Scene> {
        let cycles_max = [CYCLES_MAX, OBSTACLE_CYCLES_MAX][usize::from(self.obstacles > 0)];
        let scene = self.task.scene()?.at_most(cycles_max);
        Ok(scene.crowded(self.obstacles, self.settings.safe_distance_m, 4)?)
    }
}

fn measure(size: &Size) -> Result<Vec<Value>> {
    let (scene, settings) = (size.scene()?, size.settings);
    let mut closed = scene.begin(settings)?;
    let mut runners = Vec::new();
    for path in Simd::available() {
        let nmpc = Nmpc::with_simd(path, scene.robot.clone(), PERIOD_S, settings)?;
        runners.push((path, nmpc, histogram()));
    }
    let begin = Instant::now();
    let is_short = |cycle| begin.elapsed() <= SIZE_TIME || cycle <= CYCLES_MIN;
    while closed.cycle() < scene.cycles && is_short(closed.cycle()) {
        let mut desired_rates = None;
        for (path, nmpc, times) in &mut runners {
            let (rates, _, time) = timed_solve(nmpc, &closed.input(), End::Never);
            if closed.cycle() >= WARM_UP {
                times.saturating_record(time.as_nanos() as u64);
            }
            let is_same = *desired_rates.get_or_insert(rates) == rates;
            ensure!(is_same, "{path:?} gives other rates than the scalar path");
        }
        closed.advance(&desired_rates.context("no path")?);
    }
    // The scalar path is the first.
    let scalar_us = quantile_us(&runners[0].2, 0.5);
    let case = |(path, _, times): &(Simd, Nmpc, _)| {
        let p50_us = quantile_us(times, 0.5);
        json!({
            "solver": size.solver,
            // The line includes an orientation.
            "curve": size.task.name(),
            "path": path,
            "sections": scene.robot.section_count(),
            "horizon": settings.horizon_steps,
            "swarm": settings.swarm_size,
            "iterations": settings.swarm_iterations,
            "obstacles": size.obstacles,
            "p50_us": p50_us,
            "p99_us": quantile_us(times, 0.99),
            "speedup_vs_scalar": scalar_us / p50_us,
        })
    };
    Ok(runners.iter().map(case).collect())
}
