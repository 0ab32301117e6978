use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::bail;
use cdcr_client::{Connection, RequestError, TelemetryStream};
use cdcr_shared_types::codes::{Mode, Reason, RequestKind, guard};
use cdcr_shared_types::{Response, Telemetry};

use crate::args::Target;
use crate::bar::Bar;
use crate::done::Done;
use crate::dry_run::newest;
use crate::echo::line::clearance_text;
use crate::interrupt::{INTERRUPT_INTERVAL, Interrupt, QUIET};
use crate::standstill::Standstill;

/// Progress of the request according to a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Progress {
    Moves,
    /// The request is done, and the command is rest.
    Rests,
    /// Another mode or request has replaced it.
    Lost,
}

pub(crate) fn run(target: &Target, kind: RequestKind, limit: Duration) -> anyhow::Result<Done> {
    run_by(target, kind, limit, |connection| connection.request(kind))
}

/// As [`run`], where `ask` sends the request.
pub(crate) fn run_by(
    target: &Target,
    kind: RequestKind,
    limit: Duration,
    ask: impl FnOnce(&Connection) -> Result<Response, RequestError>,
) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    let mut telemetry = connection.telemetry()?;
    let interrupt = Interrupt::catch()?;
    let response = ask(&connection)?;
    let watched = watch(
        &connection,
        &mut telemetry,
        &response,
        kind,
        limit,
        &interrupt,
    );
    // Also if an error ended it: a closed terminal takes the output, too.
    if interrupt.is_raised() && !matches!(watched, Ok(Done::Good)) {
        return Ok(interrupted(&connection, kind));
    }
    watched
}

/// Waits until the request is done, or an interrupt.
fn watch(
    connection: &Connection,
    telemetry: &mut TelemetryStream,
    response: &Response,
    kind: RequestKind,
    limit: Duration,
    interrupt: &Interrupt,
) -> anyhow::Result<Done> {
    print_outcome(kind, response)?;
    let bar = Bar::new(kind.text());
    bar.show_share(0.0);
    let begun = Instant::now();
    let (mut heard, mut first) = (begun, None);
    let mut standstill = Standstill::default();
    let mut obstructed = String::new();
    while begun.elapsed() < limit {
        if interrupt.is_raised() {
            return Ok(Done::Interrupted);
        }
        let Some(record) = telemetry.next_within(INTERRUPT_INTERVAL)? else {
            if heard.elapsed() > QUIET {
                connection.status(QUIET)?;
                heard = Instant::now();
            }
            continue;
        };
        heard = Instant::now();
        if !is_later(&record, response) {
            continue;
        }
        obstructed = obstruction(&record);
        let left = left(kind, &record);
        bar.show_share(1.0 - left / *first.get_or_insert(left.max(f64::MIN_POSITIVE)));
        match progress(kind, &record) {
            Progress::Moves => standstill = Standstill::default(),
            Progress::Rests => {
                standstill.note(&record);
                if standstill.is_at_rest() {
                    drop(bar);
                    return done(kind, &record, response, &standstill);
                }
            }
            Progress::Lost => bail!(
                "{kind}: not done, the daemon is {} because {}; see cdcrctl status",
                Mode::text_of(record.mode),
                Reason::text_of(record.reason)
            ),
        }
    }
    if let Some(cycle) = standstill.commanded_cycle() {
        let moves = standstill.rate_rad_s().map_or_else(
            || "too few new measurements to evaluate".to_owned(),
            |rate| format!("a bend moves by {rate:.3} rad/s"),
        );
        bail!(
            "{kind}: commanded to rest since cycle {cycle}, but measured in motion after {limit:?}: {moves}"
        );
    }
    bail!(
        "{kind}: not done within {limit:?}{obstructed}; the robot continues (end it with cdcrctl hold or stop)"
    )
}

/// Holds a robot that is on its way home.
fn interrupted(connection: &Connection, kind: RequestKind) -> Done {
    let elsewhere = newest(connection).map(|record| record.mode);
    let elsewhere = elsewhere.ok().filter(|mode| *mode != Mode::Homing.code());
    if kind != RequestKind::Home || elsewhere.is_some() {
        tell!("interrupted: what was requested continues; end it with cdcrctl hold or stop");
        return Done::Interrupted;
    }
    match connection.request(RequestKind::Hold) {
        Ok(response) => tell!(
            "interrupted: {}",
            outcome_text(RequestKind::Hold, &response)
        ),
        Err(error) => tell!("interrupted, and the robot was not held: {error}"),
    }
    Done::Interrupted
}

fn done(
    kind: RequestKind,
    record: &Telemetry,
    response: &Response,
    standstill: &Standstill,
) -> anyhow::Result<Done> {
    let took_s = (record.cycle - response.cycle) as f64 * record.period_ns as f64 * 1e-9;
    writeln!(
        std::io::stdout(),
        "{kind}: done, commanded to rest since cycle {}, measured to rest {took_s:.2} s after the request",
        standstill.commanded_cycle().unwrap_or(record.cycle)
    )?;
    Ok(Done::Good)
}

/// Whether the cycle of a record already knew the request.
fn is_later(record: &Telemetry, response: &Response) -> bool {
    record.header.sender_id == response.header.sender_id && record.cycle >= response.cycle
}

fn progress(kind: RequestKind, record: &Telemetry) -> Progress {
    let rests = match (kind, Mode::try_from(record.mode)) {
        (RequestKind::Home, Ok(Mode::Homing)) => false,
        (RequestKind::Home, Ok(Mode::Holding)) if record.reason != Reason::HomeReached.code() => {
            return Progress::Lost;
        }
        (_, Ok(Mode::Holding)) => record.command.bend_rate_rad_s == [0.0; _],
        _ => return Progress::Lost,
    };
    if rests {
        Progress::Rests
    } else {
        Progress::Moves
    }
}

/// Names the obstacle, or the body itself, before which the safety step held back the command of a record.
fn obstruction(record: &Telemetry) -> String {
    let mut text = String::new();
    if record.guard_flags & guard::SELF_CONTACT != 0 {
        text = format!(
            ": two parts of the body would overlap by more than {:.1} mm (robot.self_overlap_max_m) and more than they do now; lead it out in small steps \
             (cdcrctl jog)",
            1e3 * record.robot.self_overlap_max_m
        );
    }
    if record.guard_flags & guard::CLEARANCE == 0 {
        return text;
    }
    text + &format!(
        ": an obstacle is in the way, {} mm from the body, and the clearance guard keeps {} mm (cdcrctl obstacle list)",
        clearance_text(record.clearance_m),
        clearance_text(record.settings.safe_distance_m)
    )
}

/// Remaining distance: the largest bend of homing \[rad\], otherwise the largest rate \[rad/s\].
fn left(kind: RequestKind, record: &Telemetry) -> f64 {
    let values = match kind {
        RequestKind::Home => record.present_rad,
        _ => record.command.bend_rate_rad_s,
    };
    values.iter().fold(0.0, |most, value| value.abs().max(most))
}

/// Prints the outcome of a request.
pub(crate) fn print_outcome(kind: RequestKind, response: &Response) -> std::io::Result<()> {
    writeln!(std::io::stdout(), "{}", outcome_text(kind, response))
}

/// Text for an accepted request.
pub(crate) fn outcome_text(kind: RequestKind, response: &Response) -> String {
    format!(
        "{kind}: accepted in cycle {}, the daemon is {}",
        response.cycle,
        Mode::text_of(response.mode)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(mode: Mode, reason: Reason, rate_rad_s: f64) -> Telemetry {
        let mut record = Telemetry {
            mode: mode.code(),
            reason: reason.code(),
            ..Telemetry::default()
        };
        record.command.bend_rate_rad_s[1] = rate_rad_s;
        record
    }

    #[test]
    fn it_is_done_when_the_robot_rests_where_it_was_asked_to() {
        use Progress::{Lost, Moves, Rests};
        use Reason::{HomeReached, MeasurementLost, Request};
        for (kind, mode, reason, rate_rad_s, is) in [
            (RequestKind::Home, Mode::Homing, Request, 0.5, Moves),
            (RequestKind::Home, Mode::Homing, Request, 0.0, Moves),
            (RequestKind::Home, Mode::Holding, HomeReached, -0.1, Moves),
            (RequestKind::Home, Mode::Holding, HomeReached, 0.0, Rests),
            (RequestKind::Home, Mode::Holding, Request, 0.0, Lost),
            (RequestKind::Home, Mode::Stopped, Request, 0.0, Lost),
            (RequestKind::Hold, Mode::Holding, Request, 0.5, Moves),
            (RequestKind::Hold, Mode::Holding, Request, 0.0, Rests),
            (RequestKind::Hold, Mode::Tracking, Request, 0.0, Lost),
            (RequestKind::Reset, Mode::Holding, Request, 0.0, Rests),
            (
                RequestKind::Reset,
                Mode::Faulted,
                MeasurementLost,
                0.0,
                Lost,
            ),
        ] {
            let record = record(mode, reason, rate_rad_s);
            assert_eq!(progress(kind, &record), is, "{kind} {mode} {reason}");
        }
    }

    #[test]
    fn an_obstacle_in_the_way_is_named() {
        let mut record = record(Mode::Homing, Reason::Request, 0.0);
        record.clearance_m = 0.0301;
        record.settings.safe_distance_m = 0.03;
        assert_eq!(obstruction(&record), "");
        record.guard_flags = guard::CLEARANCE | guard::RATE;
        let text = obstruction(&record);
        assert!(text.contains("in the way, 30.10 mm"), "{text}");
        assert!(text.contains("keeps 30.00 mm"), "{text}");
        record.guard_flags = guard::SELF_CONTACT;
        record.robot.self_overlap_max_m = 0.002;
        let text = obstruction(&record);
        assert!(
            text.contains("two parts of the body would overlap by more than 2.0 mm"),
            "{text}"
        );
    }

    #[test]
    fn records_of_before_and_of_another_daemon_say_nothing() {
        let mut response = Response {
            cycle: 7,
            ..Response::default()
        };
        response.header.sender_id = 3;
        let mut record = record(Mode::Holding, Reason::Request, 0.0);
        for (sender_id, cycle, later) in [(3, 6, false), (3, 7, true), (4, 8, false)] {
            record.header.sender_id = sender_id;
            record.cycle = cycle;
            assert_eq!(is_later(&record, &response), later);
        }
    }
}
