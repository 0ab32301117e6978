use std::ops::RangeInclusive;
use std::time::Instant;

use cdcr_client::{CommandedPosition, Driver, monotonic_ns};
use cdcr_controller::robot::Robot as Model;
use cdcr_shared_types::codes::{Interface, MeasurementKind};
use cdcr_shared_types::limits::{CABLES_MAX, COORDINATES_MAX};
use cdcr_shared_types::{Measurement, Service};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::address::Address;
use crate::arrays::{ArrayLike, Doubles, Numbers};
use crate::errors::Failure;
use crate::numbers::{count, until};
use crate::robot::Robot;
use crate::wire::Records;
use crate::worker::{Worker, refuse_forked_process};

/// Times of the clock [ns].
const TIMES_NS: RangeInclusive<u64> = 0..=u64::MAX;

/// The ports of a driver process, from Connection.driver(): it sends what the robot measures and follows what the daemon commands. Use it in
/// a `with`, or close it. The daemon commands nothing before a first measurement. A driver refuses commands that this robot must not follow, and counts them.
#[pyclass(frozen, module = "cdcr", name = "Driver")]
pub(crate) struct DriverPort {
    worker: Worker<Driver>,
    address: Address,
    robot: Robot,
}

impl DriverPort {
    pub(crate) fn open(
        py: Python<'_>,
        address: &Address,
        interface: Interface,
        model: Model,
    ) -> PyResult<Self> {
        let at = address.clone();
        let worker = Worker::start(py, "cdcr-driver", move || {
            let opened = Driver::connect_within(&at.location, &at.robot, interface, at.timeout);
            Ok(opened?)
        })?;
        Ok(Self {
            worker,
            address: address.clone(),
            robot: Robot { inner: model },
        })
    }

    fn lengths_m(&self, lengths: &ArrayLike<'_>) -> PyResult<[f64; CABLES_MAX]> {
        let (name, cables) = ("cable_length", self.robot.inner.cable_count());
        let numbers = Numbers::exact(lengths, name, 1, &[cables], "3 cables for each section")?;
        let numbers = numbers.finite(name)?;
        let mut lengths_m = [0.0; CABLES_MAX];
        lengths_m[..cables].copy_from_slice(numbers.values());
        Ok(lengths_m)
    }
}

#[pymethods]
impl DriverPort {
    /// Sends a measurement: one of cable_length (3 n,) [m], bend (2 n,) [rad] and tip (3,) [m].
    ///
    /// measured_ns: when it was measured [ns, CLOCK_MONOTONIC, as time.monotonic_ns()]; now if left out.
    /// Raises ArgumentError for wrong shapes, NaN, and other than one measurement.
    #[pyo3(signature = (*, cable_length = None, bend = None, tip = None, measured_ns = None))]
    fn send(
        &self,
        py: Python<'_>,
        cable_length: Option<ArrayLike<'_>>,
        bend: Option<ArrayLike<'_>>,
        tip: Option<ArrayLike<'_>>,
        measured_ns: Option<i128>,
    ) -> PyResult<()> {
        let measured_ns = measured_ns.map(|time_ns| count("measured_ns", time_ns, TIMES_NS));
        let mut measurement = Measurement {
            measured_ns: measured_ns.transpose()?.unwrap_or_else(monotonic_ns),
            sections: self.robot.inner.section_count() as u32,
            ..Measurement::default()
        };
        let kind = match (cable_length, bend, tip) {
            (Some(lengths), None, None) => {
                measurement.cable_length_m = self.lengths_m(&lengths)?;
                MeasurementKind::CableLengths
            }
            (None, Some(bend), None) => {
                let bends = self.robot.configuration(&bend, "bend")?;
                measurement.bend_rad[..bends.as_slice().len()].copy_from_slice(bends.as_slice());
                MeasurementKind::Configuration
            }
            (None, None, Some(tip)) => {
                measurement.tip_position_m = crate::arrays::triple(&tip, "tip")?;
                measurement.tip_orientation = [0.0, 0.0, 0.0, 1.0];
                MeasurementKind::TipPose
            }
            _ => {
                return Err(Failure::argument(
                    "none or more than one of cable_length, bend and tip is given",
                    "Send one at a time.",
                )
                .into());
            }
        };
        measurement.kind = kind.code();
        let sent = self
            .worker
            .call_on_thread(py, move |driver| driver.send(measurement))?;
        sent.map_err(Failure::from)?;
        Ok(())
    }

    /// The next command that is taken: a dictionary with the fields of the message Command, or None when none came within timeout_s [s].
    ///
    /// Raises LinkError when none came because the daemon has ended. The ports stay open, and take the commands of the daemon that is started next.
    #[pyo3(signature = (timeout_s = 1.0) -> "Message | None")]
    fn next_command<'py>(
        &self,
        py: Python<'py>,
        timeout_s: f64,
    ) -> PyResult<Option<Bound<'py, PyDict>>> {
        let (begin, until) = (Instant::now(), until("timeout_s", timeout_s)?);
        let command = self
            .worker
            .poll_on_thread(py, until, |driver, slice| Ok(driver.next_command(slice)?))?;
        if let Some(command) = command {
            return Records::from_message(&command).into_message(py).map(Some);
        }
        let runs = self.address.check_runs(Service::Command, begin.elapsed());
        runs.map_err(Failure::from)?;
        Ok(None)
    }

    /// How fast the cables shall run now [m/s]: (3 n,), zero before the first command and after the newest one has run out. Takes all commands that wait.
    fn cable_speeds(&self, py: Python<'_>) -> PyResult<Doubles> {
        let cables = self.robot.inner.cable_count();
        let speeds = self.worker.call_on_thread(py, |driver| {
            driver.update()?;
            Ok::<_, Failure>(driver.rates_at(monotonic_ns()).cable_speed_m_s)
        })??;
        Ok(Doubles::new(&[cables], &[], speeds[..cables].to_vec()))
    }

    /// How long the cables shall be now [m]: (3 n,), or None before the first command and until the reset of a robot that is Stopped or Faulted then: the motors hold. Takes all commands that wait.
    fn cable_lengths(&self, py: Python<'_>) -> PyResult<Option<Doubles>> {
        let cables = self.robot.inner.cable_count();
        let position = self.worker.call_on_thread(py, |driver| {
            driver.update()?;
            Ok::<_, Failure>(driver.position_at(monotonic_ns()))
        })??;
        Ok(position.map(|at| Doubles::new(&[cables], &[], at.cable_length_m[..cables].to_vec())))
    }

    /// States where motors that obey positions stand before the first command: cable_length (3 n,) [m], the last cable_lengths() that this driver gave them before it was
    /// started again. They stay there, and keep their distance from the robot, which a load has bent; without it they move to where the robot is measured.
    ///
    /// Do not call it where the motors were without torque. A first command more than 0.2 rad from it is refused.
    /// Raises ArgumentError for wrong shapes, NaN, a place beyond the limits of the robot, and after the first command.
    fn stand_at(&self, py: Python<'_>, cable_length: ArrayLike<'_>) -> PyResult<()> {
        let cable_length_m = self.lengths_m(&cable_length)?;
        let bends = self.robot.inner.bend_from_cable_lengths(&cable_length_m);
        let bends = bends.as_slice();
        let mut bend_rad = [0.0; COORDINATES_MAX];
        bend_rad[..bends.len()].copy_from_slice(bends);
        let place = CommandedPosition {
            bend_rad,
            cable_length_m,
        };
        let stated = self
            .worker
            .call_on_thread(py, move |driver| driver.stand_at(place))?;
        let remedy = "Give the last cable_lengths() of the driver before [m], before this one sends its first measurement.";
        Ok(stated.map_err(|refusal| Failure::argument(refusal, remedy))?)
    }

    /// Rests until the next command, which is then treated as the first and must match the last measurement. For motors whose torque was off: call it after the reset, before they follow again. Commands that wait are dropped.
    fn forget(&self, py: Python<'_>) -> PyResult<()> {
        self.worker.call_on_thread(py, |driver| {
            driver.update()?;
            driver.forget();
            Ok::<_, Failure>(())
        })??;
        Ok(())
    }

    /// Commands that were refused since the beginning.
    fn refusals(&self, py: Python<'_>) -> PyResult<u64> {
        self.worker.call_on_thread(py, |driver| driver.refusals())
    }

    /// Why the newest of them was refused, or None.
    fn last_refusal(&self, py: Python<'_>) -> PyResult<Option<String>> {
        let refusal = self
            .worker
            .call_on_thread(py, |driver| driver.last_refusal())?;
        Ok(refusal.map(|refusal| refusal.to_string()))
    }

    /// The robot of the daemon.
    #[getter]
    fn robot(&self) -> Robot {
        self.robot.clone()
    }

    /// Closes the ports. Closing twice changes nothing.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.worker.close(py)
    }

    fn __enter__(slf: Py<Self>) -> PyResult<Py<Self>> {
        refuse_forked_process()?;
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
        format!("<Driver of {}>", self.address.robot)
    }
}
