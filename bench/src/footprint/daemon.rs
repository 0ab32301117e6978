//! Resources of one daemon from start to end: start-up times, then usage idle and tracking.

use std::collections::BTreeMap;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use cdcr_client::{Connection, monotonic_ns};
use cdcr_shared_types::codes::realtime;
use serde_json::{Value, json};

use crate::interrupt;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::service_manager::ManagedStart;
use crate::subject::tracking::Tracking;
use crate::subject::{ROBOT, TIMEOUT};
use crate::system::cores::Cores;
use crate::system::counts::{core_share, files, page_faults, status, threads};

pub(super) const MB: f64 = 1e6;
/// What the kernel reports of the memory of a process, in units of 1024 bytes (proc(5)).
const MEMORY: [&str; 6] = ["VmRSS", "VmHWM", "RssAnon", "RssShmem", "RssFile", "VmLck"];
const SETTLE: Duration = Duration::from_millis(500);
const LOOK_EVERY: Duration = Duration::from_millis(1);
const CORE_THREADS: [&str; 2] = ["cdcr-cycle", "cdcr-exchange"];

pub(super) fn start_times(launch: &Launch, cores: &Cores) -> Result<Value> {
    let (daemon, start) = ManagedStart::begin(launch, cores)?;
    let begin_ns = start.begin_ns;
    let deadline = Instant::now() + TIMEOUT;
    let connection = loop {
        interrupt::check()?;
        match Connection::open(daemon.place.location(), ROBOT) {
            Err(_) if Instant::now() < deadline => thread::sleep(LOOK_EVERY),
            connected => break connected.with_context(|| late(&daemon, "status"))?,
        }
    };
    let record = connection.telemetry()?.next_within(TIMEOUT)?;
    let record_ns = monotonic_ns();
    record.with_context(|| late(&daemon, "record"))?;
    let ready_ns = ready_ns(&daemon, start)?;
    let status = connection.status(TIMEOUT)?;
    drop(connection);
    daemon.stop()?;
    let since_ms = |time_ns: u64| time_ns.saturating_sub(begin_ns) as f64 * 1e-6;
    Ok(json!({
        "first_release_ms": since_ms(status.origin_ns + status.period_ns),
        // To the message to a service manager after the first good cycle (`READY=1`).
        "ready_ms": since_ms(ready_ns),
        // To the receipt of the first record by a client that polls every millisecond.
        "first_record_ms": since_ms(record_ns),
    }))
}

fn ready_ns(daemon: &Daemon, start: ManagedStart) -> Result<u64> {
    start.ready_ns()?.with_context(|| late(daemon, "READY=1"))
}

fn late(daemon: &Daemon, missing: &str) -> String {
    let words = daemon.process.output_tail();
    format!("the daemon does not start: no {missing} within {TIMEOUT:?}{words}")
}

/// Durations without a client, and with tracking.
type Durations = [Duration; 2];

pub(super) fn usage(launch: &Launch, cores: &Cores, durations: Durations) -> Result<Value> {
    let (daemon, start) = ManagedStart::begin(launch, cores)?;
    ready_ns(&daemon, start)?;
    let measured = measure(&daemon, cores, durations);
    daemon.stop().and(measured)
}

fn measure(daemon: &Daemon, cores: &Cores, [idle, tracking]: Durations) -> Result<Value> {
    let memory = || {
        let kib = status(daemon.process.id(), MEMORY)?;
        anyhow::Ok(kib.map(|kib| kib as f64 * 1024.0 / MB))
    };
    let [start_mb, ..] = memory()?;
    interrupt::sleep(SETTLE)?;
    let idle = watch(daemon, idle)?;
    let [before_client_mb, ..] = memory()?;

    let client = Tracking::start(daemon.place.location(), cores.client())?;
    interrupt::sleep(SETTLE)?;
    let ([before_mb, ..], faults_before) = (memory()?, page_faults(daemon.process.id())?);
    let tracking = watch(daemon, tracking)?;
    let [resident_mb, peak_mb, own_mb, shared_mb, file_mb, locked_mb] = memory()?;
    let faults = page_faults(daemon.process.id())? - faults_before;
    // Includes the files of the tracking client.
    let (memory_files, stored_bytes) = files(&daemon.place.memory_files());
    let (root_files, _) = files(&[daemon.place.location().root().to_owned()]);
    let missing = daemon.connect()?.status(TIMEOUT)?.realtime_missing;
    client.stop()?;

    let core = |shares: &Shares| sum(CORE_THREADS.iter().filter_map(|name| shares.get(*name)));
    let all = |shares: &Shares| sum(shares.values());
    let mut threads = json!({});
    for (name, percent) in &tracking {
        let idle_percent = idle.get(name).unwrap_or(&0.0);
        threads[name] = json!({ "idle_percent": idle_percent, "tracking_percent": percent });
    }
    // A daemon with real time switched off does not request locked memory.
    let is_locked = missing & (realtime::LOCKED | realtime::OFF) == 0;
    Ok(json!({
        "core_tracking_percent": core(&tracking),
        "resident_mb": resident_mb,
        "growth_kb": 1e3 * (resident_mb - before_mb),
        "page_faults": faults as f64,
        "resident_start_mb": start_mb,
        "growth_idle_kb": 1e3 * (before_client_mb - start_mb),
        "growth_by_client_kb": 1e3 * (before_mb - before_client_mb),
        "locked": f64::from(is_locked),
        "core_idle_percent": core(&idle),
        "all_tracking_percent": all(&tracking),
        "all_idle_percent": all(&idle),
        "peak_mb": peak_mb,
        "own_mb": own_mb,
        "shared_mb": shared_mb,
        "file_mb": file_mb,
        "locked_mb": locked_mb,
        "memory_files": memory_files as f64,
        "memory_stored_mb": stored_bytes as f64 / MB,
        "root_files": root_files as f64,
        "threads": threads,
    }))
}

type Shares = BTreeMap<String, f64>;

/// `None` where the kernel does not count the time of threads.
fn sum<'a>(percents: impl Iterator<Item = &'a f64>) -> Option<f64> {
    percents.copied().reduce(|sum, percent| sum + percent)
}

fn watch(daemon: &Daemon, length: Duration) -> Result<Shares> {
    let (before, begin) = (threads(daemon.process.id()), Instant::now());
    interrupt::sleep(length)?;
    let (after, passed) = (threads(daemon.process.id()), begin.elapsed());
    let percent = |name: &str| 100.0 * core_share(&before, &after, name, passed);
    let names = after.iter().map(|thread| thread.name.clone());
    Ok(names.map(|name| (name.clone(), percent(&name))).collect())
}
