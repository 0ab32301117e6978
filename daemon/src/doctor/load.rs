//! Who else uses the core.

use super::cores::TWO_CORES;
use super::sample::{Load, Thread};
use super::{Assessed, Assessment, CoreSet, Scene, Unreadable};

checks! {
    RealTime steal, "stolen time",
        "While the hypervisor lets another machine run on this core, no priority helps.";
    RealTime neighbours, "threads on the core",
        "Others on the core empty its caches, and keep the kernel busy there when the cycle is due.";
    RealTime realtime_neighbours, "real-time threads",
        "A real-time thread of the same or a higher priority goes before the loop.";
    RealTime interrupts, "interrupts",
        "Each interrupt on the core goes before the cycle, whatever its priority.";
    RealTime irqbalance, "irqbalance",
        "It moves interrupts to this core when others are busier.";
}

/// A smaller stolen share is a matter of how time is counted.
const STEAL_SHARE: f64 = 0.01;
/// Neighbours that use less together are housekeeping.
const NEIGHBOUR_SHARE: f64 = 0.05;
/// Interrupts of devices below this rate are rare beside the periods \[1/s\].
const INTERRUPT_HZ: f64 = 100.0;
/// How many of the largest are named.
const NAMED: usize = 3;

fn steal(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let load = scene.load()?.cores.get(&core);
    let load =
        load.ok_or_else(|| Unreadable::new(format!("the time of core {core}"), "not shown"))?;
    let value = format!(
        "{:.1} % in this second, {:.2} % since the machine started",
        100.0 * load.steal,
        100.0 * load.steal_since_start
    );
    Ok(Assessment::good_if(
        load.steal.max(load.steal_since_start) < STEAL_SHARE,
        value,
        "ask for dedicated (pinned) cores for this virtual machine",
    ))
}

fn neighbours(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let neighbours = &scene.load()?.neighbours;
    let sum: f64 = neighbours.iter().map(|neighbour| neighbour.share).sum();
    let named = neighbours.iter().take(NAMED).map(|neighbour| {
        let Thread { name, id, .. } = &neighbour.thread;
        format!("{name} ({id}) {:.0} %", 100.0 * neighbour.share)
    });
    let named: Vec<_> = named.collect();
    if named.is_empty() {
        return Ok(Assessment::ok(format!("nobody else on core {core}")));
    }
    let value = format!("{:.0} % of core {core}: {}", 100.0 * sum, named.join(", "));
    let remedy = away(scene, &neighbours[0].thread);
    Ok(Assessment::good_if(sum < NEIGHBOUR_SHARE, value, remedy))
}

/// The command that moves a thread to other cores.
fn away(scene: &Scene, thread: &Thread) -> String {
    let others = scene.other_cores().unwrap_or_default();
    if is_daemons(thread) {
        return apart(&others);
    }
    if thread.is_kernel || others == CoreSet::default() {
        return "isolate the core (see `isolated core`)".to_owned();
    }
    format!(
        "sudo taskset -pc {others} {}   (or isolate the core)",
        thread.id
    )
}

/// A thread that another daemon of ours has pinned here: its core is a matter of its configuration.
fn is_daemons(thread: &Thread) -> bool {
    !thread.is_kernel && matches!(&*thread.name, "cdcr-cycle" | "cdcr-exchange")
}

/// What to do about two daemons on one core.
fn apart(others: &CoreSet) -> String {
    if others.count() == 0 {
        return "use a machine with two cores or more: another cdcrd has the only one".to_owned();
    }
    format!("set another realtime.core (of {others}) for this cdcrd or for the other one")
}

fn realtime_neighbours(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let limit = scene.plan.exchange_priority;
    let (kernel, programs): (Vec<_>, Vec<_>) = rivals(scene.load()?, core, limit)
        .into_iter()
        .partition(|thread| thread.is_kernel);
    let named = |threads: &[&Thread]| {
        let words: Vec<_> = threads.iter().take(NAMED).map(|t| described(t)).collect();
        words.join(", ")
    };
    let Some(first) = programs.first() else {
        return Ok(Assessment::ok(if kernel.is_empty() {
            "none that could go before the loop".to_owned()
        } else {
            format!("only {} of the kernel's: {}", kernel.len(), named(&kernel))
        }));
    };
    let value = format!(
        "{} may use core {core}: {}",
        programs.len(),
        named(&programs)
    );
    Ok(Assessment::warning(value, stood_back(scene, first)))
}

/// The command after which a program's real-time thread does not go before the loop.
fn stood_back(scene: &Scene, thread: &Thread) -> String {
    let others = scene.other_cores().unwrap_or_default();
    if is_daemons(thread) {
        apart(&others)
    } else if others.count() > 0 {
        format!("sudo taskset -pc {others} {}", thread.id)
    } else {
        format!("sudo chrt -f -p 1 {}", thread.id)
    }
}

/// A real-time thread; one of the kernel with what it is there for.
fn described(thread: &Thread) -> String {
    let policy = if thread.is_deadline {
        "deadline"
    } else {
        "priority"
    };
    let Thread { name, id, .. } = thread;
    let known = format!("{name} ({id}) {policy} {}", thread.priority);
    if thread.is_kernel {
        format!("{known}, {}", errand(name))
    } else {
        known
    }
}

/// What a real-time thread of the kernel does. All of them are idle unless the kernel itself needs them, and
/// the machine needs them then: their priorities are left alone.
fn errand(name: &str) -> &'static str {
    let known = [
        ("migration/", "moves threads between cores"),
        ("watchdog", "restarts a machine that hangs"),
        ("idle_inject/", "keeps the processor from overheating"),
        ("sugov:", "sets the frequency"),
        ("irq/", "serves a device"),
        ("rcu", "frees memory of the kernel"),
    ];
    let found = known.iter().find(|(begin, _)| name.starts_with(begin));
    found.map_or("a helper of the kernel", |(_, errand)| errand)
}

/// Threads that may go before the exchange on the core, and programs that are there for good.
fn rivals(load: &Load, core: usize, exchange_priority: i32) -> Vec<&Thread> {
    let is_rival = |thread: &&Thread| {
        let goes_before = thread.is_deadline || thread.priority >= exchange_priority;
        let is_pinned_here = thread.allowed.count() == 1 && !thread.is_kernel;
        thread.allowed.contains(core) && (goes_before || is_pinned_here)
    };
    load.realtime.iter().filter(is_rival).collect()
}

fn interrupts(scene: &Scene) -> Assessed {
    let core = scene.core()?;
    let rates = &scene.load()?.interrupts;
    let named = rates.iter().take(NAMED).map(|rate| {
        format!(
            "{} ({}) {:.0}/s",
            rate.label, rate.description, rate.rate_hz
        )
    });
    let named: Vec<_> = named.collect();
    if named.is_empty() {
        return Ok(Assessment::ok(format!("none on core {core}")));
    }
    let devices = || rates.iter().filter(|rate| rate.is_device());
    let device_hz: f64 = devices().map(|rate| rate.rate_hz).sum();
    let value = format!("{device_hz:.0}/s of devices; largest {}", named.join(", "));
    let Some(worst) = devices().next().filter(|_| device_hz >= INTERRUPT_HZ) else {
        return Ok(Assessment::ok(value));
    };
    let others = scene.other_cores()?;
    let remedy = if others.count() == 0 {
        TWO_CORES.to_owned()
    } else {
        format!(
            "echo {others} | sudo tee /proc/irq/{}/smp_affinity_list",
            worst.label
        )
    };
    Ok(Assessment::warning(value, remedy))
}

fn irqbalance(scene: &Scene) -> Assessed {
    let Some(process) = scene.load()?.irqbalance else {
        return Ok(Assessment::ok("does not run"));
    };
    let core = scene.core()?;
    if scene.system.cores("isolated")?.contains(core) {
        return Ok(Assessment::ok("runs, and spares isolated cores"));
    }
    let environment = scene.system.read(&format!("/proc/{process}/environ"))?;
    let banned = environment
        .split('\0')
        .find_map(|variable| variable.strip_prefix("IRQBALANCE_BANNED_CPULIST="));
    if CoreSet::parse(banned.unwrap_or_default()).contains(core) {
        return Ok(Assessment::ok(format!("runs, and spares core {core}")));
    }
    Ok(Assessment::warning(
        "runs, and does not spare the core",
        format!(
            "echo IRQBALANCE_BANNED_CPULIST={core} | sudo tee -a /etc/default/irqbalance && sudo systemctl \
             restart irqbalance"
        ),
    ))
}
