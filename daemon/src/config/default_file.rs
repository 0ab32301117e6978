//! The default file is made of what is declared: every key with its words, its range and its default.

use std::path::Path;

use super::{Config, DEFAULT_TEXT, keys};

const HEAD: &str = "\
# The default configuration of cdcrd: the paper's robot with three sections, simulated.
# Every key is here with its default; a file needs only the keys that differ.
# Units end the names. Check a file with: cdcrd check --config FILE
# One key, and where its value comes from: cdcrd config explain cycle.period_ms
";

fn made() -> String {
    let values = keys::values(&Config::default());
    let mut text = HEAD.to_owned();
    for (key, parameter) in keys::all() {
        let comment: Vec<_> = parameter
            .text()
            .lines()
            .map(|line| format!("# {line}\n"))
            .collect();
        let name = parameter.name;
        let setting = match keys::value(&values, key) {
            _ if !key.contains('.') => {
                text.push('\n');
                format!("[{key}]\n")
            }
            None => line(name, &first_section()[name]),
            Some(toml::Value::Array(list)) if list.iter().any(toml::Value::is_table) => {
                text.push('\n');
                format!("[[{key}]]\n")
            }
            Some(default) => line(name, default),
        };
        text.extend([comment.concat(), setting]);
        if key == "robot.sections.body_radius_m" {
            text += &other_sections();
        }
    }
    text
}

fn line(name: &str, value: &toml::Value) -> String {
    match value.as_float() {
        Some(number) if number != 0.0 && number.abs() < 1e-6 => format!(
            "{name} = {number:e}
"
        ),
        _ => format!(
            "{name} = {value}
"
        ),
    }
}

fn sections() -> Vec<toml::Table> {
    let sections = Config::default().robot.sections.into_iter();
    sections
        .map(|section| toml::Table::try_from(section).unwrap())
        .collect()
}

fn first_section() -> toml::Table {
    sections().swap_remove(0)
}

/// Without the words; what an angle is in degrees.
fn other_sections() -> String {
    let mut text = String::new();
    for section in sections().iter().skip(1) {
        text += "\n[[robot.sections]]\n";
        for (key, _) in keys::all() {
            if let Some(name) = key.strip_prefix("robot.sections.") {
                let mut line = line(name, &section[name]);
                if name == "cable_offset_rad" {
                    let degrees = section[name].as_float().unwrap().to_degrees().round();
                    line = line.replace('\n', &format!(" # {degrees} degrees\n"));
                }
                text += &line;
            }
        }
    }
    text
}

#[test]
fn the_committed_file_is_what_is_declared() {
    let made = made();
    if std::env::var_os("CDCR_GENERATE").is_some() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/default.toml");
        std::fs::write(file, made).unwrap();
    } else {
        assert!(
            made == DEFAULT_TEXT,
            "run `CDCR_GENERATE=1 cargo test -p cdcr-daemon --lib config::default_file` and commit what it writes"
        );
    }
}

#[test]
fn every_key_and_every_table_has_words_and_a_range_that_is_said() {
    for (key, parameter) in keys::all() {
        let words = parameter.text();
        assert!(words.len() > 10, "{key}: {words}");
        let is_said = parameter.doc.iter().any(|line| line.contains("{range}"));
        assert_eq!(is_said, parameter.range.is_some(), "{key}");
    }
}
