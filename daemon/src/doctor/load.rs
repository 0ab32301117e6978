//! Who else uses the core.

use super::sample::{Load, Thread};
use super::{Check, Concern, CoreSet, Judgement, Scene, Unreadable};

pub(super) const CHECKS: &[Check] = &[
    Check {
        key: "steal",
        title: "stolen time",
        why: "While the hypervisor lets another machine run on this core, no priority helps.",
        concern: Concern::RealTime,
        judge: steal,
    },
    Check {
        key: "neighbours",
        title: "threads on the core",
        why: "Others on the core empty its caches, and keep the kernel busy there when the cycle is due.",
        concern: Concern::RealTime,
        judge: neighbours,
    },
    Check {
        key: "realtime_neighbours",
        title: "real-time threads",
        why: "A real-time thread of the same or a higher priority goes before the loop.",
        concern: Concern::RealTime,
        judge: realtime_neighbours,
    },
    Check {
        key: "interrupts",
        title: "interrupts",
        why: "Each interrupt on the core goes before the cycle, whatever its priority.",
        concern: Concern::RealTime,
        judge: interrupts,
    },
    Check {
        key: "irqbalance",
        title: "irqbalance",
        why: "It moves interrupts to this core when others are busier.",
        concern: Concern::RealTime,
        judge: irqbalance,
    },
];

/// A smaller stolen share is a matter of how time is counted.
const STEAL_SHARE: f64 = 0.01;
/// Neighbours that use less together are housekeeping.
const NEIGHBOUR_SHARE: f64 = 0.05;
/// Interrupts of devices below this rate are rare beside the periods \[1/s\].
const INTERRUPT_HZ: f64 = 100.0;
/// How many of the largest are named.
const NAMED: usize = 3;

fn steal(scene: &Scene) -> Result<Judgement, Unreadable> {
    let core = scene.core()?;
    let load = scene.load()?.cores.get(&core);
    let load =
        load.ok_or_else(|| Unreadable::new(format!("the time of core {core}"), "not shown"))?;
    let value = format!(
        "{:.1} % in this second, {:.2} % since the machine started",
        100.0 * load.steal,
        100.0 * load.steal_since_start
    );
    Ok(if load.steal.max(load.steal_since_start) < STEAL_SHARE {
        Judgement::ok(value)
    } else {
        Judgement::warning(
            value,
            "ask for dedicated (pinned) cores for this virtual machine",
        )
    })
}

fn neighbours(scene: &Scene) -> Result<Judgement, Unreadable> {
    let core = scene.core()?;
    let neighbours = &scene.load()?.neighbours;
    let sum: f64 = neighbours.iter().map(|neighbour| neighbour.share).sum();
    let named = neighbours.iter().take(NAMED).map(|neighbour| {
        let Thread { name, id, .. } = &neighbour.thread;
        format!("{name} ({id}) {:.0} %", 100.0 * neighbour.share)
    });
    let named: Vec<_> = named.collect();
    if named.is_empty() {
        return Ok(Judgement::ok(format!("nobody else on core {core}")));
    }
    let value = format!("{:.0} % of core {core}: {}", 100.0 * sum, named.join(", "));
    if sum < NEIGHBOUR_SHARE {
        return Ok(Judgement::ok(value));
    }
    Ok(Judgement::warning(
        value,
        away(scene, &neighbours[0].thread),
    ))
}

/// The command that moves a thread to other cores.
fn away(scene: &Scene, thread: &Thread) -> String {
    let others = scene.other_cores().unwrap_or_default();
    if thread.is_kernel || others == CoreSet::default() {
        return "isolate the core (see `isolated core`)".to_owned();
    }
    format!(
        "sudo taskset -pc {others} {}   (or isolate the core)",
        thread.id
    )
}

fn realtime_neighbours(scene: &Scene) -> Result<Judgement, Unreadable> {
    let core = scene.core()?;
    let limit = scene.plan.exchange_priority;
    let rivals = rivals(scene.load()?, core, limit);
    let Some(first) = rivals.first() else {
        return Ok(Judgement::ok("none that could go before the loop"));
    };
    let named = rivals.iter().take(NAMED).map(|thread| {
        let policy = if thread.is_deadline {
            "deadline"
        } else {
            "priority"
        };
        format!(
            "{} ({}) {policy} {}",
            thread.name, thread.id, thread.priority
        )
    });
    let named: Vec<_> = named.collect();
    let mend = match scene.other_cores() {
        Ok(others) if others.count() > 0 && !first.is_kernel => {
            format!("sudo taskset -pc {others} {}", first.id)
        }
        _ => format!("sudo chrt -f -p 1 {}", first.id),
    };
    let value = format!("{} may use core {core}: {}", rivals.len(), named.join(", "));
    Ok(Judgement::warning(value, mend))
}

/// Threads that may go before the exchange on the core, or that are there for good.
fn rivals(load: &Load, core: usize, exchange_priority: i32) -> Vec<&Thread> {
    // The kernel's own helpers of every core, idle unless the kernel itself needs them.
    let helpers = ["migration/", "watchdog/", "idle_inject/"];
    let is_helper = |thread: &Thread| {
        thread.is_kernel && helpers.iter().any(|name| thread.name.starts_with(name))
    };
    let is_rival = |thread: &&Thread| {
        let goes_before = thread.is_deadline || thread.priority >= exchange_priority;
        let is_pinned_here = thread.allowed.count() == 1 && !thread.is_kernel;
        thread.allowed.contains(core) && !is_helper(thread) && (goes_before || is_pinned_here)
    };
    load.realtime.iter().filter(is_rival).collect()
}

fn interrupts(scene: &Scene) -> Result<Judgement, Unreadable> {
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
        return Ok(Judgement::ok(format!("none on core {core}")));
    }
    let devices = || rates.iter().filter(|rate| rate.is_device());
    let device_hz: f64 = devices().map(|rate| rate.rate_hz).sum();
    let value = format!("{device_hz:.0}/s of devices; largest {}", named.join(", "));
    let Some(worst) = devices().next().filter(|_| device_hz >= INTERRUPT_HZ) else {
        return Ok(Judgement::ok(value));
    };
    let others = scene.other_cores()?;
    let mend = if others.count() == 0 {
        "use a machine with two cores or more".to_owned()
    } else {
        format!(
            "echo {others} | sudo tee /proc/irq/{}/smp_affinity_list",
            worst.label
        )
    };
    Ok(Judgement::warning(value, mend))
}

fn irqbalance(scene: &Scene) -> Result<Judgement, Unreadable> {
    let Some(process) = scene.load()?.irqbalance else {
        return Ok(Judgement::ok("does not run"));
    };
    let core = scene.core()?;
    let isolated = scene.system.read("/sys/devices/system/cpu/isolated")?;
    if CoreSet::parse(&isolated).contains(core) {
        return Ok(Judgement::ok("runs, and spares isolated cores"));
    }
    let environment = scene.system.read(&format!("/proc/{process}/environ"))?;
    let banned = environment
        .split('\0')
        .find_map(|variable| variable.strip_prefix("IRQBALANCE_BANNED_CPULIST="));
    if CoreSet::parse(banned.unwrap_or_default()).contains(core) {
        return Ok(Judgement::ok(format!("runs, and spares core {core}")));
    }
    Ok(Judgement::warning(
        "runs, and does not spare the core",
        format!(
            "echo IRQBALANCE_BANNED_CPULIST={core} | sudo tee -a /etc/default/irqbalance && sudo systemctl \
             restart irqbalance"
        ),
    ))
}

#[cfg(test)]
mod tests {
    use super::super::Verdict::{Ok as Good, Unknown, Warning};
    use super::super::fake::Fake;
    use super::super::{CoreLoad, InterruptRate, Neighbour};
    use super::*;

    fn fake(change: impl FnOnce(&mut Load)) -> Fake {
        let mut fake = Fake::new(&[
            ("/sys/devices/system/cpu/online", "0-1"),
            ("/sys/devices/system/cpu/isolated", ""),
        ]);
        let mut load = Load::default();
        change(&mut load);
        fake.scene.load = Ok(load);
        fake
    }

    fn thread(name: &str, priority: i32, allowed: &str) -> Thread {
        let mut thread = Thread::named(name, 77);
        thread.is_realtime = priority > 0;
        thread.priority = priority;
        thread.allowed = CoreSet::parse(allowed);
        thread
    }

    #[test]
    fn stolen_time_is_bad_in_this_second_and_before() {
        let of = |steal, steal_since_start| {
            fake(|load| {
                let core = CoreLoad {
                    busy: 0.0,
                    steal,
                    steal_since_start,
                };
                load.cores.insert(1, core);
            })
        };
        of(0.0, 0.0001).expect("steal", Good, &["0.0 %"]);
        of(0.03, 0.0).expect("steal", Warning, &["3.0 %", "dedicated"]);
        of(0.0, 0.05).expect("steal", Warning, &["5.00 %"]);
        fake(|_| ()).expect("steal", Unknown, &["core 1"]);
    }

    #[test]
    fn busy_neighbours_are_named() {
        fake(|_| ()).expect("neighbours", Good, &["nobody"]);
        let of = |shares: &[f64], is_kernel: bool| {
            fake(|load| {
                for (index, share) in shares.iter().enumerate() {
                    let mut thread = thread(&format!("worker-{index}"), 0, "");
                    thread.is_kernel = is_kernel;
                    load.neighbours.push(Neighbour {
                        thread,
                        share: *share,
                    });
                }
            })
        };
        of(&[0.01], false).expect("neighbours", Good, &["worker-0 (77) 1 %"]);
        of(&[0.4, 0.2, 0.1, 0.1], false).expect(
            "neighbours",
            Warning,
            &["80 % of core 1", "worker-2", "taskset -pc 0 77"],
        );
        of(&[0.4], true).expect("neighbours", Warning, &["isolate"]);
    }

    #[test]
    fn real_time_threads_that_go_first_are_named() {
        let of = |thread: Thread| fake(|load| load.realtime.push(thread));
        let verdict = |thread| of(thread).verdict("realtime_neighbours");
        fake(|_| ()).expect("realtime_neighbours", Good, &["none"]);
        of(thread("audio", 88, "0-1")).expect(
            "realtime_neighbours",
            Warning,
            &["audio (77) priority 88", "taskset -pc 0 77"],
        );
        assert_eq!(verdict(thread("audio", 88, "0")), Good);
        assert_eq!(verdict(thread("audio", 10, "0-1")), Good);
        assert_eq!(verdict(thread("other loop", 10, "1")), Warning);
        let kernel = |name: &str, priority| Thread {
            is_kernel: true,
            ..thread(name, priority, "1")
        };
        assert_eq!(verdict(kernel("migration/1", 99)), Good);
        assert_eq!(verdict(kernel("irq/24-eth0", 50)), Good);
        assert_eq!(verdict(kernel("irq/24-eth0", 90)), Warning);
        // A program may call itself as it likes.
        assert_eq!(verdict(thread("migration/1", 99, "1")), Warning);
        let deadline = Thread {
            is_deadline: true,
            ..thread("camera", 0, "0-1")
        };
        assert_eq!(verdict(deadline), Warning);
    }

    #[test]
    fn frequent_interrupts_of_devices_are_bad() {
        let rate = |label: &str, rate_hz| InterruptRate {
            label: label.to_owned(),
            description: "eth0".to_owned(),
            rate_hz,
        };
        let of = |rates: &[InterruptRate]| fake(|load| load.interrupts = rates.to_vec());
        of(&[]).expect("interrupts", Good, &["none"]);
        of(&[rate("LOC", 1000.0)]).expect("interrupts", Good, &["LOC (eth0) 1000/s"]);
        of(&[rate("LOC", 1000.0), rate("24", 500.0)]).expect(
            "interrupts",
            Warning,
            &["500/s of devices", "echo 0 | sudo tee /proc/irq/24/"],
        );
    }

    #[test]
    fn irqbalance_must_spare_the_core() {
        fake(|_| ()).expect("irqbalance", Good, &["not run"]);
        let fake = fake(|load| load.irqbalance = Some(5));
        fake.expect("irqbalance", Unknown, &["/proc/5/environ"]);
        fake.write("/proc/5/environ", "A=1\0B=2\0");
        fake.expect("irqbalance", Warning, &["BANNED_CPULIST=1"]);
        fake.write("/proc/5/environ", "A=1\0IRQBALANCE_BANNED_CPULIST=1-3\0");
        fake.expect("irqbalance", Good, &["spares core 1"]);
        fake.write("/proc/5/environ", "");
        fake.write("/sys/devices/system/cpu/isolated", "1");
        fake.expect("irqbalance", Good, &["isolated"]);
    }
}
