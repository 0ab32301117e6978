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
use serde_json::{Map, Value, json};

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
    "hypervisor",
    "kernel clock source",
    "kernel isolation",
    "kernel release",
    "privileges lock memory",
    "privileges realtime",
    "processor cores",
    "processor governor",
    "processor model",
    "virtual machine",
];

/// The machine at the start of a run. What it does not tell is null.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Environment(Map<String, Value>);

impl Environment {
    /// This machine now. To be asked before any thread of this process is pinned.
    pub fn find() -> Result<Self> {
        let mut found = Self::of(&System::real(), &Cores::find()?, may_be_realtime());
        found.0.insert("commit".to_owned(), json!(commit()));
        Ok(found)
    }

    fn of(system: &System, cores: &Cores, realtime: bool) -> Self {
        let all = json!({
            // When the run began, in UTC, like `2026-11-21T12:00:00Z`.
            "started_utc": utc(SystemTime::now()),
            "cdcr_version": env!("CARGO_PKG_VERSION"),
            // Commit of the working copy in the current folder, when that is ours; `+` for changes beside it.
            "commit": null,
            // Built without optimisation: times of such a program say nothing.
            "debug_build": cfg!(debug_assertions),
            // As it is seen from the core that is measured.
            "processor": system.processor(cores.realtime),
            // Whether a hypervisor may halt the cores at any time, as the processor tells.
            "virtual_machine": system.is_virtual(),
            "hypervisor": system.hypervisor(),
            "kernel": system.kernel(),
            "memory_mb": memory_mb(system),
            // Of the last minute before the start; 1 is one busy core.
            "load_average": load_average(system),
            // Threads with SCHED_FIFO, and as much locked memory as it likes.
            "privileges": { "realtime": realtime, "lock_memory": may_lock(system) },
            "cores": { "realtime": cores.realtime, "others": cores.others },
        });
        Self(all.as_object().cloned().unwrap_or_default())
    }

    pub fn is_realtime(&self) -> bool {
        self.value("privileges realtime") == true
    }

    fn value(&self, property: &str) -> Value {
        let mut properties = self.properties();
        let found = properties.find(|(name, _)| name == property);
        found.map_or(Value::Null, |(_, value)| value)
    }

    /// A property that is a text, or nothing.
    fn text(&self, property: &str) -> String {
        self.value(property).as_str().unwrap_or_default().to_owned()
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

    /// What differs between two machines and moves absolute times. An older file may lack a property.
    pub(crate) fn differing(&self, other: &Self) -> Vec<(&'static str, Value, Value)> {
        let empty = [json!(null), json!(""), json!(false), json!(0), json!([])];
        let both = MOVING.map(|name| (name, self.value(name), other.value(name)));
        let is_differing = |(_, old, new): &(_, Value, Value)| {
            old != new && !(empty.contains(old) && empty.contains(new))
        };
        both.into_iter().filter(is_differing).collect()
    }

    /// What a figure needs beside it at least: processor, kernel, right to real time.
    pub fn line(&self) -> String {
        let realtime = if self.is_realtime() {
            "granted"
        } else {
            "refused"
        };
        let [model, release] = ["processor model", "kernel release"].map(|name| self.text(name));
        format!("Measured on {model}, kernel {release}, real time {realtime}.")
    }

    pub(crate) fn run(&self) -> String {
        let [version, commit, started, model, release] = [
            "cdcr version",
            "commit",
            "started utc",
            "processor model",
            "kernel release",
        ]
        .map(|name| self.text(name));
        let commit = if commit.is_empty() {
            commit
        } else {
            format!(" ({commit})")
        };
        format!("cdcr {version}{commit}, {started}, {model}, kernel {release}")
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
    use system::fake;

    #[test]
    fn a_machine_that_tells_nothing_is_described_all_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let cores = Cores::find().expect("cores");
        let nothing = Environment::of(&System::below(folder.path()), &cores, false);
        assert!(
            ["memory mb", "virtual machine"]
                .iter()
                .all(|name| nothing.value(name).is_null())
        );
        assert!(nothing.line().ends_with("real time refused."));
        let text = nothing.table().text();
        assert!(
            text.contains("privileges realtime") && text.contains("cores others"),
            "{text}"
        );
    }

    #[test]
    fn a_machine_that_tells_is_understood() {
        let folder = fake(&[
            (
                "proc/meminfo",
                "MemTotal:        8000000 kB\nMemFree: 1 kB\n",
            ),
            ("proc/loadavg", "0.50 0.61 1.10 1/100 4711\n"),
            ("proc/self/status", "Name:\tx\nCapEff:\t0000000000004000\n"),
            ("proc/sys/kernel/osrelease", "6.12.0\n"),
            ("proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC @0\n"),
            ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
            (
                "proc/cmdline",
                "root=/dev/sda1 isolcpus=1 quiet rcu_nocbs=1\n",
            ),
            ("sys/kernel/debug/sched/preempt", "none voluntary (full)\n"),
            (
                "sys/kernel/mm/transparent_hugepage/enabled",
                "always [madvise] never\n",
            ),
            (
                "proc/cpuinfo",
                "processor : 0\nvendor_id\t: Maker\nmodel name\t: Quick 9\ncpu MHz\t: 2500.5\nflags\t: fpu hypervisor\n",
            ),
            ("sys/devices/system/cpu/online", "0-3,5\n"),
            ("sys/devices/system/cpu/cpu2/cache/index0/level", "1\n"),
            ("sys/devices/system/cpu/cpu2/cache/index0/type", "Data\n"),
            ("sys/devices/system/cpu/cpu2/cache/index0/size", "32K\n"),
            ("sys/class/dmi/id/sys_vendor", "Cloud\n"),
            ("sys/class/dmi/id/product_name", "large\n"),
        ]);
        let mut cores = Cores::find().expect("cores");
        cores.realtime = 2;
        let found = Environment::of(&System::below(folder.path()), &cores, true);
        for (property, value) in [
            ("memory mb", json!(8192)),
            ("load average", json!(0.5)),
            ("privileges lock memory", json!(true)),
            ("kernel release", json!("6.12.0")),
            ("kernel preemption", json!("PREEMPT_DYNAMIC (full)")),
            // Nothing else of the command line.
            ("kernel isolation", json!(["isolcpus=1", "rcu_nocbs=1"])),
            ("kernel rt runtime us", json!(950_000)),
            ("kernel huge pages", json!("madvise")),
            ("processor model", json!("Quick 9")),
            ("processor cores", json!(5)),
            ("processor caches", json!(["L1 Data 32K"])),
            ("processor frequency mhz", json!(2500.5)),
            ("virtual machine", json!(true)),
            ("hypervisor", json!("Cloud large")),
        ] {
            assert_eq!(found.value(property), value, "{property}");
        }
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
        assert!(older.differing(&Environment::default()).is_empty());
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
