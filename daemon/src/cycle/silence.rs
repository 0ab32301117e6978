use std::ops::Range;

use crate::config::Interface;
use crate::handover::Policy;

/// Times between the measurements of a driver. Motors that obey speeds rest once their command has run out, so a
/// driver that was silent for longer has lost motion of which no command knows.
#[derive(Debug)]
pub(super) struct SilenceWatch {
    /// Average time between measurements \[ns\]; 0 before the second one.
    usual_ns: u64,
    /// Time from the release of a command after which a motor rests without a new one \[ns\]. Motors that obey
    /// positions make up for it.
    valid_ns: u64,
    /// Time of the last used measurement, and the release at which it was used \[ns\].
    last: Option<(u64, u64)>,
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
        }
    }

    /// Takes a measurement that is used at this release. If the driver was silent before it, for longer than a command
    /// is valid and than 2.5 times the usual time: between which ages the motors may have rested \[s\], at least since
    /// the command of the release at which the previous measurement was used has run out. A slow driver is not silent.
    pub(super) fn rested_s(&mut self, measured_ns: u64, release_ns: u64) -> Option<Range<f64>> {
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
        let age_s = |at_ns: u64| (release_ns as f64 - at_ns as f64) * 1e-9;
        let ages_s = age_s(measured_ns)..age_s(used_ns + self.valid_ns);
        (ages_s.start < ages_s.end).then_some(ages_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn watch() -> SilenceWatch {
        SilenceWatch {
            usual_ns: 0,
            valid_ns: 15 * MS,
            last: None,
        }
    }

    #[test]
    fn a_slow_driver_is_not_silent_and_one_that_becomes_slow_is_so_only_at_first() {
        let (mut watch, mut now_ns) = (watch(), 1_000 * MS);
        let mut silences = |every_ms: u64, count| {
            let silent = (0..count).filter(|_| {
                now_ns += every_ms * MS;
                watch.rested_s(now_ns, now_ns + MS).is_some()
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
            assert_eq!(watch.rested_s(at_ms * MS, (at_ms + 4) * MS), None);
        }
        // The command of the release at 114 ms runs out at 129 ms.
        let ages_s = watch.rested_s(140 * MS, 144 * MS).unwrap();
        assert!((ages_s.start - 4e-3).abs() < 1e-12 && (ages_s.end - 15e-3).abs() < 1e-12);
        // One that came while the command was valid, though used late.
        assert_eq!(watch.rested_s(158 * MS, 180 * MS), None);
    }
}
