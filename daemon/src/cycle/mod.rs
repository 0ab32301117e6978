//! One cycle of 5 ms: the order of its steps, and nothing else.
//!
//! ```text
//! measure → estimate → mode → solve → limit → keep clear → command → record
//! ```
//!
//! Invariant: nothing here allocates, locks, logs, panics or calls the system. What it decides by is
//! in the record, so that the cycle can be computed again.

mod policy;
mod record;

use cdcr_controller::estimator::Estimator;
use cdcr_controller::nmpc::{Nmpc, OBSTACLES_MAX, PLAN_MAX, SolveInput, SolveReport, SolveStatus};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{BendRates, Obstacle, Robot, Shape};
use cdcr_controller::safety::{
    Guarded, Limited, MeasurementWatch, Mode, ModeMachine, Observation, Plausibility, Reason,
    Refusal, guard, guard_ramp, homing_rates, limit, ramp_to_zero, shorten,
};
use nalgebra::Vector3;

use crate::config::{Validated, ns};
use crate::obstacles::ObstacleSet;
use crate::ports::{Clock, RobotLink, TimedMeasurement};
use crate::rt::accounting::Accounting;
use crate::rt::handoff::{
    CycleAnswer, CycleInputs, CycleRequest, REQUESTS_PER_CYCLE, REQUESTS_WAITING,
};
use crate::rt::schedule::Release;
pub use policy::{Policy, Settings};
pub use record::{CycleRecord, MeasurementUse};

/// A bend may be measured this much beyond its limit before it is a fault \[rad\]: sensor noise.
const BEND_TOLERANCE_RAD: f64 = 0.05;
/// All bends below this are straight at once \[rad\].
const HOME_EXACT_RAD: f64 = 1e-6;
/// A robot whose bends are all within the tolerance for this long is straight, too: sensors have noise \[ns\].
const HOME_SETTLED_NS: u64 = 100_000_000;
/// Longest time that the solver is warmed up \[ns\].
const WARM_UP_MAX_NS: u64 = 300_000_000;

/// The controller of one robot, cycle by cycle.
#[derive(Debug)]
pub struct Cycle<L> {
    robot: Robot,
    link: L,
    estimator: Estimator,
    modes: ModeMachine,
    watch: MeasurementWatch,
    nmpc: Nmpc,
    budget_ns: u64,
    accounting: Accounting,
    policy: Policy,
    period_ns: u64,
    budget_margin_ns: u64,
    settings_revision: u64,
    last_gather: Option<u64>,
    last_gather_ns: u64,
    /// Stops that were asked for when the last cycle ran.
    stops: u64,
    last_measured_ns: u64,
    /// Time of gathers without a fresh measurement \[ns\].
    unmeasured_ns: u64,
    /// How long the robot has been straight within the tolerance \[ns\].
    straight_ns: u64,
    /// What the measurement of this cycle shows.
    measurement_fault: Option<Reason>,
    /// Clearance in the cycle before \[m\].
    clearance_m: f64,
    longest_gap_ns: u64,
    previous_release_ns: Option<u64>,
    rates: BendRates,
    /// Those of this cycle, where they are at its release.
    obstacles: Vec<Obstacle>,
}

impl<L: RobotLink> Cycle<L> {
    /// A controller at rest. All memory that it will ever use is taken here.
    ///
    /// # Errors
    /// When the solver's settings are out of range, which a validated configuration excludes.
    pub fn new(
        validated: &Validated,
        link: L,
    ) -> Result<Self, cdcr_controller::nmpc::SettingsError> {
        let Validated {
            config,
            robot,
            initial,
            ..
        } = validated;
        let period_ns = ns(config.cycle.period_ms);
        let policy = Policy::new(config);
        let settings = Settings::new(config);
        Ok(Self {
            link,
            estimator: Estimator::new(*initial),
            modes: ModeMachine::default(),
            watch: MeasurementWatch::new(policy.plausibility),
            nmpc: Nmpc::new(robot.clone(), period_ns as f64 * 1e-9, settings.nmpc)?,
            budget_ns: settings.budget_ns,
            accounting: Accounting::new(policy.limits()),
            policy,
            period_ns,
            budget_margin_ns: config.cycle.budget_margin_ns(),
            settings_revision: 0,
            last_gather: None,
            last_gather_ns: 0,
            stops: 0,
            last_measured_ns: 0,
            unmeasured_ns: 0,
            straight_ns: 0,
            measurement_fault: None,
            clearance_m: f64::INFINITY,
            longest_gap_ns: 0,
            previous_release_ns: None,
            rates: BendRates::zero(robot.section_count()),
            obstacles: Vec::with_capacity(OBSTACLES_MAX),
            robot: robot.clone(),
        })
    }

    /// Runs code and data of the solver once, so that the first real solve finds them in memory.
    pub fn warm_up(&mut self, clock: &impl Clock) {
        let end_ns = clock.now_ns() + WARM_UP_MAX_NS;
        let tip_m = self
            .robot
            .tip_position(self.estimator.configuration().as_slice());
        let sample = ReferenceSample {
            state: cdcr_controller::reference::ReferenceState::Inside,
            position_m: tip_m * 0.99,
            ..ReferenceSample::default()
        };
        let shape = Shape::Sphere {
            centre_m: tip_m * 1.05,
        };
        let obstacle = Obstacle::new(shape, 0.01, Vector3::zeros()).ok();
        for seed in 0..20 {
            let input = SolveInput {
                configuration: self.estimator.configuration(),
                previous_rates: &self.rates,
                reference: &[sample],
                obstacles: obstacle.as_slice(),
                elapsed_periods: 1,
                seed,
            };
            let mut budget = Budget::new(|| clock.now_ns() >= end_ns);
            self.nmpc.solve(&input, &mut budget);
        }
        self.nmpc.forget_plan();
    }

    /// Whether the robot rests: the last command was zero rates.
    pub fn is_at_rest(&self) -> bool {
        self.rates.as_slice().iter().all(|rate| *rate == 0.0)
    }

    /// The process ends: bring the robot to rest.
    pub fn shut_down(&mut self) {
        self.modes.shut_down();
    }

    /// Runs the cycle of `release`. Takes requests from `next_request` until it has no more, at most
    /// [`REQUESTS_PER_CYCLE`].
    pub fn run(
        &mut self,
        release: Release,
        inputs: &CycleInputs,
        next_request: impl FnMut() -> Option<CycleRequest>,
        clock: &impl Clock,
    ) -> CycleRecord {
        let elapsed_ns = self.elapsed_ns(&release);
        let stale_inputs = self.last_gather.replace(inputs.gather) == Some(inputs.gather);
        self.take_settings(inputs);
        let measurement = self.link.measure(release.release_ns, inputs);
        self.count_silence(measurement, inputs);
        let measurement_use = self.estimate(measurement, &release, elapsed_ns);
        self.count_straight(elapsed_ns);
        let obstacles = self.place_obstacles(inputs, &release);

        let reference = inputs.window.at(release.cycle);
        let seen = self.observe(measurement, &reference, inputs);
        self.modes.observe(&seen);
        let answers = self.answer(next_request, inputs, &seen);

        let previous_rates = self.rates;
        let configuration = *self.estimator.configuration();
        let solve_start_ns = clock.now_ns();
        self.longest_gap_ns = solve_start_ns - release.start_ns;
        // A mode that comes to rest, and one that moves: a fault that the solve finds still ends in zero rates.
        let comes_to_rest = self.modes.mode().comes_to_rest();
        let (wish, report) = self.wish(&release, inputs, elapsed_ns, clock);
        let solve_end_ns = clock.now_ns();

        let limited = self.limit(&wish, comes_to_rest);
        let guarded = self.keep_clear(&limited.rates, comes_to_rest);
        self.rates = guarded.rates;
        self.clearance_m = guarded.clearance_m;
        self.link.command(release.release_ns, &guarded.rates);
        let handed_over_ns = clock.now_ns();
        let verdict = self.accounting.judge(&release, handed_over_ns);

        let mut record = CycleRecord {
            release,
            solve_start_ns,
            solve_end_ns,
            handed_over_ns,
            elapsed_ns,
            longest_gap_ns: self.longest_gap_ns,
            verdict,
            stale_inputs,
            totals: *self.accounting.totals(),
            miss_bucket: self.accounting.bucket().level(),
            mode: self.modes.mode(),
            faults: self.modes.faults(),
            gather: inputs.gather,
            gather_ns: inputs.gather_ns,
            window_first_cycle: inputs.window.first_cycle(),
            lease: inputs.lease,
            policy: self.policy,
            measurement,
            measurement_use,
            tip: self.robot.tip_pose(&configuration),
            configuration,
            previous_rates,
            reference,
            obstacles,
            settings: self.settings(),
            report,
            plan_length: 0,
            warm_plan: [0.0; PLAN_MAX],
            plan: [0.0; PLAN_MAX],
            rates: guarded.rates,
            limits_hit: limited.hit,
            clearance_hit: guarded.hit,
            clearance_m: guarded.clearance_m,
            answers,
        };
        self.copy_plans(&mut record);
        record
    }

    fn elapsed_ns(&mut self, release: &Release) -> u64 {
        let previous = self.previous_release_ns.replace(release.release_ns);
        previous.map_or(self.period_ns, |previous| release.release_ns - previous)
    }

    /// Settings change between two cycles, whole. The exchange has validated them.
    fn take_settings(&mut self, inputs: &CycleInputs) {
        if inputs.settings_revision != self.settings_revision {
            self.settings_revision = inputs.settings_revision;
            // Refused settings leave the old ones in force, and the record shows which those are.
            if self.nmpc.configure(inputs.settings.nmpc).is_ok() {
                self.budget_ns = inputs.settings.budget_ns;
            }
        }
    }

    fn settings(&self) -> Settings {
        Settings {
            nmpc: *self.nmpc.settings(),
            budget_ns: self.budget_ns,
        }
    }

    /// Predicts where the robot is, and corrects that by a new measurement that it can have.
    fn estimate(
        &mut self,
        measurement: Option<TimedMeasurement>,
        release: &Release,
        elapsed_ns: u64,
    ) -> MeasurementUse {
        let elapsed_s = elapsed_ns as f64 * 1e-9;
        self.estimator.predict(&self.rates, elapsed_s);
        self.watch.commanded(&self.rates, elapsed_s);
        self.measurement_fault = None;
        let Some(TimedMeasurement {
            measurement,
            measured_ns,
        }) = measurement
        else {
            return MeasurementUse::None;
        };
        if measured_ns <= self.last_measured_ns {
            return MeasurementUse::Repeated;
        }
        self.last_measured_ns = measured_ns;
        match self.watch.judge(&self.robot, &measurement, measured_ns) {
            Plausibility::Jump => return MeasurementUse::Implausible,
            Plausibility::Lost => {
                self.measurement_fault = Some(Reason::MeasurementJump);
                return MeasurementUse::Implausible;
            }
            Plausibility::Frozen => self.measurement_fault = Some(Reason::MeasurementFrozen),
            Plausibility::Good => {}
        }
        let age_s = (release.release_ns as f64 - measured_ns as f64) * 1e-9;
        self.estimator.correct(&self.robot, &measurement, age_s);
        MeasurementUse::Used
    }

    /// Counts how long no fresh measurement has come, in time that gathers have seen: after a stall of the machine
    /// what the driver sent meanwhile must first be taken in.
    fn count_silence(&mut self, measurement: Option<TimedMeasurement>, inputs: &CycleInputs) {
        let passed_ns = inputs.gather_ns.saturating_sub(self.last_gather_ns);
        self.last_gather_ns = inputs.gather_ns;
        let Some(TimedMeasurement { measured_ns, .. }) = measurement else {
            return;
        };
        let age_ns = inputs.gather_ns.saturating_sub(measured_ns);
        let is_fresh =
            measured_ns > self.last_measured_ns && age_ns <= self.policy.measurement_timeout_ns;
        self.unmeasured_ns = if is_fresh {
            age_ns
        } else {
            self.unmeasured_ns + passed_ns.min(2 * self.period_ns)
        };
    }

    fn count_straight(&mut self, elapsed_ns: u64) {
        let tolerance_rad = self.policy.home_tolerance_rad;
        let bends = self.estimator.configuration().as_slice();
        let is_straight = bends.iter().all(|bend| bend.abs() < tolerance_rad);
        self.straight_ns = if is_straight {
            self.straight_ns.saturating_add(elapsed_ns)
        } else {
            0
        };
    }

    /// The obstacles of this cycle, moved on to its release. The list has room for all of them.
    fn place_obstacles(&mut self, inputs: &CycleInputs, release: &Release) -> ObstacleSet {
        let placed = inputs.obstacles.at(release.release_ns);
        self.obstacles.clear();
        let shapes = placed.iter().map(|known| known.obstacle);
        self.obstacles.extend(shapes.take(OBSTACLES_MAX));
        placed
    }

    fn observe(
        &self,
        measurement: Option<TimedMeasurement>,
        reference: &ReferenceSample,
        inputs: &CycleInputs,
    ) -> Observation {
        let bends = self.estimator.configuration().as_slice();
        Observation {
            measured: measurement.is_some(),
            reference: reference.state,
            lease: inputs.lease,
            at_home: bends.iter().all(|bend| bend.abs() < HOME_EXACT_RAD)
                || self.straight_ns >= HOME_SETTLED_NS,
            misses_overflow: self.policy.stops_on_misses() && self.accounting.bucket().overflows(),
            fault: self.fault(measurement),
        }
    }

    fn fault(&self, measurement: Option<TimedMeasurement>) -> Option<Reason> {
        // What was never measured is not lost: the machine waits for it.
        measurement?;
        if self.unmeasured_ns > self.policy.measurement_timeout_ns {
            return Some(Reason::MeasurementLost);
        }
        if self.measurement_fault.is_some() {
            return self.measurement_fault;
        }
        if self.clearance_m < self.policy.clearance_fault_m {
            return Some(Reason::ClearanceBroken);
        }
        let estimate = self.estimator.configuration();
        if !estimate.is_finite() {
            return Some(Reason::NonFinite);
        }
        let beyond = self
            .robot
            .sections()
            .iter()
            .enumerate()
            .any(|(index, section)| {
                estimate.bend_rad(index) > section.bend_max_rad + BEND_TOLERANCE_RAD
            });
        beyond.then_some(Reason::LimitBroken)
    }

    fn answer(
        &mut self,
        mut next_request: impl FnMut() -> Option<CycleRequest>,
        inputs: &CycleInputs,
        seen: &Observation,
    ) -> [Option<CycleAnswer>; REQUESTS_WAITING] {
        let stops = core::mem::replace(&mut self.stops, inputs.stops) != inputs.stops;
        // What was asked before a stop must not be carried out after it.
        let most = if stops {
            REQUESTS_WAITING
        } else {
            REQUESTS_PER_CYCLE
        };
        let mut asked = [None; REQUESTS_WAITING];
        asked[..most].fill_with(&mut next_request);
        let requests = asked.map(|asked: Option<CycleRequest>| asked.map(|asked| asked.request));
        let outcomes = self.modes.requests(&requests, stops, seen);
        let mut answers = [None; REQUESTS_WAITING];
        for (answer, (asked, outcome)) in answers.iter_mut().zip(asked.iter().zip(outcomes)) {
            *answer = asked.map(|CycleRequest { ticket, .. }| CycleAnswer {
                ticket,
                outcome: outcome.unwrap_or(Err(Refusal::WrongMode)),
            });
        }
        answers
    }

    /// The rates that the mode wants.
    fn wish(
        &mut self,
        release: &Release,
        inputs: &CycleInputs,
        elapsed_ns: u64,
        clock: &impl Clock,
    ) -> (BendRates, SolveReport) {
        let period_s = self.period_ns as f64 * 1e-9;
        let rates = match self.modes.mode() {
            Mode::Tracking { .. } => return self.track(release, inputs, elapsed_ns, clock),
            Mode::Homing => homing_rates(
                self.estimator.configuration(),
                self.policy.home_rate_rad_s,
                period_s,
            ),
            Mode::Starting | Mode::Holding { .. } | Mode::Stopped { .. } | Mode::Faulted { .. } => {
                ramp_to_zero(&self.rates, self.policy.deceleration_rad_s2, period_s)
            }
        };
        self.nmpc.forget_plan();
        (rates, SolveReport::default())
    }

    /// NMPC in the time that is left.
    fn track(
        &mut self,
        release: &Release,
        inputs: &CycleInputs,
        elapsed_ns: u64,
        clock: &impl Clock,
    ) -> (BendRates, SolveReport) {
        let settings = self.nmpc.settings();
        let input = SolveInput {
            configuration: self.estimator.configuration(),
            previous_rates: &self.rates,
            reference: inputs
                .window
                .ahead(release.cycle, settings.horizon_steps as usize),
            obstacles: &self.obstacles,
            elapsed_periods: elapsed_ns / self.period_ns,
            seed: cycle_seed(settings.seed, release.cycle),
        };
        let mut looked_ns = clock.now_ns();
        let deadline_ns = release.release_ns + self.accounting.limits().deadline_ns;
        let left_ns = deadline_ns.saturating_sub(self.budget_margin_ns);
        let end_ns = match self.budget_ns {
            0 => left_ns,
            budget_ns => left_ns.min(looked_ns + budget_ns),
        };
        let longest_gap_ns = &mut self.longest_gap_ns;
        let mut budget = Budget::new(|| {
            let now_ns = clock.now_ns();
            *longest_gap_ns = (*longest_gap_ns).max(now_ns - looked_ns);
            looked_ns = now_ns;
            now_ns >= end_ns
        });
        let (rates, report) = self.nmpc.solve(&input, &mut budget);
        if report.status == SolveStatus::NonFinite {
            self.modes.fault(Reason::NonFinite);
        }
        (rates, report)
    }

    fn limit(&mut self, wish: &BendRates, comes_to_rest: bool) -> Limited {
        let period_s = self.period_ns as f64 * 1e-9;
        let limit = if comes_to_rest { shorten } else { limit };
        let limited = limit(&self.robot, self.estimator.configuration(), wish, period_s);
        if limited.hit.non_finite {
            self.modes.fault(Reason::NonFinite);
        }
        limited
    }

    /// In every mode, the last word.
    fn keep_clear(&self, rates: &BendRates, comes_to_rest: bool) -> Guarded {
        let guard = if comes_to_rest { guard_ramp } else { guard };
        guard(
            &self.robot,
            self.estimator.configuration(),
            rates,
            &self.obstacles,
            self.nmpc.settings().safe_distance_m,
            self.period_ns as f64 * 1e-9,
        )
    }

    fn copy_plans(&self, record: &mut CycleRecord) {
        if record.report.status != SolveStatus::Idle {
            let plan = self.nmpc.plan();
            record.plan_length = plan.len();
            record.plan[..plan.len()].copy_from_slice(plan);
            record.warm_plan[..plan.len()].copy_from_slice(self.nmpc.warm_plan());
        }
    }
}
