//! What one layer sets. Which layer wins: `daemon/tests/suite/command_line.rs`.

use crate::config::{Layers, LinkKind, Origin};

#[test]
fn what_is_set_by_an_option_is_toml_and_a_bare_word_is_a_string() {
    let config = |key: &str, text: &str| {
        let layers = Layers::default().key(key, text, Origin::Option("--set"));
        layers
            .and_then(Layers::settings)
            .map(|settings| settings.config)
    };
    assert_eq!(config("robot.name", "trunk").unwrap().robot.name, "trunk");
    assert_eq!(config("robot.name", "007").unwrap().robot.name, "007");
    assert_eq!(
        config("robot.name", "\"a\\u0062\"").unwrap().robot.name,
        "ab"
    );
    assert_eq!(
        config("link.kind", "driver").unwrap().link.kind,
        LinkKind::Driver
    );
    assert_eq!(
        config("cycle.miss_limit", " 7 ").unwrap().cycle.miss_limit,
        7
    );
    assert!(
        !config("realtime.no_deep_sleep", "false")
            .unwrap()
            .realtime
            .no_deep_sleep
    );
    let bends = config("link.initial_bend_rad", "[[0, 1], [0.5, 0]]").unwrap();
    assert_eq!(bends.link.initial_bend_rad, [[0.0, 1.0], [0.5, 0.0]]);
    let sections = "[{ length_m = 1, cable_radius_m = 0.01, cable_offset_rad = 0, bend_max_rad = 1, \
                    rate_max_rad_s = 1, body_radius_m = 0 }]";
    let robot = config("robot.sections", sections).unwrap().robot;
    assert_eq!((robot.sections.len(), robot.sections[0].length_m), (1, 1.0));
}
