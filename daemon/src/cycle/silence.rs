use std::ops::Range;

use crate::config::Interface;
use crate::handover::{Policy, TimedMeasurement};

/// Times between the measurements of a driver. Motors that obey speeds rest once their command has run out, so a
/// driver that was silent for longer has lost motion of which no command knows. It may state when they rested.
#[derive(Debug)]
pub(super) struct SilenceWatch {
    /// Average time between measurements \[ns\]; 0 before the second one.
    usual_ns: u64,
    /// Time from the release of a command after which a motor rests without a new one \[ns\]. Motors that obey
    /// positions make up for it.
    valid_ns: u64,
    /// Time of the last used measurement, and the release at which it was used \[ns\].
    last: Option<(u64, u64)>,
    /// The rest that was stated last \[ns\].
    stated_ns: [u64; 2],
}

/// For how long after its end a stated rest counts \[ns\]. The filters of the estimate have taken it by then.
const STATED_NS: u64 = 500_000_000;

/// When motors may have rested.
#[derive(Debug)]
pub(super) struct Rest {
    /// The driver was silent; if not, it states this rest.
    pub(super) was_silent: bool,
    /// Ages between which they rested \[s\].
    pub(super) ages_s: Range<f64>,
}

impl SilenceWatch {
    pub(super) fn new(policy: &Policy) -> Self {
        let valid_ns = match policy.interface {
            Interface::Position => u64::MAX,
            Interface::Velocity => policy.command_valid_ns,
        };
        Self {
            usual_ns: 0,
            valid_ns,
            last: None,
            stated_ns: [0; 2],
        }
    }

    /// Takes a measurement that is used at this release. The motors may have rested in a silence before it, and else as
    /// the driver states. A rest that begins within the one stated before is no rest: it would have begun with that.
    pub(super) fn rest(&mut self, timed: &TimedMeasurement, release_ns: u64) -> Option<Rest> {
        let before_ns = self.stated_ns;
        // Nothing is stated by a rest without a duration.
        if timed.rested_ns[0] < timed.rested_ns[1] {
            self.stated_ns = timed.rested_ns;
        }
        if let Some(ages_s) = self.silence_s(timed.measured_ns, release_ns) {
            return Some(Rest {
                was_silent: true,
                ages_s,
            });
        }
        let [from_ns, until_ns] = timed.rested_ns.map(|at_ns| at_ns.min(release_ns));
        let is_recent = release_ns - until_ns < STATED_NS;
        let is_one = from_ns == before_ns[0] || from_ns >= before_ns[1];
        (from_ns < until_ns && is_recent && is_one).then(|| Rest {
            was_silent: false,
            ages_s: age_s(until_ns, release_ns)..age_s(from_ns, release_ns),
        })
    }

    /// If the driver was silent before a measurement, for longer than a command is valid and than 2.5 times the usual
    /// time: between which ages the motors may have rested \[s\], at least since the command of the release at which the
    /// previous measurement was used has run out. A slow driver is not silent.
    fn silence_s(&mut self, measured_ns: u64, release_ns: u64) -> Option<Range<f64>> {
        let (last_ns, used_ns) = self.last.replace((measured_ns, release_ns))?;
        let since_ns = measured_ns - last_ns;
        if self.usual_ns == 0 {
            self.usual_ns = since_ns;
        }
        let most_ns = self.usual_ns / 2 * 5;
        self.usual_ns = (7 * self.usual_ns + since_ns.min(most_ns)) / 8;
        if since_ns <= most_ns.max(self.valid_ns) {
            return None;
        }
        let ends_ns = used_ns + self.valid_ns;
        let ages_s = age_s(measured_ns, release_ns)..age_s(ends_ns, release_ns);
        (ages_s.start < ages_s.end).then_some(ages_s)
    }
}

/// Age at `release_ns`; below zero if later.
pub(super) fn age_s(at_ns: u64, release_ns: u64) -> f64 {
    (release_ns as f64 - at_ns as f64) * 1e-9
}

#[cfg(test)]
mod tests {
    use cdcr_controller::estimator::Measurement;
    use nalgebra::Vector3;

    use super::*;

    const MS: u64 = 1_000_000;

    fn watch() -> SilenceWatch {
        SilenceWatch {
            usual_ns: 0,
            valid_ns: 15 * MS,
            last: None,
            stated_ns: [0; 2],
        }
    }

    #[test]
    fn a_slow_driver_is_not_silent_and_one_that_becomes_slow_is_so_only_at_first() {
        let (mut watch, mut now_ns) = (watch(), 1_000 * MS);
        let mut silences = |every_ms: u64, count| {
            let silent = (0..count).filter(|_| {
                now_ns += every_ms * MS;
                watch.silence_s(now_ns, now_ns + MS).is_some()
            });
            silent.count()
        };
        assert_eq!(silences(5, 100), 0);
        assert_eq!(silences(14, 1), 0, "the command is still valid");
        assert_eq!(silences(30, 1), 1);
        assert_eq!(silences(5, 100), 0);
        assert!(silences(20, 100) < 10);
        assert_eq!(silences(20, 100), 0);
        assert_eq!(silences(60, 1), 1);
    }

    #[test]
    fn the_motors_rest_from_the_end_of_the_last_command_to_the_measurement() {
        let mut watch = watch();
        for at_ms in [100, 105, 110] {
            assert_eq!(watch.silence_s(at_ms * MS, (at_ms + 4) * MS), None);
        }
        // The command of the release at 114 ms runs out at 129 ms.
        let ages_s = watch.silence_s(140 * MS, 144 * MS).unwrap();
        assert!((ages_s.start - 4e-3).abs() < 1e-12 && (ages_s.end - 15e-3).abs() < 1e-12);
        // One that came while the command was valid, though used late.
        assert_eq!(watch.silence_s(158 * MS, 180 * MS), None);
    }

    #[test]
    fn what_a_driver_states_counts_where_it_was_not_silent() {
        let mut watch = watch();
        let mut rest = |at_ms: u64, rested_ms: [u64; 2]| {
            let timed = TimedMeasurement {
                measurement: Measurement::TipPosition(Vector3::zeros()),
                measured_ns: at_ms * MS,
                rested_ns: rested_ms.map(|at_ms| at_ms * MS),
            };
            let rest = watch.rest(&timed, (at_ms + 4) * MS)?;
            let Range { start, end } = rest.ages_s;
            let ages_ms = [start, end].map(|age_s| (age_s * 1e3).round());
            Some((rest.was_silent, ages_ms))
        };
        assert_eq!(rest(100, [1, 1]), None, "it states none");
        assert_eq!(rest(105, [80, 104]), Some((false, [5.0, 29.0])));
        assert_eq!(rest(110, [80, 120]), Some((false, [0.0, 34.0])));
        assert_eq!(rest(115, [90, 115]), None, "always lately");
        assert_eq!(rest(120, [90, 120]), Some((false, [4.0, 34.0])));
        assert_eq!(rest(125, [0, 0]), None);
        assert_eq!(rest(130, [100, 130]), None, "or nothing, in turn");
        assert_eq!(rest(150, [1, 150]), Some((true, [4.0, 5.0])));
        assert_eq!(rest(645, [80, 140]).map(|rest| rest.0), Some(true));
        assert_eq!(rest(650, [80, 140]), None, "long over");
    }
}
