use cdcr_controller::robot::{Configuration, Robot};

/// Points on the backbone of a section; enough for a smooth bend of 0.7 rad.
const POINTS_PER_SECTION: usize = 24;

/// A point in the base frame \[m\].
pub(crate) type Position = [f64; 3];

/// Points on the backbone of a robot with these bends \[rad\], base first and tip last. Empty when the bends
/// do not fit the robot.
pub(crate) fn backbone(robot: &Robot, bend_rad: &[f64]) -> Vec<Position> {
    let sections = robot.section_count();
    let Some(bent) = Configuration::from_slice(bend_rad) else {
        return Vec::new();
    };
    let point = |k: usize| {
        let (section, part) = (k / POINTS_PER_SECTION, k % POINTS_PER_SECTION);
        let share = part as f64 / POINTS_PER_SECTION as f64;
        robot.body_point(&bent, section, share).into()
    };
    // The section index after the last one means the tip.
    (0..=sections * POINTS_PER_SECTION).map(point).collect()
}
