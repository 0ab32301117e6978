//! Texts with a mistake: each is named with its file, its line and its key, and none is a panic.

use std::path::Path;

use cdcr_scratch::Scratch;
use rustix::fs::{CWD, Mode, mkfifoat};

use super::error_of;
use crate::config::{Config, Layers, Origin};

#[test]
fn an_error_quotes_no_more_than_a_line_however_long_the_value_is() {
    let long = "a".repeat(40_000);
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
