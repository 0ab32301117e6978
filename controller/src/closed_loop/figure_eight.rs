//! Tasks that compare robots with flaws: a figure eight of three sections, one through the straight robot, and the
//! paper's spiral.

use nalgebra::Vector3;

use super::scene::spiral_shape;
use super::{ClosedLoop, Driven};
use crate::nmpc::{Nmpc, NmpcSettings, RateWeight, SettingsError};
use crate::plant::Flaws;
use crate::reference::ReferenceSample;
use crate::robot::{BendRates, Configuration, Obstacle, Robot, RobotError, RobotParameters};

/// Default largest acceleration of a robot behind a driver (rad/s²).
const ACCELERATION_RAD_S2: f64 = 40.0;
/// Half of the length of the figure eight (m).
const SIZE_M: f64 = 0.08;
/// Evaluated cycles of a robot at rest.
const REST_CYCLES: core::ops::Range<u32> = 1000..4000;
/// Cycles of the paper's spiral.
const SPIRAL_CYCLES: u32 = 994;
/// Start of the figure eight of three sections \[rad\]: one of the many shapes with that tip, reached from bends of 0.4
/// rad. It is constant, so that the task does not depend on the solver.
const START_RAD: [f64; 6] = [
    -0.144_084_713_683_017_76,
    -0.547_365_826_571_354_5,
    0.742_903_463_663_806_8,
    0.649_327_442_758_037_4,
    0.809_237_139_492_114,
    0.649_322_938_151_114_5,
];

/// The paper's robot with the default settings, at rest at the start of the figure eight.
#[derive(Debug, Clone)]
pub struct FigureEight {
    robot: Robot,
    settings: Option<NmpcSettings>,
    start: Configuration,
    path: TipPath,
}

/// Path of the tip.
#[derive(Debug, Clone, Copy)]
enum TipPath {
    /// The figure eight of three sections.
    Eight,
    /// A figure eight through the tip of the straight robot; the value is the largest bend of each section (rad).
    ThroughStraight(f64),
    /// The paper's spiral (Eq. 8), lowered by this distance (m).
    Spiral { lower_m: f64 },
}

/// Reason why a run is impossible.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FigureEightError {
    /// The flaws make no valid robot.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The settings are not valid.
    #[error(transparent)]
    Settings(#[from] SettingsError),
}

/// Result of one run, cycle by cycle.
#[derive(Debug, Clone)]
pub struct FigureEightRun {
    errors_mm: Vec<f64>,
    rate_changes: f64,
    min_clearance_mm: f64,
    following_mm: f64,
    limit_excess: f64,
}

/// Result of [`FigureEight::rest`]: a robot that was sent to a point and shall rest there, from second 5 to second 20.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FigureEightRest {
    /// Largest true error of the tip (mm).
    pub error_mm: f64,
    /// Largest commanded rate of a component (rad/s).
    pub rate_rad_s: f64,
}

impl FigureEight {
    /// Period (s).
    pub const PERIOD_S: f64 = 0.005;
    /// Cycles of a run: slightly more than one round.
    pub const CYCLES: u32 = 3000;
    /// Initial cycles without evaluation, in which the estimate settles.
    pub const BEGIN_CYCLES: u32 = 200;

    /// A figure eight of 160 mm by 80 mm across the robot's axis, at up to 52 mm/s; `time_s` in seconds.
    pub fn reference(time_s: f64) -> ReferenceSample {
        let [x, y] = eight_point(time_s);
        ReferenceSample::at_position(Vector3::new(0.25 + SIZE_M * x, SIZE_M * y, 0.7))
    }

    fn sample(&self, time_s: f64) -> ReferenceSample {
        let bend_rad = match self.path {
            TipPath::Eight => return Self::reference(time_s),
            TipPath::ThroughStraight(bend_rad) => bend_rad,
            TipPath::Spiral { lower_m } => {
                let tip_m = self.robot.tip_position(&spiral_shape(3, time_s));
                return ReferenceSample::at_position(tip_m - lower_m * Vector3::z());
            }
        };
        let mut bends = self.start;
        let eight = eight_point(time_s);
        for (i, bend) in bends.as_mut_slice().iter_mut().enumerate() {
            *bend = bend_rad * eight[i % 2];
        }
        ReferenceSample::at_position(self.robot.tip_position(&bends))
    }

    /// The figure eight of three sections.
    ///
    /// # Errors
    /// [`FigureEightError`], which does not occur for the paper's robot.
    pub fn new() -> Result<Self, FigureEightError> {
        let mut start = Configuration::straight(3);
        start.as_mut_slice().copy_from_slice(&START_RAD);
        Ok(Self {
            start,
            robot: Robot::new(&RobotParameters::paper(3))?,
            settings: None,
            path: TipPath::Eight,
        })
    }

    /// A figure eight of about the same size and speed through the tip of the straight robot with `sections` sections,
    /// 1 to 6. The robot can reach it.
    ///
    /// # Errors
    /// [`FigureEightError::Robot`] for another number of sections.
    pub fn through_straight(sections: usize) -> Result<Self, FigureEightError> {
        let robot = Robot::new(&RobotParameters::paper(sections))?;
        // With bends b, n sections turn by n b in total: the tip moves aside by half of that times their length.
        let bend_rad = SIZE_M / (0.5 * sections as f64 * robot.reach_m());
        Ok(Self {
            start: Configuration::straight(sections),
            robot,
            settings: None,
            path: TipPath::ThroughStraight(bend_rad),
        })
    }

    /// The paper's spiral (Eq. 8) of three sections, lowered by `lower_m` (m), because robots with shorter sections do
    /// not reach the original. It lasts 5 s.
    ///
    /// # Errors
    /// [`FigureEightError`], which does not occur for the paper's robot.
    pub fn spiral(lower_m: f64) -> Result<Self, FigureEightError> {
        let robot = Robot::new(&RobotParameters::paper(3))?;
        Ok(Self {
            start: spiral_shape(3, 0.0),
            robot,
            settings: None,
            path: TipPath::Spiral { lower_m },
        })
    }

    /// Sets the settings of the solver.
    #[must_use]
    pub fn with_settings(self, settings: NmpcSettings) -> Self {
        let settings = Some(settings);
        Self { settings, ..self }
    }

    fn cycles(&self) -> u32 {
        match self.path {
            TipPath::Eight | TipPath::ThroughStraight(_) => Self::CYCLES,
            TipPath::Spiral { .. } => SPIRAL_CYCLES,
        }
    }

    /// Settings of a daemon without a configuration; for the ideal robot those of the paper.
    fn settings(&self, flaws: &Flaws) -> NmpcSettings {
        let is_ideal = *flaws == Flaws::default();
        self.settings.unwrap_or_else(|| NmpcSettings {
            rate_weight: RateWeight::auto(is_ideal),
            ..NmpcSettings::default()
        })
    }

    /// One round with a robot that differs from its model, behind a driver. `obstacles` are those at the start.
    ///
    /// # Errors
    /// [`FigureEightError::Robot`] if the flaws make no valid robot.
    pub fn run(
        &self,
        driven: Driven,
        obstacles: &[Obstacle],
    ) -> Result<FigureEightRun, FigureEightError> {
        let (robot, settings, start) = (&self.robot, self.settings(&driven.flaws), self.start);
        let mut nmpc = Nmpc::new(robot.clone(), Self::PERIOD_S, settings)?;
        let path = |time_s| self.sample(time_s);
        let mut closed = ClosedLoop::new(robot, Self::PERIOD_S, settings, start, obstacles, path)?
            .with_acceleration(ACCELERATION_RAD_S2)
            .with_driven(driven)?;
        let mut run = FigureEightRun {
            errors_mm: Vec::with_capacity(Self::CYCLES as usize),
            rate_changes: 0.0,
            min_clearance_mm: f64::INFINITY,
            following_mm: 0.0,
            limit_excess: 0.0,
        };
        let mut before = BendRates::zero(robot.section_count());
        for cycle in 0..self.cycles() {
            closed.step(&mut nmpc);
            let rates = closed.command().rates;
            run.errors_mm.push(1e3 * closed.error_m());
            run.min_clearance_mm = run.min_clearance_mm.min(1e3 * closed.clearance_m());
            run.limit_excess = run.limit_excess.max(excess(robot, &rates, &before));
            if cycle >= Self::BEGIN_CYCLES {
                run.following_mm = run.following_mm.max(1e3 * closed.following_error_m());
                let pairs = rates.as_slice().iter().zip(before.as_slice());
                run.rate_changes += pairs.map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
            }
            before = rates;
        }
        Ok(run)
    }

    /// The robot is sent to a point 36 mm away and shall rest there.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn rest(&self, driven: Driven) -> Result<FigureEightRest, FigureEightError> {
        let (robot, settings) = (&self.robot, self.settings(&driven.flaws));
        let start = Configuration::from_bend_angles(&[[0.4, 0.0]; 3]);
        let goal_m = robot.tip_position(&start) + Vector3::new(-0.02, 0.03, 0.0);
        let goal = ReferenceSample::at_position(goal_m);
        let mut nmpc = Nmpc::new(robot.clone(), Self::PERIOD_S, settings)?;
        let mut closed = ClosedLoop::new(robot, Self::PERIOD_S, settings, start, &[], |_| goal)?
            .with_acceleration(ACCELERATION_RAD_S2)
            .with_driven(driven)?;
        let mut rest = FigureEightRest {
            error_mm: 0.0,
            rate_rad_s: 0.0,
        };
        for cycle in 0..REST_CYCLES.end {
            closed.step(&mut nmpc);
            if REST_CYCLES.contains(&cycle) {
                rest.error_mm = rest.error_mm.max(1e3 * closed.error_m());
                let rates = closed.command().rates;
                let fastest = rates.as_slice().iter().map(|rate| rate.abs());
                rest.rate_rad_s = fastest.fold(rest.rate_rad_s, f64::max);
            }
        }
        Ok(rest)
    }
}

/// A figure eight: once along ±1, twice across ±1/2.
fn eight_point(time_s: f64) -> [f64; 2] {
    let turn = 0.46 * time_s;
    [turn.sin(), 0.5 * (2.0 * turn).sin()]
}

/// Excess of a command over the limits of rates, cable speeds and acceleration, as a share of the limit; 0 within all
/// of them.
fn excess(robot: &Robot, rates: &BendRates, before: &BendRates) -> f64 {
    let pairs = rates.as_slice().iter().zip(before.as_slice()).enumerate();
    let of_rates = pairs.map(|(i, (rate, before))| {
        // Deceleration is always allowed: only growth counts, after a change of sign from zero.
        let from_rad_s = before.abs() * f64::from(u8::from(rate * before > 0.0));
        let acceleration_rad_s2 = (rate.abs() - from_rad_s) / FigureEight::PERIOD_S;
        let faster = rate.abs() / robot.sections()[i / 2].rate_max_rad_s;
        faster.max(acceleration_rad_s2 / ACCELERATION_RAD_S2)
    });
    let speeds_m_s = robot.cable_speeds(rates);
    let of_cables = speeds_m_s
        .iter()
        .map(|speed_m_s| speed_m_s.abs() / robot.cable_speed_max_m_s());
    of_rates.chain(of_cables).fold(1.0, f64::max) - 1.0
}

impl FigureEightRun {
    /// True distance of the tip from the reference at the end of each cycle (mm).
    pub fn errors_mm(&self) -> &[f64] {
        &self.errors_mm
    }

    /// Mean error of the evaluated cycles (mm).
    pub fn mean_mm(&self) -> f64 {
        mean(self.evaluated())
    }

    /// Mean error of the second half of the evaluated cycles (mm).
    pub fn settled_mm(&self) -> f64 {
        mean(&self.evaluated()[self.evaluated().len() / 2..])
    }

    /// Root mean square error of the evaluated cycles (mm).
    pub fn rms_mm(&self) -> f64 {
        let squares: f64 = self.evaluated().iter().map(|error| error * error).sum();
        (squares / self.evaluated().len() as f64).sqrt()
    }

    /// Largest error of the evaluated cycles (mm).
    pub fn max_mm(&self) -> f64 {
        self.evaluated().iter().copied().fold(0.0, f64::max)
    }

    /// Mean squared change of the rates from cycle to cycle, summed over all components (rad²/s²).
    pub fn rate_change_square(&self) -> f64 {
        self.rate_changes / self.evaluated().len() as f64
    }

    /// Least true clearance of the body over all cycles (mm); infinite without obstacles.
    pub fn min_clearance_mm(&self) -> f64 {
        self.min_clearance_mm
    }

    /// Largest difference between a motor and its commanded position in the evaluated cycles (mm).
    pub fn following_mm(&self) -> f64 {
        self.following_mm
    }

    /// Largest excess of a command over a limit of rates, cable speeds or acceleration, as a share of that limit; 0 if
    /// none was exceeded.
    pub fn limit_excess(&self) -> f64 {
        self.limit_excess
    }

    fn evaluated(&self) -> &[f64] {
        &self.errors_mm[FigureEight::BEGIN_CYCLES as usize..]
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use super::*;

    #[test]
    fn a_run_begins_where_the_figure_eight_does() {
        let eight = FigureEight::new().unwrap();
        let tip_m = eight.robot.tip_position(&eight.start);
        assert!((tip_m - FigureEight::reference(0.0).position_m).norm() < 1e-6);
    }
}
