//! Effect of each setting between precision and quiet motors, on the robot of the laboratory.

use anyhow::{Context, Result};
use cdcr_controller::closed_loop::{FigureEight, FigureEightRun};
use cdcr_controller::nmpc::NmpcSettings;
use serde_json::{Value, json};

use super::scenario::{CONTROLS, Scenario};
use crate::chart::{BLUE, ORANGE, Panel, Scale, of_rows};
use crate::dataset::{Dataset, ShownTable};
use crate::interrupt;
use crate::progress::Progress;

const DECLARATION: &str = include_str!("tuning.toml");

/// Key, its head in a plot, and the values of each knob.
#[rustfmt::skip]
const KNOBS: [(&str, &str, &[f64]); 3] = [
    ("controller.rate_weight", "controller.rate_weight [m²/(rad/s)²]", &[0.0, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5]),
    ("controller.rate_change_weight", "controller.rate_change_weight [m²/(rad/s)²]",
     &[0.0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4]),
    ("estimator.time_constant_ms", "estimator.time_constant_ms [ms]",
     &[0.0, 15.0, 30.0, 60.0, 100.0, 180.0, 300.0, 600.0, 1000.0]),
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
const PRESET: &str = "preset";

/// One row: its knob, what that is turned to, its value if it is a number, and all knobs.
type Turn = (&'static str, String, Option<f64>, Turned);

fn turns(only: Option<&str>) -> Vec<Turn> {
    let presets = PRESETS.map(|(name, knobs)| (PRESET, name.to_owned(), None, knobs));
    let mut turns = Vec::from(presets);
    for (place, (key, _, values)) in KNOBS.into_iter().enumerate() {
        if only.is_none_or(|only| key.contains(only)) {
            turns.extend(values.iter().map(|&value| {
                let mut knobs = PRECISE;
                knobs[place] = value;
                let text = match value {
                    0.0 | 1e-3.. => value.to_string(),
                    _ => format!("{value:e}"),
                };
                (key, text, Some(value), knobs)
            }));
        }
    }
    turns
}

/// Whether `only` matches a knob or the presets, which are always measured.
pub(super) fn is_any(only: Option<&str>) -> bool {
    only == Some(PRESET) || turns(only).len() > PRESETS.len()
}

pub(super) fn count(only: Option<&str>) -> usize {
    2 * turns(only).len()
}

/// Varies the knobs with `only` in their key; a run takes about `run_s` \[s\].
pub(super) fn run(only: Option<&str>, run_s: f64, progress: &mut Progress) -> Result<Dataset> {
    let eight = FigureEight::new()?;
    let mut rows = Vec::new();
    for (knob, turned_to, value, knobs) in turns(only) {
        interrupt::check()?;
        progress.begin(knob);
        let both = follow(&eight, knobs, "both 2")?;
        let cables = follow(&eight, knobs, "cables")?;
        progress.advance(2.0 * run_s);
        rows.push(json!({
            "knob": knob,
            "turned_to": turned_to,
            "value": value,
            "mean_error_mm": both.mean_mm(),
            "max_error_mm": both.max_mm(),
            "rate_change_rms": both.rate_change_square().sqrt(),
            "cables_rate_change_rms": cables.rate_change_square().sqrt(),
        }));
    }
    let mut dataset = Dataset::new("tuning", DECLARATION);
    dataset.plot("tuning", &panels(&rows))?;
    dataset.add("knobs", rows);
    Ok(dataset)
}

fn follow(eight: &FigureEight, knobs: Turned, sensor: &str) -> Result<FigureEightRun> {
    let [rate_weight, rate_change_weight, time_constant_ms] = knobs;
    let settings = NmpcSettings {
        rate_weight: rate_weight.into(),
        rate_change_weight,
        ..NmpcSettings::default()
    };
    let mut robots = Scenario::all().into_iter();
    let laboratory = robots.find(|robot| robot.name == "laboratory");
    let mut robot = laboratory.context("no robot of the laboratory")?;
    sensor.clone_into(&mut robot.sensor);
    let mut driven = robot.driven(&CONTROLS[0], true, 1);
    driven.time_constant_s = 1e-3 * time_constant_ms;
    Ok(eight.clone().with_settings(settings).run(driven, &[])?)
}

/// Error and rate change over each knob; the value 0 has no place on a logarithmic axis.
fn panels(rows: &[Value]) -> Vec<Panel> {
    let mut panels = Vec::new();
    for (key, head, _) in KNOBS {
        let is_shown = |row: &&Value| row["knob"] == key && row["value"] != json!(0.0);
        let shown: Vec<&Value> = rows.iter().filter(is_shown).collect();
        let curve = |label, y, colour| of_rows(label, shown.iter().copied(), "value", y, colour);
        let mut panel = |y, scale, curves| {
            panels.extend((!shown.is_empty()).then(|| Panel::new(key, [head, y], scale, curves)));
        };
        let mean = curve("mean", "mean_error_mm", BLUE);
        let errors = vec![mean, curve("largest", "max_error_mm", ORANGE)];
        panel("error of the tip [mm]", Scale::LogAcross, errors);
        let both = curve("cables and tip", "rate_change_rms", BLUE);
        let cables = curve("cables only", "cables_rate_change_rms", ORANGE);
        let scale = Scale::LogLog { floor: 1e-4 };
        panel("rate change, rms [rad/s]", scale, vec![both, cables]);
    }
    panels
}

pub fn knob(knob: &str, rows: &[Value]) -> ShownTable {
    let mut dataset = Dataset::new("tuning", DECLARATION);
    let of_knob = rows.iter().filter(|row| row["knob"] == knob);
    dataset.add("knobs", of_knob.cloned().collect());
    let table = dataset.table("knobs");
    table.title.clear();
    table.columns.remove(0);
    if knob == PRESET {
        PRESET.clone_into(&mut table.columns[0].head);
    }
    table.shown()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subject::daemon::Launch;

    fn in_force(preset: &str, key: &str) -> f64 {
        let mut command = Launch::default().command("config").unwrap();
        command.args(["explain", key, "--set", "link.simulated=laboratory"]);
        if preset != "none" {
            command.args(["--preset", preset]);
        }
        let output = command.output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let mut lines = text.lines();
        let value = lines.find_map(|line| line.trim().strip_prefix("value "));
        value.unwrap().trim().parse().unwrap()
    }

    #[test]
    fn the_presets_are_those_of_the_daemon() {
        for (name, knobs) in PRESETS {
            let found = KNOBS.map(|(key, ..)| in_force(name, key));
            assert_eq!(knobs, found, "{name}");
        }
    }
}
