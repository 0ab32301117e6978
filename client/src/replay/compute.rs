use cdcr_controller::estimator::Slack;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput, SolveReport, SolveStatus};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::Approach;
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot};
use cdcr_controller::safety::{
    Lag, SafeCommand, Situation, homing_rates, ramp_to_zero, safe_command,
};
use cdcr_shared_types::codes::{Interface, Mode, ReferenceState, SolverStatus, guard};
use cdcr_shared_types::model::guard_flags;
use cdcr_shared_types::{RobotDescription, SolverSettings, Telemetry};
use nalgebra::Vector3;

use super::check::Check;
use super::reference::Reference;
use super::{Outcome, ReplayError};
use crate::model::{moving_ns, obstacle_of, settings_of};
use crate::obstacles;

/// Steps of a recomputed cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Made {
    /// The solver ran.
    pub solved: bool,
    /// The clearance guard changed the command.
    pub guarded: bool,
    /// The play of the cables alone changed it.
    pub by_play: bool,
}

/// Command with other settings, compared with the recorded one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WhatIf {
    /// Largest difference of a rate \[rad/s\].
    pub rates_apart_rad_s: f64,
    /// Distance between the tips after one period of each command \[m\].
    pub tips_apart_m: f64,
    /// The clearance guard would have changed the command.
    pub guarded: bool,
    /// Cost evaluations, without a time limit.
    pub evaluations: u32,
    /// The solver would have converged.
    pub converged: bool,
}

/// Computes the steps of a cycle after the estimate: solve, limits, guard.
#[derive(Debug)]
pub(super) struct Computer {
    robot: Robot,
    nmpc: Nmpc,
    period_ns: u64,
    /// The robot of the first record.
    description: RobotDescription,
}

/// Robot state of a record in the controller's types.
struct State {
    at: Configuration,
    commanded: Configuration,
    motors: Configuration,
    present: Configuration,
    /// At the end of the motors' delay.
    delayed: Configuration,
    /// What the solver and the way home began with.
    previous: BendRates,
    /// What limits and ramp began with.
    limited_from: BendRates,
    /// Commanded position, seen from where control begins, while it moves there.
    way: Option<Configuration>,
    /// Obstacles at the release.
    known: Vec<Obstacle>,
    /// Obstacles at the time when the robot reaches its commanded position.
    led: Vec<Obstacle>,
    tip_offset_m: Vector3<f64>,
    tip_margin_m: f64,
    period_s: f64,
}

impl State {
    fn from_record(record: &Telemetry, robot: &Robot) -> Option<Self> {
        let width = robot.coordinate_count();
        let at = |bends: &[f64]| Configuration::from_slice(bends.get(..width)?);
        let lead_s = record.reference_lead_ns as f64 * 1e-9;
        let known: Vec<_> = obstacles(record)
            .iter()
            .map(obstacle_of)
            .collect::<Option<_>>()?;
        let previous = BendRates::from_slice(record.previous_rate_rad_s.get(..width)?)?;
        Some(Self {
            at: at(&record.bend_rad)?,
            commanded: at(&record.commanded_rad)?,
            motors: at(&record.motor_rad)?,
            present: at(&record.present_rad)?,
            delayed: at(&record.delayed_rad)?,
            limited_from: if record.ran_out_in_solve == 0 {
                previous
            } else {
                BendRates::zero(robot.section_count())
            },
            previous,
            way: if record.moves_to_begin == 0 {
                None
            } else {
                Some(at(&record.way_rad)?)
            },
            led: known.iter().map(|known| known.moved(lead_s)).collect(),
            known,
            tip_offset_m: record.tip_offset_m.into(),
            tip_margin_m: record.tip_margin_m,
            period_s: record.period_ns as f64 * 1e-9,
        })
    }
}

impl Computer {
    pub(super) fn new(robot: Robot, record: &Telemetry) -> Result<Self, ReplayError> {
        let period_s = record.period_ns as f64 * 1e-9;
        let settings = settings_of(&record.settings)?;
        Ok(Self {
            nmpc: Nmpc::new(robot.clone(), period_s, settings)?,
            robot,
            period_ns: record.period_ns,
            description: record.robot,
        })
    }

    /// Recomputes a cycle.
    pub(super) fn check(
        &mut self,
        record: &Telemetry,
        reference: &mut Reference,
    ) -> Result<Outcome, ReplayError> {
        let mut check = Check::new(record.cycle);
        check.same(
            "robot.fingerprint",
            record.robot.fingerprint,
            self.robot.fingerprint(),
        );
        if record.robot != self.description {
            check.same("robot", "another than before", "that of the first record");
        }
        check.same("period_ns", record.period_ns, self.period_ns);
        let state = State::from_record(record, &self.robot).ok_or(ReplayError::Shape)?;
        self.check_tip(record, &state, &mut check);
        let solved = record.plan_length > 0;
        let is_homing = record.mode == Mode::Homing.code();
        let home_from = if is_homing { Some(state.at) } else { state.way };
        let planned = if solved {
            let rates = self.solve(record, &state, reference, &mut check)?;
            let is_finite = record.report.status != SolverStatus::NonFinite.code();
            is_finite.then_some(rates)
        } else {
            home_from.map(|from| self.rates_home(record, &state, &from))
        };
        let desired = planned.unwrap_or_else(|| ramp(record, &state));
        let [guarded, by_play] =
            self.make_safe(record, &state, &desired, planned.is_none(), &mut check);
        Ok(check.first().map_or(
            Outcome::Reproduced(Made {
                solved,
                guarded,
                by_play,
            }),
            Outcome::Different,
        ))
    }

    /// Place and error of the tip, which nothing else depends on.
    fn check_tip(&self, record: &Telemetry, state: &State, check: &mut Check) {
        let tip_m = self.robot.tip_pose(&state.present).position_m + state.tip_offset_m;
        check.numbers("tip_position_m", &record.tip_position_m, tip_m.as_slice());
        let reference_m = if record.reference.state == ReferenceState::None.code() {
            Vector3::repeat(f64::NAN)
        } else {
            record.reference.position_m.into()
        };
        let error_m = (tip_m - reference_m).norm();
        check.number("position_error_m", record.position_error_m, error_m);
    }

    /// Solves with the inputs of a record and returns the desired rates.
    fn solve(
        &mut self,
        record: &Telemetry,
        state: &State,
        reference: &mut Reference,
        check: &mut Check,
    ) -> Result<BendRates, ReplayError> {
        let settings = settings_of(&record.settings)?;
        let length = record.plan_length as usize;
        let warm_plan = record.warm_plan.get(..length).ok_or(ReplayError::Shape)?;
        let seed = record.report.seed;
        let budget = &mut Budget::from_quanta(record.report.quanta);
        let (rates, report) = self.solve_with(
            record,
            state,
            reference,
            settings,
            Some(warm_plan),
            seed,
            budget,
        )?;
        check.same(
            "report.evaluations",
            record.report.evaluations,
            report.evaluations,
        );
        check.same(
            "report.iterations",
            record.report.iterations,
            report.iterations,
        );
        check.number("report.cost", record.report.cost, report.cost);
        check.numbers("plan", &record.plan[..length], self.nmpc.plan());
        let is_finite = record.report.status != SolverStatus::NonFinite.code();
        check.same(
            "report.status",
            is_finite,
            report.status != SolveStatus::NonFinite,
        );
        Ok(rates)
    }

    /// The next rates on the straight line from `from` to zero.
    fn rates_home(&self, record: &Telemetry, state: &State, from: &Configuration) -> BendRates {
        homing_rates(
            &self.robot,
            from,
            &state.previous,
            record.home_rate_rad_s,
            record.acceleration_rad_s2 * state.period_s,
            state.period_s,
        )
    }

    /// Applies limits and guard to the desired rates. With `slack`, the guard includes the play of the
    /// cables.
    fn safe(
        &self,
        record: &Telemetry,
        state: &State,
        desired: &BendRates,
        comes_to_rest: bool,
        slack: Option<&Slack>,
    ) -> SafeCommand {
        let obeys_positions = record.command.interface == Interface::Position.code();
        let motors = Some(&state.motors).filter(|motors| **motors != state.at);
        let situation = Situation {
            robot: &self.robot,
            at: &state.at,
            lag: Some(Lag {
                delayed: &state.delayed,
                time_constant_s: record.motor_time_constant_ns as f64 * 1e-9,
            }),
            commanded: if obeys_positions {
                Some(&state.commanded)
            } else {
                motors
            },
            slack,
            previous: &state.limited_from,
            obstacles: &state.led,
            safe_distance_m: record.settings.safe_distance_m,
            tip_offset_m: state.tip_margin_m,
            acceleration_rad_s2: record.acceleration_rad_s2,
            period_s: state.period_s,
            moving_s: moving_ns(record) as f64 * 1e-9,
            deceleration_rad_s2: record.deceleration_rad_s2,
            comes_to_rest,
        };
        safe_command(&situation, desired)
    }

    fn make_safe(
        &self,
        record: &Telemetry,
        state: &State,
        desired: &BendRates,
        comes_to_rest: bool,
        check: &mut Check,
    ) -> [bool; 2] {
        let slack = slack_of(record);
        let safe = self.safe(record, state, desired, comes_to_rest, slack.as_ref());
        let width = self.robot.coordinate_count();
        let command = &record.command;
        let rates = &command.bend_rate_rad_s[..width];
        check.numbers("command.bend_rate_rad_s", rates, safe.rates.as_slice());
        let target = state.commanded.advanced(&safe.rates, state.period_s);
        let targets = &command.bend_target_rad[..width];
        check.numbers("command.bend_target_rad", targets, target.as_slice());
        let lengths_m = self.robot.cable_lengths(&target);
        check.numbers(
            "command.cable_length_m",
            &command.cable_length_m,
            &lengths_m,
        );
        let speeds_m_s = self.robot.cable_speeds(&safe.rates);
        check.numbers(
            "command.cable_speed_m_s",
            &command.cable_speed_m_s,
            &speeds_m_s,
        );
        let clearance_m = if record.reference_lead_ns == 0 || !safe.clearance_m.is_finite() {
            safe.clearance_m
        } else {
            let enlarged = self.robot.enlarged(&state.present, state.tip_margin_m);
            let body = enlarged.body(&state.present);
            body.least_clearance_m(state.known.iter().copied())
        };
        check.number("clearance_m", record.clearance_m, clearance_m);
        let flags = guard_flags(&safe.limits_hit, safe.clearance_hit);
        for (bit, name, _) in guard::ALL {
            let [flagged, hit] = [record.guard_flags, flags].map(|flags| flags & bit != 0);
            check.same(&format!("guard_flags ({name})"), flagged, hit);
        }
        let by_play = slack.is_some() && {
            let without = self.safe(record, state, desired, comes_to_rest, None);
            safe.rates != without.rates
        };
        [safe.clearance_hit, by_play]
    }

    /// The command with other settings; `None` when the cycle did not solve.
    pub(super) fn what_if(
        &mut self,
        record: &Telemetry,
        settings: &SolverSettings,
        reference: &mut Reference,
    ) -> Result<Option<WhatIf>, ReplayError> {
        if record.plan_length == 0 {
            return Ok(None);
        }
        let state = State::from_record(record, &self.robot).ok_or(ReplayError::Shape)?;
        let before = settings_of(&record.settings)?;
        let settings = settings_of(settings)?;
        // A plan of another shape is not a warm start.
        let is_same_shape = before.coordinates == settings.coordinates
            && before.horizon_steps == settings.horizon_steps
            && before.control_blocks == settings.control_blocks
            && (before.rate_change_weight > 0.0) == (settings.rate_change_weight > 0.0);
        let warm_plan = record.warm_plan.get(..record.plan_length as usize);
        let warm_plan = warm_plan.filter(|_| is_same_shape);
        let (seed, budget) = (record.report.seed, &mut Budget::unlimited());
        let (desired, report) =
            self.solve_with(record, &state, reference, settings, warm_plan, seed, budget)?;
        let altered = Telemetry {
            settings: SolverSettings {
                safe_distance_m: settings.safe_distance_m,
                ..record.settings
            },
            ..*record
        };
        let safe = self.safe(&altered, &state, &desired, false, slack_of(record).as_ref());
        let width = self.robot.coordinate_count();
        let recorded = BendRates::from_slice(&record.command.bend_rate_rad_s[..width]);
        let recorded = recorded.ok_or(ReplayError::Shape)?;
        let tip_m = |rates: &BendRates| {
            let at = state.at.advanced(rates, state.period_s);
            self.robot.tip_position(&at)
        };
        let pairs = safe.rates.as_slice().iter().zip(recorded.as_slice());
        let apart = pairs.map(|(one, other)| (one - other).abs());
        Ok(Some(WhatIf {
            rates_apart_rad_s: apart.fold(0.0, f64::max),
            tips_apart_m: (tip_m(&safe.rates) - tip_m(&recorded)).norm(),
            guarded: safe.clearance_hit,
            evaluations: report.evaluations,
            converged: report.status == SolveStatus::Converged,
        }))
    }

    /// Solves with the inputs of a record and these settings.
    #[allow(clippy::too_many_arguments, reason = "what a solve depends on")]
    fn solve_with(
        &mut self,
        record: &Telemetry,
        state: &State,
        reference: &mut Reference,
        settings: NmpcSettings,
        warm_plan: Option<&[f64]>,
        seed: u64,
        budget: &mut Budget<'_>,
    ) -> Result<(BendRates, SolveReport), ReplayError> {
        if *self.nmpc.settings() != settings {
            self.nmpc.configure(settings)?;
        }
        match warm_plan {
            Some(plan) => {
                let moved_on = record.elapsed_ns / record.period_ns.max(1);
                if !self.nmpc.restore_plan(plan, moved_on) {
                    return Err(ReplayError::Shape);
                }
            }
            None => self.nmpc.forget_plan(),
        }
        self.nmpc.limit_acceleration(record.acceleration_rad_s2);
        self.nmpc.limit_pace(record.pace_m_s);
        let steps = settings.horizon_steps as usize;
        let window = reference.window(record, steps);
        let approach = Approach::from(&record.approach);
        let samples = window.ahead(record.cycle, steps).iter().zip(1..);
        let led = samples.map(|(sample, step)| {
            let time_ns = record.release_ns + step * record.period_ns;
            approach
                .followed_sample(sample, time_ns)
                .moved(&-state.tip_offset_m)
        });
        let led: Vec<_> = led.collect();
        let input = SolveInput {
            configuration: &state.at,
            previous_rates: &state.previous,
            reference: &led,
            obstacles: &state.led,
            tip_offset_m: state.tip_margin_m,
            // The recorded warm start is already shifted in time.
            elapsed_periods: 0,
            seed,
        };
        Ok(self.nmpc.solve(&input, budget))
    }
}

fn slack_of(record: &Telemetry) -> Option<Slack> {
    (record.play_m > 0.0).then(|| Slack::new(record.play_m, record.slack_m))
}

/// The next rates of the ramp to rest.
fn ramp(record: &Telemetry, state: &State) -> BendRates {
    ramp_to_zero(
        &state.limited_from,
        record.deceleration_rad_s2,
        state.period_s,
    )
}
