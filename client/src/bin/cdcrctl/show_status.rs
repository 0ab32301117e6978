mod following;

pub(crate) use following::following_error_rad;

use std::fmt::Write as _;
use std::io::{IsTerminal as _, Write as _};
use std::thread;
use std::time::Duration;

use anyhow::bail;
use cdcr_client::{
    Connection, PoseDifference, counted, monotonic_ns, realtime_missing, reason_remedy, text,
};
use cdcr_controller::safety::FarthestBend;
use cdcr_shared_types::codes::{LateCause, Mode, Outcome, Reason, RobotLink, SolverKind, TipCause};
use cdcr_shared_types::message::{Field, Struct};
use cdcr_shared_types::{LatencySummary, Statistics, Status};
use serde_json::{Value, json};

use crate::args::{Format, StatusOptions, Target};
use crate::done::Done;
use crate::echo::json;
use crate::echo::line::{clearance_text, latency_text};
use crate::interrupt::Interrupt;
use crate::stop_cause::{broken_bend, margin_share, status_remedy};
use crate::unmeasured_tip::{Unheard, refused_text};

/// Interval of `--watch`, and the number of interrupt checks in it.
const EVERY: Duration = Duration::from_secs(1);
const INTERRUPT_CHECKS: u32 = 10;
/// Terminal sequence: cursor home, and clear to the end.
const CLEAR: &str = "\x1b[H\x1b[2J";

pub(crate) fn run(target: &Target, options: &StatusOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    if options.reset_statistics {
        let response = connection.reset_statistics()?;
        let cycle = response.cycle;
        writeln!(std::io::stdout(), "statistics: reset after cycle {cycle}")?;
        return Ok(Done::Good);
    }
    if options.watch {
        return watch(&connection, options.format);
    }
    let status = connection.status(EVERY)?;
    let shown = match options.format {
        Format::Text => table(&status, broken_bend(&connection, &status), monotonic_ns())?,
        Format::Json => serde_json::to_string_pretty(&object(&status))? + "\n",
    };
    std::io::stdout().write_all(shown.as_bytes())?;
    if let Some(remedy) = status_remedy(&status).filter(|_| options.check) {
        bail!("the daemon is {}. {remedy}", Mode::text_of(status.mode));
    }
    Ok(Done::Good)
}

/// Repeats until interrupted; waits for a daemon that is restarted.
fn watch(connection: &Connection, format: Format) -> anyhow::Result<Done> {
    let interrupt = Interrupt::catch()?;
    let mut out = std::io::stdout().lock();
    let clear = match format {
        Format::Text if out.is_terminal() => CLEAR,
        _ => "",
    };
    while !interrupt.is_raised() {
        let shown = match (connection.status(EVERY), format) {
            (Ok(status), Format::Text) => {
                table(&status, broken_bend(connection, &status), monotonic_ns())?
            }
            (Ok(status), Format::Json) => object(&status).to_string() + "\n",
            (Err(silent), Format::Text) => format!("{silent}\n"),
            (Err(_), Format::Json) => String::new(),
        };
        write!(out, "{clear}{shown}")?;
        out.flush()?;
        for _ in 0..INTERRUPT_CHECKS {
            if !interrupt.is_raised() {
                thread::sleep(EVERY / INTERRUPT_CHECKS);
            }
        }
    }
    Ok(Done::Good)
}

/// The status, and what to do where only a reset lets the robot move.
fn object(status: &Status) -> Value {
    let mut object = json::message(status);
    object["remedy"] = json!(status_remedy(status));
    object
}

fn table(
    status: &Status,
    broken: Option<FarthestBend>,
    now_ns: u64,
) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    identity(&mut out, status, broken)?;
    statistics(&mut out, status, now_ns)?;
    inputs(&mut out, status, now_ns)?;
    robot(&mut out, status)?;
    Ok(out)
}

fn identity(out: &mut String, status: &Status, broken: Option<FarthestBend>) -> std::fmt::Result {
    writeln!(
        out,
        "robot       {} ({}, {})",
        text(&status.robot_name),
        counted(status.robot.sections, "section"),
        RobotLink::text_of(status.link)
    )?;
    writeln!(
        out,
        "daemon      cdcrd {}, process {}, period {} ms, pinned to {}",
        text(&status.build),
        status.process_id,
        status.period_ns as f64 / 1e6,
        core_text(status.core)
    )?;
    let reason = if status.mode == Mode::Starting.code() {
        String::new()
    } else {
        let over = if waits_for_no_source(status) {
            "; not any more: feed the reference, or go home, again"
        } else {
            ""
        };
        format!(" ({}{over})", Reason::text_of(status.reason))
    };
    writeln!(
        out,
        "mode        {}{reason}, {} in {}",
        Mode::text_of(status.mode),
        counted(status.faults, "fault"),
        counted(status.cycles, "cycle"),
    )?;
    if let Some(cycle) = newest_cycle(status) {
        writeln!(
            out,
            "cycle       {cycle} now, as answers and telemetry number them: skipped releases count, too"
        )?;
    }
    if let Some(bend) = broken {
        writeln!(out, "            {bend}")?;
    }
    let reasons = [status.reason, status.reset_refused_by];
    let limit_m = status.clearance_fault_m;
    if let Some(share) = margin_share(&reasons, status.clearance_m, status.tip_margin_m, limit_m) {
        writeln!(out, "            {share}")?;
    }
    if let Some(remedy) = status_remedy(status) {
        writeln!(out, "remedy      {remedy}")?;
    }
    if status.reset_refused_by != Reason::Start.code() {
        let cause = Reason::text_of(status.reset_refused_by);
        let (pose, tip) = (pose_difference(status), tip_distance(status));
        writeln!(out, "reset       is refused now: {cause}{pose}{tip}")?;
        let reason = Reason::try_from(status.reset_refused_by);
        if let Some(reason) = reason.ok().filter(|reason| reason.code() != status.reason) {
            writeln!(out, "            {}", reason_remedy(reason))?;
        }
    }
    if is_tip_sensor_undeclared(status) {
        writeln!(
            out,
            "driver      measures only the tip, and messages of another driver are refused: a tip sensor beside a driver needs \
             link.tip_sensor = \"separate\" and a restart of cdcrd"
        )?;
    }
    place(out, status)?;
    if status.misses_tolerated > 0 {
        writeln!(
            out,
            "misses      the leaky bucket was full {}; a real robot would have been stopped (cycle.miss_limit)",
            counted(status.misses_tolerated, "time")
        )?;
    }
    let missing = realtime_missing(status.realtime_missing);
    if missing.is_empty() {
        return writeln!(out, "real time   yes");
    }
    writeln!(out, "real time   no")?;
    for (name, remedy) in missing {
        writeln!(out, "            {name} is missing: {remedy}")?;
    }
    Ok(())
}

/// Number on the grid of the cycle that ran when the status was sent.
fn newest_cycle(status: &Status) -> Option<u64> {
    let since_ns = status.header.sent_ns.checked_sub(status.origin_ns)?;
    since_ns.checked_div(status.period_ns)
}

/// Section and distance, where a reset has to accept them.
fn pose_difference(status: &Status) -> PoseDifference {
    if status.reset_refused_by != Reason::PoseDiffers.code() {
        return PoseDifference::default();
    }
    PoseDifference::of_errors(&status.following_error_rad)
}

/// Distance of the tip from its bends, where it refuses a reset.
pub(crate) fn tip_distance(status: &Status) -> String {
    if status.reset_refused_by != Reason::TipElsewhere.code() {
        return String::new();
    }
    format!(": {:.0} mm away", 1e3 * status.tip_contradiction_m)
}

/// Tip position, error to the reference, and following error.
fn place(out: &mut String, status: &Status) -> std::fmt::Result {
    if status.mode == Mode::Starting.code() {
        write!(out, "tip         not known yet: control has not begun")?;
    } else {
        tip(out, status)?;
    }
    if let Some(unheard) = Unheard::from_status(status) {
        write!(out, "; {unheard}")?;
    } else if let Some(cause) = unused_tip(status) {
        write!(out, "; the measured tip is not in use: {cause}")?;
        if let Some(way_out) = way_out(cause) {
            write!(out, "\n            {way_out}")?;
        }
    }
    if let Some(refused) = refused_text(status) {
        write!(out, "\n            {refused}")?;
    }
    following::write(out, status)
}

/// Where the tip is, and how far from its reference.
fn tip(out: &mut String, status: &Status) -> std::fmt::Result {
    let [x, y, z] = status.tip_position_m.map(|m| 1e3 * m);
    write!(out, "tip         {x:.1}, {y:.1}, {z:.1} mm")?;
    if status.position_error_m.is_finite() {
        let [x, y, z] = status.reference_position_m.map(|m| 1e3 * m);
        let error = 1e3 * status.position_error_m;
        write!(
            out,
            ", {error:.3} mm from its reference, {x:.1}, {y:.1}, {z:.1} mm"
        )?;
    }
    if status.measured_error_m.is_finite() {
        let error = 1e3 * status.measured_error_m;
        write!(out, "; measured {error:.3} mm from it")?;
    }
    Ok(())
}

/// A tip sensor that was started before the driver is probably taken for it.
fn is_tip_sensor_undeclared(status: &Status) -> bool {
    status.driver_measures_tip_only != 0
        && status.has_tip_sensor == 0
        && status.outcomes[Outcome::OtherDriver.code() as usize] > 0
}

/// What makes the daemon use the tip again.
fn way_out(cause: TipCause) -> Option<&'static str> {
    match cause {
        TipCause::Jumped | TipCause::Frozen => Some(
            "Check the sensor. Also one that is right again is used only after cdcrctl stop and cdcrctl reset, or when its program is started again",
        ),
        TipCause::WasFar => Some("It is used again by itself after 0.32 to 20 s within the limit"),
        TipCause::None | TipCause::Far | TipCause::Jumps => None,
    }
}

fn unused_tip(status: &Status) -> Option<TipCause> {
    let cause = TipCause::try_from(status.tip_cause).ok();
    cause.filter(|cause| *cause != TipCause::None)
}

fn core_text(core: u32) -> String {
    match core {
        u32::MAX => "no core".to_owned(),
        core => format!("core {core}"),
    }
}

/// Two columns: since the start or the last reset, and the last minute.
fn statistics(out: &mut String, status: &Status, now_ns: u64) -> std::fmt::Result {
    let both = [&status.since_reset, &status.last_minute];
    let since_ns = now_ns.saturating_sub(status.statistics_since_ns);
    let since = humantime::format_duration(Duration::from_secs(since_ns / 1_000_000_000));
    let (left, right) = (format!("the last {since}"), "the last minute");
    writeln!(out, "\n{:<20}{left:>33}   {right:>33}", "")?;
    let heading = format!("{:>11}{:>11}{:>11}", "p50", "p99", "max");
    writeln!(out, "{:<20}{heading}   {heading}", "time in µs")?;
    for (name, of) in LATENCIES {
        latency_row(out, name, both.map(of))?;
    }
    // Not every cycle solves, so these percentiles cover other cycles than those above.
    let [left, right] = both.map(|statistics| format!("{} of the cycles", statistics.solve.count));
    writeln!(
        out,
        "\n{:<20}{left:>33}   {right:>33}",
        "cycles that solved"
    )?;
    latency_row(out, "solve", both.map(|statistics| &statistics.solve))?;
    writeln!(out)?;
    let [left, right] = both.map(|statistics| (statistics as &dyn Struct).counters());
    let mut counters: Vec<_> = left.into_iter().zip(right).collect();
    // The number of cycles first, late starts last, followed by their causes.
    counters[1..].reverse();
    counters.retain(|((field, _), _)| !ERROR.contains(&field.name));
    for ((field, left), (_, right)) in counters {
        let solved = both.map(|statistics| statistics.solve.count);
        let (heading, left, right) = counter_texts(field, [left, right], solved);
        writeln!(out, "{heading:<30}{left:>23}   {right:>33}")?;
    }
    for (index, cause) in LateCause::ALL.iter().enumerate().skip(1) {
        let counts = both.map(|statistics| statistics.causes[index]);
        if counts != [0, 0] {
            let [left, right] = counts;
            let name = format!("  by {cause}");
            writeln!(out, "{name:<30}{left:>23}   {right:>33}")?;
        }
    }
    let [left, right] = both.map(error_text);
    writeln!(
        out,
        "{:<30}{left:>23}   {right:>33}",
        "tip error mean, max mm"
    )
}

/// Counters that are combined in one line.
const ERROR: [&str; 3] = ["tracked_cycles", "tip_error_sum_nm", "tip_error_max_nm"];

/// Estimated error between tip and reference during tracking.
fn error_text(statistics: &Statistics) -> String {
    if statistics.tracked_cycles == 0 {
        return "-".to_owned();
    }
    let mean_nm = statistics.tip_error_sum_nm as f64 / statistics.tracked_cycles as f64;
    let max_nm = statistics.tip_error_max_nm as f64;
    format!("{:.3}, {:.3}", 1e-6 * mean_nm, 1e-6 * max_nm)
}

type LatencyOf = fn(&Statistics) -> &LatencySummary;
/// Latencies of every cycle. An indented one is a part of the line above it.
const LATENCIES: [(&str, LatencyOf); 5] = [
    ("response", |s| &s.response),
    ("  wake-up", |s| &s.wake),
    ("  compute", |s| &s.compute),
    ("gather before it", |s| &s.gather),
    ("publish after it", |s| &s.publish),
];

fn latency_row(out: &mut String, name: &str, both: [&LatencySummary; 2]) -> std::fmt::Result {
    let of: [fn(&LatencySummary) -> u64; 3] = [|l| l.p50_ns, |l| l.p99_ns, |l| l.max_ns];
    let [left, right] = both.map(|latency| {
        let [p50, p99, max] = of.map(|of| latency_text(latency, of));
        format!("{p50:>11}{p99:>11}{max:>11}")
    });
    writeln!(out, "{name:<20}{left}   {right}")
}

/// A plain count, limited cycles with their share of solved cycles, or a time in µs.
fn counter_texts(field: &Field, both: [u64; 2], solved: [u64; 2]) -> (String, String, String) {
    let heading = field.heading();
    if field.name == "limited_cycles" {
        let text = |index: usize| {
            let share = both[index] as f64 / solved[index].max(1) as f64;
            format!("{} ({:.1} %)", both[index], 100.0 * share)
        };
        return (format!("{heading} (of solved)"), text(0), text(1));
    }
    match field.unit {
        "ns" => {
            let [left, right] = both.map(|ns| format!("{:.1}", ns as f64 * 1e-3));
            (format!("{heading} µs"), left, right)
        }
        _ => (heading.to_owned(), both[0].to_string(), both[1].to_string()),
    }
}

fn inputs(out: &mut String, status: &Status, now_ns: u64) -> std::fmt::Result {
    let holder = match status.lease_holder {
        0 => "nobody".to_owned(),
        id => format!("client {id:016x}"),
    };
    writeln!(
        out,
        "\nreference   {} ahead, lease held by {holder}",
        counted(status.reference_points, "point")
    )?;
    obstacles(out, status, now_ns)?;
    let counted = Outcome::ALL.iter().zip(status.outcomes);
    for (outcome, count) in counted.filter(|(_, count)| *count > 0) {
        writeln!(out, "messages    {count:>8}  {outcome}")?;
    }
    Ok(())
}

fn obstacles(out: &mut String, status: &Status, now_ns: u64) -> std::fmt::Result {
    write!(out, "obstacles   {}", status.obstacle_count)?;
    if status.obstacle_count > 0 {
        let clearance = clearance_text(status.clearance_m);
        write!(out, ", smallest clearance {clearance} mm as estimated")?;
        let margin_mm = 1e3 * status.tip_margin_m;
        if margin_mm > 0.0 {
            write!(out, " less the tip margin of {margin_mm:.1} mm")?;
        }
    }
    writeln!(
        out,
        ", safe distance {} mm (the guard changed {}; {} rejected)",
        1e3 * status.settings.safe_distance_m,
        counted(status.clearance_guarded, "command"),
        counted(status.obstacles_refused, "update")
    )?;
    if status.silent_obstacle_source == 0 {
        return Ok(());
    }
    let silent_s = now_ns.saturating_sub(status.silent_since_ns) as f64 * 1e-9;
    writeln!(
        out,
        "            a source of them, client {:016x}, has been silent for {silent_s:.1} s (obstacles.source_timeout_ms): its obstacles remain \
         at their last positions. Restart it: the daemon stops waiting when the same ids are sent again. Or remove each of its obstacles (cdcrctl obstacle list, \
         cdcrctl obstacle remove ID); cdcrctl obstacle clear removes those of every client",
        status.silent_obstacle_source
    )
}

/// The robot holds because of a source of obstacles, and none is silent any more.
fn waits_for_no_source(status: &Status) -> bool {
    status.mode == Mode::Holding.code()
        && status.reason == Reason::ObstacleSourceSilent.code()
        && status.silent_obstacle_source == 0
}

fn robot(out: &mut String, status: &Status) -> std::fmt::Result {
    writeln!(
        out,
        "\nsection   length m   cable radius m   bend max rad   rate max rad/s   body radius m"
    )?;
    let sections = status.robot.sections as usize;
    for (index, section) in status.robot.section.iter().take(sections).enumerate() {
        writeln!(
            out,
            "{:>7}{:>11.4}{:>17.4}{:>15.3}{:>17.3}{:>16.4}",
            index + 1,
            section.length_m,
            section.cable_radius_m,
            section.bend_max_rad,
            section.rate_max_rad_s,
            section.body_radius_m
        )?;
    }
    writeln!(
        out,
        "\nsolver      {}, {} steps, {} particles × {} iterations, {} refinements, budget {}",
        SolverKind::text_of(status.settings.solver),
        status.settings.horizon_steps,
        status.settings.swarm_size,
        status.settings.swarm_iterations,
        status.settings.refinement_steps,
        budget_text(status.settings.budget_ns)
    )
}

fn budget_text(budget_ns: u64) -> String {
    match budget_ns {
        0 => "all the remaining period".to_owned(),
        ns => format!("{} ms", ns as f64 * 1e-6),
    }
}

#[cfg(test)]
mod tests;
