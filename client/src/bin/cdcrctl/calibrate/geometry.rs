use std::io::Write;
use std::path::Path;

use anyhow::{Context, bail, ensure};
use cdcr_client::counted;
use cdcr_client::model::robot_of;
use cdcr_controller::calibration::{Calibration, CalibrationError, ParameterGroup, calibrate};
use cdcr_controller::robot::{RobotParameters, SectionParameters};
use cdcr_shared_types::RobotDescription;
use toml_edit::{DocumentMut, Item};

use super::advice::{self, CORRELATED};
use super::recording::CalibrationRows;
use super::{recorded, report};
use crate::args::{Format, GeometryOptions, Target};
use crate::done::Done;
use crate::dry_run::newest;
use crate::files::read_text;
use crate::settings::save::number_of;

pub(super) fn run(target: &Target, options: &GeometryOptions) -> anyhow::Result<Done> {
    let name = options.file.display();
    let (robot, recording) = if recorded::is_recording(&options.file)? {
        of_recording(options)?
    } else {
        of_rows(target, options)?
    };
    recording
        .check_units(&robot)
        .with_context(|| name.to_string())?;
    let play_m = recording.play_m;
    let recording = recording.behind_play(play_m);
    let hold: Vec<ParameterGroup> = options.hold.iter().map(|hold| hold.0).collect();
    let found = calibrate(&robot, &recording.rows, &hold);
    if hold.len() < ParameterGroup::ALL.len()
        && let Some((how, correlation)) = refusal(&robot, &recording, &hold, &found)
    {
        let advice = advice::text(&robot, &recording, correlation);
        bail!(
            "{name}: these rows determine no value of the robot{how}; nothing to paste\n{advice}"
        );
    }
    let found: Calibration = found.with_context(|| name.to_string())?;
    let mut out = std::io::stdout().lock();
    match options.format {
        Format::Json => writeln!(out, "{:#}", report::json(&robot, &recording, &found))?,
        Format::Text => write!(
            out,
            "{}",
            report::text(&options.file, &robot, &recording, &found)?
        )?,
    }
    Ok(Done::Good)
}

/// Why nothing is determined, if so, and the correlation of the residuals. Of a model that lacks an effect, the values of `hold`
/// move that effect into the other values, and their bounds do not include it: what is refused without `hold` stays refused.
fn refusal(
    robot: &RobotParameters,
    recording: &CalibrationRows,
    hold: &[ParameterGroup],
    found: &Result<Calibration, CalibrationError>,
) -> Option<(&'static str, f64)> {
    match found {
        Err(CalibrationError::NothingLeft { correlation, .. }) => Some(("", *correlation)),
        Ok(found) if !hold.is_empty() && found.correlation > CORRELATED => {
            let free = calibrate(robot, &recording.rows, &[]);
            let Err(CalibrationError::NothingLeft { correlation, .. }) = free else {
                return None;
            };
            Some((
                " without --hold, which does not correct the model",
                correlation,
            ))
        }
        _ => None,
    }
}

/// Rows of a CSV file, with the robot of the configuration or of a daemon.
fn of_rows(
    target: &Target,
    options: &GeometryOptions,
) -> anyhow::Result<(RobotParameters, CalibrationRows)> {
    let path = &options.file;
    let text = read_text(path)?;
    let (robot, play_m) = if let Some(path) = &options.config {
        configured(path)?
    } else {
        let connection = target.connect().with_context(|| {
            format!(
                "{} names no robot: give the configuration of the recorded one with --config, or start its daemon",
                path.display()
            )
        })?;
        let record = newest(&connection)?;
        (described(&record.robot)?, record.play_m)
    };
    let recording = CalibrationRows::parse(path, &text, 3 * robot.sections.len())?;
    Ok((
        robot,
        CalibrationRows {
            play_m,
            ..recording
        },
    ))
}

/// A recording of all services, which contains the robot.
fn of_recording(options: &GeometryOptions) -> anyhow::Result<(RobotParameters, CalibrationRows)> {
    let (description, recording) = recorded::read(&options.file)?;
    let Some(config) = &options.config else {
        return Ok((described(&description)?, recording));
    };
    let (robot, play_m) = configured(config)?;
    ensure!(
        robot.sections.len() == description.sections as usize,
        "{} is of another robot: it has {}, {} has {}",
        options.file.display(),
        counted(description.sections, "section"),
        config.display(),
        robot.sections.len()
    );
    Ok((
        robot,
        CalibrationRows {
            play_m,
            ..recording
        },
    ))
}

fn described(description: &RobotDescription) -> anyhow::Result<RobotParameters> {
    Ok(robot_of(description)?.parameters())
}

/// The robot of a configuration file, without sections the default one, and its play \[m\].
fn configured(path: &Path) -> anyhow::Result<(RobotParameters, f64)> {
    let name = path.display();
    let text = read_text(path)?;
    let document: DocumentMut = text.parse().with_context(|| name.to_string())?;
    let mut robot = RobotParameters::paper(3);
    let sections = document
        .get("robot")
        .and_then(|robot| robot.get("sections"));
    if let Some(sections) = sections {
        let tables = sections
            .as_array_of_tables()
            .with_context(|| format!("{name}: robot.sections is not a list of tables"))?;
        let sections = tables.iter().enumerate().map(|(index, table)| {
            let number = |key: &str| {
                let value = table.get(key).and_then(Item::as_value).and_then(number_of);
                value.with_context(|| {
                    format!("{name}: robot.sections[{index}].{key} is missing or not a number")
                })
            };
            Ok(SectionParameters {
                length_m: number("length_m")?,
                cable_radius_m: number("cable_radius_m")?,
                cable_offset_rad: number("cable_offset_rad")?,
                bend_max_rad: number("bend_max_rad")?,
                rate_max_rad_s: number("rate_max_rad_s")?,
                body_radius_m: number("body_radius_m")?,
            })
        });
        robot.sections = sections.collect::<anyhow::Result<_>>()?;
    }
    let play = document
        .get("actuator")
        .and_then(|table| table.get("play_m"));
    let play_m = play.map_or(Some(0.0), |play| play.as_value().and_then(number_of));
    let play_m = play_m.with_context(|| format!("{name}: actuator.play_m is not a number"))?;
    Ok((robot, play_m))
}

#[cfg(test)]
mod tests {
    use cdcr_controller::calibration::CalibrationRow;
    use cdcr_controller::robot::{Configuration, Robot};
    use cdcr_scratch::Scratch;
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn the_robot_of_a_file_is_read_and_what_lacks_is_named() {
        let folder = Scratch::temporary().expect("a folder");
        let path = folder.path().join("robot.toml");
        let default = include_str!("../../../../../configs/default.toml");
        std::fs::write(&path, default).expect("written");
        assert_eq!(
            configured(&path)
                .map(|(robot, play_m)| (robot.sections, play_m))
                .expect("good"),
            (RobotParameters::paper(3).sections, 0.0)
        );
        let play = default.replace("\nplay_m = 0.0\n", "\nplay_m = 0.0006\n");
        std::fs::write(&path, play).expect("written");
        assert_eq!(configured(&path).expect("good").1, 6e-4);
        std::fs::write(
            &path,
            default.replace("length_m = 0.3\n", "length_m = \"a\"\n"),
        )
        .expect("written");
        let error = configured(&path).expect_err("no number").to_string();
        assert!(error.contains("robot.sections[0].length_m"), "{error}");
    }

    /// Two sections longer and shorter than configured, whose droop and friction \[rad\] the model lacks.
    fn rows(
        droop_rad: f64,
        friction_rad: f64,
        amplitude_rad: f64,
    ) -> (RobotParameters, CalibrationRows) {
        let configured = RobotParameters::paper(2);
        let mut truth = configured.clone();
        for (section, share) in truth.sections.iter_mut().zip([1.03, 0.965]) {
            section.length_m *= share;
        }
        let truth = Robot::new(&truth).expect("a robot");
        let mut seed = 1_u64;
        let mut noise_m = move |most_m: f64| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            most_m * ((seed >> 33) as f64 / f64::from(1_u32 << 30) - 1.0)
        };
        let bends_at = |time_s: f64| {
            [
                (0.5 * time_s).sin(),
                (0.31 * time_s).cos(),
                (0.43 * time_s).cos(),
                (0.37 * time_s).sin(),
            ]
            .map(|share| amplitude_rad * share)
        };
        let bent = |bends: [f64; 4]| Configuration::from_slice(&bends).expect("bends");
        let rows = (0..1000).map(|k| {
            let time_s = 0.05 * f64::from(k);
            let (now, soon) = (bends_at(time_s), bends_at(time_s + 0.01));
            let true_rad = core::array::from_fn(|i| {
                let droop_rad = if i % 2 == 1 { droop_rad } else { 0.0 };
                now[i] + friction_rad * (now[i] - soon[i]).signum() + droop_rad * now[i].cos()
            });
            let mut cable_length_m = truth.cable_lengths(&bent(now));
            for length_m in &mut cable_length_m[..6] {
                *length_m += noise_m(2e-5);
            }
            let noise_m = Vector3::from_fn(|_, _| noise_m(4e-4));
            CalibrationRow {
                cable_length_m,
                tip_position_m: truth.tip_position(&bent(true_rad)) + noise_m,
                tip_rotation: None,
            }
        });
        let rows = CalibrationRows {
            rows: rows.collect(),
            duration_s: 50.0,
            play_m: 0.0,
        };
        (configured, rows)
    }

    #[test]
    fn counts_that_were_zeroed_with_other_lengths_are_told_the_change() {
        let (robot, mut recording) = rows(0.0, 0.0, 0.7);
        let found = calibrate(&robot, &recording.rows, &[]).expect("a calibration");
        let text = |recording: &CalibrationRows| {
            report::text(Path::new("rows.csv"), &robot, recording, &found).expect("text")
        };
        let change = "# For the driver: these three cables were recorded with 0.";
        let mut move_to = |straight_m: [f64; 2]| {
            for row in &mut recording.rows {
                for (cables_m, straight_m) in row.cable_length_m.chunks_mut(3).zip(straight_m) {
                    let more_m = straight_m - cables_m.iter().sum::<f64>() / 3.0;
                    for length_m in cables_m {
                        *length_m += more_m;
                    }
                }
            }
            text(&recording)
        };
        let [first, second] = [0, 1].map(|j| found.geometry.robot.sections[j].length_m);
        let right = move_to([first, first + second]);
        assert!(!right.contains(change), "{right}");
        // The sections were found about 9 mm longer and 10.5 mm shorter than configured.
        let wrong = move_to([0.3, 0.6]);
        let mut changes = wrong.lines().filter_map(|line| line.strip_prefix(change));
        for (recorded, more) in [
            ("300000 m", "or subtract -0.00"),
            ("600000 m", "or subtract 0.00"),
        ] {
            let line = changes.next().expect("a line for each section");
            assert!(line.starts_with(recorded) && line.contains(more), "{line}");
        }
    }

    #[test]
    fn what_a_wrong_model_does_not_determine_is_not_offered_with_held_values_either() {
        let refused = |droop_rad, friction_rad, amplitude_rad, hold: &[ParameterGroup]| {
            let (robot, recording) = rows(droop_rad, friction_rad, amplitude_rad);
            let found = calibrate(&robot, &recording.rows, hold);
            let refusal = refusal(&robot, &recording, hold, &found);
            (found.is_ok(), refusal.map(|(how, _)| how))
        };
        let base = [ParameterGroup::Base];
        assert_eq!(refused(0.01, 0.003, 0.35, &[]), (false, Some("")));
        let (is_found, how) = refused(0.01, 0.003, 0.35, &base);
        assert!(is_found && how.is_some_and(|how| how.contains("without --hold")));
        // A right model, and rows that determine values without held ones.
        assert_eq!(refused(0.0, 0.0, 0.35, &base), (true, None));
        assert_eq!(refused(0.01, 0.003, 0.7, &base), (true, None));
    }
}
