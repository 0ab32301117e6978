//! A recording of telemetry and reference chunks holds everything: each cycle is computed again from
//! it, bit for bit.

use std::collections::{BTreeMap, HashMap};
use std::ops::ControlFlow;

use cdcr_client::{FeedEvent, FeedOptions, Spiral, events};
use cdcr_controller::nmpc::{Nmpc, SolveInput};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::{ReferenceWindow, Trajectory};
use cdcr_controller::robot::{BendRates, Configuration, Robot, RobotParameters, SectionParameters};
use cdcr_controller::safety::ramp_to_zero;
use cdcr_daemon::exchange::convert;
use cdcr_shared_types::codes::{ChunkMode, EventKind, Mode, Outcome};
use cdcr_shared_types::limits::REFERENCE_POINTS_MAX;
use cdcr_shared_types::{InputEvent, ReferenceChunk, SectionDescription, Telemetry};
use cdcr_tests::Daemon;

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

/// The robot of a record.
fn robot_of(record: &Telemetry) -> Robot {
    let used = &record.robot.section[..record.robot.sections as usize];
    let section = |section: &SectionDescription| SectionParameters {
        length_m: section.length_m,
        cable_radius_m: section.cable_radius_m,
        cable_offset_rad: section.cable_offset_rad,
        bend_max_rad: section.bend_max_rad,
        rate_max_rad_s: section.rate_max_rad_s,
        body_radius_m: section.body_radius_m,
    };
    let parameters = RobotParameters {
        sections: used.iter().map(section).collect(),
        cable_speed_max_m_s: record.robot.cable_speed_max_m_s,
    };
    Robot::new(&parameters).unwrap()
}

/// Computes the solve of a record again.
fn solve_again(record: &Telemetry, robot: &Robot, trajectory: &Trajectory) -> Vec<u64> {
    let settings = convert::settings_from_wire(&record.settings).expect("they were in force");
    let period_s = record.period_ns as f64 * 1e-9;
    let mut nmpc = Nmpc::new(robot.clone(), period_s, settings).expect("they were in force");
    let length = record.plan_length as usize;
    assert!(nmpc.restore_plan(&record.warm_plan[..length]));
    let mut window = ReferenceWindow::default();
    let steps = settings.horizon_steps as usize;
    let late_ns = (record.cycle - record.window_first_cycle) * record.period_ns;
    window.fill(
        trajectory,
        record.window_first_cycle,
        record.release_ns - late_ns,
        record.period_ns,
        steps,
    );
    let width = robot.coordinate_count();
    let input = SolveInput {
        configuration: &Configuration::from_slice(&record.bend_rad[..width])
            .expect("a configuration"),
        previous_rates: &BendRates::from_slice(&record.previous_rate_rad_s[..width])
            .expect("rates"),
        reference: window.ahead(record.cycle, steps),
        // The recorded warm start is moved on in time already.
        elapsed_periods: 0,
        seed: record.report.seed,
    };
    let (_, report) = nmpc.solve(&input, &mut Budget::<()>::of_quanta(record.report.quanta));
    assert_eq!(report.evaluations, record.report.evaluations);
    assert_eq!(report.cost.to_bits(), record.report.cost.to_bits());
    nmpc.plan().iter().map(|rate| rate.to_bits()).collect()
}

#[test]
fn every_recorded_cycle_is_computed_again_bit_for_bit() {
    let daemon = Daemon::start("");
    let connection = daemon.connect();
    let mut sent = connection.references().unwrap();
    let (mut records, mut chunks) = (Vec::new(), HashMap::new());
    let spiral = Spiral {
        duration_s: 1.5,
        ..Spiral::for_sections(&[0.3; 3])
    };
    let options = FeedOptions {
        track: true,
        ..FeedOptions::default()
    };
    let mut collect = |records: &mut Vec<Telemetry>, event: FeedEvent<'_>| {
        if let FeedEvent::Record(record) = event {
            records.push(*record);
        }
        while let Some(chunk) = sent.try_next().unwrap() {
            chunks.insert((chunk.header.sender_id, chunk.header.sequence), chunk);
        }
    };
    connection
        .feed(&spiral, options)
        .unwrap()
        .run(|event| {
            collect(&mut records, event);
            ControlFlow::Continue(())
        })
        .unwrap();

    let robot = robot_of(&records[0]);
    assert_eq!(records[0].robot.fingerprint, robot.fingerprint());
    let mut to_come = events_by_gather(&records);
    let mut trajectory = Trajectory::with_capacity(REFERENCE_POINTS_MAX);
    let mut solved = 0;
    for record in &records {
        while let Some(entry) = to_come.first_entry()
            && *entry.key() <= record.gather
        {
            for event in entry.remove() {
                apply(&event, &chunks, &robot, &mut trajectory);
            }
        }
        check_rest(record);
        if record.plan_length == 0 {
            continue;
        }
        let length = record.plan_length as usize;
        let recorded: Vec<_> = record.plan[..length]
            .iter()
            .map(|rate| rate.to_bits())
            .collect();
        let again = solve_again(record, &robot, &trajectory);
        assert_eq!(again, recorded, "cycle {}", record.cycle);
        solved += 1;
    }
    assert!(solved > 100, "only {solved} cycles were solved");
}

/// A cycle that held: its command is the ramp from the rates before.
fn check_rest(record: &Telemetry) {
    if record.mode != Mode::Holding.code() {
        return;
    }
    let width = 2 * record.robot.sections as usize;
    let before = BendRates::from_slice(&record.previous_rate_rad_s[..width]).unwrap();
    let period_s = record.period_ns as f64 * 1e-9;
    let rates = ramp_to_zero(&before, record.deceleration_rad_s2, period_s);
    assert_eq!(rates.as_slice(), &record.command.bend_rate_rad_s[..width]);
}
