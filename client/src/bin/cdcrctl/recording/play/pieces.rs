//! Where the pieces of a recorded reference begin away from the tip.
//!
//! Between two tracked pieces the recorded robot may have moved otherwise: home, a motion by hand, a reference from before
//! the recording. That is not replayed, so the tip is where the piece before ended.

use std::path::Path;

use anyhow::ensure;
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{ChunkMode, Mode, ReferenceState};

use crate::recording::file::{RecordedMessage, Recording};
use crate::standing::distance_m;

/// From a beginning farther away than this, the tip is visibly beside the reference for a while \[m\].
const FAR_M: f64 = 0.02;
/// Number of pieces that are listed.
const LISTED: usize = 10;

/// The pieces that begin farther from the tip than [`FAR_M`], which is in the place of the last tracked point before.
#[derive(Debug)]
pub(super) struct Pieces {
    /// The tip as the replay would have it \[m\].
    tip_m: [f64; 3],
    first_ns: Option<u64>,
    /// Whether a reference has begun in the recording: only such ones are sent.
    is_sent: bool,
    /// The newest cycle, if it tracked \[ns\].
    tracked_ns: Option<u64>,
    /// Time in the recording \[s\] and distance \[m\].
    far: Vec<(f64, f64)>,
    /// The first piece has begun, and a later one is among those.
    has_begun: bool,
    is_later_far: bool,
}

impl Pieces {
    /// Reads the recording to its end, for a replay that begins with the tip at `tip_m`.
    pub(super) fn read(file: &Path, tip_m: [f64; 3]) -> anyhow::Result<Self> {
        let mut recording = Recording::open(file)?;
        let mut pieces = Self::from_tip(tip_m);
        while let Some(message) = recording.next_message()? {
            match message {
                RecordedMessage::Reference(chunk) => {
                    pieces.is_sent |= chunk.mode == ChunkMode::Replace.code();
                }
                RecordedMessage::Telemetry(record) => pieces.take(&record),
                _ => {}
            }
        }
        Ok(pieces)
    }

    fn from_tip(tip_m: [f64; 3]) -> Self {
        Self {
            tip_m,
            first_ns: None,
            is_sent: false,
            tracked_ns: None,
            far: Vec::new(),
            has_begun: false,
            is_later_far: false,
        }
    }

    fn take(&mut self, record: &Telemetry) {
        let now_ns = record.release_ns;
        let first_ns = *self.first_ns.get_or_insert(now_ns);
        let before_ns = self.tracked_ns.take();
        let is_known = record.reference.state != ReferenceState::None.code();
        if record.mode != Mode::Tracking.code() || !is_known || !self.is_sent {
            return;
        }
        let away_m = distance_m(self.tip_m, record.reference.position_m);
        // A reference that is replaced while it is followed jumps from one cycle to the next; across a gap it has moved.
        let is_next = |before_ns| now_ns.saturating_sub(before_ns) <= 2 * record.period_ns;
        if before_ns.is_none_or(is_next) && away_m > FAR_M {
            let since_s = now_ns.saturating_sub(first_ns) as f64 * 1e-9;
            self.far.push((since_s, away_m));
            self.is_later_far |= self.has_begun;
        }
        self.has_begun = true;
        self.tip_m = record.reference.position_m;
        self.tracked_ns = Some(now_ns);
    }

    /// What to print before anything moves, if a piece begins far away.
    ///
    /// # Errors
    /// If a later one does, and is faster than recorded: from piece to piece the tip swings out farther, several times as far as
    /// in the recording.
    pub(super) fn note(&self, name: &str, speed: f64) -> anyhow::Result<Option<String>> {
        if self.far.is_empty() {
            return Ok(None);
        }
        let listed = self.far.iter().take(LISTED);
        let mut places: Vec<_> = listed
            .map(|(since_s, away_m)| format!("{:.0} mm at {since_s:.1} s", 1e3 * away_m))
            .collect();
        if let more @ 1.. = self.far.len().saturating_sub(LISTED) {
            places.push(format!("{more} more"));
        }
        let places = places.join(", ");
        ensure!(
            speed <= 1.0 || !self.is_later_far,
            "in {name} pieces of the reference begin away from where the tip will be: {places}. At --speed {speed} the tip would swing out farther \
             with each of them. Nothing was sent. Replay it at --speed 1 or slower, or record one piece at a time"
        );
        let swing = if speed > 1.0 {
            format!(", and at --speed {speed} swings out farther than at 1")
        } else {
            String::new()
        };
        Ok(Some(format!(
            "note: in {name} the reference begins away from where the tip will be: {places}. The tip joins it while it moves{swing}. Motions by home or by hand \
             between pieces are not replayed; Ctrl-C holds the robot"
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 5_000_000;

    /// Times \[ms\] and distances \[mm\] of the pieces that begin far away; of each cycle number, mode, and the x of its reference \[m\].
    fn pieces(tip_m: f64, cycles: &[(u64, Mode, f64)]) -> Vec<(f64, f64)> {
        let mut pieces = Pieces::from_tip([tip_m, 0.0, 0.0]);
        pieces.is_sent = true;
        for (cycle, mode, x_m) in cycles {
            let mut record = Telemetry {
                mode: mode.code(),
                release_ns: 1_000_000_000 + PERIOD_NS * cycle,
                period_ns: PERIOD_NS,
                ..Telemetry::default()
            };
            record.reference.position_m = [*x_m, 0.0, 0.0];
            record.reference.state = ReferenceState::Inside.code();
            pieces.take(&record);
        }
        let far = pieces.far.iter();
        far.map(|(since_s, away_m)| ((since_s * 1e3).round(), (away_m * 1e3).round()))
            .collect()
    }

    #[test]
    fn a_piece_that_begins_away_from_the_end_of_the_one_before_is_listed() {
        use Mode::{Holding, Homing, Tracking};
        let goto = [
            (0, Holding, 0.0),
            (1, Tracking, 0.0),
            (2, Tracking, 0.01),
            (200, Holding, 0.08),
        ];
        // At rest where it begins, and away from it.
        assert!(pieces(0.0, &goto).is_empty());
        assert_eq!(pieces(-0.03, &goto), [(5.0, 30.0)]);
        // After a motion that is not replayed, and a reference that is replaced while it is followed.
        let cycles = [
            (0, Tracking, 0.0),
            (1, Tracking, 0.015),
            (2, Tracking, 0.03),
            (3, Homing, 0.03),
            (4, Tracking, 0.0),
            (5, Tracking, 0.1),
            // Missing records: the reference has moved meanwhile.
            (50, Tracking, 0.2),
        ];
        assert_eq!(pieces(0.0, &cycles), [(20.0, 30.0), (25.0, 100.0)]);
    }

    #[test]
    fn the_note_names_the_places_and_the_speed() {
        let mut pieces = Pieces::from_tip([0.0; 3]);
        assert_eq!(pieces.note("run.mcap", 4.0).unwrap(), None);
        pieces.far = vec![(12.4, 0.082); 12];
        let note = |pieces: &Pieces, speed| pieces.note("run.mcap", speed);
        let text = note(&pieces, 4.0).unwrap().unwrap();
        for part in ["82 mm at 12.4 s", "2 more", "--speed 4", "while it moves"] {
            assert!(text.contains(part), "{text}");
        }
        // Between pieces, from one to the next.
        pieces.is_later_far = true;
        let text = note(&pieces, 1.0).unwrap().unwrap();
        assert!(!text.contains("--speed"), "{text}");
        let text = note(&pieces, 1.1).unwrap_err().to_string();
        for part in ["82 mm at 12.4 s", "Nothing was sent", "--speed 1 or slower"] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn the_first_piece_may_begin_away_from_the_tip() {
        let is_later_far = |cycles: &[(u64, f64)]| {
            let mut pieces = Pieces::from_tip([-0.03, 0.0, 0.0]);
            pieces.is_sent = true;
            for (cycle, x_m) in cycles {
                let mut record = Telemetry {
                    mode: Mode::Tracking.code(),
                    release_ns: PERIOD_NS * cycle,
                    period_ns: PERIOD_NS,
                    ..Telemetry::default()
                };
                record.reference.position_m[0] = *x_m;
                record.reference.state = ReferenceState::Inside.code();
                pieces.take(&record);
            }
            pieces.is_later_far
        };
        assert!(!is_later_far(&[(1, 0.0), (2, 0.01)]));
        assert!(is_later_far(&[(1, 0.0), (2, 0.05)]));
    }
}
