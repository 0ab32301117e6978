//! A connection to a daemon: received messages and requests.

mod live;
mod obstacles;

use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use cdcr_client::model::{broken_bound, moves_away};
use cdcr_client::{
    self, CommandStream, ConnectError, LinkError, Liveness, ObstacleSender, RequestError,
    Requester, Stream, TelemetryStream,
};
use cdcr_controller::robot::Robot as Model;
use cdcr_shared_types::codes::{Outcome, RequestKind};
use cdcr_shared_types::{
    Incident, Location, Obstacle as WireObstacle, Service, SolverSettings, Status, Telemetry,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};

use crate::address::Address;
use crate::arrays::ArrayLike;
use crate::driver::DriverPort;
use crate::errors::{Class, Failure};
use crate::feed::Feed;
use crate::feed_stream::FeedStream;
use crate::mapping::pairs;
use crate::numbers::{count, seconds, until, within};
use crate::obstacle::{Obstacle, check_count};
use crate::robot::Robot;
use crate::settings::{Settings, changed, known};
use crate::trajectory::{Points, Trajectory, TrajectorySource};
use crate::wire::Records;
use crate::words::{INTERFACES, chosen};
use crate::worker::{Closed, Worker, once, refuse_forked_process, sleep_until};

use live::FETCH_EACH;
pub(crate) use live::Live;

/// Range of the numbers of obstacles.
const NUMBERS: RangeInclusive<u32> = 0..=u32::MAX;
/// Time without records and commands after which a daemon counts as silent.
const SILENT_AFTER: Duration = Duration::from_secs(1);
/// Time without records after which it counts as silent although its commands arrive: a stalled machine delays
/// the thread that sends records, as in a feed.
const TELEMETRY_SILENT_AFTER: Duration = Duration::from_secs(10);
/// Time within which a command arrives from a daemon that runs: 20 periods of 5 ms.
const COMMAND_WITHIN: Duration = Duration::from_millis(100);

/// State owned by the thread of a connection.
pub(crate) struct Desk {
    connection: cdcr_client::Connection,
    obstacles: Option<ObstacleSender>,
    telemetry: Option<TelemetryStream>,
    /// Read while records are late.
    commands: Option<CommandStream>,
}

/// A connection to a running daemon, from cdcr.connect(). Use it in a `with`, or close it. It may be used from any thread; a process that is
/// forked from this one may not use it.
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct Connection {
    worker: Worker<Desk>,
    pub(crate) address: Address,
}

/// Connects to the daemon that controls a robot, and waits at most timeout_s [s] for one that is starting.
///
/// robot: its name; by default CDCR_ROBOT of the environment, or "cdcr". prefix and root: where the daemon is, as its options; by default CDCR_PREFIX and
/// CDCR_ROOT of the environment, or the daemon's defaults.
/// Raises ConnectError if none runs there, or it cannot be reached.
#[pyfunction]
#[pyo3(signature = (robot = None, *, prefix = None, root = None, timeout_s = 1.0))]
pub(crate) fn connect(
    py: Python<'_>,
    robot: Option<String>,
    prefix: Option<&str>,
    root: Option<PathBuf>,
    timeout_s: f64,
) -> PyResult<Connection> {
    let otherwise = Location::from_environment().map_err(ConnectError::from);
    let otherwise = otherwise.map_err(Failure::from)?;
    let prefix = prefix.unwrap_or(otherwise.prefix());
    let root = root.unwrap_or_else(|| otherwise.root().to_owned());
    let location = Location::new(prefix, &root).map_err(ConnectError::from);
    let named = || std::env::var("CDCR_ROBOT").unwrap_or_else(|_| "cdcr".to_owned());
    let address = Address {
        location: location.map_err(Failure::from)?,
        robot: robot.unwrap_or_else(named),
        timeout: seconds("timeout_s", timeout_s)?,
    };
    let at = address.clone();
    let worker = Worker::start(py, "cdcr-client", move || {
        Ok(Desk {
            connection: at.open()?,
            obstacles: None,
            telemetry: None,
            commands: None,
        })
    })?;
    Ok(Connection { worker, address })
}

#[pymethods]
impl Connection {
    /// The newest snapshot of the daemon: a dictionary with the fields of the message Status.
    ///
    /// Raises LinkError if the daemon is silent.
    #[pyo3(signature = (timeout_s = 1.0) -> "Message")]
    fn status<'py>(&self, py: Python<'py>, timeout_s: f64) -> PyResult<Bound<'py, PyDict>> {
        Records::from_message(&*self.snapshot(py, timeout_s)?).into_message(py)
    }

    /// The daemon's robot.
    fn robot(&self, py: Python<'_>) -> PyResult<Robot> {
        let inner = self.model(py)?;
        Ok(Robot { inner })
    }

    /// Requests to follow the reference that is fed. Raises RequestError if the daemon refuses.
    fn track(&self, py: Python<'_>) -> PyResult<()> {
        self.request(py, RequestKind::Track)
    }

    /// Requests to stop following; the position is kept. Raises RequestError if the daemon refuses.
    fn hold(&self, py: Python<'_>) -> PyResult<()> {
        self.request(py, RequestKind::Hold)
    }

    /// Leaves the modes stopped and faulted. Raises RequestError while the cause persists.
    ///
    /// accept_pose: the measured pose is right although it is far from where the last command left the robot, for example after a motion by hand; control begins there.
    /// Without it the daemon refuses such a reset: encoders may have lost their zero.
    #[pyo3(signature = (*, accept_pose = false))]
    fn reset(&self, py: Python<'_>, accept_pose: bool) -> PyResult<()> {
        let response = self
            .worker
            .call_on_thread(py, move |desk| desk.connection.reset(accept_pose))?;
        response.map_err(Failure::from)?;
        Ok(())
    }

    /// Requests to move to the straight robot. Raises RequestError if the daemon refuses.
    fn home(&self, py: Python<'_>) -> PyResult<()> {
        self.request(py, RequestKind::Home)
    }

    /// Stops the robot by any available means, also where this connection hangs or is closed: the daemon's answer, or the signal USR1.
    ///
    /// Raises ConnectError if no daemon runs, and RequestError if nothing confirmed the stop.
    fn stop(&self, py: Python<'_>) -> PyResult<()> {
        let Address {
            location, robot, ..
        } = self.address.clone();
        let stopped = once(py, move || Requester::stop(&location, &robot))?;
        stopped.map_err(Failure::from)?;
        Ok(())
    }

    /// Begins the statistics of the status anew, for all clients.
    fn reset_statistics(&self, py: Python<'_>) -> PyResult<()> {
        self.request(py, RequestKind::ResetStatistics)
    }

    /// The solver's settings in force. Raises LinkError if the daemon is silent.
    fn settings(&self, py: Python<'_>) -> PyResult<Settings> {
        known(&self.wire_settings(py)?)
    }

    /// Changes settings of the solver, by their names, and its time in each cycle, budget_ms [ms], 0: all the remaining period. The others
    /// stay. The daemon uses them from the next cycle on.
    ///
    /// Warns of a safe_distance_m above the present clearance: a tracking robot moves away from the obstacle. Raises ArgumentError for an unknown key and a
    /// value outside its range, RequestError if the daemon refuses.
    #[pyo3(signature = (*, budget_ms = None, **changes: "Unpack[Settings]"))]
    fn change_settings(
        &self,
        py: Python<'_>,
        budget_ms: Option<f64>,
        changes: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<()> {
        self.worker.closed().check()?;
        if budget_ms.is_none() && changes.is_none() {
            return Ok(());
        }
        let rate_weight_auto = || Ok(self.snapshot(py, 1.0)?.rate_weight_auto);
        let before = self.wire_settings(py)?;
        let wire = changed(before, budget_ms, changes, rate_weight_auto)?;
        if wire.safe_distance_m > before.safe_distance_m {
            let status = self.snapshot(py, 1.0)?;
            if let Some(warning) = moves_away(&before, &wire, &status) {
                py.import("warnings")?.call_method1("warn", (warning,))?;
            }
        }
        let changed = self
            .worker
            .call_on_thread(py, move |desk| desk.connection.change_settings(wire))?;
        if let Err(RequestError::Refused {
            outcome: Outcome::OutOfRange,
            ..
        }) = &changed
            && let Ok(status) = self.snapshot(py, 1.0)
            && let Some(bound) = broken_bound(&wire, &status)
        {
            let message = format!("cannot change settings: {bound}");
            return Err(
                Failure::new(Class::Request, message, "Give a value inside the bound.").into(),
            );
        }
        changed.map_err(Failure::from)?;
        Ok(())
    }

    /// Records of the next `seconds` [s]: a structured array, a row for each cycle, with the fields of the message Telemetry.
    ///
    /// Raises LinkError if the daemon has ended, or sends nothing for a second, or only commands for ten; live() gives what came before that.
    #[pyo3(signature = (seconds))]
    fn telemetry(&self, py: Python<'_>, seconds: f64) -> PyResult<Records> {
        let until = until("seconds", seconds)?;
        let mut records = Records::new(Telemetry::LAYOUT);
        let mut heard = self.skip_waiting_records(py)?;
        while Instant::now() < until {
            sleep_until(py, until.min(Instant::now() + FETCH_EACH))?;
            self.fetch(py, &mut records, &mut heard)?;
        }
        let runs = self.address.check_runs(Service::Telemetry, heard.elapsed());
        runs.map_err(Failure::from)?;
        Ok(records)
    }

    /// Iterates over the daemon's records from now on: each step waits batch_s [s] and gives the records since the last one, one at least.
    ///
    /// A program that takes longer than 1.28 s for a step loses records; lost_records() counts them. A step raises LinkError if the daemon sends nothing for a second, or only commands for ten.
    #[pyo3(signature = (batch_s = 0.1))]
    fn live(slf: Bound<'_, Self>, batch_s: f64) -> PyResult<Live> {
        slf.get().worker.closed().check()?;
        let batch = seconds("batch_s", batch_s)?;
        let robot = slf.get().address.robot.clone();
        let connection = slf.unbind();
        let fetch = move |py: Python<'_>, records: &mut Records, heard: &mut Instant| {
            connection.get().fetch(py, records, heard)
        };
        Ok(Live::new(Box::new(fetch), robot, batch))
    }

    /// Records that this connection's telemetry lost, because they were fetched too late.
    fn lost_records(&self, py: Python<'_>) -> PyResult<u64> {
        self.worker
            .call_on_thread(py, |desk| desk.telemetry.as_ref().map_or(0, Stream::lost))
    }

    /// The last bad cycles, at most 64, oldest first: a structured array with the fields of the message Incident.
    ///
    /// timeout_s: how long it waits for them, 0 to 2 s. Raises LinkError if the daemon has ended.
    #[pyo3(signature = (timeout_s = 0.3))]
    fn incidents(&self, py: Python<'_>, timeout_s: f64) -> PyResult<Records> {
        // The thread is blocked for that time.
        let waits = Duration::from_secs_f64(within("timeout_s", timeout_s, 0.0..=2.0)?);
        let found = self.worker.call_on_thread(py, move |desk| {
            let until = Instant::now() + waits;
            let mut records = Records::new(Incident::LAYOUT);
            let mut stream = desk.connection.incidents()?;
            while let Some(incident) =
                stream.next_within(until.saturating_duration_since(Instant::now()))?
            {
                records.push(&incident);
            }
            Ok::<_, Failure>(records)
        })??;
        let runs = self.address.check_runs(Service::Incidents, waits);
        runs.map_err(Failure::from)?;
        Ok(found)
    }

    /// Sends obstacles to the daemon, or replaces those with the same numbers, and waits for its answer.
    ///
    /// obstacles: at most 64 by their numbers (0 to 4294967295), where they are now. lifetime_s: how long they stay known [s]; 0: until they are removed.
    /// far: send also those that are farther away than thirty robot lengths, or are larger than the robot and contain the base; without it they are taken for millimetres, and nothing is sent.
    /// Raises ArgumentError for those, and for more than 64, and RequestError if the daemon refuses them.
    #[pyo3(signature = (obstacles: "Mapping[int, Obstacle]", lifetime_s = 0.0, *, far = false))]
    fn set_obstacles(
        &self,
        py: Python<'_>,
        obstacles: &Bound<'_, PyMapping>,
        lifetime_s: f64,
        far: bool,
    ) -> PyResult<()> {
        let lifetime_ns = seconds("lifetime_s", lifetime_s)?.as_nanos() as u64;
        let measured_ns = cdcr_client::monotonic_ns();
        check_count(obstacles.len()?)?;
        let wire = |(id, obstacle): (i128, Obstacle)| {
            Ok::<_, Failure>(WireObstacle {
                id: count("the number of an obstacle", id, NUMBERS)?,
                measured_ns,
                lifetime_ns,
                ..obstacle.to_wire()
            })
        };
        let obstacles = pairs("obstacles", "whole numbers to Obstacles", obstacles)?;
        let obstacles: Vec<_> = obstacles.into_iter().map(wire).collect::<Result<_, _>>()?;
        self.send_obstacles(py, move |sender| {
            if far {
                sender.upsert_anywhere(&obstacles)
            } else {
                sender.upsert(&obstacles)
            }
        })
    }

    /// Removes obstacles by their numbers. Raises RequestError if the daemon refuses, and after the others are removed for one that it did not know,
    /// unless this ended its wait for the silent source that had sent it.
    #[pyo3(signature = (ids: "Sequence[int]"))]
    fn remove_obstacles(&self, py: Python<'_>, ids: Vec<i128>) -> PyResult<()> {
        check_count(ids.len())?;
        let number = |id: i128| count("the number of an obstacle", id, NUMBERS);
        let ids: Vec<u32> = ids.into_iter().map(number).collect::<Result<_, _>>()?;
        self.remove(py, ids)
    }

    /// Removes all obstacles, those of other clients, too. Raises RequestError if the daemon refuses.
    fn clear_obstacles(&self, py: Python<'_>) -> PyResult<()> {
        self.send_obstacles(py, ObstacleSender::clear)
    }

    /// A feed of points, to be used in a `with`: it begins there, keeps the lease, and at the end gives it back, so that the robot holds.
    ///
    /// t: (k,) [s], xyz: (k, 3) [m], and so on as in Trajectory.from_arrays. track: ask for tracking once the daemon has the first points. lead_s: from the begin of
    /// the `with` to the first point, 0.05 to 60 s. Raises ArgumentError; errors of the daemon are raised in the `with`.
    /// Checks neither speed nor reach nor how near the tip is at the end: docs/python.md shows how to check them.
    #[pyo3(signature = (t, xyz, *, quaternion = None, axis = None, interpolation: "Interpolation" = "cubic", track = true, lead_s = 0.3))]
    #[allow(clippy::too_many_arguments, reason = "each is a name in Python")]
    fn feed(
        &self,
        t: ArrayLike<'_>,
        xyz: ArrayLike<'_>,
        quaternion: Option<ArrayLike<'_>>,
        axis: Option<ArrayLike<'_>>,
        interpolation: &str,
        track: bool,
        lead_s: f64,
    ) -> PyResult<Feed> {
        let points = Points::from_arrays(t, xyz, quaternion, axis, interpolation)?;
        let source = TrajectorySource::Points(std::sync::Arc::new(points));
        Feed::new(self.origin()?, source, track, lead_s)
    }

    /// As feed, of a Trajectory.
    #[pyo3(signature = (trajectory, *, track = true, lead_s = 0.3))]
    fn feed_trajectory(&self, trajectory: &Trajectory, track: bool, lead_s: f64) -> PyResult<Feed> {
        let source = trajectory.source.clone();
        Feed::new(self.origin()?, source, track, lead_s)
    }

    /// A feed of points that are not yet known, to be used in a `with`: send() adds some. Otherwise as feed.
    #[pyo3(signature = (*, interpolation: "Interpolation" = "cubic", track = true))]
    fn stream(&self, interpolation: &str, track: bool) -> PyResult<FeedStream> {
        FeedStream::new(self.origin()?, interpolation, track)
    }

    /// The ports of a driver process. interface: which part of a command it obeys. Raises ConnectError. Of two drivers the daemon refuses the measurements of the second (docs/drivers.md).
    #[pyo3(signature = (interface: "Interface" = "velocity"))]
    fn driver(&self, py: Python<'_>, interface: &str) -> PyResult<DriverPort> {
        let model = self.model(py)?;
        DriverPort::open(
            py,
            &self.address,
            chosen("interface", interface, INTERFACES)?,
            model,
        )
    }

    /// Closes the connection, and gives back everything that it had. Ends its feeds and streams, and waits until the robot holds, at most 4 s. Afterwards everything but stop() raises
    /// LinkError. Closing twice changes nothing.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.worker.close(py)
    }

    fn __enter__(slf: Py<Self>) -> PyResult<Py<Self>> {
        refuse_forked_process()?;
        slf.get().worker.closed().check()?;
        Ok(slf)
    }

    #[pyo3(signature = (_kind: "object" = None, _error: "object" = None, _trace: "object" = None, /))]
    fn __exit__(
        &self,
        py: Python<'_>,
        _kind: Option<Py<PyAny>>,
        _error: Option<Py<PyAny>>,
        _trace: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        self.worker.close(py)
    }

    fn __repr__(&self) -> String {
        format!("<Connection to {}>", self.address.robot)
    }
}

impl Connection {
    /// For a feed or stream of this connection, while it is open.
    fn origin(&self) -> Result<(Address, Closed), Failure> {
        let closed = self.worker.closed();
        closed.check()?;
        Ok((self.address.clone(), closed.clone()))
    }

    fn snapshot(&self, py: Python<'_>, timeout_s: f64) -> PyResult<Box<Status>> {
        let (begin, until) = (Instant::now(), until("timeout_s", timeout_s)?);
        let status = self.worker.poll_on_thread(py, until, |desk, slice| {
            match desk.connection.status(slice) {
                Err(LinkError::Silent { liveness, .. }) if liveness != Liveness::Replaced => {
                    Ok(None)
                }
                status => Ok(Some(Box::new(status?))),
            }
        })?;
        let silent = || Failure::from(self.address.silent(Service::Status, begin.elapsed()));
        Ok(status.ok_or_else(silent)?)
    }

    fn model(&self, py: Python<'_>) -> PyResult<Model> {
        let status = self.snapshot(py, 1.0)?;
        let model = cdcr_client::model::robot_of(&status.robot);
        Ok(model.map_err(Failure::from)?)
    }

    fn request(&self, py: Python<'_>, kind: RequestKind) -> PyResult<()> {
        let response = self
            .worker
            .call_on_thread(py, move |desk| desk.connection.request(kind))?;
        response.map_err(Failure::from)?;
        Ok(())
    }

    fn wire_settings(&self, py: Python<'_>) -> PyResult<SolverSettings> {
        let settings = self
            .worker
            .call_on_thread(py, |desk| desk.connection.settings())?;
        Ok(settings.map_err(Failure::from)?)
    }

    /// Adds the pending records. `heard`: time of the last one.
    fn fetch(&self, py: Python<'_>, records: &mut Records, heard: &mut Instant) -> PyResult<()> {
        let fetched = self.worker.call_on_thread(py, |desk| {
            let mut fetched = Records::new(Telemetry::LAYOUT);
            let stream = match &mut desk.telemetry {
                Some(stream) => stream,
                none => none.insert(desk.connection.telemetry()?),
            };
            while let Some(record) = stream.try_next()? {
                fetched.push(&record);
                desk.commands = None;
            }
            Ok::<_, Failure>(fetched)
        })??;
        if fetched.count() > 0 {
            *heard = Instant::now();
        } else if heard.elapsed() > TELEMETRY_SILENT_AFTER
            || heard.elapsed() > SILENT_AFTER && !self.sends_commands(py)?
        {
            let waited = heard.elapsed();
            let silent = self.worker.call_on_thread(py, move |desk| {
                desk.connection.silent(Service::Telemetry, waited)
            })?;
            return Err(Failure::from(silent).into());
        }
        records.append(fetched);
        Ok(())
    }

    /// Whether commands arrive. They come from another thread of the daemon than the records.
    fn sends_commands(&self, py: Python<'_>) -> PyResult<bool> {
        let newest = self.worker.call_on_thread(py, |desk| {
            let commands = match &mut desk.commands {
                Some(commands) => commands,
                none => none.insert(desk.connection.commands()?),
            };
            let waiting = commands.newest()?;
            waiting.map_or_else(
                || commands.next_within(COMMAND_WITHIN),
                |command| Ok(Some(command)),
            )
        })?;
        Ok(newest.is_ok_and(|command| command.is_some()))
    }

    /// Discards the pending records, and returns the time after which records are new.
    fn skip_waiting_records(&self, py: Python<'_>) -> PyResult<Instant> {
        let mut heard = Instant::now();
        self.fetch(py, &mut Records::new(Telemetry::LAYOUT), &mut heard)?;
        Ok(Instant::now())
    }
}
