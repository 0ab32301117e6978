//! The linear model of a problem, compared with the problem's own cost and with finite differences.

use nalgebra::{Unit, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::*;
use crate::nmpc::obstacles::CLEARANCE;
use crate::nmpc::solver::CONSTRAINTS_MAX;
use crate::nmpc::{HORIZON_STEPS_MAX, Horizon, OBSTACLES_MAX};
use crate::optimizer::{Cost, QUANTUM_NS, VIOLATIONS};
use crate::robot::{BendRates, Obstacle, RobotParameters, Shape};
use crate::wide::{Aligned, LANES};

const PERIOD_S: f64 = 0.05;
/// Changes a bend by 5e-6 rad in a period: truncation and rounding of a central difference are both near
/// 1e-11.
const STEP_RAD_S: f64 = 1e-4;

#[derive(Debug)]
struct Case {
    settings: NmpcSettings,
    at: Configuration,
    held: BendRates,
    goal: ReferenceSample,
    plan: Vec<f64>,
}

fn orientations() -> impl Strategy<Value = Orientation> {
    let vector = || prop::array::uniform3(-1.0..1.0_f64).prop_map(Vector3::from);
    prop_oneof![
        Just(Orientation::Free),
        (any::<bool>(), vector())
            .prop_filter("a direction", |(_, axis)| axis.norm() > 0.1)
            .prop_map(|(is_required, axis)| {
                let axis = Unit::new_normalize(axis);
                if is_required {
                    Orientation::Axis(axis)
                } else {
                    Orientation::Preferred(axis)
                }
            }),
        vector().prop_map(|turn| Orientation::Full(UnitQuaternion::from_scaled_axis(turn * 3.0))),
    ]
}

fn cases() -> impl Strategy<Value = Case> {
    let settings = (
        prop_oneof![Just(Coordinates::BendVector), Just(Coordinates::BendAngles)],
        prop_oneof![Just(0.0), 1e-3..0.2_f64],
        1..=5_u32,
        0..=5_u32,
        prop_oneof![Just([0.0, 0.0]), Just([1e-3, 2e-3])],
    );
    (
        1..=3_usize,
        settings,
        orientations(),
        prop::array::uniform3(-0.3..0.3_f64),
    )
        .prop_flat_map(|(sections, settings, orientation, position)| {
            let (coordinates, orientation_tolerance_rad, horizon_steps, blocks, weights) = settings;
            let settings = NmpcSettings {
                coordinates,
                orientation_tolerance_rad,
                horizon_steps,
                control_blocks: blocks.min(horizon_steps),
                rate_weight: weights[0].into(),
                rate_change_weight: weights[1],
                posture_gain: 2.0,
                terminal_weight: 3.0,
                ..NmpcSettings::default()
            };
            let goal = ReferenceSample {
                state: ReferenceState::Inside,
                position_m: Vector3::from(position),
                orientation,
            };
            let width = 2 * sections;
            let numbers = |count: usize| prop::collection::vec(-1.2..1.2_f64, count);
            let plan = numbers(width * Horizon::new(&settings, width).blocks());
            (numbers(width), numbers(width), plan).prop_map(move |(bends, held, plan)| Case {
                settings,
                at: Configuration::from_slice(&bends).expect("one to three sections"),
                held: BendRates::from_slice(&held).expect("one to three sections"),
                goal,
                plan,
            })
        })
}

/// Calls `run` with the problem of a case, for the paper's robot.
fn with_problem<T>(case: &Case, run: impl FnOnce(&TrackingProblem) -> T) -> T {
    let parameters = RobotParameters::paper(case.at.section_count());
    with_problem_among(&[], &parameters, case, run)
}

/// The same for any robot and these obstacles.
fn with_problem_among<T>(
    around: &[Obstacle],
    parameters: &RobotParameters,
    case: &Case,
    run: impl FnOnce(&TrackingProblem) -> T,
) -> T {
    let robot = Robot::new(parameters).expect("a robot");
    let horizon = Horizon::new(&case.settings, robot.coordinate_count());
    let motion = Motion::new(
        &robot,
        PERIOD_S,
        case.settings.coordinates,
        &horizon,
        &case.at,
        &case.held,
        None,
    );
    let mut bounds = Bounds::with_capacity(case.plan.len());
    motion.set_bounds(&robot, &mut bounds);
    let fastest_rad_s = motion.fastest_rad_s(&bounds);
    let limits = PlanLimits::new(&robot, &motion, 1.0, &fastest_rad_s);
    let mut obstacles = Obstacles::with_capacity();
    let safe_m = case.settings.safe_distance_m;
    let budget = &mut Budget::unlimited();
    // A reference at 0.2 m/s, so that the posture has rates.
    let next = case.goal.moved(&Vector3::new(0.0, 0.01, 0.0));
    obstacles.cull(&robot, &motion, around, safe_m, &fastest_rad_s, budget);
    run(&TrackingProblem::new(
        &robot,
        &case.settings,
        &motion,
        &limits,
        &obstacles,
        &bounds,
        (&case.held, &[case.goal, next]),
    ))
}

fn linearised(problem: &TrackingProblem, plan: &[f64]) -> LinearModel {
    let rows = 12 * HORIZON_STEPS_MAX + 2 * plan.len();
    let mut model = LinearModel::with_capacity(rows, CONSTRAINTS_MAX, plan.len(), plan.len());
    model.clear(problem.stages(), false);
    let budget = &mut Budget::unlimited();
    assert!(problem.linearise(plan, &mut model, budget));
    assert!(problem.constrain(plan, None, &mut model, budget));
    model
}

proptest! {
    #[test]
    fn residuals_sum_to_the_cost_and_every_derivative_is_the_difference(case in cases()) {
        with_problem(&case, |problem| {
            let model = linearised(problem, &case.plan);
            let residuals = (0..model.rows()).map(|row| model.residual(row));
            let posture = problem.posture[..problem.width()].iter().cycle();
            let rates: f64 = case.plan.iter().zip(posture).map(|(rate, posture)| (rate - posture) * (rate - posture)).sum();
            let rates = f64::from(case.settings.rate_weight) * rates;
            let sum = rates + residuals.map(|residual| residual * residual).sum::<f64>();
            let evaluation = problem.evaluate_at(&case.plan, &mut Budget::unlimited());
            let cost = evaluation.expect("an unlimited budget").cost.0[0];
            prop_assert!((sum - cost).abs() <= 1e-12 * cost, "{sum} {cost}");
            prop_assert_eq!(problem.evaluate_below(&case.plan, cost, &mut Budget::unlimited()), evaluation);
            let more = problem.evaluate_below(&case.plan, 0.5 * cost, &mut Budget::unlimited());
            prop_assert!(more.expect("an unlimited budget").cost.0[0] >= 0.5 * cost);
            if problem.rounding().is_some() {
                let mut alone = vec![f64::NAN; model.rows()];
                let again = problem.evaluate_residuals(&case.plan, &mut alone, &mut Budget::unlimited());
                prop_assert_eq!(again, evaluation);
                for (row, alone) in alone.iter().enumerate() {
                    prop_assert!((alone - model.residual(row)).abs() < 1e-14);
                }
            }
            for i in 0..case.plan.len() {
                let [behind, ahead] = [-STEP_RAD_S, STEP_RAD_S].map(|step| {
                    let mut plan = case.plan.clone();
                    plan[i] += step;
                    linearised(problem, &plan)
                });
                // An orientation error at the edge of the tolerance has no derivative.
                prop_assume!([behind.rows(), ahead.rows()] == [model.rows(); 2]);
                for row in 0..model.rows() {
                    let difference = (ahead.residual(row) - behind.residual(row)) / (2.0 * STEP_RAD_S);
                    let derivative = model.row(row)[i];
                    prop_assert!((derivative - difference).abs() < 1e-8, "row {row}, control {i}: {derivative} {difference}");
                }
            }
            Ok(())
        })?;
    }
}

proptest! {
    /// A plan that the budget interrupts keeps what was evaluated, and rests after it.
    #[test]
    fn a_budget_that_ends_leaves_the_plan_up_to_there(case in cases(), left_ns in 1..200_u32) {
        with_problem(&case, |problem| {
            let mut budget = Budget::from_quanta(0);
            budget.spend(QUANTUM_NS - left_ns);
            let mut plan = case.plan.clone();
            problem.bounds.project(&mut plan);
            let mut z = plan.clone();
            let mut incumbent = Incumbent::with_capacity(z.len());
            incumbent.restart(&z, None);
            let found = problem.evaluate_until_violation(&mut z, &incumbent, &mut [], &mut budget);
            let Some((evaluation, is_whole)) = found else {
                prop_assert!(budget.is_spent());
                return Ok(());
            };
            let unlimited = &mut Budget::unlimited();
            prop_assert_eq!(Some(evaluation), problem.evaluate_at(&z, unlimited));
            let kept = z.iter().zip(&plan).take_while(|(z, plan)| z == plan).count();
            prop_assert!(z[kept..].iter().all(|rate| *rate == 0.0));
            prop_assert_eq!(is_whole, kept == plan.len());
            if problem.is_free() {
                prop_assert_eq!(is_whole, !budget.is_spent());
            }
            Ok(())
        })?;
    }
}

/// Variation of the drawn plan in each of eight lanes.
const SHARES: [f64; LANES] = [1.0, 0.0, -1.0, 0.5, 1e-3, -0.25, 0.9, 0.1];

/// Balls and capsules beside the start, some overlapping it, moving or at rest: section, share of its length,
/// offset (m), velocity (m/s).
fn beside(case: &Case, places: &[(usize, f64, [f64; 3], [f64; 3])]) -> Vec<Obstacle> {
    let robot = Robot::new(&RobotParameters::paper(case.at.section_count())).expect("the paper's");
    let place = |(i, (section, s, offset_m, velocity_m_s)): (usize, &(usize, f64, [f64; 3], _))| {
        let body_m = robot.body_point(&case.at, section % case.at.section_count(), *s);
        let start_m = body_m + Vector3::from(*offset_m);
        let end_m = start_m + Vector3::new(0.02, -0.03, 0.04);
        let shape = match i % 2 {
            0 => Shape::Sphere { centre_m: start_m },
            _ => Shape::Capsule { start_m, end_m },
        };
        let moves = f64::from(u8::from(i % 3 == 0));
        Obstacle::new(shape, 0.01, moves * Vector3::from(*velocity_m_s)).expect("an obstacle")
    };
    places.iter().enumerate().map(place).collect()
}

/// Plans side by side, as in the swarm.
fn evaluated<const W: usize>(
    problem: &TrackingProblem,
    plans: impl Fn(usize) -> Wide<W>,
) -> Evaluation<W> {
    let budget = &mut Budget::unlimited();
    let bends = &mut [Aligned(Wide::splat(0.0)); COORDINATES_MAX];
    let found = match problem.motion.coordinates() {
        Coordinates::BendVector => match PositionOnly::new(problem) {
            Some(position_only) => position_only.evaluate(plans, bends, budget, pulp::Scalar),
            None => SwarmCost::<VECTORS>::new(problem).evaluate(plans, bends, budget, pulp::Scalar),
        },
        Coordinates::BendAngles => {
            SwarmCost::<ANGLES>::new(problem).evaluate(plans, bends, budget, pulp::Scalar)
        }
    };
    found.expect("an unlimited budget")
}

proptest! {
    #[test]
    fn what_is_culled_costs_nothing(
        case in cases(),
        places in prop::collection::vec(
            (0..3_usize, 0.0..1.0_f64, prop::array::uniform3(-0.2..0.2_f64), prop::array::uniform3(-1.0..1.0_f64)), 6,
        ),
        bad_lane in 0..LANES,
    ) {
        let around = beside(&case, &places);
        let parameters = RobotParameters::paper(case.at.section_count());
        let share = |i: usize, lane: usize| SHARES[lane] * case.plan[i];
        let plans = |i: usize| Wide::<LANES>::from_fn(|lane| share(i, lane));
        let free = with_problem(&case, |problem| evaluated(problem, plans));
        with_problem_among(&around, &parameters, &case, |problem| {
            let found = evaluated(problem, plans);
            // A lane that is not finite has a cost that is not finite, and changes no other lane.
            let bad = evaluated::<LANES>(problem, |i| {
                Wide::from_fn(|lane| if lane == bad_lane { f64::NAN } else { share(i, lane) })
            });
            for lane in 0..LANES {
                let plan: Vec<f64> = (0..case.plan.len()).map(|i| share(i, lane)).collect();
                let exact = problem.evaluate_at(&plan, &mut Budget::unlimited()).expect("no end");
                let alone = evaluated(problem, |i| Wide([plan[i]]));
                let [cost, bad, alone] = [found.cost.0[lane], bad.cost.0[lane], alone.cost.0[0]];
                prop_assert_eq!(cost.to_bits(), alone.to_bits());
                prop_assert!((cost - exact.cost.0[0]).abs() <= 1e-14 * (1.0 + cost));
                let stays = if lane == bad_lane { bad.is_nan() } else { bad.to_bits() == cost.to_bits() };
                prop_assert!(stays, "lane {lane}: {cost}, {bad} beside NaN in lane {bad_lane}");

                // Every section against every obstacle at every step.
                let (mut penalty, mut deepest_m, mut bends) = (0.0, 0.0, problem.motion.start());
                for step in 0..problem.steps() {
                    problem.motion.advance_one(&mut bends, &plan, step);
                    let body = problem.robot.body(&problem.motion.shape(&bends));
                    for obstacle in &around {
                        let obstacle = obstacle.moved(PERIOD_S * (step + 1) as f64);
                        for section in 0..case.at.section_count() {
                            let depth_m = case.settings.safe_distance_m - body.clearance_of(section, &obstacle);
                            prop_assume!(depth_m.abs() > 1e-9);
                            if depth_m > 0.0 {
                                penalty += case.settings.obstacle_step_penalty
                                    + depth_m * case.settings.obstacle_slope_penalty
                                    + depth_m * depth_m * case.settings.obstacle_square_penalty;
                                deepest_m = f64::max(deepest_m, depth_m);
                            }
                        }
                    }
                }
                let expected = free.cost.0[lane] + penalty;
                prop_assert!((cost - expected).abs() <= 1e-9 * expected, "lane {lane}: {cost} {expected}");
                prop_assert!((found.violations[CLEARANCE].0[lane] - deepest_m).abs() < 1e-9);
            }
            Ok(())
        })?;
    }
}

/// Six sections, bent.
fn long(horizon_steps: u32, plan: Vec<f64>) -> Case {
    let at = [0.4, 0.3].repeat(6);
    Case {
        settings: NmpcSettings {
            horizon_steps,
            ..NmpcSettings::default()
        },
        at: Configuration::from_slice(&at).expect("six sections"),
        held: BendRates::zero(6),
        goal: ReferenceSample {
            state: ReferenceState::Inside,
            position_m: Vector3::new(0.1, 0.2, 1.0),
            orientation: Orientation::Free,
        },
        plan,
    }
}

/// Values of the violated constraints.
fn met(around: &[Obstacle], parameters: &RobotParameters, case: &Case, step: &[f64]) -> Vec<f64> {
    with_problem_among(around, parameters, case, |problem| {
        let mut model = linearised(problem, &case.plan);
        let cost_rows = model.rows();
        model.activate_violated(step, &mut Budget::unlimited());
        (cost_rows..model.rows())
            .map(|row| model.residual(row))
            .collect()
    })
}

/// The paper's robot with six sections, one cable of which has no stroke left, and the largest number of
/// obstacles at this distance (m).
fn crowd(case: &Case, beside_m: impl Fn(usize) -> f64) -> (RobotParameters, Vec<Obstacle>) {
    let mut parameters = RobotParameters::paper(6);
    let robot = Robot::new(&parameters).expect("the paper's");
    let strokes_m = robot.cable_strokes(&case.at);
    parameters.cable_stroke_max_m = strokes_m.iter().fold(0.0, |most, m| m.abs().max(most));
    let around: Vec<Obstacle> = (0..OBSTACLES_MAX)
        .map(|i| {
            let body_m = robot.body_point(&case.at, i % 6, 0.3 + 0.01 * i as f64);
            // Normal to the plane of the bend.
            let centre_m = body_m + Vector3::new(-0.6, 0.8, 0.0) * beside_m(i);
            Obstacle::new(Shape::Sphere { centre_m }, 0.01, Vector3::zeros()).expect("a ball")
        })
        .collect();
    (parameters, around)
}

/// Each obstacle is within reach of each section at each step.
#[test]
fn obstacles_leave_room_for_every_limit() {
    let case = long(5, [2.0, -2.0].repeat(30));
    let (parameters, around) = crowd(&case, |_| 0.05);
    let met = |around: &[Obstacle]| met(around, &parameters, &case, &case.plan);
    let (limits, all) = (met(&[]), met(&around));
    assert!(limits.len() > 20, "{}", limits.len());
    let left_out = limits.iter().filter(|limit| !all.contains(limit)).count();
    assert_eq!(left_out, 0, "of {} limits", limits.len());
    assert!(all.len() > limits.len(), "obstacles are met, too");
}

/// There are more limits than places for constraints in a step.
#[test]
fn limits_leave_room_for_the_nearest_clearances() {
    let case = long(50, vec![0.0; 300]);
    // Only the first obstacle is nearer than the safe distance, beside the first section.
    let (parameters, around) = crowd(&case, |i| if i == 0 { 0.02 } else { 0.15 });
    let robot = Robot::new(&parameters).expect("a robot");
    let body = robot.body(&case.at);
    let safe_m = case.settings.safe_distance_m;
    let near = |o: &&Obstacle| body.clearance_m(o) < safe_m;
    assert_eq!(around.iter().filter(near).count(), 1);
    // At rest, a zero step violates only constraints that are already violated.
    let all = met(&around, &parameters, &case, &case.plan);
    let depth_m = body.clearance_of(0, &around[0]) - safe_m - 1e-6;
    let is_nearest = |h: &&f64| (**h - 1e3 * depth_m).abs() < 1e-9;
    assert_eq!(all.iter().filter(is_nearest).count(), 50, "{all:?}");
}

#[test]
fn steps_without_rows_are_announced() {
    let sections = 6;
    let case = Case {
        settings: NmpcSettings {
            horizon_steps: 20,
            ..NmpcSettings::default()
        },
        at: Configuration::straight(sections),
        held: BendRates::zero(sections),
        goal: ReferenceSample::default(),
        plan: vec![0.0; 20 * 2 * sections],
    };
    let parameters = RobotParameters::paper(sections);
    let tip_m = Robot::new(&parameters).unwrap().tip_position(&case.at);
    let centre_m = tip_m + Vector3::new(0.2, 0.0, 0.0);
    let ball = Obstacle::new(Shape::Sphere { centre_m }, 0.01, Vector3::zeros()).unwrap();
    with_problem_among(&[ball], &parameters, &case, |problem| {
        assert!(problem.is_staged() && problem.obstacles.any_reachable());
        let constrained = |quanta: u32| {
            let mut model =
                LinearModel::with_capacity(0, CONSTRAINTS_MAX, case.plan.len(), case.plan.len());
            model.clear(problem.stages(), true);
            let reach = Reach {
                step: &vec![1e-6; case.plan.len()],
                times: 1.0,
                violations: [0.0; VIOLATIONS],
            };
            let budget = &mut Budget::from_quanta(quanta);
            let is_left = problem.constrain(&case.plan, Some(reach), &mut model, budget);
            let met = model.activate_violated(&case.plan, &mut Budget::unlimited());
            (is_left, met)
        };
        assert_eq!(constrained(0), (false, None));
        assert_eq!(constrained(9), (true, None));
    });
}

proptest! {
    /// Staged rows equal dense rows, with a derivative for each block that shares it.
    #[test]
    fn staged_rows_say_what_all_derivatives_say(
        case in cases(),
        places in prop::collection::vec(
            (0..3_usize, 0.0..1.0_f64, prop::array::uniform3(-0.1..0.1_f64), prop::array::uniform3(-1.0..1.0_f64)), 3,
        ),
    ) {
        prop_assume!(case.settings.rate_change_weight == 0.0);
        let around = beside(&case, &places);
        let mut parameters = RobotParameters::paper(case.at.section_count());
        parameters.cable_stroke_max_m = 0.01;
        parameters.cable_speed_max_m_s = 0.02;
        with_problem_among(&around, &parameters, &case, |problem| {
            let step: Vec<f64> = case.plan.iter().map(|z| -1.7 * z).collect();
            let mut models = [false, true].map(|is_staged| {
                let mut model = LinearModel::with_capacity(12 * HORIZON_STEPS_MAX + 2 * case.plan.len(), CONSTRAINTS_MAX, case.plan.len(), case.plan.len());
                model.clear(problem.stages(), is_staged);
                let budget = &mut Budget::unlimited();
                assert!(problem.linearise(&case.plan, &mut model, budget));
                let reach = Reach { step: &step, times: 2.0, violations: [0.0; VIOLATIONS] };
                assert!(problem.constrain(&case.plan, is_staged.then_some(reach), &mut model, budget));
                let mut gradient = vec![0.0; case.plan.len()];
                let scale = model.gradient(&mut gradient, &mut Budget::unlimited());
                (model, gradient, scale.expect("no end"))
            });
            let [(_, dense, dense_scale), (_, staged, staged_scale)] = &models;
            prop_assert!((dense_scale - staged_scale).abs() <= 1e-12 * dense_scale);
            for (dense, staged) in dense.iter().zip(staged) {
                prop_assert!((dense - staged).abs() <= 1e-12 * dense_scale, "{dense} {staged}");
            }
            // Both violate the same constraints, also if only constraints within reach of a step of this size
            // are requested.
            let met = models.each_mut().map(|(model, ..)| {
                let _ = model.activate_violated(&step, &mut Budget::unlimited());
                let cost_rows = model.cost_rows();
                (cost_rows..model.rows()).map(|row| model.residual(row)).collect::<Vec<_>>()
            });
            prop_assert_eq!(&met[0], &met[1]);
            Ok(())
        })?;
    }
}
