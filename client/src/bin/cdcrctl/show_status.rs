use std::fmt::Write as _;
use std::io::Write as _;
use std::time::Duration;

use cdcr_client::{realtime_missing, text};
use cdcr_shared_types::codes::{Mode, Outcome, Reason, RobotLink, SolverKind};
use cdcr_shared_types::{LatencySummary, Status};

use crate::Done;
use crate::args::{Format, Target};
use crate::echo::json;
use crate::echo::line::{clearance_text, latency_text};

/// `cdcrctl status`
pub(crate) fn run(target: &Target, format: Format) -> anyhow::Result<Done> {
    let status = target.connect()?.status(Duration::from_secs(1))?;
    let shown = match format {
        Format::Text => table(&status)?,
        Format::Json => serde_json::to_string_pretty(&json::status(&status))? + "\n",
    };
    std::io::stdout().write_all(shown.as_bytes())?;
    Ok(Done::Good)
}

fn table(status: &Status) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    identity(&mut out, status)?;
    counters(&mut out, status)?;
    latencies(&mut out, status)?;
    inputs(&mut out, status)?;
    robot(&mut out, status)?;
    Ok(out)
}

fn identity(out: &mut String, status: &Status) -> std::fmt::Result {
    writeln!(
        out,
        "robot       {} ({} sections, {})",
        text(&status.robot_name),
        status.robot.sections,
        RobotLink::text_of(status.link)
    )?;
    writeln!(
        out,
        "daemon      cdcrd {}, process {}, period {} ms, pinned to {}",
        text(&status.build),
        status.process_id,
        status.period_ns as f64 * 1e-6,
        core_text(status.core)
    )?;
    writeln!(
        out,
        "mode        {} ({})",
        Mode::text_of(status.mode),
        Reason::text_of(status.reason)
    )?;
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

fn core_text(core: u32) -> String {
    match core {
        u32::MAX => "no core".to_owned(),
        core => format!("core {core}"),
    }
}

fn counters(out: &mut String, status: &Status) -> std::fmt::Result {
    writeln!(out)?;
    for (name, count) in [
        ("cycles", status.cycles),
        ("deadline misses", status.deadline_misses),
        ("skipped periods", status.skipped_periods),
        ("late starts", status.late_starts),
        ("budget hits", status.budget_hits),
        ("dropped records", status.dropped_records),
        ("faults", status.faults),
    ] {
        writeln!(out, "{name:<18}{count:>12}")?;
    }
    Ok(())
}

fn latencies(out: &mut String, status: &Status) -> std::fmt::Result {
    writeln!(
        out,
        "\n{:<18}{:>12}{:>12}{:>12}{:>12}",
        "time in µs", "p50", "p99", "p99.9", "max"
    )?;
    for (name, latency) in [
        ("wake-up", &status.wake),
        ("solve", &status.solve),
        ("response", &status.response),
    ] {
        latency_row(out, name, latency)?;
    }
    Ok(())
}

fn latency_row(out: &mut String, name: &str, latency: &LatencySummary) -> std::fmt::Result {
    writeln!(
        out,
        "{name:<18}{:>12}{:>12}{:>12}{:>12}",
        latency_text(latency, |l| l.p50_ns),
        latency_text(latency, |l| l.p99_ns),
        latency_text(latency, |l| l.p999_ns),
        latency_text(latency, |l| l.max_ns)
    )
}

fn inputs(out: &mut String, status: &Status) -> std::fmt::Result {
    let holder = match status.lease_holder {
        0 => "nobody".to_owned(),
        id => format!("client {id:016x}"),
    };
    writeln!(
        out,
        "\nreference   {} points ahead, lease held by {holder}",
        status.reference_points
    )?;
    obstacles(out, status)?;
    let counted = Outcome::ALL.iter().zip(status.outcomes);
    for (outcome, count) in counted.filter(|(_, count)| *count > 0) {
        writeln!(out, "messages    {count:>8}  {outcome}")?;
    }
    Ok(())
}

fn obstacles(out: &mut String, status: &Status) -> std::fmt::Result {
    write!(out, "obstacles   {}", status.obstacle_count)?;
    if status.obstacle_count > 0 {
        let clearance = clearance_text(status.clearance_m);
        write!(out, ", smallest clearance {clearance} mm")?;
    }
    writeln!(
        out,
        ", kept {} mm away (the guard changed {} commands; {} updates refused)",
        1e3 * status.settings.safe_distance_m,
        status.clearance_guarded,
        status.obstacles_refused
    )
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
        "\nsolver      {}, {} steps, {} particles × {} iterations, {} refinements",
        SolverKind::text_of(status.settings.solver),
        status.settings.horizon_steps,
        status.settings.swarm_size,
        status.settings.swarm_iterations,
        status.settings.refinement_steps
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use cdcr_shared_types::codes::realtime;

    #[test]
    fn the_table_says_what_matters() {
        let mut status = Status {
            mode: Mode::Tracking.code(),
            realtime_missing: realtime::FIFO,
            cycles: 1234,
            ..Status::default()
        };
        status.robot.sections = 2;
        status.outcomes[Outcome::NoLease.code() as usize] = 3;
        status.wake.count = 1;
        status.wake.p99_ns = 42_500;
        status.core = u32::MAX;
        status.obstacle_count = 2;
        status.clearance_m = 0.0105;
        status.clearance_guarded = 17;
        let table = table(&status).expect("formatted");
        for expected in [
            "mode        tracking",
            "SCHED_FIFO is missing: run as root",
            "1234",
            "42.5",
            "pinned to no core",
            "obstacles   2, smallest clearance 10.50 mm",
            "the guard changed 17 commands",
            "solve                        -           -           -           -\n",
            "3  the sender does not hold the reference lease",
        ] {
            assert!(table.contains(expected), "{expected} in\n{table}");
        }
    }
}
