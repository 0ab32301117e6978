//! Duration of the safety checks in a hard case: six sections among 64 obstacles, all of them in reach.

use std::time::Instant;

use anyhow::{Context, Result};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use cdcr_controller::safety::{Situation, safe_command};
use nalgebra::Vector3;
use serde_json::{Value, json};

use crate::closed_loop::{PERIOD_S, Scene};
use crate::numbers::Numbers;
use crate::quantiles::{histogram, quantile_us};

const SECTIONS: usize = 6;
const OBSTACLES: usize = 64;
const MOMENTS: u64 = 1000;
/// Repetitions of each command; the fastest counts, because only the machine differs between them.
const REPEATS: usize = 5;
const BEND_RAD: f64 = 0.8;
/// Fastest rates of a moment \[rad/s\].
const RATES_RAD_S: [f64; 4] = [0.1, 0.5, 1.0, 2.0];
const SPEED_M_S: f64 = 0.3;
const BODY_RADIUS_M: f64 = 0.015;
/// As in a daemon with its defaults.
const DECELERATION_RAD_S2: f64 = 40.0;

/// The obstacles around the robot: their name, whether half of them are capsules, and whether they move.
type Crowd = (&'static str, bool, bool);
const CROWDS: [Crowd; 4] = [
    ("balls", false, false),
    ("balls-moving", false, true),
    ("half-capsules", true, false),
    ("half-capsules-moving", true, true),
];

pub fn measure(divisor: u64) -> Result<Vec<Value>> {
    let measure = |crowd| measure_crowd(crowd, MOMENTS / divisor);
    CROWDS.into_iter().map(measure).collect()
}

fn measure_crowd(crowd: Crowd, moments: u64) -> Result<Value> {
    let robot = Robot::new(&RobotParameters::paper(SECTIONS))?;
    let (mut times, mut changed) = (histogram(), 0);
    for seed in 0..moments {
        let moment = Moment::new(crowd, &robot, seed)?;
        let situation = Situation {
            robot: &robot,
            at: &moment.at,
            lag: None,
            commanded: None,
            slack: None,
            previous: &moment.previous,
            obstacles: &moment.obstacles,
            safe_distance_m: Scene::SAFE_DISTANCE_M,
            tip_offset_m: 0.0,
            acceleration_rad_s2: DECELERATION_RAD_S2,
            period_s: PERIOD_S,
            moving_s: 3.0 * PERIOD_S,
            deceleration_rad_s2: DECELERATION_RAD_S2,
            comes_to_rest: false,
        };
        let timed = |()| {
            let begin = Instant::now();
            let command = safe_command(&situation, &moment.desired);
            (begin.elapsed().as_nanos() as u64, command.clearance_hit)
        };
        let runs = [(); REPEATS].map(timed);
        times.saturating_record(runs.iter().map(|run| run.0).min().unwrap_or(u64::MAX));
        changed += u64::from(runs[0].1);
    }
    Ok(json!({
        "crowd": crowd.0,
        "moments": moments,
        "p50_us": quantile_us(&times, 0.5),
        "p99_us": quantile_us(&times, 0.99),
        "max_us": quantile_us(&times, 1.0),
        "changed_percent": 100.0 * changed as f64 / moments as f64,
    }))
}

struct Moment {
    at: Configuration,
    previous: BendRates,
    desired: BendRates,
    obstacles: Vec<Obstacle>,
}

impl Moment {
    fn new(crowd: Crowd, robot: &Robot, seed: u64) -> Result<Self> {
        let mut numbers = Numbers::new(seed);
        let mut vector = |most: f64| -> Vec<f64> {
            let number = |_| numbers.between(-most, most);
            (0..2 * SECTIONS).map(number).collect()
        };
        let fastest_rad_s = RATES_RAD_S[seed as usize % RATES_RAD_S.len()];
        let (bends, rates) = (vector(BEND_RAD), vector(fastest_rad_s));
        let slower: Vec<f64> = rates.iter().map(|rate| 0.9 * rate).collect();
        let at = Configuration::from_slice(&bends).context("a shape")?;
        let obstacles = (0..OBSTACLES).map(|_| obstacle(crowd, robot, &at, &mut numbers));
        Ok(Self {
            obstacles: obstacles.collect::<Result<_>>()?,
            desired: BendRates::from_slice(&rates).context("rates")?,
            previous: BendRates::from_slice(&slower).context("rates")?,
            at,
        })
    }
}

/// Beside a random point of the body: between the safe distance and 30 mm beyond it.
fn obstacle(
    (_, has_capsules, moves): Crowd,
    robot: &Robot,
    at: &Configuration,
    numbers: &mut Numbers,
) -> Result<Obstacle> {
    let section = numbers.between(0.0, SECTIONS as f64) as usize;
    let body_m = robot.body_point(at, section, numbers.between(0.0, 1.0));
    let radius_m = numbers.between(0.005, 0.03);
    let away_m = BODY_RADIUS_M + radius_m + Scene::SAFE_DISTANCE_M + numbers.between(0.0, 0.03);
    let mut vector = || Vector3::from_fn(|_, _| numbers.between(-1.0, 1.0));
    let side = vector().normalize();
    let span_m = 0.1 * side.cross(&vector());
    let speed_m_s = if moves { SPEED_M_S } else { 0.0 };
    let velocity_m_s = speed_m_s * vector();
    let centre_m = body_m + away_m * side;
    let shape = if has_capsules && numbers.between(0.0, 1.0) < 0.5 {
        let (start_m, end_m) = (centre_m - span_m, centre_m + span_m);
        Shape::Capsule { start_m, end_m }
    } else {
        Shape::Sphere { centre_m }
    };
    Ok(Obstacle::new(shape, radius_m, velocity_m_s)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_obstacle_can_be_met_and_the_guard_has_work() {
        let robot = Robot::new(&RobotParameters::paper(SECTIONS)).expect("the paper's robot");
        for crowd in CROWDS {
            let moment = Moment::new(crowd, &robot, 3).expect("a moment");
            let body = robot.body(&moment.at);
            let far = |o: &&Obstacle| body.clearance_m(o) > Scene::SAFE_DISTANCE_M + 0.03 + 1e-9;
            assert_eq!(moment.obstacles.iter().filter(far).count(), 0);
            let is_moving = |o: &&Obstacle| o.velocity_m_s() != Vector3::zeros();
            let moving = moment.obstacles.iter().filter(is_moving).count();
            assert_eq!(moving, if crowd.2 { OBSTACLES } else { 0 });
            let found = measure_crowd(crowd, 20).expect("measured");
            let [p50, p99, changed] =
                ["p50_us", "p99_us", "changed_percent"].map(|key| found[key].as_f64().expect(key));
            assert!(p50 > 0.0 && p50 <= p99 && changed > 50.0, "{found}");
        }
    }
}
