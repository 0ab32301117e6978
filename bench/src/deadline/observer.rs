//! A client that sees every command come: the other end of release → command in the client's hands.
//!
//! It does what a driver of a robot would do: sleeps until shortly before a release, polls until the command
//! of that release is there, and sleeps again. With real time it goes before every load on its core, so that
//! what is measured is the daemon and not how the load shares a core with its client.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::{Context, Result, anyhow, ensure};
use cdcr_client::{CommandStream, Connection, Stream, TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::{LateCause, Mode, timing};
use cdcr_shared_types::{Incident, Location, Telemetry};

use super::tally::{COMMAND, Tally};
use crate::interrupt;
use crate::subject::Cycle;
use crate::subject::place::ROBOT;
use crate::system::thread::{WATCHER_PRIORITY, pin, set_fifo, sleep_until};

/// How long before a release it wakes up \[ns\]: about what a late wake-up takes. A quarter of shorter periods.
const EARLY_NS: u64 = 100_000;
/// How long the incidents of the last cycles may take to arrive.
const INCIDENTS_WAIT: Duration = Duration::from_millis(300);
/// How long a daemon may be silent before the observation is given up \[ns\].
const SILENCE_NS: u64 = 2_000_000_000;

#[derive(Debug)]
pub struct Observed {
    pub tally: Tally,
    /// Share of the cycles in which the robot followed its reference.
    pub tracking_share: f64,
    pub budget_hits: u64,
}

/// An observation that runs in a thread of its own.
#[derive(Debug)]
pub struct Observer {
    /// From when on cycles count \[ns\]; `u64::MAX`: not yet.
    begin_ns: Arc<AtomicU64>,
    ending: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<Observed>>>,
}

impl Observer {
    /// Watches the daemon at `location` from `core`; with `realtime` before all ordinary tasks.
    pub fn start(location: &Location, core: usize, realtime: bool) -> Result<Self> {
        let begin_ns = Arc::new(AtomicU64::new(u64::MAX));
        let ending = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new()
            .name("observe".to_owned())
            .spawn({
                let (location, begin_ns, ending) =
                    (location.clone(), Arc::clone(&begin_ns), Arc::clone(&ending));
                move || {
                    if realtime {
                        set_fifo(WATCHER_PRIORITY);
                    }
                    pin(core);
                    Watch::open(&location)?.run(&begin_ns, &ending)
                }
            })?;
        Ok(Self {
            begin_ns,
            ending,
            thread: Some(thread),
        })
    }

    pub fn begin(&self) {
        self.begin_ns.store(monotonic_ns(), Ordering::Relaxed);
    }

    /// Whether it ended by itself, which is a failure.
    pub fn has_ended(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    pub fn finish(mut self) -> Result<Observed> {
        self.ending.store(true, Ordering::Relaxed);
        let thread = self.thread.take().context("it was finished before")?;
        let result = thread.join();
        result
            .map_err(|_| anyhow!("the observer panicked"))?
            .context("the observer")
    }
}

impl Drop for Observer {
    fn drop(&mut self) {
        self.ending.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The ports of the observer, and what came through them.
struct Watch {
    origin_ns: u64,
    period_ns: u64,
    commands: CommandStream,
    telemetry: TelemetryStream,
    incidents: Stream<Incident>,
    /// When the command of a cycle came \[ns\].
    arrivals: HashMap<u64, u64>,
    records: Vec<Record>,
    /// What the daemon found out later about a bad cycle.
    causes: HashMap<u64, LateCause>,
    last_record_ns: u64,
    _connection: Connection,
}

#[derive(Debug, Clone, Copy)]
struct Record {
    number: u64,
    cycle: Cycle,
    tracking: bool,
    budget_spent: bool,
}

impl Record {
    fn of(telemetry: &Telemetry) -> Self {
        let has = |flag: u32| telemetry.timing_flags & flag != 0;
        let cause = LateCause::try_from(telemetry.scheduling.late_cause);
        Self {
            number: telemetry.cycle,
            cycle: Cycle {
                due_ns: telemetry.due_ns,
                wake_ns: telemetry.start_ns.saturating_sub(telemetry.due_ns),
                response_ns: telemetry.handed_over_ns.saturating_sub(telemetry.due_ns),
                late_start: has(timing::LATE_START),
                deadline_miss: has(timing::DEADLINE_MISS),
                skipped_periods: telemetry.skipped_periods,
                cause: cause.unwrap_or(LateCause::None),
                run_delay_ns: telemetry.scheduling.run_delay_ns,
            },
            tracking: telemetry.mode == Mode::Tracking.code(),
            budget_spent: telemetry.report.budget_spent != 0,
        }
    }
}

impl Watch {
    fn open(location: &Location) -> Result<Self> {
        let connection = Connection::open_within(location, ROBOT, Duration::from_secs(5))?;
        let status = connection.status(Duration::from_secs(1))?;
        Ok(Self {
            origin_ns: status.origin_ns,
            period_ns: status.period_ns,
            commands: connection.commands()?,
            telemetry: connection.telemetry()?,
            incidents: connection.incidents()?,
            arrivals: HashMap::new(),
            records: Vec::new(),
            causes: HashMap::new(),
            last_record_ns: monotonic_ns(),
            _connection: connection,
        })
    }

    fn run(mut self, begin_ns: &AtomicU64, ending: &AtomicBool) -> Result<Observed> {
        let early_ns = EARLY_NS.min(self.period_ns / 4);
        let mut lost_before = None;
        while !ending.load(Ordering::Relaxed) {
            interrupt::check()?;
            let begin_ns = begin_ns.load(Ordering::Relaxed);
            let wanted = (monotonic_ns() + early_ns - self.origin_ns) / self.period_ns + 1;
            let release_ns = self.origin_ns + wanted * self.period_ns;
            sleep_until(release_ns - early_ns);
            self.catch(wanted, release_ns + self.period_ns - 2 * early_ns)?;
            self.drain(begin_ns)?;
            if lost_before.is_none() && begin_ns != u64::MAX {
                lost_before = Some(self.telemetry.lost());
            }
            let silent_ns = monotonic_ns().saturating_sub(self.last_record_ns);
            ensure!(
                silent_ns < SILENCE_NS,
                "the daemon has sent no record for {} s",
                silent_ns / 1_000_000_000
            );
        }
        self.judge_again()?;
        let lost = self.telemetry.lost() - lost_before.unwrap_or_default();
        self.observed(lost)
    }

    /// Polls until the command of cycle `wanted`, or a later one, is there, or it is time for the next.
    fn catch(&mut self, wanted: u64, give_up_ns: u64) -> Result<()> {
        loop {
            let command = self.commands.try_next()?;
            let now_ns = monotonic_ns();
            if let Some(command) = command {
                self.arrivals.insert(command.cycle, now_ns);
                if command.cycle >= wanted {
                    return Ok(());
                }
            } else if now_ns >= give_up_ns {
                return Ok(());
            } else {
                std::hint::spin_loop();
            }
        }
    }

    /// Takes the records that wait, and keeps those of releases after `begin_ns`.
    fn drain(&mut self, begin_ns: u64) -> Result<()> {
        while let Some(telemetry) = self.telemetry.try_next()? {
            self.last_record_ns = monotonic_ns();
            if telemetry.due_ns >= begin_ns {
                self.records.push(Record::of(&telemetry));
            } else {
                self.arrivals.remove(&telemetry.cycle);
            }
        }
        self.take_incidents()
    }

    /// The incidents know more than the records: what the hypervisor took from the core.
    fn take_incidents(&mut self) -> Result<()> {
        while let Some(incident) = self.incidents.try_next()? {
            if let Ok(cause) = LateCause::try_from(incident.telemetry.scheduling.late_cause) {
                self.causes.insert(incident.telemetry.cycle, cause);
            }
        }
        Ok(())
    }

    /// The last incidents may still be on their way.
    fn judge_again(&mut self) -> Result<()> {
        std::thread::sleep(INCIDENTS_WAIT);
        self.take_incidents()?;
        for record in &mut self.records {
            if let Some(cause) = self.causes.get(&record.number) {
                record.cycle.cause = *cause;
            }
        }
        Ok(())
    }

    fn observed(&self, lost: u64) -> Result<Observed> {
        let cycles: Vec<Cycle> = self.records.iter().map(|record| record.cycle).collect();
        let mut tally = Tally::of(&cycles, true)?;
        tally.counts.lost_records = lost;
        for record in &self.records {
            match self.arrivals.get(&record.number) {
                Some(arrival_ns) => {
                    let command_ns = arrival_ns.saturating_sub(record.cycle.due_ns);
                    tally.times[COMMAND].saturating_record(command_ns);
                }
                None => tally.counts.lost_commands += 1,
            }
        }
        let count = |is: fn(&Record) -> bool| self.records.iter().filter(|r| is(r)).count() as u64;
        let tracking = count(|record| record.tracking);
        Ok(Observed {
            tracking_share: tracking as f64 / self.records.len().max(1) as f64,
            budget_hits: count(|record| record.budget_spent),
            tally,
        })
    }
}
