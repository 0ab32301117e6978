//! The statements in docs/tuning.md about a repeated path, for a robot with the flaws of the laboratory.

use std::f64::consts::TAU;

use cdcr_controller::closed_loop::{ClosedLoop, Driven, Sensor};
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, RateWeight};
use cdcr_controller::plant::RobotPreset;
use cdcr_controller::robot::{Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::Vector3;

use crate::inside;

const PERIOD_S: f64 = 0.005;
const RADIUS_M: f64 = 0.1;

/// A circle, from the tip of three bent sections.
#[derive(Clone, Copy)]
struct Rounds {
    settings: NmpcSettings,
    start_rad: [[f64; 2]; 3],
    obstacle: Option<Obstacle>,
    round_s: f64,
    /// Rounds after which the reference rests.
    count: f64,
}

/// The weights of a robot that is not the ideal one.
fn circle(posture_gain: f64) -> Rounds {
    Rounds {
        settings: NmpcSettings {
            rate_weight: RateWeight::MEASURED,
            posture_gain,
            ..NmpcSettings::default()
        },
        start_rad: [[0.4, 0.0], [0.6, 0.5], [0.6, 0.0]],
        obstacle: None,
        round_s: 3.1,
        count: f64::INFINITY,
    }
}

/// What was measured since the last such row.
struct RoundRow {
    /// Ends of the first two sections \[m\].
    ends_m: [Vector3<f64>; 2],
    tip_mean_mm: f64,
    tip_max_mm: f64,
    clearance_min_m: f64,
}

impl Rounds {
    /// A row at each of these times, in rounds.
    fn follow(&self, until_rounds: &[f64]) -> Vec<RoundRow> {
        let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
        let start = Configuration::from_bend_angles(&self.start_rad);
        let start_m = robot.tip_position(&start);
        let reference = move |time_s: f64| {
            let (sin, cos) = (TAU * (time_s / self.round_s).min(self.count)).sin_cos();
            inside(start_m + RADIUS_M * Vector3::new(cos - 1.0, sin, 0.0))
        };
        let flaws = RobotPreset::Laboratory.flaws();
        let driven = Driven {
            flaws,
            actuator: flaws.actuator,
            time_constant_s: 0.18,
            obeys_positions: true,
            sensor: Sensor::CablesAndTip { every: 2 },
            without: None,
            seed: 1,
        };
        let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, self.settings).unwrap();
        let obstacles = self.obstacle.as_slice();
        let closed = ClosedLoop::new(&robot, PERIOD_S, self.settings, start, obstacles, reference);
        let mut closed = (closed.unwrap().with_acceleration(40.0))
            .with_driven(driven)
            .unwrap();
        let row = |rounds: &f64| {
            let (mut sum_m, mut max_m, mut cycles) = (0.0, 0.0, 0.0);
            let mut clearance_min_m = f64::INFINITY;
            while closed.time_s() < rounds * self.round_s {
                closed.step(&mut nmpc);
                (sum_m, cycles) = (sum_m + closed.error_m(), cycles + 1.0);
                max_m = f64::max(max_m, closed.error_m());
                clearance_min_m = clearance_min_m.min(closed.clearance_m());
            }
            let frames = robot.section_frames(closed.configuration());
            RoundRow {
                ends_m: [1, 2].map(|section| frames[section].position_m),
                tip_mean_mm: 1e3 * sum_m / cycles,
                tip_max_mm: 1e3 * max_m,
                clearance_min_m,
            }
        };
        until_rounds.iter().map(row).collect()
    }
}

/// Largest distance between the ends of the first two sections (mm).
fn apart_mm(a: &RoundRow, b: &RoundRow) -> f64 {
    let ends = a.ends_m.iter().zip(b.ends_m);
    1e3 * ends.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
}

/// Motion of the body from round 6 to round 30, and the mean error of the tip in these rounds (mm).
fn later(rounds: &Rounds) -> [f64; 2] {
    let rows = rounds.follow(&[1.0, 5.0, 6.0, 30.0]);
    let [first, each, late] = [1, 2, 3].map(|row| apart_mm(&rows[row - 1], &rows[row]));
    let tip_mm = rows[3].tip_mean_mm;
    let gain = rounds.settings.posture_gain;
    println!(
        "gain {gain}: {first:.1} mm in rounds 2 to 5, {each:.2} mm in round 6, {late:.1} mm in 24 more; tip {tip_mm:.4} mm"
    );
    [late, tip_mm]
}

#[test]
fn the_body_repeats_what_the_tip_repeats() {
    let [late, tip_mm] = later(&circle(0.0));
    assert!(late > 50.0, "{late}");
    for gain in [1.0, 2.0, 5.0] {
        let [late, with_tip_mm] = later(&circle(gain));
        assert!(late < 8.0 / gain, "{gain}: {late}");
        let most_mm = 1.01 * tip_mm;
        assert!(with_tip_mm < most_mm, "{gain}: {with_tip_mm} {tip_mm}");
    }
}

#[test]
fn with_the_weights_of_smooth_it_is_repeated_too() {
    let smooth = |gain| {
        let mut rounds = circle(gain);
        rounds.settings.rate_weight = RateWeight::Of(1e-7);
        rounds.settings.rate_change_weight = 1e-5;
        later(&rounds)
    };
    let [without, with] = [0.0, 2.0].map(smooth);
    assert!(without[0] > 50.0 && with[0] < 4.0, "{without:?} {with:?}");
    assert!(with[1] < 1.05 * without[1], "{without:?} {with:?}");
}

#[test]
fn the_way_of_the_body_does_not_depend_on_the_speed() {
    let [fast, slow] = [3.1, 12.0].map(|round_s| {
        let rounds = Rounds {
            round_s,
            ..circle(2.0)
        };
        rounds.follow(&[15.0])
    });
    let mm = apart_mm(&fast[0], &slow[0]);
    println!("at a quarter of the speed: {mm:.2} mm beside");
    assert!(mm < 5.0, "{mm}");
}

#[test]
fn a_body_whose_tip_rests_does_not_return() {
    let stopped = Rounds {
        count: 1.5,
        ..circle(5.0)
    };
    let rows = stopped.follow(&[2.0, 6.0]);
    let mm = apart_mm(&rows[0], &rows[1]);
    println!("at rest: {mm:.3} mm");
    assert!(mm < 0.3, "{mm}");
}

/// A ball where the straightened body would be. The body keeps its distance, and the tip waits where it has to.
#[test]
fn an_obstacle_at_the_posture_is_kept_clear_of() {
    let centre_m = Vector3::new(0.02, 0.0, 0.35);
    let ball = Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap();
    for gain in [0.0, 2.0, 5.0] {
        let mut rounds = circle(gain);
        rounds.start_rad = [[0.9, 1.57], [0.9, -1.57], [0.9, -0.5]];
        rounds.obstacle = Some(ball);
        let row = &rounds.follow(&[0.2, 15.0])[1];
        let (max_mm, clearance_mm) = (row.tip_max_mm, 1e3 * row.clearance_min_m);
        println!("gain {gain}: tip {max_mm:.2} mm at most, clearance {clearance_mm:.2} mm");
        let safe_m = rounds.settings.safe_distance_m;
        assert!(row.clearance_min_m > safe_m - 1e-3, "{clearance_mm}");
        // The case is one of contact.
        assert!(
            gain == 0.0 || row.clearance_min_m < safe_m + 5e-3,
            "{clearance_mm}"
        );
    }
}
