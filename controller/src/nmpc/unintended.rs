//! Settings that are allowed and probably not meant, in the words of their keys.

/// What to say about a safe distance (m) for a robot of this length (m).
pub fn safe_distance_warning(safe_distance_m: f64, reach_m: f64) -> Option<String> {
    (safe_distance_m > reach_m).then(|| {
        format!(
            "safe_distance_m = {safe_distance_m} is longer than the robot of {reach_m:.3} m: an obstacle blocks every motion"
        )
    })
}

/// What to say about this weight of the rates of a robot with so many sections; `is_ideal`: one that equals its model.
pub fn rate_weight_warning(rate_weight: f64, sections: usize, is_ideal: bool) -> Option<String> {
    (rate_weight == 0.0 && sections > 1 && !is_ideal)
        .then(|| "rate_weight = 0: sensor noise makes the robot drift around its tip".to_owned())
}
