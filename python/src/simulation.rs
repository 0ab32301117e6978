//! `cdcr_controller::closed_loop`, period by period.

use std::time::Instant;

use cdcr_client::DURATION_MAX_S;
use cdcr_controller::closed_loop::{ClosedLoop, Driven, Sensor};
use cdcr_controller::estimator::Actuator;
use cdcr_controller::nmpc::{self, NmpcSettings, RateWeight, SolveReport};
use cdcr_controller::plant::{Flaws, RobotPreset};
use cdcr_controller::reference::ReferenceSample;
use cdcr_controller::robot::{Configuration, Robot as Model};
use cdcr_shared_types::codes::Interface;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};

use crate::arrays::{ArrayLike, Doubles};
use crate::errors::Failure;
use crate::mapping::pairs;
use crate::nmpc::{SEEDS, status_word};
use crate::numbers::{count, within};
use crate::obstacle::{Obstacle, inner};
use crate::robot::Robot;
use crate::settings::settings;
use crate::trajectory::Trajectory;
use crate::words::{INTERFACES, SENSORS, chosen};
use crate::worker::SIGNALS_EACH;

/// Default of a daemon for the largest acceleration of a robot behind a driver (rad/s²).
const ACCELERATION_RAD_S2: f64 = 40.0;

/// A closed loop, period by period: row k is the state after period k + 1. Every access makes a new array.
#[pyclass(frozen, module = "cdcr")]
pub(crate) struct Simulation {
    #[pyo3(get)]
    /// The robot.
    robot: Robot,
    /// Period [s].
    #[pyo3(get)]
    period_s: f64,
    rows: Vec<PeriodRow>,
}

/// One period.
struct PeriodRow {
    time_s: f64,
    bends: Configuration,
    rates: Vec<f64>,
    tip_m: [f64; 3],
    reference_m: [f64; 3],
    error_m: f64,
    clearance_m: f64,
    solve_s: f64,
    guarded: bool,
    report: SolveReport,
}

/// A solver, safety checks and a robot in closed loop: what a daemon does, without a clock. The same arguments give the same bits.
///
/// trajectory: what the tip follows from time 0 on. plant: "ideal" is exactly its model; "laboratory", "sloppy", "slow" and "blind" are not, and have a
/// driver and an estimate. flaws: single numbers by name, beside those of the plant, such as {"play_m": 3e-4}. settings: what differs
/// from default_settings(). period_s: 1e-6 to 10 s. start: (2 n,) [rad]; straight if left out. obstacles: where they are at time 0; they move on
/// at their velocity. duration_s: that of the trajectory if left out. seed: of the plant's noise. sensor: what the robot measures: "cables", "tip", "both" or "nothing";
/// by default "cables", and "tip" of "blind". interface: what its motors obey, "velocity" or "position". actuator_delay_s, actuator_time_constant_s, actuator_play_m: what
/// the controller takes the motors for, as the table `[actuator]`. estimator_time_constant_s: with which the estimate follows what is
/// measured. acceleration_rad_s2: largest growth of a rate; by default none of the ideal robot, 40 of others.
/// Raises ArgumentError for wrong shapes, unknown names and values outside their ranges.
#[pyfunction]
#[pyo3(signature = (
    robot, trajectory, *, plant: "Plant" = "ideal", flaws: "Mapping[str, float] | None" = None, settings: "Settings | None" = None, period_s = 0.005,
    start = None, obstacles: "Sequence[Obstacle]" = Vec::new(), duration_s = None, seed = 1, sensor: "Sensor | None" = None,
    interface: "Interface" = "velocity", actuator_delay_s = 0.0, actuator_time_constant_s = 0.0, actuator_play_m = 0.0,
    estimator_time_constant_s = 0.18, acceleration_rad_s2 = None,
) -> "Simulation")]
#[allow(clippy::too_many_arguments, reason = "each is a name in Python")]
pub(crate) fn simulate(
    py: Python<'_>,
    robot: &Robot,
    trajectory: &Trajectory,
    plant: &str,
    flaws: Option<&Bound<'_, PyMapping>>,
    settings: Option<&Bound<'_, PyDict>>,
    period_s: f64,
    start: Option<ArrayLike<'_>>,
    obstacles: Vec<Obstacle>,
    duration_s: Option<f64>,
    seed: i128,
    sensor: Option<&str>,
    interface: &str,
    actuator_delay_s: f64,
    actuator_time_constant_s: f64,
    actuator_play_m: f64,
    estimator_time_constant_s: f64,
    acceleration_rad_s2: Option<f64>,
) -> PyResult<Simulation> {
    let mut settings = self::settings(settings)?;
    let start = match start {
        Some(start) => robot.configuration(&start, "start")?,
        None => Configuration::straight(robot.inner.section_count()),
    };
    let actuator = Actuator {
        delay_s: actuator_delay_s,
        time_constant_s: actuator_time_constant_s,
        play_m: actuator_play_m,
    };
    check_actuator(&actuator, estimator_time_constant_s)?;
    let preset = preset(plant)?;
    let flaws = with_flaws(preset.flaws(), flaws)?;
    let driven = Driven {
        flaws,
        actuator,
        time_constant_s: estimator_time_constant_s,
        obeys_positions: chosen("interface", interface, INTERFACES)? == Interface::Position,
        sensor: sensor_of(sensor, preset)?,
        without: None,
        seed: count("seed", seed, SEEDS)?,
    };
    let is_ideal = preset == RobotPreset::Ideal && flaws == Flaws::default() && sensor.is_none();
    if settings.rate_weight == RateWeight::Auto {
        settings.rate_weight = RateWeight::auto(is_ideal);
    }
    let otherwise = if is_ideal {
        f64::INFINITY
    } else {
        ACCELERATION_RAD_S2
    };
    let acceleration_rad_s2 = acceleration_rad_s2.unwrap_or(otherwise);
    if acceleration_rad_s2.is_nan() || acceleration_rad_s2 <= 0.0 {
        return Err(Failure::argument(
            format!("acceleration_rad_s2 is {acceleration_rad_s2}"),
            "Give a value above 0.",
        )
        .into());
    }
    let duration_s = duration_s.unwrap_or_else(|| trajectory.source.curve().duration_s());
    let periods = periods(duration_s, period_s)?;
    let source = trajectory.source.clone();
    let reference_at = move |time_s: f64| source.sample(time_s);
    let obstacles = inner(&obstacles)?;
    let mut closed = ClosedLoop::new(
        &robot.inner,
        period_s,
        settings,
        start,
        &obstacles,
        reference_at,
    )
    .map_err(Failure::from)?
    .with_acceleration(acceleration_rad_s2);
    if !is_ideal {
        closed = closed.with_driven(driven).map_err(Failure::from)?;
    }
    let rows = run(
        py,
        &robot.inner,
        closed,
        (period_s, settings),
        periods,
        &trajectory.source,
    )?;
    Ok(Simulation {
        robot: robot.clone(),
        period_s,
        rows,
    })
}

/// All periods, without the interpreter's lock except for checks of signals.
fn run<R: Fn(f64) -> ReferenceSample + Send>(
    py: Python<'_>,
    robot: &Model,
    mut closed: ClosedLoop<R>,
    (period_s, settings): (f64, NmpcSettings),
    periods: usize,
    reference: &crate::trajectory::TrajectorySource,
) -> PyResult<Vec<PeriodRow>> {
    let mut nmpc = nmpc::Nmpc::new(robot.clone(), period_s, settings).map_err(Failure::from)?;
    let mut rows = Vec::new();
    while rows.len() < periods {
        let (closed, nmpc, rows) = (&mut closed, &mut nmpc, &mut rows);
        py.detach(move || {
            let until = Instant::now() + SIGNALS_EACH;
            while rows.len() < periods && Instant::now() < until {
                let begin = Instant::now();
                let report = closed.step(nmpc);
                let solve_s = begin.elapsed().as_secs_f64();
                rows.push(PeriodRow::after(closed, reference, report, solve_s));
            }
        });
        py.check_signals()?;
    }
    Ok(rows)
}

impl PeriodRow {
    fn after<R: Fn(f64) -> ReferenceSample>(
        closed: &ClosedLoop<R>,
        reference: &crate::trajectory::TrajectorySource,
        report: SolveReport,
        solve_s: f64,
    ) -> Self {
        let command = closed.command();
        Self {
            time_s: closed.time_s(),
            bends: *closed.configuration(),
            rates: command.rates.as_slice().to_vec(),
            tip_m: closed.tip_m().into(),
            reference_m: reference.sample(closed.time_s()).position_m.into(),
            error_m: closed.error_m(),
            clearance_m: closed.clearance_m(),
            solve_s,
            guarded: command.clearance_hit,
            report,
        }
    }
}

#[pymethods]
impl Simulation {
    /// Time since the start [s]: (k,).
    #[getter]
    fn time_s(&self) -> Doubles {
        self.column(|row| row.time_s)
    }

    /// Bends of the ideal robot; of another one, where its commands lead it as far as is known [rad]: (k, 2 n).
    #[getter]
    fn bend_rad(&self) -> Doubles {
        self.rows(2 * self.robot.inner.section_count(), |row| {
            row.bends.as_slice()
        })
    }

    /// Commanded rates of the period [rad/s]: (k, 2 n).
    #[getter]
    fn bend_rate_rad_s(&self) -> Doubles {
        self.rows(2 * self.robot.inner.section_count(), |row| &row.rates)
    }

    /// True position of the tip [m]: (k, 3).
    #[getter]
    fn tip_position_m(&self) -> Doubles {
        self.rows(3, |row| &row.tip_m)
    }

    /// The reference [m]: (k, 3).
    #[getter]
    fn reference_position_m(&self) -> Doubles {
        self.rows(3, |row| &row.reference_m)
    }

    /// From the reference to the true tip [m]: (k,).
    #[getter]
    fn position_error_m(&self) -> Doubles {
        self.column(|row| row.error_m)
    }

    /// True clearance of the body [m]: (k,); infinite without obstacles.
    #[getter]
    fn clearance_m(&self) -> Doubles {
        self.column(|row| row.clearance_m)
    }

    /// Time of solve, safety checks and simulated robot on this machine [s]: (k,). Not the same in each run.
    #[getter]
    fn solve_s(&self) -> Doubles {
        self.column(|row| row.solve_s)
    }

    /// Cost of the solutions: (k,).
    #[getter]
    fn cost(&self) -> Doubles {
        self.column(|row| row.report.cost)
    }

    /// Status of each solve, as SolveReport.status.
    #[getter]
    fn status(&self) -> Vec<&'static str> {
        let statuses = self.rows.iter().map(|row| status_word(row.report.status));
        statuses.collect()
    }

    /// Whether the clearance guard changed the command of each period.
    #[getter]
    fn guarded(&self) -> Vec<bool> {
        self.rows.iter().map(|row| row.guarded).collect()
    }

    fn __len__(&self) -> usize {
        self.rows.len()
    }

    fn __repr__(&self) -> String {
        format!(
            "<Simulation of {} periods of {} s>",
            self.rows.len(),
            self.period_s
        )
    }
}

impl Simulation {
    fn column(&self, number: impl Fn(&PeriodRow) -> f64) -> Doubles {
        Doubles::new(
            &[self.rows.len()],
            &[],
            self.rows.iter().map(number).collect(),
        )
    }

    fn rows<'s>(&'s self, width: usize, numbers: impl Fn(&'s PeriodRow) -> &'s [f64]) -> Doubles {
        let values = self.rows.iter().flat_map(numbers).copied().collect();
        Doubles::new(&[self.rows.len()], &[width], values)
    }
}

fn preset(name: &str) -> Result<RobotPreset, Failure> {
    let known = RobotPreset::ALL
        .into_iter()
        .find(|preset| preset.name() == name);
    known.ok_or_else(|| {
        Failure::argument(
            format!("no plant is called {name:?}"),
            format!(
                "Use one of: {}.",
                RobotPreset::ALL.map(RobotPreset::name).join(", ")
            ),
        )
    })
}

fn with_flaws(begin: Flaws, named: Option<&Bound<'_, PyMapping>>) -> PyResult<Flaws> {
    let mut flaws = begin;
    if let Some(named) = named {
        let mut named: Vec<(String, f64)> = pairs("flaws", "names to numbers", named)?;
        named.sort_by(|one, other| one.0.cmp(&other.0));
        for (name, value) in named {
            flaws = flaws.with(&name, value).map_err(Failure::from)?;
        }
    }
    Ok(flaws)
}

fn sensor_of(name: Option<&str>, preset: RobotPreset) -> Result<Sensor, Failure> {
    let usual = if preset.measures_tip() {
        "tip"
    } else {
        "cables"
    };
    chosen("sensor", name.unwrap_or(usual), SENSORS)
}

fn check_actuator(actuator: &Actuator, time_constant_s: f64) -> Result<(), Failure> {
    let numbers = [
        ("actuator_delay_s", actuator.delay_s, 0.3),
        ("actuator_time_constant_s", actuator.time_constant_s, 0.3),
        ("actuator_play_m", actuator.play_m, 0.01),
        ("estimator_time_constant_s", time_constant_s, 10.0),
    ];
    for (name, value, most) in numbers {
        within(name, value, 0.0..=most)?;
    }
    Ok(())
}

/// Number of periods. A simulation of more than a day, or with more memory than a day at 5 ms, is rejected as
/// a wrong unit.
fn periods(duration_s: f64, period_s: f64) -> Result<usize, Failure> {
    const PERIODS_MAX: f64 = DURATION_MAX_S / 0.005;
    within("duration_s", duration_s, 0.0..=DURATION_MAX_S)?;
    // Rounding must not add a period.
    let periods = (duration_s / period_s - 1e-9).ceil().max(0.0);
    if periods > PERIODS_MAX {
        return Err(Failure::argument(
            format!("duration_s has {periods:e} periods; allowed are {PERIODS_MAX:e}"),
            "Give a shorter duration, or a longer period_s.",
        ));
    }
    Ok(periods as usize)
}
