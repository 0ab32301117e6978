//! The limits of a robot that its driver applies to a command.

use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::limits::{BEND_TOLERANCE_RAD, COORDINATES_MAX, SECTIONS_MAX};
use cdcr_shared_types::{Command, Measurement, RobotDescription, SectionDescription};

use super::{CommandRefusal, CommandedPosition};

/// Allowance for rounding of a rate or a speed, as a share of its limit.
const ROUNDING: f64 = 1e-9;

/// The sections that a description uses.
pub(super) fn sections(robot: &RobotDescription) -> &[SectionDescription] {
    &robot.section[..(robot.sections as usize).min(SECTIONS_MAX)]
}

/// Refuses numbers that are not finite, and values obeyed by `interface` that are beyond a limit.
///
/// Other values move no motor and are not checked against limits. A position beyond a limit is accepted if it
/// is not farther out than `standing`, so that the robot can return.
pub(super) fn check(
    robot: &RobotDescription,
    interface: Interface,
    command: &Command,
    standing: Option<&CommandedPosition>,
) -> Result<(), CommandRefusal> {
    let bends = command
        .bend_rate_rad_s
        .iter()
        .chain(&command.bend_target_rad);
    let cables = command
        .cable_length_m
        .iter()
        .chain(&command.cable_speed_m_s);
    if !bends.chain(cables).all(|number| number.is_finite()) {
        return Err(CommandRefusal::NotFinite);
    }
    if interface == Interface::Position {
        check_bends(robot, &command.bend_target_rad, standing)?;
        check_strokes(robot, &command.cable_length_m, standing)
    } else {
        check_rates(robot, command)
    }
}

fn check_bends(
    robot: &RobotDescription,
    bends_rad: &[f64; COORDINATES_MAX],
    standing: Option<&CommandedPosition>,
) -> Result<(), CommandRefusal> {
    let bend = |bends: &[f64], j: usize| bends[2 * j].hypot(bends[2 * j + 1]);
    for (section, limits) in sections(robot).iter().enumerate() {
        let bend_rad = bend(bends_rad, section);
        let limit_rad = limits.bend_max_rad;
        let most = standing.map_or(0.0, |standing| bend(&standing.bend_rad, section));
        if bend_rad > most.max(limit_rad + BEND_TOLERANCE_RAD) {
            return Err(CommandRefusal::Bend {
                section,
                bend_rad,
                limit_rad,
            });
        }
    }
    Ok(())
}

/// By how much the lengths of each section's cables (m) may be off, from the radii of the cables (m), base first: as much as a bend of
/// [`BEND_TOLERANCE_RAD`] in each section up to it.
pub fn cable_tolerances_m(radii_m: impl Iterator<Item = f64>) -> impl Iterator<Item = f64> {
    radii_m.scan(0.0, |tolerance_m, radius_m| {
        *tolerance_m += BEND_TOLERANCE_RAD * radius_m;
        Some(*tolerance_m)
    })
}

fn tolerances_m(robot: &RobotDescription) -> impl Iterator<Item = f64> {
    cable_tolerances_m(sections(robot).iter().map(|section| section.cable_radius_m))
}

fn check_strokes(
    robot: &RobotDescription,
    lengths_m: &[f64],
    standing: Option<&CommandedPosition>,
) -> Result<(), CommandRefusal> {
    let limit_m = robot.cable_stroke_max_m;
    let mut straight_m = 0.0;
    let sections = sections(robot).iter().zip(tolerances_m(robot));
    for (j, (section, tolerance_m)) in sections.enumerate() {
        straight_m += section.length_m;
        for cable in 3 * j..3 * j + 3 {
            let stroke_m = lengths_m[cable] - straight_m;
            let most = standing.map_or(0.0, |standing| standing.cable_length_m[cable] - straight_m);
            if stroke_m.abs() > most.abs().max(limit_m + tolerance_m) {
                return Err(CommandRefusal::Stroke {
                    cable,
                    stroke_m,
                    limit_m,
                });
            }
        }
    }
    Ok(())
}

/// Refuses cables of a section that are off together: no bend has them.
pub(super) fn check_mean_lengths(
    robot: &RobotDescription,
    lengths_m: &[f64],
) -> Result<(), CommandRefusal> {
    let mut straight_m = 0.0;
    let sections = sections(robot).iter().zip(tolerances_m(robot));
    for (j, (section, most)) in sections.enumerate() {
        straight_m += section.length_m;
        let way = lengths_m[3 * j..3 * j + 3].iter().sum::<f64>() / 3.0 - straight_m;
        if way.abs() > most {
            return Err(CommandRefusal::Elsewhere {
                at: 3 * j,
                way,
                most,
            });
        }
    }
    Ok(())
}

/// Refuses a first position that differs from the measured one.
pub(super) fn check_near(
    robot: &RobotDescription,
    command: &Command,
    measured: &Measurement,
) -> Result<(), CommandRefusal> {
    let near = |at: usize, way: f64, most: f64| {
        let is_near = way.abs() <= most;
        let elsewhere = CommandRefusal::Elsewhere { at, way, most };
        if is_near { Ok(()) } else { Err(elsewhere) }
    };
    for (j, tolerance_m) in tolerances_m(robot).enumerate() {
        if measured.kind == MeasurementKind::Configuration.code() {
            for i in 2 * j..2 * j + 2 {
                let distance_rad = command.bend_target_rad[i] - measured.bend_rad[i];
                near(i, distance_rad, BEND_TOLERANCE_RAD)?;
            }
        } else if measured.kind == MeasurementKind::CableLengths.code() {
            for i in 3 * j..3 * j + 3 {
                let distance_m = command.cable_length_m[i] - measured.cable_length_m[i];
                near(i, distance_m, tolerance_m)?;
            }
        }
    }
    Ok(())
}

fn check_rates(robot: &RobotDescription, command: &Command) -> Result<(), CommandRefusal> {
    for (section, limits) in sections(robot).iter().enumerate() {
        let limit_rad_s = limits.rate_max_rad_s;
        for rate_rad_s in command.bend_rate_rad_s[2 * section..][..2].iter().copied() {
            if rate_rad_s.abs() > limit_rad_s * (1.0 + ROUNDING) {
                return Err(CommandRefusal::Rate {
                    section,
                    rate_rad_s,
                    limit_rad_s,
                });
            }
        }
    }
    let limit_m_s = robot.cable_speed_max_m_s;
    let used = &command.cable_speed_m_s[..3 * sections(robot).len()];
    for (cable, &speed_m_s) in used.iter().enumerate() {
        if speed_m_s.abs() > limit_m_s * (1.0 + ROUNDING) {
            return Err(CommandRefusal::CableSpeed {
                cable,
                speed_m_s,
                limit_m_s,
            });
        }
    }
    Ok(())
}

/// Minimum time of a move from `begin` to `end` \[s\].
pub(super) fn shortest_s(
    robot: &RobotDescription,
    begin: &CommandedPosition,
    end: &CommandedPosition,
) -> f64 {
    let mut shortest_s = 0.0_f64;
    for (j, section) in sections(robot).iter().enumerate() {
        for i in 2 * j..2 * j + 2 {
            let distance_rad = (end.bend_rad[i] - begin.bend_rad[i]).abs();
            shortest_s = shortest_s.max(distance_rad / section.rate_max_rad_s);
        }
        for i in 3 * j..3 * j + 3 {
            let distance_m = (end.cable_length_m[i] - begin.cable_length_m[i]).abs();
            shortest_s = shortest_s.max(distance_m / robot.cable_speed_max_m_s);
        }
    }
    shortest_s
}
