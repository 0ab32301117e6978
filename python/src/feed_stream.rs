//! Points that are fed as they come.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use cdcr_client::{
    Connection, FeedError, Lease, Orientation, ReferenceFeed, TelemetryStream, events,
    monotonic_ns, remedy,
};
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Interpolation, Mode, Outcome, Reason, RequestKind,
};
use cdcr_shared_types::limits::CHUNK_POINTS_MAX;
use cdcr_shared_types::{InputEvent, ReferencePoint, Telemetry};
use pyo3::prelude::*;

use crate::address::Address;
use crate::arrays::{ArrayLike, Numbers, shape_text};
use crate::errors::{Class, Failure};
use crate::numbers::SECONDS;
use crate::running::{Running, exit_result, wait_until_holding};
use crate::trajectory::{orientations, wire_interpolation};
use crate::words::{INTERPOLATIONS, chosen};
use crate::worker::{Closed, TURN, forked};

/// Counts of a stream of points.
#[derive(Default)]
struct Counts {
    sent: AtomicU64,
    accepted: AtomicU64,
    /// The `with` was left by an exception, which takes precedence over what the daemon says to the last points.
    abandoned: AtomicBool,
}

/// Points that are fed as they come, from Connection.stream(): a context manager. Its thread keeps the lease. Leaving the `with` waits for the daemon's answer to the last points, a second at most, and gives the lease back: the robot holds.
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct FeedStream {
    address: Address,
    closed: Closed,
    interpolation: Interpolation,
    track: bool,
    counts: Arc<Counts>,
    /// While it is open.
    points: Mutex<Option<Points>>,
    running: Running<()>,
}

/// Port for the points of a stream.
#[derive(Clone)]
struct Points {
    port: Sender<Vec<ReferencePoint>>,
    start_ns: u64,
}

#[pymethods]
impl FeedStream {
    fn __enter__(slf: Bound<'_, Self>) -> PyResult<Bound<'_, Self>> {
        let stream = slf.get();
        let (port, orders) = channel();
        let desk = StreamThread {
            orders,
            address: stream.address.clone(),
            closed: stream.closed.clone(),
            interpolation: stream.interpolation,
            track: stream.track,
            counts: Arc::clone(&stream.counts),
        };
        let run = move |begun: &Sender<bool>| desk.serve(&desk.address.open()?, begun);
        // An interrupt drops the port, which ends the thread.
        stream.running.begin(slf.py(), &stream.closed, run, || ())?;
        *stream.lock() = Some(Points {
            port,
            start_ns: monotonic_ns(),
        });
        Ok(slf)
    }

    /// Time since the `with` began [s]: the clock of send(). Raises FeedError outside of the `with`.
    fn now(&self) -> PyResult<f64> {
        let start_ns = self.open()?.start_ns;
        Ok(monotonic_ns().saturating_sub(start_ns) as f64 * 1e-9)
    }

    /// Adds points, which must follow those that were sent before, and be ahead of now().
    ///
    /// t: (k,) [s] on the clock of now(), or one number. xyz: (k, 3), or (3,) [m]. quaternion: (k, 4), x, y, z, w, if the orientation counts.
    /// Raises ArgumentError for wrong shapes, FeedError once the daemon has refused points or does not follow any more, LinkError once it has ended.
    #[pyo3(signature = (t, xyz, *, quaternion = None))]
    fn send(
        &self,
        py: Python<'_>,
        t: ArrayLike<'_>,
        xyz: ArrayLike<'_>,
        quaternion: Option<ArrayLike<'_>>,
    ) -> PyResult<()> {
        let Points { port, start_ns } = self.open()?;
        if port.send(points(start_ns, &t, &xyz, quaternion)?).is_ok() {
            return Ok(());
        }
        drop(self.close());
        self.running.wait(py, None)?;
        Ok(())
    }

    /// Chunks that were sent.
    #[getter]
    fn sent_chunks(&self) -> u64 {
        self.counts.sent.load(Ordering::Relaxed)
    }

    /// Chunks that the daemon has accepted.
    #[getter]
    fn accepted_chunks(&self) -> u64 {
        self.counts.accepted.load(Ordering::Relaxed)
    }

    /// Ends the stream, and waits until the robot holds. Raises FeedError if the daemon has refused points.
    #[pyo3(signature = (kind: "object" = None, _error: "object" = None, _trace: "object" = None, /))]
    fn __exit__(
        &self,
        py: Python<'_>,
        kind: Option<Py<PyAny>>,
        _error: Option<Py<PyAny>>,
        _trace: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        if !self.running.is_forked() {
            let is_abandoned = kind.is_some();
            self.counts.abandoned.store(is_abandoned, Ordering::Relaxed);
            drop(self.close());
        }
        exit_result(kind.as_ref(), self.running.wait(py, None))
    }

    fn __repr__(&self) -> String {
        let (robot, stage) = (&self.address.robot, self.running.word());
        let (sent, accepted) = (self.sent_chunks(), self.accepted_chunks());
        format!("<FeedStream to {robot}: {stage}, {accepted} of {sent} chunks accepted>")
    }
}

impl FeedStream {
    pub(crate) fn new(
        (address, closed): (Address, Closed),
        interpolation: &str,
        track: bool,
    ) -> PyResult<Self> {
        let interpolation = chosen("interpolation", interpolation, INTERPOLATIONS)?;
        let interpolation = wire_interpolation(interpolation);
        Ok(Self {
            address,
            closed,
            interpolation,
            track,
            counts: Arc::default(),
            points: Mutex::default(),
            running: Running::new("stream"),
        })
    }

    fn lock(&self) -> MutexGuard<'_, Option<Points>> {
        self.points.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn open(&self) -> Result<Points, Failure> {
        // In a forked process the lock may be held for ever.
        if self.running.is_forked() {
            return Err(forked());
        }
        self.closed.check()?;
        let open = self.lock().clone();
        open.ok_or_else(|| {
            self.running.failure(
                "is not open",
                "Use it inside the `with` that begins it, and make another one after an error.",
            )
        })
    }

    fn close(&self) -> Option<Points> {
        self.lock().take()
    }
}

impl Drop for FeedStream {
    fn drop(&mut self) {
        if self.running.is_forked() {
            let points = self.points.get_mut();
            std::mem::forget(points.unwrap_or_else(PoisonError::into_inner).take());
        }
    }
}

fn points(
    start_ns: u64,
    t: &ArrayLike<'_>,
    xyz: &ArrayLike<'_>,
    quaternion: Option<ArrayLike<'_>>,
) -> PyResult<Vec<ReferencePoint>> {
    let times = Numbers::with_tail(t, "t", &[], "a time for each point")?.finite("t")?;
    let positions = Numbers::with_tail(xyz, "xyz", &[3], "x, y, z of each point")?.finite("xyz")?;
    let count = positions.count();
    if times.lead() != positions.lead() || times.lead().len() > 1 || count == 0 {
        let t = shape_text(times.lead(), "");
        let xyz = shape_text(&[positions.lead(), &[3]].concat(), "");
        return Err(Failure::argument(
            format!(
                "t has the shape {t} and xyz {xyz}; needed are (k,) and (k, 3), or () and (3,)"
            ),
            "Give one time for each point, and one point at least.",
        )
        .into());
    }
    if let Some(time_s) = times
        .values()
        .iter()
        .find(|time_s| !SECONDS.contains(*time_s))
    {
        let (begin, end) = (SECONDS.start(), SECONDS.end());
        return Err(Failure::argument(
            format!("t has {time_s} s; needed are {begin} to {end:e} s since the stream began"),
            "Add to FeedStream.now().",
        )
        .into());
    }
    let orientations = orientations(quaternion, None, count)?;
    let rows = times
        .values()
        .iter()
        .zip(positions.values().chunks_exact(3))
        .zip(orientations);
    let point = |((time_s, place), orientation): ((&f64, &[f64]), Orientation)| {
        let (kind, orientation) = orientation.to_wire();
        ReferencePoint {
            time_ns: start_ns + (time_s * 1e9).round() as u64,
            position_m: [place[0], place[1], place[2]],
            orientation,
            orientation_kind: kind.code(),
            reserved: 0,
        }
    };
    Ok(rows.map(point).collect())
}

/// Largest number of chunks under way: three quarters of the queue of a delayed daemon, which loses any more.
const UNDER_WAY_MAX: u64 = 24;
/// Chunks that are sent immediately. Each further one waits longer than the one before and collects the
/// points meanwhile: all of them last 0.42 s without an event, longer than the lead of the points. The daemon
/// accepts chunks in real time, but sends the events from a thread that a busy machine delays.
const AT_ONCE: u64 = 4;
const LONGER_EACH: Duration = Duration::from_millis(2);
/// Time without an event after which a chunk is sent nevertheless, because events of chunks may be lost.
const SILENCE: Duration = Duration::from_millis(200);
/// Time limit for the events of the last chunks once the `with` is left, as for those of obstacles.
const LAST_ANSWERS: Duration = Duration::from_secs(1);

/// State of the thread of a stream.
struct StreamThread {
    address: Address,
    closed: Closed,
    orders: Receiver<Vec<ReferencePoint>>,
    interpolation: Interpolation,
    track: bool,
    counts: Arc<Counts>,
}

/// Progress of the daemon with the stream.
#[derive(Default)]
struct Followed {
    asked: bool,
    tracked: bool,
}

/// Sent points, pending points, and how many of them the daemon has evaluated.
struct Outbox {
    port: ReferenceFeed,
    waiting: VecDeque<ReferencePoint>,
    /// Sequence numbers of the newest chunks.
    sent: u64,
    evaluated: u64,
    sent_at: Instant,
}

impl StreamThread {
    /// Runs until the senders of orders are dropped.
    fn serve(&self, connection: &Connection, begun: &Sender<bool>) -> Result<(), Failure> {
        let mut outbox = Outbox::new(connection.reference_feed()?);
        let mut telemetry = connection.telemetry()?;
        let lease = connection.acquire_lease().map_err(FeedError::from)?;
        let mut renewed_ns = monotonic_ns();
        let mut followed = Followed::default();
        let _ = begun.send(true);
        let last = loop {
            match self.orders.recv_timeout(TURN) {
                Ok(points) => {
                    outbox.waiting.extend(points);
                    outbox.waiting.extend(self.orders.try_iter().flatten());
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let held = (&lease, &mut renewed_ns);
                    break self.finish(
                        connection,
                        held,
                        &mut telemetry,
                        &mut followed,
                        &mut outbox,
                    );
                }
            }
            if self.closed.is_set() {
                break Ok(());
            }
            let accepted_ns =
                self.process_telemetry(connection, &mut telemetry, &mut followed, &mut outbox)?;
            renewed_ns = renewed_ns.max(accepted_ns);
            self.send(&mut outbox)?;
            if self.track && !followed.asked && self.counts.accepted.load(Ordering::Relaxed) > 0 {
                let asked = connection.request(RequestKind::Track);
                asked.map_err(FeedError::from)?;
                followed.asked = true;
            }
            renew(&lease, &mut renewed_ns)?;
        };
        drop(lease);
        let holds = wait_until_holding(&self.address, &mut telemetry);
        last.and(holds)
    }

    /// Sends what waits, and fails for what the daemon refuses of it.
    fn finish(
        &self,
        connection: &Connection,
        (lease, renewed_ns): (&Lease<'_>, &mut u64),
        telemetry: &mut TelemetryStream,
        followed: &mut Followed,
        outbox: &mut Outbox,
    ) -> Result<(), Failure> {
        let until = Instant::now() + LAST_ANSWERS;
        let is_over = || {
            let is_asked = self.counts.abandoned.load(Ordering::Relaxed) || self.closed.is_set();
            is_asked || Instant::now() >= until
        };
        while !outbox.is_answered() && !is_over() {
            self.process_telemetry(connection, telemetry, followed, outbox)?;
            self.send(outbox)?;
            renew(lease, renewed_ns)?;
            thread::sleep(TURN);
        }
        Ok(())
    }

    /// Points that wait longer than usual share a chunk.
    fn send(&self, outbox: &mut Outbox) -> Result<(), Failure> {
        while outbox.may_send() {
            let count = outbox.waiting.len().min(CHUNK_POINTS_MAX);
            let points: Vec<_> = outbox.waiting.drain(..count).collect();
            let mode = match self.counts.sent.fetch_add(1, Ordering::Relaxed) {
                0 => ChunkMode::Replace,
                _ => ChunkMode::Append,
            };
            outbox.send(mode, self.interpolation, &points)?;
        }
        Ok(())
    }

    /// Reads all pending records. Returns the time of the last accepted chunk, or 0.
    fn process_telemetry(
        &self,
        connection: &Connection,
        telemetry: &mut TelemetryStream,
        followed: &mut Followed,
        outbox: &mut Outbox,
    ) -> Result<u64, Failure> {
        let mut accepted_ns = 0_u64;
        while let Some(record) = telemetry.try_next()? {
            for event in events(&record) {
                if event.sender_id == connection.sender_id()
                    && event.kind == EventKind::Reference.code()
                {
                    outbox.note_evaluated(event.sequence);
                    self.check_event(event)?;
                    accepted_ns = accepted_ns.max(event.evaluated_ns);
                }
            }
            followed.check_tracking(&record)?;
        }
        Ok(accepted_ns)
    }

    fn check_event(&self, event: &InputEvent) -> Result<(), Failure> {
        let outcome = Outcome::try_from(event.outcome).unwrap_or(Outcome::UnknownCode);
        if outcome == Outcome::Accepted {
            self.counts.accepted.fetch_add(1, Ordering::Relaxed);
            return Ok(());
        }
        let message = format!(
            "the daemon refused points: {outcome}, at point {} of the chunk",
            event.detail
        );
        Err(Failure::new(Class::Feed, message, remedy(outcome)))
    }
}

impl Outbox {
    fn new(port: ReferenceFeed) -> Self {
        Self {
            port,
            waiting: VecDeque::new(),
            sent: 0,
            evaluated: 0,
            sent_at: Instant::now(),
        }
    }

    fn may_send(&self) -> bool {
        let (under_way, since) = (self.sent - self.evaluated, self.sent_at.elapsed());
        let waits = LONGER_EACH * under_way.saturating_sub(AT_ONCE) as u32;
        let has_room = under_way < UNDER_WAY_MAX && since >= waits;
        (has_room || since > SILENCE) && !self.waiting.is_empty()
    }

    fn send(
        &mut self,
        mode: ChunkMode,
        interpolation: Interpolation,
        points: &[ReferencePoint],
    ) -> Result<(), Failure> {
        let header = self.port.send(mode, interpolation, points)?;
        if mode == ChunkMode::Replace {
            self.evaluated = header.sequence - 1;
        }
        self.sent = header.sequence;
        self.sent_at = Instant::now();
        Ok(())
    }

    fn is_answered(&self) -> bool {
        self.waiting.is_empty() && self.evaluated >= self.sent
    }

    fn note_evaluated(&mut self, sequence: u64) {
        self.evaluated = self.evaluated.max(sequence.min(self.sent));
    }
}

impl Followed {
    fn check_tracking(&mut self, record: &Telemetry) -> Result<(), Failure> {
        let mode = Mode::try_from(record.mode);
        if mode == Ok(Mode::Tracking) {
            self.tracked |= self.asked;
            return Ok(());
        }
        if !self.tracked {
            return Ok(());
        }
        let message = format!(
            "the daemon left tracking: {}",
            Reason::text_of(record.reason)
        );
        let next = match Reason::try_from(record.reason) {
            Ok(Reason::ReferenceEnded) => "Send points further ahead of now().",
            _ => "Find the cause with cdcrctl status, then create a new stream.",
        };
        Err(Failure::new(Class::Feed, message, next))
    }
}

/// Renews the lease at a fifth of its duration, so that four renewals may be late. Each accepted chunk renews
/// it, too: a request waits for its answer, and points wait with it.
fn renew(lease: &Lease<'_>, renewed_ns: &mut u64) -> Result<(), Failure> {
    let now_ns = monotonic_ns();
    if now_ns < *renewed_ns + lease.left().as_nanos() as u64 / 5 {
        return Ok(());
    }
    lease.renew().map_err(FeedError::from)?;
    *renewed_ns = now_ns;
    Ok(())
}
