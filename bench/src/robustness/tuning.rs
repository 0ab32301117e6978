//! Effect of each setting between precision and quiet motors, on the robot of the laboratory.

use anyhow::{Context, Result};
use cdcr_controller::closed_loop::{FigureEight, FigureEightRun};
use cdcr_controller::nmpc::NmpcSettings;
use serde::Deserialize;
use serde_json::{Value, json};

use super::scenario::{CONTROLS, Scenario};
use crate::chart::{BLUE, ORANGE, Panel, Scale, of_rows};
use crate::dataset::Dataset;
use crate::interrupt;
use crate::progress::Progress;

const DECLARATION: &str = include_str!("tuning.toml");

const PRESET: &str = "preset";

/// A value of each knob.
type Turned = [f64; 3];

#[derive(Deserialize)]
struct DeclaredTuning {
    /// Key, unit, and values.
    knobs: [(String, String, Vec<f64>); 3],
    presets: Vec<(String, Turned)>,
}

fn declared() -> DeclaredTuning {
    toml::from_str(DECLARATION).expect("a declaration")
}

/// One row: its knob, what that is turned to, its value if it is a number, and all knobs.
type Turn = (String, String, Option<f64>, Turned);

/// The presets, and each knob with `only` in its key.
fn turns(only: Option<&str>) -> Vec<Turn> {
    let DeclaredTuning { knobs, presets } = declared();
    let is_precise = |(name, _): &&(String, Turned)| name == "precise";
    let precise = presets.iter().find(is_precise).expect("a preset").1;
    let presets = (presets.into_iter()).map(|(name, knobs)| (PRESET.to_owned(), name, None, knobs));
    let mut turns: Vec<Turn> = presets.collect();
    for (place, (key, _, values)) in knobs.into_iter().enumerate() {
        if only.is_none_or(|only| key.contains(only)) {
            turns.extend(values.into_iter().map(|value| {
                let mut knobs = precise;
                knobs[place] = value;
                let text = match value {
                    0.0 | 1e-3.. => value.to_string(),
                    _ => format!("{value:e}"),
                };
                (key.clone(), text, Some(value), knobs)
            }));
        }
    }
    turns
}

/// Whether `only` matches a knob or the presets, which are always measured.
pub(super) fn is_any(only: Option<&str>) -> bool {
    only == Some(PRESET) || turns(only).iter().any(|(knob, ..)| knob != PRESET)
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
        progress.begin(&knob);
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
    for (key, unit, _) in declared().knobs {
        let head = format!("{key} [{unit}]");
        let is_shown = |row: &&Value| row["knob"] == key && row["value"] != json!(0.0);
        let shown: Vec<&Value> = rows.iter().filter(is_shown).collect();
        let curve = |label, y, colour| of_rows(label, shown.iter().copied(), "value", y, colour);
        let mut panel = |y, scale, curves| {
            panels
                .extend((!shown.is_empty()).then(|| Panel::new(&*key, [&head, y], scale, curves)));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subject::daemon::Launch;

    fn in_force(preset: &str, key: &str) -> f64 {
        let mut command = Launch::default().command("config").unwrap();
        command.args(["explain", key, "--set", "link.simulated=laboratory"]);
        if preset != "none" {
            command.args(["--tuning", preset]);
        }
        let output = command.output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let mut lines = text.lines();
        let value = lines.find_map(|line| line.trim().strip_prefix("value "));
        value.unwrap().trim().parse().unwrap()
    }

    #[test]
    fn the_presets_are_those_of_the_daemon() {
        let DeclaredTuning { knobs, presets } = declared();
        for (name, turned) in presets {
            let found = knobs.each_ref().map(|(key, ..)| in_force(&name, key));
            assert_eq!(turned, found, "{name}");
        }
    }
}
