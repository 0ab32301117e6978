//! What one trial measured, and whether its period held.

use serde::Serialize;

use crate::causes::Causes;
use crate::quantiles::Quantiles;

/// From this share of a core on, the system may halt real-time threads: Linux leaves them 95 %.
const FULL: f64 = 0.93;
/// From this share on, a remark says that solves were cut short, or that inputs were stale.
const WORTH_A_REMARK: f64 = 0.01;
/// A period holds when at most this share of its releases got no cycle in time.
const LOST_MAX: f64 = 1e-3;

/// What the daemon did in one trial, in its own statistics, unless something else is said.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrialMetrics {
    pub duration_s: f64,
    pub cycles: u64,
    pub late_starts: u64,
    /// Of them, those that missed their deadline, the end of the period.
    pub deadline_misses: u64,
    pub skipped_periods: u64,
    pub causes: Causes,
    /// Share of the cycles whose solve was cut short by the end of its time.
    pub budget_hit_share: f64,
    /// Share of the cycles that used the inputs of the one before again.
    pub stale_input_share: f64,
    pub dropped_records: u64,
    pub wake_us: Quantiles,
    pub solve_us: Quantiles,
    pub compute_us: Quantiles,
    pub response_us: Quantiles,
    /// Share of its core that the cycle thread used, by the kernel's count.
    pub cycle_core_share: f64,
    /// Share of its core that the exchange thread used, by the kernel's count.
    pub exchange_core_share: f64,
    /// Share of the cycles in which the robot followed its reference, of those whose record a client got.
    pub tracking_share: f64,
    /// Distance of the tip from its reference, as the client's records say: median \[mm\].
    pub error_p50_mm: f64,
    pub error_p99_mm: f64,
}

/// What a trial says about its period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    Holds,
    /// A cycle was late by the daemon's own doing. Nothing excuses that.
    Own,
    /// Too many releases were lost, and the machine lost them: it came late, stood still or ran another task,
    /// while the work itself fits into the period.
    Machine,
    /// Too many releases were lost, and nothing says that only the machine lost them.
    Slow,
}

impl Verdict {
    /// How many trials a period may have when one of them ends like this.
    pub fn trials(self) -> usize {
        match self {
            Self::Holds | Self::Own => 1,
            Self::Slow => 2,
            Self::Machine => 3,
        }
    }
}

impl TrialMetrics {
    /// Whether the period held, and if not, by whose doing.
    pub fn verdict(&self, period_ms: f64) -> Verdict {
        // What a release takes when the machine only does its usual part.
        let work_us = self.wake_us.p50 + self.compute_us.p999;
        if self.causes.own() > 0 {
            Verdict::Own
        } else if self.lost_share() <= LOST_MAX {
            Verdict::Holds
        } else if self.causes.all() > 0 && work_us <= period_ms * 1e3 {
            Verdict::Machine
        } else {
            Verdict::Slow
        }
    }

    pub fn due(&self) -> u64 {
        self.cycles + self.skipped_periods
    }

    /// Releases that got no command in time: those without a cycle, and those whose cycle missed its deadline.
    pub fn lost(&self) -> u64 {
        self.deadline_misses + self.skipped_periods
    }

    /// Lost releases as a share of those that were due.
    pub fn lost_share(&self) -> f64 {
        self.lost() as f64 / self.due().max(1) as f64
    }

    fn lost_words(&self, verdict: Verdict) -> String {
        let whose = match verdict {
            Verdict::Machine => "the machine: ",
            _ => "",
        };
        let (late, skipped) = (self.deadline_misses, self.skipped_periods);
        match self.causes.words().as_str() {
            "" => format!("{whose}{late} late, {skipped} skipped"),
            causes => format!("{whose}{late} late, {skipped} skipped ({causes})"),
        }
    }

    /// Share of the core that both real-time threads used together.
    pub fn core_share(&self) -> f64 {
        self.cycle_core_share + self.exchange_core_share
    }

    /// What failed, and what is worth knowing, in words; empty when there is nothing.
    pub fn remarks(&self, period_ms: f64) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let mut remarks = Vec::new();
        let verdict = self.verdict(period_ms);
        if self.causes.own() > 0 {
            remarks.push(format!("{} own misses", self.causes.own()));
        }
        if self.lost_share() > LOST_MAX {
            remarks.push(self.lost_words(verdict));
        }
        if self.core_share() >= FULL {
            let share = percent(self.core_share());
            remarks.push(format!("core full ({share}): the system halts its threads"));
        }
        if self.budget_hit_share >= WORTH_A_REMARK {
            remarks.push(format!(
                "{} of the solves cut short",
                percent(self.budget_hit_share)
            ));
        }
        if self.stale_input_share >= WORTH_A_REMARK {
            remarks.push(format!("{} stale inputs", percent(self.stale_input_share)));
        }
        if self.dropped_records > 0 {
            remarks.push(format!("{} records dropped", self.dropped_records));
        }
        if self.tracking_share < 1.0 {
            remarks.push(format!("followed in {:.1} %", 100.0 * self.tracking_share));
        }
        remarks.join("; ")
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::rate) fn quiet() -> TrialMetrics {
        let us = |p50: f64| Quantiles {
            min: 0.5 * p50,
            p50,
            p99: 2.0 * p50,
            p999: 3.0 * p50,
            max: 4.0 * p50,
        };
        TrialMetrics {
            duration_s: 2.0,
            cycles: 4000,
            late_starts: 0,
            deadline_misses: 0,
            skipped_periods: 0,
            causes: Causes::default(),
            budget_hit_share: 0.0,
            stale_input_share: 0.0,
            dropped_records: 0,
            wake_us: us(10.0),
            solve_us: us(20.0),
            compute_us: us(22.0),
            response_us: us(30.0),
            cycle_core_share: 0.1,
            exchange_core_share: 0.1,
            tracking_share: 1.0,
            error_p50_mm: 1e-9,
            error_p99_mm: 1e-9,
        }
    }

    #[test]
    fn a_trial_is_judged_by_what_was_lost_and_by_whose_doing() {
        let none = Causes::default();
        let stalls = Causes {
            platform: 2,
            other: 1,
            ..none
        };
        let compute = Causes { compute: 1, ..none };
        let fault = Causes {
            fault: 1,
            platform: 10,
            ..none
        };
        for (deadline_misses, skipped_periods, causes, period_ms, verdict, remarks) in [
            (0, 0, none, 0.5, Verdict::Holds, ""),
            (4, 0, none, 0.5, Verdict::Holds, ""),
            (2, 2, none, 0.5, Verdict::Holds, ""),
            // No evidence that it was the machine.
            (5, 0, none, 0.5, Verdict::Slow, "5 late, 0 skipped"),
            (1, 1000, none, 0.5, Verdict::Slow, "1 late, 1000 skipped"),
            (
                3,
                40,
                stalls,
                0.5,
                Verdict::Machine,
                "the machine: 3 late, 40 skipped (2 platform, 1 stall)",
            ),
            // Wake-up 10 µs and compute 66 µs do not fit.
            (
                3,
                40,
                stalls,
                0.07,
                Verdict::Slow,
                "3 late, 40 skipped (2 platform, 1 stall)",
            ),
            // Nothing excuses an own miss.
            (0, 0, compute, 0.5, Verdict::Own, "1 own misses"),
            (
                0,
                1000,
                fault,
                0.5,
                Verdict::Own,
                "1 own misses; 0 late, 1000 skipped (10 platform, 1 page fault)",
            ),
        ] {
            let metrics = TrialMetrics {
                deadline_misses,
                skipped_periods,
                causes,
                ..quiet()
            };
            assert_eq!(metrics.verdict(period_ms), verdict, "{metrics:?}");
            assert_eq!(metrics.remarks(period_ms), remarks);
        }
        assert!(Verdict::Machine.trials() > Verdict::Slow.trials());
        assert_eq!(Verdict::Own.trials(), 1);
    }

    #[test]
    fn what_costs_quality_is_said_even_when_the_period_holds() {
        let cut = TrialMetrics {
            budget_hit_share: 0.4,
            cycle_core_share: 0.9,
            tracking_share: 0.5,
            ..quiet()
        };
        let remarks = cut.remarks(0.5);
        assert_eq!(cut.verdict(0.5), Verdict::Holds);
        for word in [
            "40 % of the solves",
            "core full (100 %)",
            "followed in 50.0 %",
        ] {
            assert!(remarks.contains(word), "{remarks}");
        }
    }
}
