//! One run: a controller, the robot behind its driver, the clients, and the work of the exchange.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use cdcr_client::replay::{Outcome as Replayed, ReplayedCycle, Replayer};
use cdcr_controller::nmpc::SolverKind;
use cdcr_controller::reference::Trajectory;
use cdcr_controller::robot::Robot;
use cdcr_controller::safety::LeaseState;
use cdcr_daemon::config::{Config, Validated, ns};
use cdcr_daemon::convert;
use cdcr_daemon::cycle::Cycle;
use cdcr_daemon::handover::{CycleInputs, CycleRecord, CycleRequest, RuntimeSettings};
use cdcr_daemon::link::CycleRobot;
use cdcr_daemon::obstacles::ObstacleSet;
use cdcr_daemon::rt::clock::ManualClock;
use cdcr_daemon::rt::schedule::Release;
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Interface, Interpolation, MeasurementKind, Mode, Outcome, RequestKind,
    RobotLink,
};
use cdcr_shared_types::{Command, Header, InputEvent, ReferenceChunk, Telemetry};
use cdcr_tests::record::largest;
use nalgebra::Vector3;

use super::driver::Driver;
use crate::chaos::dice::Dice;
use crate::chaos::integral::runs_out_in_cycle;
use crate::chaos::records::{Records, Seen, describe};
use crate::chaos::{CheckResult, obstacles};

/// Release of cycle 0 \[ns\].
const ORIGIN_NS: u64 = 10_000_000_000;
/// Time from the gather to the release \[ns\].
const LEAD_NS: u64 = 200_000;

/// The last command ran out in a stall inside the cycle, before the solve or in it.
const STALLED_BEFORE: &str = "stalled before";
const STALLED_IN: &str = "stalled in";
/// The commanded position moves to where control begins.
const ON_THE_WAY: &str = "on the way";

pub(super) struct World {
    dice: Dice,
    cycle: Cycle,
    robot: Robot,
    period_ns: u64,
    timeout_ns: u64,
    lead_ns: u64,
    interface: Interface,
    driver: Driver,
    inputs: CycleInputs,
    trajectory: Trajectory,
    clock: ManualClock,
    next: u64,
    /// Remaining gathers of a stall of the exchange.
    held_up: u32,
    /// The command that leaves after the stall.
    unsent: Option<Command>,
    /// Request for the next cycle, and the previous request.
    asked: Option<RequestKind>,
    kind_of_answer: Option<RequestKind>,
    stop_asked: bool,
    sequence: u64,
    /// The chunk of the reference that the next cycle takes, and the number of chunks so far.
    fed: Option<Header>,
    chunks: u64,
    records: Records,
    replayer: Replayer,
    replayed: ReplayCounts,
}

/// Numbers of cycles that were computed again, by what is special in them.
pub(super) type ReplayCounts = BTreeMap<String, u64>;

impl World {
    pub(super) fn new(seed: u64) -> Self {
        let mut dice = Dice::new(seed);
        let text = configuration(&mut dice);
        let validated = Config::parse(&text, Path::new("chaos")).unwrap();
        let Validated { config, robot, .. } = &validated;
        let period_ns = ns(config.cycle.period_ms);
        let interface = Interface::from(config.link.interface);
        let driver = Driver::new(&mut dice, robot, interface, ORIGIN_NS);
        let driven = RobotLink::Driver.code();
        Self {
            cycle: Cycle::new(&validated, CycleRobot::Driver).unwrap(),
            robot: robot.clone(),
            period_ns,
            timeout_ns: ns(config.link.measurement_timeout_ms),
            lead_ns: ns(config.actuator.lead_ms()),
            interface,
            driver,
            inputs: CycleInputs::new(RuntimeSettings::new(config)),
            trajectory: Trajectory::with_capacity(1024, robot.reach_m()),
            clock: ManualClock::default(),
            next: 1,
            held_up: 0,
            unsent: None,
            asked: None,
            kind_of_answer: None,
            stop_asked: false,
            sequence: 0,
            fed: None,
            chunks: 0,
            replayer: Replayer::default(),
            replayed: ReplayCounts::default(),
            records: Records::new(robot.clone(), driven, period_ns, ORIGIN_NS)
                .with_play(config.actuator.play_m > 0.0),
            dice,
        }
    }

    /// Whether its robot can be expected to follow.
    pub(super) fn has_mild_robot(&self) -> bool {
        self.driver.is_mild()
    }

    /// Runs `cycles` cycles and returns the counts.
    pub(super) fn live(mut self, cycles: u32) -> Result<(Seen, ReplayCounts), String> {
        for _ in 0..cycles {
            self.turn()?;
        }
        self.records.finish()?;
        while let Some(cycle) = self.replayer.finish_one().unwrap() {
            self.count(&cycle)?;
        }
        Ok((self.records.seen, self.replayed))
    }

    /// Each cycle is computed again from its record, bit for bit.
    fn count(&mut self, cycle: &ReplayedCycle) -> CheckResult {
        let Replayed::Reproduced(made) = &cycle.outcome else {
            return Err(format!(
                "replay: {:?}\n{}",
                cycle.outcome,
                describe(&cycle.record)
            ));
        };
        let record = &cycle.record;
        let knew = largest(&record.previous_rate_rad_s) > 0.0;
        for (kind, is_one) in [
            (
                STALLED_BEFORE,
                runs_out_in_cycle(record, record.solve_start_ns),
            ),
            (STALLED_IN, knew && record.ran_out_in_solve != 0),
        ] {
            let mode = if made.solved { "solve" } else { "no solve" };
            let kind = format!("{kind}, {mode}, {}", self.interface);
            *self.replayed.entry(kind).or_default() += u64::from(is_one);
        }
        *self.replayed.entry(ON_THE_WAY.to_owned()).or_default() +=
            u64::from(record.moves_to_begin);
        Ok(())
    }

    fn turn(&mut self) -> CheckResult {
        let mut skipped = if self.dice.chance(2) {
            self.dice.below(12)
        } else {
            0
        };
        // Skipped releases, which the previous cycle overran.
        let passed = self.clock.now_ns.get().saturating_sub(ORIGIN_NS) / self.period_ns + 1;
        skipped += passed.saturating_sub(self.next + u64::from(skipped)) as u32;
        self.next += u64::from(skipped);
        let release_ns = ORIGIN_NS + self.next * self.period_ns;
        let measured_ns = release_ns - self.dice.duration_ms(1, 3).as_nanos() as u64 / 2;
        self.driver.turn(&mut self.dice, measured_ns);
        if self.dice.chance(1) {
            self.held_up = self.dice.below(40);
        }
        let is_held_up = self.held_up > 0;
        if !is_held_up {
            self.send(release_ns - LEAD_NS);
            self.act();
            self.gather(release_ns);
        }
        self.held_up = self.held_up.saturating_sub(1);
        self.run(release_ns, skipped)?;
        if !is_held_up {
            self.send(self.clock.now_ns.get());
        }
        Ok(())
    }

    /// Sends the newest command, unless it moves the robot and has expired.
    fn send(&mut self, now_ns: u64) {
        let rests = |command: &Command| largest(&command.bend_rate_rad_s) == 0.0;
        if let Some(command) = self.unsent.take()
            && (now_ns < command.valid_until_ns || rests(&command))
        {
            self.driver.take(&command, now_ns);
        }
    }

    fn run(&mut self, release_ns: u64, skipped: u32) -> CheckResult {
        let start_ns = release_ns
            + if self.dice.chance(5) {
                self.dice.duration_ms(0, 4).as_nanos() as u64
            } else {
                20_000
            };
        let release = Release {
            cycle: self.next,
            release_ns,
            due_ns: release_ns - u64::from(skipped) * self.period_ns,
            start_ns,
            skipped,
        };
        self.next += 1;
        self.clock.now_ns.set(start_ns);
        // Each reading of the clock takes so long; two in a hundred cycles stall.
        let steps_ns = if self.dice.chance(2) {
            [3_000_000, 6_000_000, 11_000_000, 20_000_000]
        } else {
            [20_000, 50_000, 200_000, 1_000_000]
        };
        self.clock.step_ns.set(self.dice.pick(&steps_ns));
        let asked = self.asked.take();
        let accepts_pose = self.dice.chance(80);
        if accepts_pose && asked == Some(RequestKind::Reset) {
            self.kind_of_answer = Some(RequestKind::ResetAcceptingPose);
        }
        let mut request = asked.and_then(|kind| convert::mode_request(kind, accepts_pose, 0));
        let next_request = || {
            let request = request.take()?;
            Some(CycleRequest {
                ticket: 1,
                request,
                asked_ns: release_ns - LEAD_NS,
                stops: 0,
            })
        };
        let record = self
            .cycle
            .run(release, &self.inputs, next_request, &self.clock);
        self.cycle.rest(&self.clock);
        let telemetry = self.telemetry(&record);
        if record.measurement.is_some() {
            self.unsent = Some(telemetry.command);
        }
        self.records.check(&telemetry)?;
        let replayed = self.replayer.take_record(&telemetry).unwrap();
        replayed.map_or(Ok(()), |cycle| self.count(&cycle))
    }

    /// The telemetry that the reporter would publish.
    fn telemetry(&mut self, record: &CycleRecord) -> Telemetry {
        self.sequence += 1;
        let mut telemetry = Telemetry {
            header: Header {
                sender_id: 1,
                sequence: self.sequence,
                sent_ns: record.handed_over_ns,
            },
            command: convert::command(record, &self.robot, self.period_ns),
            ..convert::telemetry(record, &self.robot, self.period_ns)
        };
        let accepted = record
            .answers
            .iter()
            .flatten()
            .filter(|a| a.outcome.is_ok());
        let stop = core::mem::take(&mut self.stop_asked).then_some(RequestKind::Stop);
        let kinds = accepted.filter_map(|_| self.kind_of_answer).chain(stop);
        let requests = kinds.map(|kind| InputEvent {
            kind: EventKind::Request.code(),
            detail: kind.code(),
            evaluated_ns: record.handed_over_ns,
            ..InputEvent::default()
        });
        let fed = self.fed.take().map(|header| InputEvent {
            sender_id: header.sender_id,
            sequence: header.sequence,
            kind: EventKind::Reference.code(),
            ..InputEvent::default()
        });
        for (place, event) in telemetry
            .events
            .iter_mut()
            .zip(fed.into_iter().chain(requests))
        {
            *place = InputEvent {
                outcome: Outcome::Accepted.code(),
                ..event
            };
            telemetry.event_count += 1;
        }
        telemetry
    }

    /// The gather of the exchange.
    fn gather(&mut self, release_ns: u64) {
        let gather_ns = release_ns - LEAD_NS;
        self.inputs.gather += 1;
        self.inputs.gather_ns = gather_ns;
        let has_tip_beside = self.driver.has_tip_beside();
        for message in self.driver.arrived(gather_ns) {
            let taken = convert::measurement(&message, &self.robot, self.interface, gather_ns);
            let is_tip = message.kind == MeasurementKind::TipPose.code();
            let newest = if is_tip && has_tip_beside {
                &mut self.inputs.tip
            } else {
                &mut self.inputs.measurement
            };
            if let Ok(timed) = taken
                && gather_ns - timed.measured_ns <= self.timeout_ns
                && newest.is_none_or(|newest| newest.measured_ns < timed.measured_ns)
            {
                *newest = Some(timed);
            }
        }
        self.inputs.obstacles.expire(gather_ns);
        self.trajectory.forget_before(gather_ns);
        let steps = self.inputs.settings.nmpc.horizon_steps as usize;
        let window = &mut self.inputs.window;
        window.fill(
            &self.trajectory,
            self.next,
            release_ns,
            self.period_ns,
            steps,
            self.lead_ns,
        );
    }

    /// Actions of clients and machine before the next release.
    fn act(&mut self) {
        let chance = if self.newest_is([Mode::Tracking, Mode::Homing]) {
            1
        } else {
            15
        };
        if self.dice.chance(chance) {
            self.ask();
        }
        if self.dice.chance(1) {
            self.feed();
        }
        if self.dice.chance(1) {
            let states = [LeaseState::Free, LeaseState::Expired];
            self.inputs.lease = self.dice.pick(&states);
        }
        if self.dice.chance(3) {
            self.place_obstacle();
        }
        if self.dice.chance(1) {
            self.set();
        }
        let silent = self.inputs.obstacle_source_silent;
        self.inputs.obstacle_source_silent = self.dice.chance(if silent { 80 } else { 1 });
        // One in a thousand.
        self.inputs.suspends += u64::from(self.dice.below(1000) == 0);
        let is_latched = self.newest_is([Mode::Stopped, Mode::Faulted]);
        if is_latched && self.dice.chance(1) {
            self.driver.push(&mut self.dice);
        }
    }

    fn newest_is<const N: usize>(&self, modes: [Mode; N]) -> bool {
        let newest = self.records.newest();
        newest.is_some_and(|record| modes.map(Mode::code).contains(&record.mode))
    }

    fn ask(&mut self) {
        if self.dice.chance(5) {
            self.inputs.stops += 1;
            self.stop_asked = true;
            return;
        }
        let kinds = [RequestKind::Track, RequestKind::Track, RequestKind::Home];
        let mut kind = self.dice.pick(&kinds);
        if self.newest_is([Mode::Stopped, Mode::Faulted]) {
            // A client removes the touched obstacles, and resets.
            self.inputs.obstacles = ObstacleSet::default();
            kind = RequestKind::Reset;
        } else if self.newest_is([Mode::Holding]) {
            self.feed();
        }
        if self.dice.chance(10) {
            kind = RequestKind::Hold;
        }
        self.asked = Some(kind);
        self.kind_of_answer = self.asked;
    }

    /// A curve around a random position, along the end of the reach where it leaves it.
    fn feed(&mut self) {
        self.inputs.lease = LeaseState::Held;
        let dice = &mut self.dice;
        let reach_m = self.robot.reach_m();
        let centre = Vector3::from(dice.vector(1.0)) * dice.between(0.2, 1.1) * reach_m;
        let radius_m = dice.between(0.0, 0.4) * reach_m;
        let rate_rad_s = dice.between(-8.0, 8.0);
        let interpolation = dice.pick(&[Interpolation::Linear, Interpolation::Cubic]);
        let gap_ns = dice.duration_ms(5, 50).as_nanos() as u64;
        let begin_ns = ORIGIN_NS + (self.next + 1) * self.period_ns;
        self.chunks += 1;
        let mut chunk = ReferenceChunk {
            header: Header {
                sender_id: 1,
                sequence: self.chunks,
                ..Header::default()
            },
            mode: ChunkMode::Replace.code(),
            interpolation: interpolation.code(),
            count: 2 + dice.below(60),
            ..ReferenceChunk::default()
        };
        for (point, k) in chunk.points.iter_mut().zip(0..u64::from(chunk.count)) {
            let (sin, cos) = (rate_rad_s * (k * gap_ns) as f64 * 1e-9).sin_cos();
            point.time_ns = begin_ns + k * gap_ns;
            let position_m = centre + Vector3::new(cos, sin, 0.3 * sin) * radius_m;
            // The exchange refuses what is out of reach.
            point.position_m = position_m.cap_magnitude(reach_m).into();
        }
        if let Ok(points) = convert::reference_points(&chunk, &self.robot, ORIGIN_NS)
            && self.trajectory.replace(points).is_ok()
        {
            self.replayer.take_chunk(&chunk);
            self.fed = Some(chunk.header);
        }
    }

    fn place_obstacle(&mut self) {
        let Some(record) = self.records.newest() else {
            return;
        };
        let dice = &mut self.dice;
        let mut obstacle = match dice.below(10) {
            0..6 => obstacles::near(dice, record),
            6..9 => obstacles::towards(dice, record),
            _ => {
                let turn = dice.below(3);
                obstacles::inside(dice, record, turn)
            }
        };
        let now_ns = record.release_ns;
        obstacle.measured_ns = now_ns;
        if let Ok(known) = convert::obstacle(&obstacle, now_ns) {
            // A full set rejects it.
            let _ = self.inputs.obstacles.upsert(known);
        }
    }

    fn set(&mut self) {
        let dice = &mut self.dice;
        let nmpc = &mut self.inputs.settings.nmpc;
        nmpc.solver = dice.pick(&SolverKind::ALL);
        nmpc.horizon_steps = 1 + dice.below(20);
        nmpc.control_blocks = 1 + dice.below(nmpc.horizon_steps);
        nmpc.safe_distance_m = dice.between(0.0, 0.03);
        nmpc.rate_weight = dice.pick(&[0.0, 1e-3, 1.0]).into();
        self.inputs.settings.budget_ns = dice.pick(&[0, 100_000, 2_000_000]);
        self.inputs.settings_revision += 1;
    }
}

/// A random robot with one to six sections, and with cable limits that become active, behind either
/// interface.
fn configuration(dice: &mut Dice) -> String {
    let mut text = format!(
        "[link]\nkind = \"driver\"\ninterface = \"{}\"\ncommand_valid_ms = {}\n\
         [cycle]\nmiss_limit = {}\n\
         [actuator]\ndelay_ms = {}\ntime_constant_ms = {}\nplay_m = {}\n\
         [motion]\ndeceleration_rad_s2 = {:.2}\nacceleration_rad_s2 = {:.2}\n\
         [robot]\ncable_speed_max_m_s = {:.3}\ncable_stroke_max_m = {:.3}\ntip_speed_max_m_s = {:.3}\n",
        dice.pick(&["velocity", "position"]),
        dice.pick(&["0.0", "40.0"]),
        dice.pick(&["0", "1000000"]),
        dice.pick(&["0.0", "30.0"]),
        dice.pick(&["0.0", "20.0", "100.0"]),
        dice.pick(&["0.0", "0.0004", "0.01"]),
        dice.between(5.0, 60.0),
        dice.between(10.0, 80.0),
        dice.between(0.03, 0.2),
        dice.between(0.03, 0.2),
        [0.0, dice.between(0.02, 0.5)][dice.below(2) as usize],
    );
    for _ in 0..=dice.below(6) {
        writeln!(
            text,
            "[[robot.sections]]\nlength_m = {:.3}\ncable_radius_m = 0.0125\ncable_offset_rad = {:.2}\n\
             bend_max_rad = {:.2}\nrate_max_rad_s = {:.2}\nbody_radius_m = 0.015",
            dice.between(0.1, 0.3),
            dice.between(0.0, 2.0),
            dice.between(1.0, 2.8),
            dice.between(0.5, 4.0),
        )
        .unwrap();
    }
    text
}
