//! What the scheduler did to the cycle thread, read on its core and before its next cycle: the reporter may come later, and would
//! tell the next cycle's lateness of this one.

use crate::handover::CycleRecord;
use crate::rt::attribution::Scheduling;
use crate::rt::schedule::Lateness;
use crate::rt::scheduler::SchedulerLooks;

/// Page faults are read in one of so many cycles that were in time.
const PAGE_FAULT_LOOKS: u64 = 16;

#[derive(Debug, Default)]
pub(super) struct CycleWatch {
    scheduler: SchedulerLooks,
    /// There were some at the last look.
    page_faults: bool,
    /// Times that the thread lost its core while it ran.
    interruptions: u64,
}

impl CycleWatch {
    /// Watches the thread of that number, or none: then nothing is ever told.
    pub(super) fn at(thread: Option<u32>) -> Self {
        Self {
            scheduler: SchedulerLooks::at(thread),
            ..Self::default()
        }
    }

    /// What happened since the look before; `number` counts the records. Page faults are dear to read: of a cycle that was late or waited
    /// beside another, in each cycle while there are some, and else now and then, so that few are told of another cycle.
    pub(super) fn look(
        &mut self,
        record: &CycleRecord,
        is_newest: bool,
        number: u64,
    ) -> Option<Scheduling> {
        let was_late = record.lateness != Lateness::default() || record.release.skipped > 0;
        let by_turn = number.is_multiple_of(PAGE_FAULT_LOOKS);
        let told = if was_late || !is_newest || by_turn || self.page_faults {
            let told = self.scheduler.look();
            self.page_faults = told.is_some_and(|told| told.page_faults > 0);
            told
        } else {
            self.scheduler.look_quickly()
        };
        self.interruptions += u64::from(told.map_or(0, |told| told.switches));
        told
    }

    pub(super) fn interruptions(&self) -> u64 {
        self.interruptions
    }
}
