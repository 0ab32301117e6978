//! A stop in the records of a daemon.
//!
//! The cycle of the gather that took the request is the first in mode stopped. From that cycle on, the fastest rate
//! decreases by deceleration · T in each cycle, so a speed of n steps is zero in the n-th command. The ramp of n - 1
//! periods belongs to the robot, not to the daemon.

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::Mode;

/// A stop of a robot that was tracking and moving.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stop {
    /// Index of the first record in mode stopped.
    pub first: usize,
    /// Index of the first record at rest.
    pub rest: usize,
    pub ramp_ns: u64,
}

impl Stop {
    /// The first stop in consecutive records, from the cycle before it to rest. `None` if a record is missing, or if
    /// the robot was hardly moving.
    pub fn find<'a>(records: impl IntoIterator<Item = &'a Telemetry>) -> Option<Self> {
        let records: Vec<&Telemetry> = records.into_iter().collect();
        let is_in = |record: &Telemetry, mode: Mode| record.mode == mode.code();
        let at = (records.iter()).position(|record| is_in(record, Mode::Stopped))?;
        let (first, before) = (records[at], *records.get(at.checked_sub(1)?)?);
        let sequence = |record: &Telemetry| record.header.sequence;
        let is_next = |pair: &[&Telemetry]| sequence(pair[0]) + 1 == sequence(pair[1]);
        let is_whole = records[at - 1..].windows(2).all(is_next);
        let step_rad_s = first.deceleration_rad_s2 * first.period_ns as f64 * 1e-9;
        let steps = largest(&first.previous_rate_rad_s) / step_rad_s;
        if !is_whole || !is_in(before, Mode::Tracking) || steps < 2.0 {
            return None;
        }
        let mut stopped = records[at..].iter();
        let rest = at + stopped.position(|record| speed_rad_s(record) == 0.0)?;
        // Rounding must not add a step to a speed that is a whole number of steps.
        let ramp_ns = ((steps - 1e-9).ceil() as u64 - 1) * first.period_ns;
        Some(Self {
            first: at,
            rest,
            ramp_ns,
        })
    }

    /// Time from the request to the begin of rest, less the ramp \[ns\].
    pub fn less_ramp_ns(&self, sent_ns: u64, rests_ns: u64) -> u64 {
        rests_ns.saturating_sub(sent_ns + self.ramp_ns)
    }
}

/// Fastest commanded rate of a component.
pub fn speed_rad_s(record: &Telemetry) -> f64 {
    largest(&record.command.bend_rate_rad_s)
}

fn largest(rates_rad_s: &[f64]) -> f64 {
    let sizes = rates_rad_s.iter().map(|rate| rate.abs());
    sizes.fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that tracks at 0.95 rad/s and slows down by 0.1 rad/s in each cycle of 5 ms.
    fn stop() -> Vec<Telemetry> {
        let speed_rad_s = |index: u64| (0.95 - 0.1 * index as f64).max(0.0);
        let kept = |index: u64| {
            let mode = [Mode::Tracking, Mode::Stopped][usize::from(index > 0)];
            let mut record = Telemetry {
                mode: mode.code(),
                handed_over_ns: 5_000_000 * (index + 1) + 50_000,
                period_ns: 5_000_000,
                deceleration_rad_s2: 20.0,
                ..Telemetry::default()
            };
            record.header.sequence = 7 + index;
            record.previous_rate_rad_s[0] = speed_rad_s(index.saturating_sub(1));
            record.command.bend_rate_rad_s[0] = speed_rad_s(index);
            record
        };
        (0..=10).map(kept).collect()
    }

    #[test]
    fn a_stop_is_counted_without_its_ramp_and_with_a_period_that_was_lost_on_the_way() {
        let (sent_ns, records) = (5_300_000, stop());
        let found = Stop::find(&records).expect("all records are there");
        // Ten steps: zero in the tenth stopped command, nine periods after the first.
        assert_eq!((found.first, found.rest), (1, 10));
        let rests_ns = records[found.rest].handed_over_ns;
        assert_eq!(found.less_ramp_ns(sent_ns, rests_ns), 10_050_000 - sent_ns);
        let later_ns = rests_ns + 5_000_000;
        assert_eq!(found.less_ramp_ns(sent_ns, later_ns), 4_750_000 + 5_000_000);
    }

    #[test]
    fn a_stop_with_a_missing_record_is_not_evaluated() {
        type Change = fn(&mut Vec<Telemetry>);
        // A missing record, a robot that hardly moved, or what it did before is unknown, or it does not rest.
        let missing: [Change; 4] = [
            |all| _ = all.remove(4),
            |all| all[1].previous_rate_rad_s[0] = 0.15,
            |all| _ = all.remove(0),
            |all| _ = all.pop(),
        ];
        for change in missing {
            let mut records = stop();
            change(&mut records);
            assert_eq!(Stop::find(&records), None);
        }
    }
}
