//! What is good: nothing at all, the default file, and every configuration that we ship.

use std::path::Path;

use cdcr_controller::robot::Configuration;

use crate::config::{Config, DEFAULT_TEXT, Layers, Origin, RealtimeMode, explain};
use crate::warnings::warnings;

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
            let good = Config::load(&entry.path()).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(warnings(&good.config), Vec::<String>::new());
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
    assert_eq!(warnings(&validated.config), Vec::<String>::new());
}

#[test]
fn rates_cost_something_in_every_robot_but_the_ideal_one_unless_told_otherwise() {
    let weight = |text: &str| {
        let validated = Config::parse(text, Path::new("x")).expect("legal");
        f64::from(validated.config.controller.rate_weight)
    };
    for (link, expected) in [
        ("", 0.0),
        ("[link]\nsimulated = \"laboratory\"\n", 1e-10),
        ("[link]\nkind = \"driver\"\n", 1e-10),
    ] {
        assert!(weight(link) == expected, "{link}");
        for set in [0.0, 1e-10, 1e-7] {
            let text = format!("{link}[controller]\nrate_weight = {set}\n");
            assert!(weight(&text) == set, "{text}");
        }
        let auto = format!("{link}[controller]\nrate_weight = \"auto\"\n");
        assert!(weight(&auto) == expected, "{auto}");
    }
    // The default file is where configurations begin.
    let driver = DEFAULT_TEXT.replace("kind = \"simulated\"", "kind = \"driver\"");
    assert!(weight(&driver) == 1e-10);
}

#[test]
fn a_rate_weight_that_nobody_set_is_explained_as_it_is_in_force() {
    let driver = Layers::default().text("[link]\nkind = \"driver\"\n", Path::new("x"));
    let mut layers = driver.unwrap();
    for said in [
        "value     0.0000000001\n  from      default\n",
        "value     0.0\n  from      --set\n",
    ] {
        let settings = layers.clone().settings().unwrap();
        let changed = settings.changed();
        let mut others = changed.iter().filter(|(key, ..)| *key != "link.kind");
        assert!(others.all(|(_, _, origin)| origin == "--set"));
        let explained = explain("controller.rate_weight", &settings).unwrap();
        assert!(explained.contains(said), "{explained}");
        let origin = Origin::Option("--set");
        layers = layers.key("controller.rate_weight", "0.0", origin).unwrap();
    }
}

#[test]
fn a_robot_behind_a_driver_requires_real_time_unless_told_otherwise() {
    let mode = |text: &str| {
        let validated = Config::parse(text, Path::new("x")).expect("legal");
        validated.config.realtime.mode
    };
    let driver = "[link]\nkind = \"driver\"\n";
    assert_eq!(mode(""), RealtimeMode::Prefer);
    assert_eq!(mode(driver), RealtimeMode::Require);
    for (word, expected) in [
        ("prefer", RealtimeMode::Prefer),
        ("off", RealtimeMode::Off),
        ("require", RealtimeMode::Require),
        ("auto", RealtimeMode::Require),
    ] {
        let text = format!("{driver}[realtime]\nmode = \"{word}\"\n");
        assert_eq!(mode(&text), expected, "{word}");
    }
}
