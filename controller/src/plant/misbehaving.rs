//! A robot that differs from its model: motors that lag, cables with play, encoders with offsets, noise, another
//! geometry.

use std::collections::VecDeque;

use nalgebra::{Isometry3, Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::slack_cables::bent_by_slack_cables;
use super::{Flaws, Sampling};
use crate::robot::{CABLES_MAX, Configuration, Obstacle, Robot, RobotError};

/// The model with other section lengths (m), cable distances (m) and cable angles (rad): three numbers for each
/// section, base first. Sections without an entry are as in the model.
///
/// # Errors
/// If these numbers make no valid robot.
pub fn true_robot(model: &Robot, geometry: &[[f64; 3]]) -> Result<Robot, RobotError> {
    let mut truth = model.parameters();
    for (section, [length_m, radius_m, angle_rad]) in truth.sections.iter_mut().zip(geometry) {
        section.length_m = *length_m;
        section.cable_radius_m = *radius_m;
        section.cable_offset_rad = *angle_rad;
    }
    Robot::new(&truth)
}

/// Command to the motors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotorOrder {
    /// The motors rest, for example because no command is valid.
    Stop,
    /// Run at these speeds, one for each cable (m/s).
    Speeds([f64; CABLES_MAX]),
    /// Go to these lengths, one for each cable (m), in the model's count.
    Lengths([f64; CABLES_MAX]),
}

/// The motors, cables and sensors of a robot. The same seed and the same orders give the same bits.
///
/// Orders take effect after the delay of the motors, and the last one remains in effect. The simulation of a driver
/// must therefore order [`MotorOrder::Stop`] when commands run out. No method except [`Self::new`] allocates.
#[derive(Debug, Clone)]
pub struct MisbehavingRobot {
    /// The robot that the controller assumes.
    model: Robot,
    /// The true robot.
    truth: Robot,
    flaws: Flaws,
    /// Positions of the motors, as cable lengths relative to the model's straight robot (m).
    motor_m: [f64; CABLES_MAX],
    speed_m_s: [f64; CABLES_MAX],
    /// Positions of the cables, which lag behind their motors by the play (m).
    cable_m: [f64; CABLES_MAX],
    now_s: f64,
    order: MotorOrder,
    /// Orders on their way to the motors, with their arrival times (s).
    pending: VecDeque<(f64, MotorOrder)>,
    /// Past positions of motors and cables, one for each millisecond, for sensors with a delay.
    history: VecDeque<Moment>,
    /// Times at which the encoders and the tip sensor measure next (s).
    due_s: [f64; 2],
    noise: Xoshiro256PlusPlus,
}

/// Positions of motors and cables at one time.
#[derive(Debug, Clone, Copy)]
struct Moment {
    time_s: f64,
    motor_m: [f64; CABLES_MAX],
    cable_m: [f64; CABLES_MAX],
}

/// Number of moments kept: the milliseconds of the longest delay, 300, with a reserve.
const HISTORY_MAX: usize = 320;
const HISTORY_STEP_S: f64 = 1e-3;
/// Tolerance for the rounding of summed steps (s).
const ROUNDING_S: f64 = 1e-9;

/// Orders that can be under way at once: the longest delay of 0.3 s with one every 0.1 ms. Beyond that, new orders are
/// lost.
const PENDING_MAX: usize = 3000;

impl MisbehavingRobot {
    /// A robot at rest. Except for their flaws, its encoders measure the shape `at` of the `model`.
    ///
    /// # Errors
    /// If the flaws make no valid robot.
    pub fn new(
        model: &Robot,
        at: &Configuration,
        flaws: Flaws,
        seed: u64,
    ) -> Result<Self, RobotError> {
        let mut truth = model.parameters();
        for section in &mut truth.sections {
            section.length_m *= 1.0 + flaws.length_error;
            section.cable_radius_m *= 1.0 + flaws.cable_radius_error;
            section.cable_offset_rad += flaws.cable_angle_error_rad;
        }
        let cable_m = model.cable_strokes(at);
        let mut robot = Self {
            model: model.clone(),
            truth: Robot::new(&truth)?,
            flaws,
            motor_m: cable_m,
            speed_m_s: [0.0; CABLES_MAX],
            cable_m,
            now_s: 0.0,
            order: MotorOrder::Stop,
            pending: VecDeque::with_capacity(PENDING_MAX),
            history: VecDeque::with_capacity(HISTORY_MAX),
            due_s: [0.0; 2],
            noise: Xoshiro256PlusPlus::seed_from_u64(seed),
        };
        robot.record_moment();
        Ok(robot)
    }

    /// Replaces the true robot, whatever the flaws specify for its geometry. It must have the model's section count.
    #[must_use]
    pub fn with_truth(mut self, truth: Robot) -> Self {
        debug_assert_eq!(truth.section_count(), self.model.section_count());
        self.truth = truth;
        self
    }

    /// Replaces the flaws of motors, cables and sensors, for example when a cable slips or a load is added. The
    /// geometry stays.
    pub fn set_flaws(&mut self, flaws: Flaws) {
        self.flaws = flaws;
    }

    /// Gives the motors an order, which takes effect after their delay.
    pub fn order(&mut self, order: MotorOrder) {
        if self.flaws.actuator.delay_s <= 0.0 {
            self.order = order;
            return;
        }
        if self.pending.len() < PENDING_MAX {
            let from_s = self.now_s + self.flaws.actuator.delay_s;
            self.pending.push_back((from_s, order));
        }
    }

    /// Advances the simulation by `dt_s` (s). The mechanical ends of the sections limit the motion.
    pub fn advance(&mut self, dt_s: f64) {
        let end_s = self.now_s + dt_s;
        while let Some((from_s, order)) = self.pending.front().copied() {
            if from_s > end_s - ROUNDING_S {
                break;
            }
            self.run(from_s - self.now_s);
            self.order = order;
            self.pending.pop_front();
        }
        self.run(end_s - self.now_s);
        self.now_s = end_s;
        self.record_moment();
    }

    /// Stores the present positions for sensors with a delay.
    fn record_moment(&mut self) {
        let is_old = |last: &Moment| self.now_s - last.time_s > HISTORY_STEP_S - ROUNDING_S;
        if self.history.back().is_none_or(is_old) {
            if self.history.len() == HISTORY_MAX {
                self.history.pop_front();
            }
            self.history.push_back(self.moment());
        }
    }

    fn moment(&self) -> Moment {
        Moment {
            time_s: self.now_s,
            motor_m: self.motor_m,
            cable_m: self.cable_m,
        }
    }

    /// The moment that a sensor reports when it is read now; `None`: no measurement.
    fn sample(&mut self, sensor: usize, sampling: Sampling) -> Option<Moment> {
        if sampling.interval_s > 0.0 {
            if self.now_s < self.due_s[sensor] - ROUNDING_S {
                return None;
            }
            // On a grid, except after a pause in reading.
            self.due_s[sensor] = (self.due_s[sensor] + sampling.interval_s).max(self.now_s);
        }
        if sampling.dropout > 0.0 && self.noise.random_bool(sampling.dropout.min(1.0)) {
            return None;
        }
        if sampling.delay_s <= 0.0 {
            return Some(self.moment());
        }
        let then_s = self.now_s - sampling.delay_s + ROUNDING_S;
        let mut past = self.history.iter().rev();
        // Before the first moment, the robot was at rest there.
        let then = past.find(|moment| moment.time_s <= then_s);
        then.or(self.history.front()).copied()
    }

    /// Runs the motors with their order for `dt_s`.
    fn run(&mut self, dt_s: f64) {
        if dt_s <= 0.0 {
            return;
        }
        self.now_s += dt_s;
        let time_constant_s = self.flaws.actuator.time_constant_s;
        // Share of the distance to the goal that remains.
        let left = if time_constant_s > 0.0 {
            (-dt_s / time_constant_s).exp()
        } else {
            0.0
        };
        let most_m = self.flaws.motor_speed_max_m_s * dt_s;
        for cable in 0..self.model.cable_count() {
            let here_m = self.motor_m[cable];
            let moved_m = match &self.order {
                MotorOrder::Lengths(goals_m) => {
                    (self.goal_m(cable, goals_m[cable]) - here_m) * (1.0 - left)
                }
                MotorOrder::Speeds(goals_m_s) => {
                    self.speed_change(cable, goals_m_s[cable], dt_s, left)
                }
                MotorOrder::Stop => self.speed_change(cable, 0.0, dt_s, left),
            };
            self.motor_m[cable] = here_m + moved_m.clamp(-most_m, most_m);
        }
        self.limit_bends();
        self.pull_cables();
    }

    /// Final position of a motor with a length as its goal (m).
    fn goal_m(&self, cable: usize, length_m: f64) -> f64 {
        let droop_m = if cable % 3 == 1 {
            self.flaws.droop_m
        } else {
            0.0
        };
        length_m - self.straight_m(cable) + droop_m
    }

    /// Travel of a motor (m) while it approaches another speed.
    fn speed_change(&mut self, cable: usize, goal_m_s: f64, dt_s: f64, left: f64) -> f64 {
        let behind_m_s = self.speed_m_s[cable] - goal_m_s;
        self.speed_m_s[cable] = goal_m_s + behind_m_s * left;
        goal_m_s * dt_s + behind_m_s * self.flaws.actuator.time_constant_s * (1.0 - left)
    }

    /// The model's length of a cable of the straight robot (m).
    fn straight_m(&self, cable: usize) -> f64 {
        let sections = &self.model.sections()[..=cable / 3];
        sections.iter().map(|section| section.length_m).sum()
    }

    fn limit_bends(&mut self) {
        let mut bends = self.model.bend_from_cable_strokes(&self.motor_m);
        let mut is_beyond = false;
        let (pairs, _) = bends.as_mut_slice().as_chunks_mut::<2>();
        for ([u, v], section) in pairs.iter_mut().zip(self.model.sections()) {
            let beyond = u.hypot(*v) / section.bend_max_rad;
            if beyond > 1.0 {
                (*u, *v) = (*u / beyond, *v / beyond);
                is_beyond = true;
            }
        }
        if is_beyond {
            self.motor_m = self.model.cable_strokes(&bends);
        }
    }

    /// A motor takes its cable along beyond half of the play plus friction.
    fn pull_cables(&mut self) {
        let mut band_m = 0.5 * self.flaws.actuator.play_m;
        let bends = (self.flaws.friction_m_per_rad > 0.0)
            .then(|| self.model.bend_from_cable_strokes(&self.motor_m));
        let motors_m = self.motor_m.chunks_exact(3);
        let cables_m = self.cable_m.chunks_exact_mut(3).zip(motors_m);
        for (section, (cables_m, motors_m)) in cables_m.take(self.model.section_count()).enumerate()
        {
            if let Some(bends) = &bends {
                band_m += self.flaws.friction_m_per_rad * bends.bend_rad(section);
            }
            for (cable_m, motor_m) in cables_m.iter_mut().zip(motors_m) {
                *cable_m = cable_m.clamp(motor_m - band_m, motor_m + band_m);
            }
        }
    }

    /// Positions of the motors, as cable lengths relative to the model's straight robot (m).
    pub fn motor_strokes_m(&self) -> &[f64; CABLES_MAX] {
        &self.motor_m
    }

    /// Cable lengths from the encoders (m); `None`: no measurement now, because of their interval or a dropout.
    pub fn measure_cables(&mut self) -> Option<[f64; CABLES_MAX]> {
        let then = self.sample(0, self.flaws.cables)?;
        let mut lengths_m = [0.0; CABLES_MAX];
        for cable in 0..self.model.cable_count() {
            let offset_m = if cable.is_multiple_of(3) {
                self.flaws.offset_m
            } else {
                0.0
            };
            let noise_m = self.flaws.noise_m * self.noise.random_range(-1.0..=1.0);
            let turned_m = then.motor_m[cable] + offset_m + noise_m;
            lengths_m[cable] = self.straight_m(cable) + quantised(turned_m, self.flaws.tick_m);
        }
        Some(lengths_m)
    }

    /// Tip position from the tip sensor (m); `None` as in [`Self::measure_cables`].
    pub fn measure_tip(&mut self) -> Option<Vector3<f64>> {
        let then = self.sample(1, self.flaws.tip)?;
        let tip_m = self.tip_at(&then.cable_m) + Vector3::from(self.flaws.tip_bias_m);
        // A sum of twelve uniform numbers approximates a normal one up to four standard deviations.
        Some(tip_m.map(|coordinate_m| {
            let sum: f64 = (0..12).map(|_| self.noise.random_range(-0.5..=0.5)).sum();
            quantised(
                coordinate_m + self.flaws.tip_noise_m * sum,
                self.flaws.tip_tick_m,
            )
        }))
    }

    /// True bends (rad).
    pub fn configuration(&self) -> Configuration {
        self.bent_by(&self.cable_m)
    }

    fn bent_by(&self, cable_m: &[f64; CABLES_MAX]) -> Configuration {
        // A negative stroke is a pulled cable.
        let mut bends_m = cable_m.map(|stroke_m| {
            let stretched = if stroke_m < 0.0 {
                self.flaws.stretch
            } else {
                0.0
            };
            stroke_m * (1.0 - stretched) + self.flaws.slack_m
        });
        let broken = (self.flaws.broken_cable as usize).checked_sub(1);
        if let Some(stroke_m) = broken.and_then(|broken| bends_m.get_mut(broken)) {
            *stroke_m = f64::INFINITY;
        }
        let mut bends = if broken.is_some() || self.flaws.slack_m > 0.0 {
            bent_by_slack_cables(&self.truth, &bends_m)
        } else {
            self.truth.bend_from_cable_strokes(&bends_m)
        };
        let (pairs, _) = bends.as_mut_slice().as_chunks_mut::<2>();
        for pair in pairs {
            let grown = 1.0 + pair[0].hypot(pair[1]);
            for (bend, payload_rad) in pair.iter_mut().zip(self.flaws.payload_rad) {
                *bend += payload_rad * grown;
            }
        }
        bends
    }

    /// True position of the tip (m), in the frame of the references.
    pub fn tip_m(&self) -> Vector3<f64> {
        self.tip_at(&self.cable_m)
    }

    fn tip_at(&self, cable_m: &[f64; CABLES_MAX]) -> Vector3<f64> {
        let tip_m = self.truth.tip_position(&self.bent_by(cable_m));
        match self.base() {
            None => tip_m,
            Some(base) => (base * Point3::from(tip_m)).coords,
        }
    }

    /// Pose of the base in the frame of the references; `None`: identity.
    fn base(&self) -> Option<Isometry3<f64>> {
        let Flaws {
            base_m,
            base_turn_rad,
            ..
        } = self.flaws;
        let is_elsewhere = base_m.iter().chain(&base_turn_rad).any(|part| *part != 0.0);
        is_elsewhere.then(|| Isometry3::new(base_m.into(), base_turn_rad.into()))
    }

    /// Least true clearance of the whole body (m) from `obstacles` in the frame of the references; infinite for none.
    pub fn clearance_m(&self, obstacles: impl Iterator<Item = Obstacle>) -> f64 {
        let body = self.truth.body(&self.configuration());
        match self.base().map(|base| base.inverse()) {
            None => body.least_clearance_m(obstacles),
            Some(seen) => body.least_clearance_m(obstacles.map(|obstacle| obstacle.seen_in(&seen))),
        }
    }

    /// The robot that the controller assumes.
    pub fn model(&self) -> &Robot {
        &self.model
    }

    /// The true robot.
    pub fn truth(&self) -> &Robot {
        &self.truth
    }
}

/// A value quantised in steps of `tick_m` (m); 0: none.
fn quantised(value_m: f64, tick_m: f64) -> f64 {
    if tick_m > 0.0 {
        (value_m / tick_m).round() * tick_m
    } else {
        value_m
    }
}

#[cfg(test)]
mod tests;
