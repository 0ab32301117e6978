//! No command leads two parts of the body into each other.

use super::situation::{SafeCommand, Situation};
use super::stopping::{fastest, scaled_by, shortened_to};
use crate::robot::{BendRates, Configuration, Pairs, SECTIONS_MAX, norm};

/// Most points of the way between the ends of the period and of the stopping path.
const POINTS: u32 = 4;
/// Scales that are tried before a ramp and rest.
const SCALES: u32 = 4;
/// Deeper by less is not deeper \[m\]: the same overlap of parts that no rate moves is rounded otherwise in another pose.
const EQUAL_M: f64 = 1e-9;

/// The first place of the stopping path at which the body overlaps more than it may.
struct Violation<'a> {
    from: &'a Configuration,
    /// Bends after s q̇ \[s\].
    path_s: f64,
    /// Sections that may touch on the way.
    pairs: Pairs,
    overlap_m: f64,
    /// Largest permitted overlap \[m\].
    most_m: f64,
}

/// `safe` if no two parts of the body overlap by more than they may; else its rates scaled down, as far as `permitted` makes them
/// satisfy all other rules; else a ramp of the command before; else rest.
///
/// The overlap that is permitted is the robot's, or that of the body where it is, so that it may move out of a contact. Next scale: where
/// the overlap would be the permitted one if it were linear along the path. A path of slower rates is shorter, so that is
/// on the safe side of the scale. A body that overlaps more only moves out: no scale of what leads deeper is tried.
pub(super) fn kept(
    situation: &Situation<'_>,
    safe: SafeCommand,
    permitted: impl Fn(&BendRates) -> Option<BendRates>,
) -> SafeCommand {
    let Some(mut violation) = violation(situation, &safe.rates) else {
        return safe;
    };
    let mut limits_hit = safe.limits_hit;
    limits_hit.self_contact = true;
    let stopped = SafeCommand {
        rates: BendRates::zero(situation.robot.section_count()),
        limits_hit,
        ..safe
    };
    let mut rates = safe.rates;
    for _ in 0..SCALES {
        let share = violation.share(situation, &rates);
        if share <= 0.0 {
            break;
        }
        let Some(slower) = permitted(&scaled_by(&rates, share)) else {
            break;
        };
        rates = slower;
        match self::violation(situation, &rates) {
            None => return SafeCommand { rates, ..stopped },
            Some(still) => violation = still,
        }
    }
    let ramp = ramp(situation, fastest(&safe.rates)).and_then(|rates| permitted(&rates));
    match ramp.filter(|rates| self::violation(situation, rates).is_none()) {
        Some(rates) => SafeCommand { rates, ..stopped },
        None => stopped,
    }
}

/// The command before, slowed down by the deceleration and not faster than `most_rad_s`; `None`: that is rest.
fn ramp(situation: &Situation<'_>, most_rad_s: f64) -> Option<BendRates> {
    let change_rad_s = situation.deceleration_rad_s2 * situation.period_s;
    let slower_rad_s = (fastest(situation.previous) - change_rad_s).min(most_rad_s);
    (slower_rad_s > 0.0).then(|| shortened_to(*situation.previous, slower_rad_s))
}

impl Violation<'_> {
    /// Share of the rates with which the stopping path ends where the overlap is the permitted one, if it is linear; 0 where the body overlaps
    /// more than the robot may.
    fn share(&self, situation: &Situation<'_>, rates: &BendRates) -> f64 {
        if self.most_m > situation.robot.self_overlap_max_m() {
            return 0.0;
        }
        let end_s = situation.stopping().path(fastest(rates)).path_s;
        let moved_m = motion_m(situation, rates, self.path_s);
        // Parts that are farther apart than the motion do not meet.
        let present = (situation.robot).self_contact_of(self.pairs, self.from, -moved_m);
        let present_m = present.map_or(-moved_m, |present| present.overlap_m);
        let share = (self.most_m - present_m) / (self.overlap_m - present_m);
        share.clamp(0.0, 1.0) * self.path_s / end_s
    }
}

/// The first place at which the body overlaps more than it may, seen from the measured or the commanded configuration.
fn violation<'a>(situation: &Situation<'a>, rates: &BendRates) -> Option<Violation<'a>> {
    if fastest(rates) == 0.0 {
        return None;
    }
    let robot = situation.robot;
    let path_s = situation.stopping().path(fastest(rates)).path_s;
    let commanded = (situation.commanded).filter(|it| *it != situation.at && it.is_finite());
    let beside_rad = core::array::from_fn(|j| {
        let [[u, v], [to_u, to_v]] =
            [situation.at, commanded.unwrap_or(situation.at)].map(|it| it.section(j));
        norm([to_u - u, to_v - v])
    });
    let change_rad = changes_rad(rates, path_s);
    let near = robot.near_pairs(
        situation.at,
        &beside_rad,
        &change_rad,
        robot.self_overlap_max_m(),
    );
    if near.at(1.0).is_empty() {
        return None;
    }
    let radii_m = robot.sections().iter().map(|it| it.body_radius_m);
    let thinnest_m = radii_m.fold(f64::INFINITY, f64::min);
    // Between two points no part moves through the thinnest part of the body, unless it is very thin or fast.
    let between = (motion_m(situation, rates, path_s) / (2.0 * thinnest_m)).ceil();
    let between = (between as u32).clamp(1, POINTS);
    let places = (1..=between).map(|k| path_s * f64::from(k) / f64::from(between));
    let places_s = core::iter::once(situation.period_s.min(path_s)).chain(places);
    let origins = [Some(situation.at), commanded];
    for from in origins.into_iter().flatten() {
        let (mut most_m, mut present) = (robot.self_overlap_max_m(), None);
        for place_s in places_s.clone() {
            let there = from.advanced(rates, place_s);
            let pairs = near.at(place_s / path_s);
            let Some(contact) = robot.self_contact_of(pairs, &there, most_m) else {
                continue;
            };
            let present_m = *present.get_or_insert_with(|| {
                let present = robot.self_contact_of(near.at(0.0), from, most_m);
                present.map_or(most_m, |present| present.overlap_m + EQUAL_M)
            });
            most_m = present_m;
            if contact.overlap_m > most_m {
                return Some(Violation {
                    from,
                    path_s: place_s,
                    pairs,
                    overlap_m: contact.overlap_m,
                    most_m,
                });
            }
        }
    }
    None
}

/// How far each bend vector moves along the path \[rad\].
fn changes_rad(rates: &BendRates, path_s: f64) -> [f64; SECTIONS_MAX] {
    core::array::from_fn(|j| path_s * norm(rates.section(j)))
}

/// Upper bound of the motion of any part of the body along the path \[m\].
fn motion_m(situation: &Situation<'_>, rates: &BendRates, path_s: f64) -> f64 {
    let travel_m = situation.robot.travel_m(&changes_rad(rates, path_s));
    travel_m
        .iter()
        .fold(0.0, |most, travel_m| travel_m.max(most))
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand_xoshiro::Xoshiro256PlusPlus;

    use super::*;
    use crate::robot::{Obstacle, Robot, RobotParameters, Shape};
    use crate::safety::{Lag, safe_command};

    const PERIOD_S: f64 = 0.005;

    fn robot(body_radius_m: f64, self_overlap_max_m: f64) -> Robot {
        let mut parameters = RobotParameters {
            self_overlap_max_m,
            ..RobotParameters::paper(3)
        };
        for section in &mut parameters.sections {
            section.body_radius_m = body_radius_m;
        }
        Robot::new(&parameters).unwrap()
    }

    fn situation<'a>(
        robot: &'a Robot,
        at: &'a Configuration,
        previous: &'a BendRates,
    ) -> Situation<'a> {
        Situation {
            robot,
            at,
            lag: None,
            commanded: None,
            slack: None,
            previous,
            obstacles: &[],
            safe_distance_m: 0.01,
            tip_offset_m: 0.0,
            acceleration_rad_s2: f64::INFINITY,
            period_s: PERIOD_S,
            moving_s: 3.0 * PERIOD_S,
            deceleration_rad_s2: 40.0,
            comes_to_rest: false,
        }
    }

    fn overlap_m(robot: &Robot, at: &Configuration) -> f64 {
        let contact = robot.self_contact(at, 0.0);
        contact.map_or(0.0, |contact| contact.overlap_m)
    }

    proptest! {
        /// Nearly closed rings of thin and thick bodies beside a ball, with motors that lag: no command leads deeper than allowed or than now, where the
        /// measured or the commanded configuration is, at the ends of the period and of the stopping path. Where the command without
        /// the rule keeps it, the rule changes no bit.
        #[test]
        fn no_command_leads_the_body_deeper_into_itself(
            bends in prop::array::uniform3(1.7..2.4_f64),
            turns in prop::array::uniform3(-0.4..0.4_f64),
            off in prop::array::uniform6(-0.05..0.05_f64),
            desired in prop::array::uniform6(-2.0..2.0_f64),
            body_radius_m in 0.001..0.04_f64,
            allowed_m in prop_oneof![Just(0.0), 0.0..0.02_f64],
            tip_offset_m in prop_oneof![Just(0.0), 0.0..0.05_f64],
            beside_m in prop::array::uniform3(-0.2..0.2_f64),
            has_obstacle: bool,
        ) {
            let at = Configuration::from_bend_angles(&[0, 1, 2].map(|j| [bends[j], turns[j]]));
            let [commanded, delayed] = [1.0, -0.5].map(|share| {
                let offset = BendRates::from_slice(&off).unwrap();
                at.advanced(&offset, share)
            });
            let [guarded, free] = [allowed_m, 1.0].map(|most_m| robot(body_radius_m, most_m));
            let centre_m = guarded.body_point(&at, 1, 0.5) + Vector3::from(beside_m);
            let obstacle = Obstacle::new(Shape::Sphere { centre_m }, 0.02, Vector3::zeros()).unwrap();
            let obstacles = [obstacle];
            let rest = BendRates::zero(3);
            let begin = Situation {
                lag: Some(Lag { delayed: &delayed, time_constant_s: 0.1 }),
                commanded: Some(&commanded),
                obstacles: if has_obstacle { &obstacles } else { &[] },
                tip_offset_m,
                ..situation(&guarded, &at, &rest)
            };
            let desired = BendRates::from_slice(&desired).unwrap();
            let safe = safe_command(&begin, &desired);
            let end_s = |rates: &BendRates| begin.stopping().path(fastest(rates)).path_s;
            let keeps = |rates: &BendRates| {
                [&at, &commanded].into_iter().all(|from| {
                    let most_m = overlap_m(&guarded, from).max(allowed_m);
                    [PERIOD_S, end_s(rates)].into_iter().all(|path_s| {
                        overlap_m(&guarded, &from.advanced(rates, path_s)) <= most_m
                    })
                })
            };
            prop_assert!(keeps(&safe.rates), "{safe:?}");
            let unguarded = safe_command(&Situation { robot: &free, ..begin }, &desired);
            prop_assert!(!unguarded.limits_hit.self_contact);
            prop_assert!(fastest(&safe.rates) <= fastest(&unguarded.rates));
            if safe.limits_hit.self_contact {
                prop_assert!(safe.rates != unguarded.rates);
            } else {
                prop_assert_eq!(safe, unguarded);
            }
            // What leads out of a contact on the whole way stays as it is.
            let steps = (1..=200).map(|k| f64::from(k) / 200.0);
            let is_way_out = [&at, &commanded].into_iter().all(|from| {
                let most_m = overlap_m(&guarded, from).max(allowed_m);
                let rates = &unguarded.rates;
                (steps.clone().chain([PERIOD_S / end_s(rates)])).all(|share| {
                    overlap_m(&guarded, &from.advanced(rates, share * end_s(rates))) <= most_m - 1e-9
                })
            });
            prop_assert!(!is_way_out || safe == unguarded);
        }
    }

    /// A ring that closes at full speed stops where its ends touch, is not stuck there, and opens at once.
    #[test]
    fn a_ring_closes_up_to_the_permitted_overlap_and_opens_again() {
        for (radius_m, allowed_m) in [(0.015, 0.002), (0.002, 0.0), (0.03, 0.01)] {
            let robot = robot(radius_m, allowed_m);
            let mut at = Configuration::from_bend_angles(&[[1.8, 0.2]; 3]);
            let inwards = BendRates::from_slice(&[1.0, 0.2, 1.0, 0.2, 1.0, 0.2]).unwrap();
            let mut previous = BendRates::zero(3);
            let (mut deepest_m, mut stopped) = (0.0_f64, 0);
            for _ in 0..400 {
                let safe = safe_command(&situation(&robot, &at, &previous), &inwards);
                at = at.advanced(&safe.rates, PERIOD_S);
                previous = safe.rates;
                deepest_m = deepest_m.max(overlap_m(&robot, &at));
                stopped += u32::from(safe.limits_hit.self_contact);
            }
            println!("{radius_m}: {deepest_m} m, {stopped} periods");
            assert!(deepest_m <= allowed_m, "{deepest_m} m");
            assert!(robot.self_contact(&at, allowed_m - 1e-4).is_some());
            assert!(stopped > 100);
            let outwards = scaled_by(&inwards, -1.0);
            let safe = safe_command(&situation(&robot, &at, &previous), &outwards);
            assert_eq!(
                (safe.rates, safe.limits_hit.self_contact),
                (outwards, false)
            );
        }
    }

    fn paper(section_count: usize) -> Robot {
        Robot::new(&RobotParameters::paper(section_count)).unwrap()
    }

    /// Four sections overlap deeper than they may; only the first section moves, and with it all of them together.
    #[test]
    fn a_motion_that_changes_no_overlap_is_not_held() {
        let (robot, rest) = (paper(6), BendRates::zero(6));
        let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
        let mut tried = 0;
        while tried < 100 {
            let mut bends = [[0.0; 2]; 6];
            for bend in &mut bends[..2] {
                *bend = [
                    random.random_range(0.0..0.4),
                    random.random_range(-3.0..3.0),
                ];
            }
            for bend in &mut bends[2..] {
                *bend = [
                    random.random_range(1.5..2.5),
                    random.random_range(-0.4..0.4),
                ];
            }
            let at = Configuration::from_bend_angles(&bends);
            let contact = robot.self_contact(&at, 0.0025);
            let mut desired = rest;
            desired.as_mut_slice()[0] = random.random_range(0.05..0.3);
            // The first section touches nothing on the way.
            let same = |share: u32| {
                let there = at.advanced(&desired, 0.002 * f64::from(share));
                (overlap_m(&robot, &there) - overlap_m(&robot, &at)).abs() < EQUAL_M
            };
            if contact.is_none_or(|contact| contact.sections[0] < 2) || !(1..=20).all(same) {
                continue;
            }
            tried += 1;
            let safe = safe_command(&situation(&robot, &at, &rest), &desired);
            assert!(fastest(&safe.rates) > 0.0, "{bends:?}");
        }
    }

    /// Rings that close at full speed, beside the ramp of 0.2 rad/s a period: the last steps to rest are as short as those in front of an obstacle.
    #[test]
    fn a_ring_that_closes_at_speed_does_not_stop_at_once() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(2);
        let mut held = 0;
        for section_count in [3, 4] {
            let robot = paper(section_count);
            for _ in 0..100 {
                let bend_rad = 5.0 / section_count as f64;
                let around = |random: &mut Xoshiro256PlusPlus| {
                    [
                        bend_rad + random.random_range(-0.2..0.2),
                        random.random_range(-0.5..0.5),
                    ]
                };
                let bends: Vec<_> = (0..section_count).map(|_| around(&mut random)).collect();
                let mut at = Configuration::from_bend_angles(&bends);
                if overlap_m(&robot, &at) > 0.0 {
                    continue;
                }
                let rates = (0..2 * section_count).map(|k| match k % 2 {
                    0 => random.random_range(0.7..1.3),
                    _ => random.random_range(-0.5..0.5),
                });
                let inwards = BendRates::from_slice(&rates.collect::<Vec<_>>()).unwrap();
                let mut previous = BendRates::zero(section_count);
                for _ in 0..400 {
                    let begin = Situation {
                        acceleration_rad_s2: 40.0,
                        ..situation(&robot, &at, &previous)
                    };
                    let safe = safe_command(&begin, &inwards);
                    let stops = fastest(&safe.rates) == 0.0 && fastest(&previous) > 0.3;
                    assert!(!stops, "from {} rad/s", fastest(&previous));
                    held += u32::from(safe.limits_hit.self_contact);
                    at = at.advanced(&safe.rates, PERIOD_S);
                    previous = safe.rates;
                }
            }
        }
        assert!(held > 100, "{held}");
    }
}
