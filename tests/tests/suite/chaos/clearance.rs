//! Invariant: no command brings the body nearer to an obstacle than allowed.

use cdcr_controller::robot::{BendRates, Robot, SECTIONS_MAX};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{Interface, Mode};
use cdcr_tests::record::{configuration_of, obstacles_of};

use crate::chaos::{CheckResult, ensure};

/// Rounding error of a clearance \[m\].
const TOLERANCE_M: f64 = 1e-9;

/// Clearance \[m\] that may be missing between the checked times: after the period and at the end of the
/// stopping path. A ramp along it may keep less by the same amount.
const DIP_M: f64 = 1e-3;

/// Checks cⱼ(command) ≥ min(D, cⱼ(standing still)) for each obstacle at its future position and each section
/// of the body, with exact clearances. The times are the end of the period and, to a millimetre, the rest of
/// the robot without further commands.
pub(crate) fn check(robot: &Robot, record: &Telemetry, period_s: f64) -> CheckResult {
    let rates = &record.command.bend_rate_rad_s[..robot.coordinate_count()];
    let rates = BendRates::from_slice(rates).ok_or("the rates have no shape")?;
    let lack_m = if is_ramp(record) { DIP_M + 1e-6 } else { 0.0 };
    check_at(robot, record, &rates, [period_s; 2], lack_m, TOLERANCE_M)?;
    let fastest = rates
        .as_slice()
        .iter()
        .fold(0.0_f64, |most, rate| most.max(rate.abs()));
    let ramp_s = fastest / record.deceleration_rad_s2;
    let valid_s = if record.command.interface == Interface::Position.code() {
        period_s
    } else {
        record
            .command
            .valid_until_ns
            .saturating_sub(record.release_ns) as f64
            * 1e-9
    };
    let way_s = valid_s + 0.5 * ramp_s;
    check_at(
        robot,
        record,
        &rates,
        [way_s, valid_s + ramp_s],
        lack_m,
        DIP_M,
    )
}

/// Whether the robot is ramping down or at rest.
pub(crate) fn is_ramp(record: &Telemetry) -> bool {
    let moves_on = [Mode::Tracking, Mode::Homing].map(Mode::code);
    !moves_on.contains(&record.mode)
}

/// The same after the robot has moved for `way_s` at its rates, at `time_s`. For an obstacle at rest, the
/// safe distance is reduced by `lack_m`.
fn check_at(
    robot: &Robot,
    record: &Telemetry,
    rates: &BendRates,
    [way_s, time_s]: [f64; 2],
    lack_m: f64,
    tolerance_m: f64,
) -> CheckResult {
    let standing = configuration_of(record);
    let commanded = standing.advanced(rates, way_s);
    let standing = robot.body(&standing);
    let commanded = robot.body(&commanded);
    for (index, obstacle) in obstacles_of(record).iter().enumerate() {
        let later = obstacle.moved(time_s);
        let [standing_m, commanded_m] = [&standing, &commanded]
            .map(|body| body.clearances_in_reach(&later, &[f64::INFINITY; SECTIONS_MAX]));
        let stands = obstacle.velocity_m_s().norm() == 0.0;
        // The larger of the two tolerances, not their sum.
        let slack_m = tolerance_m.max(if stands { lack_m } else { 0.0 });
        let kept_m = record.settings.safe_distance_m - slack_m;
        for j in 0..robot.section_count() {
            let floor_m = (standing_m[j] - tolerance_m).min(kept_m);
            let clearance_m = commanded_m[j];
            // A NaN breaks it, too.
            ensure(clearance_m >= floor_m, || {
                format!(
                    "the command leaves {clearance_m} m between section {j} and obstacle {index} after {time_s} s, below {floor_m} m"
                )
            })?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::RobotParameters;
    use cdcr_shared_types::Obstacle;

    use super::*;

    #[test]
    fn a_command_towards_an_obstacle_breaks_it_and_one_away_does_not() {
        let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
        let body_m = robot.sections()[0].body_radius_m;
        let mut record = Telemetry::default();
        record.robot.sections = 1;
        record.settings.safe_distance_m = 0.01;
        record.deceleration_rad_s2 = 40.0;
        record.mode = Mode::Tracking.code();
        record.obstacle_count = 1;
        record.obstacles[0] = Obstacle {
            start_m: [body_m + 0.02 + 0.010_001, 0.0, 0.25],
            radius_m: 0.02,
            ..Obstacle::default()
        };
        for (target_rad, holds) in [(0.0, true), (-0.01, true), (0.01, false)] {
            record.command.bend_rate_rad_s[0] = target_rad / 0.005;
            assert_eq!(check(&robot, &record, 0.005).is_ok(), holds, "{target_rad}");
        }
        // The obstacle moves into the robot, which stands still.
        record.command.bend_rate_rad_s[0] = 0.0;
        record.obstacles[0].velocity_m_s = [-1.0, 0.0, 0.0];
        assert_eq!(check(&robot, &record, 0.005), Ok(()));
    }
}
