//! Lock-free hand-over between the threads.
//!
//! ```text
//!  exchange ── CycleInputs (newest counts: triple buffer) ──► cycle
//!  exchange ── CycleRequest (every one: ring) ──────────────► cycle
//!  exchange ◄── CycleRecord (every one, the newest for sure: `record_ring`, drops counted) ── cycle
//!  reporter ◄── CycleReport (every one: ring, drops counted) ── exchange
//!  supervisor ◄── Summary (every one: ring, drops counted) ──── reporter
//!  supervisor ◄── Incident (bad cycles whole: ring, drops counted) reporter
//! ```

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use cdcr_controller::reference::ReferenceWindow;
use cdcr_controller::safety::{LeaseState, Refusal, Request};
use cdcr_shared_types::Incident;
use rtrb::{Consumer, Producer, RingBuffer};
use triple_buffer::{Input, Output, triple_buffer};

use crate::cycle::{CycleRecord, Settings};
use crate::obstacles::ObstacleSet;
use crate::ports::TimedMeasurement;
use crate::reporter::CycleReport;
use crate::rt::record_ring::{RecordReceiver, RecordSender, record_ring};
use crate::supervisor::Summary;

/// Everything that one gather found out, as one consistent whole.
#[derive(Debug, Clone)]
pub struct CycleInputs {
    /// Number of the gather; 0: there was none yet.
    pub gather: u64,
    /// Its time \[ns\].
    pub gather_ns: u64,
    /// The reference on the grid.
    pub window: ReferenceWindow,
    /// The reference lease.
    pub lease: LeaseState,
    /// Stops that were asked for so far. When it has grown, the cycle stops whatever else waits in the ring.
    pub stops: u64,
    /// Times that the machine slept (suspend to memory or disk) so far. When it has grown, the cycle stops.
    pub suspends: u64,
    /// The source of the obstacles is silent, and the configuration wants the robot to hold then.
    pub obstacle_source_silent: bool,
    /// The driver's newest measurement.
    pub measurement: Option<TimedMeasurement>,
    /// The obstacles, each at its own stamp.
    pub obstacles: ObstacleSet,
    /// What the exchange took of the core in a period, of late \[ns\].
    pub exchange_ns: u64,
    /// The settings in force, checked.
    pub settings: Settings,
    /// Grows with each change of the settings.
    pub settings_revision: u64,
}

impl CycleInputs {
    /// Before the first gather.
    pub fn new(settings: Settings) -> Self {
        Self {
            gather: 0,
            gather_ns: 0,
            window: ReferenceWindow::default(),
            lease: LeaseState::Free,
            stops: 0,
            suspends: 0,
            obstacle_source_silent: false,
            measurement: None,
            obstacles: ObstacleSet::default(),
            exchange_ns: 0,
            settings,
            settings_revision: 0,
        }
    }
}

/// A request on its way to the cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CycleRequest {
    /// Its ticket: the exchange finds the waiting client by it.
    pub ticket: u64,
    /// What is asked.
    pub request: Request,
}

/// What became of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CycleAnswer {
    /// Ticket of the request.
    pub ticket: u64,
    /// Taken, or why not.
    pub outcome: Result<(), Refusal>,
}

/// Requests that one cycle carries out; the rest waits for the next.
pub const REQUESTS_PER_CYCLE: usize = 4;
/// Requests that wait for a cycle. One that stops answers all of them.
pub const REQUESTS_WAITING: usize = 4 * REQUESTS_PER_CYCLE;
/// Records between cycle and exchange: 0.48 s at 5 ms.
const RECORDS: usize = 96;
/// Records between exchange and reporter: 0.64 s at 5 ms.
const REPORTS: usize = 128;
/// Summaries between reporter and supervisor: 5 s at 5 ms.
const SUMMARIES: usize = 1024;
/// Bad cycles between reporter and supervisor.
const INCIDENTS: usize = 16;

/// Ends of the cycle thread.
#[derive(Debug)]
pub struct CycleEnds {
    /// Newest inputs.
    pub inputs: Output<CycleInputs>,
    /// Requests.
    pub requests: Consumer<CycleRequest>,
    /// Records.
    pub records: RecordSender<CycleRecord>,
}

/// Ends of the exchange thread.
#[derive(Debug)]
pub struct ExchangeEnds {
    /// Newest inputs.
    pub inputs: Input<CycleInputs>,
    /// Requests.
    pub requests: Producer<CycleRequest>,
    /// Records.
    pub records: RecordReceiver<CycleRecord>,
    /// Records with what belongs to them.
    pub reports: Producer<CycleReport>,
}

/// Ends of the reporter thread.
#[derive(Debug)]
pub struct ReporterEnds {
    /// Records with what belongs to them.
    pub reports: Consumer<CycleReport>,
    /// Summaries.
    pub summaries: Producer<Summary>,
    /// Bad cycles.
    pub incidents: Producer<Incident>,
}

/// Ends of the supervisor.
#[derive(Debug)]
pub struct SupervisorEnds {
    /// Summaries.
    pub summaries: Consumer<Summary>,
    /// Bad cycles.
    pub incidents: Consumer<Incident>,
}

/// The channels between cycle, exchange, reporter and supervisor.
pub fn channels(settings: Settings) -> (CycleEnds, ExchangeEnds, ReporterEnds, SupervisorEnds) {
    let (input, output) = triple_buffer(&CycleInputs::new(settings));
    let (request_in, request_out) = RingBuffer::new(REQUESTS_WAITING);
    let (record_in, record_out) = record_ring(RECORDS);
    let (report_in, report_out) = RingBuffer::new(REPORTS);
    let (summary_in, summary_out) = RingBuffer::new(SUMMARIES);
    let (incident_in, incident_out) = RingBuffer::new(INCIDENTS);
    let cycle = CycleEnds {
        inputs: output,
        requests: request_out,
        records: record_in,
    };
    let exchange = ExchangeEnds {
        inputs: input,
        requests: request_in,
        records: record_out,
        reports: report_in,
    };
    let reporter = ReporterEnds {
        reports: report_out,
        summaries: summary_in,
        incidents: incident_in,
    };
    let supervisor = SupervisorEnds {
        summaries: summary_out,
        incidents: incident_out,
    };
    (cycle, exchange, reporter, supervisor)
}

/// Flags and counters that all threads see.
#[derive(Debug, Default)]
pub struct Shared {
    ending: AtomicBool,
    cycle_ended: AtomicBool,
    exchange_ended: AtomicBool,
    dropped_records: AtomicU64,
    origin_ns: AtomicU64,
    cycle_thread: AtomicU32,
    cycle_beats: AtomicU64,
    exchange_beats: AtomicU64,
    reporter_beats: AtomicU64,
    statistics_resets: AtomicU64,
    still_moving: AtomicBool,
    last_word_moves: AtomicBool,
    /// Set by a signal, so that neither shared memory nor another thread is needed for a stop.
    stop_asked: Arc<AtomicBool>,
}

impl Shared {
    /// With a flag that a signal sets when it asks for a stop.
    pub fn with_stop_flag(stop_asked: Arc<AtomicBool>) -> Self {
        Self {
            stop_asked,
            ..Self::default()
        }
    }

    /// Whether a stop was asked for by a signal since the last call.
    pub fn take_stop(&self) -> bool {
        // The flag is hardly ever set: a look costs less than a write.
        self.stop_asked.load(Ordering::Relaxed) && self.stop_asked.swap(false, Ordering::AcqRel)
    }

    /// The cycle thread has made its last command, and it was (not) zero rates.
    pub fn set_still_moving(&self, still_moving: bool) {
        self.still_moving.store(still_moving, Ordering::Release);
    }

    /// Whether the last command let the robot move on.
    pub fn is_still_moving(&self) -> bool {
        self.still_moving.load(Ordering::Acquire)
    }

    /// A command has left, and it was (not) zero rates.
    pub fn set_last_word_moves(&self, moves: bool) {
        self.last_word_moves.store(moves, Ordering::Release);
    }

    /// Whether the newest command that left lets the robot move on.
    pub fn last_word_moves(&self) -> bool {
        self.last_word_moves.load(Ordering::Acquire)
    }

    /// The cycle thread says who it is, so that others can read what the scheduler counts of it.
    pub fn set_cycle_thread(&self, id: u32) {
        self.cycle_thread.store(id, Ordering::Release);
    }

    /// Id of the cycle thread, once it has said it.
    pub fn cycle_thread(&self) -> Option<u32> {
        Some(self.cycle_thread.load(Ordering::Acquire)).filter(|id| *id != 0)
    }

    /// The cycle thread lives.
    pub fn beat_cycle(&self) {
        self.cycle_beats.fetch_add(1, Ordering::Relaxed);
    }

    /// The exchange thread lives.
    pub fn beat_exchange(&self) {
        self.exchange_beats.fetch_add(1, Ordering::Relaxed);
    }

    /// The reporter thread lives.
    pub fn beat_reporter(&self) {
        self.reporter_beats.fetch_add(1, Ordering::Relaxed);
    }

    /// Beats of cycle, exchange and reporter so far.
    pub fn beats(&self) -> [u64; 3] {
        [
            &self.cycle_beats,
            &self.exchange_beats,
            &self.reporter_beats,
        ]
        .map(|beats| beats.load(Ordering::Relaxed))
    }

    /// A client wants the statistics to begin anew.
    pub fn reset_statistics(&self) {
        self.statistics_resets.fetch_add(1, Ordering::Release);
    }

    /// How often that was wanted.
    pub fn statistics_resets(&self) -> u64 {
        self.statistics_resets.load(Ordering::Acquire)
    }

    /// Asks every thread to come to an end: the cycle brings the robot to rest first.
    pub fn end(&self) {
        self.ending.store(true, Ordering::Release);
    }

    /// Whether the end was asked for.
    pub fn is_ending(&self) -> bool {
        self.ending.load(Ordering::Acquire)
    }

    /// The cycle thread has made its last record.
    pub fn set_cycle_ended(&self) {
        self.cycle_ended.store(true, Ordering::Release);
    }

    /// Whether the cycle thread has made its last record.
    pub fn has_cycle_ended(&self) -> bool {
        self.cycle_ended.load(Ordering::Acquire)
    }

    /// The exchange thread has handed its last report on.
    pub fn set_exchange_ended(&self) {
        self.exchange_ended.store(true, Ordering::Release);
    }

    /// Whether the exchange thread has handed its last report on.
    pub fn has_exchange_ended(&self) -> bool {
        self.exchange_ended.load(Ordering::Acquire)
    }

    /// A record, report, incident or summary was lost because a ring was full.
    pub fn count_dropped_record(&self) {
        self.count_dropped_records(1);
    }

    /// As [`count_dropped_record`](Self::count_dropped_record), for several.
    pub fn count_dropped_records(&self, count: u64) {
        self.dropped_records.fetch_add(count, Ordering::Relaxed);
    }

    /// How many of them so far.
    pub fn dropped_records(&self) -> u64 {
        self.dropped_records.load(Ordering::Relaxed)
    }

    /// The origin of the time grid, once it is chosen.
    pub fn set_origin_ns(&self, origin_ns: u64) {
        self.origin_ns.store(origin_ns, Ordering::Release);
    }

    /// The origin of the time grid; 0 before it is chosen.
    pub fn origin_ns(&self) -> u64 {
        self.origin_ns.load(Ordering::Acquire)
    }
}
