//! Ranges, and rules between keys.

use std::path::Path;

use super::error_of;
use crate::config::{Config, keys, ns};

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
    for (key, parameter) in keys::all() {
        let Some(range) = &parameter.range else {
            continue;
        };
        let (low, high) = (*range.start(), *range.end());
        let is_whole = keys::settable()
            .get(key)
            .is_some_and(toml::Value::is_integer);
        let (below, above) = if is_whole {
            (low - 1.0, high + 1.0)
        } else {
            (low.next_down(), high.next_up())
        };
        for value in [below, above] {
            let message = error_of(&with(key, value));
            assert!(
                message.contains(parameter.name) && message.contains("line"),
                "{message}"
            );
        }
        for value in [low, high] {
            let result = Config::parse(&with(key, value), Path::new("x"));
            let is_good = result.is_ok() || parameter.also.is_some();
            assert!(is_good, "{key} = {value}: {:?}", result.err());
        }
    }
}

#[test]
fn a_timeout_of_sources_that_nobody_set_is_that_of_the_kind_of_robot() {
    let timeout_ms = |text: &str| {
        let validated = Config::parse(text, Path::new("robot.toml")).unwrap();
        validated.config.obstacles.source_timeout_ms
    };
    let driver = "[link]\nkind = \"driver\"\n";
    assert_eq!(timeout_ms(""), 0.0);
    assert_eq!(timeout_ms(driver), 500.0);
    for set_ms in [0.0, 20.0] {
        let set = format!("{driver}[obstacles]\nsource_timeout_ms = {set_ms:?}\n");
        assert_eq!(timeout_ms(&set), set_ms);
    }
}

#[test]
fn the_shortest_period_has_times_of_its_own() {
    let text = "[cycle]\nperiod_ms = 0.1\ngather_lead_ms = 0.04\n";
    let validated = Config::parse(text, Path::new("robot.toml")).unwrap();
    let cycle = &validated.config.cycle;
    assert_eq!(ns(cycle.period_ms), 100_000);
    assert_eq!(
        (cycle.deadline_ns(), cycle.budget_margin_ns()),
        (100_000, 40_000)
    );
}
