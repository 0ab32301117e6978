use cdcr_controller::safety::FollowingError;
use cdcr_shared_types as wire;
use cdcr_shared_types::codes::{Mode, Outcome, Reason};

use crate::accounting::Totals;
use crate::core_budget::{CoreBudget, Costs};
use crate::rt::schedule::Lateness;

/// What the supervisor learns of a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Summary {
    /// Number on the grid.
    pub cycle: u64,
    /// Release to start \[ns\].
    pub wake_ns: u64,
    /// The solver \[ns\].
    pub solve_ns: u64,
    /// How the real-time threads share out their core.
    pub core_budget: CoreBudget,
    /// What the parts beside the solver were known to take.
    pub costs: Costs,
    pub solved: bool,
    /// Start to hand-over \[ns\].
    pub compute_ns: u64,
    /// Release to hand-over \[ns\].
    pub response_ns: u64,
    /// The gather before it \[ns\].
    pub gather_ns: u64,
    /// Hand-over to the command being in the readers' queues \[ns\].
    pub publish_ns: u64,
    /// Releases before it that got no cycle.
    pub skipped_periods: u32,
    /// Time of the release that was due \[ns\].
    pub due_ns: u64,
    /// [`wire::codes::LateCause`]; none, too, when it only skipped the releases that the late cycle before it
    /// took.
    pub late_cause: u32,
    /// What it adds to the counters of the statistics, beside the totals and what the supervisor finds out.
    pub counts: wire::Statistics,
    /// Distance of the tip from its reference \[m\], while it follows one.
    pub position_error_m: Option<f64>,
    pub lateness: Lateness,
    /// Whether the leaky bucket is full and the robot, a simulated one, goes on.
    pub misses_tolerated: bool,
    pub totals: Totals,
    pub mode: Mode,
    pub reason: Reason,
    /// Faults since the start.
    pub faults: u64,
    pub settings: wire::SolverSettings,
    /// Holder of the lease, 0: nobody.
    pub lease_holder: u64,
    /// Last time of the reference \[ns\], 0: none.
    pub reference_end_ns: u64,
    /// Points ahead.
    pub reference_points: u32,
    /// Obstacles of this cycle.
    pub obstacle_count: u32,
    /// Obstacle updates refused since the start.
    pub obstacles_refused: u64,
    /// Smallest clearance \[m\].
    pub clearance_m: f64,
    /// Whether the clearance guard changed the command.
    pub clearance_guarded: bool,
    /// Tip at the release \[m\].
    pub tip_position_m: [f64; 3],
    /// Distance of tip and reference \[m\]; NaN without a reference.
    pub reference_distance_m: f64,
    /// Reference at the release \[m\]; NaN without one.
    pub reference_position_m: [f64; 3],
    /// Distance of tip and reference when a sensor of the tip measured it last \[m\]; NaN without either.
    pub measured_error_m: f64,
    /// How far the robot is from where it is commanded to be.
    pub following: FollowingError,
    /// Whether that is more than the warning.
    pub following_warning: bool,
    /// Events that no record took.
    pub dropped_events: u64,
    /// Messages by outcome.
    pub outcomes: [u64; Outcome::COUNT],
}
