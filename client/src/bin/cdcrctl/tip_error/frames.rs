use cdcr_controller::estimator::FAR_LIMIT;
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::TipCause;

use crate::unmeasured_tip::{SILENT_NS, silence_ns};

/// What became of the newest tip measured beside bends or cables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Frame {
    /// It is the one of the record before.
    Known,
    Used,
    /// The daemon refused it, and no more in a row than a good sensor has: it does not show where the tip is.
    Stray,
    /// The daemon refuses them for longer: the sensor or the model is wrong.
    Refused,
}

/// Which measured tips show where the tip is. It takes all records, also of cycles that do not track.
#[derive(Debug, Default)]
pub(super) struct Frames {
    newest_ns: u64,
    /// The newest that is not a stray value: when and where \[ns, m\].
    kept_ns: u64,
    kept_m: [f64; 3],
    /// Refused ones in a row, and the release that had the first of them \[ns\].
    in_a_row: u32,
    since_ns: u64,
    is_refused: bool,
}

impl Frames {
    pub(super) fn take(&mut self, record: &Telemetry) -> Frame {
        let is_new = record.tip_measured_ns > self.newest_ns;
        self.newest_ns = self.newest_ns.max(record.tip_measured_ns);
        // So many in a row are refused for longer, whatever their cause; `None`: the cause itself lasts.
        let limit = match TipCause::try_from(record.tip_cause) {
            Ok(TipCause::None) => {
                (self.in_a_row, self.is_refused) = (0, false);
                return self.keep(record, is_new, Frame::Used);
            }
            Ok(TipCause::Far) => Some(FAR_LIMIT),
            Ok(TipCause::Jumps) => Some(record.measurement_jump_limit),
            _ => None,
        };
        if is_new {
            if self.in_a_row == 0 {
                self.since_ns = record.release_ns;
            }
            self.in_a_row += 1;
        }
        // A high limit does not hide a wrong sensor; one that measures once a second may have one stray tip.
        let lasts =
            self.in_a_row > 1 && record.release_ns.saturating_sub(self.since_ns) > SILENT_NS;
        self.is_refused |= lasts || limit.is_none_or(|limit| self.in_a_row >= limit);
        if self.is_refused {
            self.keep(record, is_new, Frame::Refused)
        } else if is_new {
            Frame::Stray
        } else {
            Frame::Known
        }
    }

    fn keep(&mut self, record: &Telemetry, is_new: bool, frame: Frame) -> Frame {
        if !is_new {
            return Frame::Known;
        }
        (self.kept_ns, self.kept_m) = (record.tip_measured_ns, record.tip_measured_m);
        frame
    }

    /// The newest measured tip that is not a stray value \[ns, m\]; `None` before the first.
    pub(super) fn kept(&self) -> Option<(u64, [f64; 3])> {
        (self.kept_ns > 0).then_some((self.kept_ns, self.kept_m))
    }

    /// Whether the measured tip is refused for longer, or the sensor has been silent until this release: tip and error are
    /// those of the model.
    pub(super) fn is_by_model(&self, release_ns: u64) -> bool {
        self.is_refused || silence_ns(release_ns, self.kept_ns).is_some()
    }

    /// Whether tips are refused for longer: the first of them were not stray values either.
    pub(super) fn is_refused(&self) -> bool {
        self.is_refused
    }

    /// The same of a single refusal, where nothing else was measured.
    pub(super) fn is_unmeasured(&self) -> bool {
        self.is_refused || self.kept_ns == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tip_is_stray_until_as_many_in_a_row_are_refused_as_make_a_wrong_sensor() {
        use Frame::{Refused, Stray, Used};
        use TipCause::{Far, Frozen, Jumped, Jumps, None, WasFar};
        for (jump_limit, step_ns, causes, frames) in [
            (3, 1, vec![None, Jumps, None], vec![Used, Stray, Used]),
            (
                3,
                1,
                vec![Jumps, Jumps, Jumped],
                vec![Stray, Stray, Refused],
            ),
            (
                3,
                1,
                vec![Far, Far, Far, WasFar],
                vec![Stray, Stray, Refused, Refused],
            ),
            (
                3,
                1,
                vec![Far, Jumps, None, Far],
                vec![Stray, Stray, Used, Stray],
            ),
            (1, 1, vec![Jumps, None], vec![Refused, Used]),
            (9, 1, vec![Jumps; 4], vec![Stray; 4]),
            (3, 1, vec![Frozen], vec![Refused]),
            // For longer than a second.
            (9, 600_000_000, vec![Jumps; 3], vec![Stray, Stray, Refused]),
            (3, 2_000_000_000, vec![Far, None], vec![Stray, Used]),
        ] {
            let mut seen = Frames::default();
            let found = (1..).zip(&causes).map(|(k, cause)| {
                let mut record = Telemetry {
                    release_ns: 10 + k * step_ns,
                    tip_measured_ns: k * step_ns,
                    tip_cause: cause.code(),
                    measurement_jump_limit: jump_limit,
                    ..Telemetry::default()
                };
                let frame = seen.take(&record);
                record.release_ns += 1;
                assert_eq!(seen.take(&record), Frame::Known);
                frame
            });
            assert_eq!(found.collect::<Vec<_>>(), frames, "{causes:?}");
        }
    }
}
