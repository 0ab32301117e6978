//! Invariant: no command of ours brings the body nearer to an obstacle than is allowed.

use cdcr_controller::robot::{BendRates, Robot};
use cdcr_shared_types::Telemetry;
use cdcr_tests::record::{configuration_of, obstacles_of};

use crate::chaos::{Verdict, ensure};

/// What rounding may take from a clearance \[m\].
const TOLERANCE_M: f64 = 1e-9;

/// Checks c(command) ≥ min(D, c(standing still)) for each obstacle where it will be one period later, both with
/// the exact clearance of the whole body.
pub(crate) fn check(robot: &Robot, record: &Telemetry, period_s: f64) -> Verdict {
    let rates = &record.command.bend_rate_rad_s[..robot.coordinate_count()];
    let rates = BendRates::from_slice(rates).ok_or("the rates have no shape")?;
    let standing = configuration_of(record);
    let commanded = standing.advanced(&rates, period_s);
    let standing = robot.body(&standing);
    let commanded = robot.body(&commanded);
    for (index, obstacle) in obstacles_of(record).iter().enumerate() {
        let later = obstacle.moved(period_s);
        let floor_m = standing
            .clearance_m(&later)
            .min(record.settings.safe_distance_m);
        let clearance_m = commanded.clearance_m(&later);
        // A NaN breaks it, too.
        ensure(clearance_m >= floor_m - TOLERANCE_M, || {
            format!("the command leaves {clearance_m} m to obstacle {index}, below {floor_m} m")
        })?;
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
        // It runs into the robot by itself, and the robot stands still.
        record.command.bend_rate_rad_s[0] = 0.0;
        record.obstacles[0].velocity_m_s = [-1.0, 0.0, 0.0];
        assert_eq!(check(&robot, &record, 0.005), Ok(()));
    }
}
