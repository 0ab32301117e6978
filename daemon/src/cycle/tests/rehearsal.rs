//! Rehearsals have no effect.

use std::path::Path;

use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::robot::{Obstacle, Shape};
use cdcr_controller::safety::Request;
use nalgebra::Vector3;

use super::super::*;
use super::trial::{BEGIN_NS, PERIOD_NS, TRACK, Trial};
use crate::config::{Config, Interface};
use crate::convert;
use crate::obstacles::KnownObstacle;

/// All records of a robot with a tip sensor, noise and a lag, beside a moving ball: at the start, in motion,
/// stopped and reset.
fn records(interface: Interface, rehearses: bool) -> (Vec<CycleRecord>, u64) {
    let flaws = Flaws {
        tip_noise_m: 3e-4,
        ..RobotPreset::Laboratory.flaws()
    };
    let mut trial = Trial::with(interface, flaws, "[actuator]\ntime_constant_ms = 10.0\n");
    trial.measures_tip = true;
    trial.rehearses = rehearses;
    let shape = Shape::Sphere {
        centre_m: Vector3::new(0.12, 0.0, 0.84),
    };
    let velocity_m_s = Vector3::new(0.0, 0.05, 0.0);
    let known = KnownObstacle {
        id: 1,
        source: 0,
        obstacle: Obstacle::new(shape, 0.03, velocity_m_s).unwrap(),
        measured_ns: BEGIN_NS,
        expires_ns: Some(BEGIN_NS + 300 * PERIOD_NS),
    };
    trial.inputs.obstacles.upsert(known).unwrap();
    let mut records = vec![trial.turn()];
    trial.begin_tracking();
    records.extend((0..250).map(|_| trial.turn()));
    records.push(trial.ask(Request::Stop));
    records.extend((0..100).map(|_| trial.turn()));
    records.push(trial.ask(Request::Reset));
    records.push(trial.ask(TRACK));
    records.extend((0..100).map(|_| trial.turn()));
    (records, trial.rehearsal_looks)
}

#[test]
fn a_rehearsal_changes_no_bit_of_a_record() {
    for interface in [Interface::Position, Interface::Velocity] {
        let (without, _) = records(interface, false);
        let (with, looks) = records(interface, true);
        assert!(looks > 10, "a solve looks at the clock: {looks}");
        assert!(without.iter().any(|record| record.clearance_m < 0.1));
        for (without, with) in without.iter().zip(&with) {
            let mut with = *with;
            with.facts.rehearsed = false;
            assert_eq!(format!("{without:?}"), format!("{with:?}"));
        }
    }
}

/// The reporter writes all telemetry into one reused message.
#[test]
fn a_message_that_held_another_cycle_keeps_nothing_of_it() {
    let (records, _) = records(Interface::Position, false);
    let robot = Config::parse("", Path::new("telemetry")).unwrap().robot;
    let mut used = Box::<cdcr_shared_types::Telemetry>::default();
    for record in records.iter().rev().step_by(9) {
        let facts = CycleFacts {
            measurement: None,
            tip_measurement: None,
            slack: None,
            ..record.facts
        };
        let mut without = *record;
        without.write(facts, &ObstacleSet::default(), [&[]; 2]);
        for record in [record, &without] {
            convert::fill_telemetry(&mut used, record, &robot, PERIOD_NS);
            let fresh = convert::telemetry(record, &robot, PERIOD_NS);
            assert_eq!(format!("{used:?}"), format!("{fresh:?}"));
        }
    }
}

/// The cycle overwrites an earlier record.
#[test]
fn a_record_in_the_memory_of_another_holds_nothing_of_it() {
    let (records, _) = records(Interface::Position, false);
    let robot = Config::parse("", Path::new("telemetry")).unwrap().robot;
    let mut used = records[0];
    let lengths: std::collections::BTreeSet<_> = records.iter().map(|r| r.plan_length).collect();
    assert!(lengths.len() > 1, "with a plan and without: {lengths:?}");
    for record in records.iter().rev().step_by(9).chain([&records[0]]) {
        let plans = [&record.warm_plan, &record.plan].map(|plan| &plan[..record.plan_length]);
        used.write(record.facts, &record.obstacles, plans);
        let [used, fresh] = [&used, record].map(|r| convert::telemetry(r, &robot, PERIOD_NS));
        assert_eq!(format!("{used:?}"), format!("{fresh:?}"));
    }
}
