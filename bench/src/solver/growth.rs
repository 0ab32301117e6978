//! Growth of the solve time with one quantity: straight-line fits over the medians of the fastest path.

use cdcr_controller::nmpc::SolverKind;
use serde_json::{Value, json};
use statrs::statistics::Statistics as _;

use crate::dataset::number;

/// A varied quantity: its name, its key in a case, and its value in the paper's size.
type Quantity = (&'static str, &'static str, f64);

pub const SECTION: Quantity = ("section", "sections", 3.0);
const QUANTITIES: [Quantity; 5] = [
    SECTION,
    ("step", "horizon", 2.0),
    ("particle", "swarm", 6.0),
    ("iteration", "iterations", 30.0),
    ("obstacle", "obstacles", 0.0),
];

pub fn rows(cases: &[Value]) -> Vec<Value> {
    let solvers = SolverKind::ALL.into_iter();
    let all = solvers.flat_map(|solver| QUANTITIES.map(|per| growth(cases, solver, per)));
    all.flatten().collect()
}

/// Medians over one quantity, from the cases that equal the paper's in all others.
pub fn series(cases: &[Value], solver: SolverKind, (_, per, _): Quantity) -> Vec<(f64, f64)> {
    let fastest = cases.last().map(|case| &case["path"]);
    let is_like = |case: &Value, (_, key, paper): &Quantity| {
        *key == per || case[*key].as_f64() == Some(*paper)
    };
    let is_ours = |case: &&Value| {
        Some(&case["path"]) == fastest
            && case["solver"] == solver.name()
            && case["curve"] == "spiral"
            && QUANTITIES.iter().all(|quantity| is_like(case, quantity))
    };
    let point = |case: &Value| Some((number(case, per)?, number(case, "p50_us")?));
    let mut points: Vec<_> = (cases.iter().filter(is_ours)).filter_map(point).collect();
    points.sort_by(|one, other| one.0.total_cmp(&other.0));
    points.dedup_by_key(|point| point.0);
    points
}

fn growth(cases: &[Value], solver: SolverKind, per: Quantity) -> Option<Value> {
    let points = series(cases, solver, per);
    let (&(from, p50_us_from), &(to, p50_us_to)) = (points.first()?, points.last()?);
    let logarithms: Vec<_> = points.iter().map(|(x, us)| (x.log2(), us.log2())).collect();
    (from < to).then(|| {
        json!({
            "solver": solver,
            "per": per.0,
            "from": from as u64,
            "to": to as u64,
            "p50_us_from": p50_us_from,
            "p50_us_to": p50_us_to,
            // Slope of the line through all medians.
            "us_per_unit": slope(&points),
            // From a line through the logarithms; null if the smallest value is zero.
            "factor_per_doubling": (from > 0.0).then(|| slope(&logarithms).exp2()),
        })
    })
}

fn slope(points: &[(f64, f64)]) -> f64 {
    let (x, y): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
    x.iter().covariance(y.iter()) / x.iter().variance()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_series_leaves_the_others_out() {
        let sizes = [(2, 0, 10.0), (4, 0, 20.0), (8, 0, 40.0), (2, 16, 90.0)];
        let cases = sizes.map(|(horizon, obstacles, p50_us)| {
            json!({
                "solver": "kpso", "curve": "spiral", "path": "portable", "sections": 3, "horizon": horizon,
                "swarm": 6, "iterations": 30, "obstacles": obstacles, "p50_us": p50_us,
            })
        });
        let growths = QUANTITIES.map(|per| growth(&cases, SolverKind::Kpso, per));
        let [section, step, particle, iteration, obstacle] = growths;
        assert!([section, particle, iteration].iter().all(Option::is_none));
        let (step, obstacle) = (step.expect("three"), obstacle.expect("two"));
        assert_eq!((&step["from"], &step["to"]), (&json!(2), &json!(8)));
        let near = |found: &Value, expected: f64| (found.as_f64().unwrap() - expected).abs() < 1e-9;
        assert!(near(&step["us_per_unit"], 5.0) && near(&step["factor_per_doubling"], 2.0));
        assert!(near(&obstacle["us_per_unit"], 5.0) && obstacle["factor_per_doubling"].is_null());
    }
}
