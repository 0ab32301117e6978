use cdcr_controller::safety::FollowingError;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{Mode, Reason};

use crate::accounting::Totals;
use crate::core_budget::{CoreBudget, Costs};
use crate::handover::{FaultPlace, InputStatus, TipRejection};
use crate::rt::schedule::Lateness;

/// Data of a cycle for the supervisor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Summary {
    /// Number on the grid.
    pub cycle: u64,
    /// Wake-up latency \[ns\].
    pub wake_ns: u64,
    /// Duration of the solve \[ns\].
    pub solve_ns: u64,
    /// Division of the core among the real-time threads.
    pub core_budget: CoreBudget,
    /// Measured costs of the parts beside the solver.
    pub costs: Costs,
    pub solved: bool,
    /// Start to hand-over \[ns\].
    pub compute_ns: u64,
    /// Response time \[ns\].
    pub response_ns: u64,
    /// Duration of the gather before the cycle \[ns\].
    pub gather_ns: u64,
    /// Time from the hand-over until the command is in the readers' queues \[ns\].
    pub publish_ns: u64,
    /// Skipped releases before the cycle.
    pub skipped_periods: u32,
    /// Time of the release that was due \[ns\].
    pub due_ns: u64,
    /// [`wire::codes::LateCause`]; also none if the cycle only skipped the releases during the late cycle
    /// before it.
    pub late_cause: u32,
    /// Increments of the statistics' counters, except the totals and the supervisor's own.
    pub counts: wire::Statistics,
    /// Distance of the tip from its reference \[m\], while tracking.
    pub position_error_m: Option<f64>,
    pub lateness: Lateness,
    /// The leaky bucket is full, and the robot, a simulated one, continues.
    pub misses_tolerated: bool,
    pub totals: Totals,
    pub mode: Mode,
    pub reason: Reason,
    /// Why a reset is refused in a latched mode; `None`: it is not.
    pub reset_refused_by: Option<Reason>,
    /// Number of faults since the start.
    pub faults: u64,
    pub settings: wire::SolverSettings,
    pub inputs: InputStatus,
    pub obstacle_count: u32,
    /// Smallest clearance \[m\].
    pub clearance_m: f64,
    /// Distance by which the body counts as thicker at the tip \[m\].
    pub tip_margin_m: f64,
    /// The clearance guard changed the command.
    pub clearance_guarded: bool,
    /// Tip at the release \[m\].
    pub tip_position_m: [f64; 3],
    /// Distance of tip and reference \[m\]; NaN without a reference.
    pub reference_distance_m: f64,
    /// Reference at the release \[m\]; NaN without one.
    pub reference_position_m: [f64; 3],
    /// Distance of tip and reference at the last measurement of the tip sensor \[m\]; NaN without one of
    /// them.
    pub measured_error_m: f64,
    pub following: FollowingError,
    /// The following error exceeds its warning limit, outside Stopped and Faulted.
    pub following_warning: bool,
    /// A reset has to accept the pose, or had to in this cycle.
    pub pose_differs: bool,
    /// Last measurement of the tip beside bends or cables \[ns\]; 0: none.
    pub tip_measured_ns: u64,
    /// The newest tip measured beside the bends, if it was rejected.
    pub tip_rejected: Option<TipRejection>,
    /// Distance of the measured tip from where the measured bends place it \[m\], where it refuses a reset; else 0.
    pub tip_contradiction_m: f64,
    /// Where the cycle that began the present fault saw its cause.
    pub fault_place: Option<FaultPlace>,
}
