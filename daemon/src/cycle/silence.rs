use std::ops::Range;

use cdcr_controller::estimator::RestCause;

use crate::config::Interface;
use crate::handover::{Policy, TimedMeasurement};

/// Times between the measurements of a driver. Motors that obey speeds rest once their command has run out, so a
/// driver that was silent for longer has lost motion of which no command knows. It may state when they rested.
#[derive(Debug, Clone)]
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
    /// The newest rest whose motion the estimate has lost \[ns\].
    believed_ns: Range<u64>,
    /// It was stated, and a measurement showed it; a silence is only not contradicted.
    is_shown: bool,
    /// Rests that were stated before the newest one, and that no measurement has shown, the newest first \[ns\].
    hidden_ns: [Range<u64>; HIDDEN_MAX],
}

/// For how long after its end a stated rest counts \[ns\]. The filters of the estimate have taken it by then.
const STATED_NS: u64 = 500_000_000;

/// Hidden rests that are kept: as many stalls as the filters of the estimate do not take at once.
pub(super) const HIDDEN_MAX: usize = 3;

/// When motors may have rested.
#[derive(Debug)]
pub(super) struct Rest {
    pub(super) cause: RestCause,
    /// When they rested \[ns\].
    rested_ns: Range<u64>,
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
            believed_ns: 0..0,
            is_shown: false,
            hidden_ns: Default::default(),
        }
    }

    /// Takes a measurement that is used at this release. The motors may have rested in a silence before it, and else as
    /// the driver states, less what is [believed](Self::believe). A rest that begins within the one stated before is not a rest: it would have begun with
    /// that. After a silence, a rest counts that began before it and lasted into it, or else the silence: a statement that is too short would hide a
    /// part of it.
    pub(super) fn rests(
        &mut self,
        timed: &TimedMeasurement,
        release_ns: u64,
    ) -> impl Iterator<Item = Rest> + use<> {
        let before_ns = self.stated_ns;
        // Nothing is stated by a rest without a duration.
        if timed.rested_ns[0] < timed.rested_ns[1] {
            self.stated_ns = timed.rested_ns;
            self.hide(before_ns);
        }
        let [from_ns, until_ns] = timed.rested_ns.map(|at_ns| at_ns.min(release_ns));
        let is_recent = release_ns - until_ns < STATED_NS;
        let is_one = from_ns == before_ns[0] || from_ns >= before_ns[1];
        let mut stated = (is_recent && is_one).then_some(Rest {
            cause: RestCause::Stated,
            rested_ns: from_ns..until_ns,
        });
        if let Some(rest) = &mut stated
            && self.believed_ns.contains(&from_ns)
        {
            rest.rested_ns.start = self.believed_ns.end;
            if self.is_shown {
                rest.cause = RestCause::GoesOn;
            }
        }
        let silence_ns = self.silence_ns(timed.measured_ns, release_ns);
        if let Some(silence_ns) = &silence_ns {
            stated = stated.filter(|rest| rest.rested_ns.contains(&silence_ns.start));
            if let Some(rest) = &mut stated {
                rest.cause = RestCause::Stated;
            }
        }
        let silent = silence_ns.map(|rested_ns| Rest {
            cause: RestCause::Silence,
            rested_ns,
        });
        let stated = stated.filter(|rest| !rest.rested_ns.is_empty());
        stated.into_iter().chain(silent)
    }

    /// The estimate has lost the motion of this rest, which is decided only once.
    pub(super) fn believe(&mut self, rest: &Rest) {
        let Range { start, end } = rest.rested_ns;
        let is_longer = start == self.believed_ns.end;
        let from_ns = if is_longer {
            self.believed_ns.start
        } else {
            start
        };
        self.believed_ns = from_ns..end;
        self.is_shown = rest.cause != RestCause::Silence;
        self.hidden_ns = Default::default();
    }

    /// Keeps the rest that was stated before, if another one is stated now and it is not believed.
    fn hide(&mut self, before_ns: [u64; 2]) {
        let [from_ns, until_ns] = before_ns;
        let is_over = until_ns <= self.stated_ns[0];
        let from_ns = from_ns.max(self.believed_ns.end);
        if is_over && from_ns < until_ns {
            self.hidden_ns.rotate_right(1);
            self.hidden_ns[0] = from_ns..until_ns;
        }
    }

    /// Ages at `release_ns` between which the motors rested \[s\], and of the hidden rests, together with which a stated one may be shown.
    /// Returns their number.
    pub(super) fn fill_ages(
        &self,
        rest: &Rest,
        release_ns: u64,
        filled_s: &mut [Range<f64>; 1 + HIDDEN_MAX],
    ) -> usize {
        let is_recent = |hidden_ns: &&Range<u64>| {
            !hidden_ns.is_empty() && release_ns.saturating_sub(hidden_ns.end) < STATED_NS
        };
        let adds = rest.cause == RestCause::Stated;
        let hidden_ns = self.hidden_ns.iter().filter(|ns| adds && is_recent(ns));
        let rests_ns = core::iter::once(&rest.rested_ns).chain(hidden_ns);
        let mut count = 0;
        for (filled_s, rested_ns) in filled_s.iter_mut().zip(rests_ns) {
            *filled_s = age_s(rested_ns.end, release_ns)..age_s(rested_ns.start, release_ns);
            count += 1;
        }
        count
    }

    /// If the driver was silent before a measurement, for longer than a command is valid and than 2.5 times the usual
    /// time: when the motors may have rested \[ns\], at least since the command of the release at which the
    /// previous measurement was used has run out. A slow driver is not silent.
    fn silence_ns(&mut self, measured_ns: u64, release_ns: u64) -> Option<Range<u64>> {
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
        let rested_ns = used_ns + self.valid_ns..measured_ns;
        (!rested_ns.is_empty()).then_some(rested_ns)
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
            believed_ns: 0..0,
            is_shown: false,
            hidden_ns: Default::default(),
        }
    }

    /// When the motors of a measurement may have rested \[ms\], and whether in a silence. It is used 4 ms later.
    fn rest_ms(
        watch: &mut SilenceWatch,
        at_ms: u64,
        rested_ms: [u64; 2],
    ) -> Option<(bool, [u64; 2])> {
        let rest = rest(watch, at_ms, rested_ms)?;
        let Range { start, end } = rest.rested_ns;
        Some((
            rest.cause == RestCause::Silence,
            [start, end].map(|at_ns| at_ns / MS),
        ))
    }

    fn rest(watch: &mut SilenceWatch, at_ms: u64, rested_ms: [u64; 2]) -> Option<Rest> {
        let timed = TimedMeasurement {
            measurement: Measurement::TipPosition(Vector3::zeros()),
            measured_ns: at_ms * MS,
            rested_ns: rested_ms.map(|at_ms| at_ms * MS),
        };
        watch.rests(&timed, (at_ms + 4) * MS).last()
    }

    #[test]
    fn a_slow_driver_is_not_silent_and_one_that_becomes_slow_is_so_only_at_first() {
        let (mut watch, mut now_ns) = (watch(), 1_000 * MS);
        let mut silences = |every_ms: u64, count| {
            let silent = (0..count).filter(|_| {
                now_ns += every_ms * MS;
                watch.silence_ns(now_ns, now_ns + MS).is_some()
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
            assert_eq!(watch.silence_ns(at_ms * MS, (at_ms + 4) * MS), None);
        }
        // The command of the release at 114 ms runs out at 129 ms.
        assert_eq!(
            watch.silence_ns(140 * MS, 144 * MS),
            Some(129 * MS..140 * MS)
        );
        // One that came while the command was valid, though used late.
        assert_eq!(watch.silence_ns(158 * MS, 180 * MS), None);
    }

    #[test]
    fn what_a_driver_states_counts_where_it_was_not_silent() {
        let mut watch = watch();
        let mut rest = |at_ms, rested_ms| rest_ms(&mut watch, at_ms, rested_ms);
        assert_eq!(rest(100, [1, 1]), None, "it states none");
        assert_eq!(rest(105, [80, 104]), Some((false, [80, 104])));
        assert_eq!(rest(110, [80, 120]), Some((false, [80, 114])));
        assert_eq!(rest(115, [90, 115]), None, "always lately");
        assert_eq!(rest(120, [90, 120]), Some((false, [90, 120])));
        assert_eq!(rest(125, [0, 0]), None);
        assert_eq!(rest(130, [100, 130]), None, "or nothing, in turn");
        assert_eq!(rest(150, [1, 150]), Some((true, [149, 150])));
        assert_eq!(rest(155, [1, 150]), Some((false, [1, 150])), "the next");
        assert_eq!(rest(645, [80, 140]).map(|rest| rest.0), Some(true));
        assert_eq!(rest(650, [80, 140]), None, "long over");
    }

    #[test]
    fn a_rest_is_believed_once_and_a_longer_one_for_its_new_part() {
        let mut watch = watch();
        for (at_ms, stated_ms, rested_ms) in [
            (100, [60, 80], Some((false, [60, 80]))),
            (105, [60, 80], None),
            (110, [60, 105], Some((false, [80, 105]))),
            (115, [60, 105], None),
            (150, [140, 150], Some((true, [134, 150]))),
            (155, [140, 150], None),
            (160, [125, 150], None),
            // It began before the silence.
            (165, [125, 150], Some((false, [125, 150]))),
        ] {
            let mut before = watch.clone();
            let rest = rest(&mut watch, at_ms, stated_ms);
            assert_eq!(rest_ms(&mut before, at_ms, stated_ms), rested_ms);
            if let Some(rest) = &rest {
                watch.believe(rest);
            }
        }
    }

    /// Their driver or its machine stalls again and again.
    #[test]
    fn rests_that_nothing_has_shown_are_tried_with_the_newest_one() {
        let mut watch = watch();
        let mut rests_ms = |at_ms, stated_ms, believes: bool| {
            let rest = rest(&mut watch, at_ms, stated_ms).expect("a rest");
            let mut rests_s = [const { 0.0..0.0 }; 1 + HIDDEN_MAX];
            let count = watch.fill_ages(&rest, at_ms * MS, &mut rests_s);
            if believes {
                watch.believe(&rest);
            }
            let ms = |ago_s: f64| (at_ms as f64 - 1e3 * ago_s).round() as u64;
            let rests_ms = rests_s[..count].iter();
            let rests_ms = rests_ms.map(|ages_s| [ms(ages_s.end), ms(ages_s.start)]);
            rests_ms.collect::<Vec<_>>()
        };
        assert_eq!(rests_ms(100, [80, 90], false), [[80, 90]]);
        assert_eq!(rests_ms(105, [80, 95], false), [[80, 95]], "it goes on");
        assert_eq!(rests_ms(110, [102, 108], false), [[102, 108], [80, 95]]);
        let three = [[112, 113], [102, 108], [80, 95]];
        assert_eq!(rests_ms(115, [112, 113], true), three);
        assert_eq!(rests_ms(120, [115, 118], false), [[115, 118]], "believed");
        let newest = rest(&mut watch, 125, [121, 122]).expect("a rest");
        let count = |at_ms| {
            watch.fill_ages(
                &newest,
                at_ms * MS,
                &mut [const { 0.0..0.0 }; 1 + HIDDEN_MAX],
            )
        };
        assert_eq!([count(617), count(618)], [2, 1], "long over");
    }

    #[test]
    fn a_stated_rest_that_began_before_a_silence_replaces_it_or_the_silence_counts() {
        let mut watch = watch();
        let mut rests_ms = |at_ms, stated_ms: [u64; 2]| {
            let timed = TimedMeasurement {
                measurement: Measurement::TipPosition(Vector3::zeros()),
                measured_ns: at_ms * MS,
                rested_ns: stated_ms.map(|at_ms| at_ms * MS),
            };
            let rests = watch.rests(&timed, (at_ms + 4) * MS);
            let ms = |ns: u64| ns / MS;
            rests
                .map(|rest| [ms(rest.rested_ns.start), ms(rest.rested_ns.end)])
                .collect::<Vec<_>>()
        };
        assert_eq!(rests_ms(100, [0, 0]), [[0; 2]; 0]);
        assert_eq!(rests_ms(105, [0, 0]), [[0; 2]; 0]);
        assert_eq!(rests_ms(140, [118, 136]), [[118, 136], [124, 140]]);
        assert_eq!(rests_ms(180, [165, 176]), [[159, 180]], "too short");
    }

    #[test]
    fn only_a_rest_that_was_shown_goes_on() {
        let mut watch = watch();
        for (at_ms, stated_ms, cause) in [
            (100, [60, 80], RestCause::Stated),
            (105, [60, 104], RestCause::GoesOn),
            (150, [140, 150], RestCause::Silence),
            (155, [140, 155], RestCause::Stated),
            (160, [140, 160], RestCause::GoesOn),
        ] {
            let rest = rest(&mut watch, at_ms, stated_ms).expect("a rest");
            assert_eq!(rest.cause, cause, "{at_ms} ms");
            watch.believe(&rest);
        }
    }
}
