//! The core of the real-time threads: whom it is kept from, with whom it shares, how fast it wakes up.

use super::{Assessed, Assessment, CPU, CoreSet, Scene, Unreadable};

checks! {
    RealTime cores, "number of cores",
        "On a single core everything else runs between the cycles, on what they leave.";
    RealTime isolation, "isolated core",
        "The system puts ordinary threads on every core that is not isolated.";
    RealTime tick, "timer tick",
        "The tick and deferred work of the kernel cost every core microseconds, hundreds of times a second.";
    RealTime siblings, "hyper-threads",
        "Two threads on one physical core slow each other down to about half.";
    RealTime governor, "frequency governor",
        "A governor that saves power slows the core down between cycles, and a solve then takes longer.";
    RealTime deep_sleep, "deep sleep",
        "Out of a deep sleep a core needs up to hundreds of microseconds to wake up.";
}

pub(super) const TWO_CORES: &str = "use a machine with two cores or more";
/// From this period on, the tick is small beside the period.
const PERIOD_MS_TICK: f64 = 1.0;
/// A sibling with less load is idle.
pub(super) const SIBLING_SHARE: f64 = 0.05;
/// A sleep with a shorter way out is not deep \[µs\].
const EXIT_US: i64 = 20;

fn cores(scene: &Scene) -> Assessed {
    let online = scene.system.online()?;
    let [online, allowed] = [online.count(), scene.system.allowed()?.count()];
    Ok(Assessment::good_if(
        online.min(allowed) > 1,
        format!("{online} online, {allowed} allowed"),
        "use a machine, or a control group, with two cores or more",
    ))
}

fn isolation(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let isolated = scene.system.cores("isolated")?;
    if isolated.contains(core) {
        return Ok(Assessment::ok(format!("core {core} is isolated")));
    }
    if let Some(better) = isolated.iter().next() {
        return Ok(Assessment::warning(
            format!("core {core} is not isolated, but {isolated} is"),
            format!("set realtime.core = {better}"),
        ));
    }
    if scene.system.online()?.count() < 2 {
        let value = "the only core cannot be isolated";
        return Ok(Assessment::warning(value, TWO_CORES));
    }
    Ok(Assessment::warning(
        format!("core {core} is open to everybody"),
        format!(
            "boot with isolcpus=managed_irq,domain,{core} nohz_full={core} rcu_nocbs={core}, and set \
             kernel.timer_migration=0 in /etc/sysctl.d/"
        ),
    ))
}

fn tick(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let has_no_tick = scene.has_no_tick()?;
    let callbacks = scene.system.boot_option("rcu_nocbs")?;
    // A core without the tick is freed from callbacks, too.
    let has_no_callbacks =
        has_no_tick || CoreSet::parse(&callbacks.unwrap_or_default()).contains(core);
    let word = |is_gone: bool| if is_gone { "gone" } else { "stays" };
    let value = format!(
        "nohz_full: tick {}; rcu_nocbs: callbacks {}",
        word(has_no_tick),
        if has_no_callbacks { "gone" } else { "stay" }
    );
    if has_no_tick || scene.plan.period_ms >= PERIOD_MS_TICK {
        return Ok(Assessment::ok(value));
    }
    Ok(Assessment::warning(
        format!("{value}; the period is {} ms", scene.plan.period_ms),
        format!(
            "boot with nohz_full={core} rcu_nocbs={core}, and set kernel.timer_migration=0 in /etc/sysctl.d/"
        ),
    ))
}

fn siblings(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let siblings = scene.system.siblings(core)?;
    if siblings.count() == 0 {
        return Ok(Assessment::ok(format!(
            "core {core} has its hardware alone"
        )));
    }
    let loads = &scene.load()?.cores;
    let busy = siblings.iter().filter_map(|core| loads.get(&core));
    let busy = busy.map(|load| load.busy).fold(0.0, f64::max);
    let value = format!(
        "shared with core {siblings}, busy for {:.0} % of this second",
        100.0 * busy
    );
    Ok(if busy < SIBLING_SHARE {
        Assessment::ok(value)
    } else {
        Assessment::warning(value, rest_alone(scene, &siblings)?)
    })
}

/// How the core gets its hardware alone. The siblings are switched off only where another core is left for
/// everything else; core 0 cannot be.
fn rest_alone(scene: &Scene, siblings: &CoreSet) -> Result<String, Unreadable> {
    let others = scene.other_cores()?;
    let apart = siblings
        .iter()
        .fold(others, |left, core| left.without(core));
    if apart.count() == 0 {
        return Ok("use a machine with two physical cores or more".to_owned());
    }
    if siblings.contains(0) {
        return Ok(format!("set realtime.core to one of {apart}"));
    }
    let file = |core| format!("{CPU}/cpu{core}/online");
    let files: Vec<_> = siblings.iter().map(file).collect();
    Ok(format!("echo 0 | sudo tee {}", files.join(" ")))
}

fn governor(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let path = format!("{CPU}/cpu{core}/cpufreq/scaling_governor");
    Ok(match scene.system.read_if_there(&path)?.as_deref() {
        None => Assessment::ok("none: the system does not choose the frequency"),
        Some("performance") => Assessment::ok("performance"),
        Some(other) => Assessment::warning(other, format!("echo performance | sudo tee {path}")),
    })
}

fn deep_sleep(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let Some((name, exit_us)) = deepest_sleep(scene, core)? else {
        let value = "none: the system does not choose how to sleep";
        return Ok(Assessment::ok(value));
    };
    let value = format!("{name}, {exit_us} µs to wake up");
    if exit_us <= EXIT_US {
        return Ok(Assessment::ok(value));
    }
    Ok(
        match (&scene.probe.deep_sleep_lock, scene.plan.no_deep_sleep) {
            (Ok(()), true) => Assessment::ok(format!("{value}; the daemon keeps it away")),
            (_, false) => Assessment::warning(
                format!("{value}; realtime.no_deep_sleep is false"),
                "set realtime.no_deep_sleep = true",
            ),
            (Err(refusal), true) => Assessment::warning(
                format!("{value}; /dev/cpu_dma_latency cannot be opened: {refusal}"),
                "sudo chgrp \"$(id -gn)\" /dev/cpu_dma_latency && sudo chmod g+w /dev/cpu_dma_latency",
            ),
        },
    )
}

/// Name and longest way out \[µs\] of the deepest sleep that is allowed.
fn deepest_sleep(scene: &Scene, core: usize) -> Result<Option<(String, i64)>, Unreadable> {
    let folder = format!("{CPU}/cpu{core}/cpuidle");
    let mut deepest: Option<(String, i64)> = None;
    for state in scene.system.names(&folder) {
        let path = |file: &str| format!("{folder}/{state}/{file}");
        let is_off = scene.system.read_if_there(&path("disable"))?;
        if !state.starts_with("state") || is_off.is_some_and(|flag| flag != "0") {
            continue;
        }
        let exit_us = scene.system.number(&path("latency"))?;
        if deepest.as_ref().is_none_or(|(_, known)| *known < exit_us) {
            deepest = Some((scene.system.read(&path("name"))?, exit_us));
        }
    }
    Ok(deepest)
}
