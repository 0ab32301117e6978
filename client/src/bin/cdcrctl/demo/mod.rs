//! The demo: a private daemon that tracks the paper's spiral, and a report.

mod baseline;
mod causes;
mod config;
mod cycle;
mod daemon;
mod diagnosis;
mod pictures;
mod report;
mod shape;
mod sketch;
mod steal;
mod table;

use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;

use anyhow::anyhow;
use cdcr_client::{
    Connection, FeedEnd, FeedEvent, FeedOptions, PAPER_SECTION_M, STATUS_TIMEOUT, Spiral,
};
use cdcr_process::{PrivatePlace, fill_folder, output_folder};

use crate::args::{DemoOptions, Format};
use crate::bar::Bar;
use crate::done::Done;
use crate::incidents;
use crate::interrupt::Interrupt;
use baseline::Baseline;
use causes::IncidentCauses;
use cycle::Cycle;
use daemon::DemoDaemon;
use report::{DemoReport, Run};
use shape::Backbone;
use sketch::Sketch;
use steal::StealReading;

pub(crate) fn run(options: &DemoOptions) -> anyhow::Result<Done> {
    if let Some(out) = &options.out {
        output_folder(out)?;
    }
    let sections = options.sections as usize;
    let spiral = Spiral {
        duration_s: options.duration.as_secs_f64(),
        ..Spiral::for_sections(&vec![PAPER_SECTION_M; sections])
    };
    let interrupt = Interrupt::catch()?;
    let Some(run) = measure(sections, &spiral, &interrupt)? else {
        tell!("interrupted: the demo's daemon is stopped");
        return Ok(Done::Interrupted);
    };
    let report = DemoReport::new(options, &run)?;
    let backbone = Backbone::new(sections)?;
    match options.format {
        Format::Text => {
            let text = table::text(&report, &run.status)?;
            let sketch = sketch(&run.cycles, &spiral, &backbone);
            write!(anstream::stdout(), "{text}\n{sketch}")?;
        }
        Format::Json => writeln!(
            std::io::stdout(),
            "{}",
            serde_json::to_string_pretty(&report)?
        )?,
    }
    if let Some(out) = &options.out {
        fill_folder(out, |fresh| {
            write_files(fresh, &run, &spiral, &backbone, &report)
        })?;
    }
    Ok(Done::Good)
}

/// Measures the baseline, then runs a daemon that tracks the spiral; both end in any case. `None`:
/// interrupted.
fn measure(sections: usize, spiral: &Spiral, interrupt: &Interrupt) -> anyhow::Result<Option<Run>> {
    let place = PrivatePlace::new()?;
    let config = daemon::write_configuration(&place, &config::text(sections, spiral))?;
    let baseline = match Baseline::measure(&config, interrupt) {
        Ok(Some(baseline)) => Ok(baseline),
        Ok(None) => return Ok(None),
        // A failed baseline does not fail the demo: it only helps to explain the result.
        Err(cause) => Err(format!("{cause:#}")),
    };
    let mut daemon = DemoDaemon::start(place, &config)?;
    let Some(connection) = daemon.connect(interrupt)? else {
        return Ok(None);
    };
    let run = feed(&connection, spiral, baseline, interrupt)
        .map_err(|cause| anyhow!(daemon.explained(&format!("{cause:#}"))));
    // The client disconnects before the daemon ends, so that no files remain.
    drop(connection);
    daemon.stop()?;
    run
}

fn feed(
    connection: &Connection,
    spiral: &Spiral,
    baseline: Result<Baseline, String>,
    interrupt: &Interrupt,
) -> anyhow::Result<Option<Run>> {
    let options = FeedOptions {
        track: true,
        ..FeedOptions::default()
    };
    let bar = Bar::new("spiral");
    let mut cycles = Vec::new();
    let mut attributed = IncidentCauses::default();
    let mut origin_ns = 0;
    let mut incidents = connection.incidents()?;
    let core = connection.status(STATUS_TIMEOUT)?.core;
    let steal = StealReading::now((core != u32::MAX).then_some(core));
    let feed = connection.feed(spiral, options)?.run(|event| {
        match event {
            FeedEvent::Scheduled { start_ns } => origin_ns = start_ns,
            FeedEvent::Record(record) => {
                cycles.extend(Cycle::from_record(record, spiral, origin_ns));
            }
            FeedEvent::Progress(progress) => bar.show(&progress, None),
            _ => {}
        }
        // Five seconds may produce more incidents than the queue holds, so they are read here.
        while let Ok(Some(incident)) = incidents.try_next() {
            attributed.take(&incident);
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
    let steal = steal.and_then(|reading| reading.since());
    for incident in incidents::kept(connection, &mut incidents)? {
        attributed.take(&incident);
    }
    Ok(Some(Run {
        baseline,
        cycles,
        incidents: attributed,
        steal,
        status: connection.status(STATUS_TIMEOUT)?,
        lost_records: feed.lost_records,
    }))
}

/// The robot at the end of the run.
fn sketch(cycles: &[Cycle], spiral: &Spiral, backbone: &Backbone) -> String {
    let Some(last) = cycles.last() else {
        return String::new();
    };
    let sketch = Sketch {
        backbone: backbone.points(last),
        reference: shape::curve(spiral),
        time_s: last.time_s,
    };
    sketch.text(sketch::columns())
}

fn write_files(
    out: &Path,
    run: &Run,
    spiral: &Spiral,
    backbone: &Backbone,
    report: &DemoReport,
) -> anyhow::Result<()> {
    let (cycles, sections) = (&run.cycles, report.sections as usize);
    cycle::write_csv(&out.join("telemetry.csv"), cycles, sections)?;
    pictures::path(&out.join("path.svg"), cycles, spiral, report)?;
    pictures::shape(&out.join("shape.svg"), cycles, spiral, backbone, report)?;
    pictures::error(&out.join("error.svg"), cycles, report)?;
    pictures::timing(
        &out.join("timing.svg"),
        cycles,
        report,
        run.status.deadline_ns as f64 * 1e-3,
    )?;
    Ok(())
}
