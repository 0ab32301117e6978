//! Receives the messages of a daemon in a thread.
//!
//! A busy disk may block its writer for longer than the daemon's queues last: telemetry has 256 cycles, a
//! quarter of a second at 1 kHz, and the status two messages.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use anyhow::Context;
use cdcr_client::channels::Topic;
use cdcr_client::{Connection, LinkError, Liveness, Message, Stream, monotonic_ns};
use cdcr_shared_types::{Incident, ObstacleUpdate, ReferenceChunk, Status, Telemetry};

use crate::args::Target;
use crate::interrupt::QUIET;

/// Interval at which the services are read. A client that sends one message leaves a few milliseconds later,
/// and its unread message is lost.
const READ_EVERY: Duration = Duration::from_millis(2);
/// Maximum number of queued readings: 4 s, 60 MB at 1 kHz.
const WAITING_MAX: usize = 2048;
/// Stack size of the thread: iceoryx2 has large arrays on the stack.
const STACK_BYTES: usize = 4 << 20;

/// The thread, and its readings.
pub(super) struct Intake {
    /// `None` after the final end.
    readings: Option<Receiver<anyhow::Result<Reading>>>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Messages since the previous reading, oldest first.
#[derive(Debug, Default)]
pub(super) struct Reading {
    /// All messages sent until this time are in this or an earlier reading, except one that is being sent.
    pub(super) until_ns: u64,
    pub(super) records: Vec<Telemetry>,
    /// Reference chunks. All messages that the cycles above gathered are in this or an earlier reading.
    pub(super) references: Vec<ReferenceChunk>,
    pub(super) obstacles: Vec<ObstacleUpdate>,
    pub(super) statuses: Vec<Status>,
    pub(super) incidents: Vec<Incident>,
    /// Lost messages of each topic since the start, from the gaps in their sequence numbers.
    pub(super) lost: [u64; Topic::ALL.len()],
}

impl Intake {
    /// Starts reading, and returns the newest status.
    pub(super) fn begin(target: &Target) -> anyhow::Result<(Self, Status)> {
        let (ready, is_ready) = channel();
        let (sender, readings) = sync_channel(WAITING_MAX);
        let is_over = Arc::new(AtomicBool::new(false));
        let (target, theirs) = (target.clone(), Arc::clone(&is_over));
        let thread = thread::Builder::new()
            .stack_size(STACK_BYTES)
            .spawn(move || match Streams::open(&target) {
                Ok((streams, status)) => {
                    if ready.send(Ok(status)).is_ok() {
                        streams.read_on(&sender, &theirs);
                    }
                }
                Err(error) => drop(ready.send(Err(error))),
            })
            .context("the reading thread")?;
        let intake = Self {
            readings: Some(readings),
            is_over,
            thread: Some(thread),
        };
        let status = is_ready.recv().context("the reading thread ended")??;
        Ok((intake, status))
    }

    /// The next reading, every few milliseconds; `None` after the last one or the end of the daemon.
    pub(super) fn next(&self) -> anyhow::Result<Option<Reading>> {
        let next = self.readings.as_ref().map(Receiver::recv);
        next.and_then(Result::ok).transpose()
    }

    /// Requests a last reading of all messages until now.
    pub(super) fn end(&self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

impl Drop for Intake {
    fn drop(&mut self) {
        self.end();
        // The thread must not wait for a free place in the queue.
        self.readings = None;
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
    }
}

/// All recorded services.
struct Streams {
    connection: Connection,
    telemetry: Stream<Telemetry>,
    references: Stream<ReferenceChunk>,
    obstacles: Stream<ObstacleUpdate>,
    statuses: Stream<Status>,
    incidents: Stream<Incident>,
}

impl Streams {
    fn open(target: &Target) -> anyhow::Result<(Self, Status)> {
        let connection = target.connect()?;
        let streams = Self {
            // Opened before the telemetry: all messages gathered by a recorded cycle must be received.
            references: connection.references()?,
            obstacles: connection.obstacle_updates()?,
            telemetry: connection.telemetry()?,
            statuses: connection.statuses()?,
            incidents: connection.incidents()?,
            connection,
        };
        let status = streams.connection.status(QUIET)?;
        Ok((streams, status))
    }

    /// Reads until the end, until the receiver is gone, or until the daemon has ended.
    fn read_on(mut self, readings: &SyncSender<anyhow::Result<Reading>>, is_over: &AtomicBool) {
        let mut heard = Instant::now();
        loop {
            let is_last = is_over.load(Ordering::Relaxed);
            let reading = self.read();
            if reading.as_ref().is_ok_and(|read| !read.records.is_empty()) {
                heard = Instant::now();
            } else if heard.elapsed() > QUIET {
                // A stopped daemon may continue: its next cycles belong to the recording.
                match self.connection.status(QUIET) {
                    Ok(_)
                    | Err(LinkError::Silent {
                        liveness: Liveness::Runs { .. },
                        ..
                    }) => {}
                    Err(_) => return,
                }
                heard = Instant::now();
            }
            if readings.send(reading).is_err() || is_last {
                return;
            }
            thread::sleep(READ_EVERY);
        }
    }

    fn read(&mut self) -> anyhow::Result<Reading> {
        Ok(Reading {
            until_ns: monotonic_ns(),
            // The telemetry is read first: the messages that a cycle gathered were sent before its record.
            records: all(&mut self.telemetry)?,
            references: all(&mut self.references)?,
            obstacles: all(&mut self.obstacles)?,
            statuses: all(&mut self.statuses)?,
            incidents: all(&mut self.incidents)?,
            lost: Topic::ALL.map(|topic| match topic {
                Topic::Telemetry => self.telemetry.lost(),
                Topic::Reference => self.references.lost(),
                Topic::Obstacles => self.obstacles.lost(),
                Topic::Status => self.statuses.lost(),
                Topic::Incidents => self.incidents.lost(),
            }),
        })
    }
}

fn all<T: Message>(stream: &mut Stream<T>) -> anyhow::Result<Vec<T>> {
    let mut messages = Vec::new();
    while let Some(message) = stream.try_next()? {
        messages.push(message);
    }
    Ok(messages)
}
