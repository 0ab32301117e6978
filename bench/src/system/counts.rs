//! What the kernel counts: time of threads on and off their core, time that the hypervisor took.

use std::fs;
use std::path::Path;

/// One thread of a process, as the kernel counts it since its start.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ThreadCounts {
    /// Its id.
    pub id: u32,
    /// Its name, at most 15 bytes.
    pub name: String,
    /// Time on a core \[ns\].
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

/// Time that the hypervisor has kept this core from the machine since its start \[ms\], in steps of a tick
/// of 10 ms. None where the kernel does not count it.
pub fn steal_ms(core: usize) -> Option<f64> {
    steal_in(&fs::read_to_string("/proc/stat").ok()?, core)
}

/// The eighth number behind the name of the core, in hundredths of a second (proc(5)).
fn steal_in(stat: &str, core: usize) -> Option<f64> {
    let name = format!("cpu{core}");
    let mut lines = stat.lines();
    let line = lines.find(|line| line.split_ascii_whitespace().next() == Some(&name))?;
    let ticks: f64 = line.split_ascii_whitespace().nth(8)?.parse().ok()?;
    Some(ticks * 10.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_steal_of_a_core_is_read_as_proc_says() {
        let stat = "cpu 1 2 3 4 5 6 7 8 9 10\ncpu1 1 2 3 4 5 6 7 80 9 10\ncpu11 0 0 0 0 0 0 0 7 0 0\n";
        assert_eq!(steal_in(stat, 1), Some(800.0));
        assert_eq!(steal_in(stat, 11), Some(70.0));
        assert_eq!(steal_in(stat, 2), None);
    }

    #[test]
    fn our_own_threads_are_counted() {
        let all = threads(std::process::id());
        if all.is_empty() {
            println!("skipped: this kernel does not count what a thread ran");
            return;
        }
        assert!(all.iter().any(|thread| thread.id == std::process::id()));
    }
}
