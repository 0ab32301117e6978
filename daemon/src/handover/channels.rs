use cdcr_shared_types::{Incident, Status};
use rtrb::{Consumer, Producer, RingBuffer};
use triple_buffer::{Input, Output, triple_buffer};

use super::{
    ChangedSettings, CycleInputs, CycleRecord, CycleReport, CycleRequest, Settings, Summary,
};
use crate::rt::record_ring::{RecordReceiver, RecordSender, Used, record_ring};

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
    /// Records with what belongs to them.
    pub reports: Producer<CycleReport>,
    /// Settings of a configuration that was read again.
    pub reloaded: Consumer<ChangedSettings>,
}

#[derive(Debug)]
pub struct ReporterEnds {
    /// Records with what belongs to them.
    pub reports: Consumer<CycleReport>,
    /// Their records go back to the cycle.
    pub used: Used<CycleRecord>,
    pub summaries: Producer<Summary>,
    pub incidents: Producer<Incident>,
}

#[derive(Debug)]
pub struct SupervisorEnds {
    pub summaries: Consumer<Summary>,
    pub incidents: Consumer<Incident>,
    /// The same with their steal, to be published.
    pub explained: Producer<Incident>,
    pub status: Input<Status>,
}

/// Ends of the thread that publishes status and bad cycles.
#[derive(Debug)]
pub struct StatusDeskEnds {
    pub incidents: Consumer<Incident>,
    pub status: Output<Status>,
}

/// The ends of every thread.
#[derive(Debug)]
pub struct Channels {
    pub cycle: CycleEnds,
    pub exchange: ExchangeEnds,
    pub reporter: ReporterEnds,
    pub supervisor: SupervisorEnds,
    /// Of the thread that publishes status and bad cycles.
    pub status_desk: StatusDeskEnds,
    /// Of who reads the configuration again.
    pub reloaded: Producer<ChangedSettings>,
}

/// Settings between who reads the configuration again and the exchange.
const RELOADED: usize = 4;

/// The channels between all threads.
pub fn channels(settings: Settings) -> Channels {
    let (input, output) = triple_buffer(&CycleInputs::new(settings));
    let (request_in, request_out) = RingBuffer::new(REQUESTS_WAITING);
    // The reporter has one more in its hands.
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
        status_desk: StatusDeskEnds {
            incidents: explained_out,
            status: status_out,
        },
        reloaded: reloaded_in,
    }
}
