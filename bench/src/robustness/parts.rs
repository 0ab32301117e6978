//! Effect of each part of the controller: a number of a robot that needs it, with the part and without.

use serde_json::{Value, json};

use crate::dataset::number;

/// A part, the controller without it, the robot that shows its effect, the key of the number and its name.
#[rustfmt::skip]
const SHOWN: [[&str; 5]; 11] = [
    ["filter of cables and bends", "no filter", "30 µm of noise", "rate_change_rms", "rate change rms, rad/s"],
    ["filter of the tip", "no filter", "tip alone, 0.5 mm", "mean_error_mm", MEAN],
    ["filter of the tip", "no filter", "tip alone, 0.5 mm, 3 sections, through straight", "mean_error_mm", MEAN],
    ["model of the motors", "no actuator model", "lag 30 ms, delay 15 ms", "mean_error_mm", MEAN],
    ["model of the play", "no actuator model", "play of 0.5 mm", "mean_error_mm", MEAN],
    ["offset of the tip", "no tip", "wrong model", "settled_error_mm", SETTLED],
    ["that offset along the way", "no offset along the way", "wrong model, spiral", "settled_error_mm", SETTLED],
    ["that offset along the way", "no offset along the way", "wrong model, 5 % shorter", "settled_error_mm", SETTLED],
    ["weight on rates", "no weight on rates", "laboratory", "rest_rate_rad_s", "largest rate at rest, rad/s"],
    ["margin of the clearance", "no margin", "5 % longer, ball", "min_clearance_mm", "least clearance, mm (safe distance 10)"],
    ["all of it", "first version", "slow", "mean_error_mm", MEAN],
];

const MEAN: &str = "mean error, mm";
const SETTLED: &str = "settled error, mm";

pub(super) fn rows(rows: &[Value]) -> Vec<Value> {
    let row = |[part, without, robot, key, figure]: [&str; 5]| {
        let of = |controller: &str| {
            let mut rows = rows.iter().filter(|row| row["interface"] == "position");
            let row = rows.find(|row| row["name"] == robot && row["controller"] == controller)?;
            Some(text(number(row, key)?))
        };
        let (with, without) = (of("full")?, of(without)?);
        let row = json!({ "part": part, "robot": robot, "figure": figure, "with": with, "without": without });
        Some(row)
    };
    SHOWN.into_iter().filter_map(row).collect()
}

fn text(value: f64) -> String {
    let before_point = value.abs().log10().floor();
    let digits = (2.0 - before_point).clamp(0.0, 4.0) as usize;
    format!("{value:.digits$}")
}
