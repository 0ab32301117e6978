//! Points that are fed as they come.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Instant;

use cdcr_client::{
    Connection, FeedError, Lease, Orientation, ReferenceFeed, TelemetryStream, events,
    monotonic_ns, remedy,
};
use cdcr_shared_types::codes::{
    ChunkMode, EventKind, Interpolation, Mode, OrientationKind, Outcome, Reason, RequestKind,
};
use cdcr_shared_types::limits::CHUNK_POINTS_MAX;
use cdcr_shared_types::{InputEvent, ReferencePoint, Telemetry};
use pyo3::prelude::*;

use crate::arrays::{ArrayLike, Numbers};
use crate::connection::Address;
use crate::errors::{Class, Failure};
use crate::running::{Running, TURN, until_it_holds};
use crate::trajectory::{interpolation, orientations, wire_interpolation};

/// Counts of a stream of points.
#[derive(Default)]
struct Counts {
    sent: AtomicU64,
    accepted: AtomicU64,
}

/// Points that are fed as they come, from Connection.stream(): a context manager. Its thread keeps the lease. Leaving the `with` gives it back, and
/// the robot holds.
#[pyclass(module = "cdcr")]
pub(crate) struct FeedStream {
    address: Address,
    interpolation: Interpolation,
    track: bool,
    counts: Arc<Counts>,
    points: Option<Sender<Vec<ReferencePoint>>>,
    running: Option<Running<()>>,
    start_ns: u64,
}

#[pymethods]
impl FeedStream {
    fn __enter__(slf: Bound<'_, Self>) -> PyResult<Bound<'_, Self>> {
        let py = slf.py();
        let mut stream = slf.borrow_mut();
        if stream.points.is_some() || stream.running.is_some() {
            return Err(Failure::new(
                Class::Feed,
                "this stream was used before",
                "Make another one.",
            )
            .into());
        }
        let (points, orders) = channel();
        let desk = Desk {
            orders,
            interpolation: stream.interpolation,
            track: stream.track,
            counts: Arc::clone(&stream.counts),
        };
        let address = stream.address.clone();
        stream.running = Some(Running::start(py, move |begun| {
            let connection = address.open()?;
            desk.serve(&connection, begun)
        })?);
        stream.points = Some(points);
        stream.start_ns = monotonic_ns();
        drop(stream);
        Ok(slf)
    }

    /// Time since the `with` began [s]: the clock of send().
    fn now(&self) -> f64 {
        monotonic_ns().saturating_sub(self.start_ns) as f64 * 1e-9
    }

    /// Adds points, which must follow those that were sent before, and be ahead of now().
    ///
    /// t: (k,) [s] on the clock of now(), or one number. xyz: (k, 3), or (3,) [m]. quaternion: (k, 4), x, y, z, w, if the orientation counts.
    /// Raises ArgumentError for wrong shapes, and FeedError once the daemon has refused points or does not follow any more.
    #[pyo3(signature = (t, xyz, *, quaternion = None))]
    fn send(
        &mut self,
        py: Python<'_>,
        t: ArrayLike<'_>,
        xyz: ArrayLike<'_>,
        quaternion: Option<ArrayLike<'_>>,
    ) -> PyResult<()> {
        let points = self.points(&t, &xyz, quaternion)?;
        let sent = self
            .points
            .as_ref()
            .is_some_and(|port| port.send(points).is_ok());
        if sent {
            return Ok(());
        }
        self.points = None;
        match self.running.take() {
            Some(running) => running.join(py),
            None => {
                Err(Failure::new(Class::Feed, "the stream is not open", "Use it in a with.").into())
            }
        }
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

    #[pyo3(signature = (kind: "object" = None, _error: "object" = None, _trace: "object" = None, /))]
    fn __exit__(
        &mut self,
        py: Python<'_>,
        kind: Option<Py<PyAny>>,
        _error: Option<Py<PyAny>>,
        _trace: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        self.points = None;
        let ended = self
            .running
            .take()
            .map_or(Ok(()), |running| running.join(py));
        // What happened in the `with` comes first.
        if kind.is_none() { ended } else { Ok(()) }
    }
}

impl FeedStream {
    pub(crate) fn new(address: Address, interpolation: &str, track: bool) -> PyResult<Self> {
        let interpolation = wire_interpolation(self::interpolation(interpolation)?);
        Ok(Self {
            address,
            interpolation,
            track,
            counts: Arc::default(),
            points: None,
            running: None,
            start_ns: 0,
        })
    }

    fn points(
        &self,
        t: &ArrayLike<'_>,
        xyz: &ArrayLike<'_>,
        quaternion: Option<ArrayLike<'_>>,
    ) -> PyResult<Vec<ReferencePoint>> {
        let times = Numbers::with_tail(t, "t", &[], "a time for each point")?.finite("t")?;
        let positions =
            Numbers::with_tail(xyz, "xyz", &[3], "x, y, z of each point")?.finite("xyz")?;
        let count = positions.count();
        if times.lead() != positions.lead() || times.lead().len() > 1 || count == 0 {
            let (t, xyz) = (times.lead(), positions.lead());
            return Err(Failure::argument(
                format!("t has the shape {t:?}, and xyz {xyz:?} and 3"),
                "Give one time for each point, and one point at least.",
            )
            .into());
        }
        if times.values().iter().any(|time_s| *time_s < 0.0) {
            return Err(Failure::argument(
                "t is before the stream began",
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
            let (kind, orientation) = match orientation {
                Orientation::Full(quaternion) => (OrientationKind::Full, quaternion),
                Orientation::Free | Orientation::Axis(_) => (OrientationKind::None, [0.0; 4]),
            };
            ReferencePoint {
                time_ns: self.start_ns + (time_s * 1e9).round() as u64,
                position_m: [place[0], place[1], place[2]],
                orientation,
                orientation_kind: kind.code(),
                reserved: 0,
            }
        };
        Ok(rows.map(point).collect())
    }
}

impl Drop for FeedStream {
    fn drop(&mut self) {
        if let Some(running) = self.running.take() {
            running.abandon(self.points.take());
        }
    }
}

/// What the thread of a stream works with.
struct Desk {
    orders: Receiver<Vec<ReferencePoint>>,
    interpolation: Interpolation,
    track: bool,
    counts: Arc<Counts>,
}

/// How far the daemon has come with it.
#[derive(Default)]
struct Followed {
    asked: bool,
    tracked: bool,
}

impl Desk {
    /// Until nobody has orders any more.
    fn serve(&self, connection: &Connection, begun: &Sender<bool>) -> Result<(), Failure> {
        let port = connection.reference_feed()?;
        let mut telemetry = connection.telemetry()?;
        let lease = connection.acquire_lease()?;
        let mut renewed = Instant::now();
        let mut followed = Followed::default();
        let _ = begun.send(true);
        loop {
            match self.orders.recv_timeout(TURN) {
                Ok(points) => self.send(&port, &points)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    drop(lease);
                    return until_it_holds(&mut telemetry);
                }
            }
            self.listen(connection, &mut telemetry, &mut followed)?;
            if self.track && !followed.asked && self.counts.accepted.load(Ordering::Relaxed) > 0 {
                connection.request(RequestKind::Track)?;
                followed.asked = true;
            }
            renew(&lease, &mut renewed)?;
        }
    }

    fn send(&self, port: &ReferenceFeed, points: &[ReferencePoint]) -> Result<(), Failure> {
        for points in points.chunks(CHUNK_POINTS_MAX) {
            let mode = match self.counts.sent.fetch_add(1, Ordering::Relaxed) {
                0 => ChunkMode::Replace,
                _ => ChunkMode::Append,
            };
            port.send(mode, self.interpolation, points)?;
        }
        Ok(())
    }

    /// Reads all records that wait.
    fn listen(
        &self,
        connection: &Connection,
        telemetry: &mut TelemetryStream,
        followed: &mut Followed,
    ) -> Result<(), Failure> {
        while let Some(record) = telemetry.try_next()? {
            for event in events(&record) {
                if event.sender_id == connection.sender_id()
                    && event.kind == EventKind::Reference.code()
                {
                    self.judge(event)?;
                }
            }
            followed.judge(&record)?;
        }
        Ok(())
    }

    fn judge(&self, event: &InputEvent) -> Result<(), Failure> {
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

impl Followed {
    fn judge(&mut self, record: &Telemetry) -> Result<(), Failure> {
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
            _ => "Look with cdcrctl status.",
        };
        Err(Failure::new(Class::Feed, message, next))
    }
}

/// At a fifth of it, so that four renewals may come too late.
fn renew(lease: &Lease<'_>, renewed: &mut Instant) -> Result<(), Failure> {
    if renewed.elapsed() < lease.left() / 5 {
        return Ok(());
    }
    *renewed = Instant::now();
    lease.renew().map_err(FeedError::from)?;
    Ok(())
}
