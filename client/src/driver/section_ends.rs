//! Where the ends of the sections are (§1 of docs/model.md), without the controller: a driver needs no `model`.

use cdcr_shared_types::limits::SECTIONS_MAX;
use cdcr_shared_types::{RobotDescription, SectionDescription};

use super::{CommandedPosition, bounds};

/// Equal parts of a move, each of which is taken for straight.
const PARTS: u32 = 8;
/// Bend below which a section is straight to the last digits of a position \[rad\].
const STRAIGHT_RAD: f64 = 1e-6;

/// Longest way of a section end in a move of the bends on a straight line, if all of it were as fast as its fastest
/// part \[m\]: divided by the duration of the move, the largest speed.
pub(super) fn way_m(
    robot: &RobotDescription,
    begin: &CommandedPosition,
    end: &CommandedPosition,
) -> f64 {
    if begin.bend_rad == end.bend_rad {
        return 0.0;
    }
    let sections = bounds::sections(robot);
    let mut before = ends_m(sections, &begin.bend_rad);
    let mut longest_m = 0.0_f64;
    for part in 1..=PARTS {
        let position = begin.towards(end, f64::from(part) / f64::from(PARTS));
        let after = ends_m(sections, &position.bend_rad);
        for (a, b) in before.iter().zip(&after) {
            longest_m = longest_m.max((b[0] - a[0]).hypot(b[1] - a[1]).hypot(b[2] - a[2]));
        }
        before = after;
    }
    longest_m * f64::from(PARTS)
}

/// The ends of the sections, seen from the base, at these bend vectors \[m\].
fn ends_m(sections: &[SectionDescription], bends_rad: &[f64]) -> [[f64; 3]; SECTIONS_MAX] {
    let mut ends_m = [[0.0; 3]; SECTIONS_MAX];
    for (j, end_m) in ends_m.iter_mut().enumerate().take(sections.len()) {
        for i in (0..=j).rev() {
            *end_m = from_section(
                sections[i].length_m,
                bends_rad[2 * i],
                bends_rad[2 * i + 1],
                end_m,
            );
        }
    }
    ends_m
}

/// A point seen from the end of a section, as it is seen from the beginning of that section.
fn from_section(length_m: f64, u_rad: f64, v_rad: f64, point_m: &[f64; 3]) -> [f64; 3] {
    let square = u_rad * u_rad + v_rad * v_rad;
    let bend_rad = square.sqrt();
    let (f, g) = if bend_rad < STRAIGHT_RAD {
        (1.0, 0.5)
    } else {
        let half_sine = (0.5 * bend_rad).sin();
        (
            bend_rad.sin() / bend_rad,
            2.0 * half_sine * half_sine / square,
        )
    };
    // Rodrigues' formula, about the axis (-v, u, 0).
    let turn = |[x, y, z]: [f64; 3]| [u_rad * z, v_rad * z, -v_rad * y - u_rad * x];
    let once = turn(*point_m);
    let twice = turn(once);
    let end_m = [length_m * g * u_rad, length_m * g * v_rad, length_m * f];
    core::array::from_fn(|i| end_m[i] + point_m[i] + f * once[i] + g * twice[i])
}

#[cfg(all(test, feature = "model"))]
mod tests {
    use cdcr_controller::robot::{BendRates, Configuration};

    use super::*;
    use crate::model::robot_of;

    #[test]
    fn the_fastest_section_end_is_that_of_the_controller() {
        let mut robot = RobotDescription {
            sections: 3,
            cable_speed_max_m_s: 0.1,
            cable_stroke_max_m: 0.1,
            ..RobotDescription::default()
        };
        for (section, length_m) in robot.section.iter_mut().zip([0.12, 0.1, 0.08]) {
            *section = SectionDescription {
                length_m,
                cable_radius_m: 0.01,
                bend_max_rad: 2.8,
                rate_max_rad_s: 2.0,
                ..SectionDescription::default()
            };
        }
        let exact = robot_of(&robot).unwrap();
        let position = |bends: [f64; 6]| {
            let mut bend_rad = [0.0; 2 * SECTIONS_MAX];
            bend_rad[..6].copy_from_slice(&bends);
            CommandedPosition {
                bend_rad,
                cable_length_m: [0.0; 3 * SECTIONS_MAX],
            }
        };
        for (middle, way) in [
            ([0.0; 6], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            (
                [0.7, -1.1, 0.2, 0.9, -0.4, 0.3],
                [0.3, 0.8, -0.5, 0.1, 0.2, 0.9],
            ),
            (
                [-2.0, 1.0, 1.5, -0.1, 0.0, 1e-7],
                [0.0, -0.7, 0.9, 0.4, -1.0, 0.0],
            ),
            // The first section straightens what follows: its own end is the fastest.
            (
                [1.0, 0.0, -1.5, 0.2, 2.0, 0.1],
                [1.0, 0.0, -2.0, 0.0, 1.0, 0.0],
            ),
        ] {
            let half: [f64; 6] = way.map(|rad| 1e-4 * rad);
            let begin = position(core::array::from_fn(|i| middle[i] - half[i]));
            let end = position(core::array::from_fn(|i| middle[i] + half[i]));
            let found_m = way_m(&robot, &begin, &end) / 2e-4;
            let exact_m = exact.fastest_section_end_m_s(
                &Configuration::from_slice(&middle).unwrap(),
                &BendRates::from_slice(&way).unwrap(),
            );
            assert!(
                (found_m / exact_m - 1.0).abs() < 1e-3,
                "{found_m} for {exact_m}"
            );
        }
    }
}
