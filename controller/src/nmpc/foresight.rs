//! Choice among plans of zero cost. On a long horizon many plans follow the reference exactly. A second solve
//! over a longer horizon, with an extrapolated reference, selects the one that can be continued best. Near
//! limits of rates or constraints, this decides whether the robot can follow a later curve.

use nalgebra::Vector3;

use super::reachable::{Reachable, SolveContext};
use super::solver::{SolveTask, Solver};
use super::{HORIZON_STEPS_MAX, Horizon, NmpcSettings, PLAN_MAX, SolveReport, SolveStatus};
use crate::optimizer::{Budget, GaussNewtonOutcome, GaussNewtonSettings, Incumbent, Problem};
use crate::reference::{Orientation, ReferenceSample, ReferenceState};

/// Additional steps beyond the horizon, as a share of it.
const SHARE: f64 = 0.4;
/// Shortest horizon with foresight. With 5 to 10 steps, the few additional steps make the result worse; with
/// 16 they improve it (`cdcr-bench quality`: gap and crossing).
const HORIZON_MIN: usize = 16;
/// Largest number of Gauss-Newton steps on the longer horizon: among obstacles each takes as long as a solve.
const STEPS_MAX: u32 = 2;
/// Costs below this share of the cost of a small error count as zero: 1 nm of position error.
const EQUAL_SHARE: f64 = 1e-6;
/// Largest distance of the last sample from the cubic through the four samples before it, as a share of the
/// last step. The reference is extrapolated only below it. After eight extrapolated steps the error has grown
/// to about one step.
const SMOOTH_SHARE: f64 = 0.003;
/// A rate within this share of the box's width from a bound counts as at the bound.
const BOUND_SHARE: f64 = 1e-3;

/// A longer horizon with its own box, obstacles and limits.
#[derive(Debug)]
pub(super) struct Foresight {
    horizon: Option<Horizon>,
    reachable: Reachable,
    reference: Vec<ReferenceSample>,
}

impl Foresight {
    pub(super) fn with_capacity(unknowns: usize) -> Self {
        Self {
            horizon: None,
            reachable: Reachable::with_capacity(unknowns),
            reference: Vec::with_capacity(HORIZON_STEPS_MAX),
        }
    }

    /// Sets up the longer horizon. There is none if the horizon is shorter than [`HORIZON_MIN`], a block has
    /// several steps, the change of rates has a weight, or the plan cannot be longer.
    pub(super) fn configure(&mut self, settings: &NmpcSettings, horizon: &Horizon, width: usize) {
        let steps = horizon.steps();
        let most = HORIZON_STEPS_MAX.min(PLAN_MAX / width.max(1));
        let longer = most.min(steps + (SHARE * steps as f64) as usize);
        let is_free = horizon.blocks() == steps && settings.rate_change_weight == 0.0;
        self.horizon = (is_free && steps >= HORIZON_MIN && longer > steps).then(|| {
            let settings = NmpcSettings {
                horizon_steps: longer as u32,
                control_blocks: 0,
                ..*settings
            };
            Horizon::new(&settings, width)
        });
    }

    /// Replaces the incumbent by a plan of equal cost that is better over the longer horizon, if one is
    /// found.
    pub(super) fn improve(
        &mut self,
        solver: &mut Solver,
        task: &SolveTask,
        context: &SolveContext,
        budget: &mut Budget<'_>,
        report: &mut SolveReport,
    ) {
        let Some(horizon) = &self.horizon else {
            return;
        };
        let (known, longer) = (task.problem.steps(), horizon.steps());
        if !solver.has_plans_of_equal_cost(task) {
            return;
        }
        if !budget.begin_quantum() {
            report.budget_spent = budget.is_whole_spent();
            return;
        }
        if !extrapolate_reference(context.input.reference, known, longer, &mut self.reference) {
            return;
        }
        let motion = context.motion(horizon);
        let limits = self.reachable.update(context, &motion, budget);
        let problem = context.problem(&motion, &limits, &self.reachable, &self.reference);
        let longer = SolveTask {
            problem: &problem,
            bounds: &self.reachable.bounds,
            ..*task
        };
        solver.improve_if_restricted(task, &longer, budget, report);
    }
}

/// Writes the first `steps` samples and extrapolates them to `longer` samples. False: there are too few
/// samples, or the last five are not smooth, not inside the reference, or have an orientation.
fn extrapolate_reference(
    samples: &[ReferenceSample],
    steps: usize,
    longer: usize,
    into: &mut Vec<ReferenceSample>,
) -> bool {
    let Some(known) = samples.get(..steps) else {
        return false;
    };
    let [.., e, d, c, b, a] = known else {
        return false;
    };
    let last = [e, d, c, b, a];
    let is_usable = |sample: &&ReferenceSample| {
        sample.state == ReferenceState::Inside && sample.orientation == Orientation::Free
    };
    let [e, d, c, b, a] = last.map(|sample| sample.position_m);
    let next = |[d, c, b, a]: [Vector3<f64>; 4]| 4.0 * (a + c) - 6.0 * b - d;
    let beside_m = (next([e, d, c, b]) - a).norm();
    if !last.iter().all(is_usable) || beside_m > SMOOTH_SHARE * (a - b).norm() {
        return false;
    }
    into.clear();
    into.extend_from_slice(known);
    let mut last = [d, c, b, a];
    for _ in steps..longer {
        let ahead = next(last);
        last = [last[1], last[2], last[3], ahead];
        into.push(ReferenceSample::at_position(ahead));
    }
    true
}

impl Solver {
    /// Whether other plans may have the same cost, and a constraint or a rate limit restricts the choice.
    fn has_plans_of_equal_cost(&self, task: &SolveTask) -> bool {
        task.settings.solver.refines()
            && task.problem.is_staged()
            && !task.problem.is_regularised()
            && !self.incumbent.is_violated()
            && !self.has_tracking_error(task)
            && (!task.problem.is_free() || self.is_at_bound(task))
    }

    fn is_at_bound(&self, task: &SolveTask) -> bool {
        let intervals = task.bounds.lower().iter().zip(task.bounds.upper());
        let mut rates = self.incumbent.z().iter().zip(intervals);
        rates.any(|(rate, (lower, upper))| {
            let near = BOUND_SHARE * (upper - lower);
            rate - lower <= near || upper - rate <= near
        })
    }

    /// Calls [`Self::refine_over_longer_horizon`] if the plan extended to the longer horizon violates a constraint, or a rate
    /// of the incumbent is at a bound.
    fn improve_if_restricted(
        &mut self,
        task: &SolveTask,
        longer: &SolveTask,
        budget: &mut Budget<'_>,
        report: &mut SolveReport,
    ) {
        let (own, all) = (task.problem.dimension(), longer.problem.dimension());
        let plan = &mut self.scratch;
        plan.clear();
        plan.extend_from_slice(self.incumbent.z());
        for i in own..all {
            plan.push(plan[i - task.problem.motion.width()]);
        }
        longer.bounds.project(plan);
        restart(&mut self.alternative, longer, plan, budget);
        // Rates inside the box and without a violation can be continued unchanged.
        if self.alternative.is_violated() || self.is_at_bound(task) {
            self.refine_over_longer_horizon(task, longer, budget, report);
        } else {
            self.incumbent
                .count_evaluations(self.alternative.evaluations() as usize);
        }
        report.quanta = budget.quanta();
        report.budget_spent = budget.is_whole_spent();
        report.evaluations = self.incumbent.evaluations();
    }

    /// Refines the plan over the longer horizon, then its first part over the horizon of the task. The result
    /// replaces the incumbent if it violates no constraint and costs no more, or next to nothing. It never
    /// costs more than the warm start.
    fn refine_over_longer_horizon(
        &mut self,
        task: &SolveTask,
        longer: &SolveTask,
        budget: &mut Budget<'_>,
        report: &mut SolveReport,
    ) {
        let settings = task.settings.gauss_newton();
        let (gauss_newton, alternative) = (&mut self.gauss_newton, &mut self.alternative);
        let each = GaussNewtonSettings {
            steps: 1,
            ..settings
        };
        for _ in 0..STEPS_MAX.min(settings.steps) {
            let before = alternative.cost();
            if before <= task.settings.small_cost() {
                break;
            }
            gauss_newton.refine(longer.problem, longer.bounds, &each, budget, alternative);
            if alternative.cost() >= before {
                break;
            }
        }
        self.incumbent
            .count_evaluations(alternative.evaluations() as usize);
        self.scratch.clear();
        self.scratch
            .extend_from_slice(&alternative.z()[..task.problem.dimension()]);
        restart(alternative, task, &self.scratch, budget);
        let mut refinement = GaussNewtonOutcome::default();
        for _ in 0..settings.steps {
            let before = alternative.cost();
            if before > task.settings.cost_tolerance() {
                refinement =
                    gauss_newton.refine(task.problem, task.bounds, &each, budget, alternative);
            }
            if alternative.cost() >= before {
                break;
            }
        }
        self.incumbent
            .count_evaluations(alternative.evaluations() as usize);
        let equal = EQUAL_SHARE * task.settings.small_cost();
        let most = f64::max(self.incumbent.cost(), equal);
        if alternative.cost() <= f64::min(most, report.warm_cost) && !alternative.is_violated() {
            self.incumbent.replace(alternative);
            report.cost = alternative.cost();
            report.gradient_norm = refinement.gradient_norm;
            report.status = SolveStatus::from_incumbent(
                &self.incumbent,
                task.settings,
                &refinement,
                budget.is_whole_spent(),
            );
        }
    }
}

/// Evaluates a plan and makes it the incumbent.
fn restart(incumbent: &mut Incumbent, task: &SolveTask, plan: &[f64], budget: &mut Budget<'_>) {
    let evaluation = task.problem.evaluate_at(plan, budget);
    incumbent.restart(plan, evaluation.as_ref());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nmpc::{Nmpc, SolveInput, SolverKind};
    use crate::robot::{BendRates, Configuration, Obstacle, Robot, RobotParameters, Shape};

    fn curve(of: impl Fn(f64) -> Vector3<f64>) -> Vec<ReferenceSample> {
        (0..30)
            .map(|k| ReferenceSample::at_position(of(f64::from(k))))
            .collect()
    }

    /// Distance of the last extrapolated sample from the curve; `None`: not extrapolated.
    fn beside_m(samples: &[ReferenceSample]) -> Option<f64> {
        let mut into = Vec::new();
        let is_known = extrapolate_reference(&samples[..20], 20, 28, &mut into);
        assert!(!is_known || into[..20] == samples[..20]);
        is_known.then(|| (into[27].position_m - samples[27].position_m).norm())
    }

    #[test]
    fn a_smooth_curve_goes_on_and_another_is_not_guessed() {
        let circle = |k: f64| Vector3::new((0.05 * k).cos(), (0.05 * k).sin(), 0.0);
        let beside = beside_m(&curve(circle)).expect("smooth");
        assert!(beside < 0.05, "{beside}");
        let cubic = |k: f64| Vector3::new(k, 0.01 * k * k, -0.001 * k * k * k);
        assert!(beside_m(&curve(cubic)).expect("smooth") < 1e-9);
        assert_eq!(beside_m(&curve(|_| Vector3::x())), Some(0.0));
        for corner in [16.0, 17.0, 18.0] {
            let turn = |k: f64| Vector3::new(corner - (k - corner).abs(), 0.0, 0.0);
            assert_eq!(beside_m(&curve(turn)), None, "{corner}");
        }
        let mut ended = curve(circle);
        ended[18].state = ReferenceState::Ended;
        assert_eq!(beside_m(&ended), None);
        let short = &curve(circle)[..19];
        assert!(!extrapolate_reference(short, 20, 28, &mut Vec::new()));
    }

    #[test]
    fn short_horizons_and_held_rates_have_none() {
        let foreseen = |horizon_steps, control_blocks| {
            let settings = NmpcSettings {
                horizon_steps,
                control_blocks,
                ..NmpcSettings::default()
            };
            let mut foresight = Foresight::with_capacity(0);
            foresight.configure(&settings, &Horizon::new(&settings, 6), 6);
            foresight.horizon.map(|horizon| horizon.steps())
        };
        let steps = [2, 15, 20, 35, 40, 50].map(|steps| foreseen(steps, 0));
        assert_eq!(steps, [None, None, Some(28), Some(49), Some(50), None]);
        assert_eq!(foreseen(20, 10), None);
    }

    /// The paper's spiral at ten times its speed.
    fn spiral_m(step: u32) -> Vector3<f64> {
        let t = 5.0_f64.to_radians() + 0.05 * f64::from(step);
        let (sin_part, cos_part) = (t / 15.0).sin_cos();
        let h = 4.5 * sin_part / t;
        Vector3::new(
            h * sin_part * t.cos(),
            h * sin_part * t.sin(),
            0.6 + h * cos_part,
        )
    }

    /// Balls around the base of the last section.
    fn balls(apart_m: f64) -> Vec<Obstacle> {
        let ball = |i: u32| {
            let (sin, cos) = (2.4 * f64::from(i)).sin_cos();
            let up_m = 0.615 + 0.06 * f64::from(i) / 16.0;
            let centre_m = Vector3::new(apart_m * cos, apart_m * sin, up_m);
            Obstacle::new(Shape::Sphere { centre_m }, 0.01, Vector3::zeros()).expect("a ball")
        };
        (0..16).map(ball).collect()
    }

    /// From the same state and warm start, the plan with foresight costs no more than the plan without.
    #[test]
    fn a_plan_that_leads_on_better_costs_no_more() {
        let robot = Robot::new(&RobotParameters::paper(3)).expect("a robot");
        let direction = 5.0_f64.to_radians();
        let mut at = Configuration::from_bend_angles(&[
            [0.0; 2],
            [0.0; 2],
            [2.0 * direction / 15.0, direction],
        ]);
        let mut rates = BendRates::zero(3);
        let settings = NmpcSettings {
            solver: SolverKind::GaussNewton,
            horizon_steps: 20,
            ..NmpcSettings::default()
        };
        let apart_m = robot.sections()[2].body_radius_m + settings.safe_distance_m + 0.026;
        let balls = balls(apart_m);
        let mut nmpc = Nmpc::new(robot, 0.005, settings).expect("settings");
        let mut others = 0;
        for cycle in 0..70 {
            let steps = cycle + 1..=cycle + 20;
            let reference: Vec<_> = steps
                .map(|k| ReferenceSample::at_position(spiral_m(k)))
                .collect();
            let input = SolveInput {
                configuration: &at,
                previous_rates: &rates,
                reference: &reference,
                obstacles: &balls,
                tip_offset_m: 0.0,
                elapsed_periods: 1,
                seed: 1,
            };
            let mut blind = nmpc.clone();
            blind.foresight.horizon = None;
            let (_, without) = blind.solve(&input, &mut Budget::unlimited());
            let (command, report) = nmpc.solve(&input, &mut Budget::unlimited());
            let most = f64::max(without.cost, EQUAL_SHARE * settings.small_cost());
            assert!(report.cost <= f64::min(most, report.warm_cost), "{cycle}");
            let is_solved = report.cost <= settings.cost_tolerance();
            assert!(
                !is_solved || report.status == SolveStatus::Converged,
                "{cycle}"
            );
            others += u32::from(nmpc.plan() != blind.plan());
            (at, rates) = (at.advanced(&command, 0.005), command);
        }
        assert!(others > 10, "{others}");
    }
}
