use cdcr_shared_types::codes::Mode;
use cdcr_shared_types::limits::TIP_SENSOR_SILENT_MS;

use crate::handover::Summary;

/// A sensor that is silent, or has not measured since the robot can be moved, for longer than this is news \[ns\].
const SILENT_NS: u64 = 1_000_000 * TIP_SENSOR_SILENT_MS as u64;
/// A sensor that was silent counts as regular again after this time without a silence \[ns\]. One that measures less than
/// once a second never does: it is one line of the log, not two for each measurement.
const REGULAR_NS: u64 = 5_000_000_000;
/// A sensor that measures seldom is silent for longer than so many of its intervals where it has ended.
const INTERVALS_MAX: u64 = 3;

/// What the log has to say about the silences of a tip sensor.
#[derive(Debug, Default)]
pub(super) struct TipSilence {
    /// The configuration has a tip sensor beside the driver.
    is_expected: bool,
    /// Since when the robot can be moved without any measurement of that sensor \[ns\].
    missing_since_ns: Option<u64>,
    is_logged: bool,
    /// Since when a sensor whose silence is in the log has not been silent \[ns\].
    heard_since_ns: Option<u64>,
    /// The newest measurement since the line of the log \[ns\].
    newest_ns: u64,
    /// Longest time between two measurements since then \[ns\]; 0: there was one at most.
    interval_ns: u64,
    /// The measurement after which the sensor was reported silent \[ns\].
    logged_ns: u64,
}

/// A line of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TipNews {
    /// No measurement of the configured sensor was accepted yet.
    Missing,
    Silent,
    /// So much longer than between its measurements, since a line about an earlier silence.
    SilentForLong {
        silent_s: u64,
        interval_s: u64,
    },
    /// After a silence.
    Regular,
}

impl TipSilence {
    pub(super) fn new(is_expected: bool) -> Self {
        Self {
            is_expected,
            ..Self::default()
        }
    }

    /// The news of a cycle. In a fault a silence is none: without its driver the robot does not go on. It is one after the
    /// reset, if it lasts.
    pub(super) fn news(&mut self, summary: &Summary) -> Option<TipNews> {
        if summary.tip_measured_ns == 0 {
            return self.missing(summary);
        }
        self.learn_interval(summary.tip_measured_ns);
        if is_silent(summary) {
            self.heard_since_ns = None;
            if summary.mode == Mode::Faulted {
                return None;
            }
            if self.is_logged {
                return self.silent_for_long(summary);
            }
            self.is_logged = true;
            (self.newest_ns, self.logged_ns) = (summary.tip_measured_ns, summary.tip_measured_ns);
            return Some(TipNews::Silent);
        }
        if !self.is_logged {
            return None;
        }
        let since_ns = *self.heard_since_ns.get_or_insert(summary.due_ns);
        if summary.due_ns.saturating_sub(since_ns) < REGULAR_NS {
            return None;
        }
        *self = Self::new(self.is_expected);
        Some(TipNews::Regular)
    }

    fn learn_interval(&mut self, measured_ns: u64) {
        if self.is_logged && self.newest_ns > 0 {
            let interval_ns = measured_ns.saturating_sub(self.newest_ns);
            self.interval_ns = self.interval_ns.max(interval_ns);
        }
        self.newest_ns = measured_ns;
    }

    /// A sensor that measures seldom may end, too. Each line needs a longer silence than the one before.
    fn silent_for_long(&mut self, summary: &Summary) -> Option<TipNews> {
        let silent_ns = summary.due_ns.saturating_sub(summary.tip_measured_ns);
        let is_long = self.interval_ns > 0 && silent_ns > INTERVALS_MAX * self.interval_ns;
        let is_news = is_long && self.logged_ns != summary.tip_measured_ns;
        is_news.then(|| {
            self.logged_ns = summary.tip_measured_ns;
            let [silent_s, interval_s] = [silent_ns, self.interval_ns].map(|ns| ns / 1_000_000_000);
            TipNews::SilentForLong {
                silent_s,
                interval_s,
            }
        })
    }

    /// The news of a cycle before the first measurement. While the robot waits for its driver, or rests in a fault, a missing
    /// sensor is none.
    fn missing(&mut self, summary: &Summary) -> Option<TipNews> {
        if !self.is_expected || matches!(summary.mode, Mode::Starting | Mode::Faulted) {
            self.missing_since_ns = None;
            return None;
        }
        let since_ns = *self.missing_since_ns.get_or_insert(summary.due_ns);
        let is_news = !self.is_logged && summary.due_ns - since_ns > SILENT_NS;
        self.is_logged |= is_news;
        is_news.then_some(TipNews::Missing)
    }
}

/// A sensor that measured the tip beside bends or cables does so no more.
fn is_silent(summary: &Summary) -> bool {
    summary.due_ns.saturating_sub(summary.tip_measured_ns) > SILENT_NS
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 5_000_000;

    /// No measurement of the tip at all.
    const NEVER_NS: u64 = 0;

    /// The news while the tip is measured each `each_ns`, in one mode.
    fn news(
        watch: &mut TipSilence,
        mode: Mode,
        each_ns: u64,
        from_s: u64,
        to_s: u64,
    ) -> Vec<TipNews> {
        let [from_ns, to_ns] = [from_s, to_s].map(|s| s * 1_000_000_000);
        let cycles = (from_ns..to_ns).step_by(PERIOD_NS as usize);
        let summaries = cycles.map(|due_ns| Summary {
            mode,
            due_ns,
            tip_measured_ns: match each_ns {
                NEVER_NS => 0,
                each_ns => (due_ns / each_ns * each_ns).max(1),
            },
            ..Summary::default()
        });
        summaries
            .filter_map(|summary| watch.news(&summary))
            .collect()
    }

    /// A sensor that is silent once and then regular is two lines; one that measures each two seconds is one.
    #[test]
    fn a_silence_is_logged_once_until_the_sensor_is_regular() {
        let (often_ns, seldom_ns) = (10_000_000, 2_000_000_000);
        let mut watch = TipSilence::default();
        let mut of = |each_ns, from_s, to_s| news(&mut watch, Mode::Holding, each_ns, from_s, to_s);
        assert_eq!(of(often_ns, 1, 10), []);
        assert_eq!(of(u64::MAX, 10, 14), [TipNews::Silent]);
        assert_eq!(of(often_ns, 14, 18), []);
        assert_eq!(of(often_ns, 18, 30), [TipNews::Regular]);
        assert_eq!(of(seldom_ns, 30, 300), [TipNews::Silent]);
        assert_eq!(of(often_ns, 300, 320), [TipNews::Regular]);
    }

    /// A camera that measures each three seconds has one line, and another one when it ends.
    #[test]
    fn the_end_of_a_slow_sensor_is_logged() {
        let mut watch = TipSilence::default();
        let mut at = |due_s: u64, measured_s: u64| {
            let summary = Summary {
                mode: Mode::Holding,
                due_ns: due_s * 1_000_000_000,
                tip_measured_ns: measured_s * 1_000_000_000,
                ..Summary::default()
            };
            watch.news(&summary)
        };
        let news: Vec<_> = (3..200)
            .filter_map(|due_s| {
                let measured_s = match due_s {
                    ..40 | 100..110 => due_s / 3 * 3,
                    40..100 => 39,
                    _ => 108,
                };
                at(due_s, measured_s)
            })
            .collect();
        let [TipNews::Silent, end, rest @ ..] = news.as_slice() else {
            panic!("{news:?}");
        };
        assert!(
            matches!(end, TipNews::SilentForLong { interval_s: 3, .. }),
            "{end:?}"
        );
        // It is silent for longer than the first time only later.
        assert_eq!(rest, []);
    }

    /// Some drivers measure the tip, others do not: only the configuration says that a sensor is missing.
    #[test]
    fn a_sensor_of_which_nothing_was_accepted_is_logged_once_after_the_start() {
        for (is_expected, expected) in [(true, vec![TipNews::Missing]), (false, vec![])] {
            let mut watch = TipSilence::new(is_expected);
            let mut of = |mode, from_s, to_s| news(&mut watch, mode, NEVER_NS, from_s, to_s);
            assert_eq!(of(Mode::Starting, 1, 100), []);
            assert_eq!(of(Mode::Holding, 100, 101), []);
            assert_eq!(of(Mode::Tracking, 101, 200), expected);
            assert_eq!(of(Mode::Faulted, 200, 210), []);
            assert_eq!(of(Mode::Holding, 210, 220), []);
            let measured = news(&mut watch, Mode::Holding, 10_000_000, 220, 240);
            assert_eq!(measured.len(), expected.len());
        }
    }

    /// A fault whose driver measured the tip, too, has a line of its own. What lasts after the reset is news.
    #[test]
    fn in_a_fault_a_silence_is_no_news() {
        let mut watch = TipSilence::default();
        let mut of = |mode, each_ns, from_s, to_s| news(&mut watch, mode, each_ns, from_s, to_s);
        assert_eq!(of(Mode::Holding, 10_000_000, 1, 10), []);
        assert_eq!(of(Mode::Faulted, u64::MAX, 10, 60), []);
        assert_eq!(of(Mode::Faulted, 10_000_000, 60, 70), []);
        assert_eq!(of(Mode::Faulted, u64::MAX, 70, 80), []);
        assert_eq!(of(Mode::Holding, u64::MAX, 80, 90), [TipNews::Silent]);
    }
}
