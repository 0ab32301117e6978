//! Texts, variables and options that form a configuration, and the messages of invalid ones. Precedence of
//! the layers: `daemon/tests/suite/command_line.rs`.

mod generated;

use std::path::Path;

use cdcr_controller::robot::Configuration;
use cdcr_scratch::Scratch;
use rustix::fs::{CWD, Mode, mkfifoat};

use super::{Config, ConfigDraft, ConfigError, DEFAULT_TEXT, Layers, explain, keys, ns};
use crate::warnings::warnings;

/// The configuration of a case in `messages.txt` with the warnings about its variables, or its error.
fn settings(case: &[&str]) -> Result<(ConfigDraft, Vec<String>), ConfigError> {
    let is_layer = |line: &&str| line.starts_with("--set ") || line.starts_with("CDCR_");
    let (set, file): (Vec<&str>, Vec<&str>) = case.iter().partition(|line| is_layer(line));
    let mut layers = Layers::default().text(&file.join("\n"), Path::new("robot.toml"))?;
    let mut warnings = Vec::new();
    for (key, value) in set.iter().filter_map(|line| line.split_once('=')) {
        if let Some(key) = key.strip_prefix("--set ") {
            layers = layers.key(key, &value.replace("\\n", "\n"), "--set")?;
        } else {
            (layers, warnings) = layers.variables([(key.into(), value.into())])?;
        }
    }
    Ok((layers.settings()?, warnings))
}

/// Asserts one line of `messages.txt` for a case.
fn assert_is(case: &[&str], mark: &str, words: &str) {
    let one_line = |text: String| text.replace('\n', "\\n");
    let checked =
        settings(case).and_then(|(draft, warned)| Ok((draft.clone(), draft.validate()?, warned)));
    match (checked, mark) {
        (Ok((draft, ..)), "?") => {
            let (key, part) = words.split_once(" | ").unwrap();
            let text = explain(key, &draft).unwrap_or_else(|error| error.to_string());
            assert!(one_line(text.clone()).contains(part), "{text}");
        }
        (Ok((_, validated, warned)), "~" | "ok") => {
            let all = [warned, warnings(&validated.config)].concat();
            assert_eq!(all.len(), usize::from(mark == "~"), "{all:?}");
            assert!(all.concat().contains(words), "{all:?}");
        }
        (Ok((_, validated, _)), ">") => {
            let expected: toml::Table = words.parse().unwrap();
            let (key, _) = words.split_once(" = ").unwrap();
            let values = keys::values(&validated.config);
            assert_eq!(keys::value(&values, key), keys::value(&expected, key));
        }
        (Err(error), "=") => assert_eq!(one_line(error.to_string()), words),
        (result, _) => panic!("{result:?}"),
    }
}

#[test]
fn each_configuration_gets_its_message() {
    let (mut case, mut is_over) = (Vec::new(), true);
    for (number, line) in (1..).zip(include_str!("messages.txt").lines()) {
        let (mark, words) = line.split_once(' ').unwrap_or((line, ""));
        let is_mark = ["=", "~", ">", "?", "ok"].contains(&mark);
        if is_mark {
            eprintln!("messages.txt, line {number}: {line}");
            assert_is(&case, mark, words);
        } else if mark == "##" || is_over {
            case.clear();
        }
        let is_between = mark == "##" || line.is_empty() && case.is_empty();
        if !is_mark && !is_between {
            case.push(line);
        }
        is_over = is_mark;
    }
}

#[test]
fn nothing_the_default_file_and_every_configuration_that_we_ship_are_good() {
    let from_text: Config = toml::from_str(DEFAULT_TEXT).unwrap();
    assert_eq!(from_text, Config::default());
    let validated = Config::parse("", Path::new("x")).unwrap();
    assert_eq!(validated.initial, Configuration::straight(3));
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    let files = std::fs::read_dir(folder).unwrap();
    let mut files: Vec<_> = files.map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|end| end == "toml"));
    assert!(files.len() >= 4, "{files:?}");
    for file in files {
        let good = Config::load(&file).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(warnings(&good.config), Vec::<String>::new());
    }
}

#[test]
fn the_printed_default_sets_nothing_not_even_for_another_robot() {
    let mut lines: Vec<_> = DEFAULT_TEXT.lines().collect();
    assert_eq!(settings(&lines).unwrap().0.changed(), []);
    let kind = lines.iter().position(|line| line.starts_with("kind = "));
    lines[kind.unwrap()] = "kind = \"driver\"";
    let place = format!("robot.toml, line {}", kind.unwrap() + 1);
    let changed = [("link.kind", "\"driver\"".to_owned(), place)];
    assert_eq!(settings(&lines).unwrap().0.changed(), changed);
}

#[test]
fn an_error_quotes_no_more_than_a_line_however_long_the_value_is() {
    let long = "a".repeat(40_000);
    let name = "letters, digits, '-' and '_'";
    let comma = "; numbers have a decimal point: 0.25, not 0,25";
    for (text, start, end) in [
        (format!("robot.name = \"{long}\""), ", line 1: robot.", name),
        (format!("transport.prefix = \"{long}\""), "", name),
        (format!("transport.root = \"/{long}\""), "", ""),
        (format!("link.kind = \"{long}\""), "", ""),
        (format!("cycle.period_ms = \"{long}\""), "", ""),
        (format!("cycle.period_ms = {long}"), "", ""),
        (format!("cycle.{long} = 1"), "", ""),
        (format!("{long} = 1"), "", ""),
        (format!("[cycle]\n= {long}"), "", ""),
        (format!("\nlink.kind = 0,25 # é{long}"), ": line 2: ", comma),
    ] {
        let error = Config::parse(&text, Path::new("robot.toml")).expect_err("it is wrong");
        let message = error.to_string();
        let start = format!("robot.toml{start}");
        let is_whole = message.starts_with(&start) && message.ends_with(end);
        assert!(is_whole && message.len() < 500, "{message}");
        let (key, value) = text.split_once(" = ").unwrap_or_default();
        if let Err(error) = Layers::default().key(key, value, "--set") {
            assert!(error.to_string().len() < 500);
        }
    }
}

#[test]
fn what_is_no_file_or_too_large_a_one_is_refused_at_once() {
    let folder = Scratch::temporary().unwrap();
    let [large, pipe, missing, latin] =
        ["large", "pipe", "missing", "latin"].map(|name| folder.path().join(name));
    std::fs::write(&latin, b"# \xe4\n").unwrap();
    std::fs::write(&large, " ".repeat((1 << 20) + 1)).unwrap();
    mkfifoat(CWD, &pipe, Mode::from_raw_mode(0o600)).unwrap();
    for (path, words) in [
        (Path::new("/dev/zero"), "it is not a file"),
        (folder.path(), "it is not a file"),
        (&pipe, "it is not a file"),
        (&large, "it is larger than 1 MiB"),
        (&missing, "missing` creates one"),
        (&latin, "it is not UTF-8 text: save it with this encoding"),
    ] {
        let message = Config::load(path).expect_err("refused").to_string();
        assert!(message.ends_with(words), "{message}");
    }
    std::fs::write(&large, " ".repeat(1 << 20)).unwrap();
    assert!(Config::load(&large).is_ok());
}

#[test]
fn no_text_makes_the_parser_panic() {
    let texts = "\u{feff}¦\0¦=¦[¦[[¦a.b.c.d = 1¦robot = []¦robot.sections = 1¦\"\" = 1¦robot.sections = [1, {}]¦\
        [robot.sections]¦[cycle.period_ms]¦[[cycle.period_ms]]¦[[cycle]]¦\"a.b[\" = 1¦[robot]\n\"sections[9]\" = 1¦\
        cycle.'period_ms' = 1979-05-27¦controller.seed = 9223372036854775807¦controller.seed = -1¦[π]\nß = 'é'¦\
        cycle.period_ms = inf¦link.initial_bend_rad = [[nan, nan], [nan, nan], [nan, nan]]¦\
        # expected struct\n# expected struct é\nrobot = 1¦robot.sections = []";
    for text in texts.split('¦') {
        if let Err(error) = Config::parse(text, Path::new("x")) {
            assert!(error.to_string().len() > 5);
        }
    }
}

#[test]
fn every_number_is_refused_just_outside_its_range() {
    for key in keys::ALL.iter() {
        let Some(range) = &key.parameter.range else {
            continue;
        };
        let (table, name) = key.name.rsplit_once('.').unwrap();
        let is_whole = key.default.as_ref().is_some_and(toml::Value::is_integer);
        let result = |value: f64| {
            let mut values = keys::values(&Config::default());
            let place = match table {
                "robot.sections" => &mut values["robot"]["sections"][0][name],
                _ => &mut values[table][name],
            };
            let whole = is_whole.then_some(value as i64);
            *place = whole.map_or(value.into(), toml::Value::from);
            Config::parse(&values.to_string(), Path::new("robot.toml"))
        };
        let outward: [fn(f64) -> f64; 2] = if is_whole {
            [|low| low - 1.0, |high| high + 1.0]
        } else {
            [f64::next_down, f64::next_up]
        };
        for (limit, outward) in [*range.start(), *range.end()].into_iter().zip(outward) {
            let message = result(outward(limit)).expect_err(&key.name).to_string();
            let is_reported = message.contains(name) && message.contains("line");
            assert!(is_reported, "{message}");
            let is_good = key.parameter.also.is_some() || result(limit).is_ok();
            assert!(is_good, "{} = {limit}", key.name);
        }
    }
}

#[test]
fn the_shortest_period_has_times_of_its_own() {
    let text = "[cycle]\nperiod_ms = 0.1\ngather_lead_ms = 0.04\n";
    let cycle = Config::parse(text, Path::new("x")).unwrap().config.cycle;
    let times = [cycle.deadline_ns(), cycle.budget_margin_ns()];
    assert_eq!((ns(cycle.period_ms), times), (100_000, [100_000, 40_000]));
}
