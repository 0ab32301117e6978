use crate::robot::{CABLES_MAX, Configuration, Robot};

/// Rounding of a length (m).
const ROUNDING_M: f64 = 1e-12;

/// The shape of a robot whose cables pull and do not push, with these strokes (m) as in [`Robot::cable_strokes`]; an
/// infinite stroke is a broken cable.
///
/// Each section, base first, springs back towards straight as far as its cables allow. Of the pulls s with s · d ≥
/// −stroke for its three cables, it takes the one nearest to the pull of the proximal sections (§2 of docs/model.md).
/// If all cables are taut, the shape is that of [`Robot::bend_from_cable_strokes`].
pub(super) fn bent_by_slack_cables(robot: &Robot, strokes_m: &[f64; CABLES_MAX]) -> Configuration {
    let mut bent = Configuration::straight(robot.section_count());
    let (bends, _) = bent.as_mut_slice().as_chunks_mut::<2>();
    let (cables, _) = strokes_m.as_chunks::<3>();
    let mut proximal_m = [0.0; 2];
    let sections = robot.sections().iter().zip(robot.cable_directions());
    for ((bend, strokes_m), (section, directions)) in bends.iter_mut().zip(cables).zip(sections) {
        let pull_m = nearest_pull(directions, strokes_m, proximal_m);
        let pull_m = pull_m.unwrap_or_else(|| taut_pull(directions, strokes_m));
        *bend = core::array::from_fn(|i| (pull_m[i] - proximal_m[i]) / section.cable_radius_m);
        proximal_m = pull_m;
    }
    bent
}

fn along([x, y]: [f64; 2], direction: [f64; 2]) -> f64 {
    x * direction[0] + y * direction[1]
}

/// Of the pulls (m) that tighten no cable beyond its stroke, the one nearest to `proximal_m`; `None` if there is none.
fn nearest_pull(
    directions: &[[f64; 2]; 3],
    strokes_m: &[f64; 3],
    proximal_m: [f64; 2],
) -> Option<[f64; 2]> {
    let cables = || directions.iter().copied().zip(strokes_m.iter().copied());
    let is_free = |pull_m: &[f64; 2]| {
        cables().all(|(direction, stroke_m)| along(*pull_m, direction) + stroke_m >= -ROUNDING_M)
    };
    let distance_m = |[x, y]: &[f64; 2]| (x - proximal_m[0]).hypot(y - proximal_m[1]);
    // Candidates: no taut cable, one, or two.
    let by_one = cables().map(|(direction, stroke_m)| {
        let missing_m = -stroke_m - along(proximal_m, direction);
        core::array::from_fn(|i| proximal_m[i] + missing_m * direction[i])
    });
    let by_two = (0..3).map(|left_out| {
        let [one, other] = [(left_out + 1) % 3, (left_out + 2) % 3];
        let [[a, b], [c, d]] = [directions[one], directions[other]];
        let (s, t) = (-strokes_m[one], -strokes_m[other]);
        [s * d - b * t, a * t - s * c].map(|part_m| part_m / (a * d - b * c))
    });
    core::iter::once(proximal_m)
        .chain(by_one)
        .chain(by_two)
        .filter(is_free)
        .min_by(|one, other| distance_m(one).total_cmp(&distance_m(other)))
}

/// Least-squares pull of three taut cables (m).
fn taut_pull(directions: &[[f64; 2]; 3], strokes_m: &[f64; 3]) -> [f64; 2] {
    let cables = || directions.iter().zip(strokes_m);
    core::array::from_fn(|axis| {
        let pulls_m = cables().map(|(direction, stroke_m)| -stroke_m * direction[axis]);
        pulls_m.sum::<f64>() / 1.5
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::RobotParameters;

    fn robot() -> Robot {
        Robot::new(&RobotParameters::paper(2)).unwrap()
    }

    fn bent(bend_rad: [f64; 4]) -> Configuration {
        Configuration::from_slice(&bend_rad).unwrap()
    }

    /// The bends of a robot commanded to `bend_rad`, with strokes longer by `more_m` (m).
    fn found(bend_rad: [f64; 4], more_m: impl Fn(usize) -> f64) -> [f64; 4] {
        let mut strokes_m = robot().cable_strokes(&bent(bend_rad));
        for (cable, stroke_m) in strokes_m.iter_mut().enumerate().take(6) {
            *stroke_m += more_m(cable);
        }
        let bends = bent_by_slack_cables(&robot(), &strokes_m);
        core::array::from_fn(|i| bends.as_slice()[i])
    }

    fn near(found: [f64; 4], expected: [f64; 4]) {
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
    }

    #[test]
    fn taut_cables_bend_the_robot_as_in_the_model() {
        for bend_rad in [[0.0; 4], [0.5, -0.2, 0.1, 0.7], [-1.0, 0.3, -0.2, -0.4]] {
            near(found(bend_rad, |_| 0.0), bend_rad);
            // Over-tightened together, the cables block each other: no additional bend.
            near(found(bend_rad, |_| -1e-4), bend_rad);
        }
    }

    /// At 12.5 mm from the backbone, 1.25 mm are 0.1 rad. A section that bends along one cable is held by that cable
    /// alone.
    #[test]
    fn slack_cables_let_each_section_spring_back_towards_straight() {
        near(
            found([0.5, 0.0, 0.0, 0.0], |_| 1.25e-3),
            [0.4, 0.0, 0.0, 0.0],
        );
        near(
            found([0.05, 0.03, 0.02, -0.03], |_| 1.25e-3),
            [0.0, 0.0, 0.0, 0.0],
        );
    }

    #[test]
    fn a_broken_cable_neither_pulls_nor_blocks() {
        let broken =
            |which: usize| move |cable: usize| if cable == which { f64::INFINITY } else { 0.0 };
        // No cable pulls towards the broken one; away from it the two others do.
        let away = [-0.5, 0.0, 0.0, 0.0];
        near(found(away, broken(0)), away);
        // The intact cables of the second section take over the pull that the first one lacks.
        let both = found([0.5, 0.0, 0.3, 0.0], broken(0));
        near(both, [0.0, 0.0, 0.8, 0.0]);
    }
}
