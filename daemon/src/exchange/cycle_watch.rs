//! Scheduler statistics of the cycle thread, read on its core before its next cycle. The reporter may read
//! them later, and would assign the next cycle's lateness to this one.

use crate::handover::CycleRecord;
use crate::rt::attribution::Scheduling;
use crate::rt::schedule::Lateness;
use crate::rt::scheduler::SchedulerDeltas;

/// Page faults are read in one of this many punctual cycles.
const PAGE_FAULT_SAMPLE_PERIOD: u64 = 16;

#[derive(Debug, Default)]
pub(super) struct CycleWatch {
    scheduler: SchedulerDeltas,
    /// The last reading showed page faults.
    page_faults: bool,
    /// Number of times that the thread lost its core while it ran.
    interruptions: u64,
}

impl CycleWatch {
    /// Watches the thread with id `thread`; with `None`, `read` always returns `None`.
    pub(super) fn new(thread: Option<u32>) -> Self {
        Self {
            scheduler: SchedulerDeltas::new(thread),
            ..Self::default()
        }
    }

    /// Statistics since the previous call; `number` counts the records. Page faults are expensive to read.
    /// They are read for a cycle that was late or shares a reading, in each cycle while there are some, and
    /// in one of `PAGE_FAULT_SAMPLE_PERIOD` others. So few are assigned to a wrong cycle.
    pub(super) fn read(
        &mut self,
        record: &CycleRecord,
        is_newest: bool,
        number: u64,
    ) -> Option<Scheduling> {
        let was_late = record.lateness != Lateness::default() || record.release.skipped > 0;
        let by_turn = number.is_multiple_of(PAGE_FAULT_SAMPLE_PERIOD);
        let delta = if was_late || !is_newest || by_turn || self.page_faults {
            let delta = self.scheduler.read();
            self.page_faults = delta.is_some_and(|delta| delta.page_faults > 0);
            delta
        } else {
            self.scheduler.read_without_page_faults()
        };
        self.interruptions += u64::from(delta.map_or(0, |delta| delta.switches));
        delta
    }

    pub(super) fn interruptions(&self) -> u64 {
        self.interruptions
    }
}
