//! What time buys: how well the controller tracks, how clear it keeps and what its plans cost, against the
//! time of a solve, the swarm and the horizon; and how often a solver gets stuck.
//!
//! A [`course`] is driven with each [`variant`] of solver, budget, swarm and horizon; in [`restarts`] solvers look for the
//! best plan from a random start. All is deterministic but for what the clock ends.

pub mod course;
mod problem;
mod report;
pub mod restarts;
mod sizing;
pub mod trial;
pub mod variant;

use anyhow::Result;
use serde_json::{Value, json};

pub use problem::Field;

use crate::benchmark::Benchmark;
use crate::dataset::Dataset;
use crate::interrupt;
use crate::progress::Progress;
use crate::scene::Scene;
use course::Course;
use restarts::{Ending, contest};
use sizing::Sizing;
use trial::drive;
use variant::{BUDGETS_US, HORIZONS, SOLVERS, SWARMS, Variant};

use crate::experiment::Solver;

/// What a contest takes, about \[s\].
const CONTEST_S: f64 = 0.5;
/// What sizing the swarms of a course takes, about \[s\].
const SIZING_S: f64 = 0.2;

#[derive(Debug, Clone, clap::Args)]
pub struct QualityOptions {
    /// Runs of each variant, each with another seed, 1 to 100.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    /// One round of a part of it: a look of some seconds, no measurement.
    #[arg(long, conflicts_with = "rounds")]
    pub quick: bool,
    #[arg(skip = Course::ALL)]
    pub courses: Vec<Course>,
    #[arg(skip = u64::MAX)]
    pub cycles_max: u64,
    #[arg(skip = BUDGETS_US)]
    pub budgets_us: Vec<u64>,
    #[arg(skip = SWARMS)]
    pub swarms: Vec<(u32, u32)>,
    #[arg(skip = HORIZONS)]
    pub horizons: Vec<u32>,
    /// Random problems of each field in each round.
    #[arg(skip = 6_u32)]
    pub restarts: u32,
}

impl QualityOptions {
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

    /// The random problems of one round; every round has others.
    fn contests(&self, round: u32, progress: &mut Progress) -> Result<Vec<Ending>> {
        let mut endings = Vec::new();
        for field in Field::ALL {
            for restart in 0..self.restarts {
                interrupt::check()?;
                progress.begin(&format!("round {round}: random starts, {}", field.name()));
                endings.extend(contest(
                    field,
                    u64::from((round - 1) * self.restarts + restart),
                )?);
                progress.advance(CONTEST_S);
            }
        }
        Ok(endings)
    }
}

struct Case {
    scene: usize,
    variant: Variant,
    rounds: Vec<Value>,
}

impl Benchmark for QualityOptions {
    fn quicken(&mut self) {
        *self = Self {
            rounds: 1,
            quick: true,
            courses: vec![Course::Spiral, Course::Gap, Course::Crossing],
            cycles_max: 200,
            budgets_us: vec![20, 200, 2000],
            swarms: vec![(6, 30), (24, 30)],
            horizons: vec![2, 8],
            restarts: 2,
        };
    }

    fn is_quick(&self) -> bool {
        self.quick
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.rounds
    }

    fn expected_s(&self) -> f64 {
        let rounds = f64::from(self.rounds);
        let contests = rounds * f64::from(self.restarts) * Field::ALL.len() as f64;
        let courses = self.courses.iter().map(|&course| {
            let Ok(scene) = self.scene(course) else {
                return 0.0;
            };
            let variants = self.variants(course, &Sizing { iteration_us: 10.0 });
            let round_s: f64 = variants.iter().map(|variant| run_s(variant, &scene)).sum();
            SIZING_S + rounds * round_s
        });
        courses.sum::<f64>() + contests * CONTEST_S
    }

    /// Runs everything, round by round: what disturbs the machine for a while disturbs one round.
    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let (mut scenes, mut cases) = (Vec::new(), Vec::new());
        for &course in &self.courses {
            interrupt::check()?;
            progress.begin(&format!("sizing the swarm of {}", course.name()));
            let sizing = Sizing::measure(course)?;
            progress.advance(SIZING_S);
            scenes.push(self.scene(course)?);
            cases.extend(
                self.variants(course, &sizing)
                    .into_iter()
                    .map(|variant| Case {
                        scene: scenes.len() - 1,
                        variant,
                        rounds: Vec::new(),
                    }),
            );
        }
        let mut endings = Vec::new();
        for round in 1..=self.rounds {
            for case in &mut cases {
                interrupt::check()?;
                let (variant, scene) = (&case.variant, &scenes[case.scene]);
                let names = [
                    variant.course.name(),
                    variant.solver.name(),
                    &variant.value(),
                ]
                .join(", ");
                progress.begin(&format!("round {round}: {names}"));
                case.rounds
                    .push(json!(drive(variant, scene, round.into())?));
                progress.advance(run_s(variant, scene));
            }
            endings.push(self.contests(round, progress)?);
        }
        report::dataset(&cases, &endings)
    }
}

/// About how long one run of a variant takes \[s\].
fn run_s(variant: &Variant, scene: &Scene) -> f64 {
    scene.cycles as f64 * variant.solve_us() * 1e-6
}
