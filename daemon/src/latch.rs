//! A stop outlives the daemon: until a reset, a word in the root folder keeps the mode and reason of a stop
//! or a fault.

use std::io::Result;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use cdcr_shared_types::codes::{Mode, Reason};

use crate::mapped;

/// No stop, and no fault.
const FREE: u64 = 0;
/// Beside the mode: the robot was measured far from where its last command left it.
const POSE_UNCERTAIN: u64 = 1 << 31;
/// Beside the mode: the obstacles of the daemon before are lost. Every stop and fault after that keeps it.
const OBSTACLES_LOST: u64 = 1 << 30;

/// The latch of a robot, for every daemon of it. The default keeps nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Latch(Option<&'static AtomicU64>);

impl Latch {
    /// Opens the latch in the file at `path`; creates a missing file for the user of this process alone.
    pub fn open(path: &Path) -> Result<Self> {
        let [word] = mapped::open(path)?;
        Ok(Self(Some(word)))
    }

    /// Mode and reason of the latch as text, until a reset.
    pub fn describe(&self) -> Option<String> {
        let word = self.word();
        let mode = (word & !(POSE_UNCERTAIN | OBSTACLES_LOST)) as u32;
        let reason = (word >> 32) as u32;
        let description = || format!("{} ({})", Mode::text_of(mode), Reason::text_of(reason));
        (word != FREE).then(description)
    }

    /// Latches a stop or a fault.
    pub fn set(&self, mode: Mode, reason: Reason) {
        let lost = self.word() & OBSTACLES_LOST;
        self.store(word_of(mode, reason) | lost);
    }

    /// The last daemon left the pose uncertain.
    pub fn is_pose_uncertain(&self) -> bool {
        self.word() & POSE_UNCERTAIN != 0
    }

    /// Notes beside a stop or a fault whether the pose is uncertain.
    pub fn set_pose_uncertain(&self, is_uncertain: bool) {
        let word = self.word();
        if word != FREE && self.is_pose_uncertain() != is_uncertain {
            self.store(word ^ POSE_UNCERTAIN);
        }
    }

    /// Clears the latch after a reset.
    pub fn clear(&self) {
        self.store(FREE);
    }

    /// Latches a requested stop, which may find no cycle to carry it out.
    pub fn stop_asked(&self) {
        if let Some(word) = self.0 {
            let stopped = word_of(Mode::Stopped, Reason::Request);
            // The cycle may already have latched a more specific reason.
            let _ = word.compare_exchange(FREE, stopped, Ordering::AcqRel, Ordering::Acquire);
        }
    }

    /// Latches that the obstacles of the daemon before are lost, whatever has stopped the robot before: what is in its way
    /// has to be added again.
    pub fn lose_obstacles(&self) {
        let uncertainty = self.word() & POSE_UNCERTAIN;
        self.store(word_of(Mode::Stopped, Reason::ObstaclesLost) | OBSTACLES_LOST | uncertainty);
    }

    /// They are, whatever has stopped the robot since.
    pub fn has_lost_obstacles(&self) -> bool {
        self.word() & OBSTACLES_LOST != 0
    }

    /// Creates a deleted file again, with its folder, if the robot is latched. Returns true if it is not.
    pub(crate) fn leave(&self, path: &Path) -> Result<bool> {
        let is_free = self.word() == FREE;
        if let Some(word) = self.0.filter(|_| !is_free) {
            mapped::make_again(path, std::slice::from_ref(word))?;
        }
        Ok(is_free)
    }

    fn word(&self) -> u64 {
        self.0.map_or(FREE, |word| word.load(Ordering::Acquire))
    }

    fn store(&self, value: u64) {
        if let Some(word) = self.0 {
            word.store(value, Ordering::Release);
        }
    }
}

fn word_of(mode: Mode, reason: Reason) -> u64 {
    u64::from(mode.code()) | u64::from(reason.code()) << 32
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    #[test]
    fn what_was_latched_is_found_again_until_it_is_cleared() {
        let folder = Scratch::in_memory().unwrap();
        let path = folder.path().join("root/a.latch");
        std::fs::create_dir(path.parent().unwrap()).unwrap();
        // Its creator was killed before it wrote anything.
        std::fs::File::create(&path).unwrap();
        let latch = Latch::open(&path).unwrap();
        assert_eq!(latch.describe(), None);
        assert!(latch.leave(&path).unwrap());
        latch.set(Mode::Faulted, Reason::MeasurementLost);
        // A later stop does not change the reason.
        latch.stop_asked();
        let description = "faulted (the measurement is lost)";
        assert_eq!(
            Latch::open(&path).unwrap().describe().as_deref(),
            Some(description)
        );
        std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
        assert!(!latch.leave(&path).unwrap());
        let found = Latch::open(&path).unwrap();
        assert_eq!(found.describe().as_deref(), Some(description));
        for is_uncertain in [true, true, false, true] {
            found.set_pose_uncertain(is_uncertain);
            let next = Latch::open(&path).unwrap();
            assert_eq!(next.is_pose_uncertain(), is_uncertain);
            assert_eq!(next.describe().as_deref(), Some(description));
        }
        // Lost obstacles come first, and the uncertainty remains.
        assert!(!found.has_lost_obstacles());
        found.lose_obstacles();
        assert!(found.has_lost_obstacles() && found.is_pose_uncertain());
        found.set(Mode::Faulted, Reason::MeasurementLost);
        assert!(Latch::open(&path).unwrap().has_lost_obstacles());
        assert_eq!(found.describe().as_deref(), Some(description));
        found.clear();
        assert!(!found.has_lost_obstacles());
        // No pose is uncertain without a stop.
        found.set_pose_uncertain(true);
        assert_eq!(Latch::open(&path).unwrap().describe(), None);
    }
}
