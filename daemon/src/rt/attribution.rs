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
//!
//! An overrun that takes the next release with it is one event: the punctual cycle after it has no cause of
//! its own.

use cdcr_shared_types::codes::LateCause;

use super::schedule::Lateness;

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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Timing {
    /// How long before the release the thread asked to be woken, to rehearse and spin until then \[ns\].
    pub early_ns: u64,
    /// It woke up before the release and rehearsed: a late start is none of the timer's.
    pub woke_early: bool,
    /// From the release that was due to the start \[ns\].
    pub wake_ns: u64,
    /// From the start to the hand-over \[ns\].
    pub compute_ns: u64,
    /// From the start to the end that the solver was given, which leaves time for what follows: as much work is what
    /// the cycle is for, and makes none late \[ns\].
    pub planned_ns: u64,
    /// Longest time between two looks at the clock until the solver was done \[ns\].
    pub longest_gap_ns: u64,
    /// From the end of the solver to the hand-over: limits and clearance guard \[ns\].
    pub after_solve_ns: u64,
}

/// Two looks at the clock are a few microseconds apart; so far apart, the processor stood still \[ns\].
const STALL_NS: u64 = 100_000;
/// Limits and clearance guard take at most 0.4 ms, with 64 obstacles around six sections; so long, the
/// processor stood still \[ns\].
const STALL_AFTER_SOLVE_NS: u64 = 600_000;

/// The largest part of a late cycle's time after its release. `scheduling` is `None` where the system does
/// not tell; then load cannot be told from platform, and counts as platform.
fn attribute(timing: &Timing, scheduling: Option<&Scheduling>) -> LateCause {
    let delay_ns = scheduling.map_or(0, |scheduling| scheduling.run_delay_ns);
    let faults = scheduling.map_or(0, |scheduling| scheduling.page_faults);
    let (waited_ns, interrupted_ns) = split(delay_ns, timing);
    let worked_ns = timing.compute_ns - interrupted_ns;
    let stalled_ns = standstill_ns(timing, interrupted_ns).min(worked_ns);
    // A fault that takes long leaves a gap; one inside steady work costs a microsecond.
    let stall = if faults > 0 {
        LateCause::PageFault
    } else {
        LateCause::Stall
    };
    // A rehearsal that could be over by its release was.
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

/// What of a run delay lies between release and start, and what interrupted the computation \[ns\].
///
/// The wait before the start comes first, and its end is what made the start late. What is left lies in the
/// computation as far as a gap there shows it; the rest was over before the release, while the thread was
/// to spin.
fn split(delay_ns: u64, timing: &Timing) -> (u64, u64) {
    let waited_ns = delay_ns.min(timing.wake_ns);
    let left_ns = delay_ns - waited_ns;
    let seen_ns = standstill_ns(timing, 0);
    let early_ns = left_ns.saturating_sub(seen_ns).min(timing.early_ns);
    (waited_ns, (left_ns - early_ns).min(timing.compute_ns))
}

/// The longest gap in the computation that work does not explain, without `known_ns` of it \[ns\].
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

/// A cycle, as its accounting saw it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EvaluatedCycle {
    /// How many cycles ran, this one included.
    pub count: u64,
    pub lateness: Lateness,
    /// Releases before it that got no cycle.
    pub skipped: u32,
    pub timing: Timing,
}

/// What a cycle has to answer for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blame {
    /// Nothing: it was in time and skipped no release.
    InTime,
    /// It was late, or skipped releases that no late cycle before it took.
    Own(LateCause),
    /// It was in time. The cycle before it ran past the releases that it skipped, for this cause.
    Before(LateCause),
}

impl Blame {
    /// The cause that its record names.
    #[must_use]
    pub fn cause(self) -> Option<LateCause> {
        match self {
            Self::InTime => None,
            Self::Own(cause) | Self::Before(cause) => Some(cause),
        }
    }
}

/// Finds the cause of each bad cycle, one after the other.
#[derive(Debug, Default)]
pub struct Attribution {
    /// The newest cycle that missed its deadline: its count, and why.
    missed: Option<(u64, LateCause)>,
}

impl Attribution {
    /// What the next cycle has to answer for.
    pub fn evaluate(&mut self, cycle: &EvaluatedCycle, scheduling: Option<&Scheduling>) -> Blame {
        let Lateness {
            late_start,
            deadline_miss,
        } = cycle.lateness;
        let before = self.missed.take();
        if !late_start && !deadline_miss {
            return match before {
                _ if cycle.skipped == 0 => Blame::InTime,
                // A deadline is at most a period, so only a miss can run past the next release.
                Some((count, cause)) if count + 1 == cycle.count => Blame::Before(cause),
                _ => Blame::Own(attribute(&cycle.timing, scheduling)),
            };
        }
        let cause = attribute(&cycle.timing, scheduling);
        self.missed = deadline_miss.then_some((cycle.count, cause));
        Blame::Own(cause)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const US: u64 = 1000;

    /// A cycle that nobody woke early and that planned nothing \[µs\].
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
        // The core was lost while computing.
        assert_eq!(cause([40, 6000, 5800], [5830, 0]), LateCause::Load);
        // One gap in the solver that nobody accounts for.
        assert_eq!(cause([40, 6000, 5800], [10, 0]), LateCause::Stall);
        assert_eq!(cause([40, 6000, 5800], [10, 2]), LateCause::PageFault);
        // Steady work without a gap.
        assert_eq!(cause([40, 6000, 4], [10, 0]), LateCause::Compute);
        // A fault explains a gap, and no steady work.
        assert_eq!(cause([40, 6000, 4], [10, 1]), LateCause::Compute);
        assert_eq!(cause([40, 6000, 99], [0, 3]), LateCause::Compute);
        assert_eq!(cause([40, 6000, 200], [0, 3]), LateCause::Compute);
        // It woke up in time, and started late: the timer was punctual.
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
        // The solver would have ended in time but for the gap.
        assert_eq!(cause(14, 5700, 1630, 220), LateCause::Stall);
        assert_eq!(cause(1300, 4400, 4, 220), LateCause::Platform);
        // It did not end when it should have.
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
        // It waited for the core while it was to spin, and then computed for long.
        assert_eq!(spinning(0, 700, 4, 400), LateCause::Compute);
        assert_eq!(spinning(0, 700, 300, 400), LateCause::Compute);
        // The same delay, seen in the computation.
        assert_eq!(spinning(0, 700, 405, 400), LateCause::Load);
        // So long a delay made the start late, too.
        assert_eq!(spinning(6000, 50, 4, 6500), LateCause::Load);
        assert_eq!(spinning(6000, 50, 4, 500), LateCause::Platform);
        // More than the time to spin lies in the computation, gap or not.
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
        let overrun = Blame::Own(LateCause::Compute);
        assert_eq!(evaluate(evaluated(1, false, 0, 30)), Blame::InTime);
        assert_eq!(evaluate(evaluated(2, true, 0, 6000)), overrun);
        let after = evaluate(evaluated(3, false, 1, 30));
        assert_eq!(after, Blame::Before(LateCause::Compute));
        assert_eq!(after.cause(), overrun.cause());
        // The overrun is paid for: the next skip is another event, with the parts of its own cycle.
        let own = Blame::Own(LateCause::Platform);
        assert_eq!(evaluate(evaluated(4, false, 1, 30)), own);
        // Late itself, whatever came before.
        assert_eq!(evaluate(evaluated(5, true, 0, 6000)), overrun);
        assert_eq!(evaluate(evaluated(6, true, 1, 6000)), overrun);
        // The record between was lost, so nobody knows what the cycle before did.
        assert_eq!(evaluate(evaluated(8, false, 1, 30)), own);
    }

    #[test]
    fn a_late_start_that_met_its_deadline_took_no_release() {
        let mut attribution = Attribution::default();
        let mut late = evaluated(1, false, 0, 30);
        late.lateness.late_start = true;
        late.timing.wake_ns = 900 * US;
        let cause = attribution.evaluate(&late, None);
        assert_eq!(cause, Blame::Own(LateCause::Platform));
        let next = attribution.evaluate(&evaluated(2, false, 1, 60), None);
        assert_eq!(next, Blame::Own(LateCause::Compute));
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
