//! Attribution of a cycle's lateness to the cause of its largest part.
//!
//! ```text
//!  release ──── wake-up ────► start ──────── compute ────────► hand-over
//!          platform │ load          work │ other task │ stall
//! ```
//!
//! A wake-up is late because another task had the core (the scheduler counts that time as run delay), or
//! because the timer was late: firmware or hypervisor. A computation is long because it lost the core, waited
//! for memory, stalled on its own core, or had that much work.
//!
//! An overrun that skips the next release is one event: the punctual cycle after it has no cause of its own.

use cdcr_shared_types::codes::LateCause;

use super::schedule::Lateness;

/// Counts of the scheduler for the cycle thread since its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SchedulerCounts {
    /// Time on a core \[ns\].
    pub on_core_ns: u64,
    /// Time ready to run while another task had the core \[ns\].
    pub run_delay_ns: u64,
    /// Number of times that the thread was put on a core.
    pub turns: u64,
    /// Page faults, minor and major.
    pub page_faults: u64,
}

/// Scheduler statistics of the thread during one cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Scheduling {
    /// Time on a core \[ns\].
    pub on_core_ns: u64,
    /// Time ready to run while another task had the core \[ns\].
    pub run_delay_ns: u64,
    /// Number of times that the thread lost the core other than by its sleep.
    pub switches: u32,
    /// Page faults, minor and major.
    pub page_faults: u32,
}

impl SchedulerCounts {
    /// Difference to `before`, over a time in which the thread slept once.
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

/// Times of one cycle that concern its lateness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Timing {
    /// Planned time from the wake-up of the thread to the release, for rehearsal and spinning \[ns\].
    pub early_ns: u64,
    /// The thread woke up before the release and rehearsed: the timer did not cause a late start.
    pub woke_early: bool,
    /// Wake-up latency \[ns\].
    pub wake_ns: u64,
    /// From the start to the hand-over \[ns\].
    pub compute_ns: u64,
    /// From the start to the planned end of the solver \[ns\], which leaves time for the rest. Work up to
    /// this end is planned and makes no cycle late.
    pub planned_ns: u64,
    /// Longest time between two checks of the clock until the end of the solver \[ns\].
    pub longest_gap_ns: u64,
    /// From the end of the solver to the hand-over: limits and clearance guard \[ns\].
    pub after_solve_ns: u64,
}

/// Checks of the clock are a few microseconds apart; a longer gap than this is a stall of the processor
/// \[ns\].
const STALL_NS: u64 = 100_000;
/// Limits, clearance guard and lag rule take at most 0.5 ms, with 64 obstacles around six sections; a longer time than
/// this is a stall of the processor \[ns\].
const STALL_AFTER_SOLVE_NS: u64 = 600_000;

/// The largest part of a late cycle's time after its release. `scheduling` is `None` if the kernel does not
/// provide it: load is then indistinguishable from platform and counts as platform.
fn attribute(timing: &Timing, scheduling: Option<&Scheduling>) -> LateCause {
    let delay_ns = scheduling.map_or(0, |scheduling| scheduling.run_delay_ns);
    let faults = scheduling.map_or(0, |scheduling| scheduling.page_faults);
    let (waited_ns, interrupted_ns) = split(delay_ns, timing);
    let worked_ns = timing.compute_ns - interrupted_ns;
    let stalled_ns = standstill_ns(timing, interrupted_ns).min(worked_ns);
    // A page fault that takes long leaves a gap; one within steady work costs a microsecond.
    let stall = if faults > 0 {
        LateCause::PageFault
    } else {
        LateCause::Stall
    };
    // A rehearsal ends before its release unless the processor stalls, or it takes longer than usual.
    let late_start = if timing.woke_early {
        stall
    } else {
        LateCause::Platform
    };
    let parts = [
        (timing.wake_ns - waited_ns, late_start),
        (waited_ns + interrupted_ns, LateCause::Load),
        (stalled_ns, stall),
        (
            (worked_ns - stalled_ns).saturating_sub(timing.planned_ns),
            LateCause::Compute,
        ),
    ];
    let largest = parts.into_iter().max_by_key(|(part_ns, _)| *part_ns);
    largest.map_or(LateCause::Platform, |(_, cause)| cause)
}

/// Splits a run delay into the wait between release and start, and the interruption of the computation
/// \[ns\].
///
/// The wait before the start comes first: it made the start late. The rest interrupted the computation, as
/// far as a gap there shows it. Any more was over before the release, in the time for spinning.
fn split(delay_ns: u64, timing: &Timing) -> (u64, u64) {
    let waited_ns = delay_ns.min(timing.wake_ns);
    let left_ns = delay_ns - waited_ns;
    let seen_ns = standstill_ns(timing, 0);
    let early_ns = left_ns.saturating_sub(seen_ns).min(timing.early_ns);
    (waited_ns, (left_ns - early_ns).min(timing.compute_ns))
}

/// The longest unexplained gap in the computation, less `known_ns` \[ns\].
fn standstill_ns(timing: &Timing, known_ns: u64) -> u64 {
    let beyond = |gap_ns: u64, stall_ns| {
        let unexplained_ns = gap_ns.saturating_sub(known_ns);
        if unexplained_ns >= stall_ns {
            unexplained_ns
        } else {
            0
        }
    };
    beyond(timing.longest_gap_ns, STALL_NS).max(beyond(timing.after_solve_ns, STALL_AFTER_SOLVE_NS))
}

/// A cycle with its lateness.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EvaluatedCycle {
    /// Number of cycles so far, including this one.
    pub count: u64,
    pub lateness: Lateness,
    /// Skipped releases before the cycle.
    pub skipped: u32,
    pub timing: Timing,
}

/// Assignment of a late cause to a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CauseAssignment {
    /// None: the cycle was in time and skipped no release.
    InTime,
    /// The cycle was late, or skipped releases not taken by a late cycle before it.
    Own(LateCause),
    /// The cycle was in time. The previous cycle overran the skipped releases, for this cause.
    Before(LateCause),
}

impl CauseAssignment {
    /// The cause in the cycle's record.
    #[must_use]
    pub fn cause(self) -> Option<LateCause> {
        match self {
            Self::InTime => None,
            Self::Own(cause) | Self::Before(cause) => Some(cause),
        }
    }
}

/// Finds the cause of each bad cycle, in order.
#[derive(Debug, Default)]
pub struct Attribution {
    /// The newest cycle that missed its deadline: its count and cause.
    missed: Option<(u64, LateCause)>,
}

impl Attribution {
    /// Evaluates the next cycle.
    pub fn evaluate(
        &mut self,
        cycle: &EvaluatedCycle,
        scheduling: Option<&Scheduling>,
    ) -> CauseAssignment {
        let Lateness {
            late_start,
            deadline_miss,
        } = cycle.lateness;
        let before = self.missed.take();
        if !late_start && !deadline_miss {
            return match before {
                _ if cycle.skipped == 0 => CauseAssignment::InTime,
                // A deadline is at most a period: only a deadline miss can overrun the next release.
                Some((count, cause)) if count + 1 == cycle.count => CauseAssignment::Before(cause),
                _ => CauseAssignment::Own(attribute(&cycle.timing, scheduling)),
            };
        }
        let cause = attribute(&cycle.timing, scheduling);
        self.missed = deadline_miss.then_some((cycle.count, cause));
        CauseAssignment::Own(cause)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: u64 = 1000;

    /// A cycle without early wake-up and planned time; the arguments are in µs.
    fn timing([wake, compute, gap]: [u64; 3]) -> Timing {
        Timing {
            wake_ns: wake * US,
            compute_ns: compute * US,
            longest_gap_ns: gap * US,
            after_solve_ns: 20 * US,
            ..Timing::default()
        }
    }

    fn scheduling([delay, faults]: [u64; 2]) -> Scheduling {
        Scheduling {
            run_delay_ns: delay * US,
            page_faults: faults as u32,
            ..Scheduling::default()
        }
    }

    fn cause(times: [u64; 3], counts: [u64; 2]) -> LateCause {
        attribute(&timing(times), Some(&scheduling(counts)))
    }

    #[test]
    fn the_largest_part_is_the_cause() {
        assert_eq!(cause([6000, 50, 3], [0, 0]), LateCause::Platform);
        assert_eq!(cause([6000, 50, 3], [5900, 0]), LateCause::Load);
        assert_eq!(cause([6000, 50, 3], [2000, 0]), LateCause::Platform);
        // The core was lost during the computation.
        assert_eq!(cause([40, 6000, 5800], [5830, 0]), LateCause::Load);
        // One unexplained gap in the solver.
        assert_eq!(cause([40, 6000, 5800], [10, 0]), LateCause::Stall);
        assert_eq!(cause([40, 6000, 5800], [10, 2]), LateCause::PageFault);
        // Steady work without a gap.
        assert_eq!(cause([40, 6000, 4], [10, 0]), LateCause::Compute);
        // A page fault explains a gap, but not steady work.
        assert_eq!(cause([40, 6000, 4], [10, 1]), LateCause::Compute);
        assert_eq!(cause([40, 6000, 99], [0, 3]), LateCause::Compute);
        assert_eq!(cause([40, 6000, 200], [0, 3]), LateCause::Compute);
        // Woke up in time and started late: the timer was punctual.
        let late = Timing {
            early_ns: 75 * US,
            woke_early: true,
            ..timing([6000, 50, 4])
        };
        assert_eq!(attribute(&late, None), LateCause::Stall);
        let faulted = scheduling([0, 1]);
        assert_eq!(attribute(&late, Some(&faulted)), LateCause::PageFault);
        let mut after_the_solver = timing([40, 6000, 4]);
        after_the_solver.after_solve_ns = 5900 * US;
        let stalled = attribute(&after_the_solver, Some(&scheduling([0, 0])));
        assert_eq!(stalled, LateCause::Stall);
    }

    #[test]
    fn work_that_was_planned_makes_no_cycle_late() {
        let cause = |wake: u64, compute: u64, gap: u64, after: u64| {
            let timing = Timing {
                planned_ns: 4200 * US,
                after_solve_ns: after * US,
                ..timing([wake, compute, gap])
            };
            attribute(&timing, Some(&Scheduling::default()))
        };
        // Without the gap the solver would have ended in time.
        assert_eq!(cause(14, 5700, 1630, 220), LateCause::Stall);
        assert_eq!(cause(1300, 4400, 4, 220), LateCause::Platform);
        // The solver overran its planned end.
        assert_eq!(cause(14, 7000, 4, 220), LateCause::Compute);
    }

    #[test]
    fn without_the_schedulers_word_a_late_wake_up_is_the_platforms() {
        let mut timing = timing([9000, 40, 0]);
        timing.after_solve_ns = 0;
        assert_eq!(attribute(&timing, None), LateCause::Platform);
    }

    #[test]
    fn odd_counts_never_overflow() {
        for wake in [0, 1, u64::MAX / 4] {
            for compute in [0, 1, u64::MAX / 4] {
                for other in [0, 1, u64::MAX] {
                    let timing = Timing {
                        early_ns: other,
                        woke_early: false,
                        wake_ns: wake,
                        compute_ns: compute,
                        planned_ns: other,
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

    fn spinning(wake: u64, compute: u64, gap: u64, delay: u64) -> LateCause {
        let timing = Timing {
            early_ns: 500 * US,
            ..timing([wake, compute, gap])
        };
        attribute(&timing, Some(&scheduling([delay, 0])))
    }

    #[test]
    fn a_wait_before_the_release_interrupts_no_computation() {
        // The thread waited for the core while it should spin, and then computed for long.
        assert_eq!(spinning(0, 700, 4, 400), LateCause::Compute);
        assert_eq!(spinning(0, 700, 300, 400), LateCause::Compute);
        // The same delay, within the computation.
        assert_eq!(spinning(0, 700, 405, 400), LateCause::Load);
        // A delay long enough to make the start late, too.
        assert_eq!(spinning(6000, 50, 4, 6500), LateCause::Load);
        assert_eq!(spinning(6000, 50, 4, 500), LateCause::Platform);
        // More than the time for spinning lies in the computation, with or without a gap.
        assert_eq!(spinning(0, 6000, 90, 5900), LateCause::Load);
    }

    fn evaluated(count: u64, deadline_miss: bool, skipped: u32, compute: u64) -> EvaluatedCycle {
        EvaluatedCycle {
            count,
            lateness: Lateness {
                late_start: false,
                deadline_miss,
            },
            skipped,
            timing: timing([40, compute, 4]),
        }
    }

    #[test]
    fn a_punctual_cycle_after_an_overrun_has_the_cause_of_the_overrun() {
        let mut attribution = Attribution::default();
        let mut evaluate =
            |cycle: EvaluatedCycle| attribution.evaluate(&cycle, Some(&Scheduling::default()));
        let overrun = CauseAssignment::Own(LateCause::Compute);
        assert_eq!(
            evaluate(evaluated(1, false, 0, 30)),
            CauseAssignment::InTime
        );
        assert_eq!(evaluate(evaluated(2, true, 0, 6000)), overrun);
        let after = evaluate(evaluated(3, false, 1, 30));
        assert_eq!(after, CauseAssignment::Before(LateCause::Compute));
        assert_eq!(after.cause(), overrun.cause());
        // The overrun is accounted for: the next skip is another event, with its own cause.
        let own = CauseAssignment::Own(LateCause::Platform);
        assert_eq!(evaluate(evaluated(4, false, 1, 30)), own);
        // Late itself, whatever came before.
        assert_eq!(evaluate(evaluated(5, true, 0, 6000)), overrun);
        assert_eq!(evaluate(evaluated(6, true, 1, 6000)), overrun);
        // The record between was lost, so the previous cycle is unknown.
        assert_eq!(evaluate(evaluated(8, false, 1, 30)), own);
    }

    #[test]
    fn a_late_start_that_met_its_deadline_took_no_release() {
        let mut attribution = Attribution::default();
        let mut late = evaluated(1, false, 0, 30);
        late.lateness.late_start = true;
        late.timing.wake_ns = 900 * US;
        let cause = attribution.evaluate(&late, None);
        assert_eq!(cause, CauseAssignment::Own(LateCause::Platform));
        let next = attribution.evaluate(&evaluated(2, false, 1, 60), None);
        assert_eq!(next, CauseAssignment::Own(LateCause::Compute));
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
