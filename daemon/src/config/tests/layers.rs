//! The layers: default, file, environment, options, and which of them wins.

use std::ffi::OsString;
use std::path::Path;

use crate::config::{Layers, LinkKind, Origin};

fn variables(pairs: &[(&str, &str)]) -> Vec<(OsString, OsString)> {
    let owned = pairs
        .iter()
        .map(|(name, value)| (name.into(), value.into()));
    owned.collect()
}

#[test]
fn an_option_wins_over_the_environment_that_over_the_file_that_over_the_default() {
    let file = |layers: Layers| {
        let text = "[cycle]\nmiss_limit = 7\nperiod_ms = 2.0\n";
        layers.text(text, Path::new("robot.toml")).unwrap()
    };
    let environment = |layers: Layers| {
        let pairs = [
            ("CDCR_CYCLE_PERIOD_MS", "3"),
            ("HOME", "/"),
            ("CDCR_CYCLE_MISS_LIMIT", ""),
        ];
        let (layers, warnings) = layers.variables(variables(&pairs)).unwrap();
        assert_eq!(warnings, Vec::<String>::new());
        layers
    };
    let option = |layers: Layers| {
        let origin = Origin::Option("--set");
        layers.key("cycle.period_ms", "4.0", origin).unwrap()
    };
    let of = |layers: Layers| {
        let settings = layers.settings().unwrap();
        let origin = settings.origins.of("cycle.period_ms").to_string();
        let validated = settings.validate().unwrap();
        (validated.config.cycle.period_ms, origin)
    };
    let start = Layers::default;
    assert_eq!(of(start()), (5.0, "default".to_owned()));
    assert_eq!(of(file(start())), (2.0, "robot.toml, line 3".to_owned()));
    let layers = environment(file(start()));
    assert_eq!(of(layers), (3.0, "CDCR_CYCLE_PERIOD_MS".to_owned()));
    let layers = option(environment(file(start())));
    assert_eq!(of(layers.clone()), (4.0, "--set".to_owned()));
    let changed = layers.settings().unwrap().changed();
    let line = |key, value: &str, origin: &str| (key, value.to_owned(), origin.to_owned());
    assert_eq!(
        changed,
        [
            line("cycle.miss_limit", "7", "robot.toml, line 2"),
            line("cycle.period_ms", "4.0", "--set"),
        ]
    );
}

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

#[test]
fn variables_of_others_are_left_alone_and_a_misspelt_one_is_a_warning() {
    let pairs = [
        ("CDCR_TEST_SECONDS", "1"),
        ("CDCR_SOAK_RATE", "1"),
        ("CDCR_CYCLE_PERIOD", "2"),
    ];
    let (layers, warnings) = Layers::default().variables(variables(&pairs)).unwrap();
    assert_eq!(
        warnings,
        ["CDCR_CYCLE_PERIOD sets nothing: did you mean CDCR_CYCLE_PERIOD_MS?"]
    );
    let untouched = Layers::default().settings().unwrap().config;
    assert_eq!(layers.settings().unwrap().config, untouched);
}
