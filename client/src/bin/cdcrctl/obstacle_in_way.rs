//! Which obstacle is in the way of a motion that the robot could do without it.

use cdcr_client::model::{obstacle_of, settings_of};
use cdcr_client::{Connection, FeedOptions, Trajectory, obstacles};
use cdcr_shared_types::Telemetry;

use crate::dry_run::{newest, robot_and_pose, simulate};

/// What to add where the end of `way` is missed by more than `allowed_m`: empty unless it is reached without the obstacles.
pub(crate) fn note(
    connection: &Connection,
    way: &dyn Trajectory,
    options: &FeedOptions,
    allowed_m: f64,
) -> anyhow::Result<String> {
    let record = newest(connection)?;
    let Some((id, clearance_m)) = nearest(&record) else {
        return Ok(String::new());
    };
    let free = Telemetry {
        obstacle_count: 0,
        ..record
    };
    let demands = simulate(&free, settings_of(&record.settings)?, way, options)?;
    if demands.check_end(allowed_m).is_err() {
        return Ok(String::new());
    }
    Ok(format!(
        ". Without the obstacles the tip arrives: {} known, the nearest has id {id}, {:.1} mm from the body now (cdcrctl obstacle list)",
        record.obstacle_count,
        1e3 * clearance_m
    ))
}

/// The obstacle nearest to the body, and its clearance \[m\].
fn nearest(record: &Telemetry) -> Option<(u32, f64)> {
    let (robot, here) = robot_and_pose(record).ok()?;
    let clearances = obstacles(record).iter().filter_map(|known| {
        let obstacle = obstacle_of(known)?;
        Some((known.id, robot.clearance_m(&here, &obstacle)))
    });
    clearances.min_by(|one, other| one.1.total_cmp(&other.1))
}
