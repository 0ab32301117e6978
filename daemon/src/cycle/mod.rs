//! One cycle: the order of its steps.
//!
//! ```text
//! measure → estimate → mode → solve → make safe → command → record
//! ```
//!
//! Invariant: nothing here allocates, locks, logs, panics or makes a system call. The record contains all
//! inputs of its decisions, so that the cycle can be replayed.

mod observation;
mod own_costs;
mod present_clearance;
mod rehearsal;
mod requests;
mod safe;
mod silence;
mod state;
mod tip_watch;
mod tracking;
mod unsent;
mod warm_up;

use cdcr_controller::nmpc::{Nmpc, OBSTACLES_MAX, SolveReport, SolveStatus};
use cdcr_controller::reference::FollowedReference;
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Robot};
use cdcr_controller::safety::{Mode, ModeMachine, Reason, homing_rates, ramp_to_zero};

use crate::accounting::Accounting;
use crate::config::{Validated, ns};
use crate::core_budget::{CoreBudget, Costs, RecentCosts};
use crate::handover::{
    CycleFacts, CycleInputs, CycleRecord, CycleRequest, Policy, RuntimeSettings,
};
use crate::link::CycleRobot;
use crate::obstacles::ObstacleSet;
use crate::rt::clock::Clock;
use crate::rt::schedule::Release;
use rehearsal::Rehearsal;
use state::RobotState;
use unsent::LastSent;

#[derive(Debug)]
pub struct Cycle {
    robot: Robot,
    link: CycleRobot,
    state: RobotState,
    rehearsal: Rehearsal,
    last_sent: LastSent,
    modes: ModeMachine,
    nmpc: Nmpc,
    budget_ns: u64,
    accounting: Accounting,
    policy: Policy,
    period_ns: u64,
    core_budget: CoreBudget,
    /// Cost from the end of the solver until the thread sleeps.
    costs_after_solve: RecentCosts,
    /// Cost of the newest cycle after the solver \[ns\], until the scheduler's count shows whether the thread
    /// lost its core.
    took_after_solve_ns: Option<u64>,
    /// Interruption count in the inputs of the newest cycle.
    interruptions: u64,
    /// Time by which the solver had to end \[ns\]; 0: it did not run.
    solve_until_ns: u64,
    /// Start of the work that follows the solver \[ns\].
    solve_over_ns: u64,
    settings_revision: u64,
    last_gather: Option<u64>,
    /// Number of stops carried out.
    stops: u64,
    /// A signal requested one more stop.
    stop_signalled: bool,
    /// Start of the last cycle in which a stop was requested or the robot was latched \[ns\].
    latched_ns: u64,
    /// Duration of the current series of cycles without new inputs \[ns\].
    stale_ns: u64,
    /// The robot left a latched mode, and control has not begun since.
    control_begins: bool,
    /// The daemon before this one left the pose uncertain.
    pose_is_uncertain: bool,
    /// Suspend count of the machine at the last cycle.
    suspends: u64,
    clearance: present_clearance::PresentClearance,
    longest_gap_ns: u64,
    previous_release_ns: Option<u64>,
    /// The last command; zero if it has run out.
    rates: BendRates,
    /// Obstacles of this cycle, at their places at its release.
    known_obstacles: ObstacleSet,
    /// The same obstacles at the time when the robot reaches the configuration to which its commands lead it.
    obstacles: Vec<Obstacle>,
    followed: FollowedReference,
}

impl Cycle {
    /// A controller at rest. Allocates all memory that it ever uses.
    ///
    /// # Errors
    ///
    /// The solver's settings are out of range; a validated configuration excludes this.
    pub fn new(
        validated: &Validated,
        link: CycleRobot,
    ) -> Result<Self, cdcr_controller::nmpc::SettingsError> {
        let Validated {
            config,
            robot,
            initial,
            ..
        } = validated;
        let period_ns = ns(config.cycle.period_ms);
        let policy = Policy::new(config);
        let settings = RuntimeSettings::new(config);
        let state = RobotState::new(robot.clone(), policy, period_ns, *initial);
        let followed = FollowedReference::new(policy.approach);
        Ok(Self {
            link,
            last_sent: LastSent::new(&state),
            state,
            rehearsal: Rehearsal::new(
                RobotState::new(robot.clone(), policy, period_ns, *initial),
                followed.clone(),
            ),
            control_begins: false,
            pose_is_uncertain: false,
            stale_ns: 0,
            suspends: 0,
            modes: ModeMachine::default(),
            nmpc: Nmpc::new(robot.clone(), period_ns as f64 * 1e-9, settings.nmpc)?,
            budget_ns: settings.budget_ns,
            accounting: Accounting::new(policy.limits()),
            policy,
            period_ns,
            core_budget: CoreBudget::new(config),
            costs_after_solve: RecentCosts::default(),
            took_after_solve_ns: None,
            interruptions: 0,
            solve_until_ns: 0,
            solve_over_ns: 0,
            settings_revision: 0,
            last_gather: None,
            stops: 0,
            stop_signalled: false,
            latched_ns: 0,
            clearance: present_clearance::PresentClearance::default(),
            longest_gap_ns: 0,
            previous_release_ns: None,
            rates: BendRates::zero(robot.section_count()),
            known_obstacles: ObstacleSet::default(),
            obstacles: Vec::with_capacity(OBSTACLES_MAX),
            followed,
            robot: robot.clone(),
        })
    }

    /// Sets the share of the core that the kernel leaves to real-time threads.
    #[must_use]
    pub fn with_kernel_share(mut self, share: f64) -> Self {
        self.core_budget = self.core_budget.with_kernel_share(share);
        self
    }

    /// Starts latched for this reason: the robot needs a reset.
    #[must_use]
    pub fn stopped_before(mut self, reason: Reason) -> Self {
        self.modes = ModeMachine::stopped_before(reason);
        self
    }

    /// The last command was zero rates.
    pub fn is_at_rest(&self) -> bool {
        self.rates.as_slice().iter().all(|rate| *rate == 0.0)
    }

    /// Stops the robot in the next cycle, as if the stop count in its inputs had grown.
    pub fn stop(&mut self) {
        self.stop_signalled = true;
    }

    /// Brings the robot to rest because the process ends.
    pub fn shut_down(&mut self) {
        self.modes.shut_down();
    }

    /// Runs the cycle of `release` and writes its record. Takes at most
    /// [`REQUESTS_PER_CYCLE`](crate::handover::REQUESTS_PER_CYCLE) requests from `next_request`; in a cycle
    /// with a counted stop, all that wait.
    pub fn run_into<'a>(
        &mut self,
        memory: &'a mut Option<CycleRecord>,
        release: Release,
        inputs: &CycleInputs,
        next_request: impl FnMut() -> Option<CycleRequest>,
        clock: &impl Clock,
    ) -> &'a CycleRecord {
        let facts = self.step(release, inputs, next_request, clock);
        let solved = facts.report.status != SolveStatus::Idle;
        let plans: [&[f64]; 2] = if solved {
            [self.nmpc.warm_plan(), self.nmpc.plan()]
        } else {
            [&[]; 2]
        };
        let record = memory.get_or_insert_with(|| CycleRecord::new(facts));
        record.write(facts, &self.known_obstacles, plans);
        record
    }

    /// Same as [`run_into`](Self::run_into), but returns the record by value.
    pub fn run(
        &mut self,
        release: Release,
        inputs: &CycleInputs,
        next_request: impl FnMut() -> Option<CycleRequest>,
        clock: &impl Clock,
    ) -> CycleRecord {
        *self.run_into(&mut None, release, inputs, next_request, clock)
    }

    fn step(
        &mut self,
        release: Release,
        inputs: &CycleInputs,
        next_request: impl FnMut() -> Option<CycleRequest>,
        clock: &impl Clock,
    ) -> CycleFacts {
        let elapsed_ns = self.elapsed_ns(&release);
        let stale_inputs = self.count_stale(inputs);
        self.take_settings(inputs);
        self.learn_cost(inputs, stale_inputs);
        let measurement = self.link.measure(release.release_ns, inputs);
        self.state.count_silence(measurement, inputs);
        self.move_on(elapsed_ns);
        self.state.following.latch(self.modes.mode().is_latched());
        let measurement_use = self.state.measure(measurement, release.release_ns);
        let tip_measurement = self.link.measure_tip(release.release_ns, inputs);
        let tip_use = (self.state).measure_tip(tip_measurement, inputs, release.release_ns);
        self.state.locate(elapsed_ns);
        self.place_obstacles(inputs, &release);

        let reference = inputs.window.get(release.cycle);
        let seen = self.observe(measurement, &reference, inputs);
        let (control_begins, mode_before) = (self.control_begins, self.modes.mode());
        let following = *self.state.following().error();
        self.modes.observe(&seen);
        self.note_latch(mode_before, &release);
        let answers = self.answer(next_request, inputs, &seen, &release);
        self.begin_control(mode_before.is_latched());

        let (configuration, present) = (*self.state.configuration(), *self.state.present());
        let solve_start_ns = clock.now_ns();
        self.rest_if_run_out_by(solve_start_ns, &release, elapsed_ns);
        let previous_rates = self.rates;
        self.longest_gap_ns = solve_start_ns - release.start_ns;
        self.solve_until_ns = 0;
        let (costs, way) = (self.costs(inputs), self.way_to_begin(inputs));
        let (mut desired_rates, report) =
            self.desired_rates(&release, inputs, way.as_ref(), elapsed_ns, costs, clock);
        let comes_to_rest = self.modes.mode().comes_to_rest() && way.is_none();
        let solve_end_ns = clock.now_ns();
        self.solve_over_ns = solve_end_ns.min(self.solve_until_ns);
        let ran_out_in_solve = self.rest_if_run_out_by(solve_end_ns, &release, elapsed_ns);
        // The solve may have found a fault, and a ramp does not begin again after a stall.
        if comes_to_rest || report.status == SolveStatus::NonFinite {
            desired_rates = self.ramp();
        }
        let safe = self.make_safe(&desired_rates, comes_to_rest);
        self.note_latch(mode_before, &release);
        self.command(release.release_ns, safe.rates);
        let handed_over_ns = clock.now_ns();
        let lateness = self
            .accounting
            .evaluate(&release, handed_over_ns, stale_inputs);

        CycleFacts {
            release,
            rehearsed: core::mem::take(&mut self.rehearsal.took_place),
            solve_start_ns,
            solve_end_ns,
            handed_over_ns,
            elapsed_ns,
            solve_until_ns: self.solve_until_ns,
            core_budget: self.core_budget,
            costs,
            longest_gap_ns: self.longest_gap_ns,
            lateness,
            stale_inputs,
            totals: *self.accounting.totals(),
            miss_bucket: self.accounting.bucket().level(),
            seen,
            control_begins,
            mode: self.modes.mode(),
            faults: self.modes.faults(),
            gather: inputs.gather,
            gather_ns: inputs.gather_ns,
            window_first_cycle: inputs.window.first_cycle(),
            lease: inputs.lease,
            lease_number: inputs.lease_number,
            policy: self.policy,
            measurement,
            measurement_use,
            frozen_channel: self.state.frozen_channel,
            tip_measurement,
            tip_use,
            tip_unused: self.state.tip_watch.unused(),
            tip_offset_m: self.state.tip_offset_m(),
            tip_margin_m: self.state.tip_margin_m(),
            tip: self.state.tip(),
            present,
            delayed: *self.state.delayed(),
            motors: *self.state.motors(),
            slack: self.state.commanded_slack().copied(),
            configuration,
            commanded: *self.state.commanded(),
            following,
            previous_rates,
            ran_out_in_solve,
            way,
            reference,
            approach: *self.followed.approach(),
            pace_m_s: self.nmpc.pace_m_s(),
            settings: self.settings(),
            report,
            rates: safe.rates,
            limits_hit: safe.limits_hit,
            clearance_hit: safe.clearance_hit,
            clearance_m: self.clearance.estimated_m,
            measured_clearance_m: self.clearance.measured_m,
            answers,
        }
    }

    fn elapsed_ns(&mut self, release: &Release) -> u64 {
        let previous = self.previous_release_ns.replace(release.release_ns);
        previous.map_or(self.period_ns, |previous| release.release_ns - previous)
    }

    /// Settings change between two cycles, all at once. The exchange has validated them.
    fn take_settings(&mut self, inputs: &CycleInputs) {
        if inputs.settings_revision != self.settings_revision {
            self.settings_revision = inputs.settings_revision;
            // Rejected settings leave the old ones in force; the record contains the settings in force.
            if self.nmpc.configure(inputs.settings.nmpc).is_ok() {
                self.budget_ns = inputs.settings.budget_ns;
            }
        }
    }

    fn settings(&self) -> RuntimeSettings {
        RuntimeSettings {
            nmpc: *self.nmpc.settings(),
            budget_ns: self.budget_ns,
        }
    }

    /// Places the obstacles of this cycle at its release. The list has the capacity for all of them.
    fn place_obstacles(&mut self, inputs: &CycleInputs, release: &Release) {
        let known = inputs.obstacles.iter_at(release.release_ns);
        self.known_obstacles.fill(known);
        self.obstacles.clear();
        // The robot reaches the commanded configuration later, by the lag of its motors.
        let lead_s = self.policy.reference_lead_ns as f64 * 1e-9;
        let shapes = self.known_obstacles.iter();
        self.obstacles
            .extend(shapes.map(|known| known.obstacle.moved(lead_s)));
    }

    /// Restarts control after a latched mode. The robot first completes its ramp, and lagging motors complete
    /// their motion, unless a request to move comes earlier. A commanded position elsewhere then moves to the robot.
    fn begin_control(&mut self, was_latched: bool) {
        let mode = self.modes.mode();
        self.end_uncertainty();
        self.control_begins = (self.control_begins || was_latched) && !mode.is_latched();
        if !self.control_begins {
            self.state.give_up_way();
            return;
        }
        if self.is_at_rest() && self.state.has_arrived() {
            self.state.end_way_beside();
            if self.state.is_commanded_elsewhere() {
                // From the next cycle on, whose record states that control begins.
                if !was_latched {
                    self.state.set_out();
                }
                return;
            }
            self.control_begins = false;
            self.state.take_control();
            self.rehearsal.state.take_control();
            self.begin_unsent();
        } else if matches!(mode, Mode::Tracking { .. } | Mode::Homing) {
            self.control_begins = false;
            // On the ramp the commanded position must not step back by the lag of the motors.
            if self.is_at_rest() {
                self.state.take_control_moving();
                self.begin_unsent();
            }
        }
    }

    /// The commanded position, seen from where control begins, while it moves there.
    fn way_to_begin(&self, inputs: &CycleInputs) -> Option<Configuration> {
        let waits = self.has_stale_inputs() || inputs.obstacle_source_silent;
        let holds = matches!(self.modes.mode(), Mode::Holding { .. }) && !waits;
        self.state.way_to_begin().filter(|_| holds)
    }

    fn desired_rates(
        &mut self,
        release: &Release,
        inputs: &CycleInputs,
        way: Option<&Configuration>,
        elapsed_ns: u64,
        costs: Costs,
        clock: &impl Clock,
    ) -> (BendRates, SolveReport) {
        let rates = match self.modes.mode() {
            Mode::Tracking { .. } => return self.track(release, inputs, elapsed_ns, costs, clock),
            Mode::Homing => self.rates_home(self.state.configuration()),
            Mode::Starting | Mode::Holding { .. } | Mode::Stopped { .. } | Mode::Faulted { .. } => {
                way.map_or_else(|| self.ramp(), |way| self.rates_home(way))
            }
        };
        self.nmpc.forget_plan();
        self.followed.forget();
        self.rehearsal.followed.forget();
        (rates, SolveReport::default())
    }

    /// The next rates on the straight line from `from` to zero.
    fn rates_home(&self, from: &Configuration) -> BendRates {
        let period_s = self.period_ns as f64 * 1e-9;
        homing_rates(
            &self.robot,
            from,
            &self.rates,
            self.policy.home_rate_rad_s,
            self.policy.acceleration_rad_s2 * period_s,
            period_s,
        )
    }

    /// The next rates of the ramp to rest.
    fn ramp(&self) -> BendRates {
        let period_s = self.period_ns as f64 * 1e-9;
        ramp_to_zero(&self.rates, self.policy.deceleration_rad_s2, period_s)
    }
}

#[cfg(test)]
mod tests;
