use crate::robot::{BendRates, CABLES_MAX, Configuration, Robot};

/// Part of the play that a cable has to be asked for in one period before its motor turns round. Noise of the tip asks for less, and would
/// make the motors run through the play in every period. With 0.5 mm of play, figures are the same for 2 % to 10 %.
const TURN_MIN: f64 = 0.05;

/// How far each cable is beside its motor, where there is play between them: a motor that turns round takes its cable along when the
/// play is over (the play operator: A. Visintin, *Differential Models of Hysteresis*, Springer 1994, §III.2).
///
/// Cables with much play are where their motors are, but for half of the play: on the side from which they were pulled last.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Slack {
    /// The play (m), 0 or more.
    pub play_m: f64,
    /// Cable minus motor (m), within ± half of the play; in the order of [`Robot::cable_lengths`].
    pub slack_m: [f64; CABLES_MAX],
}

impl Slack {
    /// Cables in the middle of a play of `play_m` (m).
    pub fn middle(play_m: f64) -> Self {
        Self {
            play_m,
            slack_m: [0.0; CABLES_MAX],
        }
    }

    /// After the motors moved evenly by `moved` (rad).
    #[must_use]
    pub fn moved(&self, robot: &Robot, moved: &Configuration) -> Self {
        let mut next = *self;
        let half_m = 0.5 * self.play_m;
        for (slack_m, stroke_m) in next.slack_m.iter_mut().zip(robot.cable_strokes(moved)) {
            *slack_m = (*slack_m - stroke_m).clamp(-half_m, half_m);
        }
        next
    }

    /// Bends of the robot minus those that its motors tell (rad).
    pub fn bends(&self, robot: &Robot) -> Configuration {
        robot.bend_from_cable_strokes(&self.slack_m)
    }

    /// The rates of the motors with which the robot moves at `desired` for `period_s` (s): each motor runs through what is left of the
    /// play on the side to which its cable shall go. What the common stroke of a section's cables takes off is made up for by the next call.
    pub fn motor_rates(&self, robot: &Robot, desired: &BendRates, period_s: f64) -> BendRates {
        let straight = Configuration::straight(robot.section_count());
        let mut motors_m = robot.cable_strokes(&straight.advanced(desired, period_s));
        for (motor_m, slack_m) in motors_m.iter_mut().zip(self.slack_m) {
            if motor_m.abs() > TURN_MIN * self.play_m {
                *motor_m += slack_m + (0.5 * self.play_m).copysign(*motor_m);
            }
        }
        let moved = robot.bend_from_cable_strokes(&motors_m);
        let mut rates = *desired;
        for (rate, moved) in rates.as_mut_slice().iter_mut().zip(moved.as_slice()) {
            *rate = moved / period_s;
        }
        rates
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use super::*;
    use crate::estimator::{Actuator, Estimator};
    use crate::plant::{Flaws, MisbehavingRobot, MotorOrder};
    use crate::robot::RobotParameters;

    const PERIOD_S: f64 = 0.005;

    fn robot() -> Robot {
        Robot::new(&RobotParameters::paper(3)).unwrap()
    }

    fn bent(bend_rad: f64) -> Configuration {
        Configuration::from_slice(&[bend_rad; 6]).unwrap()
    }

    fn most(a: &Configuration, b: &Configuration) -> f64 {
        let pairs = a.as_slice().iter().zip(b.as_slice());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    /// Nothing is measured: where the estimate takes the robot for is where the plant is, at each release.
    #[test]
    fn the_estimate_goes_through_the_play_as_the_robot_does() {
        for (delay_s, time_constant_s) in [(0.0, 0.0), (0.015, 0.0), (0.01, 0.03)] {
            let actuator = Actuator {
                delay_s,
                time_constant_s,
                play_m: 5e-4,
            };
            let flaws = Flaws {
                actuator,
                ..Flaws::default()
            };
            let robot = robot();
            let mut plant = MisbehavingRobot::new(&robot, &bent(0.2), flaws, 1).unwrap();
            let mut estimator = Estimator::new(bent(0.2)).with_actuator(&robot, actuator);
            let (mut farthest_rad, mut played_rad) = (0.0_f64, 0.0_f64);
            for cycle in 0..2000 {
                let turn = f64::from(cycle) * PERIOD_S;
                let rate = |i: i32| 0.1 * (turn * (1.0 + 0.3 * f64::from(i)) + f64::from(i)).sin();
                let rates = BendRates::from_slice(&[0, 1, 2, 3, 4, 5].map(rate)).unwrap();
                plant.order(MotorOrder::Speeds(robot.cable_speeds(&rates)));
                plant.advance(PERIOD_S);
                estimator.predict(&rates, PERIOD_S);
                let truth = plant.configuration();
                farthest_rad = farthest_rad.max(most(&estimator.present(), &truth));
                played_rad = played_rad.max(most(estimator.motors(), estimator.configuration()));
            }
            assert!(played_rad > 0.02, "{played_rad}");
            assert!(farthest_rad < 1e-5, "{actuator:?}: {farthest_rad}");
        }
    }

    /// A robot that was bent to one side shall bend a little less: its motors run through the play at once. Sent there as if there were
    /// no play, they need several periods.
    #[test]
    fn motors_that_turn_round_run_through_the_play_at_once() {
        let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
        let bent = |u: f64, v: f64| Configuration::from_slice(&[u, v]).unwrap();
        let periods = |is_compensated: bool, [u, v]: [f64; 2]| {
            let mut slack = Slack::middle(5e-4).moved(&robot, &bent(10.0 * u, 10.0 * v));
            let mut goal = [-u, -v];
            let arrives = (1..100).find(|_| {
                let desired = BendRates::from_slice(&goal.map(|rad| rad / PERIOD_S)).unwrap();
                let rates = if is_compensated {
                    slack.motor_rates(&robot, &desired, PERIOD_S)
                } else {
                    desired
                };
                let before = slack.bends(&robot);
                let moved = bent(0.0, 0.0).advanced(&rates, PERIOD_S);
                slack = slack.moved(&robot, &moved);
                let after = slack.bends(&robot);
                for (i, goal) in goal.iter_mut().enumerate() {
                    *goal -= moved.as_slice()[i] + after.as_slice()[i] - before.as_slice()[i];
                }
                goal[0].hypot(goal[1]) < 4e-3
            });
            arrives.unwrap()
        };
        for direction in 0..12 {
            let (sin, cos) = (core::f64::consts::FRAC_PI_6 * f64::from(direction)).sin_cos();
            let way_rad = [0.01 * cos, 0.01 * sin];
            let (compensated, plain) = (periods(true, way_rad), periods(false, way_rad));
            println!("{direction}: {compensated}, {plain}");
            assert!(compensated <= 2 && plain >= 4, "{compensated}, {plain}");
        }
    }
}
