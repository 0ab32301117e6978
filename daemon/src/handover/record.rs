use core::ops::Deref;

use cdcr_controller::estimator::Slack;
use cdcr_controller::nmpc::{PLAN_MAX, SolveReport};
use cdcr_controller::reference::{Approach, ReferenceSample};
use cdcr_controller::robot::{BendRates, Configuration, Pose};
use cdcr_controller::safety::{FollowingError, LeaseState, LimitsHit, Mode};
use nalgebra::Vector3;

use super::{Policy, Settings};
use crate::accounting::Totals;
use crate::core_budget::{CoreBudget, Costs};
use crate::handover::{CycleAnswer, REQUESTS_WAITING, TimedMeasurement};
use crate::obstacles::ObstacleSet;
use crate::rt::schedule::Lateness;
use crate::rt::schedule::Release;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeasurementUse {
    /// There was none yet.
    None,
    /// It corrected the estimate.
    Used,
    /// It is the one of the cycle before: the estimate was predicted.
    Repeated,
    /// It was left out: no robot moves like that.
    Implausible,
}

/// Everything of one cycle: what it used, what it did, when.
///
/// It has 18 kB and is written where it stays, in memory that held another cycle: of obstacles and plans, as many as there are.
#[derive(Debug, Clone, Copy)]
pub struct CycleRecord {
    pub facts: CycleFacts,
    /// The obstacles, where they are at the release.
    pub obstacles: ObstacleSet,
    /// Scalars used of the two plans; 0: the solver did not run. The others are 0.
    pub plan_length: usize,
    /// Warm start of the solver.
    pub warm_plan: [f64; PLAN_MAX],
    pub plan: [f64; PLAN_MAX],
}

impl CycleRecord {
    /// Without obstacles and plans.
    pub fn new(facts: CycleFacts) -> Self {
        Self {
            facts,
            obstacles: ObstacleSet::default(),
            plan_length: 0,
            warm_plan: [0.0; PLAN_MAX],
            plan: [0.0; PLAN_MAX],
        }
    }

    /// Writes another cycle over this one; `plans` are its warm start and its plan, or nothing.
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

/// What a cycle used and did, all but its obstacles and plans.
#[derive(Debug, Clone, Copy)]
pub struct CycleFacts {
    pub release: Release,
    /// It was rehearsed: the thread woke up before the release.
    pub rehearsed: bool,
    /// The solver began \[ns\].
    pub solve_start_ns: u64,
    /// The solver ended \[ns\].
    pub solve_end_ns: u64,
    /// The command was handed over \[ns\].
    pub handed_over_ns: u64,
    /// Time since the release of the previous cycle \[ns\].
    pub elapsed_ns: u64,
    /// When the solver had to end \[ns\]; 0: it did not run.
    pub solve_until_ns: u64,
    /// How the real-time threads share out their core.
    pub core_budget: CoreBudget,
    /// What the parts beside the solver were known to take.
    pub costs: Costs,
    /// Longest time between two looks at the clock until the solver was done \[ns\].
    pub longest_gap_ns: u64,
    pub lateness: Lateness,
    /// Whether it used the inputs of the cycle before again.
    pub stale_inputs: bool,
    /// Counts including this cycle.
    pub totals: Totals,
    /// Level of the leaky bucket after this cycle.
    pub miss_bucket: u32,
    /// A latched mode was left, and the robot had not come to rest since when the cycle looked for faults.
    pub control_begins: bool,
    /// Mode in which the command was made.
    pub mode: Mode,
    /// Faults since the start.
    pub faults: u64,
    /// Number of the gather whose inputs were used.
    pub gather: u64,
    /// Its time \[ns\].
    pub gather_ns: u64,
    pub window_first_cycle: u64,
    pub lease: LeaseState,
    pub lease_number: u32,
    pub policy: Policy,
    /// The newest measurement.
    pub measurement: Option<TimedMeasurement>,
    pub measurement_use: MeasurementUse,
    /// The newest measurement of the tip beside that of bends or cables.
    pub tip_measurement: Option<TimedMeasurement>,
    pub tip_use: MeasurementUse,
    /// How far the tip was measured beside where the bends place it (m): the plan's reference is moved back by it.
    pub tip_offset_m: Vector3<f64>,
    /// How far it may be beside that (m): so much thicker the body counts.
    pub tip_margin_m: f64,
    /// Where the commands up to now lead the robot: what the next one is planned from.
    pub configuration: Configuration,
    /// Where they lead its motors: the robot is beside that by the play of its cables.
    pub motors: Configuration,
    /// What of the play of the cables is taken there; `None`: they have none.
    pub slack: Option<Slack>,
    /// Where it is at the release.
    pub present: Configuration,
    pub commanded: Configuration,
    /// How far the robot was from it at its last measurement.
    pub following: FollowingError,
    /// Tip at the release.
    pub tip: Pose,
    pub previous_rates: BendRates,
    /// Reference at the release.
    pub reference: ReferenceSample,
    /// The way to it, as the plan followed it.
    pub approach: Approach,
    /// Settings in force.
    pub settings: Settings,
    pub report: SolveReport,
    pub rates: BendRates,
    pub limits_hit: LimitsHit,
    /// Whether the clearance guard changed it.
    pub clearance_hit: bool,
    /// Smallest clearance at the release \[m\].
    pub clearance_m: f64,
    pub answers: [Option<CycleAnswer>; REQUESTS_WAITING],
}
