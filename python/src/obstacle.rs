use cdcr_controller::nmpc::OBSTACLES_MAX;
use cdcr_controller::robot::{self, Shape};
use pyo3::prelude::*;

use crate::arrays::{ArrayLike, Doubles, triple};
use crate::errors::Failure;
use crate::numbers::{SECONDS, within};

/// An obstacle, of which the body must stay clear: a sphere, or a capsule (all points within a radius of a segment), in the base frame.
#[pyclass(frozen, module = "cdcr", from_py_object)]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Obstacle {
    pub(crate) inner: robot::Obstacle,
}

#[pymethods]
impl Obstacle {
    /// All points within a radius of a centre.
    ///
    /// centre_m: (3,) [m], base frame. radius_m: 0 to 1e6 m. velocity_m_s: (3,) [m/s], constant.
    /// Raises ArgumentError for numbers outside their ranges.
    #[staticmethod]
    #[pyo3(signature = (centre_m, radius_m, velocity_m_s = None))]
    fn sphere(
        centre_m: ArrayLike<'_>,
        radius_m: f64,
        velocity_m_s: Option<ArrayLike<'_>>,
    ) -> PyResult<Self> {
        let centre_m = triple(&centre_m, "centre_m")?.into();
        Self::from_shape(Shape::Sphere { centre_m }, radius_m, velocity_m_s)
    }

    /// A cylinder with round ends.
    ///
    /// start_m, end_m: (3,) [m], the ends of its axis in the base frame. radius_m: 0 to 1e6 m. velocity_m_s: (3,) [m/s], constant.
    /// Raises ArgumentError for numbers outside their ranges.
    #[staticmethod]
    #[pyo3(signature = (start_m, end_m, radius_m, velocity_m_s = None))]
    fn capsule(
        start_m: ArrayLike<'_>,
        end_m: ArrayLike<'_>,
        radius_m: f64,
        velocity_m_s: Option<ArrayLike<'_>>,
    ) -> PyResult<Self> {
        let shape = Shape::Capsule {
            start_m: triple(&start_m, "start_m")?.into(),
            end_m: triple(&end_m, "end_m")?.into(),
        };
        Self::from_shape(shape, radius_m, velocity_m_s)
    }

    /// Radius around the axis [m].
    #[getter]
    fn radius_m(&self) -> f64 {
        self.inner.radius_m()
    }

    /// Ends of the axis [m], (2, 3), base frame; of a sphere both are its centre.
    #[getter]
    fn axis_m(&self) -> Doubles {
        let [start_m, end_m] = self.axis();
        Doubles::new(&[2], &[3], [start_m, end_m].concat())
    }

    /// Velocity [m/s], (3,).
    #[getter]
    fn velocity_m_s(&self) -> Doubles {
        Doubles::new(&[3], &[], self.inner.velocity_m_s().as_slice().to_vec())
    }

    /// The obstacle dt_s later, -1e9 to 1e9 s.
    fn moved(&self, dt_s: f64) -> PyResult<Self> {
        let most_s = *SECONDS.end();
        let inner = self.inner.moved(within("dt_s", dt_s, -most_s..=most_s)?);
        Ok(Self { inner })
    }

    /// For pickle and copy: the arguments that make the same obstacle.
    #[pyo3(signature = () -> "tuple[Any, ...]")]
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Py<PyAny>,))> {
        let [start_m, end_m] = self.axis();
        let (radius_m, velocity_m_s) = (self.inner.radius_m(), self.inner.velocity_m_s().into());
        let velocity_m_s: [f64; 3] = velocity_m_s;
        // Pickle cannot find a static method of a Rust class by its name.
        let caller = py.import("operator")?.getattr("methodcaller")?;
        let maker = match self.inner.shape() {
            Shape::Sphere { .. } => caller.call1(("sphere", start_m, radius_m, velocity_m_s)),
            Shape::Capsule { .. } => {
                caller.call1(("capsule", start_m, end_m, radius_m, velocity_m_s))
            }
        };
        Ok((maker?, (py.get_type::<Self>().into_any().unbind(),)))
    }

    fn __repr__(&self) -> String {
        let [start_m, end_m] = self.axis();
        let (radius_m, velocity_m_s) = (self.inner.radius_m(), self.inner.velocity_m_s());
        let velocity_m_s = velocity_m_s.as_slice();
        match self.inner.shape() {
            Shape::Sphere { .. } => {
                format!("Obstacle.sphere({start_m:?}, {radius_m:?}, {velocity_m_s:?})")
            }
            Shape::Capsule { .. } => {
                format!("Obstacle.capsule({start_m:?}, {end_m:?}, {radius_m:?}, {velocity_m_s:?})")
            }
        }
    }
}

impl Obstacle {
    fn from_shape(
        shape: Shape,
        radius_m: f64,
        velocity_m_s: Option<ArrayLike<'_>>,
    ) -> PyResult<Self> {
        let velocity_m_s = velocity_m_s
            .map(|value| triple(&value, "velocity_m_s"))
            .transpose()?
            .unwrap_or_default();
        let inner =
            robot::Obstacle::new(shape, radius_m, velocity_m_s.into()).map_err(Failure::from)?;
        Ok(Self { inner })
    }

    /// Fields of the message, without number, time and lifetime.
    pub(crate) fn to_wire(self) -> cdcr_shared_types::Obstacle {
        (&self.inner).into()
    }

    fn axis(&self) -> [[f64; 3]; 2] {
        match self.inner.shape() {
            Shape::Sphere { centre_m } => [(*centre_m).into(); 2],
            Shape::Capsule { start_m, end_m } => [(*start_m).into(), (*end_m).into()],
        }
    }
}

/// Obstacles of the controller.
pub(crate) fn inner(obstacles: &[Obstacle]) -> Result<Vec<robot::Obstacle>, Failure> {
    check_count(obstacles.len())?;
    Ok(obstacles.iter().map(|obstacle| obstacle.inner).collect())
}

/// Rejects more obstacles than controller and daemon can hold, instead of ignoring them.
pub(crate) fn check_count(found: usize) -> Result<(), Failure> {
    if found <= OBSTACLES_MAX {
        return Ok(());
    }
    Err(Failure::argument(
        format!("there are {found} obstacles; allowed are {OBSTACLES_MAX} at most"),
        "Leave out those that are farthest from the robot, or cover several by one capsule.",
    ))
}
