//! A robot that differs from its model, its driver, and the daemon's cycle, on a test clock.

pub(super) mod losing;

use std::cell::Cell;
use std::collections::VecDeque;
use std::path::Path;

use cdcr_controller::estimator::Measurement;
use cdcr_controller::plant::{Flaws, MisbehavingRobot, MotorOrder, RobotPreset};
use cdcr_controller::reference::{Interpolation, Orientation, ReferencePoint, Trajectory};
use cdcr_controller::robot::{CABLES_MAX, Configuration, Obstacle, Shape};
use cdcr_controller::safety::{LeaseState, Request};
use nalgebra::{Matrix3, Vector3};

use super::super::*;
use crate::config::{Config, Interface};
use crate::convert;
use crate::handover::TimedMeasurement;
use crate::link::CycleRobot;
use crate::obstacles::KnownObstacle;
use crate::rt::clock::ManualClock;

/// Follow the reference of the lease in the inputs.
pub(super) const TRACK: Request = Request::Track { lease_number: 0 };
pub(super) const PERIOD_NS: u64 = 5_000_000;
pub(super) const PERIOD_S: f64 = 0.005;
/// Time from a driver's measurement to the release \[ns\].
pub(super) const MEASURED_BEFORE_NS: u64 = 1_000_000;
/// Release of cycle 0.
pub(super) const BEGIN_NS: u64 = 1_000_000_000;

/// A clock that advances with each reading.
pub(super) fn clock() -> ManualClock {
    ManualClock {
        step_ns: Cell::new(100),
        ..ManualClock::default()
    }
}

/// What a driver states of the rest of its motors.
#[derive(Debug, Clone, Copy)]
pub(super) enum Statements {
    None,
    True,
    /// Since the beginning.
    AlwaysAtRest,
    /// For this time before each measurement \[ns\].
    Lately(u64),
}

/// A daemon's cycle, and the robot behind its driver.
pub(super) struct Trial {
    pub(super) cycle: Cycle,
    robot: Robot,
    pub(super) plant: MisbehavingRobot,
    interface: Interface,
    /// Each cycle is rehearsed before its release.
    pub(super) rehearses: bool,
    /// Clock readings of the longest rehearsal.
    pub(super) rehearsal_looks: u64,
    /// The motors stand still, whatever is commanded.
    pub(super) stands: bool,
    /// The exchange is stalled: commands are not sent.
    pub(super) is_held_up: bool,
    /// The newest command sent.
    pub(super) sent: Option<cdcr_shared_types::Command>,
    pub(super) statements: Statements,
    /// The newest rest of the motors that is over \[ns\].
    rested_ns: [u64; 2],
    lead_ns: u64,
    /// Error added to the encoders' lengths \[m\].
    pub(super) cable_error_m: [f64; CABLES_MAX],
    /// The robot has a tip sensor in addition to its encoders.
    pub(super) measures_tip: bool,
    /// The driver measures the tip, and neither bends nor cables.
    pub(super) measures_tip_alone: bool,
    /// Error added to the tip sensor's position \[m\].
    pub(super) tip_error_m: Vector3<f64>,
    /// Axes of the base in the frame of the tip sensor.
    pub(super) tip_axes: Matrix3<f64>,
    /// Cycles from the measurement of a tip to its arrival.
    pub(super) tip_age_cycles: usize,
    /// Tips on their way, oldest first.
    tips: VecDeque<TimedMeasurement>,
    /// Constant position reported by a frozen tip sensor.
    pub(super) frozen_tip_m: Option<Vector3<f64>>,
    pub(super) inputs: CycleInputs,
    trajectory: Trajectory,
    pub(super) clock: ManualClock,
    next: u64,
    asked: Option<Request>,
    last: Option<CycleRecord>,
    pub(super) target_rad: Vec<f64>,
    /// Cable lengths of the command sent \[m\].
    sent_m: [f64; CABLES_MAX],
    /// Place of the tip at the last release \[m\].
    pub(super) tip_m: Vector3<f64>,
    /// Bends of the robot at the last release.
    pub(super) at_release: Configuration,
}

impl Trial {
    /// The laboratory's robot.
    pub(super) fn new(interface: Interface) -> Self {
        Self::with(interface, RobotPreset::Laboratory.flaws(), "")
    }

    /// A robot with these flaws, and additional lines of the configuration.
    pub(super) fn with(interface: Interface, flaws: Flaws, more: &str) -> Self {
        Self::linked("kind = \"driver\"\n", interface, flaws, more)
    }

    /// A robot that the daemon simulates, with additional lines of `[link]`.
    pub(super) fn simulated(interface: Interface, preset: RobotPreset, more: &str) -> Self {
        let name = format!("{preset:?}").to_lowercase();
        let link = format!("simulated = \"{name}\"\n{more}");
        Self::linked(&link, interface, Flaws::default(), "")
    }

    fn linked(link: &str, interface: Interface, flaws: Flaws, more: &str) -> Self {
        let name = match interface {
            Interface::Position => "position",
            Interface::Velocity => "velocity",
        };
        let text = format!("[link]\n{link}interface = \"{name}\"\n{more}");
        let validated = Config::parse(&text, Path::new("trial")).unwrap();
        let mut inputs = CycleInputs::new(RuntimeSettings::new(&validated.config));
        inputs.lease = LeaseState::Held;
        let straight = Configuration::straight(validated.robot.section_count());
        let sent_m = validated.robot.cable_lengths(&straight);
        Self {
            cycle: Cycle::new(&validated, CycleRobot::new(&validated).unwrap()).unwrap(),
            trajectory: Trajectory::with_capacity(4096, validated.robot.reach_m()),
            plant: MisbehavingRobot::new(&validated.robot, &straight, flaws, 7).unwrap(),
            robot: validated.robot,
            interface,
            stands: false,
            is_held_up: false,
            sent: None,
            statements: Statements::None,
            rested_ns: [0; 2],
            rehearses: false,
            rehearsal_looks: 0,
            cable_error_m: [0.0; CABLES_MAX],
            measures_tip: false,
            measures_tip_alone: false,
            tip_error_m: Vector3::zeros(),
            tip_axes: Matrix3::identity(),
            tip_age_cycles: 0,
            tips: VecDeque::new(),
            frozen_tip_m: None,
            lead_ns: ns(validated.config.actuator.lead_ms()),
            inputs,
            clock: clock(),
            next: 0,
            asked: None,
            last: None,
            target_rad: Vec::new(),
            sent_m,
            tip_m: Vector3::zeros(),
            at_release: straight,
        }
    }

    /// The record of the newest cycle.
    pub(super) fn last(&self) -> CycleRecord {
        self.last.unwrap()
    }

    /// The number of the next cycle.
    pub(super) fn next(&self) -> u64 {
        self.next
    }

    /// Adds a ball that stays, measured at the next release.
    pub(super) fn put_ball(&mut self, centre_m: Vector3<f64>, radius_m: f64) -> Obstacle {
        self.put_moving_ball(centre_m, radius_m, Vector3::zeros())
    }

    pub(super) fn put_moving_ball(
        &mut self,
        centre_m: Vector3<f64>,
        radius_m: f64,
        velocity_m_s: Vector3<f64>,
    ) -> Obstacle {
        let shape = Shape::Sphere { centre_m };
        let obstacle = Obstacle::new(shape, radius_m, velocity_m_s).unwrap();
        let known = KnownObstacle {
            id: 1,
            source: 1,
            obstacle,
            measured_ns: BEGIN_NS + self.next * PERIOD_NS,
            expires_ns: None,
        };
        self.inputs.obstacles.upsert(known).unwrap();
        obstacle
    }

    pub(super) fn ask(&mut self, request: Request) -> CycleRecord {
        self.asked = Some(request);
        self.turn()
    }

    /// Measures the encoders one millisecond before the release; the robot has been moved to that time.
    pub(super) fn measure(&mut self, release_ns: u64) {
        let cables_m = self.plant.measure_cables().unwrap();
        let lengths_m = core::array::from_fn(|cable| cables_m[cable] + self.cable_error_m[cable]);
        let measurement = if self.measures_tip_alone {
            Measurement::TipPosition(self.plant.measure_tip().unwrap())
        } else {
            Measurement::CableLengths(lengths_m)
        };
        self.inputs.measurement = Some(TimedMeasurement {
            measurement,
            measured_ns: release_ns - MEASURED_BEFORE_NS,
            rested_ns: self.stated_ns(release_ns - MEASURED_BEFORE_NS),
        });
        if self.measures_tip {
            self.tips.push_back(TimedMeasurement {
                measurement: Measurement::TipPosition(self.frozen_tip_m.unwrap_or_else(|| {
                    self.tip_axes * self.plant.measure_tip().unwrap() + self.tip_error_m
                })),
                measured_ns: release_ns - MEASURED_BEFORE_NS,
                rested_ns: [0; 2],
            });
            while self.tips.len() > self.tip_age_cycles {
                self.inputs.tip = self.tips.pop_front();
            }
        }
    }

    /// The newest rest of motors that obey speeds.
    fn rest_ns(&self, now_ns: u64) -> [u64; 2] {
        let sent = self.sent.filter(|_| self.interface == Interface::Velocity);
        let rest_ns = sent.and_then(|sent| sent.rest_ns(sent.release_ns, now_ns));
        rest_ns.map_or(self.rested_ns, |rest_ns| [rest_ns.start, rest_ns.end])
    }

    /// What the driver states of it.
    fn stated_ns(&self, now_ns: u64) -> [u64; 2] {
        match self.statements {
            Statements::None => [0; 2],
            Statements::True => self.rest_ns(now_ns),
            Statements::AlwaysAtRest => [1, now_ns],
            Statements::Lately(rest_ns) => [now_ns - rest_ns, now_ns],
        }
    }

    /// The bends of the newest measurement.
    pub(super) fn measured(&self) -> Configuration {
        match self.inputs.measurement.map(|timed| timed.measurement) {
            Some(Measurement::CableLengths(lengths)) => {
                self.robot.bend_from_cable_lengths(&lengths)
            }
            other => unreachable!("{other:?}"),
        }
    }

    pub(super) fn gather(&mut self, release_ns: u64) {
        self.inputs.gather += 1;
        self.inputs.gather_ns = release_ns - 200_000;
        let steps = self.inputs.settings.nmpc.horizon_steps as usize;
        let window = &mut self.inputs.window;
        window.fill(
            &self.trajectory,
            self.next,
            release_ns,
            PERIOD_NS,
            steps,
            self.lead_ns,
        );
        self.measure(release_ns);
    }

    /// One cycle, and the motion of the robot until the next one.
    pub(super) fn turn(&mut self) -> CycleRecord {
        // Rehearses with the inputs of the cycle, with older ones, or too late for any step.
        let [early_ns, late_ns] = [75_000, 100];
        match self.next % 3 {
            0 => self.rehearse(early_ns),
            1 => self.rehearse(late_ns),
            _ => {}
        }
        self.gather(BEGIN_NS + self.next * PERIOD_NS);
        if self.next % 3 == 2 {
            self.rehearse(early_ns);
        }
        self.cycle(0)
    }

    /// One cycle in which the driver may not measure, or not get the command.
    pub(super) fn turn_of(&mut self, measures: bool, obeys: bool) -> CycleRecord {
        let measurement = self.inputs.measurement;
        self.gather(BEGIN_NS + self.next * PERIOD_NS);
        if !measures {
            self.inputs.measurement = measurement;
        }
        self.is_held_up = !obeys;
        let record = self.cycle(0);
        self.is_held_up = false;
        record
    }

    /// A cycle with a gather of its own, after `skipped` releases without one.
    pub(super) fn late_turn(&mut self, skipped: u32) -> CycleRecord {
        self.next += u64::from(skipped);
        self.gather(BEGIN_NS + self.next * PERIOD_NS);
        self.next -= u64::from(skipped);
        self.cycle(skipped)
    }

    /// Rehearses the next cycle, `before_ns` before its release.
    fn rehearse(&mut self, before_ns: u64) {
        if !self.rehearses {
            return;
        }
        let release_ns = BEGIN_NS + self.next * PERIOD_NS;
        self.clock.now_ns.set(release_ns - before_ns);
        self.cycle
            .rehearse(self.next, release_ns, &self.inputs, &self.clock);
        let now_ns = self.clock.now_ns.get();
        assert!(now_ns <= release_ns, "a rehearsal is over by the release");
        self.rehearsal_looks = self
            .rehearsal_looks
            .max((now_ns + before_ns - release_ns) / 100);
    }

    /// A cycle with the present inputs, after `skipped` releases without one.
    pub(super) fn cycle(&mut self, skipped: u32) -> CycleRecord {
        let (record, command) = self.command(skipped);
        if self.is_held_up {
            self.go_on(command.release_ns);
        } else {
            self.rested_ns = self.rest_ns(command.release_ns);
            self.sent = Some(command);
            self.obey(&command);
        }
        record
    }

    /// The record and the command of a cycle with the present inputs, after `skipped` releases without one.
    fn command(&mut self, skipped: u32) -> (CycleRecord, cdcr_shared_types::Command) {
        self.next += u64::from(skipped);
        let release_ns = BEGIN_NS + self.next * PERIOD_NS;
        let release = Release {
            cycle: self.next,
            release_ns,
            due_ns: release_ns,
            start_ns: release_ns + 20_000,
            skipped,
        };
        self.clock.now_ns.set(release.start_ns);
        let mut asked = self.asked.take();
        let next_request = || {
            asked.take().map(|request| CycleRequest {
                ticket: 1,
                request,
                asked_ns: release.start_ns,
                stops: self.inputs.stops + 1,
            })
        };
        let record = self
            .cycle
            .run(release, &self.inputs, next_request, &self.clock);
        let command = convert::command(&record, &self.robot, PERIOD_NS);
        self.target_rad = command.bend_target_rad[..self.robot.coordinate_count()].to_vec();
        self.next += 1;
        self.last = Some(record);
        (record, command)
    }

    /// Lets the work after the solver take `took_ns`.
    pub(super) fn rest_after(&mut self, took_ns: u64) {
        self.clock.now_ns.set(self.cycle.solve_over_ns + took_ns);
        self.cycle.rest(&self.clock);
    }

    /// The motors continue with the old command until the release, and then take the new one.
    pub(super) fn obey(&mut self, command: &cdcr_shared_types::Command) {
        const STEPS: u32 = 5;
        let before_m = self.sent_m;
        self.plant.advance(MEASURED_BEFORE_NS as f64 * 1e-9);
        self.tip_m = self.plant.tip_m();
        self.at_release = self.plant.configuration();
        self.sent_m = command.cable_length_m;
        // Evenly to the target, as `cdcr_client::Driver` moves; the last step ends at the next measurement.
        for step in 1..=STEPS {
            let part = f64::from(step) / f64::from(STEPS);
            self.plant.order(match self.interface {
                _ if self.stands => MotorOrder::Stop,
                Interface::Velocity => MotorOrder::Speeds(command.cable_speed_m_s),
                Interface::Position => MotorOrder::Lengths(core::array::from_fn(|cable| {
                    before_m[cable] + part * (self.sent_m[cable] - before_m[cable])
                })),
            });
            if step < STEPS {
                self.plant.advance(PERIOD_S / f64::from(STEPS));
            }
        }
    }

    /// From `release_ns` on, the motors execute the last command sent for one period, until it expires.
    fn go_on(&mut self, release_ns: u64) {
        self.plant.advance(MEASURED_BEFORE_NS as f64 * 1e-9);
        self.at_release = self.plant.configuration();
        let is_valid = |sent: &cdcr_shared_types::Command| release_ns < sent.valid_until_ns;
        self.plant.order(match self.interface {
            Interface::Position => MotorOrder::Lengths(self.sent_m),
            Interface::Velocity => match self.sent.filter(is_valid) {
                Some(sent) => MotorOrder::Speeds(sent.cable_speed_m_s),
                None => MotorOrder::Stop,
            },
        });
        (self.plant).advance((PERIOD_NS - MEASURED_BEFORE_NS) as f64 * 1e-9);
    }

    pub(super) fn turns(&mut self, count: u32) -> CycleRecord {
        for _ in 0..count {
            self.turn();
        }
        self.last.unwrap()
    }

    /// Feeds a reference on a circle of `radius_m` about the axis, from now on, for `duration_s`.
    pub(super) fn feed_circle(&mut self, radius_m: f64, duration_s: f64) {
        let start_ns = BEGIN_NS + (self.next + 2) * PERIOD_NS;
        let count = (duration_s / 0.02) as u64;
        let reach_m = self.robot.reach_m();
        let points = (0..count).map(|k| {
            let time_s = k as f64 * 0.02;
            let (sin, cos) = (1.5 * time_s).sin_cos();
            // Begins at the robot's position, at rest.
            let radius_m = radius_m * (0.5 * time_s).min(1.0).powi(2);
            ReferencePoint {
                time_ns: start_ns + k * 20_000_000,
                position_m: Vector3::new(radius_m * cos, radius_m * sin, 0.93 * reach_m),
                orientation: Orientation::Free,
                interpolation: Interpolation::Cubic,
            }
        });
        self.trajectory.replace(points).unwrap();
    }

    /// Feeds a reference of constant velocity that begins `begins_in_s` from now.
    pub(super) fn feed_line(
        &mut self,
        start_m: [f64; 3],
        velocity_m_s: [f64; 3],
        begins_in_s: f64,
    ) {
        const DURATION_S: f64 = 10.0;
        let start_ns = BEGIN_NS + self.next * PERIOD_NS + (begins_in_s * 1e9) as u64;
        let points = [0.0, DURATION_S].map(|time_s| ReferencePoint {
            time_ns: start_ns + (time_s * 1e9) as u64,
            position_m: Vector3::from(start_m) + Vector3::from(velocity_m_s) * time_s,
            orientation: Orientation::Free,
            interpolation: Interpolation::Linear,
        });
        self.trajectory.replace(points.into_iter()).unwrap();
    }

    pub(super) fn begin_tracking(&mut self) {
        self.feed_circle(0.2, 20.0);
        let record = self.ask(TRACK);
        assert!(
            matches!(record.mode, Mode::Tracking { .. }),
            "{:?}",
            record.answers[0]
        );
    }
}
