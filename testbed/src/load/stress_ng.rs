//! The common load generator stress-ng.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result, bail};

use super::Done;
use super::task::Signals;
use crate::system::cores::Cores;
use cdcr_process::{Process, folder, on_path, that_ends_with_us};

/// Interval between checks for the end of the load.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

pub(super) fn program() -> Result<PathBuf> {
    on_path("stress-ng").context(
        "stress-ng is not installed; on Debian and Ubuntu: sudo apt install stress-ng, on Fedora: \
         sudo dnf install stress-ng",
    )
}

/// Runs stress-ng until the load ends. It inherits the calling thread's affinity, which excludes the
/// real-time core, and ends with that thread.
pub(super) fn run(cores: &Cores, signals: &Signals) -> Result<Done> {
    cores.stay_off();
    let folder = folder()?;
    let counts = folder.path().join("counts.yaml");
    let command = command(cores, folder.path(), &counts)?;
    let mut process = Process::start_in(folder, "stress-ng", command)?;
    signals.works();
    while !signals.is_ending() {
        if process.has_ended()? {
            bail!("it ended by itself{}", process.output_tail());
        }
        thread::sleep(POLL_INTERVAL);
    }
    process.end()?;
    let counts = fs::read_to_string(&counts).context("the counts of stress-ng")?;
    Ok(Done {
        stress_operations: operations_in(&counts),
        ..Done::default()
    })
}

fn command(cores: &Cores, folder: &Path, counts: &Path) -> Result<Command> {
    let numbers: Vec<String> = cores.others.iter().map(usize::to_string).collect();
    let mut command = that_ends_with_us(&program()?);
    command
        .args([
            "--cpu",
            &numbers.len().to_string(),
            "--taskset",
            &numbers.join(","),
        ])
        .args([
            "--vm",
            "1",
            "--vm-bytes",
            "128M",
            "--io",
            "1",
            "--timeout",
            "0",
        ])
        .arg("--metrics-brief")
        .arg("--temp-path")
        .arg(folder)
        .arg("--yaml")
        .arg(counts)
        .current_dir(folder);
    Ok(command)
}

/// Sum of the lines `bogo-ops: 1234`, one for each kind of stress.
fn operations_in(yaml: &str) -> u64 {
    let lines = yaml
        .lines()
        .filter_map(|line| line.trim().strip_prefix("bogo-ops:"));
    lines
        .filter_map(|count| count.trim().parse::<u64>().ok())
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_operations_of_all_kinds_are_added() {
        let yaml = "metrics:\n    - stressor: cpu\n      bogo-ops: 1180\n      \
                    bogo-ops-per-second-real-time: 588.8\n    - stressor: vm\n      bogo-ops: 20\n";
        assert_eq!(operations_in(yaml), 1200);
    }
}
