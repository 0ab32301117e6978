//! The measured core, and the cores of the load.

use std::thread;

use anyhow::{Context, Result, anyhow};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

use super::thread::{CLIENT_PRIORITY, pin, set_fifo};

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cores {
    /// Core of the daemon's real-time threads: the last one, which is also the daemon's own default.
    pub realtime: usize,
    /// Cores of clients and loads: all others, or the same core if there is no other.
    pub others: Vec<usize>,
    all: CpuSet,
}

impl Cores {
    /// The cores that this process may use. Call it before any thread of the process is pinned.
    pub fn find() -> Result<Self> {
        let ids = core_affinity::get_core_ids().context("the system does not report its cores")?;
        let mut ids: Vec<usize> = ids.iter().map(|core| core.id).collect();
        ids.sort_unstable();
        let realtime = ids.pop().context("this process may use no core")?;
        if ids.is_empty() {
            ids.push(realtime);
        }
        let all = sched_getaffinity(None).context("the cores of this process")?;
        Ok(Self {
            realtime,
            others: ids,
            all,
        })
    }

    /// Whether client and loads share the daemon's core.
    pub fn is_alone(&self) -> bool {
        self.others.contains(&self.realtime)
    }

    pub fn client(&self) -> usize {
        self.others[0]
    }

    /// The same for processes that must never run on the real-time core.
    #[must_use]
    pub fn without_realtime(&self) -> Self {
        Self {
            all: self.set_of_others(),
            ..self.clone()
        }
    }

    /// Excludes the real-time core for the calling thread and the threads that it starts later.
    pub fn stay_off(&self) {
        // When refused, the thread may use all cores, and delays the daemon only when it has work.
        let _ = sched_setaffinity(None, &self.set_of_others());
    }

    fn set_of_others(&self) -> CpuSet {
        let mut set = CpuSet::new();
        self.others.iter().for_each(|core| set.set(*core));
        set
    }

    /// Calls `start` with all cores allowed, so that the process that it starts may choose its cores.
    pub fn with_all<R>(&self, start: impl FnOnce() -> R) -> R {
        with_affinity(&self.all, start)
    }

    /// Runs `work` on a separate thread on the client's core; with `realtime`, before all ordinary tasks.
    pub fn on_client<T: Send>(
        &self,
        realtime: bool,
        work: impl FnOnce() -> Result<T> + Send,
    ) -> Result<T> {
        let work = || {
            if realtime {
                set_fifo(CLIENT_PRIORITY);
            }
            pin(self.client());
            work()
        };
        let worked = thread::scope(|scope| scope.spawn(work).join());
        worked.map_err(|_| anyhow!("the client panicked"))?
    }
}

/// Calls `start` with this affinity, as far as the system grants it.
pub(crate) fn with_affinity<R>(allowed: &CpuSet, start: impl FnOnce() -> R) -> R {
    let before = sched_getaffinity(None);
    let _ = sched_setaffinity(None, allowed);
    let result = start();
    if let Ok(before) = before {
        let _ = sched_setaffinity(None, &before);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_real_time_core_is_left_alone_where_there_is_another() {
        let cores = thread::spawn(|| {
            let cores = Cores::find().expect("cores");
            cores.stay_off();
            let allowed = sched_getaffinity(None).expect("cores");
            assert_eq!(allowed.is_set(cores.realtime), cores.is_alone());
            let inside = cores.with_all(|| sched_getaffinity(None).expect("cores"));
            assert!(inside.is_set(cores.realtime));
            assert_eq!(sched_getaffinity(None).expect("cores"), allowed);
            cores
        });
        let cores = cores.join().expect("no panic");
        assert!(!cores.others.is_empty());
    }
}
