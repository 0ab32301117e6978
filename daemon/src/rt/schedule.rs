use crate::rt::clock::Clock;

/// The absolute time grid: cycle k is released at `origin + k · period`.
///
/// Lateness is counted from the release that was due, never from the actual start, so a stall cannot hide.
/// After an overrun whole periods are skipped; cycles are never made up in a burst. A short overrun into a
/// release starts that cycle late instead of skipping it.
#[derive(Debug, Clone)]
pub struct Schedule {
    origin_ns: u64,
    period_ns: u64,
    spin_ns: u64,
    last_cycle: u64,
}

/// An overrun of at most this part of a period does not skip the release into which it extends: 0.5 ms of 5
/// ms.
const OVERRUN_PART: u64 = 10;
/// After such an overrun the thread sleeps for this part of a period: the exchange must publish the command
/// and gather for the next cycle.
const BREATH_PART: u64 = 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Release {
    /// Number on the grid.
    pub cycle: u64,
    /// Time of the release on the grid \[ns\].
    pub release_ns: u64,
    /// The release that was due \[ns\]: earlier than `release_ns` if the thread slept through whole periods.
    /// Lateness counts from here.
    pub due_ns: u64,
    /// Start of the cycle \[ns\].
    pub start_ns: u64,
    /// Releases without a cycle since the previous cycle.
    pub skipped: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Lateness {
    pub late_start: bool,
    /// The command for the release that was due was handed over after the deadline.
    pub deadline_miss: bool,
}

impl Schedule {
    /// A grid whose first release, that of cycle 1, is one period after `origin_ns`.
    pub fn new(origin_ns: u64, period_ns: u64) -> Self {
        Self {
            origin_ns,
            period_ns,
            spin_ns: 0,
            last_cycle: 0,
        }
    }

    /// The same grid with waits that wake up `spin_ns` before each release and spin until then.
    #[must_use]
    pub fn with_spin(self, spin_ns: u64) -> Self {
        Self { spin_ns, ..self }
    }

    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// Time of the release of `cycle` \[ns\].
    pub fn release_ns(&self, cycle: u64) -> u64 {
        self.origin_ns + cycle * self.period_ns
    }

    /// The newest cycle released at `now_ns`.
    pub fn cycle_at(&self, now_ns: u64) -> u64 {
        now_ns.saturating_sub(self.origin_ns) / self.period_ns
    }

    /// Sleeps until the next release, or briefly after a short overrun, and returns the release that starts.
    pub fn wait(&mut self, clock: &impl Clock) -> Release {
        self.wait_with(clock, |_, _| ())
    }

    /// Same as [`wait`](Self::wait), with a rehearsal after a wake-up before the release. Runs `rehearse`
    /// with the number of the cycle and the time of its release \[ns\], and spins for the rest of the time.
    pub fn wait_with(&mut self, clock: &impl Clock, rehearse: impl FnOnce(u64, u64)) -> Release {
        let earliest = self.last_cycle + 1;
        let now_ns = clock.now_ns();
        let newest = self.cycle_at(now_ns);
        let takes_late =
            newest >= earliest && now_ns - self.release_ns(newest) <= self.period_ns / OVERRUN_PART;
        let next = if takes_late {
            newest
        } else {
            earliest.max(newest + 1)
        };
        let due_ns = self.release_ns(next);
        clock.sleep_until(if takes_late {
            now_ns + self.period_ns / BREATH_PART
        } else {
            due_ns.saturating_sub(self.spin_ns)
        });
        let mut start_ns = clock.now_ns();
        if start_ns < due_ns {
            rehearse(next, due_ns);
            start_ns = clock.now_ns();
        }
        while start_ns < due_ns {
            core::hint::spin_loop();
            start_ns = clock.now_ns();
        }
        // Slept through whole periods: the newest release counts, the others are skipped.
        let cycle = next.max(self.cycle_at(start_ns));
        let skipped = cycle - earliest;
        self.last_cycle = cycle;
        Release {
            cycle,
            release_ns: self.release_ns(cycle),
            due_ns,
            start_ns,
            skipped: u32::try_from(skipped).unwrap_or(u32::MAX),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rt::clock::ManualClock;

    #[test]
    fn a_thread_that_spins_wakes_early_and_starts_at_its_release() {
        let (clock, schedule) = (ManualClock::new(0), Schedule::new(0, 100));
        clock.step_ns.set(1);
        clock.late_ns.set(12);
        let mut schedule = schedule.with_spin(30);
        for cycle in 1..=3 {
            let release = schedule.wait(&clock);
            assert_eq!((release.cycle, release.due_ns), (cycle, cycle * 100));
            assert_eq!(
                release.start_ns, release.due_ns,
                "12 of 30 ns late is early enough"
            );
        }
        let mut rehearsed = None;
        let release = schedule.wait_with(&clock, |cycle, release_ns| {
            rehearsed = Some((cycle, release_ns));
        });
        assert_eq!((rehearsed, release.start_ns), (Some((4, 400)), 400));
        clock.late_ns.set(50);
        let release = schedule.wait_with(&clock, |_, _| unreachable!("it woke up too late"));
        assert!((20..30).contains(&(release.start_ns - release.due_ns)));
    }

    #[test]
    fn punctual_cycles_follow_each_other() {
        let (clock, mut schedule) = (ManualClock::new(1000), Schedule::new(1000, 100));
        for cycle in 1..=5 {
            let release = schedule.wait(&clock);
            assert_eq!(
                release,
                Release {
                    cycle,
                    release_ns: 1000 + cycle * 100,
                    due_ns: 1000 + cycle * 100,
                    start_ns: 1000 + cycle * 100,
                    skipped: 0
                }
            );
        }
    }

    #[test]
    fn a_late_wake_up_inside_the_period_is_late_but_skips_nothing() {
        let (clock, mut schedule) = (ManualClock::new(0), Schedule::new(0, 100));
        clock.late_ns.set(60);
        let release = schedule.wait(&clock);
        assert_eq!(
            (
                release.cycle,
                release.start_ns - release.release_ns,
                release.skipped
            ),
            (1, 60, 0)
        );
    }

    #[test]
    fn a_stall_skips_whole_periods_and_keeps_the_grid() {
        let (clock, mut schedule) = (ManualClock::new(0), Schedule::new(0, 100));
        schedule.wait(&clock);
        clock.late_ns.set(350);
        let release = schedule.wait(&clock);
        assert_eq!(
            (release.cycle, release.release_ns, release.skipped),
            (5, 500, 3)
        );
        assert_eq!((release.due_ns, release.start_ns), (200, 550));
        clock.late_ns.set(0);
        assert_eq!(schedule.wait(&clock).cycle, 6);
    }

    #[test]
    fn an_overrun_by_little_takes_its_release_late() {
        let (clock, mut schedule) = (ManualClock::new(0), Schedule::new(0, 100));
        schedule.wait(&clock);
        for (ran_until, cycle, skipped, start) in [
            (200, 2, 0, 205),
            (310, 3, 0, 315),
            // More than a tenth: the next release.
            (411, 5, 1, 500),
            // Earlier releases are skipped.
            (803, 8, 2, 808),
            (1230, 13, 4, 1300),
        ] {
            clock.now_ns.set(ran_until);
            let release = schedule.wait(&clock);
            assert_eq!(
                release,
                Release {
                    cycle,
                    release_ns: cycle * 100,
                    due_ns: cycle * 100,
                    start_ns: start,
                    skipped
                }
            );
        }
    }
}
