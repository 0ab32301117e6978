//! What one trial measured, and whether its period held.

use cdcr_shared_types::Statistics;
use cdcr_shared_types::codes::LateCause;
use serde::Serialize;

use crate::quantiles::Quantiles;

/// From this share of a core on, the system may halt real-time threads: Linux leaves them 95 %.
const FULL: f64 = 0.93;
/// From this share on, a remark says that solves were cut short, or that inputs were stale.
const WORTH_A_REMARK: f64 = 0.01;
/// A machine that stalls makes one cycle late now and then. A period of which so many cycles are late is too
/// short, and a second trial would only say so again.
const HOPELESS: f64 = 0.01;

/// What the daemon did in one trial, in its own statistics, unless something else is said.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// How long it was measured \[s\].
    pub duration_s: f64,
    /// Cycles that ran.
    pub cycles: u64,
    /// Of them, those that started late.
    pub late_starts: u64,
    /// Of them, those that missed their deadline, the end of the period.
    pub deadline_misses: u64,
    /// Releases that got no cycle.
    pub skipped_periods: u64,
    /// Late cycles by what made them late.
    pub causes: Causes,
    /// Share of the cycles whose solve was cut short by the end of its time.
    pub budget_hit_share: f64,
    /// Share of the cycles that used the inputs of the one before again.
    pub stale_input_share: f64,
    /// Records that were lost inside the daemon.
    pub dropped_records: u64,
    /// Release to start.
    pub wake_us: Quantiles,
    /// The solver.
    pub solve_us: Quantiles,
    /// Release to hand-over of the command.
    pub response_us: Quantiles,
    /// Share of its core that the cycle thread used, by the kernel's count.
    pub cycle_core_share: f64,
    /// Share of its core that the exchange thread used, by the kernel's count.
    pub exchange_core_share: f64,
    /// Share of the cycles in which the robot followed its reference, of those whose record a client got.
    pub tracking_share: f64,
    /// Distance of the tip from its reference, as the client's records say: median \[mm\].
    pub error_p50_mm: f64,
    /// The same: 99th percentile \[mm\].
    pub error_p99_mm: f64,
}

/// Late cycles by what made them late.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Causes {
    /// The timer came late, or the hypervisor had the core.
    pub platform: u64,
    /// Another task had the core.
    pub load: u64,
    /// Memory was not there.
    pub page_fault: u64,
    /// The processor stood still.
    pub stall: u64,
    /// The cycle computed for too long.
    pub compute: u64,
}

impl Causes {
    /// As the daemon counted them.
    pub fn told(statistics: &Statistics) -> Self {
        let of = |cause: LateCause| statistics.causes[cause.code() as usize];
        Self {
            platform: of(LateCause::Platform),
            load: of(LateCause::Load),
            page_fault: of(LateCause::PageFault),
            stall: of(LateCause::Stall),
            compute: of(LateCause::Compute),
        }
    }

    /// Those that are the daemon's own doing.
    pub fn own(&self) -> u64 {
        self.page_fault + self.compute
    }

    /// All late cycles.
    pub fn all(&self) -> u64 {
        self.own() + self.platform + self.load + self.stall
    }

    /// In words, without those that did not happen.
    fn words(self) -> String {
        let all = [
            (self.platform, "platform"),
            (self.load, "another task"),
            (self.page_fault, "page fault"),
            (self.stall, "stall"),
            (self.compute, "compute"),
        ];
        let there = all.iter().filter(|(count, _)| *count > 0);
        let words: Vec<_> = there
            .map(|(count, name)| format!("{count} {name}"))
            .collect();
        words.join(", ")
    }
}

impl Figures {
    /// Whether the period held: 99.9 % of the responses lie within it, and no cycle was late by the daemon's
    /// own doing.
    pub fn hold(&self, period_ms: f64) -> bool {
        self.causes.own() == 0 && self.response_us.p999 <= period_ms * 1e3
    }

    /// Whether so much was late that no single stall of the machine explains it.
    pub fn are_hopeless(&self, period_ms: f64) -> bool {
        self.response_us.p99 > period_ms * 1e3
            || self.causes.own() as f64 > HOPELESS * self.cycles as f64
    }

    /// Share of the core that both real-time threads used together.
    pub fn core_share(&self) -> f64 {
        self.cycle_core_share + self.exchange_core_share
    }

    /// What failed, and what is worth knowing, in words; empty when there is nothing.
    pub fn remarks(&self, period_ms: f64) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let mut remarks = Vec::new();
        if self.response_us.p999 > period_ms * 1e3 {
            let words = self.causes.words();
            remarks.push(match words.as_str() {
                "" => "response beyond the period".to_owned(),
                words => format!("response beyond the period (late: {words})"),
            });
        }
        if self.causes.own() > 0 {
            remarks.push(format!("{} own misses", self.causes.own()));
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

    /// Of a trial in which nothing happened.
    pub(in crate::rate) fn quiet() -> Figures {
        let us = |p50: f64| Quantiles {
            min: 0.5 * p50,
            p50,
            p99: 2.0 * p50,
            p999: 3.0 * p50,
            max: 4.0 * p50,
        };
        Figures {
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
            response_us: us(30.0),
            cycle_core_share: 0.1,
            exchange_core_share: 0.1,
            tracking_share: 1.0,
            error_p50_mm: 1e-9,
            error_p99_mm: 1e-9,
        }
    }

    #[test]
    fn a_period_holds_when_the_response_fits_and_no_miss_is_our_own() {
        let quiet = quiet();
        assert!(quiet.hold(0.09) && !quiet.hold(0.08));
        assert!(quiet.remarks(0.09).is_empty());
        let remarks = quiet.remarks(0.08);
        assert!(remarks.contains("beyond the period"), "{remarks}");

        let platform = Figures {
            causes: Causes {
                platform: 3,
                load: 1,
                stall: 1,
                ..Causes::default()
            },
            ..quiet.clone()
        };
        assert!(platform.hold(0.5));
        for causes in [
            Causes {
                compute: 1,
                ..Causes::default()
            },
            Causes {
                page_fault: 1,
                ..Causes::default()
            },
        ] {
            let own = Figures {
                causes,
                ..quiet.clone()
            };
            assert!(!own.hold(0.5) && !own.are_hopeless(0.5));
            assert!(own.remarks(0.5).contains("1 own"), "{}", own.remarks(0.5));
        }
    }

    #[test]
    fn only_what_no_stall_explains_is_hopeless() {
        let quiet = quiet();
        // p99.9 beyond the period, p99 not: that may be one stall.
        assert!(!quiet.are_hopeless(0.07) && quiet.are_hopeless(0.05));
        let computing = Figures {
            causes: Causes {
                compute: 41,
                ..Causes::default()
            },
            ..quiet
        };
        assert!(computing.are_hopeless(5.0));
    }

    #[test]
    fn what_costs_quality_is_said_even_when_the_period_holds() {
        let cut = Figures {
            budget_hit_share: 0.4,
            cycle_core_share: 0.9,
            tracking_share: 0.5,
            ..quiet()
        };
        let remarks = cut.remarks(0.5);
        assert!(cut.hold(0.5));
        for word in [
            "40 % of the solves",
            "core full (100 %)",
            "followed in 50.0 %",
        ] {
            assert!(remarks.contains(word), "{remarks}");
        }
    }
}
