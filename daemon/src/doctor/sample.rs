//! Load of the core: two snapshots of the kernel's counters, and their difference.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use cdcr_shared_types::proc_stat::stat_field;

use crate::system::{
    CoreLoad, CoreSet, CoreTimes, Reading, System, core_loads, core_times, share, unreadable,
};

const WATCHED: Duration = Duration::from_secs(1);

/// Counters of the kernel at one moment.
#[derive(Debug, Clone, Default)]
pub(super) struct Snapshot {
    cores: CoreTimes,
    threads: HashMap<u32, ThreadSample>,
    /// Interrupts on our core.
    interrupts: Vec<Interrupt>,
}

#[derive(Debug, Clone, Default)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize), serde(default))]
pub(super) struct ThreadSample {
    pub(super) process: u32,
    pub(super) id: u32,
    /// Name without control characters.
    pub(super) name: String,
    /// A thread of the kernel.
    pub(super) is_kernel: bool,
    /// Its policy is `SCHED_DEADLINE`, which precedes every priority.
    pub(super) is_deadline: bool,
    /// Real-time priority (`SCHED_FIFO`, `SCHED_RR`); 0 for other threads.
    pub(super) priority: i32,
    /// Cores that it may use; read for real-time threads only.
    pub(super) allowed: CoreSet,
    /// Core on which it last ran.
    pub(super) core: usize,
    /// Core time used, in the kernel's ticks.
    ticks: u64,
    /// Share of our core's time used between the snapshots.
    pub(super) share: f64,
}

/// Load between two snapshots.
#[derive(Debug, Clone, Default)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize), serde(default))]
pub(super) struct Load {
    pub(super) cores: BTreeMap<usize, CoreLoad>,
    /// Threads of other processes, the busiest first.
    pub(super) threads: Vec<ThreadSample>,
    /// Interrupts on our core, the most frequent first.
    pub(super) interrupts: Vec<Interrupt>,
}

#[derive(Debug, Clone, Default, PartialEq)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize), serde(default))]
pub(super) struct Interrupt {
    /// Number of a device's interrupt, or name of another interrupt.
    pub(super) label: String,
    pub(super) description: String,
    count: u64,
    /// Between the snapshots.
    pub(super) rate_hz: f64,
}

impl Interrupt {
    /// An interrupt of a device, which can be moved to another core.
    pub(super) fn is_device(&self) -> bool {
        self.label.parse::<u32>().is_ok()
    }
}

impl Snapshot {
    /// The present counters; interrupts on `core` only.
    pub(super) fn take(system: &System, core: usize) -> Reading<Self> {
        let cores = core_times(&system.read("/proc/stat")?);
        if cores.is_empty() {
            return Err(unreadable("/proc/stat", "no line of a core"));
        }
        let interrupts = system.read_if_there("/proc/interrupts")?;
        Ok(Self {
            cores,
            threads: threads(system),
            interrupts: interrupts_of(&interrupts.unwrap_or_default(), core),
        })
    }
}

/// All threads. One that ends meanwhile is omitted.
fn threads(system: &System) -> HashMap<u32, ThreadSample> {
    let mut threads = HashMap::new();
    for process in system.numbers("/proc") {
        let folder = format!("/proc/{process}/task");
        for id in system.numbers(&folder) {
            let folder = format!("{folder}/{id}");
            let stat = system.read(&format!("{folder}/stat")).unwrap_or_default();
            let Some(mut thread) = thread_of(&stat, process, id) else {
                continue;
            };
            if thread.is_realtime() {
                thread.allowed = system.allowed_to(&folder);
            }
            threads.insert(id, thread);
        }
    }
    threads
}

/// Flag of a kernel thread.
const PF_KTHREAD: u64 = 0x0020_0000;
const SCHED_DEADLINE: u64 = 6;

fn thread_of(stat: &str, process: u32, id: u32) -> Option<ThreadSample> {
    let (_, name) = stat.rsplit_once(')')?.0.split_once('(')?;
    let number = |field| stat_field::<u64>(stat.as_bytes(), field);
    Some(ThreadSample {
        process,
        id,
        name: printable(name),
        is_kernel: number(9)? & PF_KTHREAD != 0,
        is_deadline: number(41)? == SCHED_DEADLINE,
        priority: i32::try_from(number(40)?).ok()?,
        allowed: CoreSet::default(),
        core: usize::try_from(number(39)?).ok()?,
        ticks: number(14)?.saturating_add(number(15)?),
        share: 0.0,
    })
}

impl ThreadSample {
    pub(super) fn is_realtime(&self) -> bool {
        self.is_deadline || self.priority > 0
    }
}

fn printable(name: &str) -> String {
    let safe = |c: char| if c.is_control() { '?' } else { c };
    name.chars().map(safe).collect()
}

/// Parses a header of the online cores, then lines `label: count for each core, description`.
fn interrupts_of(text: &str, core: usize) -> Vec<Interrupt> {
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or("").split_whitespace().collect();
    let ours = format!("CPU{core}");
    let column = head.iter().position(|name| *name == ours);
    let parsed = lines.filter_map(|line| {
        let (label, rest) = line.split_once(':')?;
        let words: Vec<&str> = rest.split_whitespace().collect();
        let mut interrupt = Interrupt {
            label: label.trim().to_owned(),
            count: words.get(column?)?.parse().ok()?,
            ..Interrupt::default()
        };
        let description = match words.get(head.len()..).unwrap_or_default() {
            // The controller and pin precede the name of a device.
            [.., device] if interrupt.is_device() => device.to_owned(),
            words => &words.join(" "),
        };
        interrupt.description = printable(description);
        Some(interrupt)
    });
    parsed.collect()
}

impl Load {
    /// Observes the load for a second; `ours` as in [`Load::between`].
    pub(super) fn watch(system: &System, core: usize, ours: &[u32]) -> Reading<Self> {
        let before = Snapshot::take(system, core)?;
        let start = Instant::now();
        std::thread::sleep(WATCHED);
        let after = Snapshot::take(system, core)?;
        let seconds = start.elapsed().as_secs_f64();
        Ok(Self::between(&before, after, core, seconds, ours))
    }

    /// The difference of two snapshots taken `seconds` apart. The processes `ours` are excluded: this one,
    /// and a running daemon of this robot.
    pub(super) fn between(
        before: &Snapshot,
        after: Snapshot,
        core: usize,
        seconds: f64,
        ours: &[u32],
    ) -> Self {
        let cores = core_loads(&before.cores, &after.cores);
        let total = cores.get(&core).map_or(0, |load| load.ticks);
        let mut threads: Vec<ThreadSample> = after.threads.into_values().collect();
        threads.retain(|thread| !ours.contains(&thread.process));
        for thread in &mut threads {
            let earlier = before.threads.get(&thread.id).map_or(0, |old| old.ticks);
            // A new thread has used all its time meanwhile; so has one that reuses an id.
            let used = thread.ticks.checked_sub(earlier).unwrap_or(thread.ticks);
            thread.share = share(used, total);
        }
        threads.sort_by(|a, b| b.share.total_cmp(&a.share));
        let mut interrupts = after.interrupts;
        for interrupt in &mut interrupts {
            let mut earlier = before.interrupts.iter();
            let old = earlier.find(|old| old.label == interrupt.label);
            let count = interrupt
                .count
                .saturating_sub(old.map_or(0, |old| old.count));
            interrupt.rate_hz = count as f64 / seconds.max(1e-3);
        }
        interrupts.retain(|interrupt| interrupt.rate_hz > 0.0);
        interrupts.sort_by(|a, b| b.rate_hz.total_cmp(&a.rate_hz));
        Self {
            cores,
            threads,
            interrupts,
        }
    }
}
