//! Obstacles of every kind near the robot.

use cdcr_client::monotonic_ns;
use cdcr_controller::robot::{BendRates, Robot, RobotParameters};
use cdcr_daemon::convert;
use cdcr_shared_types::codes::ObstacleShape;
use cdcr_shared_types::{Obstacle, Telemetry};
use cdcr_tests::record::{configuration_of, robot_of};

use crate::chaos::dice::Dice;

/// Ids of single obstacles: a few, so that they replace each other.
const IDS: u32 = 12;

/// Attempts to place an obstacle beside one part of the robot but not too near to another.
const DRAWS: u32 = 10;

/// A ball or a bar about `gap_m` from the surface of the robot.
fn beside(dice: &mut Dice, record: &Telemetry, gap_m: f64) -> Obstacle {
    let (robot, bends) = (robot_of(&record.robot), configuration_of(record));
    let body = robot.body(&bends);
    let mut obstacle = draw(dice, record, &robot, gap_m);
    for _ in 1..DRAWS {
        let known = convert::obstacle(&obstacle, monotonic_ns());
        if known.is_ok_and(|known| body.clearance_m(&known.obstacle) >= gap_m - 1e-3) {
            break;
        }
        obstacle = draw(dice, record, &robot, gap_m);
    }
    obstacle
}

/// A ball or a bar beside the tip, or beside the end of an earlier section.
fn draw(dice: &mut Dice, record: &Telemetry, robot: &Robot, gap_m: f64) -> Obstacle {
    let sections = 1 + dice.below(record.robot.sections) as usize;
    let part = Robot::new(&RobotParameters {
        sections: robot.sections()[..sections].to_vec(),
        ..robot.parameters()
    });
    let point = part.unwrap().tip_position(&configuration_of(record));
    let radius_m = dice.between(0.005, 0.05);
    let away_m = robot.sections()[0].body_radius_m + gap_m + radius_m;
    let way = way_of_tip(record, robot).filter(|_| sections as u32 == record.robot.sections);
    let away = way.map_or_else(|| dice.vector(away_m), |way| way.map(|x| away_m * x));
    let start_m = core::array::from_fn(|i| point[i] + away[i]);
    Obstacle {
        id: dice.below(IDS),
        shape: dice
            .pick(&[ObstacleShape::Sphere, ObstacleShape::Capsule])
            .code(),
        start_m,
        // A bar points away from the robot.
        end_m: core::array::from_fn(|i| start_m[i] + 2.0 * away[i]),
        radius_m,
        measured_ns: monotonic_ns(),
        lifetime_ns: dice.duration_ms(100, 2000).as_nanos() as u64,
        ..Obstacle::default()
    }
}

/// Direction of the tip's motion; `None` at rest.
fn way_of_tip(record: &Telemetry, robot: &Robot) -> Option<[f64; 3]> {
    let rates = &record.command.bend_rate_rad_s[..robot.coordinate_count()];
    let rates = BendRates::from_slice(rates).unwrap();
    let next = robot.tip_position(&configuration_of(record).advanced(&rates, 0.005));
    let way: [f64; 3] = core::array::from_fn(|i| next[i] - record.tip_position_m[i]);
    let norm = way.iter().map(|x| x * x).sum::<f64>().sqrt();
    (norm > 1e-6).then(|| way.map(|x| x / norm))
}

/// Outside the safe distance, within reach of the next periods.
pub(crate) fn near(dice: &mut Dice, record: &Telemetry) -> Obstacle {
    let gap_m = record.settings.safe_distance_m + dice.between(0.001, 0.03);
    beside(dice, record, gap_m)
}

/// Inside the safe distance; every third in contact.
pub(crate) fn inside(dice: &mut Dice, record: &Telemetry, turn: u32) -> Obstacle {
    let gap_m = if turn % 3 == 1 {
        -dice.between(0.001, 0.005)
    } else {
        record.settings.safe_distance_m * dice.between(0.0, 1.0)
    };
    beside(dice, record, gap_m)
}

/// Approaches, and reaches the robot within a sufficient lifetime.
pub(crate) fn towards(dice: &mut Dice, record: &Telemetry) -> Obstacle {
    let gap_m = record.settings.safe_distance_m + dice.between(0.01, 0.1);
    let mut obstacle = beside(dice, record, gap_m);
    let speed = dice.between(0.02, 0.3);
    let way: [f64; 3] = core::array::from_fn(|i| record.tip_position_m[i] - obstacle.start_m[i]);
    let norm = way.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-3);
    obstacle.velocity_m_s = way.map(|x| speed * x / norm);
    obstacle.lifetime_ns = obstacle.lifetime_ns.min(600_000_000);
    obstacle
}

/// An obstacle that the daemon must reject, one kind after the other.
pub(crate) fn bad(dice: &mut Dice, record: &Telemetry, turn: u32) -> Obstacle {
    let mut obstacle = near(dice, record);
    match turn % 5 {
        0 => obstacle.radius_m = -1.0,
        1 => obstacle.start_m[2] = f64::NAN,
        2 => obstacle.shape = 9,
        3 => obstacle.measured_ns += 1_000_000_000,
        _ => (obstacle.measured_ns, obstacle.lifetime_ns) = (1, 1),
    }
    obstacle
}

/// Out of reach, for a short time.
pub(crate) fn far(id: u32) -> Obstacle {
    Obstacle {
        id,
        start_m: [1.5, 0.0, 0.02 * f64::from(id)],
        radius_m: 0.02,
        measured_ns: monotonic_ns(),
        lifetime_ns: 300_000_000,
        ..Obstacle::default()
    }
}
