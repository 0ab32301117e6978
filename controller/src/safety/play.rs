//! Correction of a safe command for cables with play.

use super::situation::{SafeCommand, Situation};
use super::stopping::fastest;
use crate::estimator::Slack;
use crate::robot::BendRates;

/// `safe` if it satisfies the rule of the guard while cables move through their play, too; otherwise the
/// correction that [`safe_command`](super::safe_command) describes.
pub(super) fn kept(situation: &Situation<'_>, slack: &Slack, safe: SafeCommand) -> SafeCommand {
    if fastest(&safe.rates) == 0.0 || situation.obstacles.is_empty() {
        return safe;
    }
    let guard = situation.guard();
    guard.through_play(slack, &safe.rates, |holds| {
        if holds(&safe.rates) {
            return safe;
        }
        repaired(situation, &safe, holds)
    })
}

/// Whether `rates` satisfy the rule of the guard while cables move through their play, too.
pub(super) fn holds(situation: &Situation<'_>, slack: &Slack, rates: &BendRates) -> bool {
    fastest(rates) == 0.0
        || situation.obstacles.is_empty()
        || (situation.guard()).through_play(slack, rates, |holds| holds(rates))
}

/// The sections of a command that satisfy the rule individually.
fn repaired(
    situation: &Situation<'_>,
    safe: &SafeCommand,
    holds: &dyn Fn(&BendRates) -> bool,
) -> SafeCommand {
    let rest = BendRates::zero(situation.robot.section_count());
    let mut kept = rest;
    for section in 0..situation.robot.section_count() {
        let own = 2 * section..2 * section + 2;
        let rates = &safe.rates.as_slice()[own.clone()];
        let mut alone = rest;
        alone.as_mut_slice()[own.clone()].copy_from_slice(rates);
        if holds(&alone) {
            kept.as_mut_slice()[own].copy_from_slice(rates);
        }
    }
    // A cable that two sections share may go faster when only one of them moves.
    situation.repaired(safe, &kept, holds)
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{CABLES_MAX, Configuration, Obstacle, Robot, RobotParameters, Shape};
    use crate::safety::{ramp_to_zero, safe_command};

    const PLAY_M: f64 = 1e-3;
    const PERIOD_S: f64 = 0.005;
    const DECELERATION_RAD_S2: f64 = 40.0;

    fn slack(taken: &[f64]) -> Slack {
        let mut slack_m = [0.0; CABLES_MAX];
        for (slack_m, part) in slack_m.iter_mut().zip(taken) {
            *slack_m = PLAY_M * part;
        }
        Slack::new(PLAY_M, slack_m)
    }

    /// Configuration of the motors that belongs to that of the cables.
    fn motors(robot: &Robot, at: &Configuration, slack: &Slack) -> Configuration {
        let mut motors = *at;
        let taken = slack.bends(robot);
        for (motor, taken) in motors.as_mut_slice().iter_mut().zip(taken.as_slice()) {
            *motor -= taken;
        }
        motors
    }

    fn situation<'a>(
        robot: &'a Robot,
        at: &'a Configuration,
        motors: &'a Configuration,
        slack: &'a Slack,
        previous: &'a BendRates,
        obstacles: &'a [Obstacle],
    ) -> Situation<'a> {
        Situation {
            robot,
            at,
            lag: None,
            commanded: Some(motors),
            slack: Some(slack),
            previous,
            obstacles,
            safe_distance_m: 0.01,
            tip_offset_m: 0.0,
            acceleration_rad_s2: f64::INFINITY,
            period_s: PERIOD_S,
            moving_s: 3.0 * PERIOD_S,
            deceleration_rad_s2: DECELERATION_RAD_S2,
            comes_to_rest: false,
        }
    }

    fn without_play<'a>(situation: &Situation<'a>) -> Situation<'a> {
        Situation {
            slack: None,
            ..*situation
        }
    }

    /// Configuration of the cables after the motors moved.
    fn after(
        situation: &Situation<'_>,
        slack: &Slack,
        rates: &BendRates,
        path_s: f64,
    ) -> Configuration {
        let moved = Configuration::straight(rates.section_count()).advanced(rates, path_s);
        let strokes_m = situation.robot.cable_strokes(situation.at);
        let motors_m = situation.robot.cable_strokes(&moved);
        let next = slack.moved(situation.robot, &moved);
        let cables = strokes_m
            .iter()
            .zip(motors_m)
            .zip(next.slack_m())
            .zip(slack.slack_m());
        let mut cables_m = [0.0; CABLES_MAX];
        for (to_m, (((stroke_m, motor_m), next_m), slack_m)) in cables_m.iter_mut().zip(cables) {
            *to_m = stroke_m + motor_m + next_m - slack_m;
        }
        situation.robot.bend_from_cable_strokes(&cables_m)
    }

    /// Smallest margin of the clearances of the cables beyond the required clearance, at most `required_m`
    /// \[m\].
    fn margin_m(situation: &Situation<'_>, next: &Configuration, required_m: f64) -> f64 {
        let [standing, body] = [situation.at, next].map(|at| situation.robot.body(at));
        let mut least_m = f64::INFINITY;
        for obstacle in situation.obstacles {
            for j in 0..situation.robot.section_count() {
                let floor_m = standing.clearance_of(j, obstacle).min(required_m);
                least_m = least_m.min(body.clearance_of(j, obstacle) - floor_m);
            }
        }
        least_m
    }

    proptest! {
        /// Wherever robot, motors, cables and obstacle are: each section of the cables is as clear as it was, or as far away as it shall be, after the
        /// period, and at rest when no other command follows; a millimetre less on the way there. The motors keep the rule of robots without play.
        /// A stop after it takes no more than the tolerance of ramps, and only slows down.
        #[test]
        fn cables_with_play_keep_clear(
            at in prop::array::uniform6(-1.2..1.2_f64),
            taken in prop::array::uniform9(-0.5..0.5_f64),
            desired in prop::array::uniform6(-2.0..2.0_f64),
            share in prop::array::uniform3(-0.5..0.5_f64),
            along in 0.0..1.0_f64,
            section in 0..3_usize,
            beside_m in -0.01..0.04_f64,
        ) {
            let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
            let at = Configuration::from_slice(&at).unwrap();
            let aside_m = Vector3::from(share).normalize() * (0.035 + beside_m);
            let centre_m = robot.body_point(&at, section, along) + aside_m;
            let obstacle = Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap();
            let (slack, rest) = (slack(&taken), BendRates::zero(3));
            let sent = motors(&robot, &at, &slack);
            let obstacles = [obstacle];
            let begin = situation(&robot, &at, &sent, &slack, &rest, &obstacles);
            let desired = BendRates::from_slice(&desired).unwrap();
            let safe = safe_command(&begin, &desired);
            let rates = safe.rates;
            let end_s = 3.0 * PERIOD_S + 0.5 * fastest(&rates) / DECELERATION_RAD_S2;
            for (part, less_m) in (0..=40).map(|part| (f64::from(part) / 40.0, 1e-3)).chain([(1.0, 0.0), (PERIOD_S / end_s, 0.0)]) {
                let left_m = margin_m(&begin, &after(&begin, &slack, &rates, part * end_s), 0.01);
                prop_assert!(left_m >= -less_m - 1e-9, "{left_m} at {part}");
            }
            for (from, path_s) in [(&at, end_s), (&sent, end_s), (&at, PERIOD_S), (&sent, PERIOD_S)] {
                let begin = Situation { at: from, ..begin };
                let left_m = margin_m(&begin, &from.advanced(&rates, path_s), 0.01);
                prop_assert!(left_m >= -1e-9, "{left_m} without play");
            }
            prop_assert!(safe.clearance_hit || safe == safe_command(&without_play(&begin), &desired));

            let begun = sent;
            let then = after(&begin, &slack, &rates, PERIOD_S);
            let sent = sent.advanced(&rates, PERIOD_S);
            let slack = slack.moved(&robot, &Configuration::straight(3).advanced(&rates, PERIOD_S));
            let stops = situation(&robot, &then, &sent, &slack, &rates, &obstacles);
            let stops = Situation { comes_to_rest: true, ..stops };
            let ramp = ramp_to_zero(&rates, DECELERATION_RAD_S2, PERIOD_S);
            let slowed = safe_command(&stops, &ramp).rates;
            if [begin.at, &begun].iter().all(|at| robot.clearance_m(at, &obstacle) >= 0.01) {
                prop_assert_eq!(slowed, ramp);
            }
            let end_s = 3.0 * PERIOD_S + 0.5 * fastest(&slowed) / DECELERATION_RAD_S2;
            let left_m = margin_m(&stops, &after(&stops, &slack, &slowed, end_s), 0.01 - 1.001e-3);
            prop_assert!(left_m >= -1e-9, "{left_m} by the ramp");
        }
    }

    /// A mast next to section 1 is closer than section 2 can come; section 2 must keep its own clearance.
    #[test]
    fn each_section_keeps_its_own_clearance() {
        let robot = Robot::new(&RobotParameters::paper(2)).unwrap();
        let at = Configuration::straight(2);
        // Section 1 gives way at once, section 2 only when its play is over.
        let slack = slack(&[0.5, -0.5, -0.5, 0.0, 0.0, 0.0]);
        let (sent, rest) = (motors(&robot, &at, &slack), BendRates::zero(2));
        let mast = |x_m, to_m| {
            let shape = Shape::Capsule {
                start_m: Vector3::new(x_m, 0.0, 0.0),
                end_m: Vector3::new(x_m, 0.0, to_m),
            };
            Obstacle::new(shape, 0.005, Vector3::zeros()).unwrap()
        };
        let obstacles = [mast(0.031, 0.3)];
        let moved = situation(&robot, &at, &sent, &slack, &rest, &obstacles);
        let moved = Situation {
            safe_distance_m: 0.03,
            ..moved
        };
        let standing_m = robot.body(&at).clearance_of(1, &obstacles[0]);
        assert!((standing_m - 0.011).abs() < 1e-3);
        let mut was_hit = false;
        for angle in 0..64 {
            let (sin, cos) = (0.1 * f64::from(angle)).sin_cos();
            let desired = BendRates::from_slice(&[-cos, sin, cos, -sin]).unwrap();
            let safe = safe_command(&moved, &desired);
            was_hit |= safe.rates != safe_command(&without_play(&moved), &desired).rates;
            let end_s = 3.0 * PERIOD_S + 0.5 * fastest(&safe.rates) / DECELERATION_RAD_S2;
            let left_m = margin_m(&moved, &after(&moved, &slack, &safe.rates, end_s), 0.03);
            assert!(left_m >= -1e-9, "{angle}: {left_m}");
        }
        assert!(was_hit);
    }
}
