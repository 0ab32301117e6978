use cdcr_shared_types::Measurement;
use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::limits::BENDS_LATE_MS;

/// What a driver has measured so far.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Measured {
    /// The last measurement of bends or cables.
    pub(super) bends: Option<Measurement>,
    /// Time of the first measurement of the tip \[ns\].
    first_tip_ns: Option<u64>,
}

impl Measured {
    /// Adds a measurement sent at `now_ns`.
    #[must_use]
    pub(super) fn with(mut self, measurement: &Measurement, now_ns: u64) -> Self {
        if measurement.kind == MeasurementKind::TipPose.code() {
            self.first_tip_ns.get_or_insert(now_ns);
        } else {
            self.bends = Some(*measurement);
        }
        self
    }

    /// A measurement was sent.
    pub(super) fn has_begun(&self) -> bool {
        self.bends.is_some() || self.first_tip_ns.is_some()
    }

    /// A first position may be followed: what is measured of the bends is known. A tip does not show how the
    /// robot is bent, so bends or cables are awaited for as long as the daemon awaits them.
    pub(super) fn may_begin(&self, now_ns: u64) -> bool {
        let late_ns = 1_000_000 * BENDS_LATE_MS as u64;
        let measures_tip_alone = |since_ns| now_ns.saturating_sub(since_ns) >= late_ns;
        self.bends.is_some() || self.first_tip_ns.is_some_and(measures_tip_alone)
    }
}

#[cfg(test)]
mod tests;
