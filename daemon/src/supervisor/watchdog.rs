use std::time::{Duration, Instant};

use crate::exit::{Ended, ExitCause};

/// Detects a thread that makes no progress.
///
/// Only time in which the supervisor itself ran is counted, so a process (or machine) that was stopped and
/// continues is not taken for a hung thread.
#[derive(Debug)]
pub(super) struct Watchdog {
    timeout: Duration,
    checked_at: Instant,
    threads: [Watched; 4],
}

#[derive(Debug, Clone, Copy, Default)]
struct Watched {
    beats: u64,
    still: Duration,
}

/// The reporter may stall for this multiple of the timeout: it sometimes waits for files, and no robot
/// depends on it.
const REPORTER_TIMES: u32 = 5;
/// The same for the status thread: no other thread's end depends on it.
const STATUS_TIMES: u32 = 20;

/// Of the time between two checks, at most this much is counted.
const COUNTED_MAX: Duration = Duration::from_millis(100);

impl Watchdog {
    /// A watchdog that expires after `timeout`.
    pub(super) fn new(timeout: Duration, now: Instant) -> Self {
        Self {
            timeout,
            checked_at: now,
            threads: [Watched::default(); 4],
        }
    }

    /// Checks the heartbeats of cycle, exchange, reporter and status.
    ///
    /// # Errors
    ///
    /// A thread has had no heartbeat for the timeout.
    pub(super) fn check(&mut self, beats: [u64; 4], now: Instant) -> Result<(), Ended> {
        let passed = now.duration_since(self.checked_at).min(COUNTED_MAX);
        self.checked_at = now;
        for (thread, beats) in self.threads.iter_mut().zip(beats) {
            thread.still = if thread.beats == beats {
                thread.still + passed
            } else {
                Duration::ZERO
            };
            thread.beats = beats;
        }
        // A cycle that hangs on the core may starve the exchange, so it is named first.
        let watched = [
            (ExitCause::CycleHung, "cycle", 1),
            (ExitCause::ExchangeHung, "exchange", 1),
            (ExitCause::ExchangeHung, "reporter", REPORTER_TIMES),
            (ExitCause::ExchangeHung, "status", STATUS_TIMES),
        ];
        let hung = watched
            .into_iter()
            .zip(&self.threads)
            .find(|((_, _, times), thread)| thread.still >= self.timeout * *times);
        let Some(((cause, name, times), _)) = hung else {
            return Ok(());
        };
        Err(Ended {
            cause,
            message: format!(
                "the {name} thread made no progress for {} ms ({}cycle.watchdog_ms); the process ends, and the robot \
                 holds when its last command expires (link.command_valid_ms)",
                (self.timeout * times).as_millis(),
                if times == 1 {
                    String::new()
                } else {
                    format!("{times} times ")
                }
            ),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn after(looks: u32, every: Duration, beats: impl Fn(u64) -> [u64; 4]) -> Option<ExitCause> {
        let mut now = Instant::now();
        let mut watchdog = Watchdog::new(200 * MS, now);
        for look in 0..looks {
            now += every;
            if let Err(ended) = watchdog.check(beats(u64::from(look)), now) {
                return Some(ended.cause);
            }
        }
        None
    }

    #[test]
    fn the_thread_that_stands_still_is_named() {
        assert_eq!(after(100, 20 * MS, |look| [look; 4]), None);
        let cause = after(100, 20 * MS, |look| [7, look, look, look]);
        assert_eq!(cause, Some(ExitCause::CycleHung));
        let cause = after(100, 20 * MS, |look| [look, 7, look, look]);
        assert_eq!(cause, Some(ExitCause::ExchangeHung));
        assert_eq!(after(100, 20 * MS, |_| [0; 4]), Some(ExitCause::CycleHung));
        // An occasional heartbeat is progress.
        assert_eq!(
            after(100, 20 * MS, |look| [look / 5, look, look, look]),
            None
        );
    }

    #[test]
    fn a_reporter_that_waits_for_files_has_five_times_as_long() {
        assert_eq!(after(50, 20 * MS, |look| [look, look, 7, look]), None);
        let cause = after(51, 20 * MS, |look| [look, look, 7, look]);
        assert_eq!(cause, Some(ExitCause::ExchangeHung));
    }

    #[test]
    fn the_thread_of_the_status_has_twenty_times_as_long() {
        assert_eq!(after(200, 20 * MS, |look| [look, look, look, 7]), None);
        let cause = after(201, 20 * MS, |look| [look, look, look, 7]);
        assert_eq!(cause, Some(ExitCause::ExchangeHung));
    }

    #[test]
    fn it_bites_at_the_first_look_at_which_the_timeout_has_been_counted() {
        // No heartbeat from the first check on, with a timeout of 200 ms. Of longer times between two checks
        // 100 ms are counted.
        for (every_ms, looks) in [(1, 201), (20, 11), (70, 4), (100, 3), (5000, 3)] {
            let begun = |look| [look + 1, 7, look, look];
            assert_eq!(after(looks - 1, every_ms * MS, begun), None, "{every_ms}");
            let cause = after(looks, every_ms * MS, begun);
            assert_eq!(cause, Some(ExitCause::ExchangeHung), "{every_ms}");
        }
    }

    #[test]
    fn a_long_time_between_two_looks_is_not_the_threads_fault() {
        let hour = Duration::from_secs(3600);
        assert_eq!(after(1, hour, |_| [0; 4]), None);
        assert_eq!(after(2, hour, |_| [0; 4]), Some(ExitCause::CycleHung));
    }
}
