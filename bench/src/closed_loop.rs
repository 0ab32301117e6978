//! One robot tracking one curve, cycle by cycle, as fast as it computes.

use std::time::Instant;

use anyhow::{Context, Result};
use cdcr_client::Orientation as Wanted;
use cdcr_controller::nmpc::{Nmpc, NmpcSettings, SolveInput};
use cdcr_controller::optimizer::{Budget, cycle_seed};
use cdcr_controller::reference::{Orientation, ReferenceSample, ReferenceState};
use cdcr_controller::robot::{BendRates, Configuration, Obstacle, Pose};
use cdcr_controller::safety::{Situation, safe_command};
use hdrhistogram::Histogram;
use nalgebra::{Quaternion, Unit, UnitQuaternion, Vector3};

use crate::scene::Scene;

/// The ideal kinematic robot and the last word on its commands, around whatever solves. The solver sees
/// the exact curve at each step of its horizon; the command is what a daemon would send.
pub struct ClosedLoop<'a> {
    scene: &'a Scene,
    settings: NmpcSettings,
    cycle: u64,
    configuration: Configuration,
    rates: BendRates,
    /// Where they are at this release.
    obstacles: Vec<Obstacle>,
    guarded: bool,
    reference: Vec<ReferenceSample>,
}

/// What one cycle led to.
#[derive(Debug, Clone)]
pub struct Sample {
    /// End of the cycle \[s\].
    pub time_s: f64,
    /// Where the tip should be then \[m\].
    pub reference_m: Vector3<f64>,
    /// Where it is.
    pub tip: Pose,
    /// How the robot is bent then.
    pub configuration: Configuration,
    /// The command of the cycle \[rad/s\].
    pub rates: BendRates,
    /// Clearance of the whole body then \[m\]; infinite without obstacles.
    pub clearance_m: f64,
    /// Time of the solve \[ns\].
    pub solve_ns: u64,
}

impl Sample {
    /// From the reference to the tip \[mm\].
    pub fn offset_mm(&self) -> Vector3<f64> {
        1e3 * (self.tip.position_m - self.reference_m)
    }

    /// Distance of the tip from the reference \[mm\].
    pub fn error_mm(&self) -> f64 {
        self.offset_mm().norm()
    }
}

impl<'a> ClosedLoop<'a> {
    /// The scene at its start.
    pub fn new(scene: &'a Scene, settings: NmpcSettings) -> Self {
        let mut begin = Self {
            scene,
            settings,
            cycle: 0,
            configuration: scene.start,
            rates: BendRates::zero(scene.robot.section_count()),
            obstacles: scene.obstacles.clone(),
            guarded: false,
            reference: Vec::new(),
        };
        begin.look_ahead();
        begin
    }

    /// Whether all cycles are done.
    pub fn is_over(&self) -> bool {
        self.cycle >= self.scene.cycles
    }

    /// What a solve of this cycle starts from.
    pub fn input(&self) -> SolveInput<'_> {
        SolveInput {
            configuration: &self.configuration,
            previous_rates: &self.rates,
            reference: &self.reference,
            obstacles: &self.obstacles,
            elapsed_periods: 1,
            seed: cycle_seed(self.settings.seed, self.cycle),
        }
    }

    /// Limits and guards the wish, moves the robot by it and the obstacles by their velocity, and goes on to
    /// the next cycle.
    pub fn advance(&mut self, wish: &BendRates) {
        let Scene {
            robot, period_s, ..
        } = self.scene;
        let situation = Situation {
            robot,
            at: &self.configuration,
            commanded: None,
            previous: &self.rates,
            obstacles: &self.obstacles,
            safe_distance_m: self.settings.safe_distance_m,
            // The paper's robot has none.
            acceleration_rad_s2: f64::INFINITY,
            period_s: *period_s,
            // It gets every command.
            moving_s: *period_s,
            deceleration_rad_s2: f64::INFINITY,
            comes_to_rest: false,
        };
        let safe = safe_command(&situation, wish);
        (self.rates, self.guarded) = (safe.rates, safe.clearance_hit);
        self.configuration = self.configuration.advanced(&self.rates, *period_s);
        self.cycle += 1;
        let time_s = self.scene.time_s(self.cycle);
        let from_the_start = self.scene.obstacles.iter();
        self.obstacles.clear();
        self.obstacles
            .extend(from_the_start.map(|obstacle| obstacle.moved(time_s)));
        self.look_ahead();
    }

    /// Whether the guard changed the last wish, because it led too near to an obstacle.
    pub fn was_guarded(&self) -> bool {
        self.guarded
    }

    /// What the cycle before this one led to.
    pub fn sample(&self, solve_ns: u64) -> Sample {
        let body = self.scene.robot.body(self.configuration.as_slice());
        let clearances_m = self.obstacles.iter().map(|o| body.clearance_m(o));
        Sample {
            time_s: self.scene.time_s(self.cycle),
            reference_m: self.scene.point_m(self.cycle),
            tip: self.scene.robot.tip_pose(&self.configuration),
            configuration: self.configuration,
            rates: self.rates,
            clearance_m: clearances_m.fold(f64::INFINITY, f64::min),
            solve_ns,
        }
    }

    /// The exact curve at the steps of the horizon.
    fn look_ahead(&mut self) {
        let first = self.cycle + 1;
        let cycles = first..first + u64::from(self.settings.horizon_steps);
        self.reference.clear();
        self.reference.extend(cycles.map(|cycle| ReferenceSample {
            state: ReferenceState::Inside,
            position_m: self.scene.point_m(cycle),
            orientation: orientation(self.scene, cycle),
        }));
    }
}

fn orientation(scene: &Scene, cycle: u64) -> Orientation {
    match scene.curve.orientation(scene.time_s(cycle)) {
        Wanted::Free => Orientation::Free,
        Wanted::Axis(axis) => Orientation::Axis(Unit::new_normalize(axis.into())),
        Wanted::Full([x, y, z, w]) => {
            Orientation::Full(UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)))
        }
    }
}

/// Runs the scene with one controller and tells of every cycle.
///
/// # Errors
/// When the settings are out of range.
pub fn run(scene: &Scene, settings: NmpcSettings) -> Result<Vec<Sample>> {
    let mut nmpc = Nmpc::new(scene.robot.clone(), scene.period_s, settings)?;
    let mut closed = ClosedLoop::new(scene, settings);
    let mut samples = Vec::with_capacity(scene.cycles as usize);
    while !closed.is_over() {
        let begin = Instant::now();
        let (wish, _) = nmpc.solve(&closed.input(), &mut Budget::unlimited());
        let solve_ns = begin.elapsed().as_nanos() as u64;
        closed.advance(&wish);
        samples.push(closed.sample(solve_ns));
    }
    Ok(samples)
}

/// A quantile of times in nanoseconds \[µs\].
pub fn quantile_us(times_ns: &Histogram<u64>, quantile: f64) -> f64 {
    times_ns.value_at_quantile(quantile) as f64 * 1e-3
}

/// Solve times from 1 ns to a minute, three digits.
///
/// # Errors
/// Never with these bounds.
pub fn histogram() -> Result<Histogram<u64>> {
    Histogram::new_with_bounds(1, 60_000_000_000, 3).context("a histogram of three digits")
}
