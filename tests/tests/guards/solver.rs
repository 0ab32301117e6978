//! `Nmpc::solve` never allocates, with any solver, coordinates and scene.

use cdcr_controller::nmpc::{Coordinates, Nmpc, NmpcSettings, SolveInput, SolverKind};
use cdcr_controller::optimizer::{Budget, Simd, cycle_seed};
use cdcr_controller::reference::{Orientation, ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use cdcr_controller::safety::limit;
use cdcr_daemon::rt::sys::count_allocations;
use nalgebra::{UnitQuaternion, Vector3};

const PERIOD_S: f64 = 0.005;
const SOLVERS: [SolverKind; 3] = [
    SolverKind::Kpso,
    SolverKind::GaussNewton,
    SolverKind::KpsoRefined,
];

#[test]
fn no_solver_touches_the_heap() {
    let mut parameters = RobotParameters::paper(3);
    // Tight limits, so that stroke and speed are active, too.
    parameters.cable_stroke_max_m = 0.03;
    parameters.cable_speed_max_m_s = 0.04;
    let robot = Robot::new(&parameters).unwrap();
    for solver in SOLVERS {
        for coordinates in [Coordinates::BendVector, Coordinates::BendAngles] {
            let settings = NmpcSettings {
                solver,
                coordinates,
                horizon_steps: 6,
                control_blocks: 3,
                swarm_size: 20,
                swarm_iterations: 10,
                rate_weight: 1e-9.into(),
                rate_change_weight: 1e-9,
                orientation_tolerance_rad: 1e-3,
                ..NmpcSettings::default()
            };
            // The paths of a release build.
            for simd in Simd::available().filter(|simd| *simd != Simd::Scalar) {
                let mut nmpc = Nmpc::with_simd(simd, robot.clone(), PERIOD_S, settings).unwrap();
                let (operations, ()) = count_allocations(|| run(&mut nmpc));
                assert_eq!(operations, 0, "{solver:?}, {coordinates:?}, {simd:?}");
            }
        }
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
        let orientation = match cycle % 3 {
            0 => Orientation::Free,
            1 => Orientation::Axis(Vector3::z_axis()),
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
