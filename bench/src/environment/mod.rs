//! The machine that a result comes from: without it no figure can be judged, or compared with another's.
//!
//! Invariant: nothing here names the machine, its user or a folder of it.

mod options;
mod system;

use std::path::Path;
use std::process::Command;
use std::time::SystemTime;

use anyhow::Result;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

pub use options::RunOptions;

use crate::dataset::{Sheet, flat, word};
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use system::System;

/// Capability `CAP_IPC_LOCK`, its bit in `CapEff` (capabilities(7)).
const CAP_IPC_LOCK: u32 = 14;
/// Properties of the machine that move absolute times.
const MOVING: [&str; 11] = [
    "debug build",
    "processor model",
    "processor cores",
    "processor governor",
    "virtual machine",
    "hypervisor",
    "kernel release",
    "kernel isolation",
    "kernel clock source",
    "privileges realtime",
    "privileges lock memory",
];

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

#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct UsedCores {
    pub realtime: usize,
    pub others: Vec<usize>,
}

/// The processor, as it is seen from the core that is measured.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Processor {
    pub model: String,
    pub vendor: Option<String>,
    pub cores: usize,
    /// Caches of the core, like `L1 Data 32K`.
    pub caches: Vec<String>,
    pub frequency_mhz: Option<f64>,
    pub governor: Option<String>,
}

/// The kernel and what it was told that matters to a punctual loop.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Kernel {
    pub release: String,
    /// Version: number of the build and what it was built with.
    pub version: String,
    /// How it preempts: `PREEMPT_RT`, or the word of the version, with the mode where it can be chosen.
    pub preemption: Option<String>,
    /// `isolcpus`, `nohz_full` and `rcu_nocbs` of its command line; all else there is left out.
    pub isolation: Vec<String>,
    pub clock_source: Option<String>,
    /// Transparent huge pages: `always`, `madvise` or `never`.
    pub huge_pages: Option<String>,
    /// Time that real-time threads may have of each period \[µs\]; -1: all of it.
    pub rt_runtime_us: Option<i64>,
    pub rt_period_us: Option<i64>,
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
            commit: commit(),
            ..Self::of(&System::real(), used, privileges)
        })
    }

    fn of(system: &System, cores: UsedCores, privileges: Privileges) -> Self {
        let processor = system.processor(cores.realtime);
        Self {
            started_utc: utc(SystemTime::now()),
            cdcr_version: env!("CARGO_PKG_VERSION").to_owned(),
            commit: None,
            debug_build: cfg!(debug_assertions),
            virtual_machine: system.is_virtual(),
            hypervisor: system.hypervisor(),
            processor,
            kernel: system.kernel(),
            memory_mb: memory_mb(system),
            load_average: load_average(system),
            privileges,
            cores,
        }
    }

    /// Name and value of everything that is known of the machine.
    fn properties(&self) -> impl Iterator<Item = (String, Value)> {
        let values = flat(&json!(self)).into_iter();
        values.map(|(key, value)| (key.replace('_', " "), value))
    }

    pub fn table(&self) -> Sheet {
        let row = |(property, value)| json!({ "property": property, "value": value });
        let columns = [word("property", "property"), word("value", "value")];
        Sheet::of(
            "The machine",
            &columns,
            self.properties().map(row).collect(),
        )
    }

    /// What differs between two machines and moves absolute times.
    pub(crate) fn differing(&self, other: &Self) -> Vec<(String, Value, Value)> {
        let both = self.properties().zip(other.properties());
        let differing =
            both.filter(|((name, old), (_, new))| MOVING.contains(&&**name) && old != new);
        differing
            .map(|((name, old), (_, new))| (name, old, new))
            .collect()
    }

    /// What a figure needs beside it at least: processor, kernel, right to real time.
    pub fn line(&self) -> String {
        let realtime = if self.privileges.realtime {
            "granted"
        } else {
            "refused"
        };
        format!(
            "Measured on {}, kernel {}, real time {realtime}.",
            self.processor.model, self.kernel.release
        )
    }

    pub(crate) fn run(&self) -> String {
        let commit = self.commit.as_ref().map(|commit| format!(" ({commit})"));
        format!(
            "cdcr {}{}, {}, {}, kernel {}",
            self.cdcr_version,
            commit.unwrap_or_default(),
            self.started_utc,
            self.processor.model,
            self.kernel.release
        )
    }
}

fn utc(time: SystemTime) -> String {
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

/// The commit, with a `+` when files were changed since; none where there is no git or no working copy of
/// this project.
fn commit() -> Option<String> {
    let root = git(&["rev-parse", "--show-toplevel"])?;
    let manifest = std::fs::read_to_string(Path::new(&root).join("bench/Cargo.toml")).ok()?;
    if !manifest.contains("name = \"cdcr-bench\"") {
        return None;
    }
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    let changed = git(&["status", "--porcelain", "--untracked-files=no"])?;
    let mark = if changed.is_empty() { "" } else { "+" };
    Some(commit + mark)
}

/// What git says; none when it is not there or refuses.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git")
        // It only looks.
        .arg("--no-optional-locks")
        .args(arguments)
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_that_tells_nothing_is_described_all_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let cores = UsedCores {
            realtime: 1,
            others: vec![0],
        };
        let nothing = Environment::of(&System::below(folder.path()), cores, Privileges::default());
        assert_eq!((nothing.memory_mb, nothing.virtual_machine), (None, None));
        assert!(nothing.line().ends_with("real time refused."));
        let text = nothing.table().text();
        assert!(
            text.contains("privileges realtime") && text.contains("cores others"),
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
        assert!(here.differing(&again).is_empty());
        let names: Vec<String> = here.properties().map(|(name, _)| name).collect();
        assert!(
            MOVING
                .iter()
                .all(|name| names.iter().any(|known| known == name)),
            "{names:?}"
        );
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
