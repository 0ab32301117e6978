//! The controlling half of a daemon in one thread with a simulated clock. Messages pass through the daemon's
//! checks into its cycle, and every resulting command is checked.

use std::cell::Cell;
use std::collections::VecDeque;
use std::path::Path;

use cdcr_controller::plant::KinematicPlant;
use cdcr_controller::reference::Trajectory;
use cdcr_controller::robot::Robot;
use cdcr_controller::safety::{LeaseState, Mode};
use cdcr_daemon::config::{Config, Validated, ns};
use cdcr_daemon::convert;
use cdcr_daemon::cycle::Cycle;
use cdcr_daemon::handover::{CycleInputs, CycleRecord, CycleRequest, RuntimeSettings};
use cdcr_daemon::link::CycleRobot;
use cdcr_daemon::rt::clock::{Clock, ManualClock};
use cdcr_daemon::rt::schedule::Release;
use cdcr_shared_types::codes::{ChunkMode, Interface, MeasurementKind, RequestKind};
use cdcr_shared_types::limits::REFERENCE_POINTS_MAX;
use cdcr_shared_types::{Measurement, ObstacleUpdate, ReferenceChunk, Request, Telemetry};
use cdcr_test_cases::Tally;

use crate::chaos::limits;
use crate::fuzz::script::{BEGIN_NS, PERIOD_NS, Run, Script, Step};

/// A section of the paper's robot.
const SECTION: &str = "[[robot.sections]]
length_m = 0.3
cable_radius_m = 0.0125
cable_offset_rad = 0.5
bend_max_rad = 2.8
rate_max_rad_s = 2.0
body_radius_m = 0.015
";
/// Time from the gather to the release.
const GATHER_LEAD_NS: u64 = 200_000;
/// Time that passes at each clock read: a solve ends after some hundred reads.
const LOOK_NS: u64 = 10_000;

/// Runs a script, and counts the results.
pub(crate) fn play(script: &Script, tally: &Tally) {
    let Some(Step::Robot(robot)) = script.0.first() else {
        panic!("a script begins with its [robot]");
    };
    let text = SECTION.repeat(robot.sections as usize);
    let validated = Config::parse(&text, Path::new("script")).unwrap();
    if robot.driver == 1 {
        Rig::new(&validated, CycleRobot::Driver).play(script, tally);
    } else {
        Rig::new(&validated, simulated(&validated)).play(script, tally);
    }
}

pub(crate) fn simulated(validated: &Validated) -> CycleRobot {
    CycleRobot::ideal(KinematicPlant::new(&validated.robot, validated.initial))
}

/// The data of the cycle, and the robot behind a correct driver.
#[derive(Debug)]
pub(crate) struct Rig {
    robot: Robot,
    period_ns: u64,
    cycle: Cycle,
    real: KinematicPlant,
    clock: ManualClock,
    trajectory: Trajectory,
    inputs: CycleInputs,
    requests: VecDeque<CycleRequest>,
    next_cycle: u64,
}

impl Rig {
    pub(crate) fn new(validated: &Validated, link: CycleRobot) -> Self {
        let mut inputs = CycleInputs::new(RuntimeSettings::new(&validated.config));
        inputs.lease = LeaseState::Held;
        Self {
            robot: validated.robot.clone(),
            period_ns: ns(validated.config.cycle.period_ms),
            cycle: Cycle::new(validated, link).unwrap(),
            real: KinematicPlant::new(&validated.robot, validated.initial),
            clock: ManualClock {
                step_ns: Cell::new(LOOK_NS),
                ..ManualClock::default()
            },
            trajectory: Trajectory::with_capacity(REFERENCE_POINTS_MAX, validated.robot.reach_m()),
            inputs,
            requests: VecDeque::new(),
            next_cycle: 0,
        }
    }

    /// Time of the next gather.
    pub(crate) fn now_ns(&self) -> u64 {
        self.release_ns(self.next_cycle) - GATHER_LEAD_NS.min(self.period_ns / 2)
    }

    fn release_ns(&self, cycle: u64) -> u64 {
        BEGIN_NS + cycle * self.period_ns
    }

    fn play(&mut self, script: &Script, tally: &Tally) {
        assert_eq!(self.period_ns, PERIOD_NS);
        for step in &script.0[1..] {
            match step {
                Step::Robot(_) => panic!("a script has one robot"),
                Step::Run(run) => self.run(*run, tally),
                Step::Chunk(chunk) => tally.count("played reference", self.take_chunk(chunk)),
                Step::Update(update) => tally.count("played obstacles", self.take_update(update)),
                Step::Measurement(message) => {
                    tally.count("played measurement", self.take_measurement(message));
                }
                Step::Request(request) => tally.count("played request", self.take_request(request)),
            }
        }
    }

    /// Like the daemon's gather, without lease and sequence.
    pub(crate) fn take_chunk(&mut self, chunk: &ReferenceChunk) -> bool {
        let now_ns = self.now_ns();
        let Ok(mode) = ChunkMode::try_from(chunk.mode) else {
            return false;
        };
        let Ok(points) = convert::reference_points(chunk, &self.robot, now_ns) else {
            return false;
        };
        match mode {
            ChunkMode::Replace => self.trajectory.replace(points).is_ok(),
            ChunkMode::Append => self.trajectory.append(points).is_ok(),
        }
    }

    fn take_update(&mut self, update: &ObstacleUpdate) -> bool {
        let now_ns = self.now_ns();
        self.inputs.obstacles.expire(now_ns);
        let updated = convert::updated_obstacles(update, &self.inputs.obstacles, now_ns);
        updated.map(|set| self.inputs.obstacles = set).is_ok()
    }

    fn take_measurement(&mut self, message: &Measurement) -> bool {
        let measured =
            convert::measurement(message, &self.robot, Interface::Velocity, self.now_ns());
        let last_ns = self.inputs.measurement.map_or(0, |last| last.measured_ns);
        match measured {
            Ok(timed) if timed.measured_ns > last_ns => {
                self.inputs.measurement = Some(timed);
                true
            }
            _ => false,
        }
    }

    pub(crate) fn take_request(&mut self, request: &Request) -> bool {
        let Ok(kind) = RequestKind::try_from(request.kind) else {
            return false;
        };
        if let Some(request) = convert::mode_request(kind, request.accepts_pose == 1, 0) {
            self.requests.push_back(CycleRequest {
                ticket: 1,
                request,
                asked_ns: u64::MAX,
                stops: 0,
            });
            return true;
        }
        if kind != RequestKind::Settings {
            return false;
        }
        let settings = convert::settings_from_wire(&request.settings, self.period_ns);
        let taken = settings.map(|settings| {
            self.inputs.settings = settings;
            self.inputs.settings_revision += 1;
        });
        taken.is_ok()
    }

    /// The measurement of a correct driver.
    fn measure(&mut self) {
        let mut message = Measurement {
            measured_ns: self.now_ns(),
            kind: MeasurementKind::Configuration.code(),
            sections: self.robot.section_count() as u32,
            interface: Interface::Velocity.code(),
            ..Measurement::default()
        };
        let bends = self.real.configuration();
        message.bend_rad[..bends.as_slice().len()].copy_from_slice(bends.as_slice());
        // An earlier one may have been slightly ahead of its time; then this one is older.
        self.take_measurement(&message);
    }

    fn run(&mut self, run: Run, tally: &Tally) {
        self.inputs.lease = match run.lease {
            0 => LeaseState::Free,
            1 => LeaseState::Held,
            _ => LeaseState::Expired,
        };
        for cycle in 0..run.cycles {
            if run.measured == 1 {
                self.measure();
            }
            let skipped = if cycle == 0 { run.skipped } else { 0 };
            let record = self.run_cycle(skipped);
            if matches!(record.mode, Mode::Tracking { .. }) {
                tally.count("cycle that follows", true);
            }
            if matches!(record.mode, Mode::Faulted { .. }) {
                tally.count("cycle with a fault", true);
            }
            if record.clearance_hit {
                tally.count("cycle that is kept clear", true);
            }
        }
    }

    /// One cycle, `skipped` periods after the intended one of its inputs.
    pub(crate) fn run_cycle(&mut self, skipped: u32) -> CycleRecord {
        let planned = self.next_cycle;
        self.gather(planned);
        let cycle = planned + u64::from(skipped);
        self.next_cycle = cycle + 1;
        let release_ns = self.release_ns(cycle);
        let release = Release {
            cycle,
            release_ns,
            due_ns: self.release_ns(planned),
            start_ns: release_ns + 30_000,
            skipped,
        };
        self.clock.sleep_until(release.start_ns);
        let (requests, clock) = (&mut self.requests, &self.clock);
        let next_request = || requests.pop_front();
        let record = self.cycle.run(release, &self.inputs, next_request, clock);
        self.evaluate(&record);
        self.real.command(&record.rates);
        self.real.advance(self.period_ns as f64 * 1e-9);
        record
    }

    fn gather(&mut self, cycle: u64) {
        let release_ns = self.release_ns(cycle);
        self.trajectory.forget_before(release_ns - self.period_ns);
        self.inputs.gather += 1;
        self.inputs.gather_ns = self.now_ns();
        self.inputs.window.fill(
            &self.trajectory,
            cycle,
            release_ns,
            self.period_ns,
            self.inputs.settings.nmpc.horizon_steps as usize,
            0,
        );
    }

    /// Checks that the command is finite and within the limits, unless the robot was measured outside before.
    fn evaluate(&self, record: &CycleRecord) {
        let telemetry = Telemetry {
            command: convert::command(record, &self.robot, self.period_ns),
            ..convert::telemetry(record, &self.robot, self.period_ns)
        };
        limits::check_record(&self.robot, &telemetry, self.period_ns as f64 * 1e-9).unwrap();
        assert_eq!(telemetry.cycle, record.release.cycle);
    }
}
