//! What happens on the core meanwhile: two snapshots of the kernel's counters, and their difference.

use std::collections::{BTreeMap, HashMap};

use super::core_set::CoreSet;
use super::system::{System, Unreadable, field_of};

#[derive(Debug, Clone, Default)]
pub(crate) struct Snapshot {
    cores: BTreeMap<usize, Ticks>,
    threads: HashMap<u32, Thread>,
    interrupts: BTreeMap<String, Interrupt>,
}

/// Time of one core since the machine started, in the kernel's ticks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Ticks {
    busy: u64,
    steal: u64,
    total: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Thread {
    pub(crate) process: u32,
    pub(crate) id: u32,
    /// Its name, without control characters.
    pub(crate) name: String,
    /// Whether it is one of the kernel's.
    pub(crate) is_kernel: bool,
    /// Whether its policy is `SCHED_FIFO` or `SCHED_RR`.
    pub(crate) is_realtime: bool,
    /// Whether its policy is `SCHED_DEADLINE`, which goes before every priority.
    pub(crate) is_deadline: bool,
    /// Real-time priority; 0 for other threads.
    pub(crate) priority: i32,
    /// Cores that it may run on; read for real-time threads only.
    pub(crate) allowed: CoreSet,
    /// Core on which it was seen last.
    pub(crate) core: usize,
    /// Time that it has used, in the kernel's ticks.
    pub(crate) ticks: u64,
}

#[cfg(test)]
impl Thread {
    /// An ordinary thread on core 1 that has done nothing.
    pub(super) fn named(name: &str, id: u32) -> Self {
        Self {
            process: id,
            id,
            name: name.to_owned(),
            is_kernel: false,
            is_realtime: false,
            is_deadline: false,
            priority: 0,
            allowed: CoreSet::default(),
            core: 1,
            ticks: 0,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Interrupt {
    description: String,
    count: u64,
}

impl Snapshot {
    /// The counters now; those of interrupts on `core`.
    pub(crate) fn take(system: &System, core: usize) -> Result<Self, Unreadable> {
        let cores = cores(&system.read("/proc/stat")?);
        if cores.is_empty() {
            return Err(Unreadable::new("/proc/stat", "it has no line of a core"));
        }
        let interrupts = system.read_if_there("/proc/interrupts")?;
        Ok(Self {
            cores,
            threads: threads(system),
            interrupts: interrupts.map_or_else(BTreeMap::new, |text| interrupts_of(&text, core)),
        })
    }
}

/// Lines `cpu3 user nice system idle iowait irq softirq steal …`. The line `cpu` is the sum of all.
fn cores(stat: &str) -> BTreeMap<usize, Ticks> {
    let lines = stat.lines().filter_map(|line| {
        let mut words = line.split_whitespace();
        let core = words.next()?.strip_prefix("cpu")?.parse().ok()?;
        // What guests use is inside `user` already.
        let times: Vec<u64> = words.take(8).map_while(|word| word.parse().ok()).collect();
        let at = |index: usize| times.get(index).copied().unwrap_or(0);
        let total = times.iter().copied().fold(0, u64::saturating_add);
        let (idle, steal) = (at(3).saturating_add(at(4)), at(7));
        let busy = total.saturating_sub(idle).saturating_sub(steal);
        Some((core, Ticks { busy, steal, total }))
    });
    lines.collect()
}

/// Every thread. One that ends while we look is left out.
fn threads(system: &System) -> HashMap<u32, Thread> {
    let mut threads = HashMap::new();
    for process in system.numbers("/proc") {
        let folder = format!("/proc/{process}/task");
        for id in system.numbers(&folder) {
            let Ok(stat) = system.read(&format!("{folder}/{id}/stat")) else {
                continue;
            };
            let Some(mut thread) = thread_of(&stat, process, id) else {
                continue;
            };
            if (thread.is_realtime || thread.is_deadline)
                && let Ok(status) = system.read(&format!("{folder}/{id}/status"))
            {
                let list = field_of(&status, "Cpus_allowed_list");
                thread.allowed = CoreSet::parse(&list.unwrap_or_default());
            }
            threads.insert(id, thread);
        }
    }
    threads
}

/// Flag of a thread of the kernel.
const PF_KTHREAD: u64 = 0x0020_0000;

/// One thread of its `stat`. The name is in parentheses, and may hold anything, parentheses too.
fn thread_of(stat: &str, process: u32, id: u32) -> Option<Thread> {
    let (head, rest) = stat.rsplit_once(')')?;
    let (_, name) = head.split_once('(')?;
    let fields: Vec<&str> = rest.split_whitespace().collect();
    // proc(5) counts from 1, and the state after the name is its field 3.
    let number = |field: usize| fields.get(field - 3)?.parse::<u64>().ok();
    let policy = number(41)?;
    Some(Thread {
        process,
        id,
        name: printable(name),
        is_kernel: number(9)? & PF_KTHREAD != 0,
        is_realtime: matches!(policy, 1 | 2),
        is_deadline: policy == 6,
        priority: i32::try_from(number(40)?).ok()?,
        allowed: CoreSet::default(),
        core: usize::try_from(number(39)?).ok()?,
        ticks: number(14)?.saturating_add(number(15)?),
    })
}

fn printable(name: &str) -> String {
    let safe = |c: char| if c.is_control() { '?' } else { c };
    name.chars().map(safe).collect()
}

/// A head of the cores that run, then lines `label: count for each core, description`.
fn interrupts_of(text: &str, core: usize) -> BTreeMap<String, Interrupt> {
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or("").split_whitespace().collect();
    let ours = format!("CPU{core}");
    let Some(column) = head.iter().position(|name| *name == ours) else {
        return BTreeMap::new();
    };
    let parsed = lines.filter_map(|line| {
        let (label, rest) = line.split_once(':')?;
        let words: Vec<&str> = rest.split_whitespace().collect();
        let count = words.get(column)?.parse().ok()?;
        let described = words.get(head.len()..).unwrap_or_default();
        let is_device = label.trim().parse::<u32>().is_ok();
        let description = match described.last() {
            Some(name) if is_device => printable(name),
            _ => printable(&described.join(" ")),
        };
        let interrupt = Interrupt { description, count };
        Some((label.trim().to_owned(), interrupt))
    });
    parsed.collect()
}

/// What happened between two snapshots.
#[derive(Debug, Clone, Default)]
pub(crate) struct Load {
    pub(crate) cores: BTreeMap<usize, CoreLoad>,
    /// Threads that used time and were last seen on our core, the busiest first.
    pub(crate) neighbours: Vec<Neighbour>,
    /// Every real-time thread of other processes.
    pub(crate) realtime: Vec<Thread>,
    /// Interrupts on our core, the most frequent first.
    pub(crate) interrupts: Vec<InterruptRate>,
    /// Process id of irqbalance, when it runs.
    pub(crate) irqbalance: Option<u32>,
}

/// Shares of one core's time, 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct CoreLoad {
    /// Used for something, between the snapshots.
    pub(crate) busy: f64,
    /// Given to somebody else by the hypervisor, between the snapshots.
    pub(crate) steal: f64,
    /// The same since the machine started.
    pub(crate) steal_since_start: f64,
}

/// A thread that used time and was last seen on our core.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Neighbour {
    pub(crate) thread: Thread,
    /// Its share of the core's time, 0 to 1.
    pub(crate) share: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct InterruptRate {
    /// Number, or the kernel's abbreviation.
    pub(crate) label: String,
    /// Device, or what it is.
    pub(crate) description: String,
    /// How often on our core \[1/s\].
    pub(crate) rate_hz: f64,
}

impl InterruptRate {
    /// Whether a device sends it: those have numbers, and can be moved.
    pub(crate) fn is_device(&self) -> bool {
        self.label.parse::<u32>().is_ok()
    }
}

impl Load {
    /// The difference of two snapshots that were taken `seconds` apart. `ours` are the processes that are
    /// no neighbours: this one, and the daemon of this robot when it runs.
    pub(crate) fn between(
        before: &Snapshot,
        after: &Snapshot,
        core: usize,
        seconds: f64,
        ours: &[u32],
    ) -> Self {
        let foreign = |thread: &&Thread| !ours.contains(&thread.process);
        let threads = || after.threads.values().filter(foreign);
        let ticks = ticks_between(before, after, core).total;
        let mut neighbours: Vec<_> = threads()
            .filter(|thread| thread.core == core)
            .filter_map(|thread| neighbour(before, thread, ticks))
            .collect();
        neighbours.sort_by(|a, b| b.share.total_cmp(&a.share));
        let mut realtime: Vec<_> = threads()
            .filter(|thread| thread.is_realtime || thread.is_deadline)
            .cloned()
            .collect();
        realtime.sort_by_key(|thread| (-thread.priority, thread.id));
        Self {
            cores: core_loads(before, after),
            neighbours,
            realtime,
            interrupts: interrupt_rates(before, after, seconds),
            irqbalance: threads()
                .find(|thread| thread.name == "irqbalance")
                .map(|thread| thread.process),
        }
    }
}

fn ticks_between(before: &Snapshot, after: &Snapshot, core: usize) -> Ticks {
    let of = |snapshot: &Snapshot| snapshot.cores.get(&core).copied().unwrap_or_default();
    let (before, after) = (of(before), of(after));
    Ticks {
        busy: after.busy.saturating_sub(before.busy),
        steal: after.steal.saturating_sub(before.steal),
        total: after.total.saturating_sub(before.total),
    }
}

fn share(part: u64, total: u64) -> f64 {
    if total == 0 {
        return 0.0;
    }
    (part as f64 / total as f64).min(1.0)
}

fn core_loads(before: &Snapshot, after: &Snapshot) -> BTreeMap<usize, CoreLoad> {
    let loads = after.cores.iter().map(|(core, since_start)| {
        let ticks = ticks_between(before, after, *core);
        let load = CoreLoad {
            busy: share(ticks.busy, ticks.total),
            steal: share(ticks.steal, ticks.total),
            steal_since_start: share(since_start.steal, since_start.total),
        };
        (*core, load)
    });
    loads.collect()
}

/// Share of each core that was used for something between two texts of `/proc/stat`, 0 to 1.
pub(super) fn busy_between(before: &str, after: &str) -> BTreeMap<usize, f64> {
    let snapshot = |stat| Snapshot {
        cores: cores(stat),
        ..Snapshot::default()
    };
    let loads = core_loads(&snapshot(before), &snapshot(after));
    let busy = loads.into_iter().map(|(core, load)| (core, load.busy));
    busy.collect()
}

/// A thread that is new has used all its time between the snapshots; so has one with the id of another.
fn neighbour(before: &Snapshot, thread: &Thread, ticks: u64) -> Option<Neighbour> {
    let earlier = before.threads.get(&thread.id).map_or(0, |old| old.ticks);
    let used = match thread.ticks.checked_sub(earlier) {
        Some(used) => used,
        None => thread.ticks,
    };
    (used > 0).then(|| Neighbour {
        thread: thread.clone(),
        share: share(used, ticks),
    })
}

fn interrupt_rates(before: &Snapshot, after: &Snapshot, seconds: f64) -> Vec<InterruptRate> {
    let rates = after.interrupts.iter().filter_map(|(label, now)| {
        let earlier = before.interrupts.get(label).map_or(0, |old| old.count);
        let count = now.count.saturating_sub(earlier);
        (count > 0).then(|| InterruptRate {
            label: label.clone(),
            description: now.description.clone(),
            rate_hz: count as f64 / seconds.max(1e-3),
        })
    });
    let mut rates: Vec<_> = rates.collect();
    rates.sort_by(|a, b| b.rate_hz.total_cmp(&a.rate_hz));
    rates
}

#[cfg(test)]
mod tests {
    use super::super::fake::Fake;
    use super::*;

    /// A line of a thread, with those fields that matter here.
    fn stat(id: u32, name: &str, flags: u64, ticks: u64, core: usize, rt: (u32, u32)) -> String {
        // As proc(5) counts them; the first two are the id and the name.
        let mut fields = [0; 53];
        (fields[9], fields[14], fields[39]) = (flags, ticks, core as u64);
        (fields[40], fields[41]) = (u64::from(rt.0), u64::from(rt.1));
        let rest: Vec<_> = fields[4..].iter().map(ToString::to_string).collect();
        format!("{id} ({name}) S {}", rest.join(" "))
    }

    fn snapshot(stat_text: &str, interrupts: &str, threads: &[(u32, String)]) -> Snapshot {
        let fake = Fake::new(&[("/proc/stat", stat_text), ("/proc/interrupts", interrupts)]);
        for (id, text) in threads {
            fake.write(&format!("/proc/{id}/task/{id}/stat"), text);
            let status = "Name:\tx\nCpus_allowed_list:\t1\n";
            fake.write(&format!("/proc/{id}/task/{id}/status"), status);
        }
        Snapshot::take(&fake.scene.system, 1).unwrap()
    }

    #[test]
    fn the_difference_shows_who_was_there() {
        let before = snapshot(
            "cpu 9 9 9 9\ncpu0 0 0 0 100 0 0 0 0 0 0\ncpu1 10 0 0 90 0 0 0 0 0 0\nintr 5\n",
            "      CPU0 CPU1\n 24: 7 5 IO-APIC 5-edge eth0\nLOC: 0 10 Local timer interrupts\nERR: 0\n",
            &[
                (50, stat(50, "a) (b", 0, 10, 1, (0, 0))),
                (51, stat(51, "elsewhere", 0, 10, 0, (0, 0))),
                (53, stat(53, "ours", 0, 10, 1, (80, 1))),
            ],
        );
        let after = snapshot(
            "cpu 9 9 9 9\ncpu0 50 0 0 150 0 0 0 0 0 0\ncpu1 40 0 0 140 0 0 0 20 0 0\n",
            "      CPU0 CPU1\n 24: 7 305 IO-APIC 5-edge eth0\nLOC: 0 260 Local timer interrupts\nERR: 0\n",
            &[
                (50, stat(50, "a) (b", 0, 30, 1, (0, 0))),
                (51, stat(51, "elsewhere", 0, 40, 0, (0, 0))),
                (52, stat(52, "fresh", 0, 5, 1, (99, 1))),
                (53, stat(53, "ours", 0, 90, 1, (80, 1))),
            ],
        );
        let load = Load::between(&before, &after, 1, 1.0, &[53]);
        let core = load.cores[&1];
        assert!((core.busy - 0.3).abs() < 1e-9 && (core.steal - 0.2).abs() < 1e-9);
        assert!((core.steal_since_start - 0.1).abs() < 1e-9);
        assert_eq!(load.cores.len(), 2);
        let names: Vec<_> = load.neighbours.iter().map(|n| &*n.thread.name).collect();
        assert_eq!(names, ["a) (b", "fresh"]);
        assert!((load.neighbours[0].share - 0.2).abs() < 1e-9);
        assert_eq!(load.realtime.len(), 1);
        assert!(load.realtime[0].allowed.contains(1) && load.realtime[0].priority == 99);
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
            "cpu1\ncpu2 x y\n",
            "\u{1b}",
            &[
                (1, String::new()),
                (2, ")(".to_owned()),
                (3, "3 (x) S".to_owned()),
                (4, stat(4, "\u{1b}[31m\nred", 0, 1, 1, (0, 0))),
            ],
        );
        let load = Load::between(&nothing, &nothing, 1, 0.0, &[]);
        assert_eq!(load.cores[&1], CoreLoad::default());
        assert!(load.neighbours.is_empty() && load.interrupts.is_empty());
        let names: Vec<_> = nothing.threads.values().map(|t| &*t.name).collect();
        assert_eq!(names, ["?[31m?red"]);
        let fake = Fake::new(&[("/proc/stat", "intr 5")]);
        assert!(Snapshot::take(&fake.scene.system, 1).is_err());
        // Counters that run backwards (a core that was off) are no load.
        let high = snapshot("cpu1 5 0 0 5\n", "CPU1\n 1: 9 x\n", &[]);
        let low = snapshot("cpu1 1 0 0 1\n", "CPU1\n 1: 2 x\n", &[]);
        let load = Load::between(&high, &low, 1, 1.0, &[]);
        assert!(load.cores[&1].busy == 0.0 && load.interrupts.is_empty());
    }
}
