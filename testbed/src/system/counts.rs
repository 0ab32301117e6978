//! Counts of the kernel: time of threads on the core and waiting for it, time taken by the hypervisor, memory and
//! files of a process.

use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, Result};
use cdcr_shared_types::proc_stat::{self, TICK_NS, core_ticks};

/// Kernel counts of one thread since its start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThreadCounts {
    pub id: u32,
    pub name: String,
    pub on_core_ns: u64,
    /// Time that the thread was ready while another one had the core \[ns\].
    pub run_delay_ns: u64,
}

/// All threads of a process, without those that end during the call. Empty if the kernel does not count
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

/// Share of one core that the threads of this name used between two counts of a process. A new thread counts
/// from its start; an ended one is left out.
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

/// Time that the hypervisor has withheld this core since the start of the machine \[ms\], in ticks of 10 ms.
/// `None` if the kernel does not count it.
pub fn steal_ms(core: usize) -> Option<f64> {
    let stat = fs::read_to_string("/proc/stat").ok()?;
    let (_, ticks) = core_ticks(&stat).find(|(of, _)| *of == Some(core))?;
    Some((ticks.steal * TICK_NS) as f64 * 1e-6)
}

/// Numbers of `/proc/PID/status` at one moment, like the kilobytes of `VmRSS`. `VmLck` counts address ranges: more
/// than the resident memory.
pub fn status<const N: usize>(process: u32, keys: [&str; N]) -> Result<[u64; N]> {
    let text = fs::read_to_string(format!("/proc/{process}/status"))?;
    let mut numbers = [0; N];
    for (number, key) in numbers.iter_mut().zip(keys) {
        let found = proc_stat::field(&text, key).and_then(|value| value.split(' ').next());
        *number = found
            .with_context(|| format!("/proc/{process}/status has no {key}"))?
            .parse()?;
    }
    Ok(numbers)
}

/// Minor and major page faults of a process since its start.
pub fn page_faults(process: u32) -> Result<u64> {
    let stat = fs::read(format!("/proc/{process}/stat"))?;
    proc_stat::page_faults(&stat).context("/proc/PID/stat has no faults")
}

/// Number of files, folders searched, and their size in memory \[bytes\]; untouched pages take none.
pub fn files(paths: &[PathBuf]) -> (u64, u64) {
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
            // Another thread with the id of an ended one.
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
