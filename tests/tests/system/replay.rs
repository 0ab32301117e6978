//! A recording of telemetry and reference chunks holds everything: each cycle is computed again from
//! it, bit for bit.

use std::collections::HashMap;
use std::ops::ControlFlow;

use cdcr_client::{FeedEvent, FeedOptions, Spiral, events};
use cdcr_controller::nmpc::{Nmpc, SolveInput};
use cdcr_controller::optimizer::Budget;
use cdcr_controller::reference::{ReferenceWindow, Trajectory};
use cdcr_controller::robot::{BendRates, Configuration, Robot, RobotParameters};
use cdcr_daemon::exchange::convert;
use cdcr_shared_types::codes::{ChunkMode, EventKind, Mode, Outcome};
use cdcr_shared_types::limits::REFERENCE_POINTS_MAX;
use cdcr_shared_types::{ReferenceChunk, Telemetry};
use cdcr_tests::{Daemon, wait_status};

/// Repeats what the exchange did with the chunks that a record reports as accepted.
fn apply_events(
    record: &Telemetry,
    chunks: &HashMap<(u64, u64), ReferenceChunk>,
    robot: &Robot,
    trajectory: &mut Trajectory,
) {
    for event in events(record) {
        let accepted = event.outcome == Outcome::Accepted.code();
        if event.kind != EventKind::Reference.code() || !accepted {
            continue;
        }
        let chunk = &chunks[&(event.sender_id, event.sequence)];
        let points =
            convert::reference_points(chunk, robot, event.judged_ns).expect("it was accepted");
        if chunk.mode == ChunkMode::Replace.code() {
            trajectory.replace(points).expect("it was accepted");
        } else {
            trajectory.append(points).expect("it was accepted");
        }
    }
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
    window.fill(
        trajectory,
        record.cycle,
        record.release_ns,
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

    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let status = wait_status(&connection, |_| true);
    assert_eq!(status.robot.fingerprint, robot.fingerprint());
    let mut trajectory = Trajectory::with_capacity(REFERENCE_POINTS_MAX);
    let mut solved = 0;
    for record in &records {
        apply_events(record, &chunks, &robot, &mut trajectory);
        if record.mode != Mode::Tracking.code() || record.plan_length == 0 {
            continue;
        }
        let length = record.plan_length as usize;
        let recorded: Vec<_> = record.plan[..length]
            .iter()
            .map(|rate| rate.to_bits())
            .collect();
        assert_eq!(
            solve_again(record, &robot, &trajectory),
            recorded,
            "cycle {}",
            record.cycle
        );
        solved += 1;
    }
    assert!(solved > 100, "only {solved} cycles were solved");
}
