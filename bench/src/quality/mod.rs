//! Error, clearance and cost over the solve time, the swarm and the horizon; how often a solver gets stuck.

pub mod course;
mod report;
mod restarts;
mod variant;

use anyhow::Result;
use cdcr_controller::nmpc::SolverKind;

pub use restarts::{CONTENDERS, Field};

use crate::benchmark::Benchmark;
use crate::dataset::Dataset;
use crate::progress::Progress;
use crate::study::{self, StudyCase};
use course::Course;
use variant::{Variant, Varied, iteration_us};

/// Approximate duration of a contest \[s\].
const CONTEST_S: f64 = 0.5;

#[derive(Debug, Clone, clap::Args)]
pub struct QualityOptions {
    /// Runs per variant, each with its own seed, 1 to 100.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: u32,
    #[arg(skip = Course::ALL)]
    pub courses: Vec<Course>,
    #[arg(skip = u64::MAX)]
    pub cycles_max: u64,
    #[arg(skip = [10, 20, 50, 100, 200, 500, 1000, 2000, 4000])]
    pub budgets_us: Vec<u64>,
    /// Particles and iterations: the paper's is the second.
    #[arg(skip = [(6, 10), (6, 30), (12, 30), (24, 30), (24, 60)])]
    pub swarms: Vec<(u32, u32)>,
    #[arg(skip = [1, 2, 4, 8, 16])]
    pub horizons: Vec<u32>,
    /// Random problems of each field in each round.
    #[arg(skip = 6_u32)]
    pub restarts: u32,
}

impl QualityOptions {
    fn variants(&self, course: Course, iteration_us: f64) -> Vec<Variant> {
        let budgets = (self.budgets_us.iter()).map(|us| Varied::Budget(*us, iteration_us));
        let swarms = (self.swarms.iter()).map(|&(size, turns)| Varied::Swarm(size, turns));
        let horizons = self.horizons.iter().map(|steps| Varied::Horizon(*steps));
        let varied = budgets.chain(swarms).chain(horizons);
        let all = varied.flat_map(|varied| SolverKind::ALL.map(|solver| (varied, solver)));
        let has_effect = |case: &(Varied, SolverKind)| {
            !matches!(case, (Varied::Swarm(..), SolverKind::GaussNewton))
        };
        let variant = |(varied, solver)| Variant::new(course, solver, varied);
        all.filter(has_effect).map(variant).collect()
    }

    fn cases(
        &self,
        iteration_us: impl Fn(Course) -> Result<f64>,
    ) -> Result<Vec<StudyCase<'static>>> {
        let mut cases = Vec::new();
        let (cycles_max, restarts) = (self.cycles_max, self.restarts);
        for &course in &self.courses {
            let cycles = course.scene()?.cycles.min(cycles_max);
            for variant in self.variants(course, iteration_us(course)?) {
                cases.push(StudyCase {
                    table: variant.axis().0,
                    what: variant.words(),
                    expected_s: variant.expected_s(cycles),
                    measure: Box::new(move |round| {
                        let scene = course.scene()?.at_most(cycles_max);
                        Ok(vec![variant.drive(&scene, round.into())?])
                    }),
                });
            }
        }
        for field in Field::ALL {
            for restart in 0..restarts {
                // Different in every round.
                let seed = move |round: u32| u64::from((round - 1) * restarts + restart);
                cases.push(StudyCase {
                    table: report::PROBLEMS,
                    what: format!("random starts, {}", field.name()),
                    expected_s: CONTEST_S,
                    measure: Box::new(move |round| restarts::contest(field, seed(round))),
                });
            }
        }
        Ok(cases)
    }
}

impl Benchmark for QualityOptions {
    fn quicken(&mut self) {
        *self = Self {
            rounds: 1,
            courses: vec![Course::Spiral, Course::Gap, Course::Crossing],
            cycles_max: 200,
            budgets_us: vec![20, 200, 2000],
            swarms: vec![(6, 30), (24, 30)],
            horizons: vec![2, 8],
            restarts: 2,
        };
    }

    fn expected_s(&self) -> f64 {
        let cases = self.cases(|_| Ok(10.0)).unwrap_or_default();
        study::expected_s(self.rounds, &cases)
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        progress.begin("sizing the swarms");
        let cases = self.cases(iteration_us)?;
        report::dataset(self.rounds, &study::run(self.rounds, &cases, progress)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_variant_has_legal_settings() {
        let options: QualityOptions = crate::benchmark::defaults();
        for course in Course::ALL {
            for variant in options.variants(course, 2.0) {
                assert_eq!(variant.settings.validate(), Ok(()), "{variant:?}");
            }
        }
    }
}
