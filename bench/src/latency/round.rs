//! Measurements of one round.

use anyhow::Result;
use cdcr_client::monotonic_ns;

use super::leg::Leg;
use crate::dataset::Recording;
use crate::quantiles::histogram;

pub(super) struct Round {
    /// Stops without a result: a record or command is missing, or the robot was hardly moving.
    pub(super) spoilt_stops: u64,
    /// Samples whose command the client did not receive, because it was away too long.
    pub(super) without_command: u64,
    began_ns: u64,
    legs: Vec<Recording>,
}

/// Times at which a message was sent, gathered and answered \[ns, `CLOCK_MONOTONIC`\].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_field_names, reason = "the unit ends each name")]
pub(super) struct Passage {
    pub(super) sent_ns: u64,
    pub(super) gather_ns: u64,
    pub(super) received_ns: u64,
}

impl Round {
    /// An empty round of a run that began at `began_ns` \[`CLOCK_MONOTONIC`\].
    pub(super) fn new(began_ns: u64) -> Result<Self> {
        let empty = |leg: Leg| {
            Ok(Recording {
                tag: leg.name().to_owned(),
                start_s: 0.0,
                duration_s: 0.0,
                histogram_ns: histogram()?,
            })
        };
        Ok(Self {
            spoilt_stops: 0,
            without_command: 0,
            began_ns,
            legs: Leg::ALL.into_iter().map(empty).collect::<Result<_>>()?,
        })
    }

    pub(super) fn leg(&self, leg: Leg) -> &Recording {
        &self.legs[leg as usize]
    }

    /// Adds a latency, limited to one minute.
    pub(super) fn record(&mut self, leg: Leg, latency_ns: u64) {
        let now_s = monotonic_ns().saturating_sub(self.began_ns) as f64 * 1e-9;
        let recording = &mut self.legs[leg as usize];
        if recording.histogram_ns.is_empty() {
            recording.start_s = now_s;
        }
        recording.duration_s = now_s - recording.start_s;
        recording.histogram_ns.saturating_record(latency_ns);
    }

    /// Adds a whole leg and its two parts. A message that came during its gather did not wait.
    pub(super) fn record_way(&mut self, whole: Leg, passage: &Passage) {
        let whole_ns = passage.received_ns.saturating_sub(passage.sent_ns);
        let grid_ns = passage
            .gather_ns
            .saturating_sub(passage.sent_ns)
            .min(whole_ns);
        let times_ns = [whole_ns, grid_ns, whole_ns - grid_ns];
        for (leg, time_ns) in whole.with_parts().into_iter().zip(times_ns) {
            self.record(leg, time_ns);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_is_made_of_a_wait_for_the_grid_and_machinery() {
        for grid in Leg::ALL.into_iter().filter(|leg| leg.is_grid()) {
            let whole = Leg::ALL[grid as usize - 1];
            let mut round = Round::new(0).expect("bounds");
            for gather_ns in [400, 90] {
                let passage = Passage {
                    sent_ns: 100,
                    gather_ns,
                    received_ns: 1000,
                };
                round.record_way(whole, &passage);
            }
            let [whole, grid, machinery] = whole.with_parts();
            let (way, part) = grid.name().split_once('.').expect("a way and a part");
            assert!(whole.name().starts_with(way) && part == "grid");
            assert_eq!(machinery.name(), format!("{way}.machinery"));
            for (leg, times_ns) in [(whole, [900; 2]), (grid, [300, 0]), (machinery, [600, 900])] {
                let found = &round.leg(leg).histogram_ns;
                assert_eq!(found.len(), 2);
                assert!(times_ns.iter().all(|ns| found.count_at(*ns) > 0), "{leg:?}");
            }
        }
    }
}
