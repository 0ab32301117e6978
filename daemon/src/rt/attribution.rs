//! Why a cycle was late: the largest part of its lateness.
//!
//! ```text
//!  release ──── wake-up ────► start ──────── compute ────────► hand-over
//!          platform │ load          work │ other task │ stall
//! ```
//!
//! A wake-up is late because another task had the core (the scheduler counts that time as run delay), or
//! because the timer itself came late: firmware or hypervisor. A computation is long because it lost the
//! core, waited for memory, stood still with the core its own, or had that much to do.

/// What the scheduler knows about the cycle thread, counted since the thread began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SchedulerCounts {
    /// Time on a core \[ns\].
    pub on_core_ns: u64,
    /// Time ready to run while another had the core \[ns\].
    pub run_delay_ns: u64,
    /// Times that it came onto a core.
    pub turns: u64,
    /// Page faults, minor and major.
    pub page_faults: u64,
}

/// What the system did to the thread during one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Scheduling {
    /// Time on a core \[ns\].
    pub on_core_ns: u64,
    /// Time ready to run while another had the core \[ns\].
    pub run_delay_ns: u64,
    /// Times that it lost the core other than by its sleep.
    pub switches: u32,
    /// Page faults, minor and major.
    pub page_faults: u32,
}

impl SchedulerCounts {
    /// What happened since `before`, a stretch in which the thread slept once.
    #[must_use]
    pub fn since(&self, before: &Self) -> Scheduling {
        let turns = self.turns.saturating_sub(before.turns);
        Scheduling {
            on_core_ns: self.on_core_ns.saturating_sub(before.on_core_ns),
            run_delay_ns: self.run_delay_ns.saturating_sub(before.run_delay_ns),
            switches: turns.saturating_sub(1) as u32,
            page_faults: self.page_faults.saturating_sub(before.page_faults) as u32,
        }
    }
}

/// The times of one cycle, as far as its lateness is concerned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// From the release that was due to the start \[ns\].
    pub wake_ns: u64,
    /// From the start to the hand-over \[ns\].
    pub compute_ns: u64,
    /// Longest time between two looks at the clock until the solver was done \[ns\].
    pub longest_gap_ns: u64,
    /// From the end of the solver to the hand-over: limits and clearance guard \[ns\].
    pub after_solve_ns: u64,
}

/// What made a cycle late.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LateCause {
    /// The wake-up came late, with the core free.
    Platform,
    /// Another task had the core.
    Load,
    /// Memory was not there when it was touched.
    PageFault,
    /// The processor stood still in the middle of the computation.
    Stall,
    /// The cycle itself computed for too long.
    Compute,
}

/// Two looks at the clock are a few microseconds apart; so far apart, the processor stood still \[ns\].
const STALL_NS: u64 = 100_000;
/// Limits and clearance guard take at most 0.4 ms, with 64 obstacles around six sections; so long, the
/// processor stood still \[ns\].
const STALL_AFTER_SOLVE_NS: u64 = 600_000;

/// The largest part of a late cycle's time after its release. `scheduling` is `None` where the system does
/// not tell; then load cannot be told from platform, and counts as platform.
pub fn attribute(timing: &Timing, scheduling: Option<&Scheduling>) -> LateCause {
    let delay_ns = scheduling.map_or(0, |scheduling| scheduling.run_delay_ns);
    let faults = scheduling.map_or(0, |scheduling| scheduling.page_faults);
    // The wait before the start comes first; what is left of the delay interrupted the computation.
    let waited_ns = delay_ns.min(timing.wake_ns);
    let interrupted_ns = (delay_ns - waited_ns).min(timing.compute_ns);
    let worked_ns = timing.compute_ns - interrupted_ns;
    let beyond = |gap_ns: u64, stall_ns| {
        let unexplained_ns = gap_ns.saturating_sub(interrupted_ns);
        if unexplained_ns >= stall_ns {
            unexplained_ns
        } else {
            0
        }
    };
    let stalled_ns = beyond(timing.longest_gap_ns, STALL_NS)
        .max(beyond(timing.after_solve_ns, STALL_AFTER_SOLVE_NS))
        .min(worked_ns);
    let stall = if faults > 0 {
        LateCause::PageFault
    } else {
        LateCause::Stall
    };
    let own = if faults > 0 && stalled_ns == 0 {
        LateCause::PageFault
    } else {
        LateCause::Compute
    };
    let parts = [
        (timing.wake_ns - waited_ns, LateCause::Platform),
        (waited_ns + interrupted_ns, LateCause::Load),
        (stalled_ns, stall),
        (worked_ns - stalled_ns, own),
    ];
    let largest = parts.into_iter().max_by_key(|(part_ns, _)| *part_ns);
    largest.map_or(LateCause::Platform, |(_, cause)| cause)
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: u64 = 1000;

    fn cause([wake, compute, gap]: [u64; 3], [delay, faults]: [u64; 2]) -> LateCause {
        let timing = Timing {
            wake_ns: wake * US,
            compute_ns: compute * US,
            longest_gap_ns: gap * US,
            after_solve_ns: 20 * US,
        };
        let scheduling = Scheduling {
            run_delay_ns: delay * US,
            page_faults: faults as u32,
            ..Scheduling::default()
        };
        attribute(&timing, Some(&scheduling))
    }

    #[test]
    fn the_largest_part_is_the_cause() {
        assert_eq!(cause([6000, 50, 3], [0, 0]), LateCause::Platform);
        assert_eq!(cause([6000, 50, 3], [5900, 0]), LateCause::Load);
        assert_eq!(cause([6000, 50, 3], [2000, 0]), LateCause::Platform);
        // The core was lost while computing.
        assert_eq!(cause([40, 6000, 5800], [5830, 0]), LateCause::Load);
        // One gap in the solver that nobody accounts for.
        assert_eq!(cause([40, 6000, 5800], [10, 0]), LateCause::Stall);
        assert_eq!(cause([40, 6000, 5800], [10, 2]), LateCause::PageFault);
        // Steady work without a gap.
        assert_eq!(cause([40, 6000, 4], [10, 0]), LateCause::Compute);
        assert_eq!(cause([40, 6000, 4], [10, 3]), LateCause::PageFault);
        // A stall after the solver.
        let timing = Timing {
            wake_ns: 40 * US,
            compute_ns: 6000 * US,
            longest_gap_ns: 4 * US,
            after_solve_ns: 5900 * US,
        };
        assert_eq!(
            attribute(&timing, Some(&Scheduling::default())),
            LateCause::Stall
        );
    }

    #[test]
    fn without_the_schedulers_word_a_late_wake_up_is_the_platforms() {
        let timing = Timing {
            wake_ns: 9000 * US,
            compute_ns: 40 * US,
            longest_gap_ns: 0,
            after_solve_ns: 0,
        };
        assert_eq!(attribute(&timing, None), LateCause::Platform);
    }

    #[test]
    fn odd_counts_never_overflow() {
        for wake in [0, 1, u64::MAX / 4] {
            for compute in [0, 1, u64::MAX / 4] {
                for other in [0, 1, u64::MAX] {
                    let timing = Timing {
                        wake_ns: wake,
                        compute_ns: compute,
                        longest_gap_ns: other,
                        after_solve_ns: other,
                    };
                    let scheduling = Scheduling {
                        run_delay_ns: other,
                        ..Scheduling::default()
                    };
                    attribute(&timing, Some(&scheduling));
                }
            }
        }
    }

    #[test]
    fn one_turn_in_a_cycle_is_its_own_wake_up() {
        let before = SchedulerCounts {
            on_core_ns: 100,
            run_delay_ns: 10,
            turns: 7,
            page_faults: 3,
        };
        let after = SchedulerCounts {
            on_core_ns: 160,
            run_delay_ns: 12,
            turns: 8,
            page_faults: 3,
        };
        let expected = Scheduling {
            on_core_ns: 60,
            run_delay_ns: 2,
            switches: 0,
            page_faults: 0,
        };
        assert_eq!(after.since(&before), expected);
        let preempted = SchedulerCounts { turns: 10, ..after };
        assert_eq!(preempted.since(&before).switches, 2);
        assert_eq!(before.since(&after).switches, 0);
    }
}
