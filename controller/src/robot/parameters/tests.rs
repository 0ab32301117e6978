//! Valid and invalid parameters, their errors, and the fingerprint.

use super::*;

#[test]
fn the_papers_robot_is_valid_with_one_to_six_sections() {
    for n in 1..=SECTIONS_MAX {
        let robot = Robot::new(&RobotParameters::paper(n)).unwrap();
        assert_eq!(
            (
                robot.section_count(),
                robot.coordinate_count(),
                robot.cable_count()
            ),
            (n, 2 * n, 3 * n)
        );
        assert_eq!(robot.sections(), RobotParameters::paper(n).sections);
        assert!((robot.reach_m() - 0.3 * n as f64).abs() < 1e-15);
    }
    let offset_rad = RobotParameters::paper(3).sections[2].cable_offset_rad;
    assert!((offset_rad - 80.0_f64.to_radians()).abs() < 1e-15);
}

#[test]
fn no_section_and_seven_sections_are_refused() {
    for n in [0, SECTIONS_MAX + 1] {
        let error = Robot::new(&RobotParameters::paper(n)).unwrap_err();
        assert_eq!(
            error,
            RobotError::SectionCount {
                key: "sections",
                value: n,
                allowed: 1..=6
            }
        );
    }
}

#[test]
fn every_parameter_is_refused_outside_its_range_and_accepted_at_its_ends() {
    type Set = fn(&mut SectionParameters, f64);
    let keys: [(&str, RangeInclusive<f64>, Set); 6] = [
        ("length_m", ranges::LENGTH_M, |s, x| s.length_m = x),
        ("cable_radius_m", ranges::CABLE_RADIUS_M, |s, x| {
            s.cable_radius_m = x;
        }),
        ("cable_offset_rad", ranges::CABLE_OFFSET_RAD, |s, x| {
            s.cable_offset_rad = x;
        }),
        ("bend_max_rad", ranges::BEND_MAX_RAD, |s, x| {
            s.bend_max_rad = x;
        }),
        ("rate_max_rad_s", ranges::RATE_MAX_RAD_S, |s, x| {
            s.rate_max_rad_s = x;
        }),
        ("body_radius_m", ranges::BODY_RADIUS_M, |s, x| {
            s.body_radius_m = x;
        }),
    ];
    for (key, allowed, set) in keys {
        let mut parameters = RobotParameters::paper(3);
        // Long and thin, so that no end of one range breaks "cable radius below length".
        parameters.sections[1].length_m = 5.0;
        parameters.sections[1].cable_radius_m = 5e-4;
        for end in [*allowed.start(), *allowed.end()] {
            let mut at_end = parameters.clone();
            set(&mut at_end.sections[1], end);
            assert!(
                Robot::new(&at_end).is_ok(),
                "{key} = {end} is the end of its range"
            );
        }
        for value in [
            allowed.start().next_down(),
            allowed.end().next_up(),
            f64::NAN,
            f64::INFINITY,
        ] {
            set(&mut parameters.sections[1], value);
            match Robot::new(&parameters) {
                Err(RobotError::Section {
                    section: 2,
                    key: found,
                    value: reported,
                    allowed: range,
                }) => {
                    assert_eq!((found, range), (key, allowed.clone()));
                    assert_eq!(reported.to_bits(), value.to_bits());
                }
                other => panic!("{key} = {value} gave {other:?}"),
            }
        }
    }
}

#[test]
fn cable_radius_stays_below_length_and_cable_speed_in_its_range() {
    let mut parameters = RobotParameters::paper(2);
    parameters.sections[1].cable_radius_m = 0.3;
    let error = Robot::new(&parameters).unwrap_err();
    let allowed = 1e-4..0.3;
    assert_eq!(
        error,
        RobotError::CableRadius {
            section: 2,
            key: "cable_radius_m",
            value: 0.3,
            allowed
        }
    );
    assert!(
        error.to_string().starts_with(
            "section 2: cable_radius_m = 0.3 is not below the length of the section, length_m = 0.3"
        ),
        "{error}"
    );

    let mut parameters = RobotParameters::paper(2);
    for value in [0.0, 101.0, f64::NAN] {
        parameters.cable_speed_max_m_s = value;
        let error = Robot::new(&parameters).unwrap_err();
        assert!(
            matches!(
                error,
                RobotError::Whole {
                    key: "cable_speed_max_m_s",
                    ..
                }
            ),
            "{error}"
        );
    }
}

/// Recordings and configurations from before the limit describe the same robot.
#[test]
fn without_a_limit_of_the_tip_speed_nothing_is_another() {
    let mut parameters = RobotParameters::paper(3);
    let without = Robot::new(&parameters).unwrap();
    assert_eq!(without.tip_speed_max_m_s(), None);
    assert_eq!(without.fingerprint(), 0x35a2_f12a_651c_d4cd);
    assert_eq!(without.parameters(), parameters);
    let text = serde_json::to_string(&parameters).unwrap();
    let newer = ",\"tip_speed_max_m_s\":0.0,\"self_overlap_max_m\":0.002";
    let older = text.replace(newer, "");
    assert!(older.len() < text.len());
    assert_eq!(
        serde_json::from_str::<RobotParameters>(&older).unwrap(),
        parameters
    );
    for (value, is_valid) in [
        (0.001, true),
        (100.0, true),
        (-0.0, true),
        (0.0009, false),
        (100.1, false),
        (-1.0, false),
        (f64::NAN, false),
        (f64::INFINITY, false),
    ] {
        parameters.tip_speed_max_m_s = value;
        let robot = Robot::new(&parameters);
        assert_eq!(robot.is_ok(), is_valid, "{value}");
        if let Ok(robot) = robot {
            let limit_m_s = robot.tip_speed_max_m_s();
            assert_eq!(limit_m_s, Some(value).filter(|value| *value > 0.0));
            assert_eq!(robot.parameters(), parameters);
        }
    }
}

#[test]
fn fingerprint_is_fnv_1a_and_depends_on_every_bit_of_every_parameter() {
    // The published test vector: FNV-1a-64 of one byte 'a' is af63dc4c8601ec8c.
    assert_eq!(
        (FNV_OFFSET_BASIS ^ 0x61).wrapping_mul(FNV_PRIME),
        0xaf63_dc4c_8601_ec8c
    );
    let paper = RobotParameters::paper(3);
    let of = |parameters: &RobotParameters| Robot::new(parameters).unwrap().fingerprint();
    assert_eq!(of(&paper), of(&paper.clone()));
    let mut seen = vec![of(&paper), of(&RobotParameters::paper(2))];
    for j in 0..3 {
        let fields: [fn(&mut SectionParameters) -> &mut f64; 6] = [
            |s| &mut s.length_m,
            |s| &mut s.cable_radius_m,
            |s| &mut s.cable_offset_rad,
            |s| &mut s.bend_max_rad,
            |s| &mut s.rate_max_rad_s,
            |s| &mut s.body_radius_m,
        ];
        for field in fields {
            let mut changed = paper.clone();
            let value = field(&mut changed.sections[j]);
            *value = value.next_up();
            seen.push(of(&changed));
        }
    }
    let mut changed = paper.clone();
    changed.cable_speed_max_m_s = changed.cable_speed_max_m_s.next_up();
    seen.push(of(&changed));
    for value in [0.1, 0.1_f64.next_up()] {
        seen.push(of(&RobotParameters {
            tip_speed_max_m_s: value,
            ..paper.clone()
        }));
        seen.push(of(&RobotParameters {
            self_overlap_max_m: value,
            ..paper.clone()
        }));
    }
    let count = seen.len();
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen.len(), count);
}

#[test]
fn a_misspelt_key_is_refused() {
    let text = serde_json::to_string(&RobotParameters::paper(1)).unwrap();
    assert_eq!(
        serde_json::from_str::<RobotParameters>(&text).unwrap(),
        RobotParameters::paper(1)
    );
    for wrong in [
        text.replace("length_m", "lenght_m"),
        text.replace("\"sections\"", "\"extra\":1,\"sections\""),
    ] {
        assert!(serde_json::from_str::<RobotParameters>(&wrong).is_err());
    }
}
