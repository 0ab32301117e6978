//! Random moments: robot, configuration, last command, desired rates and surroundings.

use core::f64::consts::PI;

use cdcr_controller::estimator::Slack;
use cdcr_controller::robot::{
    BendRates, CABLES_MAX, Configuration, Obstacle, Robot, RobotParameters,
};
use cdcr_controller::safety::{SafeCommand, Situation, safe_command};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::body::{Ball, arcs};
use super::rule::{norm, strokes_m};

/// All inputs of a command: bends in rad, rates in rad/s, as (u, v) of each section, base first.
#[derive(Debug, Clone)]
pub(super) struct Moment {
    /// Parameters with the body thickened by the share of the tip offset.
    pub(super) parameters: RobotParameters,
    /// The tip offset (m).
    pub(super) tip_offset_m: f64,
    pub(super) at: Vec<f64>,
    pub(super) commanded: Option<Vec<f64>>,
    pub(super) previous: Vec<f64>,
    pub(super) desired_rates: Vec<f64>,
    pub(super) balls: Vec<Ball>,
    pub(super) safe_m: f64,
    pub(super) acceleration_rad_s2: f64,
    pub(super) period_s: f64,
    pub(super) moving_s: f64,
    pub(super) deceleration_rad_s2: f64,
    pub(super) comes_to_rest: bool,
}

impl Moment {
    /// The crate's command.
    pub(super) fn command(&self) -> SafeCommand {
        self.command_with(None)
    }

    /// The same for cables with play.
    pub(super) fn command_with(&self, slack: Option<&Slack>) -> SafeCommand {
        let robot = Robot::new(&self.thinner()).unwrap();
        let at = Configuration::from_slice(&self.at).unwrap();
        let commanded = self.commanded.as_deref().map(Configuration::from_slice);
        let commanded = commanded.map(Option::unwrap);
        let previous = BendRates::from_slice(&self.previous).unwrap();
        let obstacles: Vec<Obstacle> = self.balls.iter().map(Ball::obstacle).collect();
        let situation = Situation {
            robot: &robot,
            at: &at,
            lag: None,
            commanded: commanded.as_ref(),
            slack,
            previous: &previous,
            obstacles: &obstacles,
            safe_distance_m: self.safe_m,
            tip_offset_m: self.tip_offset_m,
            acceleration_rad_s2: self.acceleration_rad_s2,
            period_s: self.period_s,
            moving_s: self.moving_s,
            deceleration_rad_s2: self.deceleration_rad_s2,
            comes_to_rest: self.comes_to_rest,
        };
        safe_command(
            &situation,
            &BendRates::from_slice(&self.desired_rates).unwrap(),
        )
    }

    /// The robot without the thickening, as given to the controller.
    fn thinner(&self) -> RobotParameters {
        let mut thinner = self.parameters.clone();
        for (section, thicker_m) in thinner.sections.iter_mut().zip(self.thicker_m()) {
            // Rounding must not make it negative.
            section.body_radius_m = (section.body_radius_m - thicker_m).max(0.0);
        }
        thinner
    }

    /// Thickening of each section (m): offset · min(1, s/|p|), with the body length s up to its end and the
    /// tip p.
    fn thicker_m(&self) -> Vec<f64> {
        let arcs = arcs(&self.parameters, &self.at);
        let away_m = arcs[arcs.len() - 1].end_m().norm();
        let mut length_m = 0.0;
        let sections = self.parameters.sections.iter();
        sections
            .map(|section| {
                length_m += section.length_m;
                self.tip_offset_m * (length_m / away_m).min(1.0)
            })
            .collect()
    }

    /// The same with the measured tip at this distance from the model's (m).
    fn with_tip_offset(mut self, tip_offset_m: f64) -> Self {
        self.tip_offset_m = tip_offset_m;
        let thicker_m = self.thicker_m();
        for (section, thicker_m) in self.parameters.sections.iter_mut().zip(thicker_m) {
            section.body_radius_m += thicker_m;
        }
        self
    }

    /// A play of `play_m`, with each cable at another position in it.
    pub(super) fn slack(seed: u64, play_m: f64) -> Slack {
        let mut draw = Draw::new(seed);
        Slack::new(
            play_m,
            [(); CABLES_MAX].map(|()| 0.5 * play_m * draw.signed()),
        )
    }

    /// The actual and the commanded configuration.
    pub(super) fn places(&self) -> impl Iterator<Item = &[f64]> {
        core::iter::once(self.at.as_slice()).chain(self.commanded.as_deref())
    }

    /// Robots of 1 to 6 sections with strokes from tight to free, among 1 to 64 obstacles at rest or moving.
    pub(super) fn random(seed: u64) -> Self {
        let mut draw = Draw::new(seed);
        let (parameters, at) = draw.robot();
        let period_s = draw.one_of(&[0.001, 0.005, 0.005, 0.01]);
        let rates = |draw: &mut Draw, share: f64| -> Vec<f64> {
            let most = at.iter().enumerate();
            most.map(|(i, _)| share * parameters.sections[i / 2].rate_max_rad_s * draw.signed())
                .collect()
        };
        let previous = if draw.chance(0.3) {
            vec![0.0; at.len()]
        } else {
            let share = draw.share();
            rates(&mut draw, share)
        };
        let comes_to_rest = draw.chance(0.15);
        let desired_rates = if comes_to_rest {
            let left = draw.share();
            previous.iter().map(|rate| left * rate).collect()
        } else {
            let share = draw.one_of(&[0.05, 0.5, 1.0, 1.3]);
            rates(&mut draw, share)
        };
        let commanded = draw
            .chance(0.3)
            .then(|| at.iter().map(|bend| bend + 0.05 * draw.signed()).collect());
        let balls = draw.balls(&parameters, &at, 64);
        let moment = Self {
            tip_offset_m: 0.0,
            commanded,
            previous,
            desired_rates,
            balls,
            safe_m: draw.one_of(&[0.0, 0.003, 0.01, 0.03]),
            acceleration_rad_s2: draw.one_of(&[20.0, 40.0, 200.0, f64::INFINITY]),
            period_s,
            moving_s: period_s * draw.between(1.0, 5.0),
            deceleration_rad_s2: draw.one_of(&[20.0, 40.0, 200.0, f64::INFINITY]),
            comes_to_rest,
            parameters,
            at,
        };
        let is_beside = draw.chance(0.2);
        let tip_offset_m = draw.between(0.0, 0.02);
        moment.with_tip_offset(if is_beside { tip_offset_m } else { 0.0 })
    }
}

/// Random number generator.
pub(super) struct Draw(Xoshiro256PlusPlus);

impl Draw {
    pub(super) fn new(seed: u64) -> Self {
        Self(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    pub(super) fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    pub(super) fn share(&mut self) -> f64 {
        self.between(0.0, 1.0)
    }

    fn signed(&mut self) -> f64 {
        self.between(-1.0, 1.0)
    }

    pub(super) fn chance(&mut self, share: f64) -> bool {
        self.share() < share
    }

    pub(super) fn one_of(&mut self, values: &[f64]) -> f64 {
        values[self.0.random_range(0..values.len())]
    }

    pub(super) fn count(&mut self, most: usize) -> usize {
        self.0.random_range(1..=most)
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| size * self.signed())
    }

    fn direction(&mut self) -> Vector3<f64> {
        loop {
            let vector = self.vector(1.0);
            if (0.01..1.0).contains(&vector.norm_squared()) {
                return vector.normalize();
            }
        }
    }

    /// A robot, and bends inside its limits or slightly beyond. Its strokes suffice for these bends, up to
    /// twice as much.
    pub(super) fn robot(&mut self) -> (RobotParameters, Vec<f64>) {
        let mut parameters = RobotParameters::paper(self.count(6));
        let is_papers = self.chance(0.4);
        for section in &mut parameters.sections {
            if !is_papers {
                section.length_m = self.between(0.05, 0.4);
                section.cable_radius_m = self.between(0.003, 0.03);
                section.cable_offset_rad = self.between(-PI, PI);
                section.bend_max_rad = self.between(0.8, PI);
                section.rate_max_rad_s = self.between(0.3, 5.0);
                section.body_radius_m = self.between(0.0, 0.03);
            }
        }
        let bent = self.one_of(&[0.1, 0.7, 1.02]);
        let at = self.bends(&parameters, bent);
        let strokes_m = strokes_m(&parameters, &at);
        let farthest_m = strokes_m.iter().fold(0.0_f64, |most, m| most.max(m.abs()));
        parameters.cable_stroke_max_m = (farthest_m * self.between(0.98, 2.0)).max(2e-3);
        parameters.cable_speed_max_m_s = self.one_of(&[0.02, 0.1, 0.5]);
        (parameters, at)
    }

    /// Bends of up to this share of each section's limit.
    pub(super) fn bends(&mut self, parameters: &RobotParameters, share: f64) -> Vec<f64> {
        let sections = parameters.sections.iter();
        sections
            .flat_map(|section| {
                let bend_rad = share * section.bend_max_rad * self.share();
                let (sin, cos) = self.between(-PI, PI).sin_cos();
                [bend_rad * cos, bend_rad * sin]
            })
            .collect()
    }

    /// Obstacles beside the body: from overlapping to out of reach, from wires to balls as thick as the body.
    pub(super) fn balls(
        &mut self,
        parameters: &RobotParameters,
        at: &[f64],
        most: usize,
    ) -> Vec<Ball> {
        let arcs = arcs(parameters, at);
        let most = self.one_of(&[3.0_f64, 15.0, 64.0]).min(most as f64);
        let nearest_m = self.one_of(&[-0.02, 0.0, 0.005, 0.02]);
        let moving = self.one_of(&[0.0, 0.3]);
        let count = self.count(most as usize);
        (0..count)
            .map(|_| {
                let section = self.count(arcs.len()) - 1;
                let length_m = parameters.sections[section].length_m;
                let side = self.direction();
                let radius_m = self.one_of(&[0.0, 0.001, 0.02, 0.04]);
                let away_m = parameters.sections[section].body_radius_m
                    + radius_m
                    + self.between(nearest_m, nearest_m + 0.06);
                let middle_m =
                    arcs[section].point_and_tangent(length_m * self.share()).0 + side * away_m;
                let span_m = if self.chance(0.5) {
                    side.cross(&self.direction()) * self.between(0.0, 0.4)
                } else {
                    Vector3::zeros()
                };
                let speed_m_s = self.one_of(&[0.05, 0.5, 2.0]);
                Ball {
                    start_m: middle_m - span_m * 0.5,
                    span_m,
                    radius_m,
                    velocity_m_s: if self.chance(moving) {
                        self.vector(speed_m_s)
                    } else {
                        Vector3::zeros()
                    },
                }
            })
            .collect()
    }
}

/// Whether the rates are a negligible share of the desired ones.
pub(super) fn stands(rates: &[f64], desired_rates: &[f64]) -> bool {
    norm(rates) < 1e-3 * norm(desired_rates)
}
