//! A recording of telemetry and reference chunks holds everything: each cycle, with its obstacles, is
//! computed again from it, bit for bit.

use std::collections::{BTreeMap, HashMap};
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use cdcr_client::{FeedError, FeedEvent, Line, Spiral, Trajectory as Curve, events, monotonic_ns};
use cdcr_controller::estimator::Slack;
use cdcr_controller::nmpc::{Nmpc, SolveInput};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::plant::{Flaws, Preset};
use cdcr_controller::reference::{Approach, ReferenceWindow, Trajectory};
use cdcr_controller::robot::{BendRates, Configuration, Robot};
use cdcr_controller::safety::{Situation, ramp_to_zero, safe_command};
use cdcr_daemon::convert;
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Interface, MeasurementKind, Mode, ObstacleShape, Outcome, Reason,
};
use cdcr_shared_types::limits::REFERENCE_POINTS_MAX;
use cdcr_shared_types::{InputEvent, ReferenceChunk, Telemetry, codes};
use nalgebra::Vector3;

use cdcr_tests::record::{configuration_of, largest, obstacles_of, robot_of};
use cdcr_tests::robot::DrivenRobot;
use cdcr_tests::{Daemon, EndWhenDropped, PATIENT, TIMEOUT, tracked, until_undisturbed, wait_mode};

/// The events of a recording by the gather that they took effect with, in order.
fn events_by_gather(records: &[Telemetry]) -> BTreeMap<u64, Vec<InputEvent>> {
    let mut by_gather = BTreeMap::<u64, Vec<_>>::new();
    for record in records {
        for event in events(record) {
            let gather = record.gather - u64::from(event.gathers_ago);
            by_gather.entry(gather).or_default().push(*event);
        }
    }
    by_gather
}

/// Repeats what the exchange did with a chunk that it accepted.
fn apply(
    event: &InputEvent,
    chunks: &HashMap<(u64, u64), ReferenceChunk>,
    robot: &Robot,
    trajectory: &mut Trajectory,
) {
    let accepted = event.outcome == Outcome::Accepted.code();
    if event.kind != EventKind::Reference.code() || !accepted {
        return;
    }
    let chunk = &chunks[&(event.sender_id, event.sequence)];
    let points = convert::reference_points(chunk, robot, event.judged_ns)
        .map_err(|refused| refused.outcome)
        .expect("it was accepted");
    if chunk.mode == ChunkMode::Replace.code() {
        trajectory.replace(points).expect("it was accepted");
    } else {
        trajectory.append(points).expect("it was accepted");
    }
}

/// The state of a record, and the rates of the command before.
fn state_of(record: &Telemetry) -> (Configuration, BendRates) {
    let at = configuration_of(record);
    let width = at.as_slice().len();
    let before = BendRates::from_slice(&record.previous_rate_rad_s[..width]).unwrap();
    (at, before)
}

fn approach_of(record: &Telemetry) -> Approach {
    Approach {
        begin_ns: record.approach.begin_ns,
        duration_ns: record.approach.duration_ns,
        joining_ns: record.approach.joining_ns,
        offset_m: record.approach.offset_m.into(),
        velocity_m_s: record.approach.velocity_m_s.into(),
        turn_rad: record.approach.turn_rad.into(),
    }
}

/// Computes the solve of a record again; the rates that it wants.
fn solve_again(record: &Telemetry, robot: &Robot, trajectory: &Trajectory) -> BendRates {
    let settings = convert::settings_from_wire(&record.settings, record.period_ns);
    let settings = settings.expect("they were in force");
    let settings = settings.nmpc;
    let period_s = record.period_ns as f64 * 1e-9;
    let mut nmpc = Nmpc::new(robot.clone(), period_s, settings).expect("they were in force");
    let length = record.plan_length as usize;
    assert!(nmpc.restore_plan(&record.warm_plan[..length]));
    let mut window = ReferenceWindow::default();
    let steps = settings.horizon_steps as usize;
    // A cycle that is late has inputs that were gathered for the next one.
    let ahead = record.window_first_cycle.cast_signed() - record.cycle.cast_signed();
    let ahead_ns = ahead * record.period_ns.cast_signed();
    window.fill(
        trajectory,
        record.window_first_cycle,
        record.release_ns.saturating_add_signed(ahead_ns),
        record.period_ns,
        steps,
        record.reference_lead_ns,
    );
    let (at, before) = state_of(record);
    let offset_m = Vector3::from(record.tip_offset_m);
    let approach = approach_of(record);
    let samples = window.ahead(record.cycle, steps).iter().zip(1..);
    let led = samples.map(|(sample, step)| {
        let time_ns = record.release_ns + step * record.period_ns;
        approach.led(sample, time_ns).moved(&-offset_m)
    });
    let reference: Vec<_> = led.collect();
    let input = SolveInput {
        configuration: &at,
        previous_rates: &before,
        reference: &reference,
        obstacles: &obstacles_of(record),
        tip_offset_m: offset_m.norm(),
        // The recorded warm start is moved on in time already.
        elapsed_periods: 0,
        seed: record.report.seed,
    };
    let (rates, report) = nmpc.solve(&input, &mut Budget::of_quanta(record.report.quanta));
    assert_eq!(report.evaluations, record.report.evaluations);
    assert_eq!(report.cost.to_bits(), record.report.cost.to_bits());
    let again = bits(nmpc.plan());
    assert_eq!(
        again,
        bits(&record.plan[..length]),
        "cycle {}",
        record.cycle
    );
    rates
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// Computes again what limits and guard make of the rates that the mode desires. Whether the guard changed them, and whether for the play alone.
fn command_again(record: &Telemetry, robot: &Robot, desired: &BendRates) -> [bool; 2] {
    let (at, previous) = state_of(record);
    let width = robot.coordinate_count();
    let commanded = Configuration::from_slice(&record.commanded_rad[..width]).unwrap();
    let motors = Configuration::from_slice(&record.motor_rad[..width]).unwrap();
    let obeys_positions = record.command.interface == Interface::Position.code();
    let moving_ns = if obeys_positions {
        record.period_ns
    } else {
        record.command.valid_until_ns - record.release_ns
    };
    let slack = (record.play_m > 0.0).then(|| Slack::new(record.play_m, record.slack_m));
    let situation = Situation {
        robot,
        at: &at,
        commanded: if obeys_positions {
            Some(&commanded)
        } else {
            Some(&motors).filter(|motors| **motors != at)
        },
        slack: slack.as_ref(),
        previous: &previous,
        obstacles: &obstacles_of(record),
        safe_distance_m: record.settings.safe_distance_m,
        tip_offset_m: Vector3::from(record.tip_offset_m).norm(),
        acceleration_rad_s2: record.acceleration_rad_s2,
        period_s: record.period_ns as f64 * 1e-9,
        moving_s: moving_ns as f64 * 1e-9,
        deceleration_rad_s2: record.deceleration_rad_s2,
        comes_to_rest: ![Mode::Tracking, Mode::Homing]
            .map(Mode::code)
            .contains(&record.mode),
    };
    let safe = safe_command(&situation, desired);
    let command = &record.command;
    assert_eq!(
        bits(safe.rates.as_slice()),
        bits(&command.bend_rate_rad_s[..width]),
        "cycle {}",
        record.cycle
    );
    let target = commanded.advanced(&safe.rates, situation.period_s);
    assert_eq!(
        bits(target.as_slice()),
        bits(&command.bend_target_rad[..width])
    );
    if record.reference_lead_ns == 0 {
        assert_eq!(safe.clearance_m.to_bits(), record.clearance_m.to_bits());
    }
    let flagged = record.guard_flags & codes::guard::CLEARANCE != 0;
    assert_eq!(safe.clearance_hit, flagged);
    let accelerated = record.guard_flags & codes::guard::ACCELERATION != 0;
    assert_eq!(safe.limits_hit.acceleration, accelerated);
    let without_play = Situation {
        slack: None,
        ..situation
    };
    let by_play = safe.rates != safe_command(&without_play, desired).rates;
    [flagged, by_play]
}

/// How many cycles solved, and how many commands the guard changed: of those, which only for the play of the cables.
#[derive(Debug, Default)]
struct Replayed {
    solved: u32,
    guarded: u32,
    by_play: u32,
}

#[derive(Default)]
struct Recording {
    records: Vec<Telemetry>,
    chunks: HashMap<(u64, u64), ReferenceChunk>,
}

impl Recording {
    /// A daemon with this configuration that tracks `curve` past `known`.
    fn make(configuration: &str, known: &[cdcr_shared_types::Obstacle], curve: &dyn Curve) -> Self {
        Self::of(&Daemon::start(configuration), known, curve)
    }

    /// This daemon tracks `curve` past `known`.
    fn of(daemon: &Daemon, known: &[cdcr_shared_types::Obstacle], curve: &dyn Curve) -> Self {
        let connection = daemon.connect();
        let mut telemetry = connection.telemetry().unwrap();
        let sender = connection.obstacle_sender().unwrap();
        let header = sender.upsert(known).unwrap();
        let verdict = telemetry.outcome_on(EventKind::Obstacles, &header, TIMEOUT);
        assert_eq!(verdict.unwrap(), Outcome::Accepted);
        let mut sent = connection.references().unwrap();
        until_undisturbed("a curve is tracked to its end", || {
            let mut recording = Self::default();
            let fed = connection.feed(curve, tracked()).unwrap().run(|event| {
                if let FeedEvent::Record(record) = event {
                    recording.records.push(*record);
                }
                while let Some(chunk) = sent.try_next().unwrap() {
                    let of = (chunk.header.sender_id, chunk.header.sequence);
                    recording.chunks.insert(of, chunk);
                }
                ControlFlow::Continue(())
            });
            match fed {
                // The machine held the exchange up: its inputs were stale.
                Err(FeedError::LeftTracking { reason, .. })
                    if reason == Reason::InputsStale.text() =>
                {
                    None
                }
                fed => fed.map(|_| recording).map(Some).unwrap(),
            }
        })
    }

    /// Computes every cycle again.
    fn replay(&self) -> Replayed {
        let robot = robot_of(&self.records[0].robot);
        assert_eq!(self.records[0].robot.fingerprint, robot.fingerprint());
        let mut to_come = events_by_gather(&self.records);
        let mut trajectory = Trajectory::with_capacity(REFERENCE_POINTS_MAX, robot.reach_m());
        let mut replayed = Replayed::default();
        for record in &self.records {
            while let Some(entry) = to_come.first_entry()
                && *entry.key() <= record.gather
            {
                for event in entry.remove() {
                    apply(&event, &self.chunks, &robot, &mut trajectory);
                }
            }
            let desired_rates = if record.plan_length > 0 {
                replayed.solved += 1;
                solve_again(record, &robot, &trajectory)
            } else if record.mode == Mode::Holding.code() {
                let (_, before) = state_of(record);
                let period_s = record.period_ns as f64 * 1e-9;
                ramp_to_zero(&before, record.deceleration_rad_s2, period_s)
            } else {
                continue;
            };
            let [guarded, by_play] = command_again(record, &robot, &desired_rates);
            replayed.guarded += u32::from(guarded);
            replayed.by_play += u32::from(by_play);
        }
        assert!(replayed.solved > 100, "too few cycles: {replayed:?}");
        replayed
    }
}

/// The solver sees no obstacle in its cost, so that the guard has to act.
const BLIND: &str = "[controller]\nobstacle_step_penalty = 0.0\nobstacle_slope_penalty = 0.0\n";

/// The bar may come nearer than it should, and what it touches goes on.
const CONTACT: &str = "[safety]\nclearance_fault_m = -1.0\n";

fn spiral() -> Spiral {
    Spiral {
        duration_s: 1.5,
        ..Spiral::for_sections(&[0.3; 3])
    }
}

/// A ball that stands on the paper's line, and a bar that comes from the side.
fn in_the_way() -> [cdcr_shared_types::Obstacle; 2] {
    let ball = cdcr_shared_types::Obstacle {
        id: 1,
        start_m: [0.055, 0.0, 0.885],
        radius_m: 0.02,
        measured_ns: monotonic_ns(),
        ..Default::default()
    };
    let bar = cdcr_shared_types::Obstacle {
        id: 2,
        shape: ObstacleShape::Capsule.code(),
        start_m: [-0.1, -0.2, 0.5],
        end_m: [-0.1, 0.2, 0.5],
        velocity_m_s: [0.02, 0.0, 0.0],
        ..ball
    };
    [ball, bar]
}

#[test]
fn every_recorded_cycle_is_computed_again_bit_for_bit() {
    let replayed = Recording::make(PATIENT, &[], &spiral()).replay();
    assert_eq!(replayed.guarded, 0);
}

#[test]
fn cycles_with_obstacles_are_computed_again_bit_for_bit() {
    let recording = Recording::make(&format!("{PATIENT}{CONTACT}"), &in_the_way(), &spiral());
    assert!(recording.records.iter().all(|r| r.obstacle_count == 2));
    recording.replay();
}

#[test]
fn cycles_that_the_guard_changed_are_computed_again_bit_for_bit() {
    let configuration = format!("{PATIENT}{BLIND}{CONTACT}");
    let line = Line::for_sections(&[0.3; 3]);
    let replayed = Recording::make(&configuration, &in_the_way(), &line).replay();
    assert!(replayed.guarded > 10, "{replayed:?}");
}

#[test]
fn cycles_that_the_play_of_cables_changed_are_computed_again_bit_for_bit() {
    let play = "[actuator]\nplay_m = 1.5e-3\n";
    let configuration = format!("{PATIENT}{BLIND}{CONTACT}{play}");
    let line = Line::for_sections(&[0.3; 3]);
    let recording = Recording::make(&configuration, &in_the_way(), &line);
    let replayed = recording.replay();
    assert!(replayed.by_play > 10, "{replayed:?}");
}

#[test]
fn cycles_of_a_robot_that_obeys_positions_are_computed_again_bit_for_bit() {
    let positions = "[link]\ninterface = \"position\"\n[motion]\napproach = \"direct\"\nacceleration_rad_s2 = 15.0\n";
    let recording = Recording::make(&format!("{PATIENT}{positions}"), &[], &spiral());
    recording.replay();
    let is_cut = |record: &&Telemetry| record.guard_flags & codes::guard::ACCELERATION != 0;
    assert!(recording.records.iter().any(|record| is_cut(&record)));
}

#[test]
fn cycles_of_a_robot_whose_motors_lag_and_cables_have_play_are_computed_again_bit_for_bit() {
    let lagging =
        "[link]\nsimulated = \"sloppy\"\n[actuator]\ntime_constant_ms = 20.0\nplay_m = 3e-4\n";
    let recording = Recording::make(&format!("{PATIENT}{lagging}"), &[], &spiral());
    let is_led = |record: &Telemetry| {
        record.reference_lead_ns == 20_000_000 && record.present_rad != record.bend_rad
    };
    assert!(recording.records.iter().any(is_led));
    let is_approached = |record: &Telemetry| record.approach.duration_ns > 0;
    assert!(recording.records.iter().any(is_approached));
    recording.replay();
}

/// A robot that is longer than its model, and measures its tip beside its cables: the guard keeps the obstacles as much farther away.
#[test]
fn cycles_of_a_robot_whose_tip_is_beside_its_bends_are_computed_again_bit_for_bit() {
    // On a machine that stalls the driver does not follow in time.
    let driver = "following_fault_rad = 100.0\n[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 10000.0\n";
    let daemon = Daemon::start(&format!("{PATIENT}{BLIND}{CONTACT}{driver}"));
    let ends = AtomicBool::new(false);
    let drive = || {
        let longer = Flaws {
            length_error: 0.03,
            ..Preset::Laboratory.flaws()
        };
        let connection = daemon.connect();
        let mut robot =
            DrivenRobot::with_flaws(&connection, Interface::Velocity, [0.0; 12], longer);
        while !ends.load(Ordering::Relaxed) {
            robot.follow();
            robot.measure(MeasurementKind::CableLengths);
            robot.measure(MeasurementKind::TipPose);
            std::thread::sleep(Duration::from_millis(2));
        }
    };
    let recording = std::thread::scope(|scope| {
        let _ends = EndWhenDropped(&ends);
        scope.spawn(drive);
        let connection = daemon.connect();
        wait_mode(&mut connection.telemetry().unwrap(), Mode::Holding);
        Recording::of(&daemon, &in_the_way(), &Line::for_sections(&[0.3; 3]))
    });
    let is_beside =
        |record: &&Telemetry| record.plan_length > 0 && largest(&record.tip_offset_m) > 1e-3;
    let beside = recording.records.iter().filter(is_beside).count();
    assert!(beside > 50, "{beside} of {}", recording.records.len());
    let replayed = recording.replay();
    assert!(replayed.guarded > 10, "{replayed:?}");
}
