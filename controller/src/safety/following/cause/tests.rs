use super::*;
use crate::robot::{Configuration, RobotParameters};

/// Of three sections whose bends are off by these (rad), and in addition these cables (cable, m).
fn cause(off_rad: [f64; 6], more_m: &[(usize, f64)]) -> Option<FollowingCause> {
    let robot = Robot::new(&RobotParameters::paper(3)).unwrap();
    let off = Configuration::from_slice(&off_rad).unwrap();
    let mut error = FollowingError {
        bend_rad: core::array::from_fn(|j| off.bend_rad(j)),
        cable_m: robot.cable_strokes(&off),
    };
    for (cable, more_m) in more_m {
        error.cable_m[*cable] += more_m;
    }
    FollowingCause::find(&robot, &error)
}

#[test]
fn a_cause_is_named_where_the_data_show_it() {
    use FollowingCause::{CommonMode, EverySection, OneCable};
    const ALIKE: [(usize, f64); 3] = [(3, 2e-3), (4, 2e-3), (5, 2e-3)];
    let bent = [0.0, 0.0, 0.2, -0.25, 0.0, 0.0];
    assert_eq!(cause([0.0; 6], &[]), None);
    assert_eq!(cause([0.03; 6], &[]), None, "within the tolerance");
    assert_eq!(cause(bent, &[]), None, "one section");
    assert_eq!(cause([0.2; 6], &[]), Some(EverySection));
    // A driver that refuses commands because of its zero: nothing follows, and the bends differ, too.
    for off_rad in [[0.0; 6], bent, [0.1; 6]] {
        let Some(CommonMode { section, error_m }) = cause(off_rad, &ALIKE) else {
            unreachable!("{off_rad:?}");
        };
        assert!(section == 1 && (error_m - 2e-3).abs() < 1e-12, "{error_m}");
    }
    let jammed = OneCable {
        section: 1,
        cable: 2,
        error_m: -4e-3,
    };
    assert_eq!(cause([0.0; 6], &[(5, -4e-3)]), Some(jammed));
    let text = jammed.to_string();
    assert!(
        text.starts_with("of section 2, cable 3 alone is measured 4.0 mm shorter"),
        "{text}"
    );
}
