//! Late cycles by what made them late.

use cdcr_shared_types::Statistics;
use cdcr_shared_types::codes::LateCause;
use serde::Serialize;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Causes {
    /// The timer or the processor itself came late: hypervisor, firmware.
    pub platform: u64,
    pub load: u64,
    /// The computation took too long: ours.
    pub compute: u64,
    /// A page of memory was not there: ours.
    pub fault: u64,
    /// The processor stood still in the middle of a computation, or nothing is known.
    pub other: u64,
}

impl Causes {
    pub fn reported(statistics: &Statistics) -> Self {
        let of = |cause: LateCause| statistics.causes[cause.code() as usize];
        Self {
            platform: of(LateCause::Platform),
            load: of(LateCause::Load),
            compute: of(LateCause::Compute),
            fault: of(LateCause::PageFault),
            other: of(LateCause::Stall),
        }
    }

    pub fn count(&mut self, cause: LateCause) {
        *match cause {
            LateCause::Platform => &mut self.platform,
            LateCause::Load => &mut self.load,
            LateCause::Compute => &mut self.compute,
            LateCause::PageFault => &mut self.fault,
            LateCause::Stall | LateCause::None => &mut self.other,
        } += 1;
    }

    pub fn own(&self) -> u64 {
        self.fault + self.compute
    }

    pub fn all(&self) -> u64 {
        self.own() + self.platform + self.load + self.other
    }

    /// Without those that did not happen.
    pub fn words(self) -> String {
        let all = [
            (self.platform, "platform"),
            (self.load, "another task"),
            (self.fault, "page fault"),
            (self.other, "stall"),
            (self.compute, "compute"),
        ];
        let there = all.iter().filter(|(count, _)| *count > 0);
        let words = there.map(|(count, name)| format!("{count} {name}"));
        words.collect::<Vec<_>>().join(", ")
    }
}
