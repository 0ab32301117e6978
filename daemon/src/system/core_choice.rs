//! The choice of the core for the real-time threads, if the configuration leaves it open (`realtime.core =
//! -1`).

use std::cell::LazyCell;
use std::cmp::Reverse;
use std::time::Duration;

use crate::config::Validated;

use super::{CPU, CoreSet, CoreTimes, System, times_between};

/// A hyper-thread with less load is idle.
pub(crate) const SIBLING_SHARE: f64 = 0.05;
/// Time for which hyper-threads are observed, if there are any.
const WATCHED: Duration = Duration::from_millis(100);

/// The configuration with the chosen core, if it leaves the core open and the system reports its cores. A
/// running daemon of this robot keeps its core.
#[must_use]
pub(crate) fn with_core(validated: &Validated) -> Validated {
    let mut validated = validated.clone();
    if validated.config.realtime.core < 0 {
        let system = System::this();
        let ours = daemon_process(&validated);
        let times = || system.core_times().unwrap_or_default();
        let watch = || {
            let before = times();
            std::thread::sleep(WATCHED);
            times_between(&before, &times())
        };
        let core = choose(&system, ours, can_be_pinned, watch);
        let core = core.and_then(|core| i32::try_from(core).ok());
        validated.config.realtime.core = core.unwrap_or(-1);
    }
    validated
}

/// The process id of this robot's daemon, if it runs.
pub(crate) fn daemon_process(validated: &Validated) -> Option<u32> {
    let robot = &validated.config.robot.name;
    validated.location.presence(robot)?.process_id
}

/// This process may have a thread on `core`: its initial affinity does not include isolated cores.
pub(crate) fn can_be_pinned(core: usize) -> bool {
    let pin = move || core_affinity::set_for_current(core_affinity::CoreId { id: core });
    std::thread::spawn(pin).join().unwrap_or(false)
}

/// The best core for a loop, in order of preference: without another loop, isolated, fast, with idle
/// hyper-threads, the last one. If the process `ours` has a loop, its core. `watch` returns the times of the
/// cores within a while; it is called if there are hyper-threads.
pub(crate) fn choose(
    system: &System,
    ours: Option<u32>,
    can_be_pinned: impl Fn(usize) -> bool,
    watch: impl FnOnce() -> CoreTimes,
) -> Option<usize> {
    let loops = loops(system);
    if let Some((_, core)) = loops.iter().find(|(process, _)| Some(*process) == ours) {
        return Some(*core);
    }
    let isolated = system.cores("isolated").unwrap_or_default();
    let allowed = system.allowed("/proc/self").ok()?;
    let online = system.online().unwrap_or_else(|_| allowed.clone());
    let is_ours =
        |core: &usize| allowed.contains(core) || (isolated.contains(core) && can_be_pinned(*core));
    let candidates: Vec<usize> = online.iter().copied().filter(is_ours).collect();
    let slow = slow_cores(system, &candidates);
    let times = LazyCell::new(watch);
    let is_busy = |core: &usize| {
        let time = times.get(core).copied().unwrap_or_default();
        time.share(time.busy) > SIBLING_SHARE
    };
    candidates.into_iter().min_by_key(|core| {
        let siblings = system.siblings(*core).unwrap_or_default();
        (
            loops.iter().any(|(_, taken)| taken == core),
            !isolated.contains(core),
            slow.contains(core),
            siblings.iter().any(is_busy),
            Reverse(*core),
        )
    })
}

/// The processes with a loop pinned to a core, and that core.
///
/// Of other programs no thread is looked at: the kernel would keep an entry for each, which it has to remove when the thread ends.
fn loops(system: &System) -> Vec<(u32, usize)> {
    let is_named = |folder: &str, name: &str| {
        let comm = system.read(&format!("{folder}/comm"));
        comm.is_ok_and(|comm| comm == name)
    };
    let daemons = system.processes().into_iter();
    let daemons = daemons.filter(|process| is_named(&format!("/proc/{process}"), "cdcrd"));
    let pinned = daemons.filter_map(|process| {
        let mut threads = system.threads_of(process);
        let (_, folder) = threads.find(|(_, folder)| is_named(folder, "cdcr-cycle"))?;
        let cores = system.allowed(&folder).ok()?;
        let core = cores.first().filter(|_| cores.len() == 1)?;
        Some((process, *core))
    });
    pinned.collect()
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
