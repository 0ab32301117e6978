//! Load of the core: two snapshots of the kernel's counters, and their difference.

use std::collections::{BTreeMap, HashMap};
use std::time::{Duration, Instant};

use cdcr_shared_types::proc_stat::{CoreTicks, core_ticks, field, stat_field};

use super::core_set::CoreSet;
use super::finding::{Assessed, unreadable};
use super::system::System;

const WATCHED: Duration = Duration::from_secs(1);

#[derive(Debug, Clone, Default)]
struct Snapshot {
    cores: BTreeMap<usize, CoreTicks>,
    threads: HashMap<u32, Thread>,
    /// Description and count of each interrupt, by its label.
    interrupts: BTreeMap<String, (String, u64)>,
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
    fn take(system: &System, core: usize) -> Assessed<Self> {
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
pub(super) fn cores(stat: &str) -> BTreeMap<usize, CoreTicks> {
    let each = core_ticks(stat).filter_map(|(core, ticks)| Some((core?, ticks)));
    each.collect()
}

/// All threads. One that ends meanwhile is omitted.
fn threads(system: &System) -> HashMap<u32, Thread> {
    let mut threads = HashMap::new();
    for process in system.numbers("/proc") {
        let folder = format!("/proc/{process}/task");
        for id in system.numbers(&folder) {
            let stat = system.read(&format!("{folder}/{id}/stat"));
            let Some(mut thread) = thread_of(&stat.unwrap_or_default(), process, id) else {
                continue;
            };
            if thread.is_realtime() {
                thread.allowed = allowed_cores(system, &format!("{folder}/{id}"));
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
fn interrupts_of(text: &str, core: usize) -> BTreeMap<String, (String, u64)> {
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or("").split_whitespace().collect();
    let Some(column) = head.iter().position(|name| *name == format!("CPU{core}")) else {
        return BTreeMap::new();
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
    fn between(
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

type Cores = BTreeMap<usize, CoreTicks>;

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

#[cfg(test)]
mod tests {
    use super::super::tests::Machine;
    use super::*;

    /// A `stat` line of a thread with the fields that matter here; `rt` is its priority and policy.
    fn stat(id: u32, name: &str, ticks: u64, core: usize, rt: (u32, u32)) -> String {
        // As proc(5) counts them; the first two are the id and the name.
        let mut fields = [0; 53];
        (fields[14], fields[39]) = (ticks, core as u64);
        (fields[40], fields[41]) = (u64::from(rt.0), u64::from(rt.1));
        let rest: Vec<_> = fields[4..].iter().map(ToString::to_string).collect();
        format!("{id} ({name}) S {}", rest.join(" "))
    }

    fn snapshot(stat_text: &str, interrupts: &str, threads: &[(u32, String)]) -> Snapshot {
        let machine = Machine::new(&[("/proc/stat", stat_text), ("/proc/interrupts", interrupts)]);
        for (id, text) in threads {
            machine.write(&format!("/proc/{id}/task/{id}/stat"), text);
            let status = "Name:\tx\nCpus_allowed_list:\t1\n";
            machine.write(&format!("/proc/{id}/task/{id}/status"), status);
        }
        Snapshot::take(&machine.scene.system, 1).unwrap()
    }

    #[test]
    fn the_difference_shows_who_was_there() {
        let before = snapshot(
            "cpu 9 9 9 9\ncpu0 0 0 0 100 0 0 0 0 0 0\ncpu1 10 0 0 90 0 0 0 0 0 0\nintr 5\n",
            "      CPU0 CPU1\n 24: 7 5 IO-APIC 5-edge eth0\nLOC: 0 10 Local timer interrupts\nERR: 0\n",
            &[
                (50, stat(50, "a) (b", 10, 1, (0, 0))),
                (51, stat(51, "elsewhere", 10, 0, (0, 0))),
                (53, stat(53, "ours", 10, 1, (80, 1))),
            ],
        );
        let after = snapshot(
            "cpu 9 9 9 9\ncpu0 50 0 0 150 0 0 0 0 0 0\ncpu1 40 0 0 140 0 0 0 20 0 0\n",
            "      CPU0 CPU1\n 24: 7 305 IO-APIC 5-edge eth0\nLOC: 0 260 Local timer interrupts\nERR: 0\n",
            &[
                (50, stat(50, "a) (b", 30, 1, (0, 0))),
                (51, stat(51, "elsewhere", 40, 0, (0, 0))),
                (52, stat(52, "fresh", 5, 1, (99, 1))),
                (53, stat(53, "ours", 90, 1, (80, 1))),
            ],
        );
        let load = Load::between(&before, after, 1, 1.0, &[53]);
        let core = load.cores[&1];
        assert!((core.busy - 0.3).abs() < 1e-9 && (core.steal - 0.2).abs() < 1e-9);
        assert!((core.steal_since_start - 0.1).abs() < 1e-9);
        assert_eq!(load.cores.len(), 2);
        let percent = |thread: &Thread| (100.0 * thread.share).round();
        let seen = load.threads.iter().map(|t| (&*t.name, t.core, percent(t)));
        let others = [("a) (b", 1, 20.0), ("fresh", 1, 5.0)];
        let expected = [&[("elsewhere", 0, 30.0)], &others[..]].concat();
        assert_eq!(seen.collect::<Vec<_>>(), expected);
        let mut realtime = load.threads.iter().filter(|thread| thread.is_realtime());
        let (first, next) = (realtime.next().unwrap(), realtime.next());
        assert!(next.is_none() && first.allowed.contains(1) && first.priority == 99);
        let [device, timer] = &load.interrupts[..] else {
            panic!("{:?}", load.interrupts)
        };
        assert_eq!((&*device.label, &*device.description), ("24", "eth0"));
        assert_eq!(device.rate_hz, 300.0);
        assert!(device.is_device() && !timer.is_device());
        assert_eq!(timer.description, "Local timer interrupts");
    }

    #[test]
    fn odd_content_is_left_out() {
        let nothing = snapshot(
            "cpu1 0 0 0 0 0 0 0 0\ncpu2 x y\n",
            "\u{1b}",
            &[
                (1, String::new()),
                (2, ")(".to_owned()),
                (3, "3 (x) S".to_owned()),
                (4, stat(4, "\u{1b}[31m\nred", 1, 1, (0, 0))),
            ],
        );
        let names: Vec<_> = nothing.threads.values().map(|t| &*t.name).collect();
        assert_eq!(names, ["?[31m?red"]);
        let load = Load::between(&nothing.clone(), nothing, 1, 0.0, &[]);
        assert_eq!(load.cores[&1], CoreLoad::default());
        assert!(load.threads[0].share == 0.0 && load.interrupts.is_empty());
        let machine = Machine::new(&[("/proc/stat", "intr 5")]);
        assert!(Snapshot::take(&machine.scene.system, 1).is_err());
        // Counters that run backwards (a core that was off) are no load.
        let high = snapshot("cpu1 5 0 0 5 0 0 0 0\n", "CPU1\n 1: 9 x\n", &[]);
        let low = snapshot("cpu1 1 0 0 1 0 0 0 0\n", "CPU1\n 1: 2 x\n", &[]);
        let load = Load::between(&high, low, 1, 1.0, &[]);
        assert!(load.cores[&1].busy == 0.0 && load.interrupts.is_empty());
    }
}
