//! Settings of the running kernel that let it disturb a core or memory in use.

use super::{Assessed, Assessment, Scene};

checks! {
    RealTime sysctls, "kernel settings",
        "Some work that the kernel does by default moves memory in use, or comes onto a core that should be quiet.";
}

/// When a setting matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Matters {
    Always,
    /// Where the core has no tick, and so should be left alone.
    WithoutTick,
    /// Where microseconds count: without the tick, or at short periods.
    Finely,
}

/// A setting, the value from which on it is good or, at 0, the only good one, and what it does otherwise.
const SETTINGS: [(&str, i64, Matters, &str); 5] = [
    (
        "kernel.timer_migration",
        0,
        Matters::WithoutTick,
        "timers of idle cores move to busy ones, nohz_full or not",
    ),
    (
        "kernel.numa_balancing",
        0,
        Matters::Always,
        "takes pages away to see who uses them, also locked ones",
    ),
    (
        "vm.compact_unevictable_allowed",
        0,
        Matters::Always,
        "moves locked pages, and who touches one waits",
    ),
    (
        "kernel.nmi_watchdog",
        0,
        Matters::Finely,
        "interrupts every core, whatever its priority",
    ),
    (
        "vm.stat_interval",
        10,
        Matters::Finely,
        "counts on every core so often (in s)",
    ),
];
/// Below this period, microseconds count \[ms\].
const PERIOD_MS_FINE: f64 = 1.0;

fn sysctls(scene: &Scene) -> Assessed {
    let has_no_tick = scene.has_no_tick()?;
    let is_fine = has_no_tick || scene.plan.period_ms < PERIOD_MS_FINE;
    let (mut values, mut remedies) = (Vec::new(), Vec::new());
    for (name, good, matters, does) in SETTINGS {
        let is_meant = match matters {
            Matters::Always => true,
            Matters::WithoutTick => has_no_tick,
            Matters::Finely => is_fine,
        };
        let path = format!("/proc/sys/{}", name.replace('.', "/"));
        // A kernel without the feature has no file.
        if !is_meant || scene.system.read_if_there(&path)?.is_none() {
            continue;
        }
        let value = scene.system.number(&path)?;
        let is_good = if good == 0 { value == 0 } else { value >= good };
        if !is_good {
            values.push(format!("{name} = {value}: {does}"));
            remedies.push(format!("{name}={good}"));
        }
    }
    if values.is_empty() {
        return Ok(Assessment::ok("none that disturbs the loop"));
    }
    let settings = remedies.join(" ");
    let remedy = format!("sudo sysctl {settings}   (and for good in /etc/sysctl.d/)");
    Ok(Assessment::warning(values.join("; "), remedy))
}
