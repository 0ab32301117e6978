use cdcr_shared_types::RobotDescription;
use cdcr_shared_types::codes::realtime;
use cdcr_shared_types::limits::SECTIONS_MAX;

/// Lengths of the robot's sections, base first \[m\].
pub fn section_lengths_m(robot: &RobotDescription) -> Vec<f64> {
    let sections = (robot.sections as usize).min(SECTIONS_MAX);
    let used = &robot.section[..sections];
    used.iter().map(|section| section.length_m).collect()
}

/// What a daemon lacks for real time, each with its remedy; empty: nothing. `bits` is
/// `realtime_missing` of its status.
pub fn realtime_missing(bits: u32) -> Vec<(&'static str, &'static str)> {
    realtime::set(bits).collect()
}

/// The text in a message's fixed field: UTF-8, padded with zeros.
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
    fn a_wild_number_of_sections_is_cut() {
        let robot = RobotDescription {
            sections: 99,
            ..RobotDescription::default()
        };
        assert_eq!(section_lengths_m(&robot).len(), SECTIONS_MAX);
    }
}
