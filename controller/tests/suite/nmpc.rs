//! The guarantees of `Nmpc::solve`, tested with hard robots and references.

use cdcr_controller::nmpc::{
    Coordinates, Nmpc, NmpcSettings, RateWeight, SolveInput, SolveStatus, SolverKind,
};
use cdcr_controller::optimizer::{Budget, VelocityRule, cycle_seed};
use cdcr_controller::reference::{Orientation, ReferenceSample};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use proptest::prelude::*;

use crate::{input, inside};

const PERIOD_S: f64 = 0.005;
const RULES: [VelocityRule; 3] = [
    VelocityRule::Inertia,
    VelocityRule::Constriction,
    VelocityRule::Verbatim,
];

fn paper(sections: usize) -> Robot {
    Robot::new(&RobotParameters::paper(sections)).unwrap()
}

fn solver(robot: &Robot, kind: SolverKind, horizon_steps: u32) -> Nmpc {
    let settings = NmpcSettings {
        solver: kind,
        horizon_steps,
        ..NmpcSettings::default()
    };
    Nmpc::new(robot.clone(), PERIOD_S, settings).unwrap()
}

/// Closed loop on the ideal robot; returns the error after each cycle.
fn track(
    nmpc: &mut Nmpc,
    start: Configuration,
    cycles: u64,
    target: impl Fn(u64) -> Vector3<f64>,
) -> Vec<f64> {
    let robot = nmpc.robot().clone();
    let (mut at, mut rates) = (start, BendRates::zero(robot.section_count()));
    (0..cycles)
        .map(|cycle| {
            let reference = [1, 2].map(|step| inside(target(cycle + step)));
            let input = SolveInput {
                seed: cycle_seed(1, cycle),
                ..input(&at, &rates, &reference)
            };
            rates = nmpc.solve(&input, &mut Budget::unlimited()).0;
            at = at.advanced(&rates, PERIOD_S);
            (robot.tip_position(&at) - target(cycle + 1)).norm()
        })
        .collect()
}

#[test]
fn a_reachable_reference_is_met_exactly_by_every_solver() {
    for sections in 1..=6 {
        let robot = paper(sections);
        let mut bends = Configuration::straight(sections);
        bends.as_mut_slice()[2 * sections - 2] = 0.6;
        let tip = robot.tip_position(&bends);
        for (kind, bound_m) in SolverKind::ALL.into_iter().zip([1e-6, 1e-12, 1e-12]) {
            let mut nmpc = solver(&robot, kind, 2);
            let errors = track(&mut nmpc, bends, 200, |cycle| {
                let (sin, cos) = (0.5 * cycle as f64 * PERIOD_S).sin_cos();
                Vector3::new(tip.x * cos, tip.x * sin, tip.z)
            });
            let mean = errors.iter().sum::<f64>() / errors.len() as f64;
            assert!(mean < bound_m, "{kind:?}, {sections} sections: {mean} m");
        }
    }
}

#[test]
fn a_refined_plan_is_searched_around_only_where_an_error_is_left() {
    let robot = paper(3);
    let at = Configuration::from_slice(&[0.1, 0.2, -0.3, 0.1, 0.2, 0.4]).unwrap();
    let tip = robot.tip_position(&at);
    let nowhere = Vector3::new(0.0, 0.0, 2.0);
    let near = Vector3::new(1e-4, 2e-4, 1e-4);
    for (weight, beside, iterations) in [
        (0.0, near, 0),
        (1e-10, near, 0),
        (0.0, nowhere, 30),
        (1e-10, nowhere, 30),
    ] {
        let rates = BendRates::zero(3);
        let reference = [1.0, 2.0].map(|step| inside(tip + step * beside));
        let input = input(&at, &rates, &reference);
        let mut nmpc = solver(&robot, SolverKind::KpsoRefined, 2);
        let settings = NmpcSettings {
            rate_weight: weight.into(),
            ..*nmpc.settings()
        };
        nmpc.configure(settings).unwrap();
        let report = nmpc.solve(&input, &mut Budget::unlimited()).1;
        assert_eq!(report.iterations, iterations, "{report:?}");
        let rates: f64 = nmpc.plan().iter().map(|rate| rate * rate).sum();
        let error = report.cost - weight * rates;
        assert_eq!(error < 1e-12, iterations == 0, "{error} {report:?}");
    }
}

#[test]
fn the_straight_robot_leaves_its_singular_shape() {
    // Eq. 9: the line starts where the robot cannot move its tip along its own axis.
    let robot = paper(3);
    let mut nmpc = solver(&robot, SolverKind::KpsoRefined, 2);
    let errors = track(&mut nmpc, Configuration::straight(3), 400, |cycle| {
        let t = cycle as f64 * PERIOD_S;
        Vector3::new(0.03 * t, 0.0, 0.9 - 0.01 * t)
    });
    let late = errors[300..]
        .iter()
        .fold(0.0_f64, |most, error| most.max(*error));
    assert!(late < 1e-9, "{late} m after 1.5 s");
}

#[test]
fn a_jump_and_an_unreachable_reference_are_approached_at_full_rate() {
    let robot = paper(2);
    for target in [Vector3::new(0.2, 0.1, 0.45), Vector3::new(0.0, 2.0, 0.0)] {
        let mut nmpc = solver(&robot, SolverKind::KpsoRefined, 2);
        let start = Configuration::from_slice(&[0.1, 0.0, 0.0, 0.1]).unwrap();
        let errors = track(&mut nmpc, start, 200, |_| target);
        assert!(errors.iter().all(|error| error.is_finite()));
        assert!(
            errors[100] < 0.8 * errors[0],
            "{} then {}",
            errors[0],
            errors[100]
        );
    }
}

#[test]
fn without_a_finite_problem_the_rates_are_zero_and_the_status_reports_it() {
    let robot = paper(1);
    for kind in SolverKind::ALL {
        let mut nmpc = solver(&robot, kind, 2);
        let nowhere = Configuration::from_slice(&[f64::NAN, 0.0]).unwrap();
        let (rest, goal) = (BendRates::zero(1), [inside(Vector3::new(0.0, 0.0, 0.3))]);
        let input = input(&nowhere, &rest, &goal);
        let (rates, report) = nmpc.solve(&input, &mut Budget::unlimited());
        assert_eq!(
            (rates, report.status),
            (BendRates::zero(1), SolveStatus::NonFinite)
        );
        // The next solve is not affected.
        let at = Configuration::from_slice(&[0.1, 0.0]).unwrap();
        let input = SolveInput {
            configuration: &at,
            ..input
        };
        assert!(
            nmpc.solve(&input, &mut Budget::unlimited())
                .1
                .cost
                .is_finite()
        );
    }
}

/// With the tip measured beside the model's, the plan keeps that much more distance.
#[test]
fn a_plan_keeps_the_offset_of_the_tip_as_distance() {
    let robot = paper(3);
    let at = Configuration::from_slice(&[0.3, 0.0, 0.2, 0.0, 0.3, 0.0]).unwrap();
    let tip_m = robot.tip_position(&at);
    let centre_m = tip_m + Vector3::new(0.05, 0.0, -0.02);
    let ball = [Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap()];
    let goal = [inside(tip_m + Vector3::new(0.01, 0.0, 0.0)); 2];
    let rest = BendRates::zero(3);
    for kind in SolverKind::ALL {
        let nearness_m = [0.0, 0.03].map(|tip_offset_m| {
            let input = SolveInput {
                obstacles: &ball,
                tip_offset_m,
                ..input(&at, &rest, &goal)
            };
            let mut nmpc = solver(&robot, kind, 2);
            let (rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
            robot.clearance_m(&at.advanced(&rates, PERIOD_S), &ball[0])
        });
        assert!(
            nearness_m[1] > nearness_m[0] + 1e-6,
            "{kind:?}: {nearness_m:?}"
        );
    }
}

#[test]
fn a_state_of_another_robot_gives_zero_rates() {
    let robot = paper(2);
    let bent = Configuration::from_bend_angles(&[[0.3, 0.1], [-0.2, 0.4]]);
    let goal = [inside(robot.tip_position(&bent))];
    for kind in SolverKind::ALL {
        for counts in [[1, 2], [3, 2], [2, 1], [2, 6]] {
            let mut nmpc = solver(&robot, kind, 2);
            let (at, rates) = (
                Configuration::straight(counts[0]),
                BendRates::zero(counts[1]),
            );
            let input = input(&at, &rates, &goal);
            let (rates, report) = nmpc.solve(&input, &mut Budget::unlimited());
            assert_eq!(rates, BendRates::zero(2), "{counts:?}");
            assert_eq!(report.status, SolveStatus::Idle);
        }
    }
}

#[test]
fn a_period_that_is_none_is_refused() {
    for period_s in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
        let error = Nmpc::new(paper(1), period_s, NmpcSettings::default());
        assert_eq!(error.map(drop).expect_err("no period").key, "period_s");
    }
}

#[test]
fn without_a_reference_the_rates_are_zero() {
    let robot = paper(1);
    let mut nmpc = solver(&robot, SolverKind::KpsoRefined, 2);
    let (at, rest) = (Configuration::straight(1), BendRates::zero(1));
    let input = input(&at, &rest, &[]);
    // The earlier plan is ignored.
    let goal = [inside(Vector3::new(0.1, 0.0, 0.25))];
    let tracking = SolveInput {
        reference: &goal,
        ..input
    };
    let (moving, _) = nmpc.solve(&tracking, &mut Budget::unlimited());
    assert_ne!(moving, BendRates::zero(1));
    let (rates, _) = nmpc.solve(&input, &mut Budget::unlimited());
    assert_eq!(rates, BendRates::zero(1));
    assert!(nmpc.plan().iter().all(|rate| *rate == 0.0));
}

#[test]
fn the_largest_problems_look_at_their_budget_all_along() {
    // Six sections, N = 50 in M = 20 blocks, weights on rates and changes: 240 unknowns, 630 rows. In every
    // part of the solver a quantum is 1.5 nominal microseconds. So a whole solve checks the budget thousands
    // of times, and a budget of some quanta ends it with little more work than one of none.
    let robot = paper(6);
    let at = Configuration::from_slice(&[0.1; 12]).unwrap();
    let (rest, goal) = (BendRates::zero(6), [inside(Vector3::new(0.3, 0.0, 1.5))]);
    for solver in SolverKind::ALL {
        let settings = NmpcSettings {
            solver,
            horizon_steps: 50,
            control_blocks: 20,
            swarm_size: 64,
            swarm_iterations: 3,
            refinement_steps: 1,
            rate_weight: 1e-6.into(),
            rate_change_weight: 1e-6,
            ..NmpcSettings::default()
        };
        let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings).unwrap();
        let input = input(&at, &rest, &goal);
        let (_, whole) = nmpc.solve(&input, &mut Budget::unlimited());
        let least = if solver == SolverKind::Kpso {
            100
        } else {
            1000
        };
        assert!(whole.quanta > least, "{solver:?}: {} quanta", whole.quanta);
        for quanta in [0, 1, 10, whole.quanta / 2] {
            nmpc.forget_plan();
            let (_, report) = nmpc.solve(&input, &mut Budget::from_quanta(quanta));
            assert_eq!(report.quanta, quanta);
            assert!(report.cost <= report.warm_cost);
        }
    }
}

#[test]
fn a_plan_without_a_budget_is_followed_to_its_end_and_restored_likewise() {
    let robot = paper(3);
    let (at, rest) = (Configuration::straight(3), BendRates::zero(3));
    // Evaluating so many steps takes more than the first quantum.
    let goal = [ReferenceSample::at_position(Vector3::new(0.1, 0.2, 0.5)); 40];
    for (blocks, moves) in [(0, 39), (20, 1)] {
        let settings = NmpcSettings {
            horizon_steps: 40,
            control_blocks: blocks,
            ..NmpcSettings::default()
        };
        let mut nmpc = Nmpc::new(robot.clone(), PERIOD_S, settings).unwrap();
        let input = |elapsed_periods| SolveInput {
            elapsed_periods,
            ..input(&at, &rest, &goal)
        };
        nmpc.solve(&input(1), &mut Budget::unlimited());
        for starved in 0..42 {
            let (rates, _) = nmpc.solve(&input(1), &mut Budget::from_quanta(0));
            assert_eq!(rates != rest, starved < moves, "{blocks}, {starved}");
            let mut replayed = Nmpc::new(robot.clone(), PERIOD_S, settings).unwrap();
            assert!(replayed.restore_plan(nmpc.warm_plan(), 1));
            let (again, _) = replayed.solve(&input(0), &mut Budget::from_quanta(0));
            assert_eq!((again, replayed.plan()), (rates, nmpc.plan()));
        }
    }
}

#[test]
fn settings_that_are_refused_change_nothing() {
    let mut nmpc = solver(&paper(2), SolverKind::KpsoRefined, 2);
    let before = *nmpc.settings();
    let bad = NmpcSettings {
        horizon_steps: 51,
        ..before
    };
    assert!(nmpc.configure(bad).is_err());
    assert_eq!(*nmpc.settings(), before);
    assert!(!nmpc.restore_plan(&[0.0; 3], 0));
}

/// Any valid state, reference and settings.
#[derive(Debug, Clone)]
struct Case {
    robot: Robot,
    bends: Vec<f64>,
    rates: Vec<f64>,
    target: ReferenceSample,
    obstacles: Vec<Obstacle>,
    settings: NmpcSettings,
    quanta: u32,
    seed: u64,
}

/// No orientation, a required or preferred axis, or a rotation.
fn orientations() -> impl Strategy<Value = Orientation> {
    prop_oneof![
        Just(Orientation::Free),
        (any::<bool>(), prop::array::uniform3(-1.0..1.0_f64)).prop_map(|(is_required, axis)| {
            let axis = Vector3::from(axis) + Vector3::new(0.0, 0.0, 1e-3);
            let axis = Unit::new_normalize(axis);
            if is_required {
                Orientation::Axis(axis)
            } else {
                Orientation::Preferred(axis)
            }
        }),
        prop::array::uniform3(-3.0..3.0_f64).prop_map(|[a, b, c]| {
            Orientation::Full(UnitQuaternion::from_euler_angles(a, b, c))
        }),
    ]
}

/// Different sections, with limits that may be tight.
fn robots(sections: usize) -> impl Strategy<Value = Robot> {
    let section = (0.05..0.5_f64, 0.3..3.1_f64, 0.5..8.0_f64, 0.0..0.03_f64);
    let limits = (0.01..0.5_f64, 0.005..0.3_f64);
    (prop::collection::vec(section, sections), limits).prop_map(move |(drawn, limits)| {
        let mut parameters = RobotParameters::paper(sections);
        for (section, drawn) in parameters.sections.iter_mut().zip(drawn) {
            let (length_m, bend_max_rad, rate_max_rad_s, body_radius_m) = drawn;
            section.length_m = length_m;
            section.bend_max_rad = bend_max_rad;
            section.rate_max_rad_s = rate_max_rad_s;
            section.body_radius_m = body_radius_m;
        }
        (
            parameters.cable_speed_max_m_s,
            parameters.cable_stroke_max_m,
        ) = limits;
        Robot::new(&parameters).unwrap()
    })
}

/// Up to five spheres and capsules, some overlapping the body.
fn obstacle_sets() -> impl Strategy<Value = Vec<Obstacle>> {
    let point = || prop::array::uniform3(-0.8..0.8_f64).prop_map(Vector3::from);
    let shape = prop_oneof![
        point().prop_map(|centre_m| Shape::Sphere { centre_m }),
        (point(), point()).prop_map(|(start_m, end_m)| Shape::Capsule { start_m, end_m }),
    ];
    let obstacle = (shape, 0.0..0.1_f64, point())
        .prop_map(|(shape, radius_m, velocity)| Obstacle::new(shape, radius_m, velocity).unwrap());
    prop::collection::vec(obstacle, 0..5)
}

fn cases() -> impl Strategy<Value = Case> {
    let vector = |n: usize, range: std::ops::Range<f64>| prop::collection::vec(range, 2 * n);
    (1_usize..=6).prop_flat_map(move |n| {
        let settings = (
            0_usize..3,
            1_u32..=24,
            0_u32..=20,
            1_u32..=20,
            0_u32..=20,
            0.0..1e-3,
            prop::bool::ANY,
            prop_oneof![Just(0.0), 0.0..0.2_f64],
            (0_usize..3, prop_oneof![Just(1.0), 0.0..100.0_f64]),
        );
        let target = (prop::array::uniform3(-2.0..2.0), orientations());
        (
            robots(n),
            vector(n, -1.5..1.5),
            vector(n, -2.0..2.0),
            target,
            obstacle_sets(),
            settings,
            0_u32..200,
            any::<u64>(),
        )
            .prop_map(
                |(robot, bends, rates, target, obstacles, settings, quanta, seed)| {
                    let (solver, horizon_steps, blocks, swarm_size, swarm_iterations, ..) =
                        settings;
                    let (.., weight, angles, orientation_tolerance_rad, (rule, terminal_weight)) =
                        settings;
                    let settings = NmpcSettings {
                        solver: SolverKind::ALL[solver],
                        horizon_steps,
                        control_blocks: blocks.min(horizon_steps),
                        swarm_size,
                        swarm_iterations,
                        rate_weight: RateWeight::Of(weight),
                        rate_change_weight: weight,
                        posture_gain: 2.0,
                        coordinates: if angles {
                            Coordinates::BendAngles
                        } else {
                            Coordinates::BendVector
                        },
                        orientation_tolerance_rad,
                        velocity_rule: RULES[rule],
                        terminal_weight,
                        ..NmpcSettings::default()
                    };
                    Case {
                        robot,
                        bends,
                        rates,
                        target: ReferenceSample {
                            orientation: target.1,
                            ..inside(Vector3::from(target.0))
                        },
                        obstacles,
                        settings,
                        quanta,
                        seed,
                    }
                },
            )
    })
}

fn solve_case(
    case: &Case,
    quanta: u32,
) -> (BendRates, cdcr_controller::nmpc::SolveReport, Vec<u64>) {
    let mut nmpc = Nmpc::new(case.robot.clone(), PERIOD_S, case.settings).unwrap();
    let at = Configuration::from_slice(&case.bends).unwrap();
    let rates = BendRates::from_slice(&case.rates).unwrap();
    // A reference that travels has a posture.
    let next = case.target.moved(&Vector3::new(0.0, 1e-3, 0.0));
    let goal = [case.target, next];
    let input = SolveInput {
        obstacles: &case.obstacles,
        seed: case.seed,
        ..input(&at, &rates, &goal)
    };
    let (rates, report) = nmpc.solve(&input, &mut Budget::from_quanta(quanta));
    let bits = nmpc.plan().iter().map(|rate| rate.to_bits()).collect();
    (rates, report, bits)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(crate::repetitions(25, 200)))]

    #[test]
    fn the_result_is_finite_inside_the_box_and_never_worse_than_the_warm_start(case in cases()) {
        let (rates, report, _) = solve_case(&case, u32::MAX);
        let (pairs, _) = rates.as_slice().as_chunks::<2>();
        for (pair, section) in pairs.iter().zip(case.robot.sections()) {
            // With bend angles, rates are scaled to the limit, which rounds.
            let most = section.rate_max_rad_s * (1.0 + 1e-15);
            prop_assert!(pair.iter().all(|rate| rate.abs() <= most), "{pair:?} of {most}");
        }
        prop_assert!(report.cost.is_finite() && report.cost <= report.warm_cost);
    }

    #[test]
    fn more_budget_is_never_worse_and_the_work_done_repeats_the_bits(case in cases()) {
        let (_, less, bits) = solve_case(&case, case.quanta);
        let (_, more, _) = solve_case(&case, case.quanta + 50);
        prop_assert!(more.cost <= less.cost && less.cost <= less.warm_cost);
        prop_assert!(less.quanta <= case.quanta);
        let (_, again, again_bits) = solve_case(&case, less.quanta);
        prop_assert_eq!(bits, again_bits);
        prop_assert_eq!(less.evaluations, again.evaluations);
    }
}
