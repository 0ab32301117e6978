//! `cdcrd doctor`: what on this machine matters to a loop that must be on time, how it is, and what to do
//! about it.
//!
//! A [`Scene`] holds all that was seen: files ([`System`]), trials ([`Probe`]), one second of counters
//! ([`Load`]), and what the configuration asks ([`Plan`]). Each check assesses one thing of it and changes
//! nothing, so that tests assess scenes of their own.
//!
//! Where the configuration asks for no real time, what matters only to real time is shown and assessed good.

/// The checks of a file: whom each concerns, the function that assesses it (its name is the key), title, and why it matters.
macro_rules! checks {
    ($($concern:ident $assess:ident, $title:literal, $why:literal;)+) => {
        pub(super) const CHECKS: &[super::Check] = &[$(super::Check {
            key: stringify!($assess),
            title: $title,
            why: $why,
            concern: super::Concern::$concern,
            assess: $assess,
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

pub(crate) use core_choice::with_core;
pub(crate) use core_set::CoreSet;
pub(crate) use finding::{Assessment, DoctorReport, Finding, NOTHING_TO_DO, Severity};
pub(crate) use plan::Plan;
pub(crate) use probe::Probe;
pub(crate) use sample::{Load, Snapshot};
pub(crate) use scheduler::kernel_share;
pub(crate) use system::{System, Unreadable};

use crate::config::{RealtimeMode, Validated};

/// The kernel's folder of the cores.
const CPU: &str = "/sys/devices/system/cpu";
const WATCHED: Duration = Duration::from_secs(1);

/// All that was seen.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    pub(crate) system: System,
    pub(crate) plan: Plan,
    pub(crate) probe: Probe,
    /// What happened on the core meanwhile.
    pub(crate) load: Result<Load, Unreadable>,
}

/// What a check finds, or what it could not read.
type Assessed = Result<Assessment, Unreadable>;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Concern {
    /// To every daemon.
    Always,
    /// Only where the configuration asks for real time.
    RealTime,
}

struct Check {
    key: &'static str,
    title: &'static str,
    why: &'static str,
    concern: Concern,
    assess: fn(&Scene) -> Assessed,
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
pub(crate) fn examine(validated: &Validated) -> DoctorReport {
    Scene::here(validated).report()
}

impl Scene {
    /// This machine, for a daemon of this configuration.
    pub(crate) fn here(validated: &Validated) -> Self {
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

    pub(crate) fn report(&self) -> DoctorReport {
        DoctorReport::new(checks().map(|check| check.finding(self)).collect())
    }

    /// The core of the real-time threads.
    fn core(&self) -> Result<usize, Unreadable> {
        let none = || Unreadable::new("the core", "the system does not tell which cores it has");
        self.plan.core.ok_or_else(none)
    }

    fn has_no_tick(&self) -> Result<bool, Unreadable> {
        let quiet = self.system.read_if_there(&format!("{CPU}/nohz_full"))?;
        Ok(CoreSet::parse(&quiet.unwrap_or_default()).contains(self.core()?))
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
        let assessed = (self.assess)(scene);
        let Assessment {
            mut severity,
            value,
            mut remedy,
        } = assessed.unwrap_or_else(|unreadable| {
            let remedy = "run `cdcrd doctor` as root, or look by hand";
            Assessment::unknown(unreadable.to_string(), remedy)
        });
        if self.concern == Concern::RealTime && scene.plan.mode == RealtimeMode::Off {
            severity = Severity::Ok;
        }
        if severity == Severity::Ok {
            NOTHING_TO_DO.clone_into(&mut remedy);
        }
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

/// The process id that the daemon of this robot left in its lock file.
fn daemon_process(system: &System, lock_file: &Path) -> Option<u32> {
    let id = system.number(&lock_file.to_string_lossy()).ok()?;
    u32::try_from(id).ok()
}

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
    fn each_machine_is_found_to_be_as_it_is() {
        let mut assessed = HashSet::new();
        let mut fake = Fake::new(&[]);
        for (index, line) in include_str!("findings.txt").lines().enumerate() {
            eprintln!("findings.txt, line {}: {line}", index + 1);
            let (name, rest) = line.split_once(' ').unwrap_or_default();
            match rest.strip_prefix('=').map(str::trim_start) {
                _ if name == "##" => fake = Fake::new(&[]),
                _ if name.is_empty() || name == "#" => {}
                Some(text) if name.starts_with('/') => {
                    let text = text.replace("\\n", "\n").replace("\\t", "\t");
                    fake.write(name, &text.replace("\\0", "\0"));
                }
                Some(value) => fake.set(name, value),
                None => {
                    fake.expect(line);
                    assessed.insert(name);
                }
            }
        }
        assert_eq!(assessed, checks().map(|check| check.key).collect());
    }

    #[test]
    fn a_system_that_shows_nothing_is_unknown_and_not_good() {
        let mut fake = Fake::new(&[]);
        fake.scene.load = Err(Unreadable::new("/proc/stat", "gone"));
        fake.scene.probe.fifo = Err("no".to_owned());
        let report = fake.scene.report();
        assert!(report.count(Severity::Unknown) > 5, "{report:#?}");
        assert!(report.worst >= Severity::Warning);
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
        let bad = report.findings.iter().filter(|f| f.severity > Severity::Ok);
        let keys: Vec<_> = bad.map(|finding| finding.key).collect();
        assert_eq!(keys, Vec::<&str>::new());
    }

    #[test]
    fn what_is_ok_needs_no_mending() {
        for finding in Fake::new(&[]).scene.report().findings {
            let is_ok = finding.severity == Severity::Ok;
            assert_eq!(is_ok, finding.remedy == NOTHING_TO_DO, "{finding:?}");
        }
    }
}
