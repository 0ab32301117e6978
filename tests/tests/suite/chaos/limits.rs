//! Invariant: every command is finite and within the limits of the robot.

use cdcr_controller::robot::{BendRates, Configuration, Robot};
use cdcr_shared_types::codes::Interface;
use cdcr_shared_types::{Command, Telemetry};

use crate::chaos::{CheckResult, ensure};

/// Rounding error of a bend \[rad\], a stroke \[m\] or a speed \[m/s\].
const TOLERANCE: f64 = 1e-9;

/// Checks one command: rates in the box, speeds within their limits and, where a driver obeys them,
/// positions.
pub(crate) fn check(robot: &Robot, command: &Command, period_s: f64) -> CheckResult {
    let (width, cables) = (robot.coordinate_count(), robot.cable_count());
    let rates = &command.bend_rate_rad_s[..width];
    check_finite(command)?;
    for (j, section) in robot.sections().iter().enumerate() {
        let rate = rates[2 * j].abs().max(rates[2 * j + 1].abs());
        ensure(rate <= section.rate_max_rad_s, || {
            format!("section {j} is commanded to bend at {rate} rad/s")
        })?;
    }
    let speed_max = robot.cable_speed_max_m_s();
    for speed in &command.cable_speed_m_s[..cables] {
        ensure(speed.abs() <= speed_max + TOLERANCE, || {
            format!("a cable is commanded at {speed} m/s")
        })?;
    }
    if command.interface == Interface::Position.code() {
        let target = &command.bend_target_rad[..width];
        let pairs = target.iter().zip(rates);
        let from: Vec<f64> = pairs
            .map(|(target, rate)| target - period_s * rate)
            .collect();
        check_move(robot, &from, target)?;
    }
    check_cables(robot, command)
}

/// A move of one period. A robot measured beyond a limit must not move farther beyond it.
fn check_move(robot: &Robot, from: &[f64], target: &[f64]) -> CheckResult {
    for (j, section) in robot.sections().iter().enumerate() {
        let (u, v) = (2 * j, 2 * j + 1);
        let (bend, before) = (target[u].hypot(target[v]), from[u].hypot(from[v]));
        ensure(bend <= section.bend_max_rad.max(before) + TOLERANCE, || {
            format!("section {j} is commanded from {before} to {bend} rad")
        })?;
    }
    let [strokes, before] = [target, from].map(|bends| robot.cable_strokes(&bent(bends)));
    for (stroke, before) in strokes.iter().zip(before) {
        let most = robot.cable_stroke_max_m().max(before.abs()) + TOLERANCE;
        ensure(stroke.abs() <= most, || {
            format!("a cable is commanded from {before} to {stroke} m")
        })?;
    }
    Ok(())
}

fn bent(bend_rad: &[f64]) -> Configuration {
    Configuration::from_slice(bend_rad).unwrap()
}

fn turning(rad_s: &[f64]) -> BendRates {
    BendRates::from_slice(rad_s).unwrap()
}

/// Cables agree with bends.
fn check_cables(robot: &Robot, command: &Command) -> CheckResult {
    let (width, cables) = (robot.coordinate_count(), robot.cable_count());
    let lengths = robot.cable_lengths(&bent(&command.bend_target_rad[..width]));
    let speeds = robot.cable_speeds(&turning(&command.bend_rate_rad_s[..width]));
    ensure(
        lengths[..cables] == command.cable_length_m[..cables]
            && speeds[..cables] == command.cable_speed_m_s[..cables],
        || "lengths or speeds of cables are not those of the bends".to_owned(),
    )
}

pub(crate) fn check_finite(command: &Command) -> CheckResult {
    let numbers = command.bend_rate_rad_s.iter();
    let numbers = numbers
        .chain(&command.bend_target_rad)
        .chain(&command.cable_length_m)
        .chain(&command.cable_speed_m_s);
    let finite = numbers.into_iter().all(|number| number.is_finite());
    ensure(finite, || "a command is not finite".to_owned())
}

/// Checks that the command of a record is the one of its cycle.
pub(crate) fn check_record(robot: &Robot, record: &Telemetry, period_s: f64) -> CheckResult {
    let command = &record.command;
    let same = (command.cycle, command.release_ns, command.mode)
        == (record.cycle, record.release_ns, record.mode);
    ensure(same, || "the command is another cycle's".to_owned())?;
    let width = robot.coordinate_count();
    check_acceleration(record, width, period_s)?;
    check_tip_speed(robot, record)?;
    let from = &record.bend_rad[..width];
    let pairs = from.iter().zip(&command.bend_rate_rad_s);
    let target: Vec<f64> = pairs.map(|(from, rate)| from + period_s * rate).collect();
    check_move(robot, from, &target)?;
    let state = record.bend_rad.iter().chain(&record.tip_position_m);
    let state = state
        .chain(&record.tip_orientation)
        .chain(&record.previous_rate_rad_s);
    let finite = state.into_iter().all(|number| number.is_finite());
    ensure(finite, || "the state of a record is not finite".to_owned())?;
    check(robot, command, period_s)
}

/// No end of a section is commanded faster than its limit, in any mode.
fn check_tip_speed(robot: &Robot, record: &Telemetry) -> CheckResult {
    let Some(limit_m_s) = robot.tip_speed_max_m_s() else {
        return Ok(());
    };
    let width = robot.coordinate_count();
    let rates = turning(&record.command.bend_rate_rad_s[..width]);
    let speed_m_s = robot.fastest_section_end_m_s(&bent(&record.bend_rad[..width]), &rates);
    ensure(speed_m_s <= limit_m_s + TOLERANCE, || {
        format!("the end of a section is commanded at {speed_m_s} m/s")
    })
}

/// No rate grows faster than the acceleration limit; deceleration is not limited.
fn check_acceleration(record: &Telemetry, width: usize, period_s: f64) -> CheckResult {
    let most = record.acceleration_rad_s2 * period_s;
    let rates = record
        .command
        .bend_rate_rad_s
        .iter()
        .zip(&record.previous_rate_rad_s);
    for (rate, before) in rates.take(width) {
        let from = if rate * before > 0.0 {
            before.abs()
        } else {
            0.0
        };
        ensure(rate.abs() <= from + most + TOLERANCE, || {
            format!("a rate grows from {before} to {rate} rad/s")
        })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::RobotParameters;

    use super::*;

    fn command(rates: [f64; 6], from: [f64; 6]) -> Command {
        let robot = robot();
        let mut command = Command {
            interface: Interface::Position.code(),
            ..Command::default()
        };
        for i in 0..6 {
            command.bend_rate_rad_s[i] = rates[i];
            command.bend_target_rad[i] = from[i] + 0.005 * rates[i];
        }
        command.cable_length_m = robot.cable_lengths(&bent(&command.bend_target_rad[..6]));
        command.cable_speed_m_s = robot.cable_speeds(&turning(&command.bend_rate_rad_s[..6]));
        command
    }

    fn robot() -> Robot {
        let mut parameters = RobotParameters::paper(3);
        for section in &mut parameters.sections {
            (section.rate_max_rad_s, section.bend_max_rad) = (2.0, 2.8);
        }
        (
            parameters.cable_speed_max_m_s,
            parameters.cable_stroke_max_m,
        ) = (0.03, 0.04);
        Robot::new(&parameters).unwrap()
    }

    #[test]
    fn each_limit_is_held() {
        let checked = |rates, from| check(&robot(), &command(rates, from), 0.005);
        let (slow, straight) = ([0.5, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 6]);
        assert_eq!(checked(slow, straight), Ok(()));
        for (rates, from, word) in [
            ([2.1, 0.0, 0.0, 0.0, 0.0, 0.0], straight, "2.1 rad/s"),
            (slow, [2.7999, 0.0, 0.0, 0.0, 0.0, 0.0], "section 0"),
            ([2.0; 6], straight, "m/s"),
            (slow, [1.0, 0.0, 1.0, 0.0, 1.5, 0.0], "a cable"),
            ([f64::NAN; 6], straight, "not finite"),
        ] {
            let broken = checked(rates, from).unwrap_err();
            assert!(broken.contains(word), "{word}: {broken}");
        }
        // Beyond a limit it may return.
        assert_eq!(
            checked(
                [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0],
                [2.9, 0.0, 0.0, 0.0, 0.0, 0.0]
            ),
            Ok(())
        );
        let mut other = command(slow, straight);
        other.cable_length_m[4] += 1e-6;
        assert!(check(&robot(), &other, 0.005).is_err());
    }

    #[test]
    fn a_tip_that_is_too_fast_is_found() {
        let parameters = RobotParameters {
            tip_speed_max_m_s: 0.1,
            ..robot().parameters()
        };
        let slow = Robot::new(&parameters).unwrap();
        for (robot, rate_rad_s, is_kept) in [
            (&slow, 0.13, true),
            (&slow, 0.14, false),
            (&robot(), 0.14, true),
        ] {
            let record = Telemetry {
                command: command([rate_rad_s, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 6]),
                ..Telemetry::default()
            };
            assert_eq!(
                check_tip_speed(robot, &record).is_ok(),
                is_kept,
                "{rate_rad_s}"
            );
        }
    }
}
