use core::ops::Deref;

use cdcr_controller::estimator::Slack;
use cdcr_controller::nmpc::{PLAN_MAX, SolveReport};
use cdcr_controller::reference::{Approach, ReferenceSample};
use cdcr_controller::robot::{BendRates, Configuration, Pose};
use cdcr_controller::safety::{FollowingError, LeaseState, LimitsHit, Mode, Observation};
use nalgebra::Vector3;

use super::{Policy, RuntimeSettings, TipCause};
use crate::accounting::Totals;
use crate::core_budget::{CoreBudget, Costs};
use crate::handover::{CycleAnswer, REQUESTS_WAITING, TimedMeasurement};
use crate::obstacles::ObstacleSet;
use crate::rt::schedule::Lateness;
use crate::rt::schedule::Release;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeasurementUse {
    /// No usable measurement.
    None,
    /// It corrected the estimate.
    Used,
    /// Not newer than the last one: the estimate was predicted.
    Repeated,
    /// Ignored: an implausible jump, a frozen value, or an offset beyond its limit.
    Implausible,
}

/// All inputs and results of one cycle, with its times.
///
/// A record has 18 kB. It is written in place over an earlier one; of obstacles and plans only the used part
/// is written.
#[derive(Debug, Clone, Copy)]
pub struct CycleRecord {
    pub facts: CycleFacts,
    /// Obstacles at their places at the release.
    pub obstacles: ObstacleSet,
    /// Used scalars of the two plans; 0: the solver did not run. The others are 0.
    pub plan_length: usize,
    /// Warm start of the solver.
    pub warm_plan: [f64; PLAN_MAX],
    pub plan: [f64; PLAN_MAX],
}

impl CycleRecord {
    /// A record without obstacles and plans.
    pub fn new(facts: CycleFacts) -> Self {
        Self {
            facts,
            obstacles: ObstacleSet::default(),
            plan_length: 0,
            warm_plan: [0.0; PLAN_MAX],
            plan: [0.0; PLAN_MAX],
        }
    }

    /// Overwrites the record with another cycle; `plans` are its warm start and its plan, or empty.
    pub fn write(&mut self, facts: CycleFacts, obstacles: &ObstacleSet, plans: [&[f64]; 2]) {
        self.facts = facts;
        self.obstacles.fill(obstacles.iter().copied());
        let length = plans[0].len();
        for (kept, plan) in [&mut self.warm_plan, &mut self.plan].into_iter().zip(plans) {
            kept[..length].copy_from_slice(plan);
            kept[length..self.plan_length.max(length)].fill(0.0);
        }
        self.plan_length = length;
    }
}

impl Deref for CycleRecord {
    type Target = CycleFacts;

    fn deref(&self) -> &CycleFacts {
        &self.facts
    }
}

/// Inputs and results of a cycle, except its obstacles and plans.
#[derive(Debug, Clone, Copy)]
pub struct CycleFacts {
    pub release: Release,
    /// The cycle was rehearsed: the thread woke up before the release.
    pub rehearsed: bool,
    /// Start of the solver \[ns\].
    pub solve_start_ns: u64,
    /// End of the solver \[ns\].
    pub solve_end_ns: u64,
    /// Hand-over of the command \[ns\].
    pub handed_over_ns: u64,
    /// Time since the release of the previous cycle \[ns\].
    pub elapsed_ns: u64,
    /// Time by which the solver had to end \[ns\]; 0: it did not run.
    pub solve_until_ns: u64,
    /// Division of the core among the real-time threads.
    pub core_budget: CoreBudget,
    /// Measured costs of the parts beside the solver.
    pub costs: Costs,
    /// Longest time between two checks of the clock until the end of the solver \[ns\].
    pub longest_gap_ns: u64,
    pub lateness: Lateness,
    /// The cycle used the inputs of the previous cycle again.
    pub stale_inputs: bool,
    /// Counts including this cycle.
    pub totals: Totals,
    /// Level of the leaky bucket after this cycle.
    pub miss_bucket: u32,
    /// What the mode was decided by.
    pub seen: Observation,
    /// After a latched mode, control had not yet begun when the cycle checked for faults.
    pub control_begins: bool,
    /// Mode in which the command was computed.
    pub mode: Mode,
    /// Number of faults since the start.
    pub faults: u64,
    /// Number of the gather whose inputs were used.
    pub gather: u64,
    /// Time of that gather \[ns\].
    pub gather_ns: u64,
    pub window_first_cycle: u64,
    pub lease: LeaseState,
    pub lease_number: u32,
    pub policy: Policy,
    /// Newest measurement.
    pub measurement: Option<TimedMeasurement>,
    pub measurement_use: MeasurementUse,
    /// Its channel that did not change although it should have.
    pub frozen_channel: Option<usize>,
    /// Newest measurement of the tip in addition to bends or cables.
    pub tip_measurement: Option<TimedMeasurement>,
    pub tip_use: MeasurementUse,
    /// Why the newest of them was not used.
    pub tip_unused: Option<TipCause>,
    /// Offset of the measured tip from the place given by the bends \[m\]; subtracted from the plan's
    /// reference.
    pub tip_offset_m: Vector3<f64>,
    /// Uncertainty of the tip's place beside that offset \[m\]; added to the body's radius.
    pub tip_margin_m: f64,
    /// Configuration to which the commands so far lead; the next command is planned from it.
    pub configuration: Configuration,
    /// Motor positions to which the commands lead; the play of the cables separates them from the
    /// configuration.
    pub motors: Configuration,
    /// State of the cables' play there; `None`: no play.
    pub slack: Option<Slack>,
    /// Configuration at the release.
    pub present: Configuration,
    /// At the end of the motors' delay, where this cycle's command begins to act.
    pub delayed: Configuration,
    pub commanded: Configuration,
    /// Following error at the last measurement.
    pub following: FollowingError,
    /// Tip at the release.
    pub tip: Pose,
    pub previous_rates: BendRates,
    /// The last command ran out during the solve: limits and ramp count from rest.
    pub ran_out_in_solve: bool,
    /// Commanded position, seen from where control begins, while it moves there.
    pub way: Option<Configuration>,
    /// Reference at the release.
    pub reference: ReferenceSample,
    /// Approach to the reference, as the plan followed it.
    pub approach: Approach,
    /// Largest speed of a tip that is behind its reference, in the newest cycle that solved \[m/s\].
    pub pace_m_s: f64,
    /// Settings in force.
    pub settings: RuntimeSettings,
    pub report: SolveReport,
    pub rates: BendRates,
    pub limits_hit: LimitsHit,
    /// The clearance guard changed the command.
    pub clearance_hit: bool,
    /// Smallest clearance at the release \[m\].
    pub clearance_m: f64,
    /// The same by the measured bends, where an obstacle is near \[m\].
    pub measured_clearance_m: f64,
    pub answers: [Option<CycleAnswer>; REQUESTS_WAITING],
}
