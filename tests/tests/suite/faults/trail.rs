//! The consecutive records of a daemon, each with the previous one.

use std::cell::Cell;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard, TryLockError};
use std::time::{Duration, Instant};

use cdcr_client::{Connection, TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::Mode;
use cdcr_shared_types::{Service, Telemetry};
use cdcr_tests::TIMEOUT;
use cdcr_tests::record::largest;

use crate::chaos::integral::Integral;
use crate::chaos::ramp;
use crate::faults::history::History;

/// The core of all the daemons: shared by readers, or taken by one test.
static CORE: RwLock<()> = RwLock::new(());

thread_local! {
    /// How often trails of this thread began anew, because the machine kept the thread from reading.
    static GAPS: Cell<u32> = const { Cell::new(0) };
}

/// Runs a test; `None` if it failed and its trail had begun anew.
pub(crate) fn unless_kept<R>(test: impl FnOnce() -> Option<R>) -> Option<R> {
    let gap_count = GAPS.get();
    catch_unwind(AssertUnwindSafe(test)).unwrap_or_else(|failure| {
        if GAPS.get() == gap_count {
            resume_unwind(failure);
        }
        None
    })
}

/// Waits until no other test follows a trail, and keeps them out. Never queues for the lock, because a test
/// may follow two trails.
pub(crate) fn alone() -> RwLockWriteGuard<'static, ()> {
    let begin = Instant::now();
    loop {
        match CORE.try_write() {
            Ok(guard) => return guard,
            Err(TryLockError::Poisoned(guard)) => return guard.into_inner(),
            Err(TryLockError::WouldBlock) => {}
        }
        assert!(begin.elapsed() < 5 * TIMEOUT, "the core is never free");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// A reader that fails when it loses a record, unless the machine keeps the reader for longer than its queue
/// lasts while the daemon, in its own class and locked memory, goes on. It checks on each record that a robot
/// at rest stays, and that the commanded position is the integral of the rates. While it exists, no other test
/// takes the daemon's core.
pub(crate) struct Trail {
    stream: TelemetryStream,
    /// Read, but not yet returned, with the time of reading; oldest first.
    read: VecDeque<(u64, Telemetry)>,
    before: Option<Telemetry>,
    integral: Integral,
    history: History,
    _calm: Option<RwLockReadGuard<'static, ()>>,
}

/// Whether newer records had filled the queue when this one was read: its reader came too late.
fn waited_a_queue(record: &Telemetry, read_ns: u64) -> bool {
    let queue = Service::Telemetry.queues().queue as u64;
    let waited_ns = read_ns.saturating_sub(record.release_ns);
    waited_ns / record.period_ns + 2 > queue
}

impl Trail {
    pub(crate) fn new(connection: &Connection) -> Self {
        let calm = CORE.read().unwrap_or_else(PoisonError::into_inner);
        Self {
            _calm: Some(calm),
            ..Self::new_alone(connection)
        }
    }

    /// For a test that holds [`alone`].
    pub(crate) fn new_alone(connection: &Connection) -> Self {
        Self {
            stream: connection.telemetry().unwrap(),
            read: VecDeque::new(),
            before: None,
            integral: Integral::new(connection.status(TIMEOUT).unwrap().link),
            history: History::default(),
            _calm: None,
        }
    }

    pub(crate) fn next_waiting(&mut self) -> Option<Telemetry> {
        let (read_ns, record) = match self.read.pop_front() {
            Some(read) => read,
            None => self.read()?,
        };
        if let Some(before) = &self.before {
            let expected = before.cycle + 1 + u64::from(record.skipped_periods);
            if record.cycle == expected {
                ramp::check_rest(before, &record).unwrap();
            } else {
                assert!(waited_a_queue(&record, read_ns), "a record was lost");
                println!(
                    "the machine kept the reader from {expected} to {}",
                    record.cycle
                );
                self.before = None;
                GAPS.set(GAPS.get() + 1);
            }
        }
        ramp::check(&record, record.period_ns as f64 * 1e-9).unwrap();
        self.integral.check(self.before.as_ref(), &record).unwrap();
        self.history.note(&record);
        self.before = Some(record);
        Some(record)
    }

    fn read(&mut self) -> Option<(u64, Telemetry)> {
        let record = self.stream.try_next().unwrap()?;
        Some((monotonic_ns(), record))
    }

    /// Keeps all records during `work`, which may last longer than a reader's queue.
    pub(crate) fn keep_while<R: Send>(&mut self, work: impl FnOnce() -> R + Send) -> R {
        std::thread::scope(|scope| {
            let working = scope.spawn(work);
            while !working.is_finished() {
                while let Some(read) = self.read() {
                    self.read.push_back(read);
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            working.join().unwrap_or_else(|panic| resume_unwind(panic))
        })
    }

    /// Lateness in the records so far.
    pub(crate) fn history(&self) -> &History {
        &self.history
    }

    /// The first record that satisfies `is_it`, and the previous one. Calls `meanwhile` repeatedly until
    /// then, at least every other millisecond.
    pub(crate) fn until_while(
        &mut self,
        what: &str,
        mut meanwhile: impl FnMut(),
        mut is_it: impl FnMut(&Telemetry) -> bool,
    ) -> (Telemetry, Telemetry) {
        let begin = Instant::now();
        loop {
            meanwhile();
            let before = self.before;
            match self.next_waiting() {
                Some(record) if is_it(&record) => {
                    let next =
                        |before: &Telemetry| before.cycle + 1 + u64::from(record.skipped_periods);
                    let before = before.filter(|before| next(before) == record.cycle);
                    return (before.unwrap_or(record), record);
                }
                Some(_) => {}
                None => std::thread::sleep(Duration::from_millis(1)),
            }
            assert!(
                begin.elapsed() < TIMEOUT,
                "{what} never came; the last record is of cycle {:?} in mode {:?}",
                self.before.map(|record| record.cycle),
                self.before.map(|record| Mode::text_of(record.mode)),
            );
        }
    }

    /// Sends a message, and returns the daemon's answer to it with its record. Sends it again if the record of
    /// the answer may be among lost ones.
    pub(crate) fn until_answered<M, A>(
        &mut self,
        mut send: impl FnMut() -> M,
        answer_in: impl Fn(&M, &Telemetry) -> Option<A>,
    ) -> (Telemetry, A) {
        let begin = Instant::now();
        loop {
            let (sent, gap_count) = (send(), GAPS.get());
            while GAPS.get() == gap_count {
                if let Some(record) = self.next_waiting() {
                    if let Some(answer) = answer_in(&sent, &record) {
                        return (record, answer);
                    }
                } else {
                    std::thread::sleep(Duration::from_millis(1));
                }
                assert!(begin.elapsed() < TIMEOUT, "no answer");
            }
        }
    }

    /// As [`until_while`](Self::until_while), without other work.
    pub(crate) fn until(
        &mut self,
        what: &str,
        is_it: impl FnMut(&Telemetry) -> bool,
    ) -> (Telemetry, Telemetry) {
        self.until_while(what, || {}, is_it)
    }

    /// Discards pending records, so that the next one is new.
    pub(crate) fn catch_up(&mut self) {
        while self.next_waiting().is_some() {}
    }
}

pub(crate) fn is(mode: Mode) -> impl FnMut(&Telemetry) -> bool {
    move |record| record.mode == mode.code()
}

/// Whether the command of this cycle is zero.
pub(crate) fn rests(record: &Telemetry) -> bool {
    largest(&record.command.bend_rate_rad_s) == 0.0
}

/// Lateness of the cycle by its own record \[ns\]: skipped periods before it, and its start after its
/// release.
pub(crate) fn late_ns(record: &Telemetry) -> u64 {
    u64::from(record.skipped_periods) * record.period_ns + record.start_ns - record.release_ns
}

/// Follows the robot to rest, which comes within the cycles of the ramp; the trail checks the rates of each.
/// `first` is the record of the first such cycle.
pub(crate) fn assert_ramps_to_rest(
    trail: &mut Trail,
    first: &Telemetry,
    mut meanwhile: impl FnMut(),
) {
    let step = first.deceleration_rad_s2 * first.period_ns as f64 * 1e-9;
    let begin = largest(&first.previous_rate_rad_s);
    let cycles_max = (begin / step).ceil() as u64 + 1;
    let mut record = *first;
    for cycles in 1.. {
        if rests(&record) {
            println!("  from {begin:.4} rad/s to rest in {cycles} cycles");
            return;
        }
        assert!(cycles < cycles_max, "{cycles} cycles and no rest");
        (_, record) = trail.until_while("the next record", &mut meanwhile, |_| true);
    }
}

/// Prints a measured time and its bound.
pub(crate) fn say(fault: &str, detected_ns: u64, bound_ns: u64) {
    println!(
        "{fault}: detected after {:.3} ms, at most {:.3} ms",
        detected_ns as f64 * 1e-6,
        bound_ns as f64 * 1e-6
    );
}
