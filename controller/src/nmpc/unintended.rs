//! Settings that are allowed and probably not meant, in the words of their keys.

/// What to say about a safe distance (m) for a robot of this length (m).
pub fn safe_distance_warning(safe_distance_m: f64, reach_m: f64) -> Option<String> {
    (safe_distance_m > reach_m).then(|| {
        format!(
            "safe_distance_m = {safe_distance_m} is longer than the robot of {reach_m:.3} m: an obstacle blocks every motion"
        )
    })
}

/// Budget below which plans passed no obstacle in the measurements of `docs/results.md` (What time buys): with 20 µs the robot
/// stayed before a gap and gave way to no ball, with 50 µs it did both (ms).
const BUDGET_MIN_MS: f64 = 0.05;

/// What to say about a budget (ms) that leaves the solver no time; 0 is the rest of the period.
pub fn budget_warning(budget_ms: f64) -> Option<String> {
    (budget_ms > 0.0 && budget_ms < BUDGET_MIN_MS).then(|| {
        format!(
            "budget_ms = {budget_ms} hardly lets the solver begin: with 0.02 ms its plans gave way to no obstacle, with {BUDGET_MIN_MS} ms they \
             did (docs/results.md, \"What time buys\"); 0 is all the remaining period"
        )
    })
}

/// What to say about this weight of the rates of a robot with so many sections; `is_ideal`: one that equals its model.
pub fn rate_weight_warning(rate_weight: f64, sections: usize, is_ideal: bool) -> Option<String> {
    (rate_weight == 0.0 && sections > 1 && !is_ideal)
        .then(|| "rate_weight = 0: sensor noise makes the robot drift around its tip".to_owned())
}
