use cdcr_shared_types::codes::Interface;
use cdcr_shared_types::{Command, RobotDescription};

use super::super::{CommandFollower, CommandRefusal};
use super::*;

const LATE_NS: u64 = 1_000_000 * BENDS_LATE_MS as u64;

fn measured_as(kind: MeasurementKind) -> Measurement {
    Measurement {
        kind: kind.code(),
        ..Measurement::default()
    }
}

#[test]
fn a_first_position_waits_for_bends_that_follow_a_tip() {
    let tip = measured_as(MeasurementKind::TipPose);
    assert!(!Measured::default().may_begin(u64::MAX));
    let measured = Measured::default().with(&tip, 1_000);
    assert!(!measured.may_begin(1_000));
    let measured = measured.with(&tip, 1_000 + LATE_NS / 2);
    assert!(!measured.may_begin(999 + LATE_NS));
    for kind in [
        MeasurementKind::Configuration,
        MeasurementKind::CableLengths,
    ] {
        assert!(measured.with(&measured_as(kind), 2_000).may_begin(2_000));
    }
    // A robot of which only the tip is measured.
    assert!(measured.may_begin(1_000 + LATE_NS));
}

// A driver restarted after the robot was moved by hand, which measures its tip first.
#[test]
fn a_tip_does_not_replace_the_bends_that_a_first_position_must_match() {
    let robot = RobotDescription {
        sections: 1,
        ..RobotDescription::default()
    };
    let mut bent = measured_as(MeasurementKind::Configuration);
    bent.bend_rad[0] = 0.4;
    let tip = measured_as(MeasurementKind::TipPose);
    let measured = Measured::default()
        .with(&tip, 1)
        .with(&bent, 2)
        .with(&tip, 3);
    let mut follower = CommandFollower::new(&robot, Interface::Position);
    follower.tell_measured(&measured.bends.unwrap());
    follower.tell_measured(&tip);
    let command = Command {
        sections: 1,
        interface: Interface::Position.code(),
        valid_until_ns: 10,
        ..Command::default()
    };
    let refused = follower.take(&command, 4);
    assert!(
        matches!(refused, Err(CommandRefusal::Elsewhere { at: 0, .. })),
        "{refused:?}"
    );
}
