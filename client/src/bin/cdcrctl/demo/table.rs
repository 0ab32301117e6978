use std::fmt::{Error, Write};

use cdcr_client::realtime_missing;
use cdcr_shared_types::Status;

use super::report::{Report, Spread};

/// The report for people.
pub(super) fn text(report: &Report, status: &Status) -> Result<String, Error> {
    let mut out = String::new();
    let plural = if report.sections == 1 { "" } else { "s" };
    writeln!(
        out,
        "Spiral of Eq. 8, {} section{plural}, {} s: {} cycles of {} ms\n",
        report.sections,
        report.duration_s,
        report.cycles,
        status.period_ns as f64 / 1e6
    )?;
    writeln!(
        out,
        "{:<24}{:>12}{:>12}{:>16}",
        "tracking error [mm]", "mean", "max", "paper's mean"
    )?;
    writeln!(
        out,
        "{:<24}{:>12.2e}{:>12.2e}{:>16.0e}\n",
        "  tip to exact curve",
        report.mean_error_mm,
        report.max_error_mm,
        report.paper_mean_error_mm
    )?;
    writeln!(
        out,
        "{:<24}{:>12}{:>12}{:>16}",
        "time [µs]", "p50", "p99", "max"
    )?;
    row(&mut out, "  wake-up", &report.wake_us)?;
    row(&mut out, "  solve", &report.solve_us)?;
    row(&mut out, "  response", &report.response_us)?;
    counts(&mut out, report, status)?;
    real_time(&mut out, status)?;
    if let Some(folder) = &report.out {
        writeln!(
            out,
            "\nwritten to {folder}: telemetry.csv, path.svg, error.svg, timing.svg"
        )?;
    }
    Ok(out)
}

fn row(out: &mut String, name: &str, spread: &Spread) -> Result<(), Error> {
    writeln!(
        out,
        "{name:<24}{:>12.1}{:>12.1}{:>16.1}",
        spread.p50, spread.p99, spread.max
    )
}

fn counts(out: &mut String, report: &Report, status: &Status) -> Result<(), Error> {
    let deadline_ms = status.deadline_ns as f64 * 1e-6;
    writeln!(
        out,
        "\n{:<24}{:>12}   of {} (deadline {deadline_ms} ms after the release)",
        "deadline misses", report.deadline_misses, report.cycles
    )?;
    writeln!(
        out,
        "{:<24}{:>12}   (releases that got no command)",
        "skipped periods", report.skipped_periods
    )?;
    writeln!(
        out,
        "{:<24}{:>12}",
        "lost telemetry records", report.lost_records
    )
}

fn real_time(out: &mut String, status: &Status) -> Result<(), Error> {
    let missing = realtime_missing(status.realtime_missing);
    if missing.is_empty() {
        return writeln!(out, "{:<24}{:>12}", "real time", "yes");
    }
    writeln!(out, "{:<24}{:>12}   missing:", "real time", "no")?;
    for (name, remedy) in missing {
        writeln!(out, "  {name}: {remedy}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::cycle::tests::synthetic;
    use super::super::report::tests::report;
    use super::*;
    use cdcr_shared_types::codes::realtime;

    #[test]
    fn it_names_what_is_missing_and_the_remedy() {
        let (cycles, _) = synthetic(994);
        let status = Status {
            realtime_missing: realtime::FIFO,
            period_ns: 5_000_000,
            deadline_ns: 5_000_000,
            ..Status::default()
        };
        let text = text(&report(&cycles, &status), &status).expect("formatted");
        assert!(text.contains("4.97 s: 994 cycles of 5 ms\n"), "{text}");
        assert!(text.contains("SCHED_FIFO: run as the service"), "{text}");
        assert!(text.contains("5e-3"), "{text}");
        assert!(
            text.contains("0   (releases that got no command)"),
            "{text}"
        );
    }

    #[test]
    fn real_time_is_one_word_when_all_is_well() {
        let (cycles, _) = synthetic(5);
        let status = Status::default();
        let text = text(&report(&cycles, &status), &status).expect("formatted");
        assert!(
            text.lines()
                .any(|l| l.starts_with("real time") && l.ends_with("yes"))
        );
    }
}
