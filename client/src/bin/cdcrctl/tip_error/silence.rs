use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::TipCause;

use super::frames::Frames;
use crate::unmeasured_tip::silence_ns;

/// Silence of a tip sensor beside bends or cables, along a reference.
#[derive(Debug, Default)]
pub(super) struct Silence {
    measured_ns: u64,
    /// Release of the first record with that measurement; the measurement itself, where it was there before \[ns\].
    since_ns: u64,
    /// Cycles since that measurement. They count if the sensor turns out to be silent.
    pending: u64,
    longest_ns: Option<u64>,
}

impl Silence {
    /// Returns for how many cycles it is known by this record that tip and error are those of the model. `frames` has taken it.
    pub(super) fn take(&mut self, record: &Telemetry, frames: &Frames) -> u64 {
        let measured_ns = frames.kept().map_or(0, |(measured_ns, _)| measured_ns);
        if self.measured_ns != measured_ns {
            self.since_ns = match self.measured_ns {
                0 => measured_ns,
                _ => record.release_ns,
            };
            self.measured_ns = measured_ns;
            self.pending = 0;
        }
        let silent_ns = silence_ns(record.release_ns, measured_ns);
        self.longest_ns = self.longest_ns.max(silent_ns);
        if silent_ns.is_some() {
            return 1 + core::mem::take(&mut self.pending);
        }
        let is_counted = frames.is_by_model(record.release_ns);
        self.pending += u64::from(!is_counted);
        u64::from(is_counted)
    }

    /// Why tip and error of the record that was taken last are those of the model. A measurement that arrived `fresh_ns`
    /// ago does not say where the tip is.
    pub(super) fn present_cause(
        &self,
        record: &Telemetry,
        frames: &Frames,
        fresh_ns: u64,
    ) -> Option<String> {
        let age_ns = record.release_ns.saturating_sub(self.since_ns);
        if self.measured_ns > 0 && age_ns >= fresh_ns {
            return Some(format!("tip sensor silent for {} s", seconds(age_ns)));
        }
        let cause = TipCause::try_from(record.tip_cause).ok()?;
        (cause != TipCause::None && frames.is_unmeasured())
            .then(|| format!("the measured tip is not in use because {cause}"))
    }

    pub(super) fn text(&self) -> Option<String> {
        let longest_s = seconds(self.longest_ns?);
        Some(format!("the tip sensor was silent for up to {longest_s} s"))
    }
}

fn seconds(ns: u64) -> String {
    format!("{:.1}", ns as f64 * 1e-9)
}
