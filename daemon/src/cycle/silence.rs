use crate::config::Interface;
use crate::handover::Policy;

/// Times between the measurements of a driver. Motors that obey speeds rest once their command has run out, so a
/// driver that was silent for longer has lost motion of which no command knows.
#[derive(Debug)]
pub(super) struct SilenceWatch {
    /// Average time between measurements \[ns\]; 0 before the second one.
    usual_ns: u64,
    /// Time after which a motor rests without a new command \[ns\]. Motors that obey positions make up for it.
    valid_ns: u64,
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
        }
    }

    /// Takes the time since the previous measurement. If it is longer than a command is valid, and more than twice the
    /// usual time: for how long the motors have rested \[s\]. A slow driver is not silent.
    pub(super) fn rested_s(&mut self, since_ns: u64) -> Option<f64> {
        if self.usual_ns == 0 {
            self.usual_ns = since_ns;
        }
        let most_ns = 2 * self.usual_ns;
        self.usual_ns = (7 * self.usual_ns + since_ns.min(most_ns)) / 8;
        (since_ns > most_ns.max(self.valid_ns)).then(|| (since_ns - self.valid_ns) as f64 * 1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_driver_is_not_silent_and_one_that_becomes_slow_is_so_only_at_first() {
        let mut watch = SilenceWatch {
            usual_ns: 0,
            valid_ns: 15_000_000,
        };
        let mut silences = |every_ns, count| {
            let silent = (0..count).filter(|_| watch.rested_s(every_ns).is_some());
            silent.count()
        };
        assert_eq!(silences(5_000_000, 100), 0);
        assert_eq!(silences(14_000_000, 1), 0, "the command is still valid");
        assert_eq!(silences(30_000_000, 1), 1);
        assert_eq!(silences(5_000_000, 100), 0);
        assert!(silences(20_000_000, 100) < 10);
        assert_eq!(silences(20_000_000, 100), 0);
        assert_eq!(silences(60_000_000, 1), 1);
    }
}
