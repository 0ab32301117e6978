//! Effect of each setting between precision and quiet motors, on the robot of the laboratory.

use anyhow::Result;
use cdcr_controller::closed_loop::{Driven, FigureEight, FigureEightRun, Sensor};
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_controller::plant::Preset;
use serde_json::{Value, json};

use crate::chart::{BLUE, ORANGE, Panel, Scale, of_rows, plot};
use crate::dataset::{Column, Dataset, Sheet, fixed, word};
use crate::interrupt;
use crate::progress::Progress;

const EXPLANATION: &str = include_str!("tuning.html");

const COLUMNS: [Column; 6] = [
    word("knob", "knob"),
    word("value", "turned_to"),
    fixed("error mean mm", "mean_error_mm", 3),
    fixed("error max mm", "max_error_mm", 3),
    fixed("rate change rad/s", "rate_change_rms", 4),
    fixed(
        "cables only: rate change rad/s",
        "cables_rate_change_rms",
        4,
    ),
];

struct Knob {
    key: &'static str,
    head: &'static str,
    values: &'static [f64],
}

const KNOBS: [Knob; 3] = [
    Knob {
        key: "controller.rate_weight",
        head: "controller.rate_weight [m²/(rad/s)²]",
        values: &[0.0, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5],
    },
    Knob {
        key: "controller.rate_change_weight",
        head: "controller.rate_change_weight [m²/(rad/s)²]",
        values: &[0.0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4],
    },
    Knob {
        key: "estimator.time_constant_ms",
        head: "estimator.time_constant_ms [ms]",
        values: &[0.0, 15.0, 30.0, 60.0, 100.0, 180.0, 300.0, 600.0, 1000.0],
    },
];

type Turned = [f64; KNOBS.len()];

/// The preset `precise` of a daemon.
const PRECISE: Turned = [1e-10, 0.0, 300.0];

/// The presets of a daemon, and its values without one.
const PRESETS: [(&str, Turned); 4] = [
    ("none", [1e-10, 0.0, 180.0]),
    ("precise", PRECISE),
    ("smooth", [1e-10, 1e-5, 300.0]),
    ("fast", [1e-10, 0.0, 60.0]),
];

/// The knobs with `only` in their key, or all.
fn knobs(only: Option<&str>) -> impl Iterator<Item = (usize, &'static Knob)> {
    let is_meant =
        move |(_, knob): &(usize, &Knob)| only.is_none_or(|only| knob.key.contains(only));
    KNOBS.iter().enumerate().filter(is_meant)
}

/// Whether `only` matches a knob or the presets, which are always measured.
pub(super) fn is_any(only: Option<&str>) -> bool {
    only == Some("preset") || knobs(only).next().is_some()
}

pub(super) fn count(only: Option<&str>) -> usize {
    2 * (PRESETS.len()
        + knobs(only)
            .map(|(_, knob)| knob.values.len())
            .sum::<usize>())
}

/// Varies the knobs with `only` in their key; a run takes about `run_s` \[s\].
pub(super) fn run(only: Option<&str>, run_s: f64, progress: &mut Progress) -> Result<Dataset> {
    let eight = FigureEight::new()?;
    let mut row = |knob: &str, turned_to: String, value: Option<f64>, knobs: Turned| {
        interrupt::check()?;
        progress.begin(knob);
        let both = follow(&eight, knobs, Sensor::CablesAndTip { every: 2 })?;
        let cables = follow(&eight, knobs, Sensor::Cables)?;
        progress.advance(2.0 * run_s);
        anyhow::Ok(json!({
            "knob": knob,
            "turned_to": turned_to,
            "value": value,
            "mean_error_mm": both.mean_mm(),
            "max_error_mm": both.max_mm(),
            "rate_change_rms": both.rate_change_square().sqrt(),
            "cables_rate_change_rms": cables.rate_change_square().sqrt(),
        }))
    };
    let (mut rows, mut panels) = (Vec::new(), Vec::new());
    for (name, knobs) in PRESETS {
        rows.push(row("preset", name.to_owned(), None, knobs)?);
    }
    for (place, knob) in knobs(only) {
        let turned = knob.values.iter();
        let turned = turned.map(|value| {
            let is_small = *value > 0.0 && *value < 1e-3;
            let text = if is_small {
                format!("{value:e}")
            } else {
                value.to_string()
            };
            let mut knobs = PRECISE;
            knobs[place] = *value;
            row(knob.key, text, Some(*value), knobs)
        });
        let turned: Vec<Value> = turned.collect::<Result<_>>()?;
        panels.extend(draw(knob, &turned));
        rows.extend(turned);
    }
    Ok(Dataset {
        name: "tuning",
        heading: "What the knobs do",
        explanation: EXPLANATION,
        plots: vec![plot(
            "tuning",
            "Error of the tip and change of the rates over each knob, the robot of the laboratory.",
            (2, 420),
            &panels,
        )?],
        sheets: vec![
            Sheet::of("What the knobs do", &COLUMNS, rows)
                .key("knobs")
                .file("tuning"),
        ],
        ..Dataset::default()
    })
}

fn follow(eight: &FigureEight, knobs: Turned, sensor: Sensor) -> Result<FigureEightRun> {
    let flaws = Preset::Laboratory.flaws();
    let [rate_weight, rate_change_weight, time_constant_ms] = knobs;
    let settings = NmpcSettings {
        rate_weight: rate_weight.into(),
        rate_change_weight,
        ..NmpcSettings::default()
    };
    let driven = Driven {
        flaws,
        actuator: flaws.actuator,
        time_constant_s: 1e-3 * time_constant_ms,
        obeys_positions: true,
        sensor,
        without: None,
        seed: 1,
    };
    Ok(eight.clone().with_settings(settings).run(driven, &[])?)
}

/// Error and rate change over a knob; the value 0 has no place on a logarithmic axis.
fn draw(knob: &Knob, rows: &[Value]) -> [Panel; 2] {
    let turned = || rows.iter().filter(|row| row["value"] != json!(0.0));
    let curve = |label, key, colour| of_rows(label, turned(), "value", key, colour);
    let error = vec![
        curve("mean", "mean_error_mm", BLUE),
        curve("largest", "max_error_mm", ORANGE),
    ];
    let change = vec![
        curve("cables and tip", "rate_change_rms", BLUE),
        curve("cables only", "cables_rate_change_rms", ORANGE),
    ];
    let panel = |y, scale, curves| Panel::new(knob.key, [knob.head, y], scale, curves);
    [
        panel("error of the tip [mm]", Scale::LogAcross, error),
        panel(
            "rate change, rms [rad/s]",
            Scale::LogLog { floor: 1e-4 },
            change,
        ),
    ]
}

/// Effect of one knob of a sweep, from the rows of its result.
pub fn knob(knob: &str, rows: &[Value]) -> Sheet {
    let of = rows.iter().filter(|row| row["knob"] == knob).cloned();
    let mut columns = COLUMNS[1..].to_vec();
    if knob == "preset" {
        columns[0] = word("preset", "turned_to");
    }
    Sheet::of("", &columns, of.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subject::daemon::Launch;

    /// The daemon's value of a key with this preset.
    fn in_force(preset: &str, key: &str) -> f64 {
        let mut command = Launch::default().command("config").unwrap();
        command.args(["explain", key, "--set", "link.simulated=laboratory"]);
        if preset != "none" {
            command.args(["--preset", preset]);
        }
        let output = command.output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let value = text
            .lines()
            .find_map(|line| line.trim().strip_prefix("value "));
        value.unwrap().trim().parse().unwrap()
    }

    #[test]
    fn the_presets_are_those_of_the_daemon() {
        for (name, knobs) in PRESETS {
            let keys = KNOBS.each_ref().map(|knob| knob.key);
            assert_eq!(knobs, keys.map(|key| in_force(name, key)), "{name}");
        }
    }
}
