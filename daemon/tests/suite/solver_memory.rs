//! `Nmpc::solve` never allocates, with any solver, coordinates and scene.

use cdcr_controller::nmpc::{Coordinates, Nmpc, NmpcSettings, SolveInput, SolverKind};
use cdcr_controller::optimizer::{Budget, Simd, cycle_seed};
use cdcr_controller::reference::{Orientation, ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use cdcr_controller::safety::limit;
use cdcr_daemon::rt::sys::count_allocations;
use nalgebra::{UnitQuaternion, Vector3};

const PERIOD_S: f64 = 0.005;

#[test]
fn the_counter_counts() {
    let (operations, text) = count_allocations(|| vec![1_u8; 100]);
    assert_eq!((operations, text.len()), (1, 100));
    assert_eq!(count_allocations(|| drop(text)).0, 1);
}

#[test]
fn no_solver_touches_the_heap() {
    let mut parameters = RobotParameters::paper(3);
    // Tight limits, so that stroke and speed are active, too.
    parameters.cable_stroke_max_m = 0.03;
    parameters.cable_speed_max_m_s = 0.04;
    let free = Robot::new(&parameters).unwrap();
    // The reference is paced.
    parameters.tip_speed_max_m_s = 0.05;
    let slow = Robot::new(&parameters).unwrap();
    for (solver, robot) in SolverKind::ALL
        .into_iter()
        .flat_map(|solver| [(solver, &free), (solver, &slow)])
    {
        // Six blocks without a weight on changes of rates: the smoother.
        for (coordinates, control_blocks, rate_change_weight) in [
            (Coordinates::BendVector, 3, 1e-9),
            (Coordinates::BendAngles, 3, 1e-9),
            (Coordinates::BendVector, 6, 0.0),
        ] {
            let settings = NmpcSettings {
                solver,
                coordinates,
                horizon_steps: 6,
                control_blocks,
                swarm_size: 20,
                swarm_iterations: 10,
                rate_weight: 1e-9.into(),
                rate_change_weight,
                orientation_tolerance_rad: 1e-3,
                ..NmpcSettings::default()
            };
            for simd in Simd::available() {
                let mut nmpc = Nmpc::with_simd(simd, robot.clone(), PERIOD_S, settings).unwrap();
                let (operations, ()) = count_allocations(|| run(&mut nmpc));
                assert_eq!(operations, 0, "{settings:?}, {simd:?}");
            }
        }
    }
}

/// Fast along the paper's spiral among spheres, with rates at their limits: the solver plans beyond its horizon
/// (`Foresight`). The horizon changes between short and long.
#[test]
fn plans_beyond_a_horizon_touch_no_heap() {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let obstacles: Vec<_> = (0..16)
        .map(|i| {
            let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
            let up_m = 0.615 + 0.06 * f64::from(i) / 16.0;
            let centre_m = Vector3::new(0.066 * cos, 0.066 * sin, up_m);
            Obstacle::new(Shape::Sphere { centre_m }, 0.01, Vector3::zeros()).unwrap()
        })
        .collect();
    let samples: Vec<_> = (0..200).map(|k| spiral(f64::from(k))).collect();
    for solver in [SolverKind::GaussNewton, SolverKind::KpsoRefined] {
        let settings = NmpcSettings {
            solver,
            ..NmpcSettings::default()
        };
        // A clone has the same capacity, also for horizons longer than the present one.
        let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings)
            .unwrap()
            .clone();
        let (operations, ()) = count_allocations(|| {
            let begin = 5.0_f64.to_radians();
            let mut at =
                Configuration::from_bend_angles(&[[0.0; 2], [0.0; 2], [2.0 * begin / 15.0, begin]]);
            let mut rates = BendRates::zero(3);
            for cycle in 0..75 {
                let horizon_steps = match cycle {
                    2..=65 => 20,
                    66..=70 => 40,
                    _ => 2,
                };
                if nmpc.settings().horizon_steps != horizon_steps {
                    let settings = NmpcSettings {
                        horizon_steps,
                        ..settings
                    };
                    nmpc.configure(settings).unwrap();
                }
                let input = SolveInput {
                    configuration: &at,
                    previous_rates: &rates,
                    reference: &samples[cycle + 1..=cycle + horizon_steps as usize],
                    obstacles: &obstacles,
                    tip_offset_m: 0.0,
                    elapsed_periods: 1,
                    seed: cycle_seed(1, cycle as u64),
                };
                (rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
                at = at.advanced(&rates, PERIOD_S);
            }
        });
        assert_eq!(operations, 0, "{solver:?}");
    }
}

/// Eq. 8 at ten times its speed, by cycles.
fn spiral(cycle: f64) -> ReferenceSample {
    let t = 5.0_f64.to_radians() + 0.05 * cycle;
    let (sin, cos) = (t / 15.0).sin_cos();
    let radius_m = 4.5 * sin / t;
    ReferenceSample {
        state: ReferenceState::Inside,
        position_m: Vector3::new(
            radius_m * sin * t.cos(),
            radius_m * sin * t.sin(),
            0.6 + radius_m * cos,
        ),
        orientation: Orientation::Free,
    }
}

/// From the singular straight robot, where the Hessian is evaluated, past a sphere and a capsule, to a jump
/// of the reference; with a position, an axis and a rotation.
fn run(nmpc: &mut Nmpc) {
    let robot = nmpc.robot().clone();
    let mut at = Configuration::straight(3);
    let mut rates = BendRates::zero(3);
    let mut settings = *nmpc.settings();
    for cycle in 0..60 {
        let t = cycle as f64 * PERIOD_S;
        let orientation = match cycle % 4 {
            0 => Orientation::Free,
            1 => Orientation::Axis(Vector3::z_axis()),
            2 => Orientation::Preferred(Vector3::x_axis()),
            _ => Orientation::Full(UnitQuaternion::identity()),
        };
        let jump_m = if cycle > 45 { 0.3 } else { 0.0 };
        let sample = ReferenceSample {
            state: ReferenceState::Inside,
            position_m: Vector3::new(0.2 * t + jump_m, 0.0, 0.9 - 0.1 * t),
            orientation,
        };
        let velocity_m_s = Vector3::new(0.0, 0.05, 0.0);
        let tip_m = Vector3::new(0.05, -0.01, 0.85);
        let bar = Shape::Capsule {
            start_m: tip_m - Vector3::x(),
            end_m: tip_m + Vector3::x(),
        };
        let obstacles = [Shape::Sphere { centre_m: tip_m }, bar]
            .map(|shape| Obstacle::new(shape, 0.005, velocity_m_s).unwrap());
        let input = SolveInput {
            configuration: &at,
            previous_rates: &rates,
            reference: &[sample],
            obstacles: &obstacles,
            tip_offset_m: 0.0,
            elapsed_periods: 1,
            seed: cycle_seed(1, cycle),
        };
        let (desired_rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
        rates = limit(&robot, &at, &desired_rates, PERIOD_S).rates;
        at = at.advanced(&rates, PERIOD_S);
        if cycle == 40 {
            settings.horizon_steps = 10;
            settings.control_blocks = 0;
            nmpc.configure(settings).unwrap();
        }
    }
}
