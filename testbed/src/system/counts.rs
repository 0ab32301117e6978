//! What the kernel counts: time of threads on and off their core, time that the hypervisor took.

use std::fs;
use std::path::Path;
use std::time::Duration;

use cdcr_shared_types::proc_stat::{TICK_NS, core_ticks};

/// One thread of a process, as the kernel counts it since its start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThreadCounts {
    pub id: u32,
    pub name: String,
    pub on_core_ns: u64,
    /// Time that it was ready and another had the core \[ns\].
    pub run_delay_ns: u64,
}

/// All threads of a process; those that end meanwhile are left out. Empty where the kernel does not count
/// (`CONFIG_SCHED_INFO`).
pub fn threads(process: u32) -> Vec<ThreadCounts> {
    let folder = format!("/proc/{process}/task");
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut all: Vec<_> = entries
        .flatten()
        .filter_map(|entry| thread(&entry.path()))
        .collect();
    all.sort_by_key(|thread| thread.id);
    all
}

fn thread(folder: &Path) -> Option<ThreadCounts> {
    let text = |name: &str| fs::read_to_string(folder.join(name)).ok();
    let schedstat = text("schedstat")?;
    let mut numbers = schedstat.split_ascii_whitespace().map(str::parse::<u64>);
    Some(ThreadCounts {
        id: folder.file_name()?.to_str()?.parse().ok()?,
        name: text("comm")?.trim_end().to_owned(),
        on_core_ns: numbers.next()?.ok()?,
        run_delay_ns: numbers.next()?.ok()?,
    })
}

/// Share of one core that the threads of this name used between two counts of one process, so long after each
/// other. A thread that came in between counts from its start; one that ended counts no more.
pub fn core_share(
    before: &[ThreadCounts],
    after: &[ThreadCounts],
    name: &str,
    passed: Duration,
) -> f64 {
    let used_ns = |thread: &ThreadCounts| {
        let old = before.iter().find(|old| old.id == thread.id);
        let old_ns = old.map_or(0, |old| old.on_core_ns);
        thread.on_core_ns.saturating_sub(old_ns)
    };
    let named = after.iter().filter(|thread| thread.name == name);
    let all_ns: u64 = named.map(used_ns).sum();
    all_ns as f64 / passed.as_nanos().max(1) as f64
}

/// Time that the hypervisor has kept this core from the machine since its start \[ms\], in steps of a tick
/// of 10 ms. None where the kernel does not count it.
pub fn steal_ms(core: usize) -> Option<f64> {
    let stat = fs::read_to_string("/proc/stat").ok()?;
    let (_, ticks) = core_ticks(&stat).find(|(of, _)| *of == Some(core))?;
    Some((ticks.steal * TICK_NS) as f64 * 1e-6)
}

#[cfg(test)]
mod tests {
    use cdcr_test_skip::{Need, skip};

    use super::*;

    #[test]
    fn the_share_of_a_core_is_that_of_the_named_threads_and_never_negative() {
        let thread = |id, name: &str, on_core_ns| ThreadCounts {
            id,
            name: name.to_owned(),
            on_core_ns,
            run_delay_ns: 0,
        };
        let before = [thread(1, "a", 100), thread(2, "b", 0), thread(4, "d", 900)];
        let after = [
            thread(1, "a", 400),
            thread(2, "b", 1000),
            thread(3, "a", 200),
            // Another thread that got the id of one that ended.
            thread(4, "d", 10),
        ];
        let share = |name| core_share(&before, &after, name, Duration::from_micros(1));
        assert!((share("a") - 0.5).abs() < 1e-12);
        assert!((share("b") - 1.0).abs() < 1e-12);
        assert!(share("c").abs() < 1e-12 && share("d").abs() < 1e-12);
    }

    #[test]
    fn our_own_threads_are_counted() {
        let all = threads(std::process::id());
        if all.is_empty() {
            skip(Need::Kernel, "it counts no time of threads (schedstat)");
            return;
        }
        assert!(all.iter().any(|thread| thread.id == std::process::id()));
    }
}
