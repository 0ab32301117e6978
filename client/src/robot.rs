use cdcr_shared_types::RobotDescription;
use cdcr_shared_types::codes::realtime;
use cdcr_shared_types::limits::{CABLES_MAX, SECTIONS_MAX};

/// Lengths of the robot's sections, base first \[m\].
pub fn section_lengths_m(robot: &RobotDescription) -> Vec<f64> {
    let sections = (robot.sections as usize).min(SECTIONS_MAX);
    let used = &robot.section[..sections];
    used.iter().map(|section| section.length_m).collect()
}

/// Cable lengths of the straight robot \[m\], the reference of the encoders: each is the sum of all sections
/// up to the cable's own. Three cables per section, base first.
pub fn straight_cable_lengths_m(robot: &RobotDescription) -> [f64; CABLES_MAX] {
    let mut lengths_m = [0.0; CABLES_MAX];
    let mut length_m = 0.0;
    for (cables, section_m) in lengths_m.chunks_mut(3).zip(section_lengths_m(robot)) {
        length_m += section_m;
        cables.fill(length_m);
    }
    lengths_m
}

/// Missing real-time properties of a daemon, each with its remedy; empty if none is missing. `bits` is
/// `realtime_missing` of its status.
pub fn realtime_missing(bits: u32) -> Vec<(&'static str, &'static str)> {
    realtime::set(bits).collect()
}

/// Text of a fixed message field: UTF-8, padded with zeros.
pub fn text(field: &[u8]) -> String {
    let used = field.iter().position(|&byte| byte == 0);
    String::from_utf8_lossy(&field[..used.unwrap_or(field.len())]).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_end_at_the_first_zero() {
        assert_eq!(text(b"trunk\0\0\0"), "trunk");
        assert_eq!(text(b"full"), "full");
    }

    #[test]
    fn missing_bits_have_names() {
        assert!(realtime_missing(0).is_empty());
        let both = realtime_missing(realtime::FIFO | realtime::LOCKED);
        assert_eq!(both[0].0, "SCHED_FIFO");
        assert_eq!(both[1].0, "locked memory");
    }

    #[test]
    fn cables_pass_all_sections_up_to_their_own() {
        let mut robot = RobotDescription {
            sections: 2,
            ..RobotDescription::default()
        };
        (robot.section[0].length_m, robot.section[1].length_m) = (0.25, 0.5);
        let lengths_m = straight_cable_lengths_m(&robot);
        assert_eq!(lengths_m[..7], [0.25, 0.25, 0.25, 0.75, 0.75, 0.75, 0.0]);
    }

    #[test]
    fn a_wild_number_of_sections_is_cut() {
        let robot = RobotDescription {
            sections: 99,
            ..RobotDescription::default()
        };
        assert_eq!(section_lengths_m(&robot).len(), SECTIONS_MAX);
    }
}
