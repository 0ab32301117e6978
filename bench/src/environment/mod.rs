//! The machine that a result comes from: without it no figure can be judged, or compared with another's.
//!
//! Invariant: nothing here names the machine, its user or a folder of it.

mod commit;
mod kernel;
mod options;
mod processor;
mod system;

use std::time::SystemTime;

use anyhow::Result;
use serde::{Deserialize, Serialize};

pub use kernel::Kernel;
pub use options::Options;
pub use processor::Processor;

use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use crate::table::Table;
use system::System;

/// Capability `CAP_IPC_LOCK`, its bit in `CapEff` (capabilities(7)).
const CAP_IPC_LOCK: u32 = 14;

/// The machine at the start of a run. What it does not tell is empty.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Environment {
    /// When the run began, in UTC, like `2026-11-21T12:00:00Z`.
    pub started_utc: String,
    pub cdcr_version: String,
    /// Commit of the working copy in the current folder, when that is ours; `+` for changes beside it.
    pub commit: Option<String>,
    /// Built without optimisation: times of such a program say nothing.
    pub debug_build: bool,
    pub processor: Processor,
    /// Whether a hypervisor may halt the cores at any time, as the processor tells; none where it does not.
    pub virtual_machine: Option<bool>,
    /// Which one, when it can be read.
    pub hypervisor: Option<String>,
    pub kernel: Kernel,
    pub memory_mb: Option<u64>,
    /// Load average of the last minute before the start; 1 is one busy core.
    pub load_average: Option<f64>,
    pub privileges: Privileges,
    pub cores: UsedCores,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Privileges {
    /// It may have real-time threads (`SCHED_FIFO`).
    pub realtime: bool,
    /// It may lock as much memory as it likes.
    pub lock_memory: bool,
}

/// Which cores were used for what.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct UsedCores {
    /// The core of the daemon's real-time threads.
    pub realtime: usize,
    pub others: Vec<usize>,
}

impl Environment {
    /// This machine now. To be asked before any thread of this process is pinned.
    pub fn find() -> Result<Self> {
        let cores = Cores::find()?;
        let used = UsedCores {
            realtime: cores.realtime,
            others: cores.others,
        };
        let privileges = Privileges {
            realtime: may_be_realtime(),
            lock_memory: may_lock(&System::real()),
        };
        Ok(Self {
            commit: commit::find(),
            ..Self::of(&System::real(), used, privileges)
        })
    }

    fn of(system: &System, cores: UsedCores, privileges: Privileges) -> Self {
        let processor = Processor::of(system, cores.realtime);
        Self {
            started_utc: utc(SystemTime::now()),
            cdcr_version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: None,
            debug_build: cfg!(debug_assertions),
            virtual_machine: processor::is_virtual(system),
            hypervisor: processor::hypervisor(system),
            processor,
            kernel: Kernel::of(system),
            memory_mb: memory_mb(system),
            load_average: load_average(system),
            privileges,
            cores,
        }
    }

    pub fn table(&self) -> Table {
        let rows = [
            ("started", self.started_utc.clone()),
            ("cdcr", self.version()),
            ("processor", self.processor.words()),
            ("virtual machine", self.virtual_words()),
            ("kernel", self.kernel.words()),
            ("core isolation", self.kernel.isolation_words()),
            (
                "memory",
                told(
                    self.memory_mb
                        .map(|mb| format!("{:.1} GB", mb as f64 * 1e-3)),
                ),
            ),
            ("clock source", told(self.kernel.clock_source.clone())),
            ("governor", told(self.processor.governor.clone())),
            (
                "transparent huge pages",
                told(self.kernel.huge_pages.clone()),
            ),
            ("RT throttling", self.kernel.throttling_words()),
            (
                "load average at the start",
                told(self.load_average.map(|load| load.to_string())),
            ),
            ("SCHED_FIFO", granted(self.privileges.realtime)),
            ("locked memory", granted(self.privileges.lock_memory)),
            ("cores", self.cores_words()),
        ];
        let rows = rows
            .into_iter()
            .map(|(what, value)| vec![what.to_owned(), value])
            .collect();
        Table::new("The machine", &["property", "value"], 2, rows)
    }

    /// What a figure needs beside it at least: processor, kernel, right to real time.
    pub fn line(&self) -> String {
        let realtime = granted(self.privileges.realtime);
        format!(
            "Measured on {}, kernel {}, real time {realtime}.",
            self.processor.model, self.kernel.release
        )
    }

    fn version(&self) -> String {
        let mut words = self.cdcr_version.clone();
        if let Some(commit) = &self.commit {
            words = format!("{words} ({commit})");
        }
        if self.debug_build {
            words += ", built without optimisation: its times say nothing";
        }
        words
    }

    pub(crate) fn virtual_words(&self) -> String {
        match (self.virtual_machine, &self.hypervisor) {
            (None, _) => told(None),
            (Some(false), _) => "no".to_owned(),
            (Some(true), None) => "yes".to_owned(),
            (Some(true), Some(name)) => format!("yes ({name})"),
        }
    }

    fn cores_words(&self) -> String {
        let others: Vec<String> = self.cores.others.iter().map(usize::to_string).collect();
        let realtime = self.cores.realtime;
        format!(
            "{realtime} for the loop, {} for clients and load",
            others.join(", ")
        )
    }
}

pub(crate) fn told(value: Option<String>) -> String {
    value.unwrap_or_else(|| "not told".to_owned())
}

pub(crate) fn granted(is_granted: bool) -> String {
    if is_granted { "granted" } else { "refused" }.to_owned()
}

pub fn utc(time: SystemTime) -> String {
    humantime::format_rfc3339_seconds(time).to_string()
}

fn memory_mb(system: &System) -> Option<u64> {
    let kib: u64 = system
        .field("/proc/meminfo", "MemTotal")?
        .split_ascii_whitespace()
        .next()?
        .parse()
        .ok()?;
    Some(kib * 1024 / 1_000_000)
}

fn load_average(system: &System) -> Option<f64> {
    let text = system.read("/proc/loadavg")?;
    text.split_ascii_whitespace().next()?.parse().ok()
}

/// As the capability and the limit of the process say.
fn may_lock(system: &System) -> bool {
    use rustix::process::{Resource, getrlimit};
    let capabilities = system.field("/proc/self/status", "CapEff");
    let bits = capabilities.and_then(|hex| u64::from_str_radix(&hex, 16).ok());
    bits.is_some_and(|bits| bits >> CAP_IPC_LOCK & 1 == 1)
        || getrlimit(Resource::Memlock).current.is_none()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn times_are_utc_and_of_whole_seconds() {
        let time = SystemTime::UNIX_EPOCH + Duration::from_millis(1_000_000_000_900);
        assert_eq!(utc(time), "2001-09-09T01:46:40Z");
    }

    #[test]
    fn a_machine_that_tells_nothing_is_described_all_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let cores = UsedCores {
            realtime: 1,
            others: vec![0],
        };
        let nothing = Environment::of(&System::below(folder.path()), cores, Privileges::default());
        assert_eq!(nothing.memory_mb, None);
        assert_eq!(nothing.virtual_machine, None);
        assert!(nothing.line().ends_with("real time refused."));
        let text = nothing.table().text();
        assert!(
            text.contains("not told") && text.contains("refused"),
            "{text}"
        );
        assert!(
            text.contains("1 for the loop, 0 for clients and load"),
            "{text}"
        );
    }

    #[test]
    fn a_machine_that_tells_is_understood() {
        let files = [
            (
                "proc/meminfo",
                "MemTotal:        8000000 kB\nMemFree: 1 kB\n",
            ),
            ("proc/loadavg", "0.50 0.61 1.10 1/100 4711\n"),
            ("proc/self/status", "Name:\tx\nCapEff:\t0000000000004000\n"),
        ];
        let folder = system::fake(&files);
        let system = System::below(folder.path());
        assert_eq!(memory_mb(&system), Some(8192));
        assert_eq!(load_average(&system), Some(0.5));
        assert!(may_lock(&system));
    }

    #[test]
    fn what_was_written_is_read_again_and_older_files_too() {
        let here = Environment::find().expect("a machine");
        let json = serde_json::to_string(&here).expect("JSON");
        let again: Environment = serde_json::from_str(&json).expect("the same");
        assert_eq!(again, here);
        assert_eq!(here.cdcr_version, env!("CARGO_PKG_VERSION"));
        let older: Environment = serde_json::from_str("{\"kernel\":{}}").expect("few keys");
        assert_eq!(older, Environment::default());
    }

    #[test]
    fn it_names_neither_the_machine_nor_a_folder() {
        let json = serde_json::to_string(&Environment::find().expect("a machine")).expect("JSON");
        let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        // A host that is called like a word of the description cannot be told from it.
        if host.trim().len() > 4 {
            assert!(!json.contains(host.trim()), "{json}");
        }
        let here = std::env::current_dir().expect("a folder");
        assert!(!json.contains(&*here.to_string_lossy()), "{json}");
    }
}
