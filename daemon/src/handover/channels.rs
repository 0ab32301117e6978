use cdcr_shared_types::{Incident, Status};
use rtrb::{Consumer, Producer, RingBuffer};
use triple_buffer::{Input, Output, triple_buffer};

use super::{
    ChangedSettings, CycleInputs, CycleRecord, CycleReport, CycleRequest, RuntimeSettings, Summary,
};
use crate::rt::record_ring::{RecordReceiver, RecordSender, Used, record_ring};

/// Requests carried out by one cycle; the others wait for the next.
pub const REQUESTS_PER_CYCLE: usize = 4;
/// Requests that can wait for a cycle. A cycle with a stop answers all of them.
pub const REQUESTS_WAITING: usize = 4 * REQUESTS_PER_CYCLE;
/// Records between cycle and exchange: 0.48 s at 5 ms.
const RECORDS: usize = 96;
/// Reports between exchange and reporter: 0.64 s at 5 ms.
const REPORTS: usize = 128;
/// Summaries between reporter and supervisor: 5 s at 5 ms.
const SUMMARIES: usize = 1024;
/// Incidents between reporter and supervisor, and between supervisor and status thread.
const INCIDENTS: usize = 16;

#[derive(Debug)]
pub struct CycleEnds {
    pub inputs: Output<CycleInputs>,
    pub requests: Consumer<CycleRequest>,
    pub records: RecordSender<CycleRecord>,
}

#[derive(Debug)]
pub struct ExchangeEnds {
    pub inputs: Input<CycleInputs>,
    pub requests: Producer<CycleRequest>,
    pub records: RecordReceiver<CycleRecord>,
    /// Records with the data that belong to them.
    pub reports: Producer<CycleReport>,
    /// Changed settings of a reloaded configuration.
    pub reloaded: Consumer<ChangedSettings>,
}

#[derive(Debug)]
pub struct ReporterEnds {
    /// Records with the data that belong to them.
    pub reports: Consumer<CycleReport>,
    /// Returns records to the cycle.
    pub used: Used<CycleRecord>,
    pub summaries: Producer<Summary>,
    pub incidents: Producer<Incident>,
}

#[derive(Debug)]
pub struct SupervisorEnds {
    pub summaries: Consumer<Summary>,
    pub incidents: Consumer<Incident>,
    /// Incidents with their steal time, to be published.
    pub explained: Producer<Incident>,
    pub status: Input<Status>,
}

/// Ends of the thread that publishes status and incidents.
#[derive(Debug)]
pub struct StatusThreadEnds {
    pub incidents: Consumer<Incident>,
    pub status: Output<Status>,
}

/// The channel ends of every thread.
#[derive(Debug)]
pub struct Channels {
    pub cycle: CycleEnds,
    pub exchange: ExchangeEnds,
    pub reporter: ReporterEnds,
    pub supervisor: SupervisorEnds,
    /// For the thread that publishes status and incidents.
    pub status_thread: StatusThreadEnds,
    /// For the code that reloads the configuration.
    pub reloaded: Producer<ChangedSettings>,
}

/// Changed settings between the reload and the exchange.
const RELOADED: usize = 4;

pub fn channels(settings: RuntimeSettings) -> Channels {
    let (input, output) = triple_buffer(&CycleInputs::new(settings));
    let (request_in, request_out) = RingBuffer::new(REQUESTS_WAITING);
    // The reporter holds one more.
    let (record_in, record_out, record_used) = record_ring(RECORDS, REPORTS + 1);
    let (report_in, report_out) = RingBuffer::new(REPORTS);
    let (summary_in, summary_out) = RingBuffer::new(SUMMARIES);
    let (incident_in, incident_out) = RingBuffer::new(INCIDENTS);
    let (explained_in, explained_out) = RingBuffer::new(INCIDENTS);
    let (status_in, status_out) = triple_buffer(&Status::default());
    let (reloaded_in, reloaded_out) = RingBuffer::new(RELOADED);
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
        reloaded: reloaded_out,
    };
    let reporter = ReporterEnds {
        reports: report_out,
        used: record_used,
        summaries: summary_in,
        incidents: incident_in,
    };
    let supervisor = SupervisorEnds {
        summaries: summary_out,
        incidents: incident_out,
        explained: explained_in,
        status: status_in,
    };
    Channels {
        cycle,
        exchange,
        reporter,
        supervisor,
        status_thread: StatusThreadEnds {
            incidents: explained_out,
            status: status_out,
        },
        reloaded: reloaded_in,
    }
}
