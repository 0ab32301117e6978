//! A client that sees every command come: the other end of release → command in the client's hands.
//!
//! It does what a driver of a robot would do: sleeps until shortly before a release, polls until the command
//! of that release is there, and sleeps again. With real time it goes before every load on its core, so that
//! what is measured is the daemon and not how the load shares a core with its client.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::OnceLock;
use std::time::Duration;

use anyhow::{Result, ensure};
use cdcr_client::{CommandStream, Connection, Stream, TelemetryStream, monotonic_ns};
use cdcr_shared_types::codes::{LateCause, Mode, timing};
use cdcr_shared_types::{Incident, Location, Telemetry};

use super::tally::{COMMAND, Tally};
use crate::interrupt;
use crate::subject::Cycle;
use crate::subject::TIMEOUT;
use crate::subject::place::ROBOT;
use crate::system::thread::{WATCHER_PRIORITY, pin, set_fifo, sleep_until};

/// How long before a release it wakes up \[ns\]: about what a late wake-up takes. A quarter of shorter periods.
const EARLY_NS: u64 = 100_000;
/// How long the incidents of the last cycles may take to arrive.
const INCIDENTS_WAIT: Duration = Duration::from_millis(300);
/// How long a daemon may be silent before the observation is given up \[ns\].
const SILENCE_NS: u64 = 2_000_000_000;
/// How long it may take until it is known which releases count \[ns\]: a load has to start.
const BEGIN_NS: u64 = 120_000_000_000;

/// The releases that count \[ns\], once it is known when they begin.
pub(super) type Counted = OnceLock<Range<u64>>;

/// Watches the daemon at `location` from `core` until the end of those that count; with `realtime` before all ordinary tasks. To be
/// called on a thread of its own.
pub(super) fn observe(
    location: &Location,
    core: usize,
    realtime: bool,
    counted: &Counted,
) -> Result<Tally> {
    if realtime {
        set_fifo(WATCHER_PRIORITY);
    }
    pin(core);
    Watch::open(location)?.run(counted)
}

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
        let connection = Connection::open_within(location, ROBOT, TIMEOUT)?;
        let status = connection.status(TIMEOUT)?;
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

    fn run(mut self, counted: &Counted) -> Result<Tally> {
        let early_ns = EARLY_NS.min(self.period_ns / 4);
        let (mut lost_before, opened_ns) = (None, monotonic_ns());
        while counted
            .get()
            .is_none_or(|counted| monotonic_ns() < counted.end)
        {
            interrupt::check()?;
            let (begin_ns, end_ns) = counted
                .get()
                .map_or((u64::MAX, u64::MAX), |counted| (counted.start, counted.end));
            // Before the first of them is read: whoever is held up at the beginning loses those, too.
            if lost_before.is_none() && begin_ns != u64::MAX {
                lost_before = Some(self.telemetry.lost());
            }
            let wanted = (monotonic_ns() + early_ns - self.origin_ns) / self.period_ns + 1;
            let release_ns = self.origin_ns + wanted * self.period_ns;
            sleep_until(release_ns - early_ns);
            self.catch(wanted, release_ns + self.period_ns - 2 * early_ns)?;
            self.drain(begin_ns..end_ns)?;
            let idle_ns = monotonic_ns() - opened_ns;
            let has_begun = begin_ns != u64::MAX || idle_ns < BEGIN_NS;
            ensure!(
                has_begun,
                "the load did not start within {} s",
                BEGIN_NS / 1_000_000_000
            );
            let silent_ns = monotonic_ns().saturating_sub(self.last_record_ns);
            ensure!(
                silent_ns < SILENCE_NS,
                "the daemon has sent no record for {} s",
                silent_ns / 1_000_000_000
            );
        }
        // The last records and incidents may still be on their way: the daemon's reporter is late where the machine stalls.
        std::thread::sleep(INCIDENTS_WAIT);
        self.drain(counted.get().cloned().unwrap_or_default())?;
        let lost = self.telemetry.lost() - lost_before.unwrap_or_default();
        self.tally(lost)
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

    /// Takes the records that wait, and keeps those of the releases that count.
    fn drain(&mut self, counted: Range<u64>) -> Result<()> {
        while let Some(telemetry) = self.telemetry.try_next()? {
            self.last_record_ns = monotonic_ns();
            if counted.contains(&telemetry.due_ns) {
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

    fn tally(&self, lost_records: u64) -> Result<Tally> {
        let cycle = |record: &Record| Cycle {
            cause: *self
                .causes
                .get(&record.number)
                .unwrap_or(&record.cycle.cause),
            ..record.cycle
        };
        let cycles: Vec<Cycle> = self.records.iter().map(cycle).collect();
        let mut tally = Tally::of(&cycles, true)?;
        for record in &self.records {
            if let Some(arrival_ns) = self.arrivals.get(&record.number) {
                let command_ns = arrival_ns.saturating_sub(record.cycle.due_ns);
                tally.times[COMMAND].saturating_record(command_ns);
            }
        }
        let count = |is: fn(&Record) -> bool| self.records.iter().filter(|r| is(r)).count() as u64;
        let cycles = self.records.len() as u64;
        let counts = &mut tally.counts;
        counts.lost_records = Some(lost_records);
        counts.lost_commands = Some(cycles - tally.times[COMMAND].len());
        counts.budget_hits = Some(count(|record| record.budget_spent));
        counts.tracking_share = Some(count(|record| record.tracking) as f64 / cycles.max(1) as f64);
        Ok(tally)
    }
}
