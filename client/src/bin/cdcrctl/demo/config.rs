use std::fmt::Write;

use cdcr_client::Spiral;
use cdcr_controller::robot::RobotParameters;

/// The demo's configuration: the paper's robot, simulated, with its initial tip on the spiral.
pub(super) fn text(sections: usize, spiral: &Spiral) -> String {
    let mut text = String::from("# Written by cdcrctl demo.\n");
    for section in RobotParameters::paper(sections).sections {
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n[[robot.sections]]\n\
             length_m = {:?}\n\
             cable_radius_m = {:?}\n\
             cable_offset_rad = {:?}\n\
             bend_max_rad = {:?}\n\
             rate_max_rad_s = {:?}\n\
             body_radius_m = {:?}\n",
            section.length_m,
            section.cable_radius_m,
            section.cable_offset_rad,
            section.bend_max_rad,
            section.rate_max_rad_s,
            section.body_radius_m
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
        assert_eq!(text.matches("length_m = 0.3\n").count(), 3);
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
