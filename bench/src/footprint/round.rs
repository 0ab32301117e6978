//! One daemon from its start to its end: what it takes, idle and tracking.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use cdcr_shared_types::codes::realtime;
use serde_json::{Value, json};

use super::start;
use crate::dataset::joined;
use crate::interrupt;
use crate::subject::TIMEOUT;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::tracking::Tracking;
use crate::system::cores::Cores;
use crate::system::counts::{core_share, threads};

pub(super) const MB: f64 = 1e6;
/// Between a change and what is measured after it.
const SETTLE: Duration = Duration::from_millis(500);
/// Those of the real-time core.
const CORE_THREADS: [&str; 2] = ["cdcr-cycle", "cdcr-exchange"];

/// Starts one daemon for the times of its start, and one that no client disturbs to measure it for so long, idle and
/// tracking. What was measured, under the keys of the quantities.
pub(super) fn round(
    launch: &Launch,
    cores: &Cores,
    idle: Duration,
    tracking: Duration,
) -> Result<Value> {
    let times = start::times(launch, cores)?;
    let daemon = start::without_client(launch, cores)?;
    let measured = measure(&daemon, cores, idle, tracking);
    Ok(joined([times, daemon.stop().and(measured)?]))
}

fn measure(daemon: &Daemon, cores: &Cores, idle: Duration, tracking: Duration) -> Result<Value> {
    let after_start = Memory::of(daemon.id())?;
    interrupt::sleep(SETTLE)?;
    let idle = watch(daemon, idle)?;
    let before_client = Memory::of(daemon.id())?;

    let client = Tracking::start(daemon.location(), cores.client())?;
    interrupt::sleep(SETTLE)?;
    let before_tracking = Memory::of(daemon.id())?;
    let tracking = watch(daemon, tracking)?;
    let after_tracking = Memory::of(daemon.id())?;
    // Those of the tracking client are among them.
    let (memory_files, stored_bytes) = files(&daemon.place().memory_files());
    let (root_files, _) = files(&[daemon.location().root().to_owned()]);
    let status = daemon.connect()?.status(TIMEOUT)?;
    client.stop()?;

    let growth_kb =
        |from: &Memory, to: &Memory| anyhow::Ok(1e3 * (to.mb("VmRSS")? - from.mb("VmRSS")?));
    // Not a number where the kernel does not count what threads use.
    let sum = |shares: &BTreeMap<String, f64>, names: &[&str]| {
        let of_name =
            |(name, _): &(&String, &f64)| names.is_empty() || names.contains(&name.as_str());
        let all = shares.iter().filter(of_name).map(|(_, percent)| percent);
        all.copied().reduce(|sum, percent| sum + percent)
    };
    let thread = |(name, percent): (&String, &f64)| {
        let idle_percent = idle.get(name).unwrap_or(&0.0);
        (
            name.clone(),
            json!({ "idle_percent": idle_percent, "tracking_percent": percent }),
        )
    };
    // Switched off, it is not asked for either.
    let is_locked = status.realtime_missing & (realtime::LOCKED | realtime::OFF) == 0;
    Ok(json!({
        "core_tracking_percent": sum(&tracking, &CORE_THREADS),
        "resident_mb": after_tracking.mb("VmRSS")?,
        "growth_kb": growth_kb(&before_tracking, &after_tracking)?,
        "page_faults": (after_tracking.page_faults - before_tracking.page_faults) as f64,
        "resident_start_mb": after_start.mb("VmRSS")?,
        "growth_idle_kb": growth_kb(&after_start, &before_client)?,
        "growth_by_client_kb": growth_kb(&before_client, &before_tracking)?,
        "locked": f64::from(is_locked),
        "core_idle_percent": sum(&idle, &CORE_THREADS),
        "all_tracking_percent": sum(&tracking, &[]),
        "all_idle_percent": sum(&idle, &[]),
        "peak_mb": after_tracking.mb("VmHWM")?,
        "own_mb": after_tracking.mb("RssAnon")?,
        "shared_mb": after_tracking.mb("RssShmem")?,
        "file_mb": after_tracking.mb("RssFile")?,
        "locked_mb": after_tracking.mb("VmLck")?,
        "memory_files": memory_files as f64,
        "memory_stored_mb": stored_bytes as f64 / MB,
        "root_files": root_files as f64,
        "threads": tracking.iter().map(thread).collect::<BTreeMap<_, _>>(),
    }))
}

/// Share of a core that each thread uses in the time to come \[%\]. Threads of one name are added up.
fn watch(daemon: &Daemon, length: Duration) -> Result<BTreeMap<String, f64>> {
    let (before, begin) = (threads(daemon.id()), Instant::now());
    interrupt::sleep(length)?;
    let (after, passed) = (threads(daemon.id()), begin.elapsed());
    let percent = |name: &str| 100.0 * core_share(&before, &after, name, passed);
    let all = after
        .iter()
        .map(|thread| (thread.name.clone(), percent(&thread.name)));
    Ok(all.collect())
}

struct Memory {
    /// `/proc/PID/status`. `VmLck` is counted by address range: more than what is resident.
    status: String,
    /// Since its start.
    page_faults: u64,
}

impl Memory {
    fn of(process: u32) -> Result<Self> {
        let read = |name: &str| {
            let file = format!("/proc/{process}/{name}");
            fs::read_to_string(&file).with_context(|| format!("cannot read {file}"))
        };
        Ok(Self {
            status: read("status")?,
            page_faults: faults_in(&read("stat")?).context("/proc/PID/stat has no faults")?,
        })
    }

    fn mb(&self, key: &str) -> Result<f64> {
        let bytes = bytes_in(&self.status, key);
        let bytes = bytes.with_context(|| format!("/proc/PID/status has no {key}"))?;
        Ok(bytes as f64 / MB)
    }
}

/// A value of `/proc/PID/status`, which the kernel gives in units of 1024 bytes (proc(5)).
fn bytes_in(status: &str, key: &str) -> Option<u64> {
    let mut lines = status.lines();
    let value = lines.find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
    let kilobytes: u64 = value.split_ascii_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024)
}

/// The 10th and 12th number of `/proc/PID/stat`, minor and major. The 2nd is a name in brackets that may hold anything.
fn faults_in(stat: &str) -> Option<u64> {
    let behind_name = &stat[stat.rfind(')')? + 1..];
    let mut numbers = behind_name.split_ascii_whitespace().skip(7).step_by(2);
    let mut next = || numbers.next()?.parse::<u64>().ok();
    Some(next()? + next()?)
}

/// How many files these are, folders searched, and what is really there of them \[bytes\]: pages that nobody touched
/// take nothing.
fn files(paths: &[PathBuf]) -> (u64, u64) {
    use std::os::unix::fs::MetadataExt;
    let within = |path: &Path| {
        fs::read_dir(path)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path())
    };
    let of = |path: &PathBuf| match fs::symlink_metadata(path) {
        Ok(metadata) if metadata.is_dir() => files(&within(path).collect::<Vec<_>>()),
        Ok(metadata) => (1, metadata.blocks() * 512),
        Err(_) => (0, 0),
    };
    let all = paths.iter().map(of);
    all.fold((0, 0), |(files, bytes), (more, their)| {
        (files + more, bytes + their)
    })
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    #[test]
    fn memory_is_read_as_proc_says() {
        let ours = Memory::of(std::process::id()).unwrap();
        let mb = |key| ours.mb(key).unwrap();
        let parts_mb = mb("RssAnon") + mb("RssFile") + mb("RssShmem");
        assert!(mb("VmRSS") > 0.0 && (mb("VmRSS") - parts_mb).abs() < 1e-9);
        assert!(mb("VmHWM") > 0.0 && ours.page_faults > 0);
        let status = "Name:\ta\nVmHWM:\t   20 kB\nVmRSS:\t   10 kB\nRssAnon:\t 0 kB\n";
        assert_eq!(bytes_in(status, "VmRSS"), Some(10_240));
        assert_eq!(bytes_in(status, "Vm"), None);
        assert_eq!(faults_in("7 (a ) b) S 1 2 3 4 5 6 70 8 90 10"), Some(160));
        assert_eq!(faults_in("7 (a"), None);
    }

    #[test]
    fn files_below_a_folder_are_counted() {
        let folder = Scratch::temporary().unwrap();
        fs::create_dir(folder.path().join("inner")).unwrap();
        fs::write(folder.path().join("a"), [1; 10]).unwrap();
        fs::write(folder.path().join("inner/b"), [1; 5]).unwrap();
        let gone = folder.path().join("none");
        assert_eq!(files(&[folder.path().to_owned(), gone]).0, 2);
    }
}
