use std::fmt::{Error, Write};

use cdcr_client::{counted, realtime_missing};
use cdcr_shared_types::Status;
use cdcr_shared_types::codes::LateCause;

use super::diagnosis::Diagnosis;
use super::report::DemoReport;
use crate::spread::Spread;

const WIDTH: usize = 80;

pub(super) fn text(report: &DemoReport, status: &Status) -> Result<String, Error> {
    let mut out = String::new();
    writeln!(
        out,
        "Spiral of Eq. 8, {}, {} s: {} cycles of {} ms\n",
        counted(report.sections, "section"),
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
        "{:<24}{:>12.2e}{:>12.2e}{:>16.0e}   (tip to exact curve: {})\n",
        "  ideal simulated robot",
        report.mean_error_mm,
        report.max_error_mm,
        report.paper_mean_error_mm,
        whose_error(report.skipped_periods)
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
    beside(&mut out, report)?;
    real_time(&mut out, status)?;
    diagnosis(&mut out, &report.diagnosis)?;
    if let Some(folder) = &report.out {
        writeln!(
            out,
            "\nwritten to {folder}: telemetry.csv, path.svg, shape.svg, error.svg, timing.svg"
        )?;
    }
    Ok(out)
}

/// Note on skipped periods: the robot kept its rates then, so the error is not the controller's alone.
fn whose_error(skipped_periods: u64) -> String {
    match skipped_periods {
        0 => "the controller's share".to_owned(),
        1 => "1 release without a command, caused by the machine".to_owned(),
        many => format!("{many} releases without a command, caused by the machine"),
    }
}

fn row(out: &mut String, name: &str, spread: &Spread) -> Result<(), Error> {
    writeln!(
        out,
        "{name:<24}{:>12.1}{:>12.1}{:>16.1}",
        spread.p50, spread.p99, spread.max
    )
}

fn counts(out: &mut String, report: &DemoReport, status: &Status) -> Result<(), Error> {
    let deadline_ms = status.deadline_ns as f64 * 1e-6;
    writeln!(
        out,
        "\n{:<24}{:>12}   of {} (deadline {deadline_ms} ms after the release)",
        "deadline misses", report.deadline_misses, report.cycles
    )?;
    causes(out, report)?;
    writeln!(
        out,
        "{:<24}{:>12}   (releases without a command)",
        "skipped periods", report.skipped_periods
    )?;
    writeln!(
        out,
        "{:<24}{:>12}",
        "lost telemetry records", report.lost_records
    )
}

/// Causes of the misses; empty without a miss.
fn causes(out: &mut String, report: &DemoReport) -> Result<(), Error> {
    for (cause, count) in report.misses_by_cause.ranked() {
        write!(out, "{:<24}{count:>12}   {cause}", "  caused by")?;
        let is_platform = cause == LateCause::Platform.text();
        if let Some(steal) = report.steal.filter(|s| is_platform && s.steal_s > 0.0) {
            write!(out, " (the hypervisor stole {steal})")?;
        }
        writeln!(out)?;
    }
    Ok(())
}

/// The daemon's latencies beside the baseline.
fn beside(out: &mut String, report: &DemoReport) -> Result<(), Error> {
    let Some(bare) = &report.baseline else {
        let error = report.baseline_error.as_deref().unwrap_or_default();
        return writeln!(out, "\nno bare loop for comparison: {error}");
    };
    writeln!(
        out,
        "\n{:<24}{:>12}{:>12}   (cdcrd bare: the same loop without work, {:.1} s before)",
        "next to a bare loop", "daemon", "bare loop", bare.duration_s
    )?;
    let rows = [
        ("  wake-up p50 [µs]", report.wake_us.p50, bare.wake_us.p50),
        ("  wake-up p99 [µs]", report.wake_us.p99, bare.wake_us.p99),
        ("  wake-up max [µs]", report.wake_us.max, bare.wake_us.max),
        (
            "  late starts per s",
            report.late_starts_per_s,
            bare.late_starts_per_s,
        ),
        (
            "  misses per s",
            report.deadline_misses_per_s,
            bare.deadline_misses_per_s,
        ),
    ];
    for (name, daemon, bare) in rows {
        writeln!(out, "{name:<24}{daemon:>12.1}{bare:>12.1}")?;
    }
    Ok(())
}

fn diagnosis(out: &mut String, diagnosis: &Diagnosis) -> Result<(), Error> {
    writeln!(out, "\n{}", wrapped(&diagnosis.text))?;
    if let Some(grant) = &diagnosis.grant {
        writeln!(out, "Grant real time: {grant}")?;
    }
    match &diagnosis.next {
        Some(next) => writeln!(out, "Next: {next}"),
        None => Ok(()),
    }
}

/// Wraps the text at [`WIDTH`].
fn wrapped(text: &str) -> String {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.is_empty() => word.clone_into(line),
            Some(line) if line.chars().count() + 1 + word.chars().count() <= WIDTH => {
                *line += " ";
                *line += word;
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines.join("\n")
}

fn real_time(out: &mut String, status: &Status) -> Result<(), Error> {
    let missing = realtime_missing(status.realtime_missing);
    if missing.is_empty() {
        return writeln!(out, "\n{:<24}{:>12}", "real time", "yes");
    }
    writeln!(out, "\n{:<24}{:>12}   missing:", "real time", "no")?;
    for (name, remedy) in missing {
        writeln!(out, "  {name}: {remedy}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::causes::tests::missed;
    use super::super::cycle::tests::synthetic;
    use super::super::report::tests::report;
    use super::*;
    use cdcr_shared_types::codes::realtime;

    #[test]
    fn an_error_beside_lost_releases_is_not_called_the_controllers() {
        let (mut cycles, _) = synthetic(994);
        let status = Status::default();
        let shown = |cycles: &[_]| text(&report(cycles, &status), &status).expect("formatted");
        assert!(shown(&cycles).contains("the controller's share"));
        cycles[500].skipped_periods = 3;
        let lost = shown(&cycles);
        assert!(
            lost.contains("3 releases without a command") && !lost.contains("controller's share")
        );
    }

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
        assert!(text.contains("SCHED_FIFO: grant rtprio 90"), "{text}");
        assert!(text.contains("5e-3"), "{text}");
        assert!(text.contains("0   (releases without a command)"), "{text}");
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

    #[test]
    fn misses_have_their_causes_below_them_and_a_diagnosis_at_the_end() {
        use LateCause::{Load, Platform};
        let cycles = missed(&[Load, Platform, Platform]);
        let report = report(&cycles, &Status::default());
        let text = text(&report, &Status::default()).expect("formatted");
        let lines: Vec<&str> = text.lines().collect();
        let misses = lines
            .iter()
            .position(|line| line.starts_with("deadline misses"));
        let misses = misses.expect("a row");
        assert_eq!(
            lines[misses + 1..misses + 3],
            [
                "  caused by                        2   platform (the hypervisor stole 1.30 of 5.0 s)",
                "  caused by                        1   another task had the core",
            ]
        );
        for expected in [
            "  wake-up p99 [µs]              ",
            "        90.0\n",
            "  misses per s                   0.6         6.0\n",
            "  late starts per s              0.0         8.0\n",
            "  ideal simulated robot ",
        ] {
            assert!(text.contains(expected), "{expected} in\n{text}");
        }
        assert!(text.ends_with("cdcrd doctor\n"), "{text}");
        let one_line = text.replace('\n', " ");
        assert!(one_line.contains(&report.diagnosis.text), "{text}");
    }

    #[test]
    fn without_misses_there_are_no_causes_and_nothing_to_run_next() {
        let report = report(&missed(&[]), &Status::default());
        let text = text(&report, &Status::default()).expect("formatted");
        assert!(text.contains("No deadline was missed"), "{text}");
        assert!(
            !text.contains("caused by") && !text.contains("Next"),
            "{text}"
        );
    }

    #[test]
    fn without_a_bare_loop_there_is_a_line_instead_of_its_table() {
        let mut report = report(&missed(&[]), &Status::default());
        report.baseline = None;
        report.baseline_error = Some("cdcrd bare failed (exit status: 1)".to_owned());
        let text = text(&report, &Status::default()).expect("formatted");
        let line = "\nno bare loop for comparison: cdcrd bare failed (exit status: 1)\n";
        assert!(
            text.contains(line) && !text.contains("next to a bare loop"),
            "{text}"
        );
    }

    #[test]
    fn missing_real_time_has_one_command() {
        let status = Status {
            realtime_missing: realtime::FIFO | realtime::LOCKED,
            ..Status::default()
        };
        let text = text(&report(&missed(&[]), &status), &status).expect("formatted");
        assert_eq!(text.matches("Grant real time").count(), 1, "{text}");
    }

    #[test]
    fn a_long_sentence_is_wrapped_between_words() {
        let text = "word ".repeat(40) + "end.";
        let wrapped = wrapped(&text);
        assert!(wrapped.lines().count() > 2);
        assert!(
            wrapped
                .lines()
                .all(|line| line.chars().count() <= WIDTH && line == line.trim())
        );
        assert_eq!(wrapped.replace('\n', " "), text);
    }
}
