#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

use std::ffi::OsString;

use super::*;

fn error_of(text: &str) -> String {
    Config::parse(text, Path::new("robot.toml"))
        .expect_err("it is wrong")
        .to_string()
}

#[test]
fn the_default_file_is_the_default_and_every_key_is_in_it() {
    let from_text: Config = toml::from_str(DEFAULT_TEXT).expect("the default file is TOML");
    assert_eq!(from_text, Config::default());
    let default = toml::Table::try_from(Config::default()).expect("serialises");
    let written: toml::Table = toml::from_str(DEFAULT_TEXT).expect("the default file is TOML");
    for (table, keys) in &default {
        for key in keys.as_table().expect("a table").keys() {
            assert!(
                written[table].get(key).is_some(),
                "{table}.{key} is not in default.toml"
            );
        }
    }
}

#[test]
fn every_configuration_that_we_ship_is_good() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        if entry
            .path()
            .extension()
            .is_some_and(|extension| extension == "toml")
        {
            Config::load(&entry.path()).unwrap_or_else(|error| panic!("{error}"));
            count += 1;
        }
    }
    assert!(count >= 4, "{count} configurations");
}

#[test]
fn an_empty_file_is_the_papers_robot() {
    let validated = Config::parse("", Path::new("x")).expect("empty is legal");
    assert_eq!(validated.robot.section_count(), 3);
    assert_eq!(validated.initial, Configuration::straight(3));
}

#[test]
fn unknown_keys_and_bad_values_are_named_with_file_and_line() {
    assert_eq!(
        error_of("[cycle]\nperiodms = 5\n"),
        "robot.toml, line 2: unknown key cycle.periodms: did you mean cycle.period_ms?"
    );
    assert_eq!(
        error_of("link.kind = \"simulated\"\nlink.colour = 7\n"),
        "robot.toml, line 2: unknown key link.colour: `cdcrd config default` shows every key"
    );

    let message = error_of("# comment\n[cycle]\nperiod_ms = 0.05\n");
    for part in [
        "robot.toml",
        "line 3",
        "cycle.period_ms",
        "0.05",
        "0.1 to 100",
    ] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let message = error_of("[controller]\nseed = 1\nswarm_size = 9999\n");
    for part in ["line 3", "controller.swarm_size", "1 to 512"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    for (text, parts) in [
        (
            "[robot]\ncable_stroke_max_m = 0.0\n",
            ["line 2", "robot.cable_stroke_max_m", "0.0001"],
        ),
        (
            "[controller]\nsafe_distance_m = -0.1\n",
            ["line 2", "controller.safe_distance_m", "0 to 10"],
        ),
        (
            "[controller]\norientation_tolerance_rad = 2.0\n",
            ["line 2", "controller.orientation_tolerance_rad", "0 to 1"],
        ),
        (
            "[controller]\nobstacle_slope_penalty = 0.0\n",
            [
                "line 2",
                "controller.obstacle_slope_penalty",
                "allowed is 1 to 1000000000000",
            ],
        ),
        (
            "[controller]\ncoordinates = \"polar\"\n",
            ["line 2", "polar", "bend-angles"],
        ),
    ] {
        let message = error_of(text);
        for part in parts {
            assert!(message.contains(part), "{part}: {message}");
        }
    }
    let message = error_of("[motion]\nhome_rate_rad_s = nan\n");
    assert!(
        message.contains("line 2") && message.contains("home_rate_rad_s"),
        "{message}"
    );
}

#[test]
fn section_errors_name_the_section_and_its_line() {
    let good = "[[robot.sections]]\nlength_m = 0.3\ncable_radius_m = 0.01\ncable_offset_rad = 0.0\n\
                bend_max_rad = 2.8\nrate_max_rad_s = 2.0\nbody_radius_m = 0.015\n";
    assert!(Config::parse(good, Path::new("x")).is_ok());
    let message = error_of(&format!("{good}{}", good.replace("0.3", "-0.3")));
    for part in ["line 9", "robot.sections[1].length_m", "-0.3"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let message = error_of("[[robot.sections]]\nlength_m = 0.3\n");
    assert!(message.contains("missing field"), "{message}");
}

#[test]
fn rules_between_keys() {
    let message = error_of("[realtime]\nexchange_priority = 80\n");
    assert!(message.contains("below cycle_priority"), "{message}");
    let message = error_of("[link]\ninitial_bend_rad = [[0.1, 0.0]]\n");
    assert!(
        message.contains("1 pairs are given, but the robot has 3"),
        "{message}"
    );
    let message = error_of("[link]\ninitial_bend_rad = [[0.1, 0.0], [9.0, 0.0], [0.0, 0.0]]\n");
    assert!(message.contains("section 2"), "{message}");
    let message = error_of("[transport]\nprefix = \"a b\"\n");
    assert!(message.contains("line 2: transport.prefix"), "{message}");
    let message = error_of("[realtime]\ncycle_priority = 60\n");
    assert!(
        message.contains("line 2: realtime.cycle_priority"),
        "{message}"
    );
    let message = error_of("[controller]\nswarm_size = -1\n");
    assert!(
        message.contains("swarm_size") && message.contains("whole number"),
        "{message}"
    );
    assert!(error_of("robot = 3\n").contains("expected a table"));
    assert!(error_of("[robot]\nname = \"a/b\"\n").contains("robot.name"));
}

#[test]
fn an_unknown_key_is_found_wherever_it_stands() {
    for (text, start) in [
        (
            "[motion]\n[[cycl]]\n",
            "robot.toml, line 2: unknown key cycl: ",
        ),
        (
            "period_ms = 5\n[cycle]\n",
            "robot.toml, line 1: unknown key period_ms: ",
        ),
        (
            "cycle = { perod_ms = 5 }\n",
            "robot.toml, line 1: unknown key cycle.perod_ms: ",
        ),
        (
            "\ncycle.perod_ms = 5\n",
            "robot.toml, line 2: unknown key cycle.perod_ms: ",
        ),
        (
            "[[robot.sections]]\n[[robot.sections]]\nlenght_m = 1\n",
            "robot.toml, line 3: unknown key robot.sections[1].lenght_m: did you mean \
             robot.sections.length_m?",
        ),
        (
            "[robot]\nsections = [\n  { body_radius = 1 },\n]\n",
            "robot.toml, line 3: unknown key robot.sections[0].body_radius: did you mean \
             robot.sections.body_radius_m?",
        ),
        (
            "[transport]\nz = 1\n[cycle]\na = 1\n",
            "robot.toml, line 2: unknown key transport.z: ",
        ),
    ] {
        let message = error_of(text);
        assert!(message.starts_with(start), "{message}");
    }
}

#[test]
fn every_number_is_refused_just_outside_its_range() {
    let section = "length_m = 5.0\ncable_radius_m = 0.01\ncable_offset_rad = 0.0\nbend_max_rad = 2.8\n\
                   rate_max_rad_s = 2.0\nbody_radius_m = 0.015\n";
    let with = |key: &str, value: f64| match key.strip_prefix("robot.sections.") {
        Some(name) => {
            let others = section.lines().filter(|line| !line.starts_with(name));
            let others: Vec<&str> = others.collect();
            format!(
                "[[robot.sections]]\n{}\n{name} = {value:?}\n",
                others.join("\n")
            )
        }
        None if keys::settable()[key].is_integer() => format!("{key} = {value}\n"),
        None => format!("{key} = {value:?}\n"),
    };
    for range in &ranges::RANGES {
        let is_whole = keys::settable()
            .get(range.key)
            .is_some_and(toml::Value::is_integer);
        let (below, above) = if is_whole {
            (range.low - 1.0, range.high + 1.0)
        } else {
            (range.low.next_down(), range.high.next_up())
        };
        for value in [below, above] {
            let message = error_of(&with(range.key, value));
            let name = range.key.rsplit('.').next().unwrap();
            assert!(
                message.contains(name) && message.contains("line"),
                "{message}"
            );
        }
        for value in [range.low, range.high] {
            let result = Config::parse(&with(range.key, value), Path::new("x"));
            let is_good = result.is_ok() || range.also.is_some();
            assert!(is_good, "{} = {value}: {:?}", range.key, result.err());
        }
    }
}

#[test]
fn the_period_bounds_other_times_and_the_key_that_was_set_is_the_place() {
    let message = error_of("[cycle]\nperiod_ms = 2.0\ngather_lead_ms = 1.5\n");
    assert_eq!(
        message,
        "robot.toml, line 3: cycle.gather_lead_ms: gather_lead_ms = 1.5 is out of range: with cycle.period_ms = 2, allowed \
         is at most 1"
    );
    for text in [
        "[cycle]\ndeadline_ms = 5.1\n",
        "[cycle]\nbudget_ms = 5.1\n",
        "[cycle]\nbudget_margin_ms = 2.6\n",
        "[cycle]\nperiod_ms = 50\nwatchdog_ms = 400\n",
        "[cycle]\nperiod_ms = 1\n[realtime]\nspin_us = 501\n",
    ] {
        let message = error_of(text);
        assert!(message.contains("with cycle.period_ms"), "{message}");
    }
}

#[test]
fn the_shortest_period_needs_a_shorter_gather_lead() {
    let message = error_of("[cycle]\nperiod_ms = 0.1\n");
    assert_eq!(
        message,
        "robot.toml, line 2: cycle.period_ms: gather_lead_ms = 0.2 is out of range: with cycle.period_ms = 0.1, allowed is \
         at most 0.05"
    );
    let text = "[cycle]\nperiod_ms = 0.1\ngather_lead_ms = 0.04\n";
    let validated = Config::parse(text, Path::new("robot.toml")).unwrap();
    let cycle = &validated.config.cycle;
    assert_eq!(ns(cycle.period_ms), 100_000);
    assert_eq!(
        (cycle.deadline_ns(), cycle.budget_margin_ns()),
        (100_000, 40_000)
    );
    let doubts = doubts(&validated.config);
    assert_eq!(doubts.len(), 1, "{doubts:?}");
    assert!(
        doubts[0].starts_with("cycle.late_start_ms = 1 is longer"),
        "{doubts:?}"
    );
}

#[test]
fn a_default_that_another_key_forbids_is_reported_where_that_key_stands() {
    for (text, start) in [
        (
            "[controller]\nobstacle_step_penalty = 1e12\n",
            "robot.toml, line 2: controller.obstacle_step_penalty: obstacle_slope_penalty = 10000 is out",
        ),
        (
            "[cycle]\ngather_lead_ms = 0.3\nperiod_ms = 0.5\n",
            "robot.toml, line 2: cycle.gather_lead_ms: gather_lead_ms = 0.3 is out",
        ),
        (
            "[realtime]\ncycle_priority = 60\n",
            "robot.toml, line 2: realtime.cycle_priority: exchange_priority = 70 must be below",
        ),
    ] {
        let message = error_of(text);
        assert!(message.starts_with(start), "{message}");
    }
}

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

    for (key, text, message) in [
        (
            "cycle.period",
            "1",
            "--set: unknown key cycle.period: did you mean cycle.period_ms?",
        ),
        (
            "cycle.period_ms",
            "fast",
            "--set: cycle.period_ms: \"fast\" is no TOML value: expected one like 5.0",
        ),
        ("cycle.period_ms", "1\n[link]", "--set: cycle.period_ms: "),
        (
            "cycle.period_ms",
            "'1'",
            "--set: cycle.period_ms: invalid type: string \"1\", expected a number",
        ),
        (
            "cycle.miss_limit",
            "1.5",
            "--set: cycle.miss_limit: invalid type: floating point `1.5`, expected a whole number",
        ),
        (
            "cycle.miss_limit",
            "-1",
            "--set: cycle.miss_limit: invalid value: integer `-1`, expected a whole number",
        ),
        (
            "link.kind",
            "real",
            "--set: link.kind: unknown variant `real`, expected `simulated` or `driver`",
        ),
        (
            "cycle",
            "{}",
            "--set: cycle: it is a table: set its keys one by one",
        ),
        (
            "robot.sections",
            "[{ length = 1 }]",
            "--set: unknown key robot.sections[0].length: did you mean",
        ),
        (
            "robot.sections[0].length_m",
            "1",
            "--set: robot.sections[0].length_m: robot.sections is set as a whole",
        ),
        ("robot.name", "'", "--set: robot.name: "),
    ] {
        let error = config(key, text).expect_err(text).to_string();
        assert!(error.starts_with(message), "{error}");
    }
}

#[test]
fn values_out_of_range_name_the_option_or_the_variable() {
    let pairs = [("CDCR_CYCLE_PERIOD_MS", "0.05")];
    let (layers, _) = Layers::default().variables(variables(&pairs)).unwrap();
    let error = layers
        .settings()
        .unwrap()
        .validate()
        .unwrap_err()
        .to_string();
    assert_eq!(
        error,
        "CDCR_CYCLE_PERIOD_MS: cycle.period_ms: 0.05 is out of range: allowed is 0.1 to 100"
    );
    let text = "[cycle]\ngather_lead_ms = 1.0\n";
    let layers = Layers::default()
        .text(text, Path::new("robot.toml"))
        .unwrap();
    let layers = layers
        .key("cycle.period_ms", "0.5", Origin::Option("--set"))
        .unwrap();
    let error = layers
        .settings()
        .unwrap()
        .validate()
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("robot.toml, line 2: cycle.gather_lead_ms"),
        "{error}"
    );
    let sections = "[{ length_m = 99, cable_radius_m = 0.01, cable_offset_rad = 0, bend_max_rad = 1, \
                    rate_max_rad_s = 1, body_radius_m = 0 }]";
    let layers = Layers::default().key("robot.sections", sections, Origin::Option("--set"));
    let error = layers
        .unwrap()
        .settings()
        .unwrap()
        .validate()
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("--set: robot.sections[0].length_m: 99"),
        "{error}"
    );
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
    assert_eq!(layers.settings().unwrap().config, Config::default());
    let pairs = [("CDCR_CYCLE_PERIOD_MS", "two")];
    let error = Layers::default().variables(variables(&pairs)).unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with("CDCR_CYCLE_PERIOD_MS: cycle.period_ms: \"two\"")
    );
}

#[test]
fn an_explanation_says_what_a_key_is_and_where_its_value_comes_from() {
    let text = "[cycle]\nperiod_ms = 2.0\n";
    let layers = Layers::default()
        .text(text, Path::new("robot.toml"))
        .unwrap();
    let settings = layers.settings().unwrap();
    assert_eq!(
        explain("cycle.period_ms", &settings).unwrap(),
        "cycle.period_ms\n  Period of the loop, 0.1 to 100 ms, and at least twice gather_lead_ms.\n  type      number\n  \
         range     0.1 to 100 ms, at least twice cycle.gather_lead_ms\n  default   5.0\n  value     2.0\n  from      robot.toml, line 2\n  variable  \
         CDCR_CYCLE_PERIOD_MS\n"
    );
    let table = explain("cycle", &settings).unwrap();
    for (name, _) in toml::Table::try_from(CycleConfig::default()).unwrap() {
        assert!(
            table.contains(&format!("\ncycle.{name}\n")),
            "{name}: {table}"
        );
    }
    let section = explain("robot.sections[1].length_m", &settings).unwrap();
    assert!(
        section.contains("value     0.3, 0.3, 0.3 (base first)"),
        "{section}"
    );
    let kind = explain("link.kind", &settings).unwrap();
    assert!(kind.contains("\"driver\": A driver process"), "{kind}");
    let error = explain("cycle.perod_ms", &settings)
        .unwrap_err()
        .to_string();
    assert_eq!(
        error,
        "unknown key cycle.perod_ms: did you mean cycle.period_ms?"
    );
}

#[test]
fn no_text_makes_the_parser_panic() {
    for text in [
        "\u{feff}",
        "\0",
        "=",
        "[",
        "[[",
        "a.b.c.d = 1",
        "robot = []",
        "robot.sections = 1",
        "\"\" = 1",
        "robot.sections = [1, {}]",
        "[robot.sections]",
        "[cycle.period_ms]",
        "[[cycle.period_ms]]",
        "[[cycle]]",
        "\"a.b[\" = 1",
        "[robot]\n\"sections[9]\" = 1",
        "cycle.'period_ms' = 1979-05-27",
        "controller.seed = 9223372036854775807",
        "controller.seed = -1",
        "[π]\nß = 'é'",
        "cycle.period_ms = inf",
        "link.initial_bend_rad = [[nan, nan], [nan, nan], [nan, nan]]",
        "# expected struct\n# expected struct é\nrobot = 1",
        "robot.sections = []",
    ] {
        if let Err(error) = Config::parse(text, Path::new("x")) {
            assert!(error.to_string().len() > 5);
        }
    }
}
