//! Load of the core: what the kernel counts within a second.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use cdcr_shared_types::proc_stat::stat_field;

use crate::system::{CoreSet, CoreTimes, Reading, System, times_between};

const WATCHED: Duration = Duration::from_secs(1);

/// Counts of the kernel: since the machine started, or between two samples.
#[derive(Debug, Clone, Default)]
pub(super) struct Load {
    pub(super) cores: CoreTimes,
    pub(super) cores_since_start: CoreTimes,
    /// Threads of other processes; between two samples, the busiest first.
    pub(super) threads: Vec<ThreadSample>,
    /// Interrupts on our core; between two samples, the most frequent first.
    pub(super) interrupts: Vec<Interrupt>,
}

#[derive(Debug, Clone, Default)]
#[cfg_attr(test, derive(serde::Deserialize), serde(default))]
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
    /// Share of our core's time used between the samples.
    pub(super) share: f64,
}

#[derive(Debug, Clone, Default)]
#[cfg_attr(test, derive(serde::Deserialize), serde(default))]
pub(super) struct Interrupt {
    /// Number of a device's interrupt, or name of another interrupt.
    pub(super) label: String,
    pub(super) description: String,
    count: u64,
    /// Between the samples.
    pub(super) rate_hz: f64,
}

impl Load {
    /// The load of a second, without the processes `ours`.
    pub(super) fn watch(system: &System, core: usize, ours: &[u32]) -> Reading<Self> {
        let before = Self::since_start(system, core, ours)?;
        let start = Instant::now();
        std::thread::sleep(WATCHED);
        let now = Self::since_start(system, core, ours)?;
        Ok(now.since(&before, core, start.elapsed()))
    }

    /// The present counts; interrupts on `core` only.
    pub(super) fn since_start(system: &System, core: usize, ours: &[u32]) -> Reading<Self> {
        let cores = system.core_times()?;
        let interrupts = system.read_if_there("/proc/interrupts")?;
        let threads = system.threads();
        let others = threads.filter(|(process, _, _)| !ours.contains(process));
        // A thread that ends meanwhile is omitted.
        let sampled = others
            .filter_map(|(process, id, folder)| ThreadSample::read(system, process, id, &folder));
        Ok(Self {
            cores_since_start: cores.clone(),
            cores,
            threads: sampled.collect(),
            interrupts: interrupts_of(&interrupts.unwrap_or_default(), core),
        })
    }

    /// The counts of `passed`, the time since the sample `before`.
    pub(super) fn since(mut self, before: &Self, core: usize, passed: Duration) -> Self {
        self.cores = times_between(&before.cores, &self.cores);
        let time = self.cores.get(&core).copied().unwrap_or_default();
        let ticks_of = |thread: &ThreadSample| (thread.id, thread.ticks);
        let earlier: HashMap<u32, u64> = before.threads.iter().map(ticks_of).collect();
        for thread in &mut self.threads {
            let old = earlier.get(&thread.id).copied().unwrap_or(0);
            // A new thread has used all its time meanwhile; so has one that reuses an id.
            let used = thread.ticks.checked_sub(old).unwrap_or(thread.ticks);
            thread.share = time.share(used);
        }
        self.threads.sort_by(|a, b| b.share.total_cmp(&a.share));
        for interrupt in &mut self.interrupts {
            let mut earlier = before.interrupts.iter();
            let old = earlier.find(|old| old.label == interrupt.label);
            let old = old.map_or(0, |old| old.count);
            let count = interrupt.count.saturating_sub(old);
            interrupt.rate_hz = count as f64 / passed.as_secs_f64().max(1e-3);
        }
        self.interrupts.retain(|interrupt| interrupt.rate_hz > 0.0);
        self.interrupts
            .sort_by(|a, b| b.rate_hz.total_cmp(&a.rate_hz));
        self
    }
}

/// Flag of a kernel thread.
const PF_KTHREAD: u64 = 0x0020_0000;
const SCHED_DEADLINE: u64 = 6;

impl ThreadSample {
    fn read(system: &System, process: u32, id: u32, folder: &str) -> Option<Self> {
        let stat = system.read(&format!("{folder}/stat")).ok()?;
        let (_, name) = stat.rsplit_once(')')?.0.split_once('(')?;
        let number = |field| stat_field::<u64>(stat.as_bytes(), field);
        let mut thread = Self {
            process,
            id,
            name: printable(name),
            is_kernel: number(9)? & PF_KTHREAD != 0,
            is_deadline: number(41)? == SCHED_DEADLINE,
            priority: i32::try_from(number(40)?).ok()?,
            core: usize::try_from(number(39)?).ok()?,
            ticks: number(14)?.saturating_add(number(15)?),
            ..Self::default()
        };
        if thread.is_realtime() {
            thread.allowed = system.allowed(folder).unwrap_or_default();
        }
        Some(thread)
    }

    pub(super) fn is_realtime(&self) -> bool {
        self.is_deadline || self.priority > 0
    }
}

impl Interrupt {
    /// An interrupt of a device, which can be moved to another core.
    pub(super) fn is_device(&self) -> bool {
        self.label.parse::<u32>().is_ok()
    }
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

fn printable(name: &str) -> String {
    let safe = |c: char| if c.is_control() { '?' } else { c };
    name.chars().map(safe).collect()
}
