//! Load of the core: two snapshots of the kernel's counters, and their difference.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use cdcr_shared_types::proc_stat::{CoreTicks, core_ticks, field, stat_field};

use super::core_set::CoreSet;
use super::finding::{Assessed, unreadable};
use super::system::System;

const WATCHED: Duration = Duration::from_secs(1);

type Cores = BTreeMap<usize, CoreTicks>;
/// Description and count of each interrupt, by its label.
type Interrupts = BTreeMap<String, (String, u64)>;

#[derive(Debug, Clone, Default)]
pub(super) struct Snapshot {
    cores: Cores,
    threads: HashMap<u32, Thread>,
    interrupts: Interrupts,
}

#[derive(Debug, Clone, Default)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize), serde(default))]
pub(super) struct Thread {
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
    pub(super) threads: Vec<Thread>,
    /// Interrupts on our core, the most frequent first.
    pub(super) interrupts: Vec<InterruptRate>,
}

/// Shares of one core's time, 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize), serde(default))]
pub(super) struct CoreLoad {
    pub(super) busy: f64,
    /// Given to another machine by the hypervisor between the snapshots.
    pub(super) steal: f64,
    pub(super) steal_since_start: f64,
}

#[derive(Debug, Clone, Default, PartialEq)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize), serde(default))]
pub(super) struct InterruptRate {
    /// Number of a device's interrupt, or name of another interrupt.
    pub(super) label: String,
    pub(super) description: String,
    pub(super) rate_hz: f64,
}

impl InterruptRate {
    /// An interrupt of a device, which can be moved to another core.
    pub(super) fn is_device(&self) -> bool {
        is_number(&self.label)
    }
}

fn is_number(label: &str) -> bool {
    label.parse::<u32>().is_ok()
}

impl Snapshot {
    /// The present counters; interrupts on `core` only.
    pub(super) fn take(system: &System, core: usize) -> Assessed<Self> {
        let cores = cores(&system.read("/proc/stat")?);
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

/// The time of each core, from the text of `/proc/stat`.
pub(super) fn cores(stat: &str) -> Cores {
    let each = core_ticks(stat).filter_map(|(core, ticks)| Some((core?, ticks)));
    each.collect()
}

/// All threads. One that ends meanwhile is omitted.
fn threads(system: &System) -> HashMap<u32, Thread> {
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
                thread.allowed = allowed_cores(system, &folder);
            }
            threads.insert(id, thread);
        }
    }
    threads
}

/// The cores that the thread of a folder may use; none if they cannot be read.
pub(super) fn allowed_cores(system: &System, folder: &str) -> CoreSet {
    let status = system.read(&format!("{folder}/status")).unwrap_or_default();
    CoreSet::parse(field(&status, "Cpus_allowed_list").unwrap_or_default())
}

/// Flag of a kernel thread.
const PF_KTHREAD: u64 = 0x0020_0000;
const SCHED_DEADLINE: u64 = 6;

fn thread_of(stat: &str, process: u32, id: u32) -> Option<Thread> {
    let (_, name) = stat.rsplit_once(')')?.0.split_once('(')?;
    let number = |field| stat_field::<u64>(stat.as_bytes(), field);
    Some(Thread {
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

impl Thread {
    pub(super) fn is_realtime(&self) -> bool {
        self.is_deadline || self.priority > 0
    }
}

fn printable(name: &str) -> String {
    let safe = |c: char| if c.is_control() { '?' } else { c };
    name.chars().map(safe).collect()
}

/// Parses a header of the online cores, then lines `label: count for each core, description`.
fn interrupts_of(text: &str, core: usize) -> Interrupts {
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or("").split_whitespace().collect();
    let Some(column) = head.iter().position(|name| *name == format!("CPU{core}")) else {
        return Interrupts::new();
    };
    let parsed = lines.filter_map(|line| {
        let (label, rest) = line.split_once(':')?;
        let (label, words) = (label.trim(), rest.split_whitespace().collect::<Vec<_>>());
        let count = words.get(column)?.parse().ok()?;
        let description = match words.get(head.len()..).unwrap_or_default() {
            // The controller and pin precede the name of a device.
            [.., device] if is_number(label) => printable(device),
            words => printable(&words.join(" ")),
        };
        Some((label.to_owned(), (description, count)))
    });
    parsed.collect()
}

impl Load {
    /// Observes the load for a second; `ours` as in [`Load::between`].
    pub(super) fn watch(system: &System, core: usize, ours: &[u32]) -> Assessed<Self> {
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
        let total = since(&before.cores, &after.cores, core).total;
        let mut threads: Vec<Thread> = after.threads.into_values().collect();
        threads.retain(|thread| !ours.contains(&thread.process));
        for thread in &mut threads {
            let earlier = before.threads.get(&thread.id).map_or(0, |old| old.ticks);
            // A new thread has used all its time meanwhile; so has one that reuses an id.
            let used = thread.ticks.checked_sub(earlier).unwrap_or(thread.ticks);
            thread.share = share(used, total);
        }
        threads.sort_by(|a, b| b.share.total_cmp(&a.share));
        let rate = |(label, (description, now)): (String, (String, u64))| {
            let earlier = before.interrupts.get(&label).map_or(0, |(_, count)| *count);
            let rate_hz = now.saturating_sub(earlier) as f64 / seconds.max(1e-3);
            InterruptRate {
                label,
                description,
                rate_hz,
            }
        };
        let mut interrupts: Vec<_> = after.interrupts.into_iter().map(rate).collect();
        interrupts.retain(|rate| rate.rate_hz > 0.0);
        interrupts.sort_by(|a, b| b.rate_hz.total_cmp(&a.rate_hz));
        Self {
            cores: core_loads(&before.cores, &after.cores),
            threads,
            interrupts,
        }
    }
}

/// The time of a core between two readings. Counters that run backwards (of a core that was off) count as
/// zero.
fn since(before: &Cores, after: &Cores, core: usize) -> CoreTicks {
    let [before, after] =
        [before, after].map(|cores| cores.get(&core).copied().unwrap_or_default());
    CoreTicks {
        busy: after.busy.saturating_sub(before.busy),
        steal: after.steal.saturating_sub(before.steal),
        total: after.total.saturating_sub(before.total),
    }
}

/// 0 to 1; 0 if `total` is 0.
fn share(part: u64, total: u64) -> f64 {
    (part as f64 / total.max(1) as f64).min(1.0)
}

/// Shares of each core's time between two readings.
pub(super) fn core_loads(before: &Cores, after: &Cores) -> BTreeMap<usize, CoreLoad> {
    let loads = after.iter().map(|(core, since_start)| {
        let ticks = since(before, after, *core);
        let load = CoreLoad {
            busy: share(ticks.busy, ticks.total),
            steal: share(ticks.steal, ticks.total),
            steal_since_start: share(since_start.steal, since_start.total),
        };
        (*core, load)
    });
    loads.collect()
}
