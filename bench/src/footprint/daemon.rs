//! Resources of one daemon from start to end: start-up times, then usage idle and tracking.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use cdcr_client::{Connection, monotonic_ns};
use cdcr_scratch::Scratch;
use cdcr_shared_types::codes::realtime;
use serde_json::{Value, json};

use crate::environment::{field, first_number};
use crate::interrupt;
use crate::subject::ROBOT;
use crate::subject::TIMEOUT;
use crate::subject::daemon::{Daemon, Launch};
use crate::subject::tracking::Tracking;
use crate::system::cores::Cores;
use crate::system::counts::{core_share, threads};

pub(super) const MB: f64 = 1e6;
const SETTLE: Duration = Duration::from_millis(500);
const LOOK_EVERY: Duration = Duration::from_millis(1);
const CORE_THREADS: [&str; 2] = ["cdcr-cycle", "cdcr-exchange"];

pub(super) fn start_times(launch: &Launch, cores: &Cores) -> Result<Value> {
    let (daemon, begin_ns, manager) = start(launch, cores)?;
    let deadline = Instant::now() + TIMEOUT;
    let connection = loop {
        interrupt::check()?;
        match Connection::open(daemon.location(), ROBOT) {
            Err(_) if Instant::now() < deadline => thread::sleep(LOOK_EVERY),
            connected => break connected.with_context(|| late(&daemon, "status"))?,
        }
    };
    let record = connection.telemetry()?.next_within(TIMEOUT)?;
    let record_ns = monotonic_ns();
    record.with_context(|| late(&daemon, "record"))?;
    let ready_ns = ready(&daemon, manager)?;
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

/// Time of `READY=1` \[ns\], received on a separate thread: one poll of a client may last longer than the
/// measured time.
type Manager = JoinHandle<Result<Option<u64>>>;

fn start(launch: &Launch, cores: &Cores) -> Result<(Daemon, u64, Manager)> {
    let folder = Scratch::temporary().context("a folder for temporary files")?;
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).context("a socket for READY=1")?;
    socket.set_read_timeout(Some(Duration::from_millis(100)))?;
    let mut begin_ns = 0;
    let daemon = Daemon::start_with(launch, cores, |command| {
        command.env("NOTIFY_SOCKET", path);
        begin_ns = monotonic_ns();
    })?;
    let manager = thread::spawn(move || {
        let _folder = folder;
        hear_ready(&socket)
    });
    Ok((daemon, begin_ns, manager))
}

fn ready(daemon: &Daemon, manager: Manager) -> Result<u64> {
    let heard = manager.join();
    let ready_ns = heard.map_err(|_| anyhow!("the service manager panicked"))??;
    ready_ns.with_context(|| late(daemon, "READY=1"))
}

fn late(daemon: &Daemon, missing: &str) -> String {
    let words = daemon.stderr_tail();
    format!("the daemon does not start: no {missing} within {TIMEOUT:?}{words}")
}

fn hear_ready(socket: &UnixDatagram) -> Result<Option<u64>> {
    let deadline = Instant::now() + TIMEOUT;
    let mut message = [0; 4096];
    while Instant::now() < deadline {
        interrupt::check()?;
        let received = socket.recv(&mut message);
        let now_ns = monotonic_ns();
        if received.is_ok_and(|length| says_ready(&message[..length])) {
            return Ok(Some(now_ns));
        }
    }
    Ok(None)
}

fn says_ready(message: &[u8]) -> bool {
    let mut lines = message.split(|byte| *byte == b'\n');
    lines.any(|line| line == b"READY=1")
}

pub(super) fn usage(
    launch: &Launch,
    cores: &Cores,
    idle: Duration,
    tracking: Duration,
) -> Result<Value> {
    let (daemon, _, manager) = start(launch, cores)?;
    ready(&daemon, manager)?;
    let measured = measure(&daemon, cores, idle, tracking);
    daemon.stop().and(measured)
}

fn measure(daemon: &Daemon, cores: &Cores, idle: Duration, tracking: Duration) -> Result<Value> {
    let memory = || Memory::of(daemon.id());
    let after_start = memory()?;
    interrupt::sleep(SETTLE)?;
    let idle = watch(daemon, idle)?;
    let before_client = memory()?;

    let client = Tracking::start(daemon.location(), cores.client())?;
    interrupt::sleep(SETTLE)?;
    let before_tracking = memory()?;
    let tracking = watch(daemon, tracking)?;
    let after_tracking = memory()?;
    // Includes the files of the tracking client.
    let (memory_files, stored_bytes) = files(&daemon.place().memory_files());
    let (root_files, _) = files(&[daemon.location().root().to_owned()]);
    let status = daemon.connect()?.status(TIMEOUT)?;
    client.stop()?;

    let mb = |key| after_tracking.mb(key);
    let growth_kb =
        |from: &Memory, to: &Memory| anyhow::Ok(1e3 * (to.mb("VmRSS")? - from.mb("VmRSS")?));
    let core = |shares: &Shares| sum(CORE_THREADS.iter().filter_map(|name| shares.get(*name)));
    let all = |shares: &Shares| sum(shares.values());
    let mut threads = json!({});
    for (name, percent) in &tracking {
        let idle_percent = idle.get(name).unwrap_or(&0.0);
        threads[name] = json!({ "idle_percent": idle_percent, "tracking_percent": percent });
    }
    // A daemon with real time switched off does not request locked memory.
    let is_locked = status.realtime_missing & (realtime::LOCKED | realtime::OFF) == 0;
    Ok(json!({
        "core_tracking_percent": core(&tracking),
        "resident_mb": mb("VmRSS")?,
        "growth_kb": growth_kb(&before_tracking, &after_tracking)?,
        "page_faults": (after_tracking.page_faults - before_tracking.page_faults) as f64,
        "resident_start_mb": after_start.mb("VmRSS")?,
        "growth_idle_kb": growth_kb(&after_start, &before_client)?,
        "growth_by_client_kb": growth_kb(&before_client, &before_tracking)?,
        "locked": f64::from(is_locked),
        "core_idle_percent": core(&idle),
        "all_tracking_percent": all(&tracking),
        "all_idle_percent": all(&idle),
        "peak_mb": mb("VmHWM")?,
        "own_mb": mb("RssAnon")?,
        "shared_mb": mb("RssShmem")?,
        "file_mb": mb("RssFile")?,
        "locked_mb": mb("VmLck")?,
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
    let (before, begin) = (threads(daemon.id()), Instant::now());
    interrupt::sleep(length)?;
    let (after, passed) = (threads(daemon.id()), begin.elapsed());
    let percent = |name: &str| 100.0 * core_share(&before, &after, name, passed);
    let names = after.iter().map(|thread| thread.name.clone());
    Ok(names.map(|name| (name.clone(), percent(&name))).collect())
}

struct Memory {
    /// `/proc/PID/status`. `VmLck` counts address ranges: more than the resident memory.
    status: String,
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

    /// A value that the kernel reports in units of 1024 bytes (proc(5)).
    fn mb(&self, key: &str) -> Result<f64> {
        let kib = first_number(field(&self.status, key).unwrap_or_default());
        let kib = kib.with_context(|| format!("/proc/PID/status has no {key}"))?;
        Ok(kib * 1024.0 / MB)
    }
}

/// Sum of fields 10 and 12 of `/proc/PID/stat`: minor and major faults. Field 2 is a name in brackets with
/// arbitrary characters.
fn faults_in(stat: &str) -> Option<u64> {
    let behind_name = &stat[stat.rfind(')')? + 1..];
    let mut numbers = behind_name.split_ascii_whitespace().skip(7).step_by(2);
    let mut next = || numbers.next()?.parse::<u64>().ok();
    Some(next()? + next()?)
}

/// Number of files, folders searched, and their size in memory \[bytes\]; untouched pages take none.
fn files(paths: &[PathBuf]) -> (u64, u64) {
    let within = |path: &Path| {
        let entries = fs::read_dir(path).into_iter().flatten().flatten();
        entries.map(|entry| entry.path()).collect::<Vec<_>>()
    };
    let of = |path: &PathBuf| match fs::symlink_metadata(path) {
        Ok(metadata) if metadata.is_dir() => files(&within(path)),
        Ok(metadata) => (1, metadata.blocks() * 512),
        Err(_) => (0, 0),
    };
    let all = paths.iter().map(of);
    all.fold((0, 0), |sum, more| (sum.0 + more.0, sum.1 + more.1))
}
