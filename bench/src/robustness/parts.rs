//! Effect of each part of the controller: a number of a robot that needs it, with the part and without.

use serde::Deserialize;
use serde_json::{Value, json};

use crate::dataset::number;

/// The parts that `robustness.toml` declares.
#[derive(Deserialize)]
struct Declared {
    shown_parts: Vec<[String; 5]>,
}

pub(super) fn rows(rows: &[Value]) -> Vec<Value> {
    let declared: Declared = toml::from_str(super::DECLARATION).expect("a declaration");
    let row = |[part, without, robot, key, figure]: &[String; 5]| {
        let of = |controller: &str| {
            let mut rows = rows.iter().filter(|row| row["interface"] == "position");
            let row = rows.find(|row| row["name"] == **robot && row["controller"] == controller)?;
            Some(text(number(row, key)?))
        };
        let (with, without) = (of("full")?, of(without)?);
        let row = json!({ "part": part, "robot": robot, "figure": figure, "with": with, "without": without });
        Some(row)
    };
    declared.shown_parts.iter().filter_map(row).collect()
}

fn text(value: f64) -> String {
    let before_point = value.abs().log10().floor();
    let digits = (2.0 - before_point).clamp(0.0, 4.0) as usize;
    format!("{value:.digits$}")
}
