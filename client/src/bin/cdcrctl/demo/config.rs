use std::fmt::Write;

use cdcr_client::{PAPER_SECTION_M, Spiral};

/// Angle between the first cables of two neighbouring sections \[degrees\].
const CABLE_STEP_DEG: usize = 40;

/// The demo's configuration: the paper's robot, simulated, that starts on the spiral.
pub(super) fn text(sections: usize, spiral: &Spiral) -> String {
    let mut text = String::from("# Written by cdcrctl demo.\n");
    for section in 0..sections {
        let offset_rad = ((CABLE_STEP_DEG * section) as f64).to_radians();
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n[[robot.sections]]\n\
             length_m = {PAPER_SECTION_M:?}\n\
             cable_radius_m = 0.0125\n\
             cable_offset_rad = {offset_rad:?}\n\
             bend_max_rad = 2.8\n\
             rate_max_rad_s = 2.0\n\
             body_radius_m = 0.015\n"
        );
    }
    let mut bends = vec![[0.0, 0.0]; sections];
    if let Some(last) = bends.last_mut() {
        *last = spiral.start_bend_rad();
    }
    let _ = write!(
        text,
        "\n[link]\nkind = \"simulated\"\ninitial_bend_rad = {bends:?}\n"
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_has_every_section_and_starts_on_the_spiral() {
        let text = text(3, &Spiral::for_sections(&[0.3; 3]));
        assert_eq!(text.matches("[[robot.sections]]").count(), 3);
        assert!(
            text.contains("cable_offset_rad = 0.6981317007977318"),
            "{text}"
        );
        // θ = 2·5°/15, φ = 5°.
        assert!(
            text.contains("initial_bend_rad = [[0.0, 0.0], [0.0, 0.0], [0.01159"),
            "{text}"
        );
    }
}
