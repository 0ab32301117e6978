//! The kernel's scheduler: pre-emption, and what it takes from real-time threads.

use crate::core_budget::{Costs, KERNEL_SHARE};

use super::privileges::may_have_priority;
use super::system::chosen_of;
use super::{Assessed, Assessment, Scene, System, Unreadable};

/// How long real-time threads may run in a second of [`kernel_share`]; -1: there is no limit.
pub(super) const RT_RUNTIME_US: &str = "/proc/sys/kernel/sched_rt_runtime_us";

/// The share of a core that the kernel leaves to real-time threads. Without a limit (-1) the default one is kept:
/// ordinary tasks of the core starve otherwise, those of the kernel among them.
pub(crate) fn kernel_share(system: &System) -> Result<f64, Unreadable> {
    let runtime_us = system.number(RT_RUNTIME_US)?;
    let period_us = system.number("/proc/sys/kernel/sched_rt_period_us")?;
    Ok(if runtime_us < 0 {
        KERNEL_SHARE
    } else {
        (runtime_us as f64 / period_us.max(1) as f64).min(KERNEL_SHARE)
    })
}

checks! {
    RealTime preemption, "pre-emption model",
        "Where the kernel does not let itself be interrupted, the cycle waits until it has finished.";
    RealTime rt_throttling, "RT throttling",
        "The kernel halts real-time threads beyond their share of a second; without a limit a hung one keeps its core for ever.";
    RealTime rt_group, "RT group",
        "In a control group without real-time runtime, SCHED_FIFO is refused even to root.";
}

/// From this period on, a kernel that can be interrupted everywhere is good enough without `PREEMPT_RT`.
const PERIOD_MS_FULL: f64 = 1.0;

fn preemption(scene: &Scene) -> Assessed {
    let system = &scene.system;
    let version = system.read("/proc/sys/kernel/version")?;
    let flag = system.read_if_there("/sys/kernel/realtime")?;
    if version.contains("PREEMPT_RT") || flag.as_deref() == Some("1") {
        return Ok(Assessment::ok("PREEMPT_RT"));
    }
    if version.contains("PREEMPT_DYNAMIC") {
        return dynamic_preemption(scene);
    }
    Ok(if version.contains("PREEMPT") {
        of_model(scene, "full", "PREEMPT")
    } else {
        of_model(
            scene,
            "none",
            "none or voluntary, fixed when the kernel was built",
        )
    })
}

/// The model can be chosen at run time; the file that tells it is readable for root only.
fn dynamic_preemption(scene: &Scene) -> Assessed {
    let told = scene.system.read("/sys/kernel/debug/sched/preempt");
    let chosen = told
        .as_deref()
        .ok()
        .and_then(|text| chosen_of(text, ['(', ')']));
    if let Some(model) = chosen {
        return Ok(of_model(scene, model, &format!("dynamic, {model}")));
    }
    if let Some(model) = scene.system.boot_option("preempt")? {
        let value = format!("dynamic, {model} at boot");
        return Ok(of_model(scene, &model, &value));
    }
    Ok(Assessment::unknown(
        "dynamic, the model in force cannot be read",
        "sudo mount -t debugfs none /sys/kernel/debug; sudo cat /sys/kernel/debug/sched/preempt",
    ))
}

fn of_model(scene: &Scene, model: &str, value: &str) -> Assessment {
    // A lazy kernel is lazy towards ordinary threads only.
    let is_full = matches!(model, "full" | "lazy");
    if is_full && scene.plan.period_ms >= PERIOD_MS_FULL {
        return Assessment::ok(value);
    }
    if is_full {
        return Assessment::warning(
            format!("{value}; the period is {} ms", scene.plan.period_ms),
            "install a kernel with PREEMPT_RT",
        );
    }
    Assessment::warning(
        value,
        "boot with preempt=full, or at once: echo full | sudo tee /sys/kernel/debug/sched/preempt; best is a \
         kernel with PREEMPT_RT",
    )
}

fn rt_throttling(scene: &Scene) -> Assessed {
    let share = kernel_share(&scene.system)?;
    if scene.system.number(RT_RUNTIME_US)? < 0 {
        return Ok(Assessment::warning(
            "off: nothing guards the core from a hung loop",
            "sudo sysctl kernel.sched_rt_runtime_us=950000",
        ));
    }
    let usual = scene.plan.core_budget;
    let budget = usual.with_kernel_share(share);
    let costs = Costs::default();
    let value = format!(
        "at {:.1} % of a core, of which the loop keeps to {:.1} %: {}, and what guard and exchange are measured to take \
         beyond that is taken from the solver",
        100.0 * share,
        100.0 * budget.share_max(),
        budget.describe(costs)
    );
    let is_enough = budget.solve_ns(costs) == usual.solve_ns(costs);
    let remedy = "sudo sysctl kernel.sched_rt_runtime_us=950000";
    Ok(Assessment::good_if(is_enough, value, remedy))
}

fn rt_group(scene: &Scene) -> Assessed {
    if let Some((file, runtime_us)) = group_runtime_us(scene)? {
        return Ok(if runtime_us == 0 {
            scene.plan.missing(
                "this control group has no real-time runtime",
                format!("echo 950000 | sudo tee {file}   (and first in the groups above it)"),
            )
        } else {
            Assessment::ok(format!("{runtime_us} µs"))
        });
    }
    if scene.probe.fifo.is_err() && may_have_priority(scene)? {
        return Ok(scene.plan.missing(
            "SCHED_FIFO is refused in spite of the privilege: probably CONFIG_RT_GROUP_SCHED",
            "boot with rt_group_sched=0, or start cdcrd in the root control group",
        ));
    }
    Ok(Assessment::ok("no limit of a group"))
}

/// The file and the real-time runtime of this process's group, where the kernel has version 1 of control
/// groups with real-time groups.
fn group_runtime_us(scene: &Scene) -> Result<Option<(String, i64)>, Unreadable> {
    let system = &scene.system;
    let (groups, mounts) = (
        system.read("/proc/self/cgroup")?,
        system.read("/proc/mounts")?,
    );
    let (Some(group), Some(mount)) = (cpu_group(&groups), cpu_mount(&mounts)) else {
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

/// Lines `1:cpu,cpuacct:/group`.
fn cpu_group(groups: &str) -> Option<&str> {
    groups.lines().find_map(|line| {
        let (controllers, group) = line.split_once(':')?.1.split_once(':')?;
        controllers
            .split(',')
            .any(|name| name == "cpu")
            .then_some(group)
    })
}

/// Lines `cgroup /sys/fs/cgroup/cpu cgroup rw,cpu 0 0`.
fn cpu_mount(mounts: &str) -> Option<&str> {
    mounts.lines().find_map(|line| {
        let mut words = line.split_whitespace().skip(1);
        let (folder, kind, options) = (words.next()?, words.next()?, words.next()?);
        let is_cpu = kind == "cgroup" && options.split(',').any(|option| option == "cpu");
        is_cpu.then_some(folder)
    })
}

#[cfg(test)]
mod tests {
    use super::super::fake::Fake;
    use super::*;

    #[test]
    fn the_kernels_share_is_read_and_no_limit_is_the_default_one() {
        let fake = Fake::new(&[("/proc/sys/kernel/sched_rt_period_us", "1000000")]);
        for (runtime_us, share) in [
            ("950000", Some(0.95)),
            ("500000", Some(0.5)),
            ("1000000", Some(0.95)),
            ("-1", Some(0.95)),
            ("many", None),
        ] {
            fake.write(RT_RUNTIME_US, runtime_us);
            assert_eq!(kernel_share(&fake.scene.system).ok(), share);
        }
    }
}
