//! Texts with a mistake: each is named with its file, its line and its key, and none is a panic.

use std::path::Path;

use cdcr_scratch::Scratch;
use rustix::fs::{CWD, Mode, mkfifoat};

use super::error_of;
use crate::config::{Config, Layers, Origin};

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
fn a_value_of_a_list_is_named_with_its_index_and_its_line() {
    for (text, start) in [
        (
            "[link]\ninitial_bend_rad = [\n [0, 0],\n [0, \"y\"],\n]\n",
            "robot.toml, line 4: link.initial_bend_rad[1][1]: invalid type: string \"y\", expected a number",
        ),
        (
            "[link]\ninitial_bend_rad = [\n [0, 0],\n [0, 9],\n [0, 0],\n]\n",
            "robot.toml, line 4: link.initial_bend_rad[1]: section 2: a bend of 9 rad is out of range",
        ),
        (
            "robot.sections = [\n { length_m = true },\n]\n",
            "robot.toml, line 2: robot.sections[0].length_m: invalid type: boolean",
        ),
        (
            "[[robot.sections]]\nlength_m = 'a'\n",
            "robot.toml, line 2: robot.sections[0].length_m: invalid type: string \"a\"",
        ),
        (
            "[cycle]\nperiod_ms = 'a'\n",
            "robot.toml, line 2: cycle.period_ms: invalid type: string \"a\", expected a number",
        ),
        (
            "cycle = 1\n",
            "robot.toml, line 1: cycle: invalid type: integer `1`, expected a table",
        ),
    ] {
        let message = error_of(text);
        assert!(message.starts_with(start), "{message}");
    }
}

#[test]
fn infinity_and_nan_are_called_what_they_are() {
    let sections = "robot.sections = [{ length_m = -inf, cable_radius_m = 0.01, cable_offset_rad = 0, \
                    bend_max_rad = 1, rate_max_rad_s = 1, body_radius_m = 0 }]";
    for (text, part) in [
        (
            "cycle.period_ms = inf",
            "cycle.period_ms: inf is out of range",
        ),
        (
            "cycle.period_ms = nan",
            "cycle.period_ms: NaN is out of range",
        ),
        (sections, "robot.sections[0].length_m: -inf is out of range"),
        (
            "link.initial_bend_rad = [[0, 0], [0, inf], [0, 0]]",
            "link.initial_bend_rad[1]: section 2: a bend of inf rad is out of range",
        ),
    ] {
        let message = error_of(text);
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn an_error_quotes_no_more_than_a_line_however_long_the_value_is() {
    let long = "a".repeat(400_000);
    for text in [
        format!("robot.name = \"{long}\""),
        format!("transport.prefix = \"{long}\""),
        format!("transport.root = \"/{long}\""),
        format!("link.kind = \"{long}\""),
        format!("cycle.period_ms = \"{long}\""),
        format!("cycle.period_ms = {long}"),
        format!("cycle.{long} = 1"),
        format!("{long} = 1"),
        format!("[cycle]\n= {long}"),
    ] {
        let message = error_of(&text);
        assert!(message.starts_with("robot.toml"), "{message}");
        assert!(message.len() < 500, "{} bytes", message.len());
        let layer = text.split_once(" = ").and_then(|(key, value)| {
            let origin = Origin::Option("--set");
            Layers::default().key(key, value, origin).err()
        });
        if let Some(error) = layer {
            assert!(error.to_string().len() < 500);
        }
    }
    let message = error_of(&format!("robot.name = \"{long}\""));
    assert!(
        message.ends_with("letters, digits, '-' and '_'"),
        "{message}"
    );
}

#[test]
fn what_is_no_file_or_too_large_a_one_is_refused_at_once() {
    let folder = Scratch::temporary().unwrap();
    let (large, pipe) = (folder.path().join("large"), folder.path().join("pipe"));
    std::fs::write(&large, " ".repeat((1 << 20) + 1)).unwrap();
    mkfifoat(CWD, &pipe, Mode::from_raw_mode(0o600)).unwrap();
    for (path, words) in [
        (Path::new("/dev/zero"), "it is not a file"),
        (folder.path(), "it is not a file"),
        (&pipe, "it is not a file"),
        (&large, "it is larger than 1 MiB"),
    ] {
        let message = Config::load(path).expect_err("refused").to_string();
        assert!(message.ends_with(words), "{message}");
    }
    std::fs::write(&large, " ".repeat(1 << 20)).unwrap();
    assert!(Config::load(&large).is_ok());
    let missing = Config::load(&folder.path().join("missing")).expect_err("it is missing");
    assert!(
        missing.to_string().contains("`cdcrd config default > "),
        "{missing}"
    );
}

#[test]
fn the_root_of_the_file_system_is_no_root_folder() {
    for root in ["/", "//", "/.", "/..", "/tmp/..", "/a/../../"] {
        let message = error_of(&format!("transport.root = \"{root}\""));
        for part in ["transport.root", "not / itself"] {
            assert!(message.contains(part), "{message}");
        }
    }
}

#[test]
fn a_group_is_one_of_the_system_or_a_number() {
    let group_id = |group: &str| {
        let text = format!("[transport]\ngroup = \"{group}\"\n");
        Config::parse(&text, Path::new("robot.toml")).map(|validated| validated.group_id)
    };
    assert_eq!(group_id("").unwrap(), None);
    assert_eq!(group_id("1001").unwrap(), Some(1001));
    let message = group_id("no such group").unwrap_err().to_string();
    for part in [
        "robot.toml, line 2: transport.group: ",
        "\"no such group\"",
        "getent group",
    ] {
        assert!(message.contains(part), "{message}");
    }
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
