use crate::limits::{
    CABLES_MAX, COORDINATES_MAX, EVENTS_MAX, OBSTACLES_MAX, PLAN_MAX, SECTIONS_MAX,
};
use crate::message::message;
use crate::{Command, Header, Measurement, Obstacle, RobotDescription, SolverSettings};

message! {
    /// A message received by the daemon, and its outcome.
    ///
    /// In order, the events of the records state exactly which reference chunk, obstacle update or request took effect
    /// in which cycle. With a recording of those messages, they reproduce the state of the reference buffer and of the
    /// obstacle set for every cycle.
    #[derive(Eq)]
    pub struct InputEvent "cdcr.InputEvent.v2" {
        /// `header.sender_id` of the message.
        sender_id: u64,
        /// `header.sequence` of the message.
        sequence: u64,
        /// The daemon's clock when it evaluated the message; of a request that a cycle decided, that cycle's `handed_over_ns` \[ns,
        /// `CLOCK_MONOTONIC`\].
        evaluated_ns: u64,
        /// [`codes::EventKind`](crate::codes::EventKind).
        kind: u32 [code EventKind],
        /// [`codes::Outcome`](crate::codes::Outcome).
        outcome: u32 [code Outcome],
        /// Detail of the outcome: index of the point or obstacle; for a request its
        /// [`codes::RequestKind`](crate::codes::RequestKind), with `accepts_pose` `ResetAcceptingPose`; for an accepted obstacle update
        /// how many obstacles are known after it; for first bends that a tip contradicts, its distance in mm.
        detail: u32,
        /// It took effect this many gathers before the record's `gather`: 0, unless more happened at once
        /// than one record can report.
        gathers_ago: u32,
    }

    /// The reference at one time, after interpolation.
    pub struct ReferenceSample "cdcr.ReferenceSample.v1" {
        /// Position in the base frame \[m\].
        position_m: [f64; 3],
        /// As in [`ReferencePoint`](crate::ReferencePoint).
        orientation: [f64; 4],
        /// [`codes::OrientationKind`](crate::codes::OrientationKind).
        orientation_kind: u32 [code OrientationKind],
        /// [`codes::ReferenceState`](crate::codes::ReferenceState).
        state: u32 [code ReferenceState],
    }

    /// The smooth approach to a reference that begins away from the tip or in motion.
    ///
    /// At a time t the plan follows the reference plus `offset_m` (1 - 10 s³ + 15 s⁴ - 6 s⁵), with s = (t - begin) /
    /// duration, plus `velocity_m_s` joining (p - 6 p³ + 8 p⁴ - 3 p⁵), with p = (t - begin) / joining; s and p are at
    /// most 1. Its orientation is that of the reference, turned in the base frame about `turn_rad` times the factor of
    /// `offset_m`. All zero while the reference itself is followed.
    pub struct Approach "cdcr.Approach.v1" {
        /// Release at which it began \[ns\].
        begin_ns: u64,
        /// How long the distance takes \[ns\].
        duration_ns: u64,
        /// How long joining the motion takes \[ns\].
        joining_ns: u64,
        /// Tip minus reference at the beginning \[m\].
        offset_m: [f64; 3],
        /// Velocity of what was followed before, minus that of the reference, at the beginning \[m/s\].
        velocity_m_s: [f64; 3],
        /// Rotation from the reference's orientation to the tip's at the beginning, axis times angle \[rad\].
        turn_rad: [f64; 3],
    }

    /// Result and effort of the solver in one cycle. All zero in cycles without a solve.
    pub struct SolverReport "cdcr.SolverReport.v1" {
        /// Cost of the solution, in the scale of the weights.
        cost: f64,
        /// Cost of the warm start.
        warm_cost: f64,
        /// Norm of the projected gradient at the solution.
        gradient_norm: f64,
        /// How far the solution breaks its worst constraint: \[m\] of clearance, or parts of a limit.
        violation: f64,
        /// Seed of this cycle's swarm: a function of `settings.seed` and the cycle.
        seed: u64,
        /// Cost evaluations.
        evaluations: u32,
        /// Budget checks that were passed. A replay with a budget of this many checks does the same
        /// work, whatever its clock says.
        quanta: u32,
        /// Swarm iterations.
        iterations: u32,
        /// Gauss-Newton steps that were accepted.
        refinements: u32,
        /// [`codes::SolverStatus`](crate::codes::SolverStatus).
        status: u32 [code SolverStatus],
        /// [`codes::Winner`](crate::codes::Winner): which candidate the solution descends from.
        winner: u32 [code Winner],
        /// [`codes::Constraint`](crate::codes::Constraint): which constraint the solution breaks.
        violated: u32 [code Constraint],
        /// 1 when the budget ended the solve, whatever the status.
        budget_spent: u32 [yes],
    }

    /// Effects of the operating system on the cycle thread between the previous record and this one, read by the
    /// exchange.
    #[derive(Eq)]
    pub struct SchedulingReport "cdcr.SchedulingReport.v1" {
        /// Time that the thread was ready to run and another had the core \[ns\].
        run_delay_ns: u64,
        /// Time that it ran \[ns\].
        on_core_ns: u64,
        /// Longest time between two clock reads \[ns\], from the start of the cycle to the end of the solve, work included. Far
        /// longer than a quantum of work (a few µs): the processor stood still.
        longest_gap_ns: u64,
        /// Page faults, minor and major, since they were last read: in each late cycle, while there
        /// are some, and in one of 16 others.
        page_faults: u32,
        /// Times that it lost the core other than by its sleep.
        switches: u32,
        /// [`codes::LateCause`](crate::codes::LateCause): what made the cycle late.
        late_cause: u32 [code LateCause],
        /// 1 when the numbers above could be read.
        known: u32 [yes],
    }

    /// The complete record of one cycle: inputs as used, outputs, timing, mode, fault.
    ///
    /// It holds every input of the cycle except the reference. That is reproduced from the clients' chunks in the order
    /// of the events of the records; see `docs/replay.md`.
    pub struct Telemetry "cdcr.Telemetry.v15" {
        /// The daemon, number of the record, time of publication.
        header: Header,

        // ---- timing
        /// Number of the cycle on the grid: release = origin + cycle · period.
        cycle: u64,
        /// Release time r of this cycle \[ns, `CLOCK_MONOTONIC`\]: what was measured, predicted and commanded
        /// refers to it.
        release_ns: u64,
        /// The release that the thread slept for \[ns\]. Earlier than `release_ns` when it slept through whole
        /// periods; lateness counts from here, so a stall cannot hide behind the newest release.
        due_ns: u64,
        /// The cycle started s \[ns\].
        start_ns: u64,
        /// The solver began \[ns\].
        solve_start_ns: u64,
        /// The solver ended \[ns\].
        solve_end_ns: u64,
        /// The command was handed over p \[ns\].
        handed_over_ns: u64,
        /// Period T \[ns\].
        period_ns: u64,
        /// Time since the release of the previous cycle that ran \[ns\]: a multiple of the period.
        elapsed_ns: u64,
        /// Periods skipped between the previous cycle and this one.
        skipped_periods: u32,
        /// [`codes::timing`](crate::codes::timing) bits: late start, deadline miss, stale inputs.
        timing_flags: u32 [bits timing],
        /// Deadline misses since the start.
        deadline_misses_total: u64,
        /// Skipped periods since the start.
        skipped_periods_total: u64,
        /// What the system did to the cycle thread, and what made the cycle late.
        scheduling: SchedulingReport,

        // ---- mode
        /// [`codes::Mode`](crate::codes::Mode) in which the command was made.
        mode: u32 [code Mode],
        /// [`codes::Reason`](crate::codes::Reason) why this mode.
        reason: u32 [code Reason],
        /// Level of the leaky bucket of deadline misses.
        miss_bucket: u32,
        /// Events of this record, 0 ..= [`EVENTS_MAX`].
        event_count: u32 [length],

        // ---- inputs as used
        /// Number of the gather whose inputs the cycle used.
        gather: u64,
        /// The clock of that gather \[ns, `CLOCK_MONOTONIC`\].
        gather_ns: u64,
        /// What the daemon took in since the last record; the first `event_count` are used.
        events: [InputEvent; EVENTS_MAX] [used 1 event_count],
        /// The measurement as used, header zero; `kind` 0 when there was none. The simulated robot measures
        /// its own configuration.
        measurement: Measurement,
        /// Estimated bend vector that the commands up to this release lead to \[rad\]: what the next one is planned from. Of motors
        /// without lag and delay it is the one at the release.
        bend_rad: [f64; COORDINATES_MAX] [used 2 command.sections],
        /// Rates of the previous command \[rad/s\]; zero if the last one sent has run out.
        previous_rate_rad_s: [f64; COORDINATES_MAX] [used 2 command.sections],
        /// The solver's settings in this cycle.
        settings: SolverSettings,
        /// The robot of the daemon's configuration.
        robot: RobotDescription,
        /// First cycle of the reference window: the samples reach from its release past the horizon, by up to 60
        /// periods (60 at 5 ms).
        window_first_cycle: u64,
        /// How fast rates shrink when holding or stopping \[rad/s²\].
        deceleration_rad_s2: f64,
        /// Rate of the fastest component on the way home \[rad/s\].
        home_rate_rad_s: f64,
        /// Deadline after the release \[ns\].
        deadline_ns: u64,
        /// A start later than this after the release it was due at is a late start \[ns\].
        late_start_ns: u64,
        /// A measurement older than this is lost \[ns\].
        measurement_timeout_ns: u64,
        /// A clearance below this is a fault \[m\].
        clearance_fault_m: f64,
        /// How far a measurement may jump \[rad\].
        measurement_jump_rad: f64,
        /// How far the robot may be commanded while the measurement stands still \[rad\].
        measurement_frozen_rad: f64,
        /// This many consecutive jumps are a fault.
        measurement_jump_limit: u32,
        /// [`codes::MeasurementState`](crate::codes::MeasurementState).
        measurement_state: u32 [code MeasurementState],
        /// Level at which the leaky bucket stops the robot; 0: it does not.
        miss_limit: u32,
        /// [`codes::LeaseState`](crate::codes::LeaseState).
        lease_state: u32 [code LeaseState],
        /// Scalars of `warm_plan` and `plan` that are used; 0: the solver did not run.
        plan_length: u32 [length],
        /// Obstacles of this cycle, 0 ..= [`OBSTACLES_MAX`].
        obstacle_count: u32 [length],
        /// The obstacles as used, in this order, where they are at the release (plan and guard look at them `reference_lead_ns` later): `measured_ns` is the release,
        /// `lifetime_ns` what is left of their lifetime then, 0: until removed. The first `obstacle_count` are
        /// used.
        obstacles: [Obstacle; OBSTACLES_MAX] [used 1 obstacle_count],
        /// The plan that the solver started from \[rad/s\], block by block.
        warm_plan: [f64; PLAN_MAX] [unit "rad/s"] [used 1 plan_length],

        // ---- outputs
        /// The solution \[rad/s\], block by block.
        plan: [f64; PLAN_MAX] [unit "rad/s"] [used 1 plan_length],
        /// What the solver did.
        report: SolverReport,
        /// Reference at the release.
        reference: ReferenceSample,
        /// The way to it that the plan follows.
        approach: Approach,
        /// Bend vector at the release \[rad\]: behind `bend_rad` by the lag of the motors behind their commands.
        present_rad: [f64; COORDINATES_MAX] [used 2 command.sections],
        /// The tip as it was measured beside bends or cables \[m\]; zero when it was not.
        tip_measured_m: [f64; 3],
        /// When the tip of `tip_measured_m` was measured \[ns, `CLOCK_MONOTONIC`\].
        tip_measured_ns: u64,
        /// Offset of the measured tip from where the bends place it, smoothed \[m\]. The plan's reference is moved back by it.
        tip_offset_m: [f64; 3],
        /// Distance that the tip may have from where the bends place it \[m\]: the length of `tip_offset_m`, and three standard deviations of its uncertainty. For plan and guard the body is thicker by this distance.
        tip_margin_m: f64,
        /// Tip position at the release, from `present_rad` and `tip_offset_m` \[m\].
        tip_position_m: [f64; 3],
        /// Tip orientation at the release, unit quaternion (x, y, z, w).
        tip_orientation: [f64; 4],
        /// Distance of tip and reference at the release \[m\]; NaN without a reference.
        position_error_m: f64,
        /// [`codes::guard`](crate::codes::guard) bits: which limits changed the command that the mode wanted.
        guard_flags: u32 [bits guard],
        /// [`codes::MeasurementState`](crate::codes::MeasurementState): what became of `tip_measured_m`.
        tip_state: u32 [code MeasurementState],
        /// Smallest distance at the release between the surfaces of body and obstacles, from `present_rad` and
        /// `obstacles` \[m\]: negative inside one, infinite without obstacles, NaN when `present_rad` is not
        /// finite. The body counts as thicker by `tip_margin_m`.
        clearance_m: f64,
        /// The command as it left.
        command: Command,
        /// Commanded bend vector at the release \[rad\]: `command.bend_target_rad` is one period later.
        commanded_rad: [f64; COORDINATES_MAX] [used 2 command.sections],
        /// Following error of each section \[rad\]: how far the measured bend vector is from every commanded one of the last
        /// `following_lag_ns`, so that a lag of the motors up to that is not an error. Zero while only the tip is measured.
        following_error_rad: [f64; SECTIONS_MAX] [used 1 command.sections],
        /// The same of each cable \[m\]. Where positions are obeyed and lengths measured, with the difference of the section's mean length from the
        /// commanded one, which is not an error of a bend.
        following_error_m: [f64; CABLES_MAX] [used 3 command.sections],
        /// A following error above this is a warning \[rad\].
        following_warning_rad: f64,
        /// A following error above this is a fault \[rad\].
        following_fault_rad: f64,
        /// How far the motors may lag behind \[ns\].
        following_lag_ns: u64,
        /// Largest acceleration of a component \[rad/s²\]; infinite: no limit.
        acceleration_rad_s2: f64,
        /// How far ahead of the reference the motors are commanded \[ns\]: the delay and time constant of `[actuator]` together.
        reference_lead_ns: u64,
        /// Time constant of the motors \[ns\]: `reference_lead_ns` less their delay.
        motor_time_constant_ns: u64,
        /// Bend vector at the end of the motors' delay \[rad\], where this cycle's command begins to act.
        delayed_rad: [f64; COORDINATES_MAX] [used 2 command.sections],
        /// Where the commands up to this release lead the motors \[rad\]: `bend_rad` differs from that by the play of the cables.
        motor_rad: [f64; COORDINATES_MAX] [used 2 command.sections],
        /// Used part of that play there: each cable minus its motor \[m\].
        slack_m: [f64; CABLES_MAX] [used 3 command.sections],
        /// Play of the cables \[m\]; 0: none.
        play_m: f64,
        /// Commanded position minus the place of the robot where control begins after a reset \[rad\], while `moves_to_begin` is set: the
        /// rates wanted are those of homing from there.
        way_rad: [f64; COORDINATES_MAX] [used 2 command.sections],
        /// A reference farther from the tip than this is not approached \[m\]; infinite: it is, from anywhere.
        approach_distance_m: f64,
        /// Largest speed of a tip that is behind its reference and returns to it, in the newest cycle that solved \[m/s\]; infinite: no limit.
        pace_m_s: f64,
        /// 1 where a latched mode was left and control has not begun since: a following error is not a fault then.
        control_begins: u32 [yes],
        /// 1 while the commanded position moves to where control begins after a reset.
        moves_to_begin: u32 [yes],
        /// 1 where the last command had run out when the solve ended: limits and ramp count from rest, the solve from
        /// `previous_rate_rad_s`.
        ran_out_in_solve: u32 [yes],
        /// Number of the reference lease: counted as leases are acquired. Tracking ends where it changes.
        lease_number: u32,
        /// 1 where a reset has to accept the pose: a section is measured more than 0.2 rad from where the last command left it, or the
        /// daemon before this one ended in such a pose.
        pose_differs: u32 [yes],
        /// 1 where the newest measurement was rejected as a jump: a reset is refused then.
        measurement_rejected: u32 [yes],
        /// 1 where the reference at the release is too far from the tip to be tracked.
        reference_too_far: u32 [yes],
        /// [`codes::TipCause`](crate::codes::TipCause): why the newest `tip_measured_m` was not used, also in the cycles until the next one.
        tip_cause: u32 [code TipCause],
        /// Distance of the measured tip from where the measured bends place it \[m\], where it is so far that a reset is refused (the
        /// reason `TipElsewhere`); 0: it is not.
        tip_contradiction_m: f64,
    }
}
