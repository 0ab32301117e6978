//! `cdcrd doctor`: what on this machine matters to a loop that must be on time, how it is, and what to do
//! about it.
//!
//! A [`Scene`] holds all that was seen: files ([`System`]), trials ([`Probe`]), one second of counters
//! ([`Load`]), and what the configuration asks ([`Plan`]). Each check judges one thing of it and changes
//! nothing, so that tests judge scenes of their own.
//!
//! Where the configuration asks for no real time, what matters only to real time is shown and judged good.

/// The checks of a file: whom each concerns, the function that judges it (its name is the key), title, and why it matters.
macro_rules! checks {
    ($($concern:ident $judge:ident, $title:literal, $why:literal;)+) => {
        pub(super) const CHECKS: &[super::Check] = &[$(super::Check {
            key: stringify!($judge),
            title: $title,
            why: $why,
            concern: super::Concern::$concern,
            judge: $judge,
        }),+];
    };
}

mod core_choice;
mod core_set;
mod cores;
#[cfg(test)]
mod fake;
mod finding;
mod folder;
mod load;
mod machine;
mod memory;
mod plan;
mod privileges;
mod probe;
mod sample;
mod scheduler;
mod sysctls;
mod system;

use std::path::Path;
use std::time::{Duration, Instant};

pub use core_choice::with_core;
pub use core_set::CoreSet;
pub use finding::{Finding, Judgement, NOTHING_TO_DO, Report, Verdict};
pub use plan::Plan;
pub use probe::Probe;
pub use sample::{CoreLoad, InterruptRate, Load, Neighbour, Snapshot, Thread};
pub use scheduler::kernel_share;
pub use system::{System, Unreadable};

use crate::config::{RealtimeMode, Validated};

/// How long the counters are watched.
const WATCHED: Duration = Duration::from_secs(1);

/// All that was seen.
#[derive(Debug, Clone)]
pub struct Scene {
    /// The files of the system.
    pub system: System,
    /// What the configuration asks.
    pub plan: Plan,
    /// What was tried.
    pub probe: Probe,
    /// What happened on the core meanwhile.
    pub load: Result<Load, Unreadable>,
}

/// To whom a thing matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Concern {
    /// To every daemon.
    Always,
    /// Only where the configuration asks for real time.
    RealTime,
}

/// One thing that matters.
struct Check {
    key: &'static str,
    title: &'static str,
    why: &'static str,
    concern: Concern,
    judge: fn(&Scene) -> Result<Judgement, Unreadable>,
}

/// Every check, in the order of the report.
fn checks() -> impl Iterator<Item = &'static Check> {
    let groups: [&[Check]; 8] = [
        privileges::CHECKS,
        scheduler::CHECKS,
        cores::CHECKS,
        sysctls::CHECKS,
        load::CHECKS,
        machine::CHECKS,
        memory::CHECKS,
        folder::CHECKS,
    ];
    groups.into_iter().flatten()
}

/// Looks at this machine with the eyes of a daemon of this configuration. Takes a second.
pub fn examine(validated: &Validated) -> Report {
    Scene::here(validated).report()
}

impl Scene {
    /// This machine, for a daemon of this configuration.
    pub fn here(validated: &Validated) -> Self {
        let system = System::at(Path::new("/"));
        let plan = Plan::new(&with_core(validated));
        let load = watch(&system, &plan);
        let probe = Probe::new(&system, &plan);
        Self {
            system,
            plan,
            probe,
            load,
        }
    }

    /// Judges everything.
    pub fn report(&self) -> Report {
        Report::new(checks().map(|check| check.finding(self)).collect())
    }

    /// The core of the real-time threads.
    fn core(&self) -> Result<usize, Unreadable> {
        let none = || Unreadable::new("the core", "the system does not tell which cores it has");
        self.plan.core.ok_or_else(none)
    }

    fn load(&self) -> Result<&Load, Unreadable> {
        self.load.as_ref().map_err(Clone::clone)
    }

    /// Whether the daemon of this robot runs.
    fn daemon_runs(&self) -> bool {
        let process = daemon_process(&self.system, &self.plan.lock_file);
        process.is_some_and(|id| self.system.path(&format!("/proc/{id}")).exists())
    }

    /// The cores that run, without that of the real-time threads.
    fn other_cores(&self) -> Result<CoreSet, Unreadable> {
        Ok(self.system.online()?.without(self.core()?))
    }
}

impl Check {
    fn finding(&self, scene: &Scene) -> Finding {
        let judged = (self.judge)(scene);
        let Judgement {
            mut verdict,
            value,
            mut remedy,
        } = judged.unwrap_or_else(|unreadable| {
            let remedy = "run `cdcrd doctor` as root, or look by hand";
            Judgement::unknown(unreadable.to_string(), remedy)
        });
        if self.concern == Concern::RealTime && scene.plan.mode == RealtimeMode::Off {
            verdict = Verdict::Ok;
        }
        if verdict == Verdict::Ok {
            NOTHING_TO_DO.clone_into(&mut remedy);
        }
        Finding {
            key: self.key,
            title: self.title,
            verdict,
            value,
            why: self.why,
            remedy,
        }
    }
}

/// The process id that the daemon of this robot left in its lock file.
fn daemon_process(system: &System, lock_file: &Path) -> Option<u32> {
    let id = system.number(&lock_file.to_string_lossy()).ok()?;
    u32::try_from(id).ok()
}

/// Watches the counters for a while.
fn watch(system: &System, plan: &Plan) -> Result<Load, Unreadable> {
    let core = plan
        .core
        .ok_or_else(|| Unreadable::new("the load", "no core is known"))?;
    let mut ours = vec![std::process::id()];
    ours.extend(daemon_process(system, &plan.lock_file));
    let before = Snapshot::take(system, core)?;
    let start = Instant::now();
    std::thread::sleep(WATCHED);
    let after = Snapshot::take(system, core)?;
    let seconds = start.elapsed().as_secs_f64();
    Ok(Load::between(&before, &after, core, seconds, &ours))
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::fake::Fake;
    use super::*;

    #[test]
    fn every_check_has_a_name_of_its_own_and_a_reason() {
        let keys: HashSet<_> = checks().map(|check| check.key).collect();
        assert_eq!(keys.len(), checks().count());
        for check in checks() {
            assert!(check.why.ends_with('.'), "{}: {}", check.key, check.why);
        }
    }

    #[test]
    fn a_system_that_shows_nothing_is_unknown_and_not_good() {
        let mut fake = Fake::new(&[]);
        fake.scene.load = Err(Unreadable::new("/proc/stat", "gone"));
        fake.scene.probe.fifo = Err("no".to_owned());
        let report = fake.scene.report();
        assert!(report.count(Verdict::Unknown) > 5, "{report:#?}");
        assert!(report.worst >= Verdict::Warning);
        let unknown = report.findings.iter().find(|f| f.key == "steal");
        assert!(unknown.is_some_and(|f| f.value.contains("/proc/stat") && !f.remedy.is_empty()));
    }

    #[test]
    fn nothing_of_real_time_is_bad_where_none_is_asked_for() {
        let mut fake = Fake::new(&[]);
        fake.scene.plan.mode = RealtimeMode::Off;
        fake.scene.probe.fifo = Err("no".to_owned());
        fake.scene.probe.memory_lock = Err("no".to_owned());
        let report = fake.scene.report();
        let bad = report.findings.iter().filter(|f| f.verdict > Verdict::Ok);
        let keys: Vec<_> = bad.map(|finding| finding.key).collect();
        assert_eq!(keys, Vec::<&str>::new());
    }

    #[test]
    fn what_is_ok_needs_no_mending() {
        for finding in Fake::new(&[]).scene.report().findings {
            let is_ok = finding.verdict == Verdict::Ok;
            assert_eq!(is_ok, finding.remedy == NOTHING_TO_DO, "{finding:?}");
        }
    }
}
