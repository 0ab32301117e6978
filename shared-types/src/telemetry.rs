use iceoryx2::prelude::ZeroCopySend;

use crate::limits::{
    CABLES_MAX, COORDINATES_MAX, EVENTS_MAX, OBSTACLES_MAX, PLAN_MAX, SECTIONS_MAX,
};
use crate::{Command, Header, Measurement, Obstacle, RobotDescription, SolverSettings};

/// One message that the daemon took in, and what became of it.
///
/// The events of the records, in order, say exactly which reference chunk, obstacle update or request
/// took effect in which cycle. Together with a recording of those messages they rebuild the state of
/// the reference buffer and of the obstacle set for every cycle.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[type_name("cdcr.InputEvent.v1")]
pub struct InputEvent {
    /// `header.sender_id` of the message.
    pub sender_id: u64,
    /// `header.sequence` of the message.
    pub sequence: u64,
    /// The daemon's clock when it judged the message \[ns, `CLOCK_MONOTONIC`\].
    pub judged_ns: u64,
    /// [`codes::EventKind`](crate::codes::EventKind).
    pub kind: u32,
    /// [`codes::Outcome`](crate::codes::Outcome).
    pub outcome: u32,
    /// Place of the trouble: index of the point or obstacle; for a request its
    /// [`codes::RequestKind`](crate::codes::RequestKind); for an accepted obstacle update how many
    /// obstacles are known after it.
    pub detail: u32,
    /// It took effect this many gathers before the record's `gather`: 0, unless more happened at once
    /// than one record can report.
    pub gathers_ago: u32,
}

/// The reference at one instant, after interpolation.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("cdcr.ReferenceSample.v1")]
pub struct ReferenceSample {
    /// Position in the base frame \[m\].
    pub position_m: [f64; 3],
    /// As in [`ReferencePoint`](crate::ReferencePoint).
    pub orientation: [f64; 4],
    /// [`codes::OrientationKind`](crate::codes::OrientationKind).
    pub orientation_kind: u32,
    /// [`codes::ReferenceState`](crate::codes::ReferenceState).
    pub state: u32,
}

/// What the solver did in one cycle. All zero in cycles that did not solve.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default, ZeroCopySend)]
#[type_name("cdcr.SolverReport.v1")]
pub struct SolverReport {
    /// Cost of the solution, in the scale of the weights.
    pub cost: f64,
    /// Cost of the warm start.
    pub warm_cost: f64,
    /// Norm of the projected gradient at the solution.
    pub gradient_norm: f64,
    /// How far the solution breaks its worst constraint: \[m\] of clearance, or parts of a limit.
    pub violation: f64,
    /// Seed of this cycle's swarm: a function of `settings.seed` and the cycle.
    pub seed: u64,
    /// Cost evaluations.
    pub evaluations: u32,
    /// Budget checks that were passed. A replay with a budget of this many checks does the same
    /// work, whatever its clock says.
    pub quanta: u32,
    /// Swarm iterations.
    pub iterations: u32,
    /// Gauss-Newton steps that were accepted.
    pub refinements: u32,
    /// [`codes::SolverStatus`](crate::codes::SolverStatus).
    pub status: u32,
    /// [`codes::Winner`](crate::codes::Winner): which candidate the solution descends from.
    pub winner: u32,
    /// [`codes::Constraint`](crate::codes::Constraint): which constraint the solution breaks.
    pub violated: u32,
    /// 1 when the budget ended the solve, whatever the status.
    pub budget_spent: u32,
}

/// What the system did to the cycle thread between the record before and this one, read by the exchange.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ZeroCopySend)]
#[type_name("cdcr.SchedulingReport.v1")]
pub struct SchedulingReport {
    /// Time that the thread was ready to run and another had the core \[ns\].
    pub run_delay_ns: u64,
    /// Time that it ran \[ns\].
    pub on_core_ns: u64,
    /// Longest time between two looks at the clock inside the solver \[ns\]; 0: it did not run. Far longer
    /// than a quantum of work (a few µs): the processor stood still.
    pub longest_gap_ns: u64,
    /// Page faults, minor and major.
    pub page_faults: u32,
    /// Times that it lost the core other than by its sleep.
    pub switches: u32,
    /// [`codes::LateCause`](crate::codes::LateCause): what made the cycle late.
    pub late_cause: u32,
    /// 1 when the numbers above could be read.
    pub known: u32,
}

/// Everything of one cycle: inputs as used, outputs, timing, mode, fault.
///
/// A record holds all that its cycle used but the reference, which is rebuilt from the clients' chunks
/// in the order that the events of the records tell; see `docs/replay.md`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("cdcr.Telemetry.v2")]
pub struct Telemetry {
    /// The daemon, number of the record, time of publication.
    pub header: Header,

    // ---- when
    /// Number of the cycle on the grid: release = origin + cycle · period.
    pub cycle: u64,
    /// Release time r of this cycle \[ns, `CLOCK_MONOTONIC`\]: what was measured, predicted and commanded
    /// refers to it.
    pub release_ns: u64,
    /// The release that the thread slept for \[ns\]. Earlier than `release_ns` when it slept through whole
    /// periods; lateness counts from here, so a stall cannot hide behind the newest release.
    pub due_ns: u64,
    /// The cycle started s \[ns\].
    pub start_ns: u64,
    /// The solver began \[ns\].
    pub solve_start_ns: u64,
    /// The solver ended \[ns\].
    pub solve_end_ns: u64,
    /// The command was handed over p \[ns\].
    pub handed_over_ns: u64,
    /// Period T \[ns\].
    pub period_ns: u64,
    /// Time since the release of the previous cycle that ran \[ns\]: a multiple of the period.
    pub elapsed_ns: u64,
    /// Periods skipped between the previous cycle and this one.
    pub skipped_periods: u32,
    /// [`codes::timing`](crate::codes::timing) bits: late start, deadline miss, stale inputs.
    pub timing_flags: u32,
    /// Deadline misses since the start.
    pub deadline_misses_total: u64,
    /// Skipped periods since the start.
    pub skipped_periods_total: u64,
    /// What the system did to the cycle thread, and what made the cycle late.
    pub scheduling: SchedulingReport,

    // ---- mode
    /// [`codes::Mode`](crate::codes::Mode) in which the command was made.
    pub mode: u32,
    /// [`codes::Reason`](crate::codes::Reason) why this mode.
    pub reason: u32,
    /// Level of the leaky bucket of deadline misses.
    pub miss_bucket: u32,
    /// Events of this record, 0 ..= [`EVENTS_MAX`].
    pub event_count: u32,

    // ---- inputs as used
    /// Number of the gather whose inputs the cycle used.
    pub gather: u64,
    /// The clock of that gather \[ns, `CLOCK_MONOTONIC`\].
    pub gather_ns: u64,
    /// What the daemon took in since the last record; the first `event_count` are used.
    pub events: [InputEvent; EVENTS_MAX],
    /// The measurement as used, header zero; `kind` 0 when there was none. The simulated robot measures
    /// its own configuration.
    pub measurement: Measurement,
    /// Estimated bend vector at the release \[rad\].
    pub bend_rad: [f64; COORDINATES_MAX],
    /// Rates of the previous command \[rad/s\].
    pub previous_rate_rad_s: [f64; COORDINATES_MAX],
    /// The solver's settings in this cycle.
    pub settings: SolverSettings,
    /// The robot.
    pub robot: RobotDescription,
    /// First cycle of the reference window: the samples reach from its release past the horizon, by up to 60
    /// periods (60 at 5 ms).
    pub window_first_cycle: u64,
    /// How fast rates shrink when holding or stopping \[rad/s²\].
    pub deceleration_rad_s2: f64,
    /// Rate of the fastest component on the way home \[rad/s\].
    pub home_rate_rad_s: f64,
    /// Deadline after the release \[ns\].
    pub deadline_ns: u64,
    /// A start later than this after the release it was due at is a late start \[ns\].
    pub late_start_ns: u64,
    /// A measurement older than this is lost \[ns\].
    pub measurement_timeout_ns: u64,
    /// A clearance below this is a fault \[m\].
    pub clearance_fault_m: f64,
    /// How far a measurement may jump \[rad\].
    pub measurement_jump_rad: f64,
    /// How far the robot may be commanded while the measurement stands still \[rad\].
    pub measurement_frozen_rad: f64,
    /// So many jumps in a row are a fault.
    pub measurement_jump_limit: u32,
    /// [`codes::MeasurementState`](crate::codes::MeasurementState).
    pub measurement_state: u32,
    /// Level at which the leaky bucket stops the robot; 0: it does not.
    pub miss_limit: u32,
    /// [`codes::LeaseState`](crate::codes::LeaseState).
    pub lease_state: u32,
    /// Scalars of `warm_plan` and `plan` that are used; 0: the solver did not run.
    pub plan_length: u32,
    /// Obstacles of this cycle, 0 ..= [`OBSTACLES_MAX`].
    pub obstacle_count: u32,
    /// The obstacles as used, in this order, where they are at the release: `measured_ns` is the release,
    /// `lifetime_ns` what is left of their lifetime then, 0: until removed. The first `obstacle_count` are
    /// used.
    pub obstacles: [Obstacle; OBSTACLES_MAX],
    /// The plan that the solver started from \[rad/s\], block by block.
    pub warm_plan: [f64; PLAN_MAX],

    // ---- outputs
    /// The solution \[rad/s\], block by block.
    pub plan: [f64; PLAN_MAX],
    /// What the solver did.
    pub report: SolverReport,
    /// Reference at the release.
    pub reference: ReferenceSample,
    /// Tip position at the release, from `bend_rad` \[m\].
    pub tip_position_m: [f64; 3],
    /// Tip orientation at the release, unit quaternion (x, y, z, w).
    pub tip_orientation: [f64; 4],
    /// Distance of tip and reference at the release \[m\]; NaN without a reference.
    pub position_error_m: f64,
    /// [`codes::guard`](crate::codes::guard) bits: which limits changed the command that the mode wanted.
    pub guard_flags: u32,
    /// Zero.
    pub reserved: u32,
    /// Smallest distance at the release between the surfaces of body and obstacles, from `bend_rad` and
    /// `obstacles` \[m\]: negative inside one, infinite without obstacles, NaN when `bend_rad` is not
    /// finite.
    pub clearance_m: f64,
    /// The command as it left.
    pub command: Command,
    /// Commanded bend vector at the release \[rad\]: `command.bend_target_rad` is one period later.
    pub commanded_rad: [f64; COORDINATES_MAX],
    /// Following error of each section \[rad\]: how far the measured bend vector is from every commanded one of the last
    /// `following_lag_ns`, so that a lag of the motors up to that is no error. Zero while only the tip is measured.
    pub following_error_rad: [f64; SECTIONS_MAX],
    /// The same of each cable \[m\].
    pub following_error_m: [f64; CABLES_MAX],
    /// A following error above this is a warning \[rad\].
    pub following_warning_rad: f64,
    /// A following error above this is a fault \[rad\].
    pub following_fault_rad: f64,
    /// How far the motors may lag behind \[ns\].
    pub following_lag_ns: u64,
    /// Largest acceleration of a component \[rad/s²\]; infinite: no limit.
    pub acceleration_rad_s2: f64,
}

impl Default for Telemetry {
    fn default() -> Self {
        Self {
            header: Header::default(),
            cycle: 0,
            release_ns: 0,
            due_ns: 0,
            start_ns: 0,
            solve_start_ns: 0,
            solve_end_ns: 0,
            handed_over_ns: 0,
            period_ns: 0,
            elapsed_ns: 0,
            skipped_periods: 0,
            timing_flags: 0,
            deadline_misses_total: 0,
            skipped_periods_total: 0,
            scheduling: SchedulingReport::default(),
            mode: 0,
            reason: 0,
            miss_bucket: 0,
            event_count: 0,
            gather: 0,
            gather_ns: 0,
            events: [InputEvent::default(); EVENTS_MAX],
            measurement: Measurement::default(),
            bend_rad: [0.0; COORDINATES_MAX],
            previous_rate_rad_s: [0.0; COORDINATES_MAX],
            settings: SolverSettings::default(),
            robot: RobotDescription::default(),
            window_first_cycle: 0,
            deceleration_rad_s2: 0.0,
            home_rate_rad_s: 0.0,
            deadline_ns: 0,
            late_start_ns: 0,
            measurement_timeout_ns: 0,
            clearance_fault_m: 0.0,
            measurement_jump_rad: 0.0,
            measurement_frozen_rad: 0.0,
            measurement_jump_limit: 0,
            measurement_state: 0,
            miss_limit: 0,
            lease_state: 0,
            plan_length: 0,
            obstacle_count: 0,
            obstacles: [Obstacle::default(); OBSTACLES_MAX],
            warm_plan: [0.0; PLAN_MAX],
            plan: [0.0; PLAN_MAX],
            report: SolverReport::default(),
            reference: ReferenceSample::default(),
            tip_position_m: [0.0; 3],
            tip_orientation: [0.0; 4],
            position_error_m: 0.0,
            guard_flags: 0,
            reserved: 0,
            clearance_m: 0.0,
            command: Command::default(),
            commanded_rad: [0.0; COORDINATES_MAX],
            following_error_rad: [0.0; SECTIONS_MAX],
            following_error_m: [0.0; CABLES_MAX],
            following_warning_rad: 0.0,
            following_fault_rad: 0.0,
            following_lag_ns: 0,
            acceleration_rad_s2: 0.0,
        }
    }
}
