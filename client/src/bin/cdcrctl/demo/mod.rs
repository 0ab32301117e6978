//! Everything at once: a daemon of its own, the paper's spiral, and what came of it.

mod config;
mod cycle;
mod daemon;
mod pictures;
mod report;
mod table;

use std::fs;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use cdcr_client::{Connection, FeedEnd, FeedEvent, FeedOptions, PAPER_SECTION_M, Spiral};
use cdcr_shared_types::Status;

use crate::Done;
use crate::args::{DemoOptions, Format};
use crate::bar::Bar;
use crate::interrupt::Interrupt;
use cycle::Cycle;
use daemon::DemoDaemon;
use report::Report;

/// What one run left behind.
struct Run {
    cycles: Vec<Cycle>,
    status: Status,
    lost_records: u64,
}

/// `cdcrctl demo`
pub(crate) fn run(options: &DemoOptions) -> anyhow::Result<Done> {
    if let Some(out) = &options.out {
        fs::create_dir_all(out)
            .with_context(|| format!("cannot make the folder {}", out.display()))?;
    }
    let sections = options.sections as usize;
    let spiral = Spiral {
        duration_s: options.duration.as_secs_f64(),
        ..Spiral::for_sections(&vec![PAPER_SECTION_M; sections])
    };
    let interrupt = Interrupt::catch()?;
    let Some(run) = track(sections, &spiral, &interrupt)? else {
        eprintln!("interrupted: the demo's daemon is stopped");
        return Ok(Done::Interrupted);
    };
    let report = Report::new(options, &run.cycles, &run.status, run.lost_records)?;
    print(&report, &run.status, options.format)?;
    if let Some(out) = &options.out {
        write_files(out, &run.cycles, &spiral, &report)?;
    }
    Ok(Done::Good)
}

/// Starts a daemon, feeds it the spiral, and stops it whatever happens. `None`: interrupted.
fn track(sections: usize, spiral: &Spiral, interrupt: &Interrupt) -> anyhow::Result<Option<Run>> {
    let mut daemon = DemoDaemon::start(&config::text(sections, spiral))?;
    let Some(connection) = daemon.connect(interrupt)? else {
        return Ok(None);
    };
    let run = feed(&connection, spiral, interrupt).with_context(|| daemon.last_words());
    // The client leaves before its daemon does, so that nothing of it stays behind.
    drop(connection);
    daemon.stop()?;
    run
}

fn feed(
    connection: &Connection,
    spiral: &Spiral,
    interrupt: &Interrupt,
) -> anyhow::Result<Option<Run>> {
    let options = FeedOptions {
        track: true,
        ..FeedOptions::default()
    };
    let bar = Bar::new("spiral");
    let mut cycles = Vec::new();
    let mut origin_ns = 0;
    let feed = connection.feed(spiral, options)?.run(|event| {
        match event {
            FeedEvent::Scheduled { start_ns } => origin_ns = start_ns,
            FeedEvent::Record(record) => cycles.extend(Cycle::of(record, spiral, origin_ns)),
            FeedEvent::Progress(progress) => bar.show(&progress),
            _ => {}
        }
        if interrupt.is_raised() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    if feed.end == FeedEnd::Interrupted {
        return Ok(None);
    }
    Ok(Some(Run {
        cycles,
        status: connection.status(Duration::from_secs(1))?,
        lost_records: feed.lost_records,
    }))
}

fn print(report: &Report, status: &Status, format: Format) -> anyhow::Result<()> {
    let text = match format {
        Format::Text => table::text(report, status)?,
        Format::Json => serde_json::to_string_pretty(report)? + "\n",
    };
    Ok(std::io::stdout().write_all(text.as_bytes())?)
}

fn write_files(
    out: &Path,
    cycles: &[Cycle],
    spiral: &Spiral,
    report: &Report,
) -> anyhow::Result<()> {
    let sections = report.sections as usize;
    cycle::write_csv(&out.join("telemetry.csv"), cycles, sections)?;
    pictures::path(&out.join("path.svg"), cycles, spiral, report)?;
    pictures::error(&out.join("error.svg"), cycles, report)?;
    pictures::timing(&out.join("timing.svg"), cycles, report)?;
    Ok(())
}
