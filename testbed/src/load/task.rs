//! The threads of a load: work and core.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use anyhow::{Context, Result};
use cdcr_shared_types::Location;

use super::{Done, Load, disk, flood, memory, processor, stress_ng, visitors};
use crate::system::cores::Cores;

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ThreadJob {
    pub(super) job: Job,
    /// Core of the thread; `None` if the job sets its own affinity.
    pub(super) core: Option<usize>,
}

/// Work of a thread until the load ends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Job {
    Spin,
    /// Copies a buffer of `bytes` bytes into another.
    Copy {
        bytes: usize,
    },
    Disk,
    Visit(Location),
    References(Location),
    Obstacles(Location),
    StressNg(Cores),
}

impl Job {
    /// Name of the thread, at most 15 bytes.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Spin => "spin",
            Self::Copy { .. } => "copy",
            Self::Disk => "disk",
            Self::Visit(_) => "visit",
            Self::References(_) => "references",
            Self::Obstacles(_) => "obstacles",
            Self::StressNg(_) => "stress-ng",
        }
    }

    pub(super) fn run(self, signals: &Signals) -> Result<Done> {
        match self {
            Self::Spin => Ok(processor::spin(signals)),
            Self::Copy { bytes } => Ok(memory::copy(bytes, signals)),
            Self::Disk => disk::write_and_read(signals),
            Self::Visit(target) => Ok(visitors::come_and_go(&target, signals)),
            Self::References(target) => flood::references(&target, signals),
            Self::Obstacles(target) => flood::obstacles(&target, signals),
            Self::StressNg(cores) => stress_ng::run(&cores, signals),
        }
    }
}

/// State shared by the threads of a load.
#[derive(Debug, Default)]
pub(super) struct Signals {
    ending: AtomicBool,
    ready: AtomicUsize,
    failure: OnceLock<String>,
}

impl Signals {
    pub(super) fn end(&self) {
        self.ending.store(true, Ordering::Relaxed);
    }

    pub(super) fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Relaxed)
    }

    /// Called once by each thread when it begins to work.
    pub(super) fn works(&self) {
        self.ready.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn ready(&self) -> usize {
        self.ready.load(Ordering::Relaxed)
    }

    pub(super) fn fail(&self, why: String) {
        let _ = self.failure.set(why);
    }

    pub(super) fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }
}

pub(super) fn tasks(
    load: Load,
    cores: &Cores,
    target: Option<&Location>,
) -> Result<Vec<ThreadJob>> {
    let target = || {
        let name = load.name();
        let missing = || format!("the load {name} needs a daemon to load");
        target.cloned().with_context(missing)
    };
    let on_others = |jobs: Vec<Job>| spread(jobs, &cores.others);
    let each = |cores: &[usize], job: &Job| spread(vec![job.clone(); cores.len()], cores);
    let copy = |cores: &[usize]| Job::Copy {
        bytes: memory::buffer_bytes(cores.len()),
    };
    Ok(match load {
        Load::None => Vec::new(),
        Load::Cpu => each(&cores.others, &Job::Spin),
        Load::Memory => each(&cores.others, &copy(&cores.others)),
        Load::Io => on_others(vec![Job::Disk]),
        Load::Clients => on_others(vec![Job::Visit(target()?); visitors::COMERS as usize]),
        Load::Flood => on_others(vec![Job::References(target()?), Job::Obstacles(target()?)]),
        Load::All => {
            let target = target()?;
            let parts = Load::PARTS.map(|part| tasks(part, cores, Some(&target)));
            parts.into_iter().collect::<Result<Vec<_>>>()?.concat()
        }
        Load::CpuEverywhere => {
            let every = every_core(cores);
            [each(&every, &Job::Spin), each(&every, &copy(&every))].concat()
        }
        Load::StressNg => vec![ThreadJob {
            job: Job::StressNg(cores.clone()),
            core: None,
        }],
    })
}

/// Assigns the jobs to the cores in turn.
fn spread(jobs: Vec<Job>, cores: &[usize]) -> Vec<ThreadJob> {
    let cores = cores.iter().copied().cycle();
    let tasks = jobs.into_iter().zip(cores);
    tasks
        .map(|(job, core)| ThreadJob {
            job,
            core: Some(core),
        })
        .collect()
}

fn every_core(cores: &Cores) -> Vec<usize> {
    let mut every = cores.others.clone();
    every.push(cores.realtime);
    every.sort_unstable();
    every.dedup();
    every
}

#[cfg(test)]
mod tests {
    use super::*;
    use cdcr_process::PrivatePlace;

    fn cores_of(tasks: &[ThreadJob]) -> Vec<usize> {
        tasks.iter().filter_map(|task| task.core).collect()
    }

    #[test]
    fn no_load_but_one_touches_the_real_time_core() {
        let place = PrivatePlace::new().unwrap();
        let cores = Cores::find().unwrap();
        for load in Load::OWN {
            let tasks = tasks(load, &cores, Some(place.location())).unwrap();
            let touched = cores_of(&tasks).contains(&cores.realtime);
            let may = cores.is_alone() || load == Load::CpuEverywhere;
            assert_eq!(touched, may && load != Load::None, "{load:?}");
            assert_eq!(tasks.is_empty(), load == Load::None, "{load:?}");
        }
    }

    #[test]
    fn each_core_gets_its_own_and_all_is_the_sum() {
        let place = PrivatePlace::new().unwrap();
        let mut cores = Cores::find().unwrap();
        (cores.realtime, cores.others) = (7, vec![2, 3, 5]);
        let count = |load| {
            let tasks = tasks(load, &cores, Some(place.location())).unwrap();
            (tasks.len(), cores_of(&tasks))
        };
        assert_eq!(count(Load::Cpu), (3, vec![2, 3, 5]));
        assert_eq!(count(Load::Clients), (5, vec![2, 3, 5, 2, 3]));
        assert_eq!(count(Load::CpuEverywhere).1, [2, 3, 5, 7, 2, 3, 5, 7]);
        assert_eq!(count(Load::All).0, 3 + 3 + 1 + 5 + 2);
        assert_eq!(count(Load::StressNg), (1, vec![]));
    }

    #[test]
    fn a_load_on_a_daemon_needs_one() {
        let cores = Cores::find().unwrap();
        for load in Load::OWN {
            let tasks = tasks(load, &cores, None);
            assert_eq!(tasks.is_err(), load.needs_daemon(), "{load:?}");
        }
    }
}
