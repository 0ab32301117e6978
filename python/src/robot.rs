use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::thread;

use cdcr_controller::robot::{
    self, CABLES_MAX, Configuration, Jacobian, RobotParameters, SECTIONS_MAX, SectionParameters,
    ZyxAngles, quaternion_xyzw,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use serde::Deserialize;
use toml::Value;

use crate::arrays::{ArrayLike, Doubles, Numbers, shape_text};
use crate::errors::{Failure, REPORT};
use crate::numbers::count;
use crate::obstacle::{Obstacle, inner};
use crate::settings::read;
use crate::words::{FORMS, Form, chosen};

/// Configurations that one thread computes before it takes the next block.
const BLOCK: usize = 1024;
/// Up to this number, a second thread is not worthwhile.
const ALONE_MAX: usize = 4096;
/// Largest number for one shape: 2.4 MB.
const BACKBONE_POINTS_MAX: u32 = 100_000;

type Accessor = fn(&mut SectionParameters) -> &mut f64;

/// The numbers of a section, by the names of the arguments.
const PLACES: [(&str, Accessor); 6] = [
    ("length_m", |section| &mut section.length_m),
    ("cable_radius_m", |section| &mut section.cable_radius_m),
    ("cable_offset_rad", |section| &mut section.cable_offset_rad),
    ("bend_max_rad", |section| &mut section.bend_max_rad),
    ("rate_max_rad_s", |section| &mut section.rate_max_rad_s),
    ("body_radius_m", |section| &mut section.body_radius_m),
];

/// A robot: 1 to 6 sections that bend into circular arcs, each under three cables.
///
/// Bends are bend vectors (u, v) = θ (cos φ, sin φ) [rad] of each section, base first: arrays whose last axis is 2 n long. Every
/// function takes any number of axes before that and computes all configurations in one call; NaN in gives NaN out.
/// A robot is immutable, and may be used from any thread.
#[pyclass(frozen, module = "cdcr", from_py_object)]
#[derive(Debug, Clone)]
pub(crate) struct Robot {
    pub(crate) inner: robot::Robot,
}

#[pymethods]
impl Robot {
    /// A robot by its numbers; what is left out is the paper's robot. A single number counts for every section; there are as many
    /// sections as the longest list has numbers.
    ///
    /// length_m: backbone of a section, 0.001 to 10 m. cable_radius_m: cables from the backbone, 0.0001 to 1 m. cable_offset_rad: angle of
    /// the first cable, -2π to 2π rad (40° more from section to section if left out). bend_max_rad: 0.01 to π rad. rate_max_rad_s: of
    /// each bend component, 0.001 to 100 rad/s. body_radius_m: 0 to 1 m. cable_speed_max_m_s and cable_stroke_max_m: 0.0001 to 100.
    /// tip_speed_max_m_s: of the end of each section, 0.001 to 100 m/s; 0: no limit. self_overlap_max_m: overlap of two
    /// parts of the body that a command may lead to, 0 to 2 m; as much as the body is thick: no check.
    /// Raises ArgumentError for a value outside its range and for lists of different lengths.
    #[new]
    #[pyo3(signature = (
        length_m = None, *, cable_radius_m = None, cable_offset_rad = None,
        bend_max_rad = None, rate_max_rad_s = None, body_radius_m = None,
        cable_speed_max_m_s = 0.5, cable_stroke_max_m = 0.25, tip_speed_max_m_s = 0.0, self_overlap_max_m = 0.002,
    ))]
    #[allow(clippy::too_many_arguments, reason = "each is a name in Python")]
    fn new(
        length_m: Option<ArrayLike<'_>>,
        cable_radius_m: Option<ArrayLike<'_>>,
        cable_offset_rad: Option<ArrayLike<'_>>,
        bend_max_rad: Option<ArrayLike<'_>>,
        rate_max_rad_s: Option<ArrayLike<'_>>,
        body_radius_m: Option<ArrayLike<'_>>,
        cable_speed_max_m_s: f64,
        cable_stroke_max_m: f64,
        tip_speed_max_m_s: f64,
        self_overlap_max_m: f64,
    ) -> PyResult<Self> {
        let is_counted = length_m.is_some();
        let given = [
            length_m,
            cable_radius_m,
            cable_offset_rad,
            bend_max_rad,
            rate_max_rad_s,
            body_radius_m,
        ];
        let mut lists = Vec::new();
        for ((name, place), value) in PLACES.into_iter().zip(given) {
            if let Some(value) = value {
                lists.push((name, list(value, name)?, place));
            }
        }
        let sections = lists.iter().map(|(_, list, _)| list.len()).max();
        // The paper's longest robot has three sections; single numbers do not determine their count.
        let sections = sections
            .filter(|sections| *sections > 1 || is_counted)
            .unwrap_or(3);
        let mut parameters = RobotParameters {
            cable_speed_max_m_s,
            cable_stroke_max_m,
            tip_speed_max_m_s,
            self_overlap_max_m,
            ..RobotParameters::paper(sections)
        };
        for (name, list, place) in lists {
            if list.len() != 1 && list.len() != sections {
                let found = list.len();
                return Err(Failure::argument(
                    format!("{name} has {found} numbers, another list {sections}"),
                    "Give one number for each section, or one for all.",
                )
                .into());
            }
            for (section, value) in parameters.sections.iter_mut().zip(list.iter().cycle()) {
                *place(section) = *value;
            }
        }
        Self::from_parameters(&parameters)
    }

    /// The paper's robot: sections of 0.3 m, cables at 12.5 mm. sections: 1 to 6.
    #[staticmethod]
    #[pyo3(signature = (sections = 3))]
    fn paper(sections: i128) -> PyResult<Self> {
        let sections: u8 = count("sections", sections, 1..=SECTIONS_MAX as u8)?;
        Self::from_parameters(&RobotParameters::paper(sections.into()))
    }

    /// The robot in the table `[robot]` of a configuration of cdcrd.
    ///
    /// Raises ArgumentError for a file that is not a configuration, an unknown key, and a value outside its range.
    #[staticmethod]
    fn from_toml(path: PathBuf) -> PyResult<Self> {
        // Values of the default configuration for keys that the file does not contain.
        let paper = RobotParameters::paper(3);
        let mut file = read(&path)?;
        let Some(Value::Table(mut table)) = file.remove("robot") else {
            return Self::from_parameters(&paper);
        };
        table.remove("name");
        for (key, value) in [
            ("cable_speed_max_m_s", paper.cable_speed_max_m_s),
            ("cable_stroke_max_m", paper.cable_stroke_max_m),
        ] {
            table.entry(key).or_insert(Value::Float(value));
        }
        if !table.contains_key("sections") {
            let sections = Value::try_from(&paper.sections);
            table.insert(
                "sections".to_owned(),
                sections.map_err(|error| Failure::argument(error, REPORT))?,
            );
        }
        let parameters = RobotParameters::deserialize(Value::Table(table)).map_err(|error| {
            let name = path.display();
            Failure::argument(
                format!("{name}: [robot]: {}", error.message()),
                format!("Check it with: cdcrd check --config {name}"),
            )
        })?;
        Self::from_parameters(&parameters)
    }

    /// Number of sections n, 1 to 6.
    #[getter]
    fn sections(&self) -> usize {
        self.inner.section_count()
    }

    /// Length of each section [m], base first: (n,).
    #[getter]
    fn length_m(&self) -> Doubles {
        let lengths_m = self.inner.sections().iter().map(|section| section.length_m);
        Doubles::new(&[self.sections()], &[], lengths_m.collect())
    }

    /// Radius of the body of each section [m], base first: (n,).
    #[getter]
    fn body_radius_m(&self) -> Doubles {
        let radii_m = self
            .inner
            .sections()
            .iter()
            .map(|section| section.body_radius_m);
        Doubles::new(&[self.sections()], &[], radii_m.collect())
    }

    /// Length of the whole backbone [m].
    #[getter]
    fn reach_m(&self) -> f64 {
        self.inner.reach_m()
    }

    /// Position of the tip [m], base frame.
    ///
    /// bend: (..., 2 n) [rad]. Returns (..., 3). Raises ArgumentError for another shape.
    #[pyo3(signature = (bend))]
    fn forward(&self, bend: ArrayLike<'_>) -> PyResult<Doubles> {
        self.blocks(bend, &[3], robot::Robot::tip_positions)
    }

    /// Orientation of the tip, base frame.
    ///
    /// bend: (..., 2 n) [rad]. form: "quaternion" gives (..., 4), x, y, z, w with w ≥ 0; "matrix" gives (..., 3, 3), whose columns are the axes of
    /// the tip; "zyx" gives (..., 3), the paper's Φ, Θ, Ψ [rad]. Raises ArgumentError for another shape or form.
    #[pyo3(signature = (bend, form: "Form" = "quaternion"))]
    fn orientation(&self, bend: ArrayLike<'_>, form: &str) -> PyResult<Doubles> {
        let rotation = |robot: &robot::Robot, shape: &Configuration| robot.tip_pose(shape).rotation;
        match chosen("form", form, FORMS)? {
            Form::Quaternion => self.each(bend, &[4], |robot, shape, out| {
                out.copy_from_slice(&quaternion_xyzw(&rotation(robot, shape)));
            }),
            Form::Matrix => self.each(bend, &[3, 3], |robot, shape, out| {
                // nalgebra stores columns, numpy rows.
                out.copy_from_slice(rotation(robot, shape).transpose().as_slice());
            }),
            Form::Zyx => self.each(bend, &[3], |robot, shape, out| {
                let angles = ZyxAngles::from_rotation(&rotation(robot, shape));
                out.copy_from_slice(&[angles.phi_rad, angles.theta_rad, angles.psi_rad]);
            }),
        }
    }

    /// Points of the backbone [m], base frame, at equal distances along it from the base to the tip.
    ///
    /// bend: (..., 2 n) [rad]. points: 2 to 100 000. Returns (..., points, 3). Raises ArgumentError for another shape.
    #[pyo3(signature = (bend, points = 50))]
    fn backbone(&self, bend: ArrayLike<'_>, points: i128) -> PyResult<Doubles> {
        let points = count("points", points, 2..=BACKBONE_POINTS_MAX)? as usize;
        let places = self.places(points);
        self.each(bend, &[points, 3], |robot, shape, out| {
            for ((section, share), out) in places.iter().zip(out.chunks_exact_mut(3)) {
                out.copy_from_slice(robot.body_point(shape, *section, *share).as_slice());
            }
        })
    }

    /// Jacobian of the tip in the base frame: rows v [m/rad] and ω [rad/rad], one column for each bend component.
    ///
    /// bend: (..., 2 n) [rad]. Returns (..., 6, 2 n). Raises ArgumentError for another shape.
    #[pyo3(signature = (bend))]
    fn jacobian(&self, bend: ArrayLike<'_>) -> PyResult<Doubles> {
        let columns = self.inner.coordinate_count();
        self.each(bend, &[6, columns], |robot, shape, out| {
            let mut jacobian = Jacobian::new();
            robot.tip_jacobian(shape, &mut jacobian);
            for (row, out) in out.chunks_exact_mut(columns).enumerate() {
                for (out, column) in out.iter_mut().zip(jacobian.columns()) {
                    *out = column[row];
                }
            }
        })
    }

    /// Lengths of the cables [m], three for each section, base first.
    ///
    /// bend: (..., 2 n) [rad]. Returns (..., 3 n). Raises ArgumentError for another shape.
    #[pyo3(signature = (bend))]
    fn cables(&self, bend: ArrayLike<'_>) -> PyResult<Doubles> {
        let cables = self.inner.cable_count();
        self.each(bend, &[cables], |robot, shape, out| {
            out.copy_from_slice(&robot.cable_lengths(shape)[..cables]);
        })
    }

    /// Bends whose cables have these lengths [m], by least squares: an error common to the three cables of a section is ignored.
    ///
    /// length: (..., 3 n) [m]. Returns (..., 2 n) [rad]. Raises ArgumentError for another shape.
    #[pyo3(signature = (length))]
    fn bend_from_cables(&self, length: ArrayLike<'_>) -> PyResult<Doubles> {
        let cables = self.inner.cable_count();
        let what = format!("3 cables for each of {} sections", self.sections());
        let lengths = Numbers::with_tail(&length, "length", &[cables], &what)?;
        let coordinates = self.inner.coordinate_count();
        let mut out = Vec::with_capacity(lengths.count() * coordinates);
        for row in lengths.values().chunks_exact(cables) {
            let mut lengths_m = [0.0; CABLES_MAX];
            lengths_m[..cables].copy_from_slice(row);
            out.extend_from_slice(self.inner.bend_from_cable_lengths(&lengths_m).as_slice());
        }
        Ok(Doubles::new(lengths.lead(), &[coordinates], out))
    }

    /// Least distance of the body's surface from some obstacles [m]: negative inside one, infinite without any. Exact along the whole body.
    ///
    /// bend: (..., 2 n) [rad]. obstacles: at most 64. Returns (...). Raises ArgumentError for another shape and more obstacles.
    #[pyo3(signature = (bend, obstacles: "Sequence[Obstacle]"))]
    fn clearance(&self, bend: ArrayLike<'_>, obstacles: Vec<Obstacle>) -> PyResult<Doubles> {
        let obstacles = inner(&obstacles)?;
        self.each(bend, &[], |robot, shape, out| {
            let body = robot.body(shape);
            out[0] = body.least_clearance_m(obstacles.iter().copied());
        })
    }

    fn __repr__(&self) -> String {
        let lengths_m = self.inner.sections().iter().map(|section| section.length_m);
        format!("Robot(length_m={:?})", lengths_m.collect::<Vec<_>>())
    }

    /// For pickle and copy: the arguments that make the same robot.
    #[pyo3(signature = () -> "tuple[tuple[()], dict[str, Any]]")]
    fn __getnewargs_ex__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyTuple>, Bound<'py, PyDict>)> {
        let arguments = PyDict::new(py);
        for (name, place) in PLACES {
            let mut sections = self.inner.sections().to_vec();
            let numbers: Vec<f64> = sections.iter_mut().map(|section| *place(section)).collect();
            arguments.set_item(name, numbers)?;
        }
        arguments.set_item("cable_speed_max_m_s", self.inner.cable_speed_max_m_s())?;
        arguments.set_item("cable_stroke_max_m", self.inner.cable_stroke_max_m())?;
        let tip_speed_max_m_s = self.inner.parameters().tip_speed_max_m_s;
        arguments.set_item("tip_speed_max_m_s", tip_speed_max_m_s)?;
        arguments.set_item("self_overlap_max_m", self.inner.self_overlap_max_m())?;
        Ok((PyTuple::empty(py), arguments))
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.inner == other.inner
    }
}

impl Robot {
    fn from_parameters(parameters: &RobotParameters) -> PyResult<Self> {
        let inner = robot::Robot::new(parameters).map_err(Failure::from)?;
        Ok(Self { inner })
    }

    /// Bends of this robot.
    pub(crate) fn bends<'a>(&self, bend: &ArrayLike<'a>, name: &str) -> PyResult<Numbers<'a>> {
        let sections = self.sections();
        let what = format!("2 numbers for each of {sections} sections");
        Numbers::with_tail(bend, name, &[2 * sections], &what)
    }

    /// One finite configuration of this robot.
    pub(crate) fn configuration(
        &self,
        bend: &ArrayLike<'_>,
        name: &str,
    ) -> PyResult<Configuration> {
        let sections = self.sections();
        let what = format!("2 numbers for each of {sections} sections");
        let numbers = Numbers::exact(bend, name, 1, &[2 * sections], &what)?.finite(name)?;
        Ok(
            Configuration::from_slice(numbers.values())
                .unwrap_or(Configuration::straight(sections)),
        )
    }

    /// Computes `row` numbers for each configuration.
    fn each(
        &self,
        bend: ArrayLike<'_>,
        row: &[usize],
        compute: impl Fn(&robot::Robot, &Configuration, &mut [f64]) + Sync,
    ) -> PyResult<Doubles> {
        let numbers = row.iter().product();
        self.blocks(bend, row, |robot, bends, out| {
            let mut shape = Configuration::straight(robot.section_count());
            let bends = bends.chunks_exact(robot.coordinate_count());
            for (bend, out) in bends.zip(out.chunks_exact_mut(numbers)) {
                shape.as_mut_slice().copy_from_slice(bend);
                compute(robot, &shape, out);
            }
        })
    }

    /// Computes `row` numbers for each configuration, block by block, without the interpreter's lock. With
    /// many blocks, threads take them from a common queue, so a busy core takes fewer.
    fn blocks(
        &self,
        bend: ArrayLike<'_>,
        row: &[usize],
        compute: impl Fn(&robot::Robot, &[f64], &mut [f64]) + Sync,
    ) -> PyResult<Doubles> {
        let py = bend.py();
        let bends = self.bends(&bend, "bend")?;
        let (values, robot, count) = (bends.values(), &self.inner, bends.count());
        let numbers: usize = row.iter().product();
        let mut out = empty_list(count, numbers)?;
        py.detach(|| {
            let width = robot.coordinate_count();
            let blocks = values.chunks(BLOCK * width);
            let blocks = Mutex::new(blocks.zip(out.chunks_mut(BLOCK * numbers)));
            let next = || {
                let mut blocks = blocks.lock().unwrap_or_else(PoisonError::into_inner);
                blocks.next()
            };
            let work = || {
                while let Some((bends, out)) = next() {
                    compute(robot, bends, out);
                }
            };
            if count <= ALONE_MAX {
                return work();
            }
            thread::scope(|scope| {
                let threads = thread::available_parallelism().map_or(1, usize::from);
                for _ in 1..threads.min(count.div_ceil(BLOCK)) {
                    scope.spawn(work);
                }
                work();
            });
        });
        Ok(Doubles::new(bends.lead(), row, out))
    }

    /// Section and position within it for each of some equidistant points.
    fn places(&self, points: usize) -> Vec<(usize, f64)> {
        let reach_m = self.inner.reach_m();
        let place = |point: usize| {
            let mut along_m = reach_m * point as f64 / (points - 1) as f64;
            for (j, section) in self.inner.sections().iter().enumerate() {
                if along_m <= section.length_m {
                    return (j, along_m / section.length_m);
                }
                along_m -= section.length_m;
            }
            (self.sections() - 1, 1.0)
        };
        (0..points).map(place).collect()
    }
}

/// Zeros for `count` rows. Fails without enough memory, which would otherwise end the process.
fn empty_list(count: usize, numbers: usize) -> Result<Vec<f64>, Failure> {
    let all = count.checked_mul(numbers);
    match all.map(|all| Vec::<f64>::new().try_reserve_exact(all)) {
        // Zeroed by the kernel: the threads that fill the pages allocate them.
        Some(Ok(())) => Ok(vec![0.0; count * numbers]),
        _ => Err(Failure::argument(
            format!("there is no memory for the result of {count} configurations"),
            "Compute fewer of them in one call.",
        )),
    }
}

/// One number, or one for each section.
fn list(value: ArrayLike<'_>, name: &str) -> PyResult<Vec<f64>> {
    let numbers = Numbers::with_tail(&value, name, &[], "a number for each section")?;
    match numbers.lead() {
        [] => Ok(numbers.values().to_vec()),
        [count] if *count > 0 => Ok(numbers.values().to_vec()),
        shape => Err(Failure::argument(
            format!(
                "{name} has the shape {}; needed is one number, or one for each section",
                shape_text(shape, "")
            ),
            "Give a flat list.",
        )
        .into()),
    }
}
