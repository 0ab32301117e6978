//! Trajectories: the curves of `cdcr_client`, and points interpolated as in the daemon.

use std::sync::Arc;

use cdcr_client::model::orientation_of;
use cdcr_client::{
    self, Circle, DURATION_MAX_S, Figure, FigurePlane, FigureShape, Line, Orientation, Spiral,
};
use cdcr_controller::reference::{
    self, Interpolation, ReferencePoint, ReferenceSample, ReferenceState,
};
use cdcr_shared_types::codes;
use pyo3::prelude::*;

use crate::arrays::{ArrayLike, Doubles, Numbers, triple};
use crate::errors::Failure;
use crate::numbers::{count, within};
use crate::robot::Robot;
use crate::words::{INTERPOLATIONS, chosen};

/// A curve that can be fed or simulated.
pub(crate) type Curve = dyn cdcr_client::Trajectory + Send + Sync;

/// Smallest and largest radius and speed of a curve (m, m/s).
const SMALLEST: f64 = 1e-6;
const LARGEST: f64 = 1e6;

/// Longest time between two points \[s\]: the daemon takes points that are a day ahead at most, and `lead_s`, 60 s at most, comes before the first.
const GAP_MAX_S: f64 = DURATION_MAX_S - 120.0;

/// What the tip shall follow: a curve in time, which counts from its start. Immutable.
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct Trajectory {
    pub(crate) source: TrajectorySource,
}

#[derive(Clone)]
pub(crate) enum TrajectorySource {
    Curve(Arc<Curve>),
    Points(Arc<Points>),
}

/// Points in time, the first at 0.
pub(crate) struct Points {
    times_s: Vec<f64>,
    buffer: reference::Trajectory,
    orientations: Vec<Orientation>,
    interpolation: Interpolation,
}

#[pymethods]
impl Trajectory {
    /// The paper's spiral (Eq. 8), 4.97 s long, in the workspace of the last section.
    #[staticmethod]
    fn spiral(robot: &Robot) -> Self {
        Self::curve(Spiral::for_sections(&lengths_m(robot)))
    }

    /// The paper's line (Eq. 9), from the tip of the straight robot, 2.55 s long.
    #[staticmethod]
    fn line(robot: &Robot) -> Self {
        Self::curve(Line::for_sections(&lengths_m(robot)))
    }

    /// The paper's circle, 6.28 s long.
    #[staticmethod]
    fn circle(robot: &Robot) -> Self {
        Self::curve(Circle::for_sections(&lengths_m(robot)))
    }

    /// A screw line about the vertical at an even speed; every other round goes back.
    ///
    /// centre_m: (3,) [m]. radius_m: 1e-6 to 1e6 m. rise_m: from end to end, -1e6 to 1e6 m. speed_m_s: 1e-6 to 1e6 m/s. turns: 1 to 100, from end to end.
    /// rounds: 1 to 4294967295. Raises ArgumentError for a value outside its range.
    #[staticmethod]
    #[pyo3(signature = (centre_m, radius_m, *, rise_m, speed_m_s, turns = 1, rounds = 1))]
    fn helix(
        centre_m: ArrayLike<'_>,
        radius_m: f64,
        rise_m: f64,
        speed_m_s: f64,
        turns: i128,
        rounds: i128,
    ) -> PyResult<Self> {
        within("radius_m", radius_m, SMALLEST..=LARGEST)?;
        within("speed_m_s", speed_m_s, SMALLEST..=LARGEST)?;
        let turns = count("turns", turns, 1..=100_u32)?;
        let rounds = count("rounds", rounds, 1..=u32::MAX)?;
        within("rise_m", rise_m, -LARGEST..=LARGEST)?;
        let rise = rise_m / radius_m;
        let shape = FigureShape::Helix { turns, rise };
        let centre_m = triple(&centre_m, "centre_m")?;
        let place = (centre_m, radius_m);
        Ok(Self::curve(Figure::new(
            shape,
            FigurePlane::Xy,
            place,
            speed_m_s,
            rounds,
        )))
    }

    /// Points of your own.
    ///
    /// t: (k,) [s], increasing by 1 µs at least, by 86280 s at most, a day long at most; time counts from the first. xyz: (k, 3) [m], base frame. quaternion: (k, 4), x, y, z, w, of unit
    /// length, or axis: (k, 3), a unit vector, if the tip's orientation counts. interpolation: "cubic" or "linear".
    /// Raises ArgumentError for wrong shapes, NaN, times that do not increase, and what is not of unit length.
    #[staticmethod]
    #[pyo3(signature = (t, xyz, *, quaternion = None, axis = None, interpolation: "Interpolation" = "cubic"))]
    fn from_arrays(
        t: ArrayLike<'_>,
        xyz: ArrayLike<'_>,
        quaternion: Option<ArrayLike<'_>>,
        axis: Option<ArrayLike<'_>>,
        interpolation: &str,
    ) -> PyResult<Self> {
        let points = Points::from_arrays(t, xyz, quaternion, axis, interpolation)?;
        Ok(Self {
            source: TrajectorySource::Points(Arc::new(points)),
        })
    }

    /// How long it lasts [s].
    #[getter]
    fn duration_s(&self) -> f64 {
        self.source.curve().duration_s()
    }

    /// Positions [m], base frame, at these times [s]; before and after the curve that of its nearer end.
    ///
    /// t: any shape. Returns (..., 3).
    #[pyo3(signature = (t))]
    fn position(&self, t: ArrayLike<'_>) -> PyResult<Doubles> {
        let times = Numbers::with_tail(&t, "t", &[], "times")?.finite("t")?;
        let positions = times
            .values()
            .iter()
            .map(|time_s| self.source.curve().position_m(*time_s));
        Ok(Doubles::new(
            times.lead(),
            &[3],
            positions.flatten().collect(),
        ))
    }

    fn __repr__(&self) -> String {
        let curve = self.source.curve();
        format!(
            "<Trajectory {} of {:.2} s>",
            curve.name(),
            curve.duration_s()
        )
    }
}

impl Trajectory {
    fn curve(curve: impl cdcr_client::Trajectory + Send + Sync + 'static) -> Self {
        Self {
            source: TrajectorySource::Curve(Arc::new(curve)),
        }
    }
}

impl TrajectorySource {
    pub(crate) fn curve(&self) -> &Curve {
        match self {
            Self::Curve(curve) => curve.as_ref(),
            Self::Points(points) => points.as_ref(),
        }
    }

    pub(crate) fn interpolation(&self) -> Interpolation {
        match self {
            Self::Curve(_) => Interpolation::Cubic,
            Self::Points(points) => points.interpolation,
        }
    }

    /// The reference at a time, as used by a solve.
    pub(crate) fn sample(&self, time_s: f64) -> ReferenceSample {
        match self {
            Self::Curve(curve) => ReferenceSample {
                state: ReferenceState::Inside,
                position_m: curve.position_m(time_s).into(),
                orientation: orientation_of(curve.orientation(time_s)),
            },
            Self::Points(points) => points.buffer.sample(to_ns(time_s)),
        }
    }
}

impl Points {
    pub(crate) fn from_arrays(
        t: ArrayLike<'_>,
        xyz: ArrayLike<'_>,
        quaternion: Option<ArrayLike<'_>>,
        axis: Option<ArrayLike<'_>>,
        interpolation: &str,
    ) -> PyResult<Self> {
        let times = Numbers::exact(&t, "t", 1, &[], "a time for each point")?.finite("t")?;
        let positions =
            Numbers::exact(&xyz, "xyz", 2, &[3], "x, y, z of each point")?.finite("xyz")?;
        let count = positions.count();
        if count == 0 || times.count() != count {
            let found = times.count();
            return Err(Failure::argument(
                format!("t has the shape ({found},) and xyz ({count}, 3)"),
                "Give one time for each point, and one point at least.",
            )
            .into());
        }
        let interpolation = chosen("interpolation", interpolation, INTERPOLATIONS)?;
        let orientations = orientations(quaternion, axis, count)?;
        let begin_s = times.values()[0];
        let times_s: Vec<f64> = times
            .values()
            .iter()
            .map(|time_s| time_s - begin_s)
            .collect();
        let lasts_s = times_s[count - 1];
        within(
            "the time from the first t to the last",
            lasts_s,
            0.0..=DURATION_MAX_S,
        )?;
        let gaps_s = times_s.windows(2).map(|pair| pair[1] - pair[0]);
        let longest_s = gaps_s.fold(0.0, f64::max);
        within(
            "the time from one t to the next",
            longest_s,
            0.0..=GAP_MAX_S,
        )?;
        let points = times_s
            .iter()
            .zip(positions.values().chunks_exact(3))
            .zip(&orientations);
        let point =
            |((time_s, place), orientation): ((&f64, &[f64]), &Orientation)| ReferencePoint {
                time_ns: to_ns(*time_s),
                position_m: [place[0], place[1], place[2]].into(),
                orientation: orientation_of(*orientation),
                interpolation,
            };
        let mut buffer = reference::Trajectory::with_capacity(count, f64::INFINITY);
        buffer.replace(points.map(point)).map_err(|error| {
            Failure::argument(
                format!("t: {error}"),
                "Give times that increase by 1 µs at least.",
            )
        })?;
        Ok(Self {
            times_s,
            buffer,
            orientations,
            interpolation,
        })
    }
}

impl cdcr_client::Trajectory for Points {
    fn name(&self) -> &'static str {
        "of points"
    }

    fn duration_s(&self) -> f64 {
        self.times_s.last().copied().unwrap_or_default()
    }

    fn position_m(&self, time_s: f64) -> [f64; 3] {
        self.buffer.sample(to_ns(time_s)).position_m.into()
    }

    /// Called only at the times of the points.
    fn orientation(&self, time_s: f64) -> Orientation {
        let at = self.times_s.partition_point(|known_s| *known_s < time_s);
        self.orientations[at.min(self.orientations.len() - 1)]
    }

    fn knots_s(&self) -> Option<&[f64]> {
        Some(&self.times_s)
    }
}

/// Orientations of `count` points, from one of two arrays.
pub(crate) fn orientations(
    quaternion: Option<ArrayLike<'_>>,
    axis: Option<ArrayLike<'_>>,
    count: usize,
) -> PyResult<Vec<Orientation>> {
    let (value, name, width) = match (quaternion, axis) {
        (None, None) => return Ok(vec![Orientation::Free; count]),
        (Some(quaternion), None) => (quaternion, "quaternion", 4),
        (None, Some(axis)) => (axis, "axis", 3),
        (Some(_), Some(_)) => {
            return Err(Failure::argument(
                "both quaternion and axis are given",
                "Give one of them.",
            )
            .into());
        }
    };
    let numbers =
        Numbers::exact(&value, name, 2, &[width], "one row for each point")?.finite(name)?;
    if numbers.count() != count {
        let found = numbers.count();
        return Err(Failure::argument(
            format!("{name} has the shape ({found}, {width}); needed is ({count}, {width}): one row for each point"),
            "Give as many rows as there are points.",
        )
        .into());
    }
    let orientation = |row: &[f64]| match *row {
        [x, y, z, w] => Orientation::Full([x, y, z, w]),
        _ => Orientation::Axis([row[0], row[1], row[2]]),
    };
    let rows = numbers.values().chunks_exact(width);
    // With the daemon's tolerance.
    let is_unit = |row: &[f64]| (row.iter().map(|x| x * x).sum::<f64>().sqrt() - 1.0).abs() < 1e-6;
    if let Some(at) = rows.clone().position(|row| !is_unit(row)) {
        return Err(Failure::argument(
            format!("row {at} of {name} is not of unit length"),
            "Normalise each row.",
        )
        .into());
    }
    Ok(rows.map(orientation).collect())
}

fn to_ns(time_s: f64) -> u64 {
    (time_s * 1e9).round() as u64
}

fn lengths_m(robot: &Robot) -> Vec<f64> {
    robot
        .inner
        .sections()
        .iter()
        .map(|section| section.length_m)
        .collect()
}

/// The code of an interpolation in messages.
pub(crate) fn wire_interpolation(interpolation: Interpolation) -> codes::Interpolation {
    match interpolation {
        Interpolation::Linear => codes::Interpolation::Linear,
        Interpolation::Cubic => codes::Interpolation::Cubic,
    }
}
