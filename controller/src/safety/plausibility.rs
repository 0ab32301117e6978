use nalgebra::Vector3;

use crate::estimator::Measurement;
use crate::robot::{BendRates, Configuration, Robot};

/// What a robot cannot do, so that its measurement must be wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlausibilityRules {
    /// A bend-vector component may differ from the measurement before by this much, beyond what the
    /// largest rate can do meanwhile \[rad\].
    pub jump_rad: f64,
    /// So many jumps in a row are a fault.
    pub jump_limit: u32,
    /// A measurement that stays the same in every bit while a component is commanded to move this far is
    /// frozen \[rad\].
    pub frozen_rad: f64,
}

/// The verdict on one measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plausibility {
    /// The robot can be there.
    Good,
    /// No robot moves that fast: leave it out.
    Jump,
    /// The last of a series of jumps: leave it out, and a fault.
    Lost,
    /// It should have changed, and has not: a fault.
    Frozen,
}

/// Compares each measurement with the one of its kind before.
///
/// A sensor that lost its count, a swapped cable or a driver that repeats old values with new stamps shows
/// here, and nowhere else: its numbers are finite, fresh and within the limits.
#[derive(Debug, Clone)]
pub struct MeasurementWatch {
    rules: PlausibilityRules,
    /// The last good one of the bends, and of the tip position.
    bends: Option<Seen<Configuration>>,
    tip: Option<Seen<Vector3<f64>>>,
    jumps: u32,
}

/// A measurement that was good.
#[derive(Debug, Clone, Copy)]
struct Seen<T> {
    value: T,
    measured_ns: u64,
    /// How far the farthest component was commanded to move since the value last changed \[rad\].
    commanded_rad: f64,
}

impl MeasurementWatch {
    /// Nothing was measured yet.
    pub fn new(rules: PlausibilityRules) -> Self {
        Self {
            rules,
            bends: None,
            tip: None,
            jumps: 0,
        }
    }

    /// What it judges by.
    pub fn rules(&self) -> &PlausibilityRules {
        &self.rules
    }

    /// The robot was commanded to move at `rates` for `elapsed_s`.
    pub fn commanded(&mut self, rates: &BendRates, elapsed_s: f64) {
        let fastest = rates
            .as_slice()
            .iter()
            .fold(0.0, |most, r| r.abs().max(most));
        let way_rad = fastest * elapsed_s;
        if let Some(seen) = &mut self.bends {
            seen.commanded_rad += way_rad;
        }
        if let Some(seen) = &mut self.tip {
            seen.commanded_rad += way_rad;
        }
    }

    /// Judges a measurement that is newer than every one before. The caller leaves out what jumps.
    ///
    /// A fault is said once. After a series of jumps nobody knows which side was right, so the next
    /// measurement is believed; the robot rests by then, and who resets it has looked.
    pub fn judge(
        &mut self,
        robot: &Robot,
        measurement: &Measurement,
        measured_ns: u64,
    ) -> Plausibility {
        let rules = self.rules;
        let verdict = match measurement {
            Measurement::Configuration(bends) => {
                let jumps = |before: &_, elapsed_s| jumps(robot, &rules, before, bends, elapsed_s);
                judge(&mut self.bends, bends, measured_ns, &rules, jumps)
            }
            Measurement::CableLengths(lengths) => {
                let bends = robot.bend_from_cable_lengths(lengths);
                let jumps = |before: &_, elapsed_s| jumps(robot, &rules, before, &bends, elapsed_s);
                judge(&mut self.bends, &bends, measured_ns, &rules, jumps)
            }
            Measurement::TipPosition(tip_m) => {
                let jumps = |before: &Vector3<f64>, elapsed_s| {
                    (tip_m - before).norm() > tip_way_m(robot, &rules, elapsed_s)
                };
                judge(&mut self.tip, tip_m, measured_ns, &rules, jumps)
            }
        };
        self.jumps = match verdict {
            Plausibility::Jump => self.jumps.saturating_add(1),
            _ => 0,
        };
        if self.jumps < rules.jump_limit {
            return verdict;
        }
        *self = Self::new(rules);
        Plausibility::Lost
    }
}

/// Judges `value` against the last good one, and keeps it if it is good.
fn judge<T: Copy + PartialEq>(
    last: &mut Option<Seen<T>>,
    value: &T,
    measured_ns: u64,
    rules: &PlausibilityRules,
    jumps: impl Fn(&T, f64) -> bool,
) -> Plausibility {
    let fresh = Seen {
        value: *value,
        measured_ns,
        commanded_rad: 0.0,
    };
    let Some(before) = last else {
        *last = Some(fresh);
        return Plausibility::Good;
    };
    let elapsed_s = measured_ns.saturating_sub(before.measured_ns) as f64 * 1e-9;
    if jumps(&before.value, elapsed_s) {
        return Plausibility::Jump;
    }
    if before.value != *value {
        *before = fresh;
        return Plausibility::Good;
    }
    before.measured_ns = measured_ns;
    if before.commanded_rad <= rules.frozen_rad {
        return Plausibility::Good;
    }
    // Said once: a robot at rest does not change, and could never prove that it is measured again.
    before.commanded_rad = 0.0;
    Plausibility::Frozen
}

/// Whether a component moved farther than its section can. Not a number jumps, too.
fn jumps(
    robot: &Robot,
    rules: &PlausibilityRules,
    before: &Configuration,
    now: &Configuration,
    elapsed_s: f64,
) -> bool {
    robot.sections().iter().enumerate().any(|(j, section)| {
        let way_rad = rules.jump_rad + section.rate_max_rad_s * elapsed_s;
        let (before, now) = (before.section(j), now.section(j));
        let stays = |k: usize| (now[k] - before[k]).abs() <= way_rad;
        !(stays(0) && stays(1))
    })
}

/// How far the tip can move while every component moves as far as is allowed \[m\]. A section that bends by
/// δ turns all that follows it by δ at most, so the tip moves by no more than δ times what hangs on its
/// base; the two components of a section make √2.
fn tip_way_m(robot: &Robot, rules: &PlausibilityRules, elapsed_s: f64) -> f64 {
    let sections = robot.sections();
    let ways = sections.iter().enumerate().map(|(j, section)| {
        let hanging_m: f64 = sections[j..].iter().map(|s| s.length_m).sum();
        let way_rad = rules.jump_rad + section.rate_max_rad_s * elapsed_s;
        core::f64::consts::SQRT_2 * way_rad * hanging_m
    });
    ways.sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{CABLES_MAX, RobotParameters};

    const MS: u64 = 1_000_000;
    const RULES: PlausibilityRules = PlausibilityRules {
        jump_rad: 0.1,
        jump_limit: 3,
        frozen_rad: 0.05,
    };

    fn robot() -> Robot {
        Robot::new(&RobotParameters::paper(2)).unwrap()
    }

    fn bends(u: f64) -> Configuration {
        Configuration::from_slice(&[0.3, 0.0, u, -0.2]).unwrap()
    }

    fn measured(u: f64) -> Measurement {
        Measurement::Configuration(bends(u))
    }

    #[test]
    fn what_the_rates_can_do_is_no_jump_and_more_is() {
        let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
        // 2 rad/s for 10 ms and the tolerance of 0.1 rad.
        assert_eq!(watch.judge(&robot, &measured(0.0), 0), Plausibility::Good);
        assert_eq!(
            watch.judge(&robot, &measured(0.119), 10 * MS),
            Plausibility::Good
        );
        assert_eq!(
            watch.judge(&robot, &measured(0.24), 20 * MS),
            Plausibility::Jump
        );
        // Left out: the next one is compared with the last good one.
        assert_eq!(
            watch.judge(&robot, &measured(0.12), 30 * MS),
            Plausibility::Good
        );
        assert_eq!(
            watch.judge(&robot, &measured(f64::NAN), 40 * MS),
            Plausibility::Jump
        );
    }

    #[test]
    fn a_series_of_jumps_is_a_fault_and_then_the_next_measurement_is_believed() {
        let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
        watch.judge(&robot, &measured(0.0), 0);
        let verdicts = [1, 2, 3, 4, 5].map(|ms| watch.judge(&robot, &measured(1.0), ms * MS));
        let expected = [
            Plausibility::Jump,
            Plausibility::Jump,
            Plausibility::Lost,
            Plausibility::Good,
            Plausibility::Good,
        ];
        assert_eq!(verdicts, expected);
        // Back again is a jump like any other.
        assert_eq!(
            watch.judge(&robot, &measured(0.0), 6 * MS),
            Plausibility::Jump
        );
    }

    #[test]
    fn an_odd_one_now_and_then_is_no_series() {
        let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
        for ms in 0..100 {
            let odd = ms % 3 > 0;
            let verdict = watch.judge(&robot, &measured(f64::from(u8::from(odd))), ms * MS);
            let expected = if odd {
                Plausibility::Jump
            } else {
                Plausibility::Good
            };
            assert_eq!(verdict, expected, "{ms}");
        }
    }

    #[test]
    fn cables_are_compared_with_bends_and_the_tip_with_itself() {
        let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
        watch.judge(&robot, &measured(0.0), 0);
        let cables = |u| -> Measurement {
            let mut lengths = [0.0; CABLES_MAX];
            lengths.copy_from_slice(&robot.cable_lengths(bends(u).as_slice()));
            Measurement::CableLengths(lengths)
        };
        assert_eq!(watch.judge(&robot, &cables(0.05), MS), Plausibility::Good);
        assert_eq!(
            watch.judge(&robot, &cables(0.5), 2 * MS),
            Plausibility::Jump
        );
        let tip = |u| Measurement::TipPosition(robot.tip_position(bends(u).as_slice()));
        assert_eq!(watch.judge(&robot, &tip(0.05), 3 * MS), Plausibility::Good);
        assert_eq!(watch.judge(&robot, &tip(0.06), 4 * MS), Plausibility::Good);
        let far = Measurement::TipPosition(Vector3::new(0.5, 0.0, 0.0));
        assert_eq!(watch.judge(&robot, &far, 5 * MS), Plausibility::Jump);
    }

    #[test]
    fn a_value_that_stands_still_is_frozen_only_while_the_robot_should_move() {
        let (robot, mut watch) = (robot(), MeasurementWatch::new(RULES));
        let still = BendRates::zero(2);
        let moving = BendRates::from_slice(&[0.0, -1.0, 0.2, 0.0]).unwrap();
        for ms in 0..1000 {
            watch.commanded(&still, 1e-3);
            assert_eq!(
                watch.judge(&robot, &measured(0.2), ms * MS),
                Plausibility::Good
            );
        }
        for ms in 1000..1049 {
            watch.commanded(&moving, 1e-3);
            assert_eq!(
                watch.judge(&robot, &measured(0.2), ms * MS),
                Plausibility::Good
            );
        }
        watch.commanded(&moving, 2e-3);
        assert_eq!(
            watch.judge(&robot, &measured(0.2), 1050 * MS),
            Plausibility::Frozen
        );
        // Said once, and again when it should have moved as far again.
        assert_eq!(
            watch.judge(&robot, &measured(0.2), 1051 * MS),
            Plausibility::Good
        );
        watch.commanded(&moving, 0.051);
        assert_eq!(
            watch.judge(&robot, &measured(0.2), 1052 * MS),
            Plausibility::Frozen
        );
        // The smallest change shows that the sensor lives.
        watch.commanded(&moving, 0.049);
        assert_eq!(
            watch.judge(&robot, &measured(0.2 + 1e-15), 1053 * MS),
            Plausibility::Good
        );
        watch.commanded(&moving, 0.049);
        assert_eq!(
            watch.judge(&robot, &measured(0.2 + 1e-15), 1054 * MS),
            Plausibility::Good
        );
    }
}
