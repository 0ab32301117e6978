//! What one round measured.

use anyhow::Result;
use cdcr_client::monotonic_ns;
use hdrhistogram::Histogram;

use super::leg::Leg;
use crate::quantiles::histogram;

pub(super) struct Sampled {
    pub(super) latencies: Histogram<u64>,
    /// When the first and the last one were recorded, after the start of the run \[ns\].
    pub(super) span_ns: Option<(u64, u64)>,
}

pub(super) struct Round {
    /// Stops that could not be judged: a record or a command is missing, or the robot was hardly moving.
    pub(super) spoilt_stops: u64,
    /// Samples whose command never was in the client's hands, because the client was away too long.
    pub(super) without_command: u64,
    began_ns: u64,
    legs: Vec<Sampled>,
}

/// When something was sent, taken in and answered \[ns, `CLOCK_MONOTONIC`\].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(clippy::struct_field_names, reason = "the unit ends each name")]
pub(super) struct Passage {
    pub(super) sent_ns: u64,
    pub(super) gather_ns: u64,
    pub(super) received_ns: u64,
}

impl Round {
    /// An empty one of a run that began at `began_ns` \[`CLOCK_MONOTONIC`\].
    pub(super) fn new(began_ns: u64) -> Result<Self> {
        let empty = || {
            Ok(Sampled {
                latencies: histogram()?,
                span_ns: None,
            })
        };
        Ok(Self {
            spoilt_stops: 0,
            without_command: 0,
            began_ns,
            legs: Leg::ALL.iter().map(|_| empty()).collect::<Result<_>>()?,
        })
    }

    pub(super) fn leg(&self, leg: Leg) -> &Sampled {
        &self.legs[leg as usize]
    }

    /// Adds a latency; one longer than a minute counts as a minute.
    pub(super) fn record(&mut self, leg: Leg, latency_ns: u64) {
        let now_ns = monotonic_ns().saturating_sub(self.began_ns);
        let sampled = &mut self.legs[leg as usize];
        sampled.latencies.saturating_record(latency_ns);
        let first_ns = sampled.span_ns.map_or(now_ns, |(first_ns, _)| first_ns);
        sampled.span_ns = Some((first_ns, now_ns));
    }

    /// Adds a whole way and its two parts. A message that came while its gather was under way did not wait.
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
    fn the_parts_of_a_way_make_the_whole() {
        let mut round = Round::new(0).expect("bounds");
        for (gather_ns, grid, machinery) in [(400, 300, 600), (90, 0, 900)] {
            let passage = Passage {
                sent_ns: 100,
                gather_ns,
                received_ns: 1000,
            };
            round.record_way(Leg::StopCommand, &passage);
            let newest = |leg: Leg| round.leg(leg).latencies.max();
            assert_eq!(newest(Leg::StopCommand), 900);
            assert_eq!(round.leg(Leg::StopGrid).latencies.count_at(grid), 1);
            assert_eq!(
                round.leg(Leg::StopMachinery).latencies.count_at(machinery),
                1
            );
        }
        let sampled = round.leg(Leg::StopCommand);
        assert_eq!(sampled.latencies.len(), 2);
        let (first_ns, last_ns) = sampled.span_ns.expect("two were recorded");
        assert!(first_ns <= last_ns);
        assert_eq!(round.leg(Leg::LeaseGrid).span_ns, None);
    }
}
