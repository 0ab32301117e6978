//! Statistics of the scheduler for one thread, read by another: `/proc/self/task/<id>/{schedstat,stat}`.

use std::fs::File;
use std::os::unix::fs::FileExt;

use cdcr_shared_types::proc_stat::page_faults;

use super::attribution::{SchedulerCounts, Scheduling};

/// Reads the counts of one thread from files that stay open, without allocation. `schedstat` is fast; for
/// `stat` the kernel formats fifty numbers: 20 µs with cold caches.
#[derive(Debug)]
pub struct SchedulerReader {
    schedstat: File,
    stat: File,
}

impl SchedulerReader {
    /// A reader for the thread `id` of this process. `None` if the kernel does not count
    /// (`CONFIG_SCHED_INFO`), or `/proc` is missing.
    pub fn open(id: u32) -> Option<Self> {
        let open = |name: &str| File::open(format!("/proc/self/task/{id}/{name}")).ok();
        let reader = Self {
            schedstat: open("schedstat")?,
            stat: open("stat")?,
        };
        reader.read().map(|_| reader)
    }

    /// The present counts. `None` if the thread has ended.
    pub fn read(&self) -> Option<SchedulerCounts> {
        self.read_with(self.page_faults()?)
    }

    /// The present counts with a known number of page faults.
    fn read_with(&self, page_faults: u64) -> Option<SchedulerCounts> {
        let mut text = [0; 128];
        let length = self.schedstat.read_at(&mut text, 0).ok()?;
        let [on_core_ns, run_delay_ns, turns] = schedstat(&text[..length])?;
        Some(SchedulerCounts {
            on_core_ns,
            run_delay_ns,
            turns,
            page_faults,
        })
    }

    fn page_faults(&self) -> Option<u64> {
        let mut text = [0; 1024];
        let length = self.stat.read_at(&mut text, 0).ok()?;
        page_faults(&text[..length])
    }
}

/// Differences of one thread's scheduler statistics between readings.
#[derive(Debug, Default)]
pub struct SchedulerDeltas {
    reader: Option<SchedulerReader>,
    before: Option<SchedulerCounts>,
}

impl SchedulerDeltas {
    /// Reads the thread `id` of this process; with `None`, every reading is `None`.
    pub fn new(id: Option<u32>) -> Self {
        Self {
            reader: id.and_then(SchedulerReader::open),
            before: None,
        }
    }

    /// Statistics since the previous reading. `None` at the first one, and if the kernel does not provide
    /// them.
    pub fn read(&mut self) -> Option<Scheduling> {
        let counts = self.reader.as_ref()?.read()?;
        self.since_before(counts)
    }

    /// Same as [`read`](Self::read) without page faults, which the next complete reading includes.
    pub fn read_without_page_faults(&mut self) -> Option<Scheduling> {
        let Some(before) = self.before else {
            return self.read();
        };
        let counts = self.reader.as_ref()?.read_with(before.page_faults)?;
        self.since_before(counts)
    }

    fn since_before(&mut self, counts: SchedulerCounts) -> Option<Scheduling> {
        let before = self.before.replace(counts)?;
        Some(counts.since(&before))
    }
}

pub fn this_thread() -> u32 {
    rustix::thread::gettid()
        .as_raw_nonzero()
        .get()
        .unsigned_abs()
}

/// Core time, run delay and number of turns: the three numbers of `schedstat`
/// (<https://docs.kernel.org/scheduler/sched-stats.html>).
fn schedstat(text: &[u8]) -> Option<[u64; 3]> {
    let mut numbers = core::str::from_utf8(text).ok()?.split_ascii_whitespace();
    let mut next = || numbers.next()?.parse().ok();
    Some([next()?, next()?, next()?])
}

#[cfg(test)]
mod tests {
    use cdcr_test_skip::{Need, skip};

    use super::*;

    #[test]
    fn the_files_are_read_as_in_proc() {
        assert_eq!(schedstat(b"540966 7 3\n"), Some([540_966, 7, 3]));
        assert_eq!(schedstat(b"540966 7"), None);
    }

    #[test]
    fn the_first_look_has_none_before_it() {
        let mut deltas = SchedulerDeltas::new(Some(this_thread()));
        if deltas.reader.is_none() {
            skip(Need::Kernel, "it counts no time of threads (schedstat)");
            return;
        }
        assert_eq!(deltas.read(), None);
        assert!(deltas.read().is_some());
        let touched = std::hint::black_box(vec![1_u8; 1 << 26]);
        assert_eq!(
            deltas
                .read_without_page_faults()
                .map(|delta| delta.page_faults),
            Some(0)
        );
        let delta = deltas.read().expect("it has looked before");
        assert!(delta.page_faults > 0, "those of {} bytes", touched.len());
        assert_eq!(SchedulerDeltas::new(None).read(), None);
    }

    #[test]
    fn a_thread_that_works_is_seen_to_run() {
        let Some(reader) = SchedulerReader::open(this_thread()) else {
            skip(Need::Kernel, "it counts no time of threads (schedstat)");
            return;
        };
        let before = reader.read().expect("the thread lives");
        let begin = std::time::Instant::now();
        let mut sum = 0_u64;
        while begin.elapsed() < std::time::Duration::from_millis(30) {
            sum = std::hint::black_box(sum.wrapping_add(1));
        }
        // Leaving the core updates the counts.
        std::thread::sleep(std::time::Duration::from_millis(1));
        let ran = reader.read().expect("the thread lives").since(&before);
        assert!(ran.on_core_ns > 0, "{ran:?}");
    }
}
