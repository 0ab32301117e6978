//! The harder scenes: a crowd of obstacles, a gap, an obstacle that crosses the robot, a jump of the reference; and a spiral out of reach.

use cdcr_controller::closed_loop::Scene;
use cdcr_controller::nmpc::{NmpcSettings, SolverKind};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::robot::{Obstacle, Robot, RobotParameters, SECTIONS_MAX};

/// Errors of the tip \[mm\] and clearances of the body \[m\], cycle by cycle.
struct Run {
    errors_mm: Vec<f64>,
    clearances_m: Vec<f64>,
}

impl Run {
    /// Each step of the horizon has rates of its own.
    fn new(scene: &Scene, horizon_steps: u32, seed: u64, has_time: bool) -> Self {
        let settings = NmpcSettings {
            horizon_steps,
            seed,
            control_blocks: 0,
            swarm_size: 32,
            swarm_iterations: 50,
            refinement_steps: 20,
            safe_distance_m: Scene::SAFE_DISTANCE_M,
            ..NmpcSettings::default()
        };
        Self::with(scene, settings, has_time)
    }

    fn with(scene: &Scene, settings: NmpcSettings, has_time: bool) -> Self {
        let mut nmpc = scene.solver(settings).unwrap();
        let mut closed = scene.begin(settings).unwrap();
        let (mut errors_mm, mut clearances_m) = (Vec::new(), Vec::new());
        while closed.cycle() < scene.cycles {
            let mut budget = [Budget::from_quanta(0), Budget::unlimited()];
            let budget = &mut budget[usize::from(has_time)];
            let (rates, report) = nmpc.solve(&closed.input(), budget);
            assert!(has_time || report.budget_spent);
            closed.advance(&rates);
            errors_mm.push(1e3 * closed.error_m());
            clearances_m.push(closed.clearance_m());
        }
        Self {
            errors_mm,
            clearances_m,
        }
    }

    fn mean_mm(&self) -> f64 {
        self.errors_mm.iter().sum::<f64>() / self.errors_mm.len() as f64
    }

    fn max_mm(&self) -> f64 {
        self.errors_mm.iter().copied().fold(0.0, f64::max)
    }

    fn least_m(&self) -> f64 {
        let clearances_m = self.clearances_m.iter().copied();
        clearances_m.fold(f64::INFINITY, f64::min)
    }

    /// Cycles below the safe distance, beyond rounding.
    fn too_near(&self) -> usize {
        let is_near = |clearance_m: &&f64| **clearance_m < Scene::SAFE_DISTANCE_M - 1e-9;
        self.clearances_m.iter().filter(is_near).count()
    }
}

#[test]
fn with_enough_time_the_tip_arrives_and_the_body_keeps_clear() {
    // Far more work than fits into a cycle of 5 ms; the same bits on every machine.
    let mut max_mm = 0.0;
    for seed in 1..=5 {
        let run = Run::new(&Scene::gap().unwrap(), 5, seed, true);
        assert!(run.mean_mm() < 1.0 && run.too_near() == 0);
        // The gap was as narrow as intended.
        assert!(run.least_m() < Scene::SAFE_DISTANCE_M + 0.004);
        max_mm += run.max_mm() / 5.0;
    }
    assert!(max_mm < 5.0, "{max_mm}");
    let run = Run::new(&Scene::crossing().unwrap(), 10, 1, true);
    assert!(run.mean_mm() < 6.0 && run.max_mm() < 25.0);
    // The ball came as near as allowed.
    assert!(run.too_near() == 0 && run.least_m() < Scene::SAFE_DISTANCE_M + 0.001);
    // No robot can follow the jump at once.
    let run = Run::new(&Scene::jump().unwrap(), 10, 1, true);
    assert!(run.max_mm() > 50.0 && run.mean_mm() < 15.0);
}

#[test]
fn without_any_time_the_robot_stays_where_it_is() {
    let scene = Scene::jump().unwrap().at_most(60);
    let run = Run::new(&scene, 10, 1, false);
    let jump_mm = 1e3 * (scene.point_m(60) - scene.point_m(0)).norm();
    assert!((run.max_mm() - jump_mm).abs() < 1e-9);
    // A ball moves into the robot.
    let run = Run::new(&Scene::crossing().unwrap(), 10, 1, false);
    assert!(run.least_m() < 0.0 && run.too_near() > 20);
}

/// The tip at the nearest reachable point of a shorter robot: the target `nearest` of `cdcr-bench robustness`.
#[test]
fn the_part_of_the_spiral_that_is_out_of_reach_is_that_far_away() {
    let mut shorter = RobotParameters::paper(3);
    for section in &mut shorter.sections {
        section.length_m *= 0.95;
    }
    let mut scene = Scene::spiral(3).unwrap();
    scene.robot = Robot::new(&shorter).unwrap();
    let run = Run::with(&scene, NmpcSettings::default(), true);
    // The evaluated cycles: see `FigureEightRun::settled_mm`.
    let settled = &run.errors_mm[597..];
    let mean_mm = settled.iter().sum::<f64>() / settled.len() as f64;
    assert!((mean_mm - 34.22).abs() < 0.005, "{mean_mm}");
}

#[test]
fn every_obstacle_of_a_crowd_stays_within_reach_and_the_spiral_is_followed() {
    for sections in [3, 6] {
        let settings = NmpcSettings {
            solver: SolverKind::GaussNewton,
            ..NmpcSettings::default()
        };
        let scene = Scene::spiral(sections).unwrap().at_most(200);
        let scene = scene.crowded(64, settings.safe_distance_m, 4).unwrap();
        // The obstacles that the solver considers, with the body at its rate limits.
        let horizon_s = f64::from(settings.horizon_steps) * Scene::PERIOD_S;
        let change_rad = 2_f64.sqrt() * scene.robot.sections()[0].rate_max_rad_s * horizon_s;
        let travel_m = scene.robot.travel_m(&[change_rad; SECTIONS_MAX]);
        let reach_m = travel_m.map(|travel_m| travel_m + settings.safe_distance_m);
        let mut nmpc = scene.solver(settings).unwrap();
        let mut closed = scene.begin(settings).unwrap();
        while closed.cycle() < scene.cycles {
            closed.step(&mut nmpc);
            let body = scene.robot.body(closed.configuration());
            let near = |o: &&Obstacle| body.sections_in_reach(o, &reach_m) != 0;
            assert_eq!(scene.obstacles.iter().filter(near).count(), 64);
            let error_m = closed.error_m();
            assert!(error_m < 1e-4, "{sections} sections: {error_m} m");
        }
    }
}
