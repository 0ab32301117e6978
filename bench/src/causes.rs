//! Late cycles by cause.

use cdcr_shared_types::codes::LateCause::{self, Compute, Load, PageFault, Platform, Stall};
use serde::{Serialize, Serializer};

/// Key in results of each cause except `None`.
const KEYS: [(LateCause, &str); LateCause::COUNT - 1] = [
    (Platform, "platform"),
    (Load, "load"),
    (PageFault, "fault"),
    (Stall, "other"),
    (Compute, "compute"),
];

/// Causes of the daemon itself.
pub const OWN: [LateCause; 2] = [PageFault, Compute];

/// Counts by the code of their cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Causes(pub [u64; LateCause::COUNT]);

impl Causes {
    /// A cycle without a known cause counts as a stall.
    pub fn count(&mut self, cause: LateCause) {
        let counted = match cause {
            LateCause::None => Stall,
            known => known,
        };
        self.0[counted.code() as usize] += 1;
    }

    fn get(&self, cause: LateCause) -> u64 {
        self.0[cause.code() as usize]
    }

    pub fn own(&self) -> u64 {
        OWN.map(|cause| self.get(cause)).iter().sum()
    }

    pub fn all(&self) -> u64 {
        KEYS.iter().map(|(cause, _)| self.get(*cause)).sum()
    }

    pub fn words(self) -> String {
        let there = KEYS.iter().filter(|(cause, _)| self.get(*cause) > 0);
        let words = there.map(|(cause, _)| format!("{} {cause}", self.get(*cause)));
        words.collect::<Vec<_>>().join(", ")
    }
}

impl Serialize for Causes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(KEYS.map(|(cause, key)| (key, self.get(cause))))
    }
}
