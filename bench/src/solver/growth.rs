//! How the time of a solve grows with one thing when all others stay: straight-line fits over the medians
//! of the fastest path.

use serde::Serialize;

use super::Case;
use crate::dataset::{Column, fixed, plain, word};
use crate::experiment::Solver;
use crate::named::named;

named! {
    pub enum Quantity {
        Section = "section",
        Step = "step",
        Particle = "particle",
        Iteration = "iteration",
        Obstacle = "obstacle",
    }
}

pub const COLUMNS: [Column; 8] = [
    word("solver", "solver"),
    word("per", "per"),
    plain("from", "from"),
    plain("to", "to"),
    fixed("first µs", "p50_us_from", 2),
    fixed("last µs", "p50_us_to", 2),
    fixed("µs for one more", "us_per_unit", 3),
    fixed("for twice as many", "factor_per_doubling", 2),
];

impl Quantity {
    fn of(self, size: &[usize; 5]) -> usize {
        size[self as usize]
    }
}

/// The growth of one solver with one quantity.
#[derive(Debug, Clone, Serialize)]
pub struct Growth {
    pub solver: Solver,
    pub per: Quantity,
    pub from: usize,
    pub to: usize,
    pub p50_us_from: f64,
    pub p50_us_to: f64,
    /// Slope of the line through all medians \[µs for one more\].
    pub us_per_unit: f64,
    /// Factor on the time for twice as many, from a line through the logarithms; none where the smallest
    /// is zero.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub factor_per_doubling: Option<f64>,
}

/// The growth in every series of cases that differ in one quantity from the paper's size.
pub fn growth(cases: &[Case]) -> Vec<Growth> {
    let Some(fastest) = cases.last().map(|case| case.path) else {
        return Vec::new();
    };
    let mut all = Vec::new();
    for solver in Solver::ALL {
        let is_ours =
            |case: &&Case| case.path == fastest && case.solver == solver && case.curve == "spiral";
        let ours: Vec<&Case> = cases.iter().filter(is_ours).collect();
        all.extend(
            Quantity::ALL
                .iter()
                .filter_map(|&per| of(&ours, solver, per)),
        );
    }
    all
}

fn numbers(case: &Case) -> [usize; 5] {
    [
        case.sections,
        case.horizon as usize,
        case.swarm as usize,
        case.iterations as usize,
        case.obstacles,
    ]
}

/// From the cases that are like the paper's in all but this quantity.
fn of(cases: &[&Case], solver: Solver, per: Quantity) -> Option<Growth> {
    const PAPER: [usize; 5] = [3, 2, 6, 30, 0];
    let is_in_series = |case: &&&Case| {
        let others = Quantity::ALL.iter().filter(|&&other| other != per);
        let size = numbers(case);
        others.into_iter().all(|q| q.of(&size) == q.of(&PAPER))
    };
    let series = cases.iter().filter(is_in_series);
    let mut points: Vec<(usize, f64)> = series
        .map(|case| (per.of(&numbers(case)), case.p50_us))
        .collect();
    points.sort_by_key(|point| point.0);
    points.dedup_by_key(|point| point.0);
    let (&(from, p50_us_from), &(to, p50_us_to)) = (points.first()?, points.last()?);
    if from == to {
        return None;
    }
    let line: Vec<(f64, f64)> = points.iter().map(|&(x, us)| (x as f64, us)).collect();
    let logarithms: Vec<(f64, f64)> = line.iter().map(|(x, us)| (x.log2(), us.log2())).collect();
    Some(Growth {
        solver,
        per,
        from,
        to,
        p50_us_from,
        p50_us_to,
        us_per_unit: slope(&line),
        factor_per_doubling: (from > 0).then(|| slope(&logarithms).exp2()),
    })
}

fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let (mean_x, mean_y) = points
        .iter()
        .fold((0.0, 0.0), |(x, y), p| (x + p.0 / count, y + p.1 / count));
    let (over, under) = points.iter().fold((0.0, 0.0), |(over, under), p| {
        let dx = p.0 - mean_x;
        (over + dx * (p.1 - mean_y), under + dx * dx)
    });
    over / under
}

#[cfg(test)]
mod tests {
    use cdcr_controller::optimizer::Simd;

    use super::*;

    fn case(horizon: u32, obstacles: usize, p50_us: f64) -> Case {
        Case {
            solver: Solver::Kpso,
            curve: "spiral",
            path: Simd::Portable,
            sections: 3,
            horizon,
            swarm: 6,
            iterations: 30,
            obstacles,
            p50_us,
            p99_us: p50_us,
            speedup_vs_scalar: 1.0,
        }
    }

    #[test]
    fn each_series_leaves_the_others_out() {
        let cases = [
            case(2, 0, 10.0),
            case(4, 0, 20.0),
            case(8, 0, 40.0),
            case(2, 16, 90.0),
        ];
        let all = growth(&cases);
        assert_eq!(all.len(), 2, "{all:?}");
        assert_eq!((all[0].per, all[0].from, all[0].to), (Quantity::Step, 2, 8));
        assert!((all[0].us_per_unit - 5.0).abs() < 1e-9);
        let factor = all[0].factor_per_doubling.expect("from two");
        assert!((factor - 2.0).abs() < 1e-9);
        assert_eq!(all[1].per, Quantity::Obstacle);
        assert!((all[1].us_per_unit - 5.0).abs() < 1e-9);
        assert_eq!(all[1].factor_per_doubling, None);
    }
}
