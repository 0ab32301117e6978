//! The example of the client library, `client/examples/driver.rs`, as the author of a driver runs it.

use std::process::Command;

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{MeasurementState, Mode, RequestKind};
use cdcr_tests::{
    Daemon, Place, Program, STALL_TOLERANT, TIMEOUT, paper_line, reset_here, text, track,
    wait_mode, wait_record,
};
use rustix::process::Signal;

use super::error_max_m;

/// Accuracy of an ideal robot on a slow line, on a machine without stalls \[m\].
const EXACT_M: f64 = 0.005;
/// Observed records at rest: half a second.
const RESTING: u32 = 100;

#[test]
fn the_example_of_a_velocity_driver_tracks_holds_and_ends() {
    run_driver("velocity", |place| place.command("examples/driver"));
}

#[test]
fn the_example_of_a_position_driver_tracks_holds_and_ends() {
    run_driver("position", |place| place.command("examples/driver"));
}

/// Runs an example driver for beginners.
pub(super) fn run_driver(interface: &str, program: impl FnOnce(&Place) -> Command) {
    let mut daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = \"driver\"\ninterface = \"{interface}\"\nmeasurement_timeout_ms = 2000.0\n\
         command_valid_ms = 1000.0\n"
    ));
    let mut command = program(daemon.place());
    let mut example = Program::start(command.arg(interface));
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    wait_mode(&mut telemetry, Mode::Holding);

    let records = track(&connection, &paper_line(1.0));
    assert!(records.len() > 20, "{}", records.len());
    let cycles = records.iter().map(|record| {
        let period_s = record.period_ns as f64 * 1e-9;
        (f64::from(record.skipped_periods) * period_s, period_s)
    });
    let last = records.last().unwrap();
    let error_m = last.position_error_m;
    assert!(error_m < error_max_m(EXACT_M, cycles), "{error_m} m");

    // At rest it stays at its position, to the bit: its encoders have no noise.
    let rest = |record: &Telemetry| {
        record.mode == Mode::Holding.code()
            && record.cycle > last.cycle + 100
            && record.measurement_state == MeasurementState::Used.code()
    };
    let stood = wait_record(&mut telemetry, rest).measurement;
    let mut seen = 0;
    wait_record(&mut telemetry, |record| {
        assert_eq!(record.mode, Mode::Holding.code());
        assert_eq!(record.measurement.cable_length_m, stood.cable_length_m);
        seen += 1;
        seen > RESTING
    });
    assert!(stood.cable_length_m[0] != 0.3, "it was moved");

    assert!(example.runs());
    example.signal(Signal::TERM);
    let output = example.output();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    drop((telemetry, connection));
    daemon.end_clean();
}

/// Its robot is then straight again, and the daemon commands the old position until a reset.
#[test]
fn a_position_driver_that_is_started_again_beside_a_stopped_robot_moves_nothing() {
    let daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\nkind = \"driver\"\ninterface = \"position\"\nmeasurement_timeout_ms = 1000.0\n\
         command_valid_ms = 1000.0\n"
    ));
    let start = || daemon.place().start("examples/driver position");
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    let example = start();
    wait_mode(&mut telemetry, Mode::Holding);
    let straight = wait_record(&mut telemetry, is_measured).measurement;
    track(&connection, &paper_line(1.0));
    connection
        .request_within(RequestKind::Stop, TIMEOUT)
        .unwrap();
    example.signal(Signal::KILL);
    wait_mode(&mut telemetry, Mode::Faulted);

    let _again = start();
    let mut stands = |mode: Mode| {
        let first = wait_record(&mut telemetry, |record| {
            record.mode == mode.code() && is_measured(record)
        });
        let last = wait_record(&mut telemetry, |record| {
            record.cycle > first.cycle + u64::from(RESTING) && is_measured(record)
        });
        let at_m = last.measurement.cable_length_m;
        assert_eq!(at_m, straight.cable_length_m, "{mode:?}");
    };
    stands(Mode::Faulted);
    reset_here(&connection);
    stands(Mode::Holding);
}

fn is_measured(record: &Telemetry) -> bool {
    record.measurement_state == MeasurementState::Used.code()
}

#[test]
fn the_example_is_short() {
    let source = include_str!("../../../../client/examples/driver.rs");
    assert!(source.lines().count() <= 60);
}

#[test]
fn an_example_of_the_other_interface_names_the_remedy() {
    let daemon = Daemon::start("[link]\nkind = \"driver\"\n");
    let mut command = daemon.place().command("examples/driver");
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output).contains("velocity or position"),
        "{}",
        text(&output)
    );
}
