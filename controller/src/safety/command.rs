//! The command that satisfies all limits and the clearance rule.

use crate::robot::BendRates;

use super::lag::LagLines;
use super::play;
use super::self_contact;
use super::situation::{SafeCommand, Situation};
use super::stopping::fastest;

/// Makes the rates desired by a mode safe: the nearest rates inside all limits, then rates close to those
/// that satisfy the clearance rule (docs/model.md §7 and §8). Both hold at the end of the period and, when no
/// other command follows, until the robot is at rest.
///
/// While the motors of a section move through the play of its cables, the section stands still. Another
/// section must not come closer to an obstacle because the first one does not compensate. So the rule of the
/// guard also holds for the cables while they move through their play: section by section, exact at the ends
/// of the period and of the stopping path, 1 mm less between. If a command violates that, the sections that
/// satisfy it alone continue and the others stand still. All sections stand still if that violates the rule,
/// too, or if the work budget of the command is spent.
///
/// Motors that lag average the commanded path, and so lead the body past its corners. Of first order, they lead
/// it between the commanded path and the straight lines in the bends, from its configuration at the end of the delay to the ends
/// of the period and of the stopping path, seen from an obstacle that moves at its velocity. At seven points of these
/// lines, each at its time, a section keeps 0.75 mm less than D, or than its clearance where the commands so far lead, or
/// what it keeps on the line to rest; otherwise the command is corrected, or else scaled down.
///
/// Last, the rates are scaled down, or are rest, where two parts of the body would overlap by more than
/// [`Robot::self_overlap_max_m`](crate::robot::Robot::self_overlap_max_m) and more than now, as seen from
/// the measured or the commanded configuration: at the ends of the period and of the stopping path, and at up to four points on the
/// way there. It is the body of the model, without the uncertainty of the tip.
///
/// A robot that comes to rest continues along the stopping path of the previous command, through its play,
/// too: its ramp is only scaled down. Allocates nothing.
pub fn safe_command(situation: &Situation<'_>, desired: &BendRates) -> SafeCommand {
    let Situation {
        robot,
        at,
        tip_offset_m,
        ..
    } = *situation;
    let model = situation;
    let situation = &Situation {
        robot: &robot.enlarged(at, tip_offset_m),
        ..*situation
    };
    if situation.comes_to_rest {
        return situation.shortened(desired);
    }
    let limited = situation.limited(desired);
    // The guard returns no faster rates.
    let limits = situation.limits_moving(fastest(&limited.rates));
    let safe = SafeCommand::new(limited, situation.guard().apply(&limits, &limited.rates));
    let lag = LagLines::new(situation, &limited.rates);
    let fastest_rad_s = fastest(&limited.rates);
    let safe = lag
        .as_ref()
        .map_or(safe, |lag| lag.kept(safe, fastest_rad_s));
    let lags_well = |rates: &BendRates| lag.as_ref().is_none_or(|lag| lag.holds(rates));
    let slack = situation.play();
    let kept = slack.map_or(safe, |slack| play::kept(situation, slack, safe));
    let safe = if kept.rates != safe.rates && !lags_well(&kept.rates) {
        SafeCommand {
            rates: BendRates::zero(situation.robot.section_count()),
            ..kept
        }
    } else {
        kept
    };
    self_contact::kept(model, safe, |rates| {
        let limited = situation.limits(fastest(rates)).shorten(rates);
        let guarded = situation.guard().shorten(&limited.rates).rates;
        let holds = lags_well(&guarded)
            && slack.is_none_or(|slack| play::holds(situation, slack, &guarded));
        holds.then_some(guarded)
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::estimator::Slack;
    use crate::robot::{CABLES_MAX, Configuration, Obstacle, Robot, RobotParameters, Shape};
    use crate::safety::{Lag, ramp_to_zero};
    use nalgebra::Vector3;

    const PERIOD_S: f64 = 0.005;

    fn configuration(bends: [f64; 4]) -> Configuration {
        Configuration::from_slice(&bends).unwrap()
    }

    fn rates(values: [f64; 4]) -> BendRates {
        BendRates::from_slice(&values).unwrap()
    }

    /// Any finite rate, half of them in the range of a robot.
    fn any_rate() -> impl Strategy<Value = f64> {
        use prop::num::f64::{NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO};
        prop_oneof![
            -3.0..3.0_f64,
            POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO
        ]
    }

    proptest! {
        /// Wherever robot, commanded position and obstacle are, whatever play the cables have and however far the tip is beside: in rest
        /// no component is larger than the ramp's, and zero stays zero; in motion the acceleration holds; the commanded position
        /// never goes farther out; no section end is too fast; the body overlaps itself no more than allowed or before. In every mode zero is zero.
        #[test]
        fn every_rule_holds_after_all_of_them(
            at in prop::array::uniform4(-2.5..2.5_f64),
            off in prop::array::uniform4(-0.6..0.6_f64),
            previous in prop::array::uniform4(-2.0..2.0_f64),
            desired in prop::array::uniform4(any_rate()),
            centre in prop::array::uniform3(-0.5..0.5_f64),
            taken in prop::array::uniform6(-0.5..0.5_f64),
            play_m in prop_oneof![Just(0.0), 0.0..2e-3_f64],
            tip_offset_m in prop_oneof![Just(0.0), 0.0..0.1_f64],
            comes_to_rest: bool,
            is_ramp: bool,
            tip_speed_max_m_s in prop_oneof![Just(0.0), 0.01..0.5_f64],
        ) {
            let robot = Robot::new(&RobotParameters { tip_speed_max_m_s, ..RobotParameters::paper(2) }).unwrap();
            let centre_m = Vector3::from(centre);
            let obstacle = Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap();
            let commanded = configuration(core::array::from_fn(|i| at[i] + off[i]));
            let delayed = configuration(core::array::from_fn(|i| at[i] - 0.3 * off[i]));
            let (at, previous) = (configuration(at), rates(previous));
            let mut slack_m = [0.0; CABLES_MAX];
            slack_m.iter_mut().zip(taken).for_each(|(slack_m, part)| *slack_m = play_m * part);
            let slack = Slack::new(play_m, slack_m);
            let situation = Situation {
                robot: &robot,
                at: &at,
                lag: Some(Lag { delayed: &delayed, time_constant_s: 0.1 }),
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
            let end_m_s = robot.fastest_section_end_m_s(&at, &safe.rates);
            prop_assert!(tip_speed_max_m_s == 0.0 || end_m_s <= tip_speed_max_m_s * (1.0 + 1e-12));
            let next = commanded.advanced(&safe.rates, PERIOD_S);
            for section in 0..2 {
                let most = robot.sections()[section].bend_max_rad.max(commanded.bend_rad(section));
                prop_assert!(next.bend_rad(section) <= most + 1e-12);
            }
            // The rule of the guard, as its own documentation has it.
            let enlarged = robot.enlarged(&at, tip_offset_m);
            let after = |rates: &BendRates| enlarged.body(&at.advanced(rates, PERIOD_S));
            let most_m = if comes_to_rest { 0.01 - 1.001e-3 } else { 0.01 };
            let floor_m = after(&BendRates::zero(2)).clearance_m(&obstacle).min(most_m);
            // Ramps with play are tested in `play`.
            let is_checked = !comes_to_rest || play_m == 0.0;
            prop_assert!(!is_checked || after(&safe.rates).clearance_m(&obstacle) >= floor_m);
            if !comes_to_rest {
                let stopped_s = situation.stopping().path(fastest(&safe.rates)).path_s;
                for from in [&at, &commanded] {
                    let most_m = robot.self_contact(from, robot.self_overlap_max_m());
                    let most_m = most_m.map_or(robot.self_overlap_max_m(), |it| it.overlap_m);
                    for path_s in [PERIOD_S, stopped_s] {
                        let there = from.advanced(&safe.rates, path_s);
                        prop_assert_eq!(robot.self_contact(&there, most_m), None);
                    }
                }
            }
            // Zero rates stay zero in every mode, in motion and at rest.
            for previous in [&previous, &BendRates::zero(2)] {
                for comes_to_rest in [false, true] {
                    let standing = Situation { previous, comes_to_rest, ..situation };
                    prop_assert_eq!(safe_command(&standing, &BendRates::zero(2)).rates, BendRates::zero(2));
                }
            }
        }
    }
}
