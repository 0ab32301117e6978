//! The kernel's scheduler: pre-emption model, limits of real-time threads, and settings that disturb them.

use cdcr_shared_types::proc_stat::chosen;

use super::Severity::{Unknown, Warning};
use super::finding::{Assessed, problem, warn_unless};
use super::privileges::may_have_priority;
use super::{Observations, Reading};
use crate::core_budget::{CoreBudget, Costs};

/// Below this period, microseconds matter \[ms\]. From this period on, a fully pre-emptible kernel and the
/// tick are good enough.
pub(super) const PERIOD_MS_FINE: f64 = 1.0;

pub(super) fn preemption(observed: &Observations) -> Assessed {
    let system = &observed.system;
    let version = system.read("/proc/sys/kernel/version")?;
    let flag = system.read_if_there("/sys/kernel/realtime")?;
    let has = |word| version.contains(word);
    let (model, value) = if has("PREEMPT_RT") || flag.as_deref() == Some("1") {
        return Ok("PREEMPT_RT".to_owned());
    } else if has("PREEMPT_DYNAMIC") {
        let Some((model, since)) = dynamic_preemption(observed)? else {
            return problem!(Unknown, "dynamic, cannot read the current model"
                => "sudo mount -t debugfs none /sys/kernel/debug; sudo cat /sys/kernel/debug/sched/preempt");
        };
        (model.clone(), format!("dynamic, {model}{since}"))
    } else if has("PREEMPT") {
        ("full".to_owned(), "PREEMPT".to_owned())
    } else {
        let value = "none or voluntary, fixed when the kernel was built";
        ("none".to_owned(), value.to_owned())
    };
    let period_ms = observed.period_ms();
    // The lazy model delays ordinary threads only.
    match &*model {
        "full" | "lazy" if period_ms >= PERIOD_MS_FINE => Ok(value),
        "full" | "lazy" => problem!(Warning, "{value}; the period is {period_ms} ms"
            => "install a kernel with PREEMPT_RT"),
        _ => problem!(Warning, "{value}"
            => "boot with preempt=full, or at once: echo full | sudo tee /sys/kernel/debug/sched/preempt; best is a \
                kernel with PREEMPT_RT"),
    }
}

/// The model that was chosen at run time (its file is readable for root only), or at boot.
fn dynamic_preemption(observed: &Observations) -> Reading<Option<(String, &'static str)>> {
    let text = observed.system.read("/sys/kernel/debug/sched/preempt");
    if let Some(model) = chosen(&text.unwrap_or_default(), ['(', ')']) {
        return Ok(Some((model.to_owned(), "")));
    }
    let at_boot = observed.system.boot_option("preempt")?;
    Ok(at_boot.map(|model| (model, " at boot")))
}

pub(super) fn rt_throttling(observed: &Observations) -> Assessed {
    let Some(share) = observed.system.kernel_share()? else {
        return problem!(Warning, "off: a hung loop blocks the core"
            => "sudo sysctl kernel.sched_rt_runtime_us=950000");
    };
    let usual = CoreBudget::new(&observed.validated.config);
    let budget = usual.with_kernel_share(share);
    let costs = Costs::default();
    let value = format!(
        "at {:.1} % of a core; the loop limits itself to {:.1} %: {}; longer measured times of guard and exchange \
         reduce the solver budget",
        100.0 * share,
        100.0 * budget.share_max(),
        budget.describe(costs)
    );
    let is_usual = budget.solve_ns(costs) == usual.solve_ns(costs);
    warn_unless!(is_usual, "{value}" => "sudo sysctl kernel.sched_rt_runtime_us=950000")
}

pub(super) fn rt_group(observed: &Observations) -> Assessed {
    match group_runtime_us(observed)? {
        Some((file, 0)) => {
            problem!(observed.missing(), "this control group has no real-time runtime"
            => "echo 950000 | sudo tee {file}   (and first in the groups above it)")
        }
        Some((_, runtime_us)) => Ok(format!("{runtime_us} µs")),
        None if observed.probe.fifo.is_err() && may_have_priority(observed)? => {
            problem!(observed.missing(), "SCHED_FIFO is refused despite the privilege: probably CONFIG_RT_GROUP_SCHED"
            => "boot with rt_group_sched=0, or start cdcrd in the root control group")
        }
        None => Ok("no limit of a group".to_owned()),
    }
}

/// File and real-time runtime of this process's control group, if the kernel has version 1 of control groups
/// with real-time groups.
fn group_runtime_us(observed: &Observations) -> Reading<Option<(String, i64)>> {
    let system = &observed.system;
    let has_cpu = |list: &str| list.split(',').any(|name| name == "cpu");
    // Lines `1:cpu,cpuacct:/group`.
    let groups = system.read("/proc/self/cgroup")?;
    let group = groups.lines().find_map(|line| {
        let (controllers, group) = line.split_once(':')?.1.split_once(':')?;
        has_cpu(controllers).then_some(group)
    });
    // Lines `cgroup /sys/fs/cgroup/cpu cgroup rw,cpu 0 0`.
    let mounts = system.read("/proc/mounts")?;
    let mount = mounts.lines().find_map(|line| {
        let mut words = line.split_whitespace().skip(1);
        let (folder, kind, options) = (words.next()?, words.next()?, words.next()?);
        (kind == "cgroup" && has_cpu(options)).then_some(folder)
    });
    let (Some(group), Some(mount)) = (group, mount) else {
        return Ok(None);
    };
    // In a container the mount is the group itself.
    for folder in [format!("{mount}{group}"), mount.to_owned()] {
        let file = format!("{}/cpu.rt_runtime_us", folder.trim_end_matches('/'));
        if system.read_if_there(&file)?.is_some() {
            let runtime_us = system.number(&file)?;
            return Ok(Some((file, runtime_us)));
        }
    }
    Ok(None)
}

/// A setting of the kernel, its smallest good value (0: the only good one), when it matters, and its effect
/// otherwise. `tickless`: on a core without the tick; `fine`: also with short periods.
const SETTINGS: &str = "\
kernel.timer_migration | 0 | tickless | moves timers of idle cores to busy ones, even with nohz_full
kernel.numa_balancing | 0 | always | unmaps pages to track their use, including locked ones
vm.compact_unevictable_allowed | 0 | always | moves locked pages; a thread that uses one waits
kernel.nmi_watchdog | 0 | fine | interrupts every core, whatever its priority
vm.stat_interval | 10 | fine | updates counters on every core at this interval (s)";

pub(super) fn sysctls(observed: &Observations) -> Assessed {
    let has_no_tick = observed.has_no_tick()?;
    let is_fine = has_no_tick || observed.period_ms() < PERIOD_MS_FINE;
    let (mut values, mut settings) = (Vec::new(), Vec::new());
    for setting in SETTINGS.lines() {
        let parts: Vec<&str> = setting.split(" | ").collect();
        let &[name, good, matters, does] = &parts[..] else {
            continue;
        };
        let is_meant = matters == "always" || (matters == "fine" && is_fine) || has_no_tick;
        let path = format!("/proc/sys/{}", name.replace('.', "/"));
        // A kernel without the feature has no file.
        if !is_meant || observed.system.read_if_there(&path)?.is_none() {
            continue;
        }
        let value = observed.system.number(&path)?;
        let limit: i64 = good.parse().unwrap_or(0);
        if value != limit && (limit == 0 || value < limit) {
            values.push(format!("{name} = {value}: {does}"));
            settings.push(format!("{name}={good}"));
        }
    }
    if values.is_empty() {
        return Ok("none that disturb the loop".to_owned());
    }
    let [values, settings] = [values.join("; "), settings.join(" ")];
    problem!(Warning, "{values}" => "sudo sysctl {settings}   (permanently: /etc/sysctl.d/)")
}
