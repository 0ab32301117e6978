//! Other users of the core: steal, threads, interrupts.

use super::Severity::Warning;
use super::finding::{Assessed, problem, warn_unless};
use super::sample::{Interrupt, Load, ThreadSample};
use super::{CoreSet, Observations, unreadable};
use crate::system::CoreTimes;

/// Less steal is within the accuracy of its accounting \[%\].
const STEAL_PERCENT: f64 = 1.0;
/// Neighbours with a smaller total share are housekeeping.
const NEIGHBOUR_SHARE: f64 = 0.05;
/// Device interrupts below this rate are rare compared with the periods \[1/s\].
const INTERRUPT_HZ: f64 = 100.0;

/// The first three, as text.
fn named(all: impl Iterator<Item = String>) -> String {
    all.take(3).collect::<Vec<_>>().join(", ")
}

pub(super) fn steal(observed: &Observations) -> Assessed {
    let core = observed.core()?;
    let load = observed.load()?;
    let percent_of = |times: &CoreTimes| {
        let time = times.get(&core);
        let percent = time.map(|time| 100.0 * time.share(time.steal));
        percent.ok_or_else(|| unreadable(&format!("the time of core {core}"), "not shown"))
    };
    let now = percent_of(&load.cores)?;
    let since_start = percent_of(&load.cores_since_start)?;
    let is_good = now.max(since_start) < STEAL_PERCENT;
    warn_unless!(is_good, "{now:.1} % in this second, {since_start:.2} % since boot"
        => "use dedicated (pinned) cores for this virtual machine")
}

pub(super) fn neighbours(observed: &Observations) -> Assessed {
    let core = observed.core()?;
    let threads = observed.load()?.threads.iter();
    let here = threads.filter(|thread| thread.core == core && thread.share > 0.0);
    let here: Vec<&ThreadSample> = here.collect();
    let Some(busiest) = here.first() else {
        return Ok(format!("no other threads on core {core}"));
    };
    let sum: f64 = here.iter().map(|thread| thread.share).sum();
    let one = |t: &&ThreadSample| format!("{} ({}) {:.0} %", t.name, t.id, 100.0 * t.share);
    let each = named(here.iter().map(one));
    let value = format!("{:.0} % of core {core}: {each}", 100.0 * sum);
    let isolate = || "isolate the core (see `isolated core`)".to_owned();
    let remedy = elsewhere(observed, busiest, "   (or isolate the core)").unwrap_or_else(isolate);
    warn_unless!(sum < NEIGHBOUR_SHARE, "{value}" => "{remedy}")
}

/// The remedy that moves a thread to another core, with an alternative; `None` if it cannot be moved.
fn elsewhere(observed: &Observations, thread: &ThreadSample, alternative: &str) -> Option<String> {
    let others = observed.other_cores().unwrap_or_default();
    // The core of another daemon of ours depends on its configuration.
    let is_daemons = matches!(&*thread.name, "cdcr-cycle" | "cdcr-exchange");
    let remedy = match (is_daemons, others.is_empty()) {
        _ if thread.is_kernel => return None,
        (true, true) => "use a machine with two cores or more: another cdcrd uses the only core",
        (true, false) => {
            &format!("set another realtime.core ({others}) for this cdcrd or the other one")
        }
        (false, true) => return None,
        (false, false) => &format!("sudo taskset -pc {others} {}{alternative}", thread.id),
    };
    Some(remedy.to_owned())
}

pub(super) fn realtime_neighbours(observed: &Observations) -> Assessed {
    let core = observed.core()?;
    let limit = observed.realtime().exchange_priority;
    let rivals = rivals(observed.load()?, core, limit).into_iter();
    let (kernel, programs): (Vec<_>, Vec<_>) = rivals.partition(|thread| thread.is_kernel);
    let described = |threads: &[&ThreadSample]| named(threads.iter().copied().map(described));
    let Some(first) = programs.first() else {
        return Ok(match kernel.len() {
            0 => "none above the loop".to_owned(),
            count => format!("only {count} kernel threads: {}", described(&kernel)),
        });
    };
    let lower = || format!("sudo chrt -f -p 1 {}", first.id);
    let remedy = elsewhere(observed, first, "").unwrap_or_else(lower);
    let (count, described) = (programs.len(), described(&programs));
    problem!(Warning, "{count} can use core {core}: {described}" => "{remedy}")
}

/// A real-time thread; a kernel thread with its purpose.
fn described(thread: &ThreadSample) -> String {
    let (name, id, priority) = (&thread.name, thread.id, thread.priority);
    let policy = ["priority", "deadline"][usize::from(thread.is_deadline)];
    let errand = if thread.is_kernel { errand(name) } else { "" };
    format!("{name} ({id}) {policy} {priority}{errand}")
}

/// Purpose of a real-time kernel thread. All of them are idle unless the kernel needs them, and then the
/// machine needs them, too: their priorities are left alone.
fn errand(name: &str) -> &'static str {
    let known = [
        ("migration/", ", moves threads between cores"),
        ("watchdog", ", restarts a hung machine"),
        ("idle_inject/", ", prevents overheating"),
        ("sugov:", ", sets the frequency"),
        ("irq/", ", serves a device"),
        ("rcu", ", frees memory of the kernel"),
        ("", ", kernel helper"),
    ];
    let found = known.iter().find(|(begin, _)| name.starts_with(begin));
    found.map_or("", |(_, errand)| errand)
}

/// Threads that may precede the exchange on the core, and programs pinned there.
fn rivals(load: &Load, core: usize, exchange_priority: i32) -> Vec<&ThreadSample> {
    let is_rival = |thread: &&ThreadSample| {
        let goes_before = thread.is_deadline || thread.priority >= exchange_priority;
        let is_pinned_here = thread.allowed.len() == 1 && !thread.is_kernel;
        thread.is_realtime() && thread.allowed.contains(&core) && (goes_before || is_pinned_here)
    };
    let mut rivals: Vec<&ThreadSample> = load.threads.iter().filter(is_rival).collect();
    rivals.sort_by_key(|thread| (-thread.priority, thread.id));
    rivals
}

pub(super) fn interrupts(observed: &Observations) -> Assessed {
    let core = observed.core()?;
    let rates = &observed.load()?.interrupts;
    if rates.is_empty() {
        return Ok(format!("none on core {core}"));
    }
    let one = |of: &Interrupt| format!("{} ({}) {:.0}/s", of.label, of.description, of.rate_hz);
    let each = named(rates.iter().map(one));
    let devices: Vec<_> = rates.iter().filter(|rate| rate.is_device()).collect();
    // The sum of nothing would be -0.
    let device_hz = devices.iter().fold(0.0, |sum, rate| sum + rate.rate_hz);
    let value = format!("{device_hz:.0}/s of devices; largest {each}");
    let Some(worst) = devices.first().filter(|_| device_hz >= INTERRUPT_HZ) else {
        return Ok(value);
    };
    let (others, label) = (observed.other_cores()?, &worst.label);
    if others.is_empty() {
        return problem!(Warning, "{value}" => "use a machine with two cores or more");
    }
    problem!(Warning, "{value}" => "echo {others} | sudo tee /proc/irq/{label}/smp_affinity_list")
}

pub(super) fn irqbalance(observed: &Observations) -> Assessed {
    let mut threads = observed.load()?.threads.iter();
    let Some(ThreadSample { process, .. }) = threads.find(|thread| thread.name == "irqbalance")
    else {
        return Ok("does not run".to_owned());
    };
    let core = observed.core()?;
    if observed.system.cores("isolated")?.contains(&core) {
        return Ok("runs, but leaves isolated cores alone".to_owned());
    }
    let environment = observed.system.read(&format!("/proc/{process}/environ"))?;
    let mut variables = environment.split('\0');
    let banned = variables.find_map(|word| word.strip_prefix("IRQBALANCE_BANNED_CPULIST="));
    if CoreSet::parse(banned.unwrap_or_default()).contains(&core) {
        return Ok(format!("runs, but leaves core {core} alone"));
    }
    problem!(Warning, "runs, and may move interrupts to core {core}"
        => "echo IRQBALANCE_BANNED_CPULIST={core} | sudo tee -a /etc/default/irqbalance && sudo systemctl restart \
            irqbalance")
}
