//! Ranges, and rules between keys.

use std::path::Path;

use super::error_of;
use crate::config::{Config, keys, ns};
use crate::warnings::warnings;

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
    let message = error_of("[link]\nsimulated_tip = true\n");
    assert!(
        message.contains("line 2: link.simulated_tip: the ideal robot is exactly its model"),
        "{message}"
    );
    for (flaws, part) in [
        ("{ tip_delay = 0.01 }", "there are delay_s, time_constant_s"),
        (
            "{ tip_dropout = 2 }",
            "tip_dropout = 2 is out of range: allowed is 0 to 0.9",
        ),
    ] {
        let text = format!("[link]\nsimulated = \"slow\"\nsimulated_flaws = {flaws}\n");
        let message = error_of(&text);
        let is_at_its_key = message.contains("line 3: link.simulated_flaws");
        assert!(is_at_its_key && message.contains(part), "{message}");
    }
    let message = error_of("[link]\nsimulated = \"slow\"\nsimulated_geometry = [[0.3, 0.01, 0]]\n");
    assert!(
        message.contains("line 3: link.simulated_geometry") && message.contains("the robot has 3"),
        "{message}"
    );
    let message = error_of(
        "[link]\nsimulated = \"slow\"\nsimulated_geometry = [[0.3, 0.01, 0], [0.3, 0.4, 0], [0.3, 0.01, 0]]\n",
    );
    assert!(message.contains("section 2: cable_radius_m"), "{message}");
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
        "[realtime]\nspin_us = -0.5\n",
        "[cycle]\nperiod_ms = 1\n[actuator]\ndelay_ms = 64.1\n",
    ] {
        let message = error_of(text);
        assert!(message.contains("with cycle.period_ms"), "{message}");
    }
    let border = "[cycle]\nperiod_ms = 1\n[actuator]\ndelay_ms = 64.0\n";
    assert!(Config::parse(border, Path::new("robot.toml")).is_ok());
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
    let message = error_of("[obstacles]\nsource_timeout_ms = -0.5\n");
    assert!(
        message.contains("allowed is -1, or at least 0"),
        "{message}"
    );
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
    let warnings = warnings(&validated.config);
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(
        warnings[0].starts_with("cycle.late_start_ms = 1 is longer"),
        "{warnings:?}"
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
            "[controller]\nterminal_weight = 0.0\nhorizon_steps = 1\n",
            "robot.toml, line 2: controller.terminal_weight: terminal_weight = 0 is out",
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
