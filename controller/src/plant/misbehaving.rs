//! A robot as it is built: motors that lag, cables that have play, encoders that count from elsewhere, noise, another geometry.

use std::collections::VecDeque;

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::Flaws;
use crate::robot::{CABLES_MAX, Configuration, Robot, RobotError, RobotParameters};

/// What the motors are told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotorOrder {
    /// To stand where they are.
    Stand,
    /// To run at these speeds, one for each cable (m/s).
    Speeds([f64; CABLES_MAX]),
    /// To go to these lengths, one for each cable (m), counted as the model counts them.
    Lengths([f64; CABLES_MAX]),
}

/// The motors, cables and sensors of a robot. The same seed and the same orders give the same bits.
///
/// Orders take effect after the delay of the motors; a robot that gets none goes on with the last one, so who simulates a
/// driver orders [`MotorOrder::Stand`] when commands run out. No method but [`Self::new`] allocates.
#[derive(Debug, Clone)]
pub struct MisbehavingRobot {
    /// What the controller takes it for.
    model: Robot,
    /// What it is.
    truth: Robot,
    flaws: Flaws,
    /// Where the motors are, as lengths of cable counted from the model's straight robot (m).
    motor_m: [f64; CABLES_MAX],
    speed_m_s: [f64; CABLES_MAX],
    /// Where the cables are: behind their motors by the play (m).
    cable_m: [f64; CABLES_MAX],
    now_s: f64,
    order: MotorOrder,
    /// Orders that are under way to the motors, and when they arrive (s).
    coming: VecDeque<(f64, MotorOrder)>,
    noise: Xoshiro256PlusPlus,
}

/// Orders that can be under way at once: the longest delay of 0.3 s with one in each 0.1 ms. Of more the newest are lost.
const COMING_MAX: usize = 3000;

impl MisbehavingRobot {
    /// A robot at rest, whose encoders the `model` reads as `at` but for their flaws.
    ///
    /// # Errors
    /// When flaws of its geometry make it no robot.
    pub fn new(
        model: &Robot,
        at: &Configuration,
        flaws: Flaws,
        seed: u64,
    ) -> Result<Self, RobotError> {
        let mut truth = RobotParameters {
            sections: model.sections().to_vec(),
            cable_speed_max_m_s: model.cable_speed_max_m_s(),
            cable_stroke_max_m: model.cable_stroke_max_m(),
        };
        for section in &mut truth.sections {
            section.length_m *= 1.0 + flaws.length_error;
            section.cable_radius_m *= 1.0 + flaws.cable_radius_error;
            section.cable_offset_rad += flaws.cable_angle_error_rad;
        }
        let cable_m = model.cable_strokes(at);
        Ok(Self {
            model: model.clone(),
            truth: Robot::new(&truth)?,
            flaws,
            motor_m: cable_m,
            speed_m_s: [0.0; CABLES_MAX],
            cable_m,
            now_s: 0.0,
            order: MotorOrder::Stand,
            coming: VecDeque::with_capacity(COMING_MAX),
            noise: Xoshiro256PlusPlus::seed_from_u64(seed),
        })
    }

    /// The same with cables and sections that are those of another robot, whatever the flaws say of its geometry. It has as many
    /// sections as the model.
    #[must_use]
    pub fn with_truth(mut self, truth: Robot) -> Self {
        debug_assert_eq!(truth.section_count(), self.model.section_count());
        self.truth = truth;
        self
    }

    /// Other flaws of motors, cables and sensors from now on: a cable slips, a load comes. The geometry stays.
    pub fn set_flaws(&mut self, flaws: Flaws) {
        self.flaws = flaws;
    }

    /// Tells the motors what to do from now on, or from now and the delay on.
    pub fn order(&mut self, order: MotorOrder) {
        if self.flaws.actuator.delay_s <= 0.0 {
            self.order = order;
            return;
        }
        if self.coming.len() < COMING_MAX {
            let from_s = self.now_s + self.flaws.actuator.delay_s;
            self.coming.push_back((from_s, order));
        }
    }

    /// Lets `dt_s` (s) pass, as far as the sections bend: they have mechanical ends.
    pub fn advance(&mut self, dt_s: f64) {
        let end_s = self.now_s + dt_s;
        while let Some((from_s, order)) = self.coming.front().copied() {
            // Rounding of a sum of steps is no time.
            if from_s > end_s - 1e-9 {
                break;
            }
            self.run(from_s - self.now_s);
            self.order = order;
            self.coming.pop_front();
        }
        self.run(end_s - self.now_s);
        self.now_s = end_s;
    }

    /// The motors at their order for `dt_s`.
    fn run(&mut self, dt_s: f64) {
        if dt_s <= 0.0 {
            return;
        }
        self.now_s += dt_s;
        let time_constant_s = self.flaws.actuator.time_constant_s;
        // Of the way to its goal a motor has this part left.
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
                MotorOrder::Stand => self.speed_change(cable, 0.0, dt_s, left),
            };
            self.motor_m[cable] = here_m + moved_m.clamp(-most_m, most_m);
        }
        self.keep_ends();
        self.pull_cables();
    }

    /// Where a motor stands that was sent to a length (m).
    fn goal_m(&self, cable: usize, length_m: f64) -> f64 {
        let droop_m = if cable % 3 == 1 {
            self.flaws.droop_m
        } else {
            0.0
        };
        length_m - self.straight_m(cable) + droop_m
    }

    /// How far a motor runs (m) on the way to another speed.
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

    fn keep_ends(&mut self) {
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

    /// A motor takes its cable along when the play is over.
    fn pull_cables(&mut self) {
        let play_m = 0.5 * self.flaws.actuator.play_m;
        for (cable_m, motor_m) in self.cable_m.iter_mut().zip(&self.motor_m) {
            *cable_m = cable_m.clamp(motor_m - play_m, motor_m + play_m);
        }
    }

    /// Where the motors are, as lengths of cable counted from the model's straight robot (m).
    pub fn motor_strokes_m(&self) -> &[f64; CABLES_MAX] {
        &self.motor_m
    }

    /// What the encoders say (m).
    pub fn measure_cables(&mut self) -> [f64; CABLES_MAX] {
        let mut lengths_m = [0.0; CABLES_MAX];
        for cable in 0..self.model.cable_count() {
            let offset_m = if cable.is_multiple_of(3) {
                self.flaws.offset_m
            } else {
                0.0
            };
            let noise_m = self.flaws.noise_m * self.noise.random_range(-1.0..=1.0);
            let turned_m = self.motor_m[cable] + offset_m + noise_m;
            let tick_m = self.flaws.tick_m;
            let counted_m = if tick_m > 0.0 {
                (turned_m / tick_m).round() * tick_m
            } else {
                turned_m
            };
            lengths_m[cable] = self.straight_m(cable) + counted_m;
        }
        lengths_m
    }

    /// What a sensor of the tip's position says (m).
    pub fn measure_tip(&mut self) -> Vector3<f64> {
        let tip_m = self.tip_m();
        // A sum of twelve uniform numbers is as good as a normal one out to four deviations.
        tip_m.map(|coordinate_m| {
            let sum: f64 = (0..12).map(|_| self.noise.random_range(-0.5..=0.5)).sum();
            coordinate_m + self.flaws.tip_noise_m * sum
        })
    }

    /// How it is bent in truth (rad).
    pub fn configuration(&self) -> Configuration {
        let mut bends = self.truth.bend_from_cable_strokes(&self.cable_m);
        let (pairs, _) = bends.as_mut_slice().as_chunks_mut::<2>();
        for pair in pairs {
            let grown = 1.0 + pair[0].hypot(pair[1]);
            for (bend, payload_rad) in pair.iter_mut().zip(self.flaws.payload_rad) {
                *bend += payload_rad * grown;
            }
        }
        bends
    }

    /// Where its tip is in truth (m).
    pub fn tip_m(&self) -> Vector3<f64> {
        self.truth.tip_position(&self.configuration())
    }

    /// The robot that it is in truth.
    pub fn truth(&self) -> &Robot {
        &self.truth
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use super::*;
    use crate::estimator::Actuator;
    use crate::plant::Preset;
    use crate::robot::BendRates;

    const STEP_S: f64 = 0.001;

    fn model() -> Robot {
        Robot::new(&RobotParameters::paper(2)).unwrap()
    }

    fn bent(bend_rad: [f64; 4]) -> Configuration {
        Configuration::from_slice(&bend_rad).unwrap()
    }

    fn robot(flaws: Flaws) -> MisbehavingRobot {
        MisbehavingRobot::new(&model(), &bent([0.5, -0.2, 0.1, 0.0]), flaws, 7).unwrap()
    }

    fn lengths(bend_rad: [f64; 4]) -> MotorOrder {
        MotorOrder::Lengths(model().cable_lengths(&bent(bend_rad)))
    }

    fn speeds(rad_s: [f64; 4]) -> MotorOrder {
        let rates = BendRates::from_slice(&rad_s).unwrap();
        MotorOrder::Speeds(model().cable_speeds(&rates))
    }

    fn lagging(delay_s: f64, time_constant_s: f64) -> Flaws {
        Flaws {
            actuator: Actuator {
                delay_s,
                time_constant_s,
                play_m: 0.0,
            },
            ..Flaws::default()
        }
    }

    fn near(robot: &MisbehavingRobot, expected: [f64; 4], within_rad: f64) {
        let found = robot.configuration();
        for (found, expected) in found.as_slice().iter().zip(expected) {
            assert!(
                (found - expected).abs() <= within_rad,
                "{found}, {expected}"
            );
        }
    }

    fn run(robot: &mut MisbehavingRobot, order: MotorOrder, steps: u32, step_s: f64) {
        for _ in 0..steps {
            robot.order(order);
            robot.advance(step_s);
        }
    }

    #[test]
    fn the_ideal_robot_goes_where_it_is_sent_at_once_and_measures_it() {
        let mut robot = robot(Preset::Ideal.flaws());
        near(&robot, [0.5, -0.2, 0.1, 0.0], 1e-12);
        run(&mut robot, lengths([0.1, 0.2, 0.3, 0.4]), 1, STEP_S);
        near(&robot, [0.1, 0.2, 0.3, 0.4], 1e-12);
        run(&mut robot, speeds([1.0, 0.0, -2.0, 0.0]), 1, 0.1);
        near(&robot, [0.2, 0.2, 0.1, 0.4], 1e-12);
        let before = robot.measure_cables();
        run(&mut robot, MotorOrder::Stand, 1, 1.0);
        assert_eq!(robot.measure_cables(), before);
        let measured = model().bend_from_cable_lengths(&before);
        near(
            &robot,
            core::array::from_fn(|i| measured.as_slice()[i]),
            1e-12,
        );
        let tip_m = model().tip_position(&robot.configuration());
        assert!((robot.measure_tip() - tip_m).norm() < 1e-15);
    }

    #[test]
    fn motors_lag_by_their_time_constant_whatever_the_step() {
        let lag_s = 0.02;
        for steps in [1, 7, 100] {
            let mut robot = robot(lagging(0.0, lag_s));
            let step_s = 0.1 / f64::from(steps);
            run(&mut robot, speeds([1.0, 0.0, 0.0, 0.0]), steps, step_s);
            let behind = lag_s * (1.0 - (-0.1 / lag_s).exp());
            near(&robot, [0.6 - behind, -0.2, 0.1, 0.0], 1e-12);
            // It runs on for a while when it is told to stand.
            run(&mut robot, MotorOrder::Stand, 1, 10.0);
            near(&robot, [0.6, -0.2, 0.1, 0.0], 1e-12);
            run(&mut robot, lengths([0.0; 4]), 1, lag_s);
            let left = (-1.0_f64).exp();
            near(&robot, [0.6 * left, -0.2 * left, 0.1 * left, 0.0], 1e-12);
        }
    }

    #[test]
    fn orders_take_effect_after_the_delay_whatever_the_step() {
        for (step_s, delay_s) in [
            (0.0005, 0.015),
            (STEP_S, 0.015),
            (0.005, 0.015),
            (0.0001, 0.05),
        ] {
            let mut robot = robot(lagging(delay_s, 0.0));
            let steps = (0.1 / step_s).round() as u32;
            run(&mut robot, speeds([1.0, 0.0, 0.0, 0.0]), steps, step_s);
            near(&robot, [0.5 + 0.1 - delay_s, -0.2, 0.1, 0.0], 1e-12);
            run(&mut robot, MotorOrder::Stand, steps, step_s);
            near(&robot, [0.5 + 0.1, -0.2, 0.1, 0.0], 1e-12);
        }
    }

    #[test]
    fn a_cable_comes_along_when_the_play_is_over() {
        let mut robot = robot(Flaws {
            actuator: Actuator {
                play_m: 1e-3,
                ..Actuator::IDEAL
            },
            ..Flaws::default()
        });
        let straight = model().cable_strokes(&bent([0.5, -0.2, 0.1, 0.0]));
        let mut pulled = model().cable_lengths(&bent([0.5, -0.2, 0.1, 0.0]));
        pulled[0] += 2e-3;
        run(&mut robot, MotorOrder::Lengths(pulled), 1, STEP_S);
        assert!((robot.cable_m[0] - straight[0] - 1.5e-3).abs() < 1e-15);
        pulled[0] -= 0.9e-3;
        run(&mut robot, MotorOrder::Lengths(pulled), 1, STEP_S);
        assert!(
            (robot.cable_m[0] - straight[0] - 1.5e-3).abs() < 1e-15,
            "in its play"
        );
        pulled[0] -= 0.3e-3;
        run(&mut robot, MotorOrder::Lengths(pulled), 1, STEP_S);
        assert!((robot.cable_m[0] - straight[0] - 1.3e-3).abs() < 1e-15);
    }

    #[test]
    fn errors_of_the_geometry_and_a_load_bend_it_otherwise() {
        let mut longer = robot(Flaws {
            length_error: 0.05,
            cable_radius_error: -0.5,
            payload_rad: [0.01, 0.0],
            ..Flaws::default()
        });
        run(&mut longer, lengths([0.1, 0.0, 0.0, 0.0]), 1, STEP_S);
        // Half the radius: twice the bend; its encoders cannot know.
        near(&longer, [0.2 + 0.012, 0.0, 0.01, 0.0], 1e-12);
        let measured = model().bend_from_cable_lengths(&longer.measure_cables());
        assert!((measured.as_slice()[0] - 0.1).abs() < 1e-12);
        assert!((longer.truth().reach_m() - 0.63).abs() < 1e-12);
    }

    #[test]
    fn sensors_are_as_bad_as_is_said_and_repeat() {
        let flaws = Flaws {
            droop_m: 0.0,
            tick_m: 0.0,
            ..Preset::Laboratory.flaws()
        };
        let (mut one, mut other) = (robot(flaws), robot(flaws));
        let first = one.measure_cables();
        assert_eq!(first, other.measure_cables());
        assert_ne!(first, one.measure_cables());
        let true_m = model().cable_lengths(&one.configuration());
        let far =
            |measured: [f64; CABLES_MAX], cable: usize| (measured[cable] - true_m[cable]).abs();
        let most = (0..1000)
            .map(|_| far(other.measure_cables(), 2))
            .fold(0.0, f64::max);
        assert!((2.9e-5..=3.0001e-5).contains(&most), "{most}");
        let mean = (0..1000)
            .map(|_| other.measure_cables()[3] - true_m[3])
            .sum::<f64>()
            / 1000.0;
        assert!((mean - 1e-4).abs() < 2e-6, "{mean}");
        let tip_m = one.tip_m();
        let squares = (0..10_000).map(|_| (one.measure_tip() - tip_m).norm_squared());
        let deviation_m = (squares.sum::<f64>() / 30_000.0).sqrt();
        assert!((deviation_m / 3e-4 - 1.0).abs() < 0.02, "{deviation_m}");
        let mut counted = robot(Flaws {
            tick_m: 1e-3,
            ..Flaws::default()
        });
        let ticks = (counted.measure_cables()[0] - 0.3) / 1e-3;
        assert!((ticks - ticks.round()).abs() < 1e-9);
    }

    #[test]
    fn sections_have_mechanical_ends_and_motors_a_largest_speed() {
        for order in [speeds([3.0, 4.0, 0.0, 0.0]), lengths([3.0, 4.0, 0.1, 0.0])] {
            let mut robot = robot(lagging(0.0, 0.02));
            run(&mut robot, order, 10_000, STEP_S);
            let [u, v, w, ..] = *robot.configuration().as_slice() else {
                unreachable!("two sections")
            };
            assert!((u.hypot(v) - 2.8).abs() < 1e-9);
            assert!((w - 0.1).abs() < 1e-9 && v > u);
        }
        let mut slow = robot(Flaws {
            motor_speed_max_m_s: 0.01,
            ..Flaws::default()
        });
        let before = slow.motor_m;
        run(&mut slow, lengths([0.0; 4]), 10, STEP_S);
        let most = (0..6).map(|cable| (slow.motor_m[cable] - before[cable]).abs());
        assert!((most.fold(0.0, f64::max) - 1e-4).abs() < 1e-15);
    }
}
