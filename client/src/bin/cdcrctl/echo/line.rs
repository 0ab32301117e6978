//! Formats each message as one line of text.

use cdcr_client::events;
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Interpolation, LateCause, MeasurementState, Mode, ObstacleAction,
    ObstacleShape, Outcome, Reason, ReferenceState, SolverStatus, guard, timing,
};
use cdcr_shared_types::limits::{CHUNK_POINTS_MAX, OBSTACLES_MAX, SECTIONS_MAX};
use cdcr_shared_types::{
    Command, Incident, LatencySummary, ObstacleUpdate, ReferenceChunk, Status, Telemetry,
};

use crate::stop_cause::margin_share;

pub(super) const TELEMETRY_HEADING: &str = "     cycle  mode        reference        tip x mm      \
    y mm      z mm      error mm   wake µs  waited µs  solve µs  response µs  measurement  obstacles  clearance mm  \
    late by, limited by, refused";
pub(super) const COMMAND_HEADING: &str =
    "     cycle  mode        bend rates rad/s (u, v of each section) | cable lengths mm";
pub(super) const STATUS_HEADING: &str = "    cycles  mode        misses  skipped  response p99 µs  points ahead  obstacles  clearance mm  reason";
pub(crate) const INCIDENT_HEADING: &str = "  seconds ago      cycle  wake µs  compute µs  response µs  waited µs  faults  switches  gap µs  \
    steal ms  what (cause)";
pub(super) const REFERENCE_HEADING: &str =
    "sender            chunk  mode     between  points   first s ahead   last s ahead";
pub(super) const OBSTACLES_HEADING: &str =
    "sender           update  action  obstacles (id shape at m, radius m)";

pub(super) fn telemetry(record: &Telemetry) -> String {
    let [x, y, z] = record.tip_position_m.map(|x| 1e3 * x);
    format!(
        "{:>10}  {:<10}  {:<16}{x:>9.4}{y:>10.4}{z:>10.4}{:>14}{:>10.1}{:>11}{:>10}{:>13.1}  {:<11}{:>11}{:>14}  {}",
        record.cycle,
        Mode::text_of(record.mode),
        ReferenceState::text_of(record.reference.state),
        error_text(record.position_error_m),
        us(record.start_ns, record.due_ns),
        known_text(record, us(record.scheduling.run_delay_ns, 0)),
        solve_text(record),
        us(record.handed_over_ns, record.due_ns),
        MeasurementState::text_of(record.measurement_state),
        record.obstacle_count,
        clearance_text(record.clearance_m),
        remarks(record),
    )
}

fn us(to_ns: u64, from_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-3
}

/// A dash for a missing value.
fn or_dash(is_reported: bool, text: String) -> String {
    if is_reported { text } else { "-".to_owned() }
}

/// One decimal; a dash when the system does not provide the value.
fn known_text(record: &Telemetry, value: f64) -> String {
    or_dash(record.scheduling.known != 0, format!("{value:.1}"))
}

/// In µs; a dash in a cycle without a solve.
fn solve_text(record: &Telemetry) -> String {
    let solve_us = us(record.solve_end_ns, record.solve_start_ns);
    let has_solved = record.report.status != SolverStatus::Idle.code();
    or_dash(has_solved, format!("{solve_us:.1}"))
}

/// In mm; a dash without a reference.
fn error_text(error_m: f64) -> String {
    or_dash(error_m.is_finite(), format!("{:.3e}", 1e3 * error_m))
}

/// In mm; a dash without an obstacle.
pub(crate) fn clearance_text(clearance_m: f64) -> String {
    or_dash(clearance_m.is_finite(), format!("{:.2}", 1e3 * clearance_m))
}

/// Cause of lateness, limits that changed the command, and refusals.
fn remarks(record: &Telemetry) -> String {
    let late = match LateCause::try_from(record.scheduling.late_cause) {
        Ok(LateCause::None) => String::new(),
        _ => format!("late: {}", LateCause::text_of(record.scheduling.late_cause)),
    };
    let limited: Vec<_> = guard::set(record.guard_flags)
        .map(|(name, _)| name)
        .collect();
    let refused = refusals(record);
    let parts = [late, limited.join(", "), refused];
    let parts: Vec<_> = parts.into_iter().filter(|part| !part.is_empty()).collect();
    parts.join("; ")
}

fn refusals(record: &Telemetry) -> String {
    let refused = events(record)
        .iter()
        .filter(|event| event.outcome != Outcome::Accepted.code())
        .map(|event| {
            let (kind, why) = (
                EventKind::text_of(event.kind),
                Outcome::text_of(event.outcome),
            );
            format!("refused: {kind}: {why}")
        });
    refused.collect::<Vec<_>>().join("; ")
}

pub(super) fn incident(incident: &Incident) -> String {
    incident_at(incident, incident.header.sent_ns)
}

/// The line at the time `now_ns`.
pub(crate) fn incident_at(incident: &Incident, now_ns: u64) -> String {
    let record = &incident.telemetry;
    let scheduling = &record.scheduling;
    let whole = |count: u32| or_dash(scheduling.known != 0, count.to_string());
    format!(
        "{:>13.1} {:>10} {:>8.1} {:>11.1} {:>12.1} {:>10} {:>7} {:>9} {:>7.1} {:>9}  {} ({}{})",
        us(now_ns, record.due_ns) * 1e-6,
        record.cycle,
        us(record.start_ns, record.due_ns),
        us(record.handed_over_ns, record.start_ns),
        us(record.handed_over_ns, record.due_ns),
        known_text(record, us(scheduling.run_delay_ns, 0)),
        whole(scheduling.page_faults),
        whole(scheduling.switches),
        us(scheduling.longest_gap_ns, 0),
        steal_text(incident),
        troubles(record),
        LateCause::text_of(scheduling.late_cause),
        stopped(record),
    )
}

/// Names a process that was stopped and continued (docs/realtime.md): the thread lost its core, and no other task made it wait.
fn stopped(record: &Telemetry) -> &'static str {
    let scheduling = &record.scheduling;
    let late_ns = record.handed_over_ns.saturating_sub(record.due_ns);
    let is_stopped = scheduling.known != 0
        && scheduling.late_cause == LateCause::Platform.code()
        && scheduling.switches > 0
        && scheduling.run_delay_ns < late_ns / 10;
    if is_stopped {
        "; or cdcrd was stopped and continued: SIGSTOP, debugger"
    } else {
        ""
    }
}

/// In ms; a dash when the system does not provide it.
fn steal_text(incident: &Incident) -> String {
    let ms = incident.steal_ns as f64 * 1e-6;
    or_dash(incident.steal_window_ns > 0, format!("{ms:.0}"))
}

/// The reasons of an incident.
fn troubles(record: &Telemetry) -> String {
    let flag = |bit: u32, text: &str| (record.timing_flags & bit != 0).then(|| text.to_owned());
    let skipped =
        (record.skipped_periods > 0).then(|| format!("skipped {}", record.skipped_periods));
    let fault = (record.mode == Mode::Faulted.code()).then(|| {
        let share = margin_share(
            &[record.reason],
            record.clearance_m,
            record.tip_margin_m,
            record.clearance_fault_m,
        );
        let share = share.map_or_else(String::new, |share| format!(": {share}"));
        format!("faulted: {}{share}", Reason::text_of(record.reason))
    });
    let parts = [
        flag(timing::LATE_START, "late start"),
        flag(timing::DEADLINE_MISS, "deadline miss"),
        skipped,
        fault,
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

pub(super) fn command(command: &Command) -> String {
    let sections = (command.sections as usize).min(SECTIONS_MAX);
    let rates = join(&command.bend_rate_rad_s[..2 * sections], 1.0, 4);
    let lengths = join(&command.cable_length_m[..3 * sections], 1e3, 2);
    format!(
        "{:>10}  {:<10}  {rates} | {lengths}",
        command.cycle,
        Mode::text_of(command.mode)
    )
}

fn join(values: &[f64], scale: f64, decimals: usize) -> String {
    let texts = values.iter().map(|x| format!("{:.decimals$}", scale * x));
    texts.collect::<Vec<_>>().join(" ")
}

pub(super) fn status(status: &Status) -> String {
    format!(
        "{:>10}  {:<10}{:>8}{:>9}{:>17}{:>14}{:>11}{:>14}  {}",
        status.cycles,
        Mode::text_of(status.mode),
        status.deadline_misses,
        status.skipped_periods,
        latency_text(&status.last_minute.response, |response| response.p99_ns),
        status.reference_points,
        status.obstacle_count,
        clearance_text(status.clearance_m),
        Reason::text_of(status.reason)
    )
}

/// A latency in µs; a dash when none was measured.
pub(crate) fn latency_text(
    latency: &LatencySummary,
    value_ns: impl Fn(&LatencySummary) -> u64,
) -> String {
    let value_us = us(value_ns(latency), 0);
    or_dash(latency.count > 0, format!("{value_us:.1}"))
}

pub(super) fn reference(chunk: &ReferenceChunk) -> String {
    let points = &chunk.points[..(chunk.count as usize).min(CHUNK_POINTS_MAX)];
    let sent_ns = chunk.header.sent_ns as f64;
    let ahead_s = |time_ns: Option<u64>| time_ns.map_or(0.0, |t| (t as f64 - sent_ns) * 1e-9);
    format!(
        "{:016x}{:>7}  {:<8} {:<8}{:>7}{:>16.3}{:>15.3}",
        chunk.header.sender_id,
        chunk.header.sequence,
        ChunkMode::text_of(chunk.mode),
        Interpolation::text_of(chunk.interpolation),
        chunk.count,
        ahead_s(points.first().map(|p| p.time_ns)),
        ahead_s(points.last().map(|p| p.time_ns)),
    )
}

pub(super) fn obstacles(update: &ObstacleUpdate) -> String {
    let used = &update.obstacles[..(update.count as usize).min(OBSTACLES_MAX)];
    let texts = used.iter().map(|o| {
        let shape = ObstacleShape::text_of(o.shape);
        let [x, y, z] = o.start_m;
        format!("{} {shape} at {x},{y},{z} radius {}", o.id, o.radius_m)
    });
    format!(
        "{:016x}{:>8}  {:<7} {}",
        update.header.sender_id,
        update.header.sequence,
        ObstacleAction::text_of(update.action),
        texts.collect::<Vec<_>>().join("; ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clearance_and_the_guard_show() {
        let mut record = Telemetry {
            obstacle_count: 3,
            clearance_m: 0.012_34,
            guard_flags: guard::RATE | guard::CLEARANCE,
            ..Telemetry::default()
        };
        assert!(telemetry(&record).ends_with("3         12.34  rate, clearance"));
        record.clearance_m = f64::INFINITY;
        record.guard_flags = 0;
        assert!(telemetry(&record).ends_with("3             -  "));
    }

    #[test]
    fn a_refusal_shows_what_was_refused() {
        let mut record = Telemetry {
            event_count: 1,
            ..Telemetry::default()
        };
        record.events[0].kind = EventKind::Measurement.code();
        record.events[0].outcome = Outcome::OutOfRange.code();
        let line = telemetry(&record);
        assert!(
            line.ends_with("refused: measurement: a value is out of range"),
            "{line}"
        );
    }

    #[test]
    fn a_stall_shows_and_a_cycle_without_a_solve_has_a_dash() {
        let mut record = Telemetry {
            due_ns: 10_000_000,
            release_ns: 25_000_000,
            start_ns: 25_040_000,
            solve_start_ns: 25_050_000,
            solve_end_ns: 25_052_000,
            handed_over_ns: 25_060_000,
            ..Telemetry::default()
        };
        record.report.status = SolverStatus::Converged.code();
        let line = telemetry(&record);
        for part in ["   15040.0          -", "       2.0", "      15060.0"] {
            assert!(line.contains(part), "{part} in {line}");
        }
        record.report.status = SolverStatus::Idle.code();
        record.scheduling.known = 1;
        record.scheduling.run_delay_ns = 12_340;
        record.scheduling.late_cause = LateCause::Load.code();
        record.measurement_state = MeasurementState::Implausible.code();
        let line = telemetry(&record);
        for part in [
            "15040.0       12.3         -",
            "  implausible",
            "late: another task had the core",
        ] {
            assert!(line.contains(part), "{part} in {line}");
        }
        assert_eq!(
            width_of(TELEMETRY_HEADING, "clearance mm"),
            width_of(&line, " 0.00  ")
        );
    }

    /// Characters up to the end of `part`, without trailing blanks.
    fn width_of(text: &str, part: &str) -> usize {
        let at = text.rfind(part).expect("it is there");
        text[..at + part.trim_end().len()].chars().count()
    }

    #[test]
    fn an_incident_has_time_kind_and_cause() {
        let mut bad = Incident {
            steal_ns: 20_000_000,
            steal_window_ns: 100_000_000,
            ..Incident::default()
        };
        bad.telemetry = Telemetry {
            cycle: 4711,
            due_ns: 10_000_000,
            start_ns: 11_500_000,
            handed_over_ns: 16_000_000,
            skipped_periods: 3,
            timing_flags: timing::LATE_START | timing::DEADLINE_MISS,
            mode: Mode::Faulted.code(),
            reason: Reason::MeasurementFrozen.code(),
            ..Telemetry::default()
        };
        bad.telemetry.scheduling.late_cause = LateCause::Platform.code();
        let line = incident_at(&bad, 2_510_000_000);
        for part in [
            "          2.5       4711   1500.0      4500.0       6000.0          -       -         -     0.0        20  ",
            "late start, deadline miss, skipped 3, faulted: the measurement is frozen (platform)",
        ] {
            assert!(line.contains(part), "{part} in {line}");
        }
        assert_eq!(
            width_of(INCIDENT_HEADING, "steal ms"),
            width_of(&line, "  20  ")
        );
        bad.telemetry.scheduling.known = 1;
        // A machine that was suspended.
        let late = Telemetry {
            start_ns: 18_892_013_601_900,
            ..bad.telemetry
        };
        let line = incident(&Incident {
            telemetry: late,
            ..bad
        });
        assert!(line.contains(" 4711 18892003601.9 "), "{line}");
        bad.telemetry.scheduling.page_faults = 9;
        bad.steal_window_ns = 0;
        let line = incident(&bad);
        assert!(
            line.contains("0.0       9         0     0.0         -  "),
            "{line}"
        );
        assert!(!line.contains("SIGSTOP"), "{line}");
        bad.telemetry.scheduling.switches = 1;
        let line = incident(&bad);
        assert!(
            line.contains("(platform; or cdcrd was stopped and continued: SIGSTOP"),
            "{line}"
        );
        bad.telemetry.scheduling.run_delay_ns = 1_500_000;
        assert!(!incident(&bad).contains("SIGSTOP"));
    }

    #[test]
    fn a_record_from_anywhere_never_panics() {
        let mut record = Telemetry {
            event_count: 99,
            mode: 77,
            release_ns: 10,
            start_ns: 5,
            ..Telemetry::default()
        };
        record.events[0].outcome = Outcome::OutOfReach.code();
        let text = telemetry(&record);
        assert!(text.contains("outside the reachable ball"), "{text}");
        let wild = Command {
            sections: 99,
            ..Command::default()
        };
        assert!(!command(&wild).is_empty());
        let chunk = ReferenceChunk {
            count: 9999,
            ..ReferenceChunk::default()
        };
        assert!(!reference(&chunk).is_empty());
    }
}
