//! Refused messages in the log: the status counts them all.

use cdcr_shared_types::codes::Outcome;

use super::LATE_LINE_EVERY;
use crate::handover::{RefusedTips, Summary};

/// Of a tip that arrives, too late: a camera with a long delay.
const LATE: &str = "arrived later than link.tip_age_max_ms (0: link.measurement_timeout_ms, as without bends) after its time stamp: raise that key above the delay of \
    the sensor, or correct its stamps (CLOCK_MONOTONIC, in ns)";

/// What the log has to say about refused messages: the first one for each reason, and first bends whenever a tip begins to
/// contradict them.
#[derive(Debug)]
pub(super) struct Refusals {
    has_tip_sensor: bool,
    /// The present contradiction of first bends is in the log.
    is_contradiction_logged: bool,
    /// Time of the last line about one \[ns\].
    contradiction_ns: Option<u64>,
}

impl Refusals {
    pub(super) fn new(has_tip_sensor: bool) -> Self {
        Self {
            has_tip_sensor,
            is_contradiction_logged: false,
            contradiction_ns: None,
        }
    }

    /// The reasons that are news in a cycle, with a hint each.
    pub(super) fn news(&mut self, summary: &Summary, before: &Summary) -> Vec<(Outcome, String)> {
        let is_contradiction_news = self.is_contradiction_news(summary);
        let count =
            |summary: &Summary, outcome: Outcome| summary.inputs.outcomes[outcome.code() as usize];
        let is_news = |outcome: Outcome| match outcome {
            Outcome::Accepted => false,
            Outcome::TipElsewhere => is_contradiction_news,
            _ => count(before, outcome) == 0 && count(summary, outcome) > 0,
        };
        let news = Outcome::ALL.iter().filter(|&&outcome| is_news(outcome));
        news.map(|&outcome| (outcome, self.hint(outcome, summary)))
            .collect()
    }

    fn is_contradiction_news(&mut self, summary: &Summary) -> bool {
        if summary.inputs.refused_tips.contradiction_m == 0.0 {
            self.is_contradiction_logged = false;
            return false;
        }
        let every_ns = LATE_LINE_EVERY.as_nanos() as u64;
        let is_soon = |logged_ns: u64| summary.due_ns.saturating_sub(logged_ns) < every_ns;
        if self.is_contradiction_logged || self.contradiction_ns.is_some_and(is_soon) {
            return false;
        }
        self.is_contradiction_logged = true;
        self.contradiction_ns = Some(summary.due_ns);
        true
    }

    fn hint(&self, outcome: Outcome, summary: &Summary) -> String {
        let is_refused_tip = summary.inputs.refused_tips.newest == outcome;
        let is_tip = is_refused_tip || summary.inputs.driver_measures_tip_only;
        match outcome {
            Outcome::OtherDriver if is_tip && !self.has_tip_sensor => {
                "; a tip sensor in a process of its own needs link.tip_sensor = \"separate\""
                    .to_owned()
            }
            Outcome::TipElsewhere => contradiction(summary.inputs.refused_tips.contradiction_m),
            Outcome::InThePast if is_refused_tip => format!("; the tip {LATE}"),
            _ => String::new(),
        }
    }
}

/// Why the newest of the refused tips was refused.
pub(super) fn newest_refusal(refused: RefusedTips) -> String {
    match refused.newest {
        Outcome::Accepted => "; none arrived: check that the tip sensor runs and sends".to_owned(),
        Outcome::InThePast => format!("; the newest {LATE}"),
        outcome => format!("; the newest was refused: {outcome} (cdcrctl status has the remedy)"),
    }
}

/// What first bends are refused for while a tip sensor contradicts them.
fn contradiction(away_m: f64) -> String {
    format!(
        ": {:.0} mm away. Usual causes: (1) the driver sends degrees or millimetres; (2) scale, sign, order or zero of its encoders are wrong; \
         (3) the frame of the tip sensor is not that of the base",
        1e3 * away_m
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Refusals so far, and the present contradiction, at a time.
    fn summary(due_s: f64, outcome: Outcome, count: u64, contradiction_m: f64) -> Summary {
        let mut summary = Summary {
            due_ns: (1e9 * due_s) as u64,
            ..Summary::default()
        };
        summary.inputs.outcomes[outcome.code() as usize] = count;
        summary.inputs.refused_tips.contradiction_m = contradiction_m;
        summary
    }

    /// Once a second at most, as other lines.
    #[test]
    fn each_contradiction_of_first_bends_is_logged() {
        let mut refusals = Refusals::new(true);
        let mut before = Summary::default();
        let mut logged = Vec::new();
        for (due_s, contradiction_m) in [
            (1.0, 0.2),
            (1.1, 0.2),
            (1.2, 0.0),
            (1.3, 0.3),
            (2.1, 0.3),
            (2.2, 0.3),
            (9.0, 0.0),
            (9.1, 0.4),
        ] {
            let now = summary(due_s, Outcome::TipElsewhere, 1, contradiction_m);
            for (_, hint) in refusals.news(&now, &before) {
                logged.push(hint[..8].to_owned());
            }
            before = now;
        }
        assert_eq!(logged, [": 200 mm", ": 300 mm", ": 400 mm"]);
    }

    #[test]
    fn a_tip_later_than_the_timeout_names_the_key() {
        let mut now = summary(1.0, Outcome::InThePast, 1, 0.0);
        let hint = |now: &Summary| {
            let news = Refusals::new(true).news(now, &Summary::default());
            news[0].1.clone()
        };
        assert_eq!(hint(&now), "", "of another message");
        now.inputs.driver_measures_tip_only = true;
        assert_eq!(hint(&now), "", "of a reference, beside such a driver");
        now.inputs.refused_tips.newest = Outcome::InThePast;
        for text in [hint(&now), newest_refusal(now.inputs.refused_tips)] {
            assert!(text.contains("raise that key above the delay"), "{text}");
        }
    }

    #[test]
    fn a_tip_sensor_that_is_taken_for_the_driver_is_a_hint_once() {
        for (tip_only, has_tip_sensor, has_hint) in [
            (true, false, true),
            (false, false, false),
            (true, true, false),
        ] {
            let mut refusals = Refusals::new(has_tip_sensor);
            let mut now = summary(1.0, Outcome::OtherDriver, 1, 0.0);
            now.inputs.driver_measures_tip_only = tip_only;
            let news = refusals.news(&now, &Summary::default());
            let [(Outcome::OtherDriver, hint)] = news.as_slice() else {
                panic!("{news:?}");
            };
            assert_eq!(hint.contains("link.tip_sensor"), has_hint, "{hint}");
            assert_eq!(refusals.news(&now, &now), []);
        }
    }
}
