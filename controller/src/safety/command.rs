use crate::estimator::Slack;
use crate::robot::{BendRates, Configuration, Obstacle, Robot};

use super::clearance::{ClearanceGuard, Guarded, Stopping, fastest, shortened_to};
use super::{Limited, Limits, LimitsHit, play};

/// What a command is checked against.
#[derive(Debug, Clone, Copy)]
pub struct Situation<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// Where it is.
    pub at: &'a Configuration,
    /// Where its motors are led, when that is elsewhere: commanded positions, or motors beside cables that have play. Limits and clearance
    /// hold there, too.
    pub commanded: Option<&'a Configuration>,
    /// What is taken of the play between the robot's motors and its cables; `None`, or a play of 0: they have none.
    pub slack: Option<&'a Slack>,
    /// The command before.
    pub previous: &'a BendRates,
    /// Obstacles, where they are now.
    pub obstacles: &'a [Obstacle],
    /// Distance D that the body keeps \[m\].
    pub safe_distance_m: f64,
    /// How far the tip may be beside where the bends place it \[m\], 0 or more: so much more the body keeps, each section its part
    /// ([`Robot::thicker`], [`Estimator::tip_margin_m`](crate::estimator::Estimator::tip_margin_m)).
    pub tip_offset_m: f64,
    /// How fast the rate of a component may grow \[rad/s²\]; infinite: as it likes.
    pub acceleration_rad_s2: f64,
    /// Period \[s\].
    pub period_s: f64,
    /// How long the robot moves by a command when no other follows \[s\], at least a period.
    pub moving_s: f64,
    /// How fast the fastest component shrinks after that \[rad/s²\]; infinite: it stops at once.
    pub deceleration_rad_s2: f64,
    /// Whether the robot comes to rest: then rates are only shortened.
    pub comes_to_rest: bool,
}

impl<'a> Situation<'a> {
    pub(super) fn stopping(&self) -> Stopping {
        Stopping {
            moving_s: self.moving_s.max(self.period_s),
            deceleration_rad_s2: self.deceleration_rad_s2,
        }
    }

    /// The limits of rates of which no component is faster than this, or than any may be.
    pub(super) fn limits(&self, fastest_rad_s: f64) -> Limits<'a> {
        let sections = self.robot.sections().iter();
        let limit_rad_s = sections.fold(0.0_f64, |most, section| most.max(section.rate_max_rad_s));
        let way_s = self.stopping().way(fastest_rad_s.min(limit_rad_s)).way_s;
        Limits::new(self.robot, self.at, way_s)
            .with_commanded(self.commanded)
            .with_stopping(self.stopping())
    }

    /// The same of a robot that moves.
    fn limits_moving(&self, fastest_rad_s: f64) -> Limits<'a> {
        let change_rad_s = self.acceleration_rad_s2 * self.period_s;
        self.limits(fastest_rad_s)
            .with_acceleration(self.previous, change_rad_s)
    }

    /// The nearest rates inside the limits.
    fn limited(&self, desired: &BendRates) -> Limited {
        let limited = self.limits_moving(fastest(desired)).nearest(desired);
        Limited {
            // The projection keeps that but for rounding.
            rates: shortened_to(limited.rates, fastest(desired)),
            ..limited
        }
    }

    /// The play of cables that have some.
    fn play(&self) -> Option<&'a Slack> {
        self.slack.filter(|slack| slack.play_m() > 0.0)
    }

    /// A robot that comes to rest: `ramp` is only shortened.
    fn shortened(&self, ramp: &BendRates) -> SafeCommand {
        let limited = self.limits(fastest(ramp)).shorten(ramp);
        let guard = ClearanceGuard {
            slack: self.play(),
            ..self.guard()
        };
        SafeCommand::new(limited, guard.scale_down(&limited.rates))
    }

    /// The guard of a robot without play.
    pub(super) fn guard(&self) -> ClearanceGuard<'a> {
        ClearanceGuard {
            robot: self.robot,
            at: self.at,
            commanded: self.commanded,
            slack: None,
            obstacles: self.obstacles,
            safe_distance_m: self.safe_distance_m,
            period_s: self.period_s,
            stopping: self.stopping(),
        }
    }
}

/// A command inside every limit that keeps clear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SafeCommand {
    /// The rates \[rad/s\].
    pub rates: BendRates,
    /// Which limits changed them.
    pub limits_hit: LimitsHit,
    /// Whether the clearance guard changed them.
    pub clearance_hit: bool,
    /// Smallest clearance of the body, thicker where the tip is beside its bends, to any obstacle now \[m\]: negative inside an obstacle, infinite without obstacles, NaN
    /// when the state is not finite.
    pub clearance_m: f64,
}

/// What a mode desires, made safe: the nearest command inside every limit, and of those near to it one that keeps clear (docs/model.md §7 and §8). Both hold at the end of the period and, when no other command follows, until the robot rests.
///
/// A section whose cables have play stands while its motors turn round, so another one must not come nearer to an obstacle because the first
/// one gives way. The rule of the guard holds for the cables on their way through the play, too: section by section, exactly at the ends of the period and
/// of the stopping way, 1 mm less between. Where the command does not hold that, the sections that hold
/// it alone go on, the others stand until they may; and all of them stand where that does not hold either, or where the work for one command is used up.
///
/// A robot that comes to rest goes on along the stopping way of the command before, through its play, too: its ramp is only scaled down.
/// Allocates nothing.
pub fn safe_command(situation: &Situation<'_>, desired: &BendRates) -> SafeCommand {
    let Situation {
        robot,
        at,
        tip_offset_m,
        ..
    } = *situation;
    let situation = &Situation {
        robot: &robot.thicker(at, tip_offset_m),
        ..*situation
    };
    if situation.comes_to_rest {
        return situation.shortened(desired);
    }
    let limited = situation.limited(desired);
    // What the guard makes of them is not faster.
    let limits = situation.limits_moving(fastest(&limited.rates));
    let safe = SafeCommand::new(limited, situation.guard().apply(&limits, &limited.rates));
    match situation.play() {
        None => safe,
        Some(slack) => play::held(situation, slack, safe),
    }
}

impl SafeCommand {
    fn new(limited: Limited, guarded: Guarded) -> Self {
        Self {
            rates: guarded.rates,
            limits_hit: limited.hit,
            clearance_hit: guarded.hit,
            clearance_m: guarded.clearance_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{CABLES_MAX, RobotParameters, Shape};
    use crate::safety::ramp_to_zero;
    use nalgebra::Vector3;

    const PERIOD_S: f64 = 0.005;

    fn configuration(bends: [f64; 4]) -> Configuration {
        Configuration::from_slice(&bends).unwrap()
    }

    fn rates(values: [f64; 4]) -> BendRates {
        BendRates::from_slice(&values).unwrap()
    }

    /// Any finite rate, as often as one that a robot can have.
    fn wish() -> impl Strategy<Value = f64> {
        use prop::num::f64::{NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO};
        prop_oneof![
            -3.0..3.0_f64,
            POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO
        ]
    }

    proptest! {
        /// Wherever robot, commanded position and obstacle are, whatever play the cables have and however far the tip is beside: in rest
        /// no component is larger than the ramp's, and zero stays zero; in motion the acceleration holds; the commanded position
        /// never goes farther out. In every mode zero is zero.
        #[test]
        fn every_rule_holds_after_all_of_them(
            at in prop::array::uniform4(-2.5..2.5_f64),
            off in prop::array::uniform4(-0.6..0.6_f64),
            previous in prop::array::uniform4(-2.0..2.0_f64),
            desired in prop::array::uniform4(wish()),
            centre in prop::array::uniform3(-0.5..0.5_f64),
            taken in prop::array::uniform6(-0.5..0.5_f64),
            play_m in prop_oneof![Just(0.0), 0.0..2e-3_f64],
            tip_offset_m in prop_oneof![Just(0.0), 0.0..0.1_f64],
            comes_to_rest: bool,
            is_ramp: bool,
        ) {
            let robot = Robot::new(&RobotParameters::paper(2)).unwrap();
            let centre_m = Vector3::from(centre);
            let obstacle = Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap();
            let commanded = configuration(core::array::from_fn(|i| at[i] + off[i]));
            let (at, previous) = (configuration(at), rates(previous));
            let mut slack_m = [0.0; CABLES_MAX];
            slack_m.iter_mut().zip(taken).for_each(|(slack_m, part)| *slack_m = play_m * part);
            let slack = Slack::new(play_m, slack_m);
            let situation = Situation {
                robot: &robot,
                at: &at,
                commanded: Some(&commanded),
                slack: Some(&slack),
                previous: &previous,
                obstacles: &[obstacle],
                safe_distance_m: 0.01,
                tip_offset_m,
                acceleration_rad_s2: 40.0,
                period_s: PERIOD_S,
                moving_s: 3.0 * PERIOD_S,
                deceleration_rad_s2: 40.0,
                comes_to_rest,
            };
            let desired = if comes_to_rest && is_ramp {
                ramp_to_zero(&previous, 40.0, PERIOD_S)
            } else {
                rates(desired)
            };
            let safe = safe_command(&situation, &desired);
            for ((rate, desired), previous) in
                safe.rates.as_slice().iter().zip(desired.as_slice()).zip(previous.as_slice())
            {
                if comes_to_rest {
                    prop_assert!(rate.abs() <= desired.abs() && rate * desired >= 0.0);
                } else {
                    let shrinks = rate * previous >= 0.0 && rate.abs() <= previous.abs();
                    prop_assert!(shrinks || rate.abs() <= previous.abs() + 40.0 * PERIOD_S + 1e-12);
                }
            }
            let next = commanded.advanced(&safe.rates, PERIOD_S);
            for section in 0..2 {
                let most = robot.sections()[section].bend_max_rad.max(commanded.bend_rad(section));
                prop_assert!(next.bend_rad(section) <= most + 1e-12);
            }
            // The rule of the guard, as its own documentation has it.
            let thicker = robot.thicker(&at, tip_offset_m);
            let after = |rates: &BendRates| thicker.body(&at.advanced(rates, PERIOD_S));
            let most_m = if comes_to_rest { 0.01 - 1.001e-3 } else { 0.01 };
            let floor_m = after(&BendRates::zero(2)).clearance_m(&obstacle).min(most_m);
            // A ramp is judged where cables with play are on their way (`play`).
            let is_judged = !comes_to_rest || play_m == 0.0;
            prop_assert!(!is_judged || after(&safe.rates).clearance_m(&obstacle) >= floor_m);
            // Nobody who wishes to stand is moved: neither on the way nor at rest, in no mode.
            for previous in [&previous, &BendRates::zero(2)] {
                for comes_to_rest in [false, true] {
                    let still = Situation { previous, comes_to_rest, ..situation };
                    prop_assert_eq!(safe_command(&still, &BendRates::zero(2)).rates, BendRates::zero(2));
                }
            }
        }
    }
}
