//! The choice of the core for the real-time threads, if the configuration leaves it open (`realtime.core =
//! -1`).

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::time::Duration;

use crate::config::Validated;

use super::{CPU, CoreSet, System, core_loads, core_times};

/// A hyper-thread with less load is idle.
pub(crate) const SIBLING_SHARE: f64 = 0.05;
/// Time for which hyper-threads are observed, if there are any.
const WATCHED: Duration = Duration::from_millis(100);
/// Name of a loop's thread, and of its program.
const LOOP: (&str, &str) = ("cdcr-cycle", "cdcrd");

/// The configuration with the chosen core, if it leaves the core open and the system reports its cores. A
/// running daemon of this robot keeps its core.
#[must_use]
pub(crate) fn with_core(validated: &Validated) -> Validated {
    let mut validated = validated.clone();
    if validated.config.realtime.core < 0 {
        let system = System::this();
        let ours = daemon_process(&system, &validated);
        let wait = || std::thread::sleep(WATCHED);
        let core = choose(&system, ours, can_be_pinned, wait);
        validated.config.realtime.core =
            core.and_then(|core| i32::try_from(core).ok()).unwrap_or(-1);
    }
    validated
}

/// The process id in the lock file of this robot's daemon.
pub(crate) fn daemon_process(system: &System, validated: &Validated) -> Option<u32> {
    let name = &validated.config.robot.name;
    let lock_file = validated.location.lock_file(name);
    let id = system.number(&lock_file.to_string_lossy()).ok()?;
    u32::try_from(id).ok()
}

/// This process may have a thread on `core`: its initial affinity does not include isolated cores.
pub(crate) fn can_be_pinned(core: usize) -> bool {
    let pin = move || core_affinity::set_for_current(core_affinity::CoreId { id: core });
    std::thread::spawn(pin).join().unwrap_or(false)
}

/// The best core for a loop, in order of preference: without another loop, isolated, fast, with idle
/// hyper-threads, the last one. If the process `ours` has a loop, its core. The hyper-threads are observed
/// during `wait`.
pub(crate) fn choose(
    system: &System,
    ours: Option<u32>,
    can_be_pinned: impl Fn(usize) -> bool,
    wait: impl Fn(),
) -> Option<usize> {
    let loops = loops(system);
    if let Some((_, core)) = loops.iter().find(|(process, _)| Some(*process) == ours) {
        return Some(*core);
    }
    let isolated = system.cores("isolated").unwrap_or_default();
    let allowed = system.allowed().ok()?;
    let online = system.online().unwrap_or_else(|_| allowed.clone());
    let is_ours =
        |core: &usize| allowed.contains(core) || (isolated.contains(core) && can_be_pinned(*core));
    let candidates: Vec<usize> = online.iter().copied().filter(is_ours).collect();
    let slow = slow_cores(system, &candidates);
    let busy = busy_siblings(system, &candidates, wait);
    candidates.into_iter().min_by_key(|core| {
        (
            loops.iter().any(|(_, taken)| taken == core),
            !isolated.contains(core),
            slow.contains(core),
            busy.contains(core),
            Reverse(*core),
        )
    })
}

/// The processes with a loop pinned to a core, and that core.
fn loops(system: &System) -> Vec<(u32, usize)> {
    let is_named = |folder: &str, name: &str| {
        let comm = system.read(&format!("{folder}/comm"));
        comm.is_ok_and(|comm| comm == name)
    };
    let (thread_name, program) = LOOP;
    let mut loops = Vec::new();
    let processes = system.numbers("/proc").into_iter();
    for process in processes.filter(|id| is_named(&format!("/proc/{id}"), program)) {
        for id in system.numbers(&format!("/proc/{process}/task")) {
            let folder = format!("/proc/{process}/task/{id}");
            let cores = system.allowed_to(&folder);
            if is_named(&folder, thread_name) && cores.len() == 1 {
                loops.extend(cores.iter().map(|core| (process, *core)));
            }
        }
    }
    loops
}

/// Cores that are slower by design: efficiency cores, and the small ones of big.LITTLE.
fn slow_cores(system: &System, cores: &[usize]) -> Vec<usize> {
    let efficient = system.read("/sys/devices/cpu_atom/cpus");
    let efficient = CoreSet::parse(&efficient.unwrap_or_default());
    let capacity = |core: usize| system.number(&format!("{CPU}/cpu{core}/cpu_capacity")).ok();
    let largest = cores.iter().filter_map(|core| capacity(*core)).max();
    let is_slow = |core: &usize| efficient.contains(core) || capacity(*core) < largest;
    cores.iter().copied().filter(is_slow).collect()
}

/// Cores that share their hardware with a core that is busy during `wait`.
fn busy_siblings(system: &System, cores: &[usize], wait: impl Fn()) -> Vec<usize> {
    let siblings = |core: &usize| (*core, system.siblings(*core).unwrap_or_default());
    let mut shared: BTreeMap<usize, CoreSet> = cores.iter().map(siblings).collect();
    shared.retain(|_, siblings| !siblings.is_empty());
    if shared.is_empty() {
        return Vec::new();
    }
    let look = || core_times(&system.read("/proc/stat").unwrap_or_default());
    let before = look();
    wait();
    let loads = core_loads(&before, &look());
    let is_busy = |core: &usize| loads.get(core).map_or(0.0, |load| load.busy) > SIBLING_SHARE;
    shared.retain(|_, siblings| siblings.iter().any(is_busy));
    shared.into_keys().collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::Files;
    use super::*;

    /// `doctor/findings.txt` has the cases of online, allowed and occupied cores.
    #[test]
    fn a_core_whose_hyper_thread_is_at_work_is_left_alone() {
        let files = Files::new(&[
            ("/sys/devices/system/cpu/online", "0-3"),
            ("/proc/self/status", "Cpus_allowed_list:\t0-3"),
        ]);
        for (core, siblings) in [(0, "0,2"), (1, "1,3"), (2, "0,2"), (3, "1,3")] {
            let path = format!("{CPU}/cpu{core}/topology/thread_siblings_list");
            files.write(&path, siblings);
        }
        let stat = |busy| format!("cpu0 0 0 0 9 0 0 0 0\ncpu1 {busy} 0 0 9 0 0 0 0\n");
        files.write("/proc/stat", stat(0));
        let system = &files.system;
        assert_eq!(choose(system, None, |_| true, || ()), Some(3));
        let work = || files.write("/proc/stat", stat(100));
        assert_eq!(choose(system, None, |_| true, work), Some(2));
    }
}
