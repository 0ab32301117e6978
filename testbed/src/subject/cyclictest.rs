//! cyclictest of rt-tests, the common tool for wake-up latencies.

use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use hdrhistogram::Histogram;
use rustix::thread::{CpuSet, sched_getaffinity};

use cdcr_process::{Process, on_path, that_ends_with_us};

use crate::quantiles::histogram;
use crate::system::cores::with_affinity;

/// Allowance for start, end and a slow machine, beyond the duration.
const TIMEOUT: Duration = Duration::from_secs(30);
/// Extra run time. The main thread of cyclictest prints, then checks for the end, so cycles in between are
/// never printed. The extra cycles replace them, even when the main thread is delayed there.
const SPARE: Duration = Duration::from_millis(100);

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cyclictest {
    program: PathBuf,
}

impl Cyclictest {
    /// Finds the program in `PATH`.
    pub fn find() -> Option<Self> {
        let program = on_path("cyclictest")?;
        Some(Self { program })
    }

    /// Starts one thread on `core` with `cycles` releases, one every `period`, with `SCHED_FIFO` at
    /// `priority` if there is one. Memory is locked; the thread sleeps with absolute `clock_nanosleep`. Call
    /// it from a thread that outlives the process.
    ///
    /// For a user without the right to real-time threads, cyclictest refuses to run, even without a priority.
    pub fn start(
        &self,
        period: Duration,
        priority: Option<u8>,
        core: usize,
        cycles: u64,
    ) -> Result<RunningCyclictest> {
        let nanoseconds = period.as_nanos();
        ensure!(
            nanoseconds > 0 && nanoseconds.is_multiple_of(1000),
            "cyclictest knows whole microseconds only, not a period of {nanoseconds} ns"
        );
        let spare_cycles = 1 + SPARE.as_nanos().div_ceil(nanoseconds) as u64;
        let mut command = that_ends_with_us(&self.program);
        command.args(arguments(period, priority, core, cycles + spare_cycles));
        let process = with_core(core, || {
            if let Some(other) = another(core) {
                command.arg(format!("--mainaffinity={other}"));
            }
            Process::start("cyclictest", command)
        })?;
        Ok(RunningCyclictest {
            process,
            period,
            cycles,
        })
    }
}

/// One thread (`-t 1`), every latency (`-v`) in nanoseconds (`-N`).
fn arguments(period: Duration, priority: Option<u8>, core: usize, cycles: u64) -> Vec<String> {
    let mut arguments = vec![
        "-t1".to_owned(),
        format!("-a{core}"),
        format!("-i{}", period.as_micros()),
        format!("-l{cycles}"),
        "-m".to_owned(),
        "-v".to_owned(),
        "-N".to_owned(),
    ];
    arguments.push(match priority {
        Some(priority) => format!("-p{priority}"),
        None => "--policy=other".to_owned(),
    });
    arguments
}

/// Another core that this thread may use, for the printing thread of cyclictest.
fn another(core: usize) -> Option<usize> {
    let ids = core_affinity::get_core_ids()?;
    ids.iter().map(|id| id.id).find(|id| *id != core)
}

/// Calls `start` with `core` added to the affinity: cyclictest uses only the cores that it inherits.
fn with_core<R>(core: usize, start: impl FnOnce() -> R) -> R {
    let mut allowed = sched_getaffinity(None).unwrap_or_else(|_| CpuSet::new());
    allowed.set(core);
    with_affinity(&allowed, start)
}

#[derive(Debug)]
pub struct RunningCyclictest {
    process: Process,
    period: Duration,
    cycles: u64,
}

impl RunningCyclictest {
    pub fn wait(mut self) -> Result<Latencies> {
        let duration_s = self.period.as_secs_f64() * self.cycles as f64;
        let limit = Duration::from_secs_f64(2.0 * duration_s) + TIMEOUT;
        let printed = self.process.wait(limit, crate::interrupt::check)?;
        let mut each_ns = latencies_in(&printed)
            .with_context(|| format!("what cyclictest printed{}", self.process.output_tail()))?;
        let (made, asked) = (each_ns.len(), self.cycles);
        ensure!(
            made as u64 >= asked,
            "cyclictest reported {made} cycles of the {asked} requested{}",
            self.process.output_tail()
        );
        each_ns.truncate(asked as usize);
        Ok(Latencies::from_times(each_ns, self.period))
    }
}

impl Drop for RunningCyclictest {
    fn drop(&mut self) {
        // cyclictest removes this file itself unless it is killed.
        let _ = self.process.end();
        let _ = fs::remove_file(format!("/dev/shm/cyclictest{}", self.process.id()));
    }
}

#[derive(Debug, Clone)]
pub struct Latencies {
    pub histogram_ns: Histogram<u64>,
    pub each_ns: Vec<u64>,
    pub cycles: u64,
    /// Releases without a cycle: after a late wake-up, cyclictest sleeps until the next future release, as
    /// the daemon does.
    pub skipped_periods: u64,
    period: Duration,
}

impl Latencies {
    fn from_times(each_ns: Vec<u64>, period: Duration) -> Self {
        let mut histogram_ns = histogram();
        let period_ns = (period.as_nanos() as u64).max(1);
        for latency_ns in &each_ns {
            histogram_ns.saturating_record(*latency_ns);
        }
        Self {
            histogram_ns,
            cycles: each_ns.len() as u64,
            // Number of whole periods by which a wake-up missed its release.
            skipped_periods: each_ns
                .iter()
                .map(|latency_ns| latency_ns / period_ns)
                .sum(),
            each_ns,
            period,
        }
    }

    /// Removes the warm-up cycles at the beginning, which cyclictest cannot exclude itself.
    pub fn without_first(mut self, cycles: u64) -> Result<Self> {
        ensure!(
            cycles < self.cycles,
            "a warm-up of {cycles} cycles leaves none of the {} cycles of cyclictest",
            self.cycles
        );
        Ok(Self::from_times(
            self.each_ns.split_off(cycles as usize),
            self.period,
        ))
    }

    /// Number of cycles with a larger latency.
    pub fn later_than(&self, limit_ns: u64) -> u64 {
        let late = self
            .each_ns
            .iter()
            .filter(|latency_ns| **latency_ns > limit_ns);
        late.count() as u64
    }
}

/// Parses the lines `thread: cycle: latency` in the output of `-v`. A wrong cycle number shows that the
/// output has another format.
fn latencies_in(printed: &str) -> Result<Vec<u64>> {
    let mut each_ns = Vec::new();
    for line in printed.lines() {
        let Some((cycle, latency_ns)) = latency(line) else {
            continue;
        };
        let expected = each_ns.len() as u64;
        ensure!(
            cycle == expected,
            "cycle {cycle} follows where cycle {expected} should"
        );
        each_ns.push(latency_ns);
    }
    Ok(each_ns)
}

fn latency(line: &str) -> Option<(u64, u64)> {
    let mut numbers = line.split(':').map(|number| number.trim().parse::<u64>());
    let (thread, cycle, latency_ns) = (numbers.next()?, numbers.next()?, numbers.next()?);
    match (thread, cycle, latency_ns, numbers.next()) {
        (Ok(0), Ok(cycle), Ok(latency_ns), None) => Some((cycle, latency_ns)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use cdcr_test_skip::{Need, skip};

    use super::*;
    use crate::system::cores::Cores;
    use crate::system::thread::may_be_realtime;

    const PERIOD: Duration = Duration::from_millis(1);
    const REPORTED: &str = "Using 1 cpus.\nMax CPUs = 2\nThread 0 using cpu 1.\nThread 0 Interval: 1500\n\
                        # /dev/cpu_dma_latency set to 0us\n\
                        \u{20}      0:       0:   85045\n       0:       1: 3081684\n\
                        \u{20}      0:       2:   36681\n";

    fn usable() -> Option<Cyclictest> {
        if !may_be_realtime() {
            skip(Need::Realtime, "cyclictest refuses to run without");
            return None;
        }
        let found = Cyclictest::find();
        if found.is_none() {
            skip(Need::Cyclictest, "it is not installed");
        }
        found
    }

    #[test]
    fn every_cycle_is_read_and_the_periods_that_it_slept_through_are_counted() {
        assert_eq!(latencies_in(REPORTED).unwrap(), [85_045, 3_081_684, 36_681]);
        let all = Latencies::from_times(latencies_in(REPORTED).unwrap(), PERIOD);
        assert_eq!((all.cycles, all.skipped_periods), (3, 3));
        assert_eq!((all.histogram_ns.len(), all.later_than(85_045)), (3, 1));
        let warm = all.clone().without_first(2).unwrap();
        assert_eq!(warm.each_ns, [36_681]);
        assert_eq!((warm.skipped_periods, warm.histogram_ns.len()), (0, 1));
        assert!(all.without_first(3).is_err());
    }

    #[test]
    fn a_hole_in_the_cycles_is_an_error() {
        let error = latencies_in("0: 0: 5\n0: 2: 6\n").unwrap_err().to_string();
        assert!(
            error.contains("cycle 2 follows where cycle 1 should"),
            "{error}"
        );
    }

    #[test]
    fn the_real_one_reports_every_cycle() {
        let Some(cyclictest) = usable() else {
            return;
        };
        let cores = Cores::find().unwrap();
        for priority in [Some(80), None] {
            // From a thread that excludes the core, as in a measurement.
            cores.stay_off();
            let running = cyclictest
                .start(PERIOD, priority, cores.realtime, 200)
                .unwrap();
            let (id, folder) = (running.process.id(), running.process.folder().to_owned());
            let latencies = running.wait().unwrap();
            assert_eq!((latencies.cycles, latencies.histogram_ns.len()), (200, 200));
            assert!(latencies.histogram_ns.min() > 0);
            let memory = PathBuf::from(format!("/dev/shm/cyclictest{id}"));
            assert!(!memory.exists() && !folder.exists());
        }
    }

    #[test]
    fn a_period_that_it_cannot_keep_is_refused() {
        let cyclictest = Cyclictest {
            program: PathBuf::from("cyclictest"),
        };
        let error = cyclictest
            .start(Duration::from_nanos(1500), None, 0, 1)
            .unwrap_err();
        assert!(error.to_string().contains("1500 ns"), "{error}");
    }
}
