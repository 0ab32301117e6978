//! The bare loop: the daemon's cycle thread without any work, as a separate process.

use std::process::Command;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use cdcr_shared_types::codes::LateCause;
use serde::Deserialize;

use super::Cycle;
use super::daemon::Launch;
use crate::interrupt;
use crate::system::cores::Cores;
use cdcr_process::Process;

/// Allowance for start, end and a slow machine, beyond the duration.
const TIMEOUT: Duration = Duration::from_secs(30);

/// A running bare loop. Dropping it ends the process.
#[derive(Debug)]
pub struct Baseline {
    process: Process,
    duration: Duration,
}

impl Baseline {
    /// Starts `cdcrd bare` with this configuration.
    pub fn start(launch: &Launch, cores: &Cores, duration: Duration) -> Result<Self> {
        let command = command(launch, duration)?;
        let process = cores.with_all(|| Process::start("cdcrd bare", command))?;
        Ok(Self { process, duration })
    }

    pub fn wait(mut self) -> Result<Vec<Cycle>> {
        let cycles = cycles(
            &self
                .process
                .wait(2 * self.duration + TIMEOUT, interrupt::check)?,
        )?;
        let words = || self.process.output_tail();
        ensure!(
            !cycles.is_empty(),
            "cdcrd bare reported no cycle{}",
            words()
        );
        Ok(cycles)
    }
}

fn command(launch: &Launch, duration: Duration) -> Result<Command> {
    let mut command = launch.command_that_ends_with_us("bare")?;
    let duration = format!("{}us", duration.as_micros());
    command.args(["--format", "csv", "--duration", &duration]);
    Ok(command)
}

/// The columns used from a line of `cdcrd bare --format csv`.
#[derive(Deserialize)]
struct BaselineRow {
    due_ns: u64,
    start_ns: u64,
    handed_over_ns: u64,
    skipped_periods: u32,
    late_start: u8,
    deadline_miss: u8,
    /// Empty where the kernel does not count it.
    run_delay_ns: Option<u64>,
    cause: u32,
}

fn cycles(csv: &str) -> Result<Vec<Cycle>> {
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    let rows = reader.deserialize().map(|row| cycle(&row?));
    rows.collect::<Result<_>>()
        .context("cdcrd bare --format csv: is cdcrd of the same version as this program?")
}

fn cycle(row: &BaselineRow) -> Result<Cycle> {
    Ok(Cycle {
        due_ns: row.due_ns,
        wake_ns: row.start_ns.saturating_sub(row.due_ns),
        response_ns: row.handed_over_ns.saturating_sub(row.due_ns),
        late_start: row.late_start != 0,
        deadline_miss: row.deadline_miss != 0,
        skipped_periods: row.skipped_periods,
        cause: LateCause::try_from(row.cause)?,
        run_delay_ns: row.run_delay_ns.unwrap_or(0),
    })
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::BARE_COLUMNS;

    use super::*;

    #[test]
    fn times_are_counted_from_their_release() {
        let rows = "3,200,310,350,1,1,0,70,2,2\n4,400,410,415,0,0,0,,,0\n";
        let first = Cycle {
            due_ns: 200,
            wake_ns: 110,
            response_ns: 150,
            late_start: true,
            deadline_miss: false,
            skipped_periods: 1,
            cause: LateCause::Load,
            run_delay_ns: 70,
        };
        let second = Cycle {
            due_ns: 400,
            wake_ns: 10,
            response_ns: 15,
            late_start: false,
            skipped_periods: 0,
            cause: LateCause::None,
            run_delay_ns: 0,
            ..first
        };
        assert_eq!(
            cycles(&format!("{BARE_COLUMNS}\n{rows}")).unwrap(),
            [first, second]
        );
    }

    #[test]
    fn what_another_version_writes_is_refused() {
        let unknown_cause = format!("{BARE_COLUMNS}\n3,200,310,350,1,1,0,70,2,99\n");
        for text in ["due_ns,start_ns\n1,2\n", &unknown_cause] {
            let error = format!("{:#}", cycles(text).unwrap_err());
            assert!(error.contains("same version"), "{error}");
        }
    }
}
