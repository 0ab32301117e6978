//! Output of `cdcrd bare`.

use std::io::{self, BufWriter, Write};
use std::time::Duration;

use anyhow::{Context, Result};
use cdcr_shared_types::codes::LateCause;
use cdcr_shared_types::{BARE_COLUMNS, BareSummary, LatencySummary, parse_duration};
use clap::{Args, ValueEnum};

use super::{ConfigSource, end_with_process};
use crate::bare::{self, BareCycle, Outcome};

/// Help text after the options.
pub(super) fn after_help() -> String {
    let causes = LateCause::ALL.iter();
    let causes: Vec<_> = causes
        .map(|cause| format!("{} {cause}", cause.code()))
        .collect();
    format!("{AFTER_HELP}\ncause: {}.", causes.join(", "))
}

const AFTER_HELP: &str = "Example: cdcrd bare --duration 1min --format csv > bare.csv\n\n\
    The cycle thread of the configuration (core, priority, locked memory, period) wakes up before each release \
    (realtime.spin_us), spins until the release and reads the clock. Lateness is evaluated as in cdcrd run, but is caused by \
    the machine alone. Uses no shared memory, so it can run beside a daemon; on the same core the two \
    disturb each other. SIGINT and SIGTERM end it early and print the results so far.\n\n\
    --format csv prints one line per cycle. run_delay_ns and page_faults are empty where the kernel does not \
    report them. Logs to the standard error.";

#[derive(Debug, Args)]
pub(super) struct BareOptions {
    #[command(flatten)]
    source: ConfigSource,
    /// Duration: 1 to 10 million periods.
    #[arg(long, value_name = "DURATION", default_value = "10s", value_parser = parse_duration)]
    duration: Duration,
    /// Output format.
    #[arg(long, value_enum, default_value_t = BareFormat::Text, value_name = "FORMAT")]
    format: BareFormat,
    /// End when the parent process, which has this id, ends, however it ends.
    #[arg(long, value_name = "PID", hide = true)]
    end_with_parent: Option<i32>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum BareFormat {
    /// Table.
    Text,
    /// One line per cycle.
    Csv,
    /// The numbers of the table as one JSON object.
    Json,
}

/// Runs the bare loop, and prints its results.
pub(super) fn run(options: &BareOptions) -> Result<()> {
    end_with_process(options.end_with_parent)?;
    let outcome = bare::run(&options.source.load()?, options.duration)?;
    let mut out = BufWriter::new(io::stdout().lock());
    match write(&mut out, options.format, &outcome).and_then(|()| out.flush()) {
        // The reader has closed the pipe: `cdcrd bare --format csv | head`.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        written => written.context("cannot write the result"),
    }
}

fn write(out: &mut impl Write, format: BareFormat, outcome: &Outcome) -> io::Result<()> {
    match format {
        BareFormat::Text => write_text(out, &outcome.summary),
        BareFormat::Csv => write_csv(out, &outcome.cycles),
        BareFormat::Json => {
            serde_json::to_writer_pretty(&mut *out, &outcome.summary)?;
            writeln!(out)
        }
    }
}

fn write_csv(out: &mut impl Write, cycles: &[BareCycle]) -> io::Result<()> {
    writeln!(out, "{BARE_COLUMNS}")?;
    for cycle in cycles {
        let release = &cycle.release;
        let (run_delay_ns, page_faults) = match cycle.interference {
            Some(reported) => (
                reported.run_delay_ns.to_string(),
                reported.page_faults.to_string(),
            ),
            None => (String::new(), String::new()),
        };
        writeln!(
            out,
            "{},{},{},{},{},{},{},{run_delay_ns},{page_faults},{}",
            release.cycle,
            release.due_ns,
            release.start_ns,
            cycle.handed_over_ns,
            release.skipped,
            u8::from(cycle.lateness.late_start),
            u8::from(cycle.lateness.deadline_miss),
            cycle.assignment.cause().unwrap_or_default().code()
        )?;
    }
    Ok(())
}

fn write_text(out: &mut impl Write, summary: &BareSummary) -> io::Result<()> {
    let ms = |time_ns: u64| time_ns as f64 / 1e6;
    writeln!(
        out,
        "Loop without work, period {} ms, {:.2} s\n",
        ms(summary.period_ns),
        summary.duration_s
    )?;
    let late = format!("started over {} ms late", ms(summary.late_start_ns));
    let miss = format!("over after {} ms", ms(summary.deadline_ns));
    for (name, count, meaning) in [
        ("cycles", summary.cycles, ""),
        ("late starts", summary.late_starts, &late),
        ("deadline misses", summary.deadline_misses, &miss),
        (
            "skipped periods",
            summary.skipped_periods,
            "releases without a cycle",
        ),
    ] {
        writeln!(
            out,
            "{}",
            format!("{name:<17}{count:>9}   {meaning}").trim_end()
        )?;
    }
    for (name, count) in &summary.causes {
        writeln!(out, "{:<17}{count:>9}   {name}", "caused by")?;
    }
    if let Some(page_faults) = summary.page_faults {
        writeln!(out, "{:<17}{page_faults:>9}", "page faults")?;
    }
    write_latencies(out, summary)?;
    let realtime = if summary.realtime {
        "yes".to_owned()
    } else {
        format!("no: {} missing", summary.realtime_missing.join(", "))
    };
    let core = summary
        .core
        .map_or("not pinned".to_owned(), |core| core.to_string());
    writeln!(out, "\n{:<17}{realtime}\n{:<17}{core}", "real time", "core")
}

fn write_latencies(out: &mut impl Write, summary: &BareSummary) -> io::Result<()> {
    writeln!(
        out,
        "\n{:<17}{:>9}{:>9}{:>9}{:>9}{:>9}",
        "time [µs]", "min", "p50", "p99", "p99.9", "max"
    )?;
    let mut row = |name, of: &LatencySummary| {
        let columns = [of.min_ns, of.p50_ns, of.p99_ns, of.p999_ns, of.max_ns];
        let columns = columns.map(|time_ns| format!("{:>9.1}", time_ns as f64 * 1e-3));
        writeln!(out, "{name:<17}{}", columns.concat())
    };
    row("wake-up", &summary.wake)?;
    match &summary.run_delay {
        Some(run_delay) => row("run-queue wait", run_delay),
        None => writeln!(out, "{:<17}not reported by the kernel", "run-queue wait"),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::bare::Interference;
    use crate::rt::attribution::CauseAssignment;
    use crate::rt::schedule::Lateness;
    use crate::rt::schedule::Release;

    fn outcome() -> Outcome {
        let cycle = BareCycle {
            release: Release {
                cycle: 3,
                release_ns: 300,
                due_ns: 200,
                start_ns: 310,
                skipped: 1,
            },
            handed_over_ns: 350,
            lateness: Lateness {
                late_start: true,
                deadline_miss: false,
            },
            assignment: CauseAssignment::Own(LateCause::Load),
            interference: Some(Interference {
                run_delay_ns: 70,
                page_faults: 2,
            }),
        };
        let untold = BareCycle {
            assignment: CauseAssignment::Before(LateCause::Stall),
            interference: None,
            ..cycle
        };
        let latency = LatencySummary {
            count: 4_999,
            min_ns: 1_000,
            p50_ns: 14_049,
            p99_ns: 30_000,
            p999_ns: 99_960,
            max_ns: 1_234_500,
        };
        let summary = BareSummary {
            period_ns: 100_000,
            deadline_ns: 100_000,
            late_start_ns: 1_000_000,
            spin_ns: 0,
            duration_s: 0.5,
            cycles: 4_999,
            late_starts: 1,
            deadline_misses: 0,
            skipped_periods: 1,
            causes: BTreeMap::from([("another task had the core".to_owned(), 1)]),
            wake: latency,
            run_delay: None,
            page_faults: Some(2),
            realtime: false,
            realtime_missing: vec!["SCHED_FIFO".to_owned(), "locked memory".to_owned()],
            core: Some(1),
        };
        Outcome {
            summary,
            cycles: vec![cycle, untold],
        }
    }

    fn written(format: BareFormat) -> String {
        let mut bytes = Vec::new();
        write(&mut bytes, format, &outcome()).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_line_of_csv_for_each_cycle_and_nothing_where_nothing_is_reported() {
        let expected = [
            BARE_COLUMNS,
            "3,200,310,350,1,1,0,70,2,2",
            "3,200,310,350,1,1,0,,,4",
        ];
        assert_eq!(
            written(BareFormat::Csv).lines().collect::<Vec<_>>(),
            expected
        );
    }

    #[test]
    fn the_table() {
        let expected = "\
Loop without work, period 0.1 ms, 0.50 s

cycles                4999
late starts              1   started over 1 ms late
deadline misses          0   over after 0.1 ms
skipped periods          1   releases without a cycle
caused by                1   another task had the core
page faults              2

time [µs]              min      p50      p99    p99.9      max
wake-up                1.0     14.0     30.0    100.0   1234.5
run-queue wait   not reported by the kernel

real time        no: SCHED_FIFO, locked memory missing
core             1
";
        assert_eq!(written(BareFormat::Text), expected);
    }

    #[test]
    fn the_summary_is_json_with_units() {
        let json: serde_json::Value = serde_json::from_str(&written(BareFormat::Json)).unwrap();
        assert_eq!(json["wake"]["p999_ns"], 99_960);
        assert_eq!(json["run_delay"], serde_json::Value::Null);
        assert_eq!(json["causes"]["another task had the core"], 1);
        assert_eq!(json["realtime_missing"][1], "locked memory");
    }
}
