//! `cdcrd doctor`: findings about this machine that affect the timing of the loop, with their remedies.
//!
//! [`Observations`] are files ([`System`]), trials ([`Probe`]), one second of counts ([`Load`]), and the
//! configuration. Each check assesses one aspect of them and changes nothing, so that tests can assess machines of
//! their own.
//!
//! If the configuration asks for no real time, checks that matter only to real time are shown and assessed as
//! good.

mod cores;
mod finding;
mod load;
mod machine;
mod privileges;
mod probe;
mod sample;
mod scheduler;
#[cfg(test)]
mod tests;

pub(crate) use finding::{DoctorReport, Finding, Severity};

use finding::{Assessed, Problem};
use probe::Probe;
use sample::Load;

use crate::config::{RealtimeConfig, RealtimeMode, Validated};
use crate::start;
use crate::system::{CPU, CoreSet, Reading, System, daemon_process, unreadable, with_core};

struct Observations {
    system: System,
    /// The configuration with the chosen core.
    validated: Validated,
    probe: Probe,
    load: Reading<Load>,
}

struct Check {
    key: &'static str,
    title: &'static str,
    why: &'static str,
    assess: fn(&Observations) -> Assessed,
}

/// The function of each check (its name is the key), its title, and the reason why it matters.
macro_rules! checks {
    ($($file:ident::$assess:ident, $title:literal, $why:literal;)+) => {
        &[$(Check { key: stringify!($assess), title: $title, why: $why, assess: $file::$assess }),+]
    };
}

/// Every check, in the order of the report.
const CHECKS: &[Check] = checks! {
    privileges::fifo, "SCHED_FIFO",
        "Without real-time priority any other program can delay the cycle by many periods.";
    privileges::pin, "pinned to a core",
        "A thread that migrates between cores finds cold caches and competing threads.";
    privileges::memory_lock, "locked memory",
        "A page that was swapped out is loaded again in the middle of a cycle.";
    scheduler::preemption, "pre-emption model",
        "While the kernel is not preemptible, the cycle waits for it.";
    scheduler::rt_throttling, "RT throttling",
        "The kernel halts real-time threads that exceed their share of a second; without a limit a hung thread blocks its core.";
    scheduler::rt_group, "RT group",
        "In a control group without real-time runtime, SCHED_FIFO is refused, even for root.";
    cores::cores, "number of cores",
        "On a single core all other threads run in the time between cycles.";
    cores::isolation, "isolated core",
        "The system puts ordinary threads on every core that is not isolated.";
    cores::tick, "timer tick",
        "The tick and deferred kernel work cost each core microseconds, hundreds of times per second.";
    cores::siblings, "hyper-threads",
        "Two threads on one physical core run at about half speed each.";
    cores::governor, "frequency governor",
        "A governor that saves power slows the core down between cycles, and a solve then takes longer.";
    cores::deep_sleep, "deep sleep",
        "A core needs up to hundreds of microseconds to wake up from deep sleep.";
    scheduler::sysctls, "kernel settings",
        "Some default kernel work moves memory in use or runs on the real-time core.";
    load::steal, "stolen time",
        "While the hypervisor runs another machine on this core, no priority helps.";
    load::neighbours, "threads on the core",
        "Other threads on the core evict its caches and keep the kernel busy at a release.";
    load::realtime_neighbours, "real-time threads",
        "A real-time thread of the same or a higher priority runs before the loop.";
    load::interrupts, "interrupts",
        "Each interrupt on the core preempts the cycle, at any priority.";
    load::irqbalance, "irqbalance",
        "It moves interrupts to this core when other cores are busier.";
    machine::clock_source, "clock source",
        "The loop reads the clock thousands of times per second; a slow clock source costs microseconds per read.";
    machine::virtual_machine, "virtual machine",
        "A hypervisor can halt a core for milliseconds at any time; the guest cannot prevent it.";
    machine::shared_memory, "shared memory",
        "Daemon and clients communicate through files in the root folder; when its memory is full, no client can connect.";
    machine::huge_pages, "transparent huge pages",
        "To create huge pages, the kernel moves memory of a running process, which waits; the daemon disables this for itself.";
    machine::swap, "swap",
        "Memory that is not locked can be on disk when the cycle needs it.";
    machine::root_folder, "root folder",
        "Users with write access can disturb the robot; without write access the daemon does not start.";
};

/// Checks that matter to every daemon; the others matter only if the configuration asks for real time.
const ALWAYS: [&str; 2] = ["shared_memory", "root_folder"];

/// Examines this machine for a daemon with this configuration. Takes a second.
pub(crate) fn examine(validated: &Validated) -> DoctorReport {
    let system = System::this();
    let validated = with_core(validated);
    let mut ours = vec![std::process::id()];
    ours.extend(daemon_process(&validated));
    let core = realtime_core(&validated);
    let observed = Observations {
        load: core.and_then(|core| Load::watch(&system, core, &ours)),
        probe: Probe::new(&system, &validated),
        system,
        validated,
    };
    observed.report()
}

/// The core of the real-time threads.
fn realtime_core(validated: &Validated) -> Reading<usize> {
    let hidden = || unreadable("the core", "the system does not report its cores");
    start::core(&validated.config.realtime).ok_or_else(hidden)
}

impl Observations {
    fn report(&self) -> DoctorReport {
        let findings: Vec<Finding> = CHECKS.iter().map(|check| check.finding(self)).collect();
        let severities = findings.iter().map(|finding| finding.severity);
        let worst = severities.max().unwrap_or(Severity::Ok);
        DoctorReport { worst, findings }
    }

    fn realtime(&self) -> &RealtimeConfig {
        &self.validated.config.realtime
    }

    fn period_ms(&self) -> f64 {
        self.validated.config.cycle.period_ms
    }

    fn core(&self) -> Reading<usize> {
        realtime_core(&self.validated)
    }

    fn load(&self) -> Reading<&Load> {
        self.load.as_ref().map_err(Clone::clone)
    }

    fn has_no_tick(&self) -> Reading<bool> {
        let quiet = self.system.read_if_there(&format!("{CPU}/nohz_full"))?;
        Ok(CoreSet::parse(&quiet.unwrap_or_default()).contains(&self.core()?))
    }

    /// The online cores without that of the real-time threads.
    fn other_cores(&self) -> Reading<CoreSet> {
        Ok(self.system.online()?.without(self.core()?))
    }

    /// Severity of a refused privilege.
    fn missing(&self) -> Severity {
        match self.realtime().mode {
            RealtimeMode::Require => Severity::Fault,
            _ => Severity::Warning,
        }
    }
}

impl Check {
    fn finding(&self, observed: &Observations) -> Finding {
        let concerns = observed.realtime().mode != RealtimeMode::Off || ALWAYS.contains(&self.key);
        let (severity, value, remedy) = match (self.assess)(observed) {
            Err(problem) if concerns => (problem.severity, problem.value, problem.remedy),
            Ok(value) | Err(Problem { value, .. }) => {
                (Severity::Ok, value, "nothing to do".to_owned())
            }
        };
        Finding {
            key: self.key,
            title: self.title,
            severity,
            value,
            why: self.why,
            remedy,
        }
    }
}
