use std::collections::VecDeque;

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::limits::CABLES_MAX;

/// Number of cable measurements kept, for a tip measurement that arrives later.
const REMEMBERED: usize = 200;

/// A tip measurement, and the cables at that time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair {
    /// Time since the recording began \[s\].
    pub(super) time_s: f64,
    pub(super) cable_length_m: [f64; CABLES_MAX],
    pub(super) tip_position_m: [f64; 3],
}

/// Makes pairs of cables and tips from records. Measurements that are not finite are skipped.
#[derive(Debug)]
pub(super) struct Pairs {
    /// Start of the recording \[ns\].
    start_ns: u64,
    /// Cables with the time of their measurement \[ns\], oldest first.
    seen: VecDeque<(u64, [f64; CABLES_MAX])>,
    /// Tips that wait for a later measurement of the cables.
    waiting: VecDeque<(u64, [f64; 3])>,
    newest_tip_ns: u64,
}

impl Pairs {
    /// For measurements from the cycle of `first` on.
    pub(super) fn new(first: &Telemetry) -> Self {
        Self {
            start_ns: first.release_ns,
            seen: VecDeque::new(),
            waiting: VecDeque::new(),
            newest_tip_ns: 0,
        }
    }

    /// Adds a record; [`Self::next_pair`] then returns the completed pairs.
    pub(super) fn take(&mut self, record: &Telemetry) {
        let measured = &record.measurement;
        let newest_ns = self.seen.back().map_or(0, |(newest_ns, _)| *newest_ns);
        let is_cables = measured.kind == MeasurementKind::CableLengths.code();
        let lengths_m = measured.cable_length_m;
        if is_cables && measured.measured_ns > newest_ns && is_finite(&lengths_m) {
            self.seen.push_back((measured.measured_ns, lengths_m));
            if self.seen.len() > REMEMBERED {
                self.seen.pop_front();
            }
        }
        if record.tip_measured_ns > self.newest_tip_ns {
            self.newest_tip_ns = record.tip_measured_ns;
            let tip_m = record.tip_measured_m;
            if record.tip_measured_ns >= self.start_ns && is_finite(&tip_m) {
                self.waiting.push_back((record.tip_measured_ns, tip_m));
            }
        }
    }

    /// The oldest completed pair.
    pub(super) fn next_pair(&mut self) -> Option<Pair> {
        loop {
            let (tip_ns, tip_position_m) = *self.waiting.front()?;
            if self.seen.back()?.0 < tip_ns {
                return None;
            }
            self.waiting.pop_front();
            if let Some(cable_length_m) = self.lengths_at(tip_ns) {
                return Some(Pair {
                    time_s: (tip_ns - self.start_ns) as f64 * 1e-9,
                    cable_length_m,
                    tip_position_m,
                });
            }
        }
    }

    /// Cables interpolated between two measurements; `None` when the time is before the kept measurements.
    fn lengths_at(&self, time_ns: u64) -> Option<[f64; CABLES_MAX]> {
        let after = self.seen.iter().position(|(ns, _)| *ns >= time_ns)?;
        let (after_ns, after_m) = self.seen[after];
        if after_ns == time_ns {
            return Some(after_m);
        }
        let (before_ns, before_m) = *self.seen.get(after.checked_sub(1)?)?;
        let part = (time_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
        Some(core::array::from_fn(|i| {
            before_m[i] + part * (after_m[i] - before_m[i])
        }))
    }
}

fn is_finite(numbers: &[f64]) -> bool {
    numbers.iter().all(|number| number.is_finite())
}
