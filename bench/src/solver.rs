//! How long a solve takes, and how that grows with sections, steps, particles and iterations, on every
//! path of this processor.
//!
//! All paths give the same bits, so in each cycle every path solves the same problem, one after the
//! other, and the speed-up is a ratio of times that were measured side by side.

use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput, SolverKind};
use cdcr_controller::optimizer::{Budget, Path, cycle_seed};
use cdcr_controller::robot::{BendRates, Configuration};
use cdcr_controller::safety::limit;
use hdrhistogram::Histogram;
use serde::Serialize;

use crate::closed_loop::{Scene, histogram, window};
use crate::paper;

/// Cycles of one case, at most.
const CYCLES_MAX: u64 = 400;
/// Time of one case, about.
const CASE_TIME: Duration = Duration::from_secs(2);
/// Cycles at the start of a case that are not counted.
const WARM_UP: u64 = 10;

/// One line: one solver on one path, at one size.
#[derive(Debug, Clone, Serialize)]
pub struct Case {
    /// Solver.
    pub solver: &'static str,
    /// Path of the swarm.
    pub path: Path,
    /// Sections of the robot.
    pub sections: usize,
    /// Prediction steps.
    pub horizon: u32,
    /// Particles.
    pub swarm: u32,
    /// Swarm iterations.
    pub iterations: u32,
    /// Obstacles.
    pub obstacles: u32,
    /// Median \[µs\].
    pub p50_us: f64,
    /// 99th percentile \[µs\].
    pub p99_us: f64,
    /// Median of the scalar path over the median of this one, in the same run.
    pub speedup_vs_scalar: f64,
}

/// A size at which every path is measured.
#[derive(Debug, Clone, Copy)]
pub struct Size {
    solver: SolverKind,
    name: &'static str,
    sections: usize,
    horizon: u32,
    swarm: u32,
    iterations: u32,
}

/// The sizes that are measured: the paper's, and from there one thing at a time.
pub fn sizes() -> Vec<Size> {
    let base = Size {
        solver: SolverKind::Kpso,
        name: "kpso",
        sections: 3,
        horizon: 2,
        swarm: 6,
        iterations: 30,
    };
    let refined = Size {
        solver: SolverKind::KpsoRefined,
        name: "kpso-refined",
        ..base
    };
    let newton = Size {
        solver: SolverKind::GaussNewton,
        name: "gauss-newton",
        ..base
    };
    let mut sizes = Vec::new();
    for size in [base, refined, newton] {
        sizes.extend((1..=6).map(|sections| Size { sections, ..size }));
    }
    sizes.extend([1, 5, 10, 20, 50].map(|horizon| Size { horizon, ..base }));
    sizes.extend([1, 5, 10, 20, 50].map(|horizon| Size { horizon, ..newton }));
    sizes.extend([8, 16, 64, 256, 512].map(|swarm| Size { swarm, ..base }));
    sizes.extend([10, 100].map(|iterations| Size { iterations, ..base }));
    sizes.push(Size {
        swarm: 15,
        iterations: 70,
        ..refined
    });
    sizes.push(Size {
        swarm: 64,
        horizon: 20,
        ..refined
    });
    sizes
}

/// Measures one size on every path.
///
/// # Errors
/// When a controller cannot be built, or two paths disagree.
pub fn measure(size: &Size) -> Result<Vec<Case>> {
    let (robot, curve) = paper::spiral_of(size.sections)?;
    let scene = Scene {
        robot: &robot,
        start: paper::start(size.sections, curve.start_bend_rad()),
        curve: &curve,
        cycles: CYCLES_MAX,
        period_s: paper::PERIOD_S,
    };
    let settings = NmpcSettings {
        solver: size.solver,
        horizon_steps: size.horizon,
        swarm_size: size.swarm,
        swarm_iterations: size.iterations,
        ..NmpcSettings::default()
    };
    let mut runners = Vec::new();
    for path in Path::available() {
        let nmpc = Nmpc::on_path(path, robot.clone(), scene.period_s, settings)?;
        runners.push((path, nmpc, histogram()?));
    }
    race(&scene, &settings, &mut runners)?;
    let us = |times: &Histogram<u64>, quantile| times.value_at_quantile(quantile) as f64 * 1e-3;
    let scalar_us = runners
        .first()
        .map_or(f64::NAN, |(_, _, times)| us(times, 0.5));
    let case = |(path, _, times): &(Path, Nmpc, Histogram<u64>)| Case {
        solver: size.name,
        path: *path,
        sections: size.sections,
        horizon: size.horizon,
        swarm: size.swarm,
        iterations: size.iterations,
        obstacles: 0,
        p50_us: us(times, 0.5),
        p99_us: us(times, 0.99),
        speedup_vs_scalar: scalar_us / us(times, 0.5),
    };
    Ok(runners.iter().map(case).collect())
}

/// The closed loop, in which every path solves every cycle.
fn race(
    scene: &Scene,
    settings: &NmpcSettings,
    runners: &mut [(Path, Nmpc, Histogram<u64>)],
) -> Result<()> {
    let mut at: Configuration = scene.start;
    let mut rates = BendRates::zero(scene.robot.section_count());
    let begin = Instant::now();
    for cycle in 0..scene.cycles {
        let reference = window(scene, cycle, settings.horizon_steps);
        let input = SolveInput {
            configuration: &at,
            previous_rates: &rates,
            reference: &reference,
            elapsed_periods: 1,
            seed: cycle_seed(settings.seed, cycle),
        };
        let mut wish = None;
        for (path, nmpc, times) in &mut *runners {
            let start = Instant::now();
            let (rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
            if cycle >= WARM_UP {
                times.saturating_record(start.elapsed().as_nanos() as u64);
            }
            let first = wish.get_or_insert(rates);
            ensure!(
                *first == rates,
                "{path:?} gives other rates than the scalar path"
            );
        }
        let wish = wish.unwrap_or(rates);
        rates = limit(scene.robot, &at, &wish, scene.period_s).rates;
        at = at.advanced(&rates, scene.period_s);
        if begin.elapsed() > CASE_TIME && cycle > 2 * WARM_UP {
            break;
        }
    }
    Ok(())
}
