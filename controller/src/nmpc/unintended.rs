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

/// Time constant of rates that move the body and not the tip (s): from period to period the plan changes them by the share at which their
/// cost is least.
fn rates_last_s(rate_weight: f64, rate_change_weight: f64, period_s: f64) -> f64 {
    period_s * rate_change_weight / rate_weight
}

/// Longest time constant of such rates without a warning (s).
const RATES_LAST_MAX_S: f64 = 5.0;

/// Warning about a weight on changes of the rates beside this weight of the rates.
pub fn rate_change_weight_warning(
    rate_weight: f64,
    rate_change_weight: f64,
    period_s: f64,
    sections: usize,
) -> Option<String> {
    let last_s = rates_last_s(rate_weight, rate_change_weight, period_s);
    (rate_change_weight > 0.0 && sections > 1 && last_s > RATES_LAST_MAX_S).then(|| {
        let ends = period_s * rate_change_weight;
        format!(
            "rate_change_weight = {rate_change_weight:e} beside a rate_weight of {rate_weight:e}: the body goes on moving while the tip rests, \
             {}; a rate_weight of {ends:.0e} ends this in about 1 s",
            if last_s.is_finite() {
                format!("for about {last_s:.0} s")
            } else {
                "for ever".to_owned()
            }
        )
    })
}

/// Warning about a gain of the posture without effect.
pub fn posture_gain_warning(
    posture_gain: f64,
    rate_weight: f64,
    horizon_steps: u32,
) -> Option<String> {
    let missing = if rate_weight == 0.0 {
        "without a rate_weight"
    } else if horizon_steps == 1 {
        "with a horizon of one step"
    } else {
        return None;
    };
    (posture_gain > 0.0).then(|| {
        format!("posture_gain = {posture_gain} has no effect {missing}: the body does not repeat what the tip repeats")
    })
}

/// Warning about this rate weight of a robot with so many sections; `is_ideal`: the robot equals its model.
pub fn rate_weight_warning(rate_weight: f64, sections: usize, is_ideal: bool) -> Option<String> {
    (rate_weight == 0.0 && sections > 1 && !is_ideal)
        .then(|| "rate_weight = 0: sensor noise makes the robot drift around its tip".to_owned())
}
