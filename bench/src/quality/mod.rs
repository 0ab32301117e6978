//! What time buys: how well the controller tracks, how clear it keeps and what its plans cost, against the
//! time of a solve, the swarm and the horizon; and how often a solver gets stuck.
//!
//! | file | question it answers |
//! |---|---|
//! | `course`, `legs` | what is driven |
//! | `variant`, `sizing` | with which solver, budget, swarm and horizon |
//! | `trial` | what came of one run |
//! | `problem`, `restarts` | who finds the best plan from a random start |
//! | `report`, `plots` | what came of it, as a dataset |
//!
//! A closed loop with an ideal robot, without a daemon. All is deterministic but for what the clock ends.

pub mod course;
mod legs;
mod plots;
mod problem;
mod report;
pub mod restarts;
mod sizing;
pub mod trial;
pub mod variant;

use anyhow::Result;

pub use problem::Field;

use crate::dataset::Dataset;
use crate::interrupt;
use crate::progress::Progress;
use crate::scene::Scene;
use course::Course;
use restarts::{Ending, contest};
use sizing::Sizing;
use trial::{RunMetrics, drive};
use variant::{BUDGETS_US, HORIZONS, SOLVERS, SWARMS, Variant};

use crate::experiment::Solver;

/// What a contest takes, about \[s\].
const CONTEST_S: f64 = 0.5;
/// What sizing the swarms of a course takes, about \[s\].
const SIZING_S: f64 = 0.2;

#[derive(Debug, Clone)]
pub struct QualityOptions {
    /// Runs of each variant, each with another seed.
    pub rounds: u32,
    pub courses: Vec<Course>,
    pub cycles_max: u64,
    pub budgets_us: Vec<u64>,
    pub swarms: Vec<(u32, u32)>,
    pub horizons: Vec<u32>,
    /// Random problems of each field in each round.
    pub restarts: u32,
}

impl QualityOptions {
    pub fn full() -> Self {
        Self {
            rounds: 3,
            courses: Course::ALL.to_vec(),
            cycles_max: u64::MAX,
            budgets_us: BUDGETS_US.to_vec(),
            swarms: SWARMS.to_vec(),
            horizons: HORIZONS.to_vec(),
            restarts: 6,
        }
    }

    /// One round of a part: a look, no measurement.
    pub fn quick() -> Self {
        Self {
            rounds: 1,
            courses: vec![Course::Spiral, Course::Gap, Course::Crossing],
            cycles_max: 200,
            budgets_us: vec![20, 200, 2000],
            swarms: vec![(6, 30), (24, 30)],
            horizons: vec![2, 8],
            restarts: 2,
        }
    }

    /// All variants of a course, in the order in which they are run.
    fn variants(&self, course: Course, sizing: &Sizing) -> Vec<Variant> {
        let mut variants = Vec::new();
        for &budget_us in &self.budgets_us {
            let timed = |solver| Variant::timed(course, solver, budget_us, sizing);
            variants.extend(SOLVERS.map(timed));
        }
        for &swarm in &self.swarms {
            let searching = [Solver::Kpso, Solver::KpsoRefined];
            variants.extend(searching.map(|solver| Variant::swarm(course, solver, swarm)));
        }
        for &steps in &self.horizons {
            variants.extend(SOLVERS.map(|solver| Variant::horizon(course, solver, steps)));
        }
        variants
    }

    fn scene(&self, course: Course) -> Result<Scene> {
        Ok(course.scene()?.at_most(self.cycles_max))
    }
}

#[derive(Debug, Clone)]
pub struct Case {
    pub variant: Variant,
    pub rounds: Vec<RunMetrics>,
}

pub fn expected_s(options: &QualityOptions) -> f64 {
    let rounds = f64::from(options.rounds);
    let contests = rounds * f64::from(options.restarts) * Field::ALL.len() as f64;
    let courses = options.courses.iter().map(|&course| {
        let Ok(scene) = options.scene(course) else {
            return 0.0;
        };
        let variants = options.variants(course, &Sizing { iteration_us: 10.0 });
        let round_s: f64 = variants.iter().map(|variant| run_s(variant, &scene)).sum();
        SIZING_S + rounds * round_s
    });
    courses.sum::<f64>() + contests * CONTEST_S
}

/// About how long one run of a variant takes \[s\].
fn run_s(variant: &Variant, scene: &Scene) -> f64 {
    scene.cycles as f64 * variant.solve_us() * 1e-6
}

/// Runs everything, round by round: what disturbs the machine for a while disturbs one round.
pub fn run(options: &QualityOptions, progress: &mut Progress) -> Result<Dataset> {
    let mut courses = Vec::new();
    for &course in &options.courses {
        interrupt::check()?;
        progress.begin(&format!("sizing the swarm of {}", course.name()));
        let sizing = Sizing::measure(course)?;
        progress.advance(SIZING_S);
        let cases = options
            .variants(course, &sizing)
            .into_iter()
            .map(|variant| Case {
                variant,
                rounds: Vec::new(),
            });
        courses.push((options.scene(course)?, cases.collect::<Vec<_>>()));
    }
    let mut endings = Vec::new();
    for round in 0..options.rounds {
        for (scene, cases) in &mut courses {
            drive_all(scene, cases, round, progress)?;
        }
        endings.push(contest_all(options.restarts, round, progress)?);
    }
    let cases: Vec<Case> = courses.into_iter().flat_map(|(_, cases)| cases).collect();
    report::dataset(&cases, &endings)
}

/// One round of every variant of a course.
fn drive_all(scene: &Scene, cases: &mut [Case], round: u32, progress: &mut Progress) -> Result<()> {
    for case in cases {
        interrupt::check()?;
        let variant = &case.variant;
        progress.begin(&format!(
            "round {}: {}, {}, {}",
            round + 1,
            variant.course.name(),
            variant.solver.name(),
            variant.value()
        ));
        case.rounds
            .push(drive(variant, scene, u64::from(round) + 1)?);
        progress.advance(run_s(variant, scene));
    }
    Ok(())
}

/// The random problems of one round; every round has others.
fn contest_all(restarts: u32, round: u32, progress: &mut Progress) -> Result<Vec<Ending>> {
    let mut endings = Vec::new();
    for field in Field::ALL {
        for restart in 0..restarts {
            interrupt::check()?;
            progress.begin(&format!(
                "round {}: random starts, {}",
                round + 1,
                field.name()
            ));
            endings.extend(contest(field, u64::from(round * restarts + restart))?);
            progress.advance(CONTEST_S);
        }
    }
    Ok(endings)
}
