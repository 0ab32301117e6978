//! Steal: the time for which the hypervisor withheld the core, and the late cycles that it explains.

use std::fs::File;
use std::os::unix::fs::FileExt;

use cdcr_shared_types::codes::LateCause;
use cdcr_shared_types::proc_stat::{TICK_NS, core_ticks};

use crate::rt::clock::Clock;

/// Time between readings of the steal while no cycle is late \[ns\]: earlier steal must not explain a later
/// cycle.
const READ_EVERY_NS: u64 = 100_000_000;

/// Steal in a time window; both 0: it cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Steal {
    /// Time stolen \[ns\], in steps of a tick.
    pub(super) steal_ns: u64,
    /// Length of the window, up to the newest reading \[ns\].
    pub(super) window_ns: u64,
}

impl Steal {
    /// The cause of a cycle that was `lateness_ns` late. In a virtual machine, steal looks like another task
    /// on the core, a stall or a long computation. If the steal is at least half of the lateness, the cause
    /// is the platform.
    pub(super) fn cause(self, seen: u32, lateness_ns: u64) -> u32 {
        let looks_alike = [LateCause::Load, LateCause::Stall, LateCause::Compute];
        let is_stolen = self.steal_ns >= TICK_NS && self.steal_ns >= lateness_ns / 2;
        if is_stolen && looks_alike.map(LateCause::code).contains(&seen) {
            LateCause::Platform.code()
        } else {
            seen
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct StealReading {
    time_ns: u64,
    total_ns: u64,
}

/// The steal of one core, read at most once per check of the supervisor: all late cycles of a check share the
/// reading.
#[derive(Debug, Default)]
pub(super) struct StealMonitor {
    reader: Option<StealReader>,
    /// Oldest first. Two readings precede the newest, so that one is older than a late cycle that contains a
    /// reading.
    readings: [StealReading; 3],
    is_fresh: bool,
}

impl StealMonitor {
    /// Reads the steal of `core`, or of all cores together.
    pub(super) fn new(core: Option<usize>, clock: &impl Clock) -> Self {
        let mut steal = Self {
            reader: StealReader::open(core),
            ..Self::default()
        };
        steal.read(clock.now_ns());
        steal.readings = [steal.readings[2]; 3];
        steal
    }

    /// Begins a new check.
    pub(super) fn begin_check(&mut self, clock: &impl Clock) {
        self.is_fresh = false;
        let now_ns = clock.now_ns();
        if now_ns.saturating_sub(self.readings[2].time_ns) > READ_EVERY_NS {
            self.read(now_ns);
        }
    }

    /// Steal since the newest reading before `due_ns`.
    pub(super) fn since(&mut self, due_ns: u64, clock: &impl Clock) -> Steal {
        if !self.is_fresh {
            self.read(clock.now_ns());
        }
        between(&self.readings, due_ns)
    }

    fn read(&mut self, now_ns: u64) {
        self.is_fresh = true;
        if let Some(total_ns) = self.reader.as_mut().and_then(StealReader::read_ns) {
            self.readings.rotate_left(1);
            self.readings[2] = StealReading {
                time_ns: now_ns,
                total_ns,
            };
        }
    }
}

/// From the newest reading before `due_ns`, or the oldest, to the newest.
fn between(readings: &[StealReading; 3], due_ns: u64) -> Steal {
    let [oldest, before, newest] = readings;
    let begin = if before.time_ns <= due_ns {
        before
    } else {
        oldest
    };
    Steal {
        steal_ns: newest.total_ns.saturating_sub(begin.total_ns),
        window_ns: newest.time_ns.saturating_sub(begin.time_ns),
    }
}

/// Reads the steal of one core, or of all cores.
#[derive(Debug)]
struct StealReader {
    file: File,
    core: Option<usize>,
    text: Vec<u8>,
}

impl StealReader {
    /// A reader for `core`, or for the sum of all cores. `None` if `/proc/stat` is missing.
    fn open(core: Option<usize>) -> Option<Self> {
        Some(Self {
            file: File::open("/proc/stat").ok()?,
            core,
            text: vec![0; 64 * 1024],
        })
    }

    /// Steal since the start of the machine \[ns\].
    fn read_ns(&mut self) -> Option<u64> {
        let length = self.file.read_at(&mut self.text, 0).ok()?;
        let text = core::str::from_utf8(&self.text[..length]).ok()?;
        let (_, ticks) = core_ticks(text).find(|(core, _)| *core == self.core)?;
        Some(ticks.steal * TICK_NS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rt::clock::ManualClock;

    const MS: u64 = 1_000_000;

    #[test]
    fn steal_that_is_half_of_the_lateness_makes_it_the_platforms() {
        let cause = |steal_ms, lateness_ms, seen: LateCause| {
            let steal = Steal {
                steal_ns: steal_ms * MS,
                window_ns: 100 * MS,
            };
            LateCause::try_from(steal.cause(seen.code(), lateness_ms * MS)).expect("a cause")
        };
        for seen in [LateCause::Load, LateCause::Stall, LateCause::Compute] {
            assert_eq!(cause(10, 6, seen), LateCause::Platform);
            assert_eq!(cause(10, 20, seen), LateCause::Platform);
            assert_eq!(cause(10, 21, seen), seen, "less than half");
            assert_eq!(cause(0, 0, seen), seen, "less than a tick");
        }
        for seen in [LateCause::None, LateCause::Platform, LateCause::PageFault] {
            assert_eq!(cause(10, 6, seen), seen);
        }
    }

    #[test]
    fn the_window_begins_before_the_late_cycle() {
        let reading = |time_ms, total_ms| StealReading {
            time_ns: time_ms * MS,
            total_ns: total_ms * MS,
        };
        let readings = [reading(100, 0), reading(200, 30), reading(220, 40)];
        let steal = |due_ms| {
            let Steal {
                steal_ns,
                window_ns,
            } = between(&readings, due_ms * MS);
            [steal_ns / MS, window_ns / MS]
        };
        assert_eq!(steal(210), [10, 20]);
        assert_eq!(steal(200), [10, 20]);
        // A reading during the late cycle.
        assert_eq!(steal(195), [40, 120]);
        assert_eq!(steal(50), [40, 120]);
    }

    #[test]
    fn the_late_cycles_of_a_check_share_one_reading() {
        let clock = ManualClock::default();
        let mut steal = StealMonitor::new(None, &clock);
        let window_ms = |steal: Steal| steal.window_ns / MS;
        clock.sleep_until(20 * MS);
        steal.begin_check(&clock);
        assert_eq!(window_ms(steal.since(5 * MS, &clock)), 20);
        clock.sleep_until(21 * MS);
        assert_eq!(window_ms(steal.since(5 * MS, &clock)), 20, "no new reading");
        clock.sleep_until(40 * MS);
        steal.begin_check(&clock);
        assert_eq!(window_ms(steal.since(25 * MS, &clock)), 20, "a new one");
        // The steal is also read while no cycle is late.
        clock.sleep_until(400 * MS);
        steal.begin_check(&clock);
        clock.sleep_until(420 * MS);
        steal.begin_check(&clock);
        assert_eq!(window_ms(steal.since(410 * MS, &clock)), 20);
    }

    #[test]
    fn steal_that_cannot_be_read_is_zero() {
        let clock = ManualClock::default();
        let mut steal = StealMonitor::default();
        clock.sleep_until(400 * MS);
        steal.begin_check(&clock);
        assert_eq!(steal.since(300 * MS, &clock), Steal::default());
    }

    #[test]
    fn this_machine_can_be_read() {
        let mut reader = StealReader::open(None).expect("/proc is there");
        assert!(reader.read_ns().is_some());
    }
}
