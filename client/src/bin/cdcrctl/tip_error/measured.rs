use std::collections::VecDeque;

use cdcr_shared_types::Telemetry;

use super::frames::Frame;

/// The error according to a tip sensor, which has noise but no model: it includes errors of the estimate.
#[derive(Debug, Default)]
pub(super) struct MeasuredError {
    /// Reference at the newest releases \[ns, m\], oldest first.
    reference: VecDeque<(u64, [f64; 3])>,
    /// The cycles since then did not track it: the next one begins anew.
    pub(super) is_left: bool,
    newest_ns: u64,
    /// Time between the last two measurements \[ns\]; 0 before the second one.
    pub(super) interval_ns: u64,
    /// The newest error that was computed, and the time of its measurement \[m, ns\].
    error_m: f64,
    error_ns: u64,
    sums: Sums,
    /// Of the stray ones since the last one that was used: they count if the sensor turns out to be wrong.
    pending: Sums,
    strays: u64,
}

#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Sums {
    pub(super) count: u64,
    pub(super) sum_m: f64,
    pub(super) max_m: f64,
}

impl Sums {
    fn add(&mut self, other: Self) {
        self.count += other.count;
        self.sum_m += other.sum_m;
        self.max_m = self.max_m.max(other.max_m);
    }
}

/// A tip measurement of this age belongs to the path, not to its end, unless the sensor is slow \[ns\].
pub(super) const FRESH_NS: u64 = 100_000_000;
/// The newest measurement of a slow sensor is up to an interval old, and late in addition.
const FRESH_INTERVALS: u64 = 2;
/// Number of kept releases: enough for a sensor that is half a second late at 5 ms.
const REMEMBERED: usize = 100;

impl MeasuredError {
    /// Decides about the pending ones by a record, also by one that does not track or has no new tip.
    pub(super) fn settle(&mut self, frame: Frame, is_refused: bool) {
        if is_refused {
            self.sums.add(core::mem::take(&mut self.pending));
        } else if frame == Frame::Used {
            self.strays += core::mem::take(&mut self.pending).count;
        }
    }

    /// Takes a record that tracks, after [`Self::settle`].
    pub(super) fn take(&mut self, record: &Telemetry, frame: Frame) {
        if core::mem::take(&mut self.is_left) {
            self.reference.clear();
        } else if self.reference.len() == REMEMBERED {
            self.reference.pop_front();
        }
        let here = (record.release_ns, record.reference.position_m);
        self.reference.push_back(here);
        let tip_ns = record.tip_measured_ns;
        if tip_ns <= self.newest_ns {
            return;
        }
        if self.newest_ns > 0 {
            self.interval_ns = tip_ns - self.newest_ns;
        }
        self.newest_ns = tip_ns;
        let after = self
            .reference
            .partition_point(|(time_ns, _)| *time_ns < tip_ns);
        let Some([(from_ns, from_m), (to_ns, to_m)]) = after
            .checked_sub(1)
            .and_then(|before| Some([*self.reference.get(before)?, *self.reference.get(after)?]))
        else {
            return;
        };
        let share = (tip_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
        let square: f64 = (0..3)
            .map(|i| {
                let reference_m = from_m[i] + share * (to_m[i] - from_m[i]);
                (record.tip_measured_m[i] - reference_m).powi(2)
            })
            .sum();
        let error_m = square.sqrt();
        let sums = Sums {
            count: 1,
            sum_m: error_m,
            max_m: error_m,
        };
        if frame == Frame::Stray {
            return self.pending.add(sums);
        }
        (self.error_m, self.error_ns) = (error_m, tip_ns);
        self.sums.add(sums);
    }

    /// Of all but stray ones.
    pub(super) fn sums(&self) -> Sums {
        self.sums
    }

    /// The stray ones, which the daemon refused.
    pub(super) fn strays(&self) -> u64 {
        self.strays + self.pending.count
    }

    /// The newest error, while the sensor measures: it does not belong to a later place of the reference.
    pub(super) fn newest_m(&self) -> Option<f64> {
        let (now_ns, _) = self.reference.back()?;
        let is_fresh = now_ns.saturating_sub(self.error_ns) < self.fresh_ns();
        (self.sums.count > 0 && is_fresh).then_some(self.error_m)
    }

    pub(super) fn fresh_ns(&self) -> u64 {
        FRESH_NS.max(self.interval_ns.saturating_mul(FRESH_INTERVALS))
    }
}
