//! One line of text for each message.

use cdcr_client::events;
use cdcr_shared_types::codes::{
    ChunkMode, Interpolation, Mode, ObstacleAction, ObstacleShape, Outcome, Reason, ReferenceState,
    SolverStatus,
};
use cdcr_shared_types::limits::{CHUNK_POINTS_MAX, OBSTACLES_MAX, SECTIONS_MAX};
use cdcr_shared_types::{
    Command, LatencySummary, ObstacleUpdate, ReferenceChunk, Status, Telemetry,
};

use super::json::guards;

pub(super) const TELEMETRY_HEADING: &str = "     cycle  mode        reference        tip x mm   \
    y mm      z mm      error mm   wake µs  solve µs  response µs  obstacles  clearance mm  limited by, refused";
pub(super) const COMMAND_HEADING: &str =
    "     cycle  mode        bend rates rad/s (u, v of each section) | cable lengths mm";
pub(super) const STATUS_HEADING: &str = "    cycles  mode        misses  skipped  response p99 µs  points ahead  obstacles  clearance mm  reason";
pub(super) const REFERENCE_HEADING: &str =
    "sender            chunk  mode     between  points   first s ahead   last s ahead";
pub(super) const OBSTACLES_HEADING: &str =
    "sender           update  action  obstacles (id shape at m, radius m)";

pub(super) fn telemetry(record: &Telemetry) -> String {
    let [x, y, z] = record.tip_position_m.map(|x| 1e3 * x);
    format!(
        "{:>10}  {:<10}  {:<16}{x:>9.4}{y:>10.4}{z:>10.4}{:>14}{:>10.1}{:>10}{:>13.1}{:>11}{:>14}  {}",
        record.cycle,
        Mode::text_of(record.mode),
        ReferenceState::text_of(record.reference.state),
        error_text(record.position_error_m),
        us(record.start_ns, record.due_ns),
        solve_text(record),
        us(record.handed_over_ns, record.due_ns),
        record.obstacle_count,
        clearance_text(record.clearance_m),
        remarks(record),
    )
}

fn us(to_ns: u64, from_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-3
}

/// In µs; a dash in a cycle without a solve.
fn solve_text(record: &Telemetry) -> String {
    if record.report.status == SolverStatus::Idle.code() {
        return "-".to_owned();
    }
    format!("{:.1}", us(record.solve_end_ns, record.solve_start_ns))
}

/// In mm; a dash when there is no reference to be off.
fn error_text(error_m: f64) -> String {
    if error_m.is_finite() {
        format!("{:.3e}", 1e3 * error_m)
    } else {
        "-".to_owned()
    }
}

/// In mm; a dash when there is no obstacle.
pub(crate) fn clearance_text(clearance_m: f64) -> String {
    if clearance_m.is_finite() {
        format!("{:.2}", 1e3 * clearance_m)
    } else {
        "-".to_owned()
    }
}

/// Which limits changed the command, and what was refused.
fn remarks(record: &Telemetry) -> String {
    let limited = guards(record.guard_flags).join(", ");
    let refused = refusals(record);
    let parts = [limited, refused];
    let parts: Vec<_> = parts.into_iter().filter(|part| !part.is_empty()).collect();
    parts.join("; ")
}

fn refusals(record: &Telemetry) -> String {
    let refused = events(record)
        .iter()
        .filter(|event| event.outcome != Outcome::Accepted.code())
        .map(|event| format!("refused: {}", Outcome::text_of(event.outcome)));
    refused.collect::<Vec<_>>().join("; ")
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
        latency_text(&status.response, |response| response.p99_ns),
        status.reference_points,
        status.obstacle_count,
        clearance_text(status.clearance_m),
        Reason::text_of(status.reason)
    )
}

/// A latency in µs; a dash when none was counted.
pub(crate) fn latency_text(
    latency: &LatencySummary,
    value_ns: impl Fn(&LatencySummary) -> u64,
) -> String {
    if latency.count == 0 {
        return "-".to_owned();
    }
    format!("{:.1}", us(value_ns(latency), 0))
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
    use cdcr_shared_types::codes::guard;

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
        for part in ["   15040.0", "       2.0", "      15060.0"] {
            assert!(line.contains(part), "{part} in {line}");
        }
        record.report.status = SolverStatus::Idle.code();
        let line = telemetry(&record);
        assert!(line.contains("15040.0         -"), "{line}");
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
