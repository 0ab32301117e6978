use crate::robot::{CABLES_MAX, Configuration, Robot};

/// Play between motors and cables: the offset of each cable from its motor. A reversing motor takes its cable along
/// only after it has crossed the play (play operator: A. Visintin, *Differential Models of Hysteresis*, Springer 1994,
/// §III.2).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slack {
    /// The play (m), 0 or more.
    play_m: f64,
    /// Cable minus motor (m), within ± half of the play; in the order of [`Robot::cable_lengths`].
    slack_m: [f64; CABLES_MAX],
}

/// The part of the play that a reversing motor crosses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlayWindow {
    /// Share of the play.
    part: f64,
    /// Cable minus motor at the middle of this part (m).
    middle_m: [f64; CABLES_MAX],
}

impl PlayWindow {
    /// The whole play.
    pub(super) const WHOLE: Self = Self {
        part: 1.0,
        middle_m: [0.0; CABLES_MAX],
    };

    /// A window of a share `part` of the play, in which `slack` has the same relative position. Cables that move with
    /// their motors continue to do so.
    pub(super) fn around(slack: &Slack, part: f64) -> Self {
        let middle_m = slack.slack_m.map(|slack_m| (1.0 - part) * slack_m);
        Self { part, middle_m }
    }
}

impl Slack {
    /// Cables in the middle of a play of `play_m` (m).
    pub(super) fn middle(play_m: f64) -> Self {
        Self::new(play_m, [0.0; CABLES_MAX])
    }

    /// Cables at an offset `slack_m` (m) from their motors, within ± half of the play `play_m` (m). A negative play and
    /// a NaN count as none.
    pub fn new(play_m: f64, slack_m: [f64; CABLES_MAX]) -> Self {
        Self {
            play_m: play_m.max(0.0),
            slack_m,
        }
    }

    /// The play (m), 0 or more.
    pub fn play_m(&self) -> f64 {
        self.play_m
    }

    /// Cable minus motor (m), in the order of [`Robot::cable_lengths`].
    pub fn slack_m(&self) -> &[f64; CABLES_MAX] {
        &self.slack_m
    }

    /// State after the motors moved by `moved` (rad) at constant rates.
    #[must_use]
    pub fn moved(&self, robot: &Robot, moved: &Configuration) -> Self {
        self.moved_within(robot, moved, &PlayWindow::WHOLE)
    }

    /// As [`Self::moved`], with motors that take their cables along at the ends of `window`.
    pub(super) fn moved_within(
        &self,
        robot: &Robot,
        moved: &Configuration,
        window: &PlayWindow,
    ) -> Self {
        let mut next = *self;
        let half_m = 0.5 * window.part * self.play_m;
        let cables = next.slack_m.iter_mut().zip(robot.cable_strokes(moved));
        for ((slack_m, stroke_m), middle_m) in cables.zip(&window.middle_m) {
            *slack_m = (*slack_m - stroke_m).clamp(middle_m - half_m, middle_m + half_m);
        }
        next
    }

    /// The same relative position in the whole play as this one in `window`.
    pub(super) fn widened(&self, window: &PlayWindow) -> Self {
        let mut wide = *self;
        for (slack_m, middle_m) in wide.slack_m.iter_mut().zip(&window.middle_m) {
            *slack_m = (*slack_m - middle_m) / window.part;
        }
        wide
    }

    /// True if each cable either rests or moves with its motor all the time between these two moves (rad) from here in
    /// one direction.
    pub(crate) fn is_even_between(
        &self,
        robot: &Robot,
        from: &Configuration,
        to: &Configuration,
    ) -> bool {
        let half_m = 0.5 * self.play_m;
        let strokes_m = robot.cable_strokes(from).into_iter();
        let strokes_m = strokes_m.zip(robot.cable_strokes(to));
        let mut cables = self.slack_m.iter().zip(strokes_m);
        cables.all(|(slack_m, (from_m, to_m))| {
            let (from_m, to_m) = (slack_m - from_m, slack_m - to_m);
            let stands = from_m.abs() <= half_m && to_m.abs() <= half_m;
            stands || (from_m >= half_m && to_m >= half_m) || (from_m.max(to_m) <= -half_m)
        })
    }

    /// Bends of the robot minus those of its motors (rad).
    pub fn bends(&self, robot: &Robot) -> Configuration {
        robot.bend_from_cable_strokes(&self.slack_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::{Actuator, Estimator, Measurement};
    use crate::plant::{Flaws, MisbehavingRobot, MotorOrder};
    use crate::robot::{BendRates, RobotParameters};

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

    /// Encoder noise while the tip is measured: the cables rest until the motion exceeds a tenth of the play.
    #[test]
    fn noise_of_the_motors_moves_no_cable_while_the_tip_is_measured() {
        let (robot, rest) = (robot(), BendRates::zero(3));
        let actuator = Actuator {
            play_m: 5e-4,
            ..Actuator::IDEAL
        };
        let mut estimator = Estimator::new(bent(0.2)).with_actuator(&robot, actuator);
        let mut moved_rad = |bend_rad: f64, has_tip: bool| {
            if has_tip {
                estimator.predict(&rest, PERIOD_S);
                let tip_m = robot.tip_position(&bent(0.2));
                let _ = estimator.correct_tip(&robot, &tip_m, 0.0);
            }
            let before = *estimator.configuration();
            let lengths_m = robot.cable_lengths(&bent(bend_rad));
            estimator.correct(&robot, &Measurement::CableLengths(lengths_m), 0.0);
            let after = estimator.configuration();
            let [x, y] = [0, 1].map(|i| after.as_slice()[i] - before.as_slice()[i]);
            (most(after, &before), x.hypot(y))
        };
        assert!((moved_rad(0.2003, false).0 - 3e-4).abs() < 1e-9);
        // At most 10 µm, in a band of 50 µm.
        assert!(moved_rad(0.2001, true).0 < 1e-9 && moved_rad(0.2003, true).0 < 1e-9);
        // Of the first section's 13.7 mrad, the part beyond half of the band.
        let (_, far_rad) = moved_rad(0.21, true);
        assert!((0.009..0.013).contains(&far_rad), "{far_rad}");
        // The cable follows further motion, and rests after a reversal.
        assert!(moved_rad(0.22, true).1 > 0.0141);
        assert!(moved_rad(0.2199, true).0 < 1e-9);
    }

    /// At rest with a measured tip, the motors cross three quarters of the play. When the robot moves on, its cables
    /// are taken to have crossed the whole play, and its tip stays in place.
    #[test]
    fn excess_play_at_rest_does_not_move_the_robot() {
        let robot = Robot::new(&RobotParameters::paper(1)).unwrap();
        let actuator = Actuator {
            play_m: 5e-4,
            ..Actuator::IDEAL
        };
        let start = Configuration::from_slice(&[0.3, 0.0]).unwrap();
        let mut estimator = Estimator::new(start).with_actuator(&robot, actuator);
        let mut go = |rate_rad_s: f64| {
            let rates = BendRates::from_slice(&[rate_rad_s, 0.0]).unwrap();
            let before = *estimator.configuration();
            estimator.predict(&rates, PERIOD_S);
            let model_tip_m = robot.tip_position(estimator.configuration());
            let tip_m = model_tip_m + estimator.tip_offset_m();
            let _ = estimator.correct_tip(&robot, &tip_m, 0.0);
            let after = estimator.configuration();
            let seen_m = robot.tip_position(after) + estimator.tip_offset_m();
            let moved_rad = after.as_slice()[0] - before.as_slice()[0];
            (moved_rad, (seen_m - tip_m).norm())
        };
        // Until all cables move with their motors.
        for _ in 0..4000 {
            go(5e-3);
        }
        // The first cable's motor moves 0.3125 µm each time.
        let stands = (0..2000).take_while(|_| go(-5e-3).0.abs() < 1e-6).count();
        assert!((1195..1205).contains(&stands), "{stands} periods");
        for _ in 0..2000 {
            go(-5e-3);
        }
        let (moved_rad, jumped_m) = go(-0.5);
        // All three cables lag by another eighth of the play: 62.5 µm, as bend 4/3 of that.
        let farther_rad = 4.0 / 3.0 * 6.25e-5 / 0.0125;
        let off_rad = moved_rad - (farther_rad - 2.5e-3);
        assert!(off_rad.abs() < 2e-5, "{moved_rad}");
        assert!(jumped_m < 1e-9, "{jumped_m} m");
    }

    /// Without measurements, the estimate of the present configuration equals that of the plant at each release.
    #[test]
    fn the_estimate_crosses_the_play_as_the_robot_does() {
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

            // A restart at the motors' configuration moves no cable.
            for _ in 0..100 {
                estimator.predict(&BendRates::zero(3), PERIOD_S);
            }
            let rest = *estimator.configuration();
            estimator.begin(*estimator.motors());
            assert!(most(estimator.configuration(), &rest) < 1e-15);
            assert!(most(&estimator.present(), &rest) < 1e-15);
        }
    }
}
