use super::clearance::fastest;
use super::{SafeCommand, Situation, safe_command};
use crate::estimator::Slack;
use crate::robot::{BendRates, Configuration, Obstacle};

/// Between the end of the period and that of the stopping way this much may lack of the clearance, as for the guard \[m\].
const BETWEEN_M: f64 = 1e-3;
/// Clearances that differ by less are the same but for rounding \[m\].
const ROUNDING_M: f64 = 1e-12;

/// [`safe_command`] of a robot whose cables have play, of which `slack` is taken now; `None`: without play.
///
/// A section whose motors turn round stands until their play is over, so another one must not come nearer to an obstacle because the first
/// one gives way. Let c(s) be the clearance of the body of the cables to an obstacle, as in the rule of the guard. Here, too, c(s) ≥ min(D, c⁰(s))
/// at the ends of the period and of the stopping way, and 1 mm less half-way between. Where the command does not hold that, the sections that hold
/// it alone go on, the others stand until they may; and all of them stand where that does not hold either. Allocates nothing.
pub fn safe_command_with_play(
    situation: &Situation<'_>,
    slack: Option<&Slack>,
    desired: &BendRates,
) -> SafeCommand {
    let safe = safe_command(situation, desired);
    let Some(slack) = slack else {
        return safe;
    };
    let cables = Cables { situation, slack };
    if situation.obstacles.is_empty() || cables.keep_clear(&safe.rates, &[0.0, 0.5, 1.0]) {
        return safe;
    }
    let rest = BendRates::zero(situation.robot.section_count());
    let mut kept = rest;
    for section in 0..situation.robot.section_count() {
        let mut alone = rest;
        let own = 2 * section..2 * section + 2;
        alone.as_mut_slice()[own.clone()].copy_from_slice(&safe.rates.as_slice()[own.clone()]);
        if cables.keep_clear(&alone, &[1.0]) {
            kept.as_mut_slice()[own.clone()].copy_from_slice(&alone.as_slice()[own]);
        }
    }
    // They are only shortened: what is left of them is inside every limit that they are inside.
    let shortened = Situation {
        comes_to_rest: true,
        ..*situation
    };
    let kept = safe_command(&shortened, &kept).rates;
    let holds = cables.keep_clear(&kept, &[0.0, 0.5, 1.0]);
    SafeCommand {
        rates: if holds { kept } else { rest },
        clearance_hit: true,
        ..safe
    }
}

/// The cables of a robot, and what is around it.
struct Cables<'a> {
    situation: &'a Situation<'a>,
    slack: &'a Slack,
}

impl Cables<'_> {
    /// Whether the rule holds at these parts of the way from the end of the period, 0, to that of the stopping way, 1.
    fn keep_clear(&self, rates: &BendRates, parts: &[f64]) -> bool {
        let Situation {
            robot,
            at,
            period_s,
            safe_distance_m,
            ..
        } = *self.situation;
        let way = self.situation.stopping().way(fastest(rates));
        let standing = robot.body(at);
        let reach_m = self.reach_m(rates) * way.way_s;
        let last_s = way.time_s(way.way_s);
        let is_near = |obstacle: &&Obstacle| {
            let comes_m = reach_m + obstacle.velocity_m_s().norm() * last_s;
            standing.clearance_m(obstacle) < safe_distance_m + comes_m
        };
        parts.iter().all(|part| {
            let way_s = period_s + part * (way.way_s - period_s);
            let body = robot.body(&self.after(rates, way_s));
            let time_s = way.time_s(way_s);
            let lacks_m = if *part > 0.0 && *part < 1.0 {
                BETWEEN_M
            } else {
                ROUNDING_M
            };
            let mut near = self.situation.obstacles.iter().filter(is_near);
            near.all(|obstacle| {
                let then = obstacle.moved(time_s);
                let floor_m = standing.clearance_m(&then).min(safe_distance_m);
                body.clearance_m(&then) >= floor_m - lacks_m
            })
        })
    }

    /// Where the cables are after a way of the motors that took `way_s` at `rates`.
    fn after(&self, rates: &BendRates, way_s: f64) -> Configuration {
        let robot = self.situation.robot;
        let moved = Configuration::straight(robot.section_count()).advanced(rates, way_s);
        let before = self.slack.bends(robot);
        let after = self.slack.moved(robot, &moved).bends(robot);
        let mut cables = *self.situation.at;
        let changes = moved.as_slice().iter().zip(after.as_slice());
        let changes = changes.zip(before.as_slice());
        for (cable, ((moved, after), before)) in cables.as_mut_slice().iter_mut().zip(changes) {
            *cable += moved + (after - before);
        }
        cables
    }

    /// No point of the body moves faster \[m/s\].
    fn reach_m(&self, rates: &BendRates) -> f64 {
        let robot = self.situation.robot;
        let mut beyond_m = robot.reach_m();
        let sections = robot.sections().iter().enumerate();
        let speeds_m_s = sections.map(|(j, section)| {
            let [u, v] = rates.section(j);
            let speed_m_s = beyond_m * u.hypot(v);
            beyond_m -= section.length_m;
            speed_m_s
        });
        // Of cables that run through their play two components may be left of one.
        2.0 * speeds_m_s.sum::<f64>()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{CABLES_MAX, Robot, RobotParameters, Shape};

    proptest! {
        /// Wherever robot, cables and obstacle are: after the period, and at rest when no other command follows, the body of the cables is
        /// as clear as it was, or as far away as it shall be.
        #[test]
        fn cables_with_play_keep_clear(
            at in prop::array::uniform4(-1.5..1.5_f64),
            taken in prop::array::uniform6(-0.5..0.5_f64),
            desired in prop::array::uniform4(-2.0..2.0_f64),
            share in prop::array::uniform3(-0.5..0.5_f64),
            beside_m in -0.01..0.04_f64,
        ) {
            const PLAY_M: f64 = 1e-3;
            let robot = Robot::new(&RobotParameters::paper(2)).unwrap();
            let at = Configuration::from_slice(&at).unwrap();
            // Near the tip, wherever that is.
            let aside_m = Vector3::from(share).normalize() * (0.035 + beside_m);
            let centre_m = robot.tip_position(&at) + aside_m;
            let obstacle = Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap();
            let mut slack_m = [0.0; CABLES_MAX];
            slack_m[..6].copy_from_slice(&taken.map(|part| PLAY_M * part));
            let slack = Slack::new(PLAY_M, slack_m);
            let rest = BendRates::zero(2);
            let situation = Situation {
                robot: &robot,
                at: &at,
                commanded: None,
                previous: &rest,
                obstacles: &[obstacle],
                safe_distance_m: 0.01,
                acceleration_rad_s2: f64::INFINITY,
                period_s: 0.005,
                moving_s: 0.015,
                deceleration_rad_s2: 40.0,
                comes_to_rest: false,
            };
            let desired = BendRates::from_slice(&desired).unwrap();
            let rates = safe_command_with_play(&situation, Some(&slack), &desired).rates;
            let cables = Cables { situation: &situation, slack: &slack };
            let clearance_m = |at: &Configuration| robot.clearance_m(at, &obstacle);
            let floor_m = clearance_m(&at).min(0.01);
            for way_s in [0.005, 0.015 + 0.5 * fastest(&rates) / 40.0] {
                let after_m = clearance_m(&cables.after(&rates, way_s));
                prop_assert!(after_m >= floor_m - 1e-9, "{} of {}", after_m, floor_m);
            }
            // Half-way, where a section may turn round.
            let between_m = clearance_m(&cables.after(&rates, 0.01));
            prop_assert!(between_m >= floor_m - 2e-3, "{} of {}", between_m, floor_m);
        }
    }
}
