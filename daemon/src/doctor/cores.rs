//! The core of the real-time threads: its isolation, its siblings, its wake-up.

use super::Severity::Warning;
use super::finding::{Assessed, problem, warn_unless};
use super::scheduler::PERIOD_MS_FINE;
use super::{CPU, CoreSet, Observations, Reading};
use crate::system::SIBLING_SHARE;

/// A sleep state with a shorter exit latency is not deep \[µs\].
const EXIT_US: i64 = 20;

pub(super) fn cores(observed: &Observations) -> Assessed {
    let online = observed.system.online()?.len();
    let allowed = observed.system.allowed("/proc/self")?.len();
    warn_unless!(online.min(allowed) > 1, "{online} online, {allowed} allowed"
        => "use a machine or a control group with two cores or more")
}

pub(super) fn isolation(observed: &Observations) -> Assessed {
    let core = observed.core()?;
    let isolated = observed.system.cores("isolated")?;
    if isolated.contains(&core) {
        return Ok(format!("core {core} is isolated"));
    }
    if let Some(better) = isolated.first() {
        return problem!(Warning, "core {core} is not isolated, but {isolated} is"
            => "set realtime.core = {better}");
    }
    if observed.system.online()?.len() < 2 {
        return problem!(Warning, "the only core cannot be isolated"
            => "use a machine with two cores or more");
    }
    problem!(Warning, "core {core} is not isolated"
        => "boot with isolcpus=managed_irq,domain,{core} nohz_full={core} rcu_nocbs={core}, and set \
            kernel.timer_migration=0 in /etc/sysctl.d/")
}

pub(super) fn tick(observed: &Observations) -> Assessed {
    let core = observed.core()?;
    let has_no_tick = observed.has_no_tick()?;
    let callbacks = observed.system.boot_option("rcu_nocbs")?;
    let callbacks = CoreSet::parse(&callbacks.unwrap_or_default());
    let value = match (has_no_tick, callbacks.contains(&core)) {
        // A core without the tick is also freed from callbacks.
        (true, _) => "nohz_full: timer tick off; rcu_nocbs: RCU callbacks off",
        (false, true) => "nohz_full: timer tick on; rcu_nocbs: RCU callbacks off",
        (false, false) => "nohz_full: timer tick on; rcu_nocbs: RCU callbacks on",
    };
    let period_ms = observed.period_ms();
    if has_no_tick || period_ms >= PERIOD_MS_FINE {
        return Ok(value.to_owned());
    }
    problem!(Warning, "{value}; the period is {period_ms} ms"
        => "boot with nohz_full={core} rcu_nocbs={core}, and set kernel.timer_migration=0 in /etc/sysctl.d/")
}

pub(super) fn siblings(observed: &Observations) -> Assessed {
    let core = observed.core()?;
    let siblings = observed.system.siblings(core)?;
    if siblings.is_empty() {
        return Ok(format!("core {core} shares no physical core"));
    }
    let times = &observed.load()?.cores;
    let times = siblings.iter().filter_map(|core| times.get(core));
    let busy = times.map(|time| time.share(time.busy));
    let busy = busy.fold(0.0, f64::max);
    let percent = 100.0 * busy;
    let value = format!("shared with core {siblings}, busy for {percent:.0} % of this second");
    if busy < SIBLING_SHARE {
        return Ok(value);
    }
    let remedy = rest_alone(observed, &siblings)?;
    problem!(Warning, "{value}" => "{remedy}")
}

/// The remedy that gives the core a physical core of its own. Siblings are switched off only if another core is
/// left for everything else; core 0 cannot be.
fn rest_alone(observed: &Observations, siblings: &CoreSet) -> Reading {
    let without = |left: CoreSet, core: &usize| left.without(*core);
    let apart = siblings.iter().fold(observed.other_cores()?, without);
    if apart.is_empty() {
        return Ok("use a machine with two physical cores or more".to_owned());
    }
    if siblings.contains(&0) {
        return Ok(format!("set realtime.core to one of {apart}"));
    }
    let file = |core: &usize| format!(" {CPU}/cpu{core}/online");
    let files: String = siblings.iter().map(file).collect();
    Ok(format!("echo 0 | sudo tee{files}"))
}

pub(super) fn governor(observed: &Observations) -> Assessed {
    let path = format!("{CPU}/cpu{}/cpufreq/scaling_governor", observed.core()?);
    match observed.system.read_if_there(&path)? {
        None => Ok("none: the system does not choose the frequency".to_owned()),
        Some(governor) if governor == "performance" => Ok(governor),
        Some(other) => problem!(Warning, "{other}" => "echo performance | sudo tee {path}"),
    }
}

pub(super) fn deep_sleep(observed: &Observations) -> Assessed {
    let Some((exit_us, name)) = deepest_sleep(observed)? else {
        return Ok("none: the system does not choose how to sleep".to_owned());
    };
    let value = format!("{name}, {exit_us} µs to wake up");
    match &observed.probe.deep_sleep_lock {
        _ if exit_us <= EXIT_US => Ok(value),
        _ if !observed.realtime().no_deep_sleep => {
            problem!(Warning, "{value}; realtime.no_deep_sleep is false"
            => "set realtime.no_deep_sleep = true")
        }
        Ok(()) => Ok(format!("{value}; disabled by the daemon")),
        Err(refusal) => {
            problem!(Warning, "{value}; cannot open /dev/cpu_dma_latency: {refusal}"
            => "sudo chgrp \"$(id -gn)\" /dev/cpu_dma_latency && sudo chmod g+w /dev/cpu_dma_latency")
        }
    }
}

/// Exit latency \[µs\] and name of the deepest enabled sleep state.
fn deepest_sleep(observed: &Observations) -> Reading<Option<(i64, String)>> {
    let system = &observed.system;
    let core = observed.core()?;
    let mut deepest = None;
    for state in 0.. {
        let folder = format!("{CPU}/cpu{core}/cpuidle/state{state}");
        let Some(name) = system.read_if_there(&format!("{folder}/name"))? else {
            break;
        };
        let is_off = system.read_if_there(&format!("{folder}/disable"))?;
        if is_off.is_none_or(|flag| flag == "0") {
            let exit_us = system.number(&format!("{folder}/latency"))?;
            deepest = deepest.max(Some((exit_us, name)));
        }
    }
    Ok(deepest)
}
