//! Duration of a stop: from the request to zero rates within one period plus the ramp.
//!
//! A robot tracks at speed and is stopped at varying times within the period. The records are compared with
//! the guarantee. The first gather after the request takes it, or the check just before the release. That
//! release executes it, and from there on the rates shrink by deceleration · T in each cycle. Any longer
//! duration must be explained by the records: skipped releases, or a late gather or start.

mod access;
mod beside;
mod latch;
mod matrix;
mod place;
mod signal;

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use cdcr_client::{
    Connection, FeedEvent, FeedOptions, Line, TelemetryStream, events, monotonic_ns,
};
use cdcr_shared_types::codes::{EventKind, Interface, Mode, Outcome, Reason, RequestKind, timing};
use cdcr_shared_types::{Response, Telemetry};
use cdcr_testbed::quantiles::{histogram, quantile_us};
use cdcr_testbed::subject::asker::Asker;
use cdcr_testbed::subject::phases::Phases;
use cdcr_testbed::subject::stop::Stop;
use cdcr_tests::record::largest;
use cdcr_tests::robot::DrivenRobot;
use cdcr_tests::{Daemon, EndWhenDropped, Place, ROBOT, STALL_TOLERANT, ask_for, wait_record};

use crate::chaos::ramp;

/// Number of measured stops.
const STOPS: usize = 20;
/// Largest number of turns for them. A stalled machine spoils some: a late reference, a lost record.
const TURNS_MAX: usize = 10 * STOPS;
/// A robot is at speed when its fastest component has this rate \[rad/s\].
const SPEED_RAD_S: f64 = 0.8;
/// Deceleration of the rates: a stop from the largest rate, 2 rad/s, takes 20 cycles.
const DECELERATION_RAD_S2: f64 = 20.0;
/// Time from the gather to the release in the default configuration \[ns\]: 0.2 ms before the cycle thread
/// wakes up, 75 µs early.
const GATHER_LEAD_NS: u64 = 275_000;

#[test]
fn a_simulated_robot_stops_within_one_period_and_the_ramp() {
    let daemon = Daemon::start(&configuration("simulated", Interface::Velocity));
    measure_stops("simulated", &daemon);
}

#[test]
fn a_robot_behind_a_driver_stops_within_one_period_and_the_ramp() {
    stops_behind_a_driver(Interface::Velocity);
}

#[test]
fn a_robot_behind_a_driver_of_positions_stops_within_one_period_and_the_ramp() {
    stops_behind_a_driver(Interface::Position);
}

fn stops_behind_a_driver(interface: Interface) {
    let daemon = Daemon::start(&configuration("driver", interface));
    let ending = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| drive(daemon.place(), interface, &ending));
        let _ends = EndWhenDropped(&ending);
        measure_stops(&format!("driver, {interface}"), &daemon);
    });
}

fn configuration(link: &str, interface: Interface) -> String {
    format!(
        "{STALL_TOLERANT}[link]\nkind = \"{link}\"\ninterface = \"{interface}\"\nmeasurement_timeout_ms = 2000.0\n\
         [motion]\napproach = \"direct\"\ndeceleration_rad_s2 = {DECELERATION_RAD_S2:.1}\n"
    )
}

fn drive(place: &Place, interface: Interface, ending: &AtomicBool) {
    let connection = cdcr_tests::load::connect(place);
    let mut robot = DrivenRobot::new(&connection, interface, [0.0; 12]);
    while !ending.load(Ordering::Relaxed) {
        robot.turn();
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A stop that was requested and executed.
#[derive(Debug, Clone, Copy)]
struct Asked {
    /// Times before and after the sending \[ns, `CLOCK_MONOTONIC`\].
    begun_ns: u64,
    sent_ns: u64,
    response: Response,
}

/// Sender id of the requests.
const STOPPER: u64 = 0x5709;

/// Requests a stop with known times, which the client library does not report.
fn stop(asker: &mut Asker) -> Asked {
    let (_, begun_ns) = asker.ask(RequestKind::Stop).unwrap();
    let sent_ns = monotonic_ns();
    loop {
        if let Some(answer) = asker.poll().unwrap() {
            answer.accepted().unwrap();
            assert_eq!(answer.response.request_sequence, answer.sequence);
            return Asked {
                begun_ns,
                sent_ns,
                response: answer.response,
            };
        }
        std::thread::sleep(Duration::from_micros(200));
    }
}

/// Durations of a stop \[ns\].
#[derive(Debug, Clone, Copy)]
struct Taken {
    to_first_ns: u64,
    /// To the first command of zero rates, without the cycles of the ramp.
    to_zero_less_ramp_ns: u64,
    ramp_cycles: usize,
    late_ns: u64,
}

fn measure_stops(link: &str, daemon: &Daemon) {
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    wait_record(&mut telemetry, |record| record.mode == Mode::Holding.code());
    let mut stopper = Asker::open(daemon.place().location(), ROBOT, STOPPER).unwrap();
    let (mut taken, mut phases) = (Vec::new(), Phases::default());
    let mut turns = 0_usize;
    while taken.len() < STOPS {
        turns += 1;
        assert!(
            turns < TURNS_MAX,
            "only {} stops in {turns} turns",
            taken.len()
        );
        ask_for(&connection, RequestKind::Reset);
        let mut records = Vec::new();
        if let Some(asked) =
            stop_at_speed(&connection, &mut stopper, turns, &mut phases, |record| {
                records.push(*record);
            })
        {
            follow_to_rest(&mut telemetry, &mut records, asked.response.cycle);
            taken.extend(evaluate(&records, &asked));
        }
        while telemetry.try_next().unwrap().is_some() {}
    }
    report(link, &taken);
}

/// Sends the robot to a far position and stops it on the way. `None` if it never reached the speed.
fn stop_at_speed(
    connection: &Connection,
    stopper: &mut Asker,
    turn: usize,
    phases: &mut Phases,
    mut seen: impl FnMut(&Telemetry),
) -> Option<Asked> {
    let side = if turn.is_multiple_of(2) { 0.4 } else { -0.4 };
    let place = Line {
        start_m: [side, 0.1, 0.5],
        velocity_m_s: [0.0; 3],
        duration_s: 3.0,
        tip_axis: None,
    };
    let options = FeedOptions {
        lead: Duration::from_millis(50),
        track: true,
        ..FeedOptions::default()
    };
    let mut asked = None;
    // Ends with an error, because the daemon leaves tracking.
    let _ = connection.feed(&place, options).unwrap().run(|event| {
        let FeedEvent::Record(record) = event else {
            return ControlFlow::Continue(());
        };
        seen(record);
        let at_speed = largest(&record.command.bend_rate_rad_s) > SPEED_RAD_S;
        if asked.is_none() && record.mode == Mode::Tracking.code() && at_speed {
            std::thread::sleep(Duration::from_nanos(phases.next_ns(record.period_ns)));
            asked = Some(stop(stopper));
        }
        ControlFlow::Continue(())
    });
    asked
}

/// Adds the records between the last one and rest. Both streams have all records of the turn.
fn follow_to_rest(telemetry: &mut TelemetryStream, records: &mut Vec<Telemetry>, cycle: u64) {
    let last = records.last().map_or(0, |record| record.header.sequence);
    wait_record(telemetry, |record| {
        if record.header.sequence > last {
            records.push(*record);
        }
        record.cycle > cycle && largest(&record.command.bend_rate_rad_s) == 0.0
    });
}

/// Checks a stop against the guarantee. `None` if records are missing, a stall ended the ramp, or the robot
/// was hardly moving or no longer tracking when the request came.
fn evaluate(records: &[Telemetry], asked: &Asked) -> Option<Taken> {
    let stop = Stop::find(records)?;
    let at = stop.first;
    let (before, first) = (&records[at - 1], &records[at]);
    // A stall of the machine in which the last command ran out ended the ramp.
    let is_cut = |pair: &[Telemetry]| {
        let [before, now] = [&pair[0], &pair[1]];
        let stalls = now.elapsed_ns > now.period_ns
            || now.timing_flags & timing::STALE_INPUTS != 0
            || now.solve_start_ns > now.release_ns + now.period_ns;
        let moved = largest(&before.command.bend_rate_rad_s) > 0.0;
        stalls && moved && largest(&now.previous_rate_rad_s) == 0.0
    };
    if records[at - 1..].windows(2).any(is_cut) {
        return None;
    }
    for pair in records[at - 1..].windows(2) {
        let commanded = pair[0].command.bend_rate_rad_s;
        assert_eq!(
            pair[1].previous_rate_rad_s, commanded,
            "other rates were held"
        );
    }
    assert_eq!(first.cycle, asked.response.cycle, "another cycle answered");
    assert_eq!(first.reason, Reason::Request.code());
    assert_taken_by_its_gather(before, first, asked);
    assert_ramp(records, &stop);
    let late_ns = late_ns(before, first);
    let allowed_ns = first.period_ns + GATHER_LEAD_NS + late_ns;
    let took_ns = first.command.header.sent_ns.saturating_sub(asked.sent_ns);
    assert!(
        took_ns <= allowed_ns,
        "{took_ns} ns from the request to the stop, {allowed_ns} ns are accounted for"
    );
    let rest_ns = records[stop.rest].command.header.sent_ns;
    Some(Taken {
        to_first_ns: first.command.header.sent_ns - asked.begun_ns,
        to_zero_less_ramp_ns: stop.less_ramp_ns(asked.begun_ns, rest_ns),
        ramp_cycles: stop.rest - at + 1,
        late_ns,
    })
}

/// Checks that the gather of the request is the first one after its sending, and that its cycle is the first
/// one after that gather.
fn assert_taken_by_its_gather(before: &Telemetry, first: &Telemetry, asked: &Asked) {
    let ours = |event: &&cdcr_shared_types::InputEvent| {
        event.kind == EventKind::Request.code()
            && event.sender_id == STOPPER
            && event.sequence == asked.response.request_sequence
    };
    if let Some(event) = events(first).iter().find(ours) {
        assert_eq!(event.outcome, Outcome::Accepted.code());
        assert_eq!(event.gathers_ago, 0);
    }
    // A later gather would have taken it, and the cycle before would have executed it.
    assert!(
        before.gather_ns <= asked.sent_ns,
        "the gather {} ns after the request did not take it",
        before.gather_ns - asked.sent_ns
    );
    assert!(first.handed_over_ns > asked.begun_ns);
}

/// Lateness in the records: skipped periods, the time from release to publication, and reused inputs of the
/// previous cycle because no gather came between.
fn late_ns(before: &Telemetry, first: &Telemetry) -> u64 {
    let skipped_ns = first.release_ns - before.release_ns - first.period_ns;
    let after_release_ns = first.command.header.sent_ns - first.release_ns;
    let old_inputs_ns = (before.release_ns - GATHER_LEAD_NS).saturating_sub(before.gather_ns);
    skipped_ns + after_release_ns + old_inputs_ns
}

/// Checks that the rates follow the ramp from the first stopped record to rest, and within its cycles.
fn assert_ramp(records: &[Telemetry], stop: &Stop) {
    for record in &records[stop.first..=stop.rest] {
        assert_eq!(record.deceleration_rad_s2, DECELERATION_RAD_S2);
        ramp::check(record, record.period_ns as f64 * 1e-9).unwrap();
        assert!(largest(&record.command.bend_rate_rad_s).is_finite());
    }
    let (took, cycles) = (
        stop.rest - stop.first,
        stop.ramp_ns / records[stop.first].period_ns,
    );
    assert!(
        took as u64 <= cycles,
        "at rest after {took} cycles, not {cycles}"
    );
}

fn report(link: &str, taken: &[Taken]) {
    println!("{link}: {} stops at speed, in ms", taken.len());
    println!("{:<44} {:>8} {:>8} {:>8}", "", "p50", "p99", "max");
    let row = |name: &str, value: fn(&Taken) -> u64| {
        let mut times_ns = histogram();
        let values = taken.iter().map(value);
        values.for_each(|time_ns| times_ns.saturating_record(time_ns));
        let at = |part: f64| 1e-3 * quantile_us(&times_ns, part);
        println!(
            "{name:<44} {:>8.3} {:>8.3} {:>8.3}",
            at(0.5),
            at(0.99),
            at(1.0)
        );
    };
    row("request → first slower command", |taken| {
        taken.to_first_ns
    });
    row("request → zero rates, less the ramp", |taken| {
        taken.to_zero_less_ramp_ns
    });
    row("of it late, as the records say", |taken| taken.late_ns);
    let longest = taken.iter().map(|taken| taken.ramp_cycles).max();
    println!("longest ramp: {} cycles", longest.unwrap_or(0));
}
