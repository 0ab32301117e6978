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

#[cfg(test)]
mod tests {
    use super::super::Severity::{Ok as Good, Unknown, Warning};
    use super::super::fake::Fake;
    use super::super::sample::CoreLoad;
    use super::super::{CPU, Load};

    #[test]
    fn one_core_is_too_few() {
        let fake = |online: &str, allowed: &str| {
            Fake::new(&[
                (&format!("{CPU}/online"), online),
                (
                    "/proc/self/status",
                    &format!("Cpus_allowed_list: {allowed}"),
                ),
            ])
        };
        fake("0-3", "2-3").expect("cores", Good, &["4 online, 2 allowed"]);
        fake("0", "0").expect("cores", Warning, &["1 online"]);
        fake("0-3", "3").expect("cores", Warning, &["1 allowed"]);
        Fake::new(&[]).expect("cores", Unknown, &["online"]);
    }

    #[test]
    fn an_isolated_core_is_good_and_a_wasted_one_is_named() {
        let fake = |isolated: &str| {
            Fake::new(&[
                ("/sys/devices/system/cpu/online", "0-3"),
                ("/sys/devices/system/cpu/isolated", isolated),
            ])
        };
        fake("1-2").expect("isolation", Good, &["core 1"]);
        fake("3").expect("isolation", Warning, &["realtime.core = 3"]);
        fake("\n").expect("isolation", Warning, &["isolcpus=managed_irq,domain,1"]);
        Fake::new(&[]).expect("isolation", Unknown, &[]);
    }

    #[test]
    fn the_tick_matters_to_short_periods() {
        let mut fake = Fake::new(&[("/proc/cmdline", "quiet")]);
        fake.write(&format!("{CPU}/nohz_full"), "(null)");
        fake.expect("tick", Good, &["tick stays"]);
        fake.scene.plan.period_ms = 0.5;
        fake.expect("tick", Warning, &["nohz_full=1"]);
        fake.write("/proc/cmdline", "rcu_nocbs=all");
        fake.expect("tick", Warning, &["callbacks gone"]);
        fake.write(&format!("{CPU}/nohz_full"), "1-3");
        fake.expect("tick", Good, &["tick gone"]);
    }

    #[test]
    fn a_sibling_at_work_is_bad() {
        let path = format!("{CPU}/cpu1/topology/thread_siblings_list");
        let mut fake = Fake::new(&[(&path, "1")]);
        fake.expect("siblings", Good, &["alone"]);
        fake.write(&path, "1,3");
        let mut load = Load::default();
        let busy = |busy| CoreLoad {
            busy,
            ..CoreLoad::default()
        };
        load.cores.insert(3, busy(0.01));
        fake.scene.load = Ok(load.clone());
        fake.expect("siblings", Good, &["core 3"]);
        load.cores.insert(3, busy(0.5));
        fake.scene.load = Ok(load);
        fake.expect("siblings", Unknown, &["online"]);
        fake.write(&format!("{CPU}/online"), "0-3");
        fake.expect("siblings", Warning, &["50 %", "cpu3/online"]);
    }

    #[test]
    fn a_sibling_is_switched_off_only_where_a_core_is_left() {
        let remedy = |siblings: &str, online: &str| {
            let path = format!("{CPU}/cpu1/topology/thread_siblings_list");
            let files = [(&*path, siblings), (&format!("{CPU}/online"), online)];
            let mut fake = Fake::new(&files);
            let mut load = Load::default();
            for core in [0, 2, 3] {
                let busy = CoreLoad {
                    busy: 0.5,
                    ..CoreLoad::default()
                };
                load.cores.insert(core, busy);
            }
            fake.scene.load = Ok(load);
            assert_eq!(fake.severity("siblings"), Warning);
            fake.assess("siblings").remedy
        };
        let file = |core| format!("{CPU}/cpu{core}/online");
        assert_eq!(
            remedy("1,3", "0-3"),
            format!("echo 0 | sudo tee {}", file(3))
        );
        let two = format!("echo 0 | sudo tee {} {}", file(2), file(3));
        assert_eq!(remedy("1-3", "0-3"), two);
        // Core 0 stays, whoever shares with it.
        assert_eq!(remedy("0-1", "0-3"), "set realtime.core to one of 2-3");
        // Everything else needs a core, too.
        assert!(remedy("0-1", "0-1").contains("two physical cores"));
        assert!(remedy("1,3", "1,3").contains("two physical cores"));
    }

    #[test]
    fn a_governor_that_saves_is_bad() {
        let path = format!("{CPU}/cpu1/cpufreq/scaling_governor");
        let fake = Fake::new(&[]);
        fake.expect("governor", Good, &["none"]);
        fake.write(&path, "performance\n");
        fake.expect("governor", Good, &["performance"]);
        fake.write(&path, "powersave\n");
        fake.expect("governor", Warning, &["powersave", "echo performance"]);
    }

    #[test]
    fn deep_sleep_is_kept_away_where_it_can_be() {
        let mut fake = Fake::new(&[]);
        fake.expect("deep_sleep", Good, &["none"]);
        for (state, name, latency) in [(0, "POLL", "0"), (1, "C1", "2"), (2, "C6", "133")] {
            let folder = format!("{CPU}/cpu1/cpuidle/state{state}");
            fake.write(&format!("{folder}/name"), name);
            fake.write(&format!("{folder}/latency"), latency);
            fake.write(&format!("{folder}/disable"), "0");
        }
        fake.expect("deep_sleep", Good, &["C6, 133 µs", "keeps it away"]);
        fake.scene.plan.no_deep_sleep = false;
        fake.expect("deep_sleep", Warning, &["no_deep_sleep = true"]);
        fake.scene.plan.no_deep_sleep = true;
        fake.scene.probe.deep_sleep_lock = Err("permission denied".to_owned());
        fake.expect("deep_sleep", Warning, &["permission denied", "chmod"]);
        fake.write(&format!("{CPU}/cpu1/cpuidle/state2/disable"), "1");
        fake.expect("deep_sleep", Good, &["C1, 2 µs"]);
        fake.write(&format!("{CPU}/cpu1/cpuidle/state1/latency"), "soon");
        fake.expect("deep_sleep", Unknown, &["soon"]);
    }
}
