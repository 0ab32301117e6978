//! The result of a calibration as text, JSON and configuration.

use std::fmt::{Error, Write};
use std::path::Path;

use cdcr_client::{cable_tolerances_m, counted};
use cdcr_controller::calibration::{
    Calibration, Estimate, Geometry, Parameter, ParameterGroup, TipError, median,
};
use cdcr_controller::robot::{RobotParameters, SectionParameters};
use serde_json::{Value, json};

use super::advice::{self, CORRELATED};
use super::recording::CalibrationRows;

/// Text, with the configuration at the end.
pub(super) fn text(
    path: &Path,
    robot: &RobotParameters,
    recording: &CalibrationRows,
    found: &Calibration,
) -> Result<String, Error> {
    let mut out = String::new();
    let is_turned = recording.rows.iter().all(|row| row.tip_rotation.is_some());
    writeln!(
        out,
        "{}: {} in {:.1} s, {}, tip {}\n",
        path.display(),
        counted(recording.rows.len(), "row"),
        recording.duration_s,
        counted(robot.sections.len(), "section"),
        if is_turned {
            "position and rotation"
        } else {
            "position"
        },
    )?;
    if recording.play_m > 0.0 {
        writeln!(
            out,
            "the cables follow the measured motors behind a play of {:.3} mm (actuator.play_m)\n",
            1e3 * recording.play_m
        )?;
    }
    let head = ["", "configured", "found", "95 % within"];
    writeln!(
        out,
        "{:<36}{:>14}{:>14}{:>14}",
        head[0], head[1], head[2], head[3]
    )?;
    found
        .estimates
        .iter()
        .try_for_each(|estimate| parameter(&mut out, estimate))?;
    let sections = found.cable_zeros.iter().enumerate();
    for (section, zeros) in sections.filter(|(section, _)| has_zeros(found, *section)) {
        for (cable, (zero_m, within_m)) in zeros.iter().enumerate() {
            let name = format!("zero of cable {} [mm]", 3 * section + cable + 1);
            let (zero, within) = (1e3 * zero_m, 1e3 * within_m);
            writeln!(out, "{name:<36}{:>14}{zero:>14.4}{within:>14.4}", "")?;
        }
    }
    writeln!(
        out,
        "\n{:<26}{:>8}{:>10}{:>10}{:>10}{:>10}{:>10}",
        "tip error [mm]", "rows", "rms", "x", "y", "z", "max"
    )?;
    let names = [
        "configured",
        "configured, held out",
        "found",
        "found, held out",
    ];
    let errors = found.before.iter().chain(&found.after);
    for (name, error) in names.iter().zip(errors) {
        let TipError {
            rows,
            rms_m,
            axis_rms_m,
            max_m,
            ..
        } = error;
        let [rms, x, y, z, max] =
            [*rms_m, axis_rms_m[0], axis_rms_m[1], axis_rms_m[2], *max_m].map(|m| 1e3 * m);
        writeln!(
            out,
            "{:<26}{rows:>8}{rms:>10.3}{x:>10.3}{y:>10.3}{z:>10.3}{max:>10.3}",
            format!("  {name}")
        )?;
    }
    evaluation(&mut out, found)?;
    if found.held.iter().any(advice::needs_motion) {
        writeln!(
            out,
            "\n{}",
            advice::text(robot, recording, found.correlation)
        )?;
    }
    write!(out, "\n{}", fragment(robot, recording, found)?)?;
    Ok(out)
}

fn parameter(out: &mut String, estimate: &Estimate) -> Result<(), Error> {
    let Estimate {
        parameter,
        old,
        value,
        within,
    } = *estimate;
    let (unit, scale) = if parameter.is_angle() {
        ("deg", 1_f64.to_degrees())
    } else {
        ("mm", 1e3)
    };
    let [old, value, within] = [old, value, within].map(|number| scale * number);
    let name = format!("{parameter} [{unit}]");
    writeln!(out, "{name:<36}{old:>14.4}{value:>14.4}{within:>14.4}")
}

fn is_estimated(found: &Calibration, parameter: Parameter) -> bool {
    found.held.iter().all(|held| held.parameter != parameter)
}

/// True if the zeros of this section are estimated: those of its cables are sums of both.
fn has_zeros(found: &Calibration, section: usize) -> bool {
    [0, 1]
        .into_iter()
        .all(|a| is_estimated(found, Parameter::CableZero(section, a)))
}

/// Evaluation of the result.
fn evaluation(out: &mut String, found: &Calibration) -> Result<(), Error> {
    let noise = &found.noise;
    writeln!(
        out,
        "\nnoise: {:.4} mm of a cable, {:.3} mm of a tip coordinate; outlier rows left out: {}, held out {}",
        1e3 * noise.cable_m,
        1e3 * noise.tip_m,
        found.outliers,
        found.outliers_held_out
    )?;
    let rms: Vec<_> = found
        .cable_rms_m
        .iter()
        .map(|m| format!("{:.3}", 1e3 * m))
        .collect();
    writeln!(
        out,
        "the three cables of a section agree to {} mm rms, base first",
        rms.join(", ")
    )?;
    let zeros =
        (0..found.cable_zeros.len()).flat_map(|j| [0, 1].map(|a| Parameter::CableZero(j, a)));
    let zeros = zeros.filter(|zero| is_estimated(found, *zero)).count();
    let estimated = found.estimates.len() + zeros;
    writeln!(
        out,
        "\nexcitation: {estimated} parameters estimated; held as configured:"
    )?;
    if found.held.is_empty() {
        writeln!(out, "  none")?;
    }
    for held in &found.held {
        writeln!(out, "  {} ({})", held.parameter, held.why)?;
    }
    if found.correlation > CORRELATED {
        writeln!(
            out,
            "\nResiduals of consecutive rows are correlated: the model lacks an effect (other play than actuator.play_m, a load, friction). The \
             bounds are widened {:.1} times for it and hold for this model only.",
            found.correlation
        )?;
    }
    Ok(())
}

/// The sections for a configuration, with the old values as comments.
fn fragment(
    robot: &RobotParameters,
    recording: &CalibrationRows,
    found: &Calibration,
) -> Result<String, Error> {
    // A position driver follows a first command within the tolerance.
    let sections = &found.geometry.robot.sections;
    let tolerances_m = cable_tolerances_m(sections.iter().map(|section| section.cable_radius_m));
    let mut straight_m = 0.0;
    let mut out = String::from("# Replaces all [[robot.sections]] of the configuration:\n");
    let configured = Geometry::configured(robot);
    for (j, (new, tolerance_m)) in sections.iter().zip(tolerances_m).enumerate() {
        let SectionParameters {
            bend_max_rad,
            rate_max_rad_s,
            body_radius_m,
            ..
        } = new;
        writeln!(out, "[[robot.sections]]")?;
        for (key, parameter) in [
            ("length_m", Parameter::Length(j)),
            ("cable_radius_m", Parameter::CableRadius(j)),
            ("cable_offset_rad", Parameter::CableAngle(j)),
        ] {
            let new = found.geometry.value(parameter);
            let note = if is_estimated(found, parameter) {
                "was"
            } else {
                "held as configured:"
            };
            writeln!(
                out,
                "{key} = {new:.7} # {note} {}",
                configured.value(parameter)
            )?;
        }
        writeln!(out, "bend_max_rad = {bend_max_rad:?}")?;
        writeln!(out, "rate_max_rad_s = {rate_max_rad_s:?}")?;
        writeln!(out, "body_radius_m = {body_radius_m:?}")?;
        if has_zeros(found, j) {
            let zeros = found.cable_zeros[j].map(|(zero_m, _)| format!("{zero_m:.6}"));
            writeln!(
                out,
                "# For the driver, to subtract from measured lengths and add to commanded ones [m]: {}",
                zeros.join(", ")
            )?;
        }
        straight_m += new.length_m;
        let common_m = median_common_mode_m(recording, j);
        if (common_m - straight_m).abs() > tolerance_m {
            writeln!(
                out,
                "# For the driver: these three cables were recorded with {common_m:.6} m in the mean, and have {straight_m:.6} m with the lengths found. \
                 Set their zero again when the robot is straight, or subtract {:.6} more from each measured length and add it to each commanded one [m]",
                common_m - straight_m
            )?;
        }
    }
    let pose = |pose: &nalgebra::Isometry3<f64>| {
        let [x, y, z] = pose.translation.vector.into();
        let [qx, qy, qz, qw] = pose.rotation.coords.into();
        format!(
            "at {x:.6}, {y:.6}, {z:.6} m, turned by {qx:.6}, {qy:.6}, {qz:.6}, {qw:.6} (x, y, z, w)"
        )
    };
    let has = |group| {
        found
            .estimates
            .iter()
            .any(|one| one.parameter.group() == group)
    };
    if has(ParameterGroup::Base) {
        let base = pose(&found.geometry.base);
        writeln!(
            out,
            "# For the driver: the base in the frame of the tip sensor is {base}"
        )?;
    }
    if has(ParameterGroup::Sensor) {
        let sensor = pose(&found.geometry.sensor);
        writeln!(
            out,
            "# For the driver: what the sensor sees, in the frame of the tip, is {sensor}"
        )?;
    }
    Ok(out)
}

/// Mean length of the three cables of a section, the median of all rows \[m\]. No bend changes it.
fn median_common_mode_m(recording: &CalibrationRows, section: usize) -> f64 {
    let cables = 3 * section..3 * section + 3;
    let rows = recording.rows.iter();
    let means_m = rows.map(|row| row.cable_length_m[cables.clone()].iter().sum::<f64>() / 3.0);
    median(means_m.collect())
}

pub(super) fn json(
    robot: &RobotParameters,
    recording: &CalibrationRows,
    found: &Calibration,
) -> Value {
    let error = |error: &TipError| {
        json!({
            "rows": error.rows,
            "rms_m": error.rms_m,
            "axis_rms_m": error.axis_rms_m,
            "max_m": error.max_m,
            "rms_rad": error.rms_rad,
        })
    };
    let estimate = |estimate: &Estimate| {
        json!({
            "parameter": estimate.parameter.to_string(),
            "unit": if estimate.parameter.is_angle() { "rad" } else { "m" },
            "configured": estimate.old,
            "found": estimate.value,
            "within_95": estimate.within,
        })
    };
    let sections = found.cable_zeros.iter().enumerate();
    let zeros = sections.flat_map(|(section, zeros)| {
        zeros.map(|zero| Some(zero).filter(|_| has_zeros(found, section)))
    });
    let held = found.held.iter().map(
        |held| json!({ "parameter": held.parameter.to_string(), "why": held.why.to_string() }),
    );
    json!({
        "rows": recording.rows.len(),
        "duration_s": recording.duration_s,
        "play_m": recording.play_m,
        "estimates": found.estimates.iter().map(estimate).collect::<Vec<_>>(),
        "cable_zeros": zeros
            .map(|zero| zero.map(|(zero_m, within_m)| json!({ "found_m": zero_m, "within_95_m": within_m })))
            .collect::<Vec<_>>(),
        "held": held.collect::<Vec<_>>(),
        "tip_error": {
            "configured": error(&found.before[0]),
            "configured_held_out": error(&found.before[1]),
            "found": error(&found.after[0]),
            "found_held_out": error(&found.after[1]),
        },
        "cable_rms_m": found.cable_rms_m,
        "noise": { "cable_m": found.noise.cable_m, "tip_m": found.noise.tip_m },
        "outliers": found.outliers,
        "outliers_held_out": found.outliers_held_out,
        "correlation": found.correlation,
        "toml": fragment(robot, recording, found).unwrap_or_default(),
    })
}
