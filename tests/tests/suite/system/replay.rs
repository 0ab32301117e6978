//! A recording of telemetry and reference chunks is complete: each cycle, with its obstacles, is recomputed
//! from it, bit for bit.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use cdcr_client::model::robot_of;
use cdcr_client::replay::{Outcome, Replayer};
use cdcr_client::{FeedError, FeedEvent, Line, Spiral, Trajectory as Curve, events};
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::robot::{BendRates, Configuration};
use cdcr_shared_types::codes::{
    EventKind, Interface, MeasurementKind, Mode, ObstacleShape, Outcome as Answer, Reason, guard,
};
use cdcr_shared_types::{ReferenceChunk, Telemetry};

use cdcr_tests::record::largest;
use cdcr_tests::robot::DrivenRobot;
use cdcr_tests::{
    Daemon, EndWhenDropped, STALL_TOLERANT, TIMEOUT, ball, paper_line, tracked, until_undisturbed,
    wait_mode,
};

/// Numbers of solves, of commands changed by the guard, and of those changed only because of the play of the
/// cables.
#[derive(Debug, Default)]
struct Replayed {
    solved: u32,
    guarded: u32,
    by_play: u32,
}

#[derive(Default)]
struct Recording {
    records: Vec<Telemetry>,
    chunks: Vec<ReferenceChunk>,
}

impl Recording {
    /// A daemon with this configuration that tracks `curve` past `known`.
    fn make(configuration: &str, known: &[cdcr_shared_types::Obstacle], curve: &dyn Curve) -> Self {
        Self::record(&Daemon::start(configuration), known, curve)
    }

    /// This daemon tracks `curve` past `known`.
    fn record(daemon: &Daemon, known: &[cdcr_shared_types::Obstacle], curve: &dyn Curve) -> Self {
        let connection = daemon.connect();
        let mut telemetry = connection.telemetry().unwrap();
        let sender = connection.obstacle_sender().unwrap();
        let header = sender.upsert(known).unwrap();
        let outcome = telemetry.outcome_on(EventKind::Obstacles, &header, TIMEOUT);
        assert_eq!(outcome.unwrap(), Answer::Accepted);
        let mut sent = connection.references().unwrap();
        until_undisturbed("a curve is tracked to its end", || {
            let mut recording = Self::default();
            let fed = connection.feed(curve, tracked()).unwrap().run(|event| {
                if let FeedEvent::Record(record) = event {
                    recording.records.push(*record);
                }
                while let Some(chunk) = sent.try_next().unwrap() {
                    recording.chunks.push(chunk);
                }
                ControlFlow::Continue(())
            });
            match fed {
                // The machine delayed this reader for longer than the queues of records or chunks last.
                Ok(report) if report.lost_records + sent.lost() > 0 => None,
                // The machine delayed the exchange: its inputs were stale.
                Err(FeedError::LeftTracking { reason, .. })
                    if reason == Reason::InputsStale.text() =>
                {
                    None
                }
                fed => fed.map(|_| recording).map(Some).unwrap(),
            }
        })
    }

    /// Recomputes every cycle.
    fn replay(&self) -> Replayed {
        let mut replayed = Replayed::default();
        for outcome in self.outcomes() {
            let Outcome::Reproduced(made) = outcome else {
                panic!("{outcome:?}");
            };
            replayed.solved += u32::from(made.solved);
            replayed.guarded += u32::from(made.guarded);
            replayed.by_play += u32::from(made.by_play);
        }
        assert!(replayed.solved > 100, "too few cycles: {replayed:?}");
        replayed
    }

    /// Number of cycles without a known reference if the record `at` is missing: the chunks of that record
    /// are unknown until the next one.
    fn unknown_without(&self, at: usize) -> usize {
        let (before, after) = (&self.records[at - 1], &self.records[at + 1..]);
        let takes = |record: &Telemetry| {
            let accepted = events(record).iter().filter(|event| {
                (event.kind, event.outcome)
                    == (EventKind::Reference.code(), Answer::Accepted.code())
            });
            let gathers = accepted.map(|event| record.gather - u64::from(event.gathers_ago));
            gathers.filter(|gather| *gather > before.gather).min()
        };
        let known_from = after.iter().filter_map(takes).min().unwrap_or(u64::MAX);
        let unknown = after.iter().filter(|record| record.gather < known_from);
        unknown.filter(|record| solves(record)).count()
    }

    fn outcomes(&self) -> Vec<Outcome> {
        let mut replayer = Replayer::default();
        for chunk in &self.chunks {
            replayer.take_chunk(chunk);
        }
        let mut outcomes = Vec::new();
        for record in &self.records {
            outcomes.extend(replayer.take_record(record).unwrap());
        }
        while let Some(cycle) = replayer.finish_one().unwrap() {
            outcomes.push(cycle);
        }
        assert_eq!(outcomes.len(), self.records.len());
        outcomes.into_iter().map(|cycle| cycle.outcome).collect()
    }
}

/// The solver's cost ignores obstacles, so that the guard has to act.
const BLIND: &str = "[controller]\nobstacle_step_penalty = 0.0\nobstacle_slope_penalty = 0.0\n";

/// The bar may come nearer than the safe distance, and contact is not a fault.
const CONTACT: &str = "[safety]\nclearance_fault_m = -1.0\n";

fn solves(record: &Telemetry) -> bool {
    record.plan_length > 0
}

fn spiral() -> Spiral {
    Spiral {
        duration_s: 1.5,
        ..Spiral::for_sections(&[0.3; 3])
    }
}

/// A ball at rest on the paper's line, and a bar that comes from the side.
fn in_the_way() -> [cdcr_shared_types::Obstacle; 2] {
    let bar = cdcr_shared_types::Obstacle {
        shape: ObstacleShape::Capsule.code(),
        end_m: [-0.1, 0.2, 0.5],
        velocity_m_s: [0.02, 0.0, 0.0],
        ..ball(2, [-0.1, -0.2, 0.5])
    };
    [ball(1, [0.055, 0.0, 0.885]), bar]
}

#[test]
fn a_bit_that_is_wrong_is_found_and_a_missing_record_makes_no_other_wrong() {
    let recording = Recording::make(STALL_TOLERANT, &[], &spiral());
    let first = recording.records.iter().position(solves).unwrap();
    // A record whose loss makes only some of the later cycles unknown: while the machine stalls, a client may
    // send many chunks at once.
    let last = recording.records.len() - 1;
    let all = |at: usize| recording.records[at + 1..].iter().filter(|r| solves(r));
    let is_between = |at: &usize| (1..all(*at).count()).contains(&recording.unknown_without(*at));
    let at = (first + 50..last).find(is_between).unwrap_or(first + 50);
    let altered = |change: fn(&mut Telemetry)| {
        let mut records = recording.records.clone();
        change(&mut records[at]);
        let chunks = recording.chunks.clone();
        Recording { records, chunks }.outcomes()
    };
    for (change, field) in [
        (
            (|record| record.plan[3] += f64::EPSILON) as fn(&mut Telemetry),
            "plan[3]",
        ),
        (|record| record.clearance_m = 0.5, "clearance_m"),
        (
            |record| record.command.bend_rate_rad_s[0] += 1e-12,
            "command.bend_rate_rad_s[0]",
        ),
        (
            |record| record.tip_position_m[2] += f64::EPSILON,
            "tip_position_m[2]",
        ),
        (|record| record.position_error_m *= 2.0, "position_error_m"),
        (|record| record.report.iterations += 1, "report.iterations"),
        (
            |record| record.robot.section[1].cable_radius_m *= 0.9,
            "robot",
        ),
        (|record| record.mode = Mode::Homing.code(), "mode"),
        (|record| record.lease_number += 1, "mode"),
    ] {
        let outcomes = altered(change);
        assert!(
            matches!(&outcomes[at], Outcome::Different(found) if found.what == field),
            "{field}: {:?}",
            outcomes[at]
        );
    }
    let mut records = recording.records.clone();
    records.remove(at);
    let chunks = recording.chunks.clone();
    let outcomes = Recording { records, chunks }.outcomes();
    let different = outcomes
        .iter()
        .find(|outcome| matches!(outcome, Outcome::Different(_)));
    assert_eq!(different, None);
    let unknown = outcomes
        .iter()
        .filter(|outcome| **outcome == Outcome::WithoutReference);
    assert_eq!(unknown.count(), recording.unknown_without(at));
}

#[test]
fn cycles_that_the_guard_changed_are_computed_again_bit_for_bit() {
    let configuration = format!("{STALL_TOLERANT}{BLIND}{CONTACT}");
    let line = Line::for_sections(&[0.3; 3]);
    let replayed = Recording::make(&configuration, &in_the_way(), &line).replay();
    assert!(replayed.guarded > 10, "{replayed:?}");
}

#[test]
fn cycles_that_the_play_of_cables_changed_are_computed_again_bit_for_bit() {
    let play = "[actuator]\nplay_m = 1.5e-3\n";
    let configuration = format!("{STALL_TOLERANT}{BLIND}{CONTACT}{play}");
    let line = Line::for_sections(&[0.3; 3]);
    let recording = Recording::make(&configuration, &in_the_way(), &line);
    let replayed = recording.replay();
    assert!(replayed.by_play > 10, "{replayed:?}");
}

#[test]
fn cycles_of_a_robot_that_obeys_positions_are_computed_again_bit_for_bit() {
    let positions = "[link]\ninterface = \"position\"\n[motion]\napproach = \"direct\"\nacceleration_rad_s2 = 15.0\n";
    let recording = Recording::make(&format!("{STALL_TOLERANT}{positions}"), &[], &spiral());
    recording.replay();
    // The plan grows as fast as allowed.
    let grows = |pair: &[Telemetry]| {
        let most_rad_s = 15.0 * pair[1].period_ns as f64 * 1e-9;
        let [before, now] = [0, 1].map(|i| pair[i].command.bend_rate_rad_s);
        let mut grown = before.iter().zip(now).map(|(a, b)| b.abs() - a.abs());
        grown.any(|grown| grown > 0.999 * most_rad_s)
    };
    assert!(recording.records.windows(2).any(grows));
}

#[test]
fn cycles_of_a_robot_whose_motors_lag_and_cables_have_play_are_computed_again_bit_for_bit() {
    let lagging =
        "[link]\nsimulated = \"sloppy\"\n[actuator]\ntime_constant_ms = 20.0\nplay_m = 3e-4\n";
    let recording = Recording::make(&format!("{STALL_TOLERANT}{lagging}"), &[], &spiral());
    let is_led = |record: &Telemetry| {
        record.reference_lead_ns == 20_000_000 && record.present_rad != record.bend_rad
    };
    assert!(recording.records.iter().any(is_led));
    let is_approached = |record: &Telemetry| record.approach.duration_ns > 0;
    assert!(recording.records.iter().any(is_approached));
    recording.replay();
}

/// A robot that is longer than its model, with a measured tip and measured cables: the guard increases the
/// distance from obstacles accordingly.
#[test]
fn cycles_of_a_robot_whose_tip_is_beside_its_bends_are_computed_again_bit_for_bit() {
    // On a stalled machine the driver does not follow in time.
    let driver = "following_fault_rad = 100.0\n[link]\nkind = \"driver\"\nmeasurement_timeout_ms = 10000.0\n";
    let daemon = Daemon::start(&format!("{STALL_TOLERANT}{BLIND}{CONTACT}{driver}"));
    let ends = AtomicBool::new(false);
    let drive = || {
        let longer = Flaws {
            length_error: 0.03,
            ..RobotPreset::Laboratory.flaws()
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
        Recording::record(&daemon, &in_the_way(), &Line::for_sections(&[0.3; 3]))
    });
    let is_beside =
        |record: &&Telemetry| record.plan_length > 0 && largest(&record.tip_offset_m) > 1e-3;
    let beside = recording.records.iter().filter(is_beside).count();
    assert!(beside > 50, "{beside} of {}", recording.records.len());
    let replayed = recording.replay();
    assert!(replayed.guarded > 10, "{replayed:?}");
}

/// A reference of 0.3 m/s leaves a tip behind that may move at 0.05 m/s. No command is faster, and every cycle is
/// recomputed with the limit of its record.
#[test]
fn a_reference_above_the_speed_limit_is_followed_at_the_limit_and_replayed() {
    const LIMIT_M_S: f64 = 0.05;
    let configuration = format!(
        "{STALL_TOLERANT}[robot]\ntip_speed_max_m_s = {LIMIT_M_S}\n[link]\nsimulated = \"laboratory\"\n"
    );
    let line = Line {
        velocity_m_s: [0.28, 0.0, -0.1],
        ..paper_line(0.7)
    };
    let recording = Recording::make(&configuration, &[], &line);
    recording.replay();
    let robot = robot_of(&recording.records[0].robot).unwrap();
    assert_eq!(robot.tip_speed_max_m_s(), Some(LIMIT_M_S));
    let (mut fastest_m_s, mut limited) = (0.0_f64, 0);
    for record in &recording.records {
        let at = Configuration::from_slice(&record.bend_rad[..6]).unwrap();
        let rates = BendRates::from_slice(&record.command.bend_rate_rad_s[..6]).unwrap();
        fastest_m_s = fastest_m_s.max(robot.fastest_section_end_m_s(&at, &rates));
        limited += u32::from(record.guard_flags & guard::TIP_SPEED != 0);
    }
    println!("{fastest_m_s} m/s, {limited} cycles at the limit");
    assert!(limited > 50 && fastest_m_s > 0.99 * LIMIT_M_S);
    assert!(fastest_m_s <= LIMIT_M_S * (1.0 + 1e-9));
}
