use proptest::prelude::*;

use super::*;
use crate::robot::{BendRates, RobotParameters};

/// Sections of these lengths and radii (m).
fn robot(sections: &[[f64; 2]]) -> Robot {
    let mut parameters = RobotParameters::paper(sections.len());
    for (section, [length_m, body_radius_m]) in parameters.sections.iter_mut().zip(sections) {
        section.length_m = *length_m;
        section.cable_radius_m = 0.1 * length_m;
        section.body_radius_m = *body_radius_m;
    }
    Robot::new(&parameters).unwrap()
}

/// Deepest overlap of points of the backbone, `count` of each section; minus infinity without parts that can touch.
fn sampled_m(robot: &Robot, at: &Configuration, count: u32) -> f64 {
    let mut points = Vec::new();
    let mut base_m = 0.0;
    for (j, section) in robot.sections().iter().enumerate() {
        for k in 0..=count {
            let share = f64::from(k) / f64::from(count);
            let point_m = robot.body_point(at, j, share);
            points.push((
                base_m + share * section.length_m,
                section.body_radius_m,
                point_m,
            ));
        }
        base_m += section.length_m;
    }
    let mut deepest_m = f64::NEG_INFINITY;
    for (i, (from_m, radius_m, point_m)) in points.iter().enumerate() {
        for (to_m, its_radius_m, its_m) in &points[i..] {
            if to_m - from_m >= PI * radius_m.max(*its_radius_m) {
                deepest_m = deepest_m.max(radius_m + its_radius_m - (point_m - its_m).norm());
            }
        }
    }
    deepest_m
}

/// One to six sections of any length and radius, none of which can bend narrower than its body, and their bends: half of the shapes coil.
fn bodies() -> impl Strategy<Value = (Robot, Configuration)> {
    let section = (0.1..0.4_f64, 0.02..1.0_f64, 0.0..2.8_f64, -PI..PI);
    let coil = (0.5..2.8_f64, -PI..PI);
    (
        prop::collection::vec(section, 1..=SECTIONS_MAX),
        prop::option::of(coil),
    )
        .prop_map(|(sections, coil)| {
            let sizes: Vec<_> = (sections.iter())
                .map(|(length_m, share, ..)| [*length_m, share * length_m / 2.9 / 4.0])
                .collect();
            let bends: Vec<_> = (sections.iter())
                .map(|(_, _, bend_rad, direction_rad)| match coil {
                    Some((bend_rad, towards_rad)) => [bend_rad, towards_rad + 0.1 * direction_rad],
                    None => [*bend_rad, *direction_rad],
                })
                .collect();
            (robot(&sizes), Configuration::from_bend_angles(&bends))
        })
}

proptest! {
    /// The overlap is that of densely sampled points, of which it is the limit: it is more by what they miss at most. Of two places in laps
    /// that lie on each other, the less deep one may be found.
    #[test]
    fn the_deepest_overlap_is_that_of_many_points((robot, at) in bodies()) {
        const COUNT: u32 = 120;
        let sampled_m = sampled_m(&robot, &at, COUNT);
        let found_m = robot.self_contact(&at, 0.0).map_or(0.0, |found| found.overlap_m);
        // The nearest points of both sides are up to half a step from a sampled one.
        let step_m = robot.sections().iter().fold(0.0_f64, |most, it| most.max(it.length_m)) / f64::from(COUNT);
        let radii_m = robot.sections().iter().map(|it| it.body_radius_m);
        let slack_m = 0.02 * radii_m.fold(0.0, f64::max);
        prop_assert!(found_m >= sampled_m - slack_m, "{found_m} m, {sampled_m} m by points");
        prop_assert!(found_m <= sampled_m.max(0.0) + step_m, "{found_m} m, {sampled_m} m by points");
        // A floor only hides what is not deeper.
        for above_m in [0.5 * found_m, found_m + 1e-9] {
            let above = robot.self_contact(&at, above_m).map(|found| found.overlap_m);
            if above_m < found_m {
                prop_assert!((above.unwrap_or(0.0) - found_m).abs() < 1e-6, "{above:?} above {above_m}");
            } else {
                prop_assert_eq!(above, None);
            }
        }
    }

    /// Schur's bound: with bends of at most π in all, and no arc narrower than the thickest body, nothing touches, whatever the directions.
    #[test]
    fn a_body_bent_by_half_a_turn_in_all_does_not_touch_itself((robot, at) in bodies(), share in 0.0..=1.0_f64) {
        let turned_rad: f64 = (0..robot.section_count()).map(|j| at.bend_rad(j)).sum();
        let scale = (share.sqrt() * PI / turned_rad).min(1.0);
        let bends: Vec<_> = at.as_slice().iter().map(|bend| bend * scale * (1.0 - 1e-12)).collect();
        let at = Configuration::from_slice(&bends).unwrap();
        let thickest_m = robot.sections().iter().fold(0.0_f64, |most, it| most.max(it.body_radius_m));
        let is_wide = (robot.sections().iter().enumerate()).all(|(j, it)| it.length_m / at.bend_rad(j) >= thickest_m);
        prop_assume!(is_wide);
        prop_assert_eq!(robot.self_contact(&at, 0.0), None);
        let touching_m = sampled_m(&robot, &at, 60);
        prop_assert!(touching_m <= 1e-9, "{touching_m} m");
    }
}

proptest! {
    /// Wherever the bends begin and go, the pairs that are left to a share of the way have every contact there.
    #[test]
    fn pairs_that_are_left_out_along_a_motion_do_not_touch(
        (robot, at) in bodies(),
        beside in prop::array::uniform12(-0.05..0.05_f64),
        way in prop::array::uniform12(-0.3..0.3_f64),
        share in 0.0..=1.0_f64,
        above_m in prop_oneof![Just(0.0), 0.0..0.01_f64],
    ) {
        let [beside, way] = [beside, way].map(|it| {
            BendRates::from_slice(&it[..2 * robot.section_count()]).unwrap()
        });
        let norms = |it: &BendRates| core::array::from_fn(|j| norm(it.section(j)));
        let near = robot.near_pairs(&at, &norms(&beside), &norms(&way), above_m);
        let there = at.advanced(&beside, 1.0).advanced(&way, share);
        let deepest_m = |found: Option<SelfContact>| found.map_or(above_m, |it| it.overlap_m);
        let all_m = deepest_m(robot.self_contact(&there, above_m));
        // What is looked at with a share is looked at with every larger one.
        for share in [share, 1.0] {
            let found_m = deepest_m(robot.self_contact_of(near.at(share), &there, above_m));
            prop_assert!((found_m - all_m).abs() < 1e-6, "{found_m} m of {all_m} m");
        }
    }
}

/// The half circle of the bound's equality, with an arc as narrow as its body and legs that run back beside each other.
#[test]
fn the_bound_is_reached_by_a_half_circle_as_narrow_as_the_body() {
    let radius_m = 0.05;
    let robot = robot(&[[0.3, radius_m], [PI * radius_m, radius_m], [0.3, radius_m]]);
    let shape =
        |bend_rad: f64| Configuration::from_bend_angles(&[[0.0, 0.0], [bend_rad, 0.3], [0.0, 0.0]]);
    assert_eq!(robot.self_contact(&shape(PI - 1e-9), 0.0), None);
    assert!(sampled_m(&robot, &shape(PI), 200).abs() < 1e-9);
    // Bent farther, beyond what a robot allows, the legs cross.
    let found = robot
        .self_contact(&shape(PI + 0.2), 0.0)
        .expect("legs that cross");
    assert_eq!(found.sections, [0, 2]);
    assert!(found.overlap_m > 0.02, "{found:?}");
}

/// A thick section beside a thin one that turns back: bends of π touch, as the turn is narrower than the thick body.
#[test]
fn a_turn_narrower_than_the_thickest_body_is_looked_at() {
    let robot = robot(&[[0.3, 0.035], [0.05, 0.002], [0.3, 0.002]]);
    let at = Configuration::from_bend_angles(&[[0.0, 0.0], [3.1, 0.0], [0.0, 0.0]]);
    let found = robot.self_contact(&at, 0.0).expect("a contact");
    assert_eq!(found.sections, [0, 2]);
    assert!(
        (found.overlap_m - sampled_m(&robot, &at, 400)).abs() < 1e-4,
        "{found:?}"
    );
}

/// A catheter of 0.3 mm that crosses itself: the points of a section are 19 mm apart.
#[test]
fn a_thin_body_is_not_missed_between_points() {
    let robot = robot(&[[0.3, 3e-4]; 3]);
    let mut touching = 0;
    for turn in 0..200 {
        let turn_rad = 1e-3 * f64::from(turn);
        // Nearly a ring, which its end crosses at an angle.
        let ring = TAU / 3.0 + 0.1;
        let at = Configuration::from_bend_angles(&[[ring, 0.0], [ring, turn_rad], [ring, 0.0]]);
        let by_points_m = sampled_m(&robot, &at, 1500);
        let found_m = robot
            .self_contact(&at, 0.0)
            .map_or(0.0, |found| found.overlap_m);
        touching += u32::from(by_points_m > 1e-5);
        assert!(
            found_m >= by_points_m - 1e-7,
            "{turn_rad}: {found_m} m, {by_points_m} m"
        );
        if turn % 50 == 0 {
            println!("{turn_rad}: {found_m} m");
        }
    }
    assert!(touching > 0);
}

/// No number of the bends is a contact, and a body without thickness has none.
#[test]
fn bends_that_are_no_numbers_and_lines_touch_nothing() {
    let ring = Configuration::from_bend_angles(&[[TAU / 3.0, 0.0]; 3]);
    assert!(robot(&[[0.3, 0.015]; 3]).self_contact(&ring, 0.0).is_some());
    assert_eq!(robot(&[[0.3, 0.0]; 3]).self_contact(&ring, 0.0), None);
    let mut unknown = ring;
    unknown.as_mut_slice()[3] = f64::NAN;
    assert_eq!(robot(&[[0.3, 0.015]; 3]).self_contact(&unknown, 0.0), None);
}
