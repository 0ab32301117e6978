//! The times of a solve as a result: several rounds over all sizes, so that they have a spread.

use anyhow::{Context, Result};
use serde_json::{Value, json};

use crate::chart::{BLUE, Curve, GREEN, ORANGE, PURPLE, Panel, Scale, sheet};
use crate::csv::csv;
use crate::figures::Figure;
use crate::growth::{Growth, growth};
use crate::interrupt;
use crate::metric::{Metric, median};
use crate::progress::Progress;
use crate::section::{Section, Sheet};
use crate::solver::{self, Case, Size};
use crate::table::{self, Table};

/// Time of one size, about \[s\].
const SIZE_S: f64 = 1.0;
/// Sections at which every solver is measured in a quick look.
const QUICK_SECTIONS: usize = 1;

const EXPLANATION: &str = "\
<p>How long one solve takes, back to back, without a daemon: the paper's size, and from there one thing at a \
time. Every path of the processor gives the same bits; in each cycle all paths solve the same problem, one \
after the other, so the speed-up is a ratio of times that were measured side by side. Each number is the \
median of the rounds, and a round goes through all sizes. First solves are not counted.</p>\n";

#[derive(Debug, Clone)]
pub struct Options {
    pub rounds: u32,
    pub sizes: Vec<Size>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            rounds: 3,
            sizes: solver::sizes(),
        }
    }
}

impl Options {
    /// One round over the shortest robot.
    pub fn quick() -> Self {
        let is_small = |size: &Size| matches!(size.task, crate::experiment::Task::Spiral { sections } if sections == QUICK_SECTIONS);
        let mut sizes = solver::sizes();
        sizes.retain(is_small);
        Self { rounds: 1, sizes }
    }
}

/// About how long it takes \[s\].
pub fn expected_s(options: &Options) -> f64 {
    f64::from(options.rounds) * options.sizes.len() as f64 * SIZE_S
}

/// Measures all sizes on every path, round by round.
pub fn run(options: &Options, progress: &mut Progress) -> Result<Report> {
    let mut rounds = Vec::new();
    for round in 1..=options.rounds {
        let mut cases = Vec::new();
        for size in &options.sizes {
            interrupt::check()?;
            progress.begin(&format!("round {round} of {}", options.rounds));
            cases.extend(solver::measure(size)?);
            progress.advance(SIZE_S);
        }
        rounds.push(cases);
    }
    Report::of(rounds)
}

#[derive(Debug)]
pub struct Report {
    /// The cases of each round, in the same order.
    rounds: Vec<Vec<Case>>,
    cases: Vec<Case>,
    growth: Vec<Growth>,
}

impl Report {
    fn of(rounds: Vec<Vec<Case>>) -> Result<Self> {
        let first = rounds.first().context("at least one round is needed")?;
        let middle = |index: usize, value: fn(&Case) -> f64| {
            let values: Vec<f64> = rounds.iter().map(|cases| value(&cases[index])).collect();
            median(&values).unwrap_or(f64::NAN)
        };
        let cases: Vec<Case> = first
            .iter()
            .enumerate()
            .map(|(index, case)| Case {
                p50_us: middle(index, |case| case.p50_us),
                p99_us: middle(index, |case| case.p99_us),
                speedup_vs_scalar: middle(index, |case| case.speedup_vs_scalar),
                ..case.clone()
            })
            .collect();
        Ok(Self {
            growth: growth(&cases),
            cases,
            rounds,
        })
    }

    /// The median of every solver on every path beside the sections of the robot.
    fn panel(&self) -> Panel {
        let colours = [BLUE, ORANGE, GREEN, PURPLE];
        let fastest = self.cases.last().map(|case| case.path);
        let mut curves: Vec<Curve> = Vec::new();
        let mut names: Vec<&str> = self.cases.iter().map(|case| case.solver.name()).collect();
        names.sort_unstable();
        names.dedup();
        for (name, colour) in names.into_iter().zip(colours) {
            let is_ours = |case: &&Case| {
                Some(case.path) == fastest
                    && case.solver.name() == name
                    && case.curve == "spiral"
                    && (case.horizon, case.obstacles) == (2, 0)
                    && (case.swarm, case.iterations) == (6, 30)
            };
            let ours = self.cases.iter().filter(is_ours);
            let mut points: Vec<_> = ours.map(|c| (c.sections as f64, c.p50_us)).collect();
            points.sort_by(|one, other| one.0.total_cmp(&other.0));
            points.dedup_by_key(|point| point.0);
            curves.push(Curve::line(name, points, colour));
        }
        Panel {
            title: "Median of a solve on the fastest path".to_owned(),
            x: "sections",
            y: "time [µs]",
            scale: Scale::Log { floor: 0.1 },
            curves,
        }
    }
}

impl Section for Report {
    fn name(&self) -> &'static str {
        "solver"
    }

    fn heading(&self) -> &'static str {
        "Time of a solve, offline"
    }

    fn explanation(&self) -> &'static str {
        EXPLANATION
    }

    fn json(&self) -> Result<Value> {
        Ok(json!({ "rounds": self.rounds.len(), "cases": self.cases, "growth": self.growth }))
    }

    fn tables(&self) -> Vec<Table> {
        let mut tables = vec![table::cases(&self.cases)];
        if !self.growth.is_empty() {
            tables.insert(0, table::growth(&self.growth));
        }
        tables
    }

    fn sheets(&self) -> Result<Vec<Sheet>> {
        let sheet = |name: &str, csv| Sheet {
            name: name.to_owned(),
            csv,
        };
        Ok(vec![
            sheet("solver", csv(&self.cases)?),
            sheet("solver-growth", csv(&self.growth)?),
        ])
    }

    fn pictures(&self) -> Result<Vec<Figure>> {
        Ok(vec![Figure {
            name: "solver-sections",
            caption:
                "How the time of a solve grows with the sections of the robot: the paper's spiral, \
                      2 steps, 6 particles, 30 iterations."
                    .to_owned(),
            svg: sheet(&[self.panel()], 1, 700)?,
        }])
    }

    fn metrics(&self) -> Vec<Metric> {
        let of = |(index, case): (usize, &Case)| {
            let each = |value: fn(&Case) -> f64| {
                let rounds = self.rounds.iter();
                rounds.map(move |cases| value(&cases[index]))
            };
            let path = path(case);
            [
                Metric::lower(format!("{path}/p50"), "µs", each(|case| case.p50_us)),
                Metric::lower(format!("{path}/p99"), "µs", each(|case| case.p99_us)),
            ]
        };
        let mut metrics: Vec<Metric> = self.cases.iter().enumerate().flat_map(of).collect();
        // The paper's size stands in every series.
        metrics.sort_by(|one, other| one.name.cmp(&other.name));
        metrics.dedup_by(|one, other| one.name == other.name);
        metrics
    }
}

/// Solver, path of the processor, curve and size.
fn path(case: &Case) -> String {
    format!(
        "solver/{}/{}/{}/{}-sections-{}-steps-{}x{}-{}-obstacles",
        case.solver.name(),
        format!("{:?}", case.path).to_lowercase(),
        case.curve,
        case.sections,
        case.horizon,
        case.swarm,
        case.iterations,
        case.obstacles,
    )
}

#[cfg(test)]
mod tests {
    use cdcr_controller::optimizer::Path;

    use super::*;
    use crate::experiment::Solver;

    fn case(sections: usize, p50_us: f64) -> Case {
        Case {
            solver: Solver::Kpso,
            curve: "spiral",
            path: Path::Scalar,
            sections,
            horizon: 2,
            swarm: 6,
            iterations: 30,
            obstacles: 0,
            p50_us,
            p99_us: 2.0 * p50_us,
            speedup_vs_scalar: 1.0,
        }
    }

    #[test]
    fn rows_are_medians_and_every_round_is_kept() {
        let rounds = [9.0, 1.0, 2.0].map(|us| vec![case(1, us), case(2, 10.0 * us), case(1, us)]);
        let report = Report::of(rounds.to_vec()).expect("rounds");
        assert_eq!(
            (report.cases[0].p50_us, report.cases[1].p99_us),
            (2.0, 40.0)
        );
        let metrics = report.metrics();
        // Two sizes, two quantiles; the size that is measured twice counts once.
        assert_eq!(metrics.len(), 4);
        assert_eq!(metrics[0].rounds, [9.0, 1.0, 2.0]);
        assert!(Report::of(Vec::new()).is_err());
    }
}
