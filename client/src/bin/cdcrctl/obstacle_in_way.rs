//! Which obstacle is in the way of a motion that the robot could do without it.

use cdcr_client::model::{obstacle_of, settings_of};
use cdcr_client::{Connection, FeedOptions, Trajectory, obstacles};
use cdcr_controller::nmpc::NmpcSettings;
use cdcr_shared_types::Telemetry;

use crate::dry_run::{newest, robot_and_pose, simulate};
use crate::standing::distance_m;

/// What to add where the end of `way` is missed by more than `allowed_m`: empty unless it is reached without the obstacles.
pub(crate) fn note(
    connection: &Connection,
    way: &dyn Trajectory,
    options: &FeedOptions,
    allowed_m: f64,
) -> anyhow::Result<String> {
    let record = newest(connection)?;
    note_of(
        &record,
        settings_of(&record.settings)?,
        way,
        options,
        allowed_m,
    )
}

fn note_of(
    record: &Telemetry,
    settings: NmpcSettings,
    way: &dyn Trajectory,
    options: &FeedOptions,
    allowed_m: f64,
) -> anyhow::Result<String> {
    let Some((id, clearance_m)) = nearest(record) else {
        return Ok(String::new());
    };
    let arrives = |record: &Telemetry| -> anyhow::Result<bool> {
        let demands = simulate(record, settings, way, options)?;
        Ok(demands.check_end(allowed_m).is_ok())
    };
    if let Some((id, speed_m_s)) = fastest(record)
        && arrives(&standing(record))?
    {
        return Ok(format!(
            ". This takes moving obstacles to go on as now for the whole way: id {id} at {speed_m_s:.3} m/s. If they stayed where they are, the tip \
             would arrive: try again when they have passed (cdcrctl obstacle list)"
        ));
    }
    let free = Telemetry {
        obstacle_count: 0,
        ..*record
    };
    if !arrives(&free)? {
        return Ok(String::new());
    }
    Ok(format!(
        ". Without the obstacles the tip arrives: {} known, the nearest has id {id}, {:.1} mm from the body now (cdcrctl obstacle list)",
        record.obstacle_count,
        1e3 * clearance_m
    ))
}

/// The obstacle that moves fastest, and its speed \[m/s\]; `None` if all rest.
fn fastest(record: &Telemetry) -> Option<(u32, f64)> {
    let speeds = obstacles(record)
        .iter()
        .map(|known| (known.id, distance_m(known.velocity_m_s, [0.0; 3])));
    let moving = speeds.filter(|(_, speed_m_s)| *speed_m_s > 0.0);
    moving.max_by(|one, other| one.1.total_cmp(&other.1))
}

/// The same with obstacles that rest where they are.
fn standing(record: &Telemetry) -> Telemetry {
    let mut standing = *record;
    for obstacle in &mut standing.obstacles {
        obstacle.velocity_m_s = [0.0; 3];
    }
    standing
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

#[cfg(test)]
mod tests {
    use cdcr_client::Straight;
    use cdcr_shared_types::Obstacle;

    use super::*;
    use crate::dry_run::tests::two_sections;

    #[test]
    fn an_obstacle_that_comes_is_named_with_its_speed_and_one_that_rests_with_its_clearance() {
        let way = Straight::new([0.0, 0.0, 0.6], [0.2, 0.0, 0.53], 0.1, 0.4);
        let note = |start_m: [f64; 3], speed_m_s: f64| {
            let mut record = two_sections();
            record.obstacle_count = 1;
            record.obstacles[0] = Obstacle {
                id: 7,
                radius_m: 0.05,
                start_m,
                velocity_m_s: [-speed_m_s, 0.0, 0.0],
                ..Obstacle::default()
            };
            let (settings, options) = (NmpcSettings::default(), FeedOptions::default());
            note_of(&record, settings, &way, &options, 1e-3).unwrap()
        };
        let resting = note([0.2, 0.0, 0.53], 0.0);
        assert!(resting.contains("the nearest has id 7"), "{resting}");
        // It is beyond the end now, and in the way when the tip arrives.
        let coming = note([0.45, 0.0, 0.53], 0.1);
        assert!(coming.contains("id 7 at 0.100 m/s"), "{coming}");
    }
}
