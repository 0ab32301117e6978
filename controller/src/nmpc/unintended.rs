//! Warnings about settings that are allowed and probably unintended, in the words of their keys.

/// Warning about a safe distance (m) for a robot of this length (m).
pub fn safe_distance_warning(safe_distance_m: f64, reach_m: f64) -> Option<String> {
    (safe_distance_m > reach_m).then(|| {
        format!(
            "safe_distance_m = {safe_distance_m} is longer than the robot of {reach_m:.3} m: an obstacle blocks every motion"
        )
    })
}

/// Budget below which plans avoided no obstacle in the measurements of `docs/results.md` (What time buys): with 20 µs the robot
/// stopped before a gap and avoided no ball; with 50 µs it passed the gap and avoided the ball (ms).
const BUDGET_MIN_MS: f64 = 0.05;

/// Warning about a budget (ms) that leaves the solver no time; 0 is the rest of the period.
pub fn budget_warning(budget_ms: f64) -> Option<String> {
    (budget_ms > 0.0 && budget_ms < BUDGET_MIN_MS).then(|| {
        format!(
            "budget_ms = {budget_ms} is too short: in tests the solver avoided no obstacle with 0.02 ms, and did with {BUDGET_MIN_MS} ms \
             (docs/results.md, \"What time buys\"); 0 is all the remaining period"
        )
    })
}

/// Warning about this rate weight of a robot with so many sections; `is_ideal`: the robot equals its model.
pub fn rate_weight_warning(rate_weight: f64, sections: usize, is_ideal: bool) -> Option<String> {
    (rate_weight == 0.0 && sections > 1 && !is_ideal)
        .then(|| "rate_weight = 0: sensor noise makes the robot drift around its tip".to_owned())
}
