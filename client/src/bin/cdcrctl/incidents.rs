use std::io::Write;
use std::time::{Duration, Instant};

use cdcr_client::{Connection, Stream, monotonic_ns};
use cdcr_shared_types::Incident;
use cdcr_shared_types::limits::INCIDENTS_MAX;

use crate::args::{Format, IncidentsOptions, Target};
use crate::done::Done;
use crate::echo::{json, line};
use crate::interrupt::{INTERRUPT_INTERVAL, Interrupt};

/// Number of statuses after which all kept incidents have arrived: the daemon detects a new reader at the
/// latest when it publishes its next status.
const STATUSES: u64 = 3;
/// Timeout for these statuses; ten per second are published.
const TIMEOUT: Duration = Duration::from_secs(2);

pub(crate) fn run(target: &Target, options: &IncidentsOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    let interrupt = Interrupt::catch()?;
    let mut stream = connection.incidents()?;
    let kept = kept(&connection, &mut stream)?;
    let mut out = std::io::stdout().lock();
    if options.format == Format::Text && (options.follow || !kept.is_empty()) {
        writeln!(out, "{}", line::INCIDENT_HEADING)?;
    }
    for incident in newest(&kept, options.count) {
        print(&mut out, incident, options.format)?;
    }
    if !options.follow {
        if kept.is_empty() && options.format == Format::Text {
            writeln!(out, "no incidents since the daemon started")?;
        }
        return Ok(Done::Good);
    }
    while !interrupt.is_raised() {
        match stream.next_within(INTERRUPT_INTERVAL)? {
            Some(incident) => print(&mut out, &incident, options.format)?,
            None => out.flush()?,
        }
    }
    Ok(Done::Good)
}

/// The incidents that the daemon has kept and that were not read from `stream` yet, oldest first.
pub(crate) fn kept(
    connection: &Connection,
    stream: &mut Stream<Incident>,
) -> anyhow::Result<Vec<Incident>> {
    let mut snapshots = connection.statuses()?;
    let deadline = Instant::now() + TIMEOUT;
    for _ in 0..STATUSES {
        let left = deadline.saturating_duration_since(Instant::now());
        if snapshots.next_within(left)?.is_none() {
            break;
        }
    }
    let mut kept = Vec::with_capacity(INCIDENTS_MAX);
    while let Some(incident) = stream.try_next()? {
        kept.push(incident);
    }
    Ok(kept)
}

/// The last `count` incidents.
fn newest(kept: &[Incident], count: Option<u64>) -> &[Incident] {
    let count = count.map_or(kept.len(), |count| kept.len().min(count as usize));
    &kept[kept.len() - count..]
}

fn print(out: &mut impl Write, incident: &Incident, format: Format) -> std::io::Result<()> {
    match format {
        Format::Text => writeln!(out, "{}", line::incident_at(incident, monotonic_ns()))?,
        Format::Json => writeln!(out, "{}", json::message(incident))?,
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_count_leaves_the_newest() {
        let mut kept = vec![Incident::default(); 3];
        for (number, incident) in (1..).zip(&mut kept) {
            incident.header.sequence = number;
        }
        let numbers = |count| newest(&kept, count).iter().map(|i| i.header.sequence);
        assert!(numbers(None).eq([1, 2, 3]));
        assert!(numbers(Some(2)).eq([2, 3]));
        assert!(numbers(Some(9)).eq([1, 2, 3]));
    }
}
