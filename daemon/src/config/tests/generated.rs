//! The default file and the schema are generated from the declarations: every key with its description, range
//! and default.

use std::path::Path;

use cdcr_controller::robot::SectionParameters;
use cdcr_controller::robot::ranges::SECTION_COUNT;
use schemars::generate::SchemaSettings;
use serde_json::{Value, json};

use crate::config::explain::pointer;
use crate::config::{Config, DEFAULT_TEXT, SCHEMA_TEXT, keys};

const HEAD: &str = "\
# The default configuration of cdcrd: the paper's robot with three sections, simulated.
# Every key is here with its default; a file needs only the keys that differ.
# Units end the names. Check a file with: cdcrd check --config FILE
# One key, and where its value comes from: cdcrd config explain cycle.period_ms
";

fn compare(name: &str, made: &str, is_same: bool) {
    if std::env::var_os("CDCR_GENERATE").is_some() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        return std::fs::write(folder.join(name), made).unwrap();
    }
    let command = "CDCR_GENERATE=1 cargo test -p cdcr-daemon --lib generated";
    assert!(is_same, "{name}: run `{command}` and commit what it writes");
}

#[test]
fn the_committed_file_is_what_is_declared() {
    let values = keys::values(&Config::default());
    let sections = values["robot"]["sections"].as_array().unwrap();
    let mut text = HEAD.to_owned();
    for key in keys::ALL.iter() {
        let name = key.parameter.name;
        let setting = match &key.default {
            None if !key.name.contains('.') => format!("[{name}]\n"),
            None => line(name, &sections[0][name]),
            Some(_) if key.name == "robot.sections" => format!("[[{}]]\n", key.name),
            Some(default) => line(name, default),
        };
        text += if setting.starts_with('[') { "\n" } else { "" };
        let words = key.parameter.text();
        text.extend(words.lines().map(|line| format!("# {line}\n")));
        text += &setting;
        if key.name == "robot.sections.body_radius_m" {
            for section in &sections[1..] {
                text += "\n[[robot.sections]]\n";
                let names = SectionParameters::PARAMETERS.iter().map(|of| of.name);
                text.extend(names.map(|name| line(name, &section[name])));
            }
        }
    }
    compare("default.toml", &text, text == DEFAULT_TEXT);
}

fn line(name: &str, value: &toml::Value) -> String {
    match value.as_float() {
        Some(number) if number != 0.0 && number.abs() < 1e-6 => format!("{name} = {number:e}\n"),
        Some(angle) if angle != 0.0 && name == "cable_offset_rad" => {
            let degrees = angle.to_degrees().round();
            format!("{name} = {value} # {degrees} degrees\n")
        }
        _ => format!("{name} = {value}\n"),
    }
}

#[test]
fn the_committed_schema_is_what_is_declared() {
    let mut settings = SchemaSettings::draft2020_12().for_deserialize();
    // Editors do not follow references.
    settings.inline_subschemas = true;
    let generator = settings.into_generator();
    let mut schema = generator.into_root_schema_for::<Config>().to_value();
    schema["title"] = json!("Configuration of cdcrd");
    for key in keys::ALL.iter() {
        let node = schema.pointer_mut(&pointer(&key.name)).expect(&key.name);
        node["description"] = json!(key.parameter.text().replace('\n', " "));
        if key.name == "robot.sections" {
            node["minItems"] = json!(SECTION_COUNT.start());
            node["maxItems"] = json!(SECTION_COUNT.end());
            // The Rust documentation of one table of a list does not concern users.
            node["items"].as_object_mut().unwrap().remove("description");
        }
        let range = key.parameter.range.iter();
        for (name, limit) in range.flat_map(|r| [("minimum", *r.start()), ("maximum", *r.end())]) {
            let whole = (node["type"] == "integer").then_some(limit as i64);
            node[name] = whole.map_or(json!(limit), |whole| json!(whole));
        }
        let node = node.as_object_mut().unwrap();
        if node.contains_key("properties") {
            // Each key has its own default.
            node.remove("default");
        }
    }
    // The order of its keys depends on a feature of serde_json, which other crates may enable.
    let committed: Value = serde_json::from_str(SCHEMA_TEXT).unwrap();
    compare("schema.json", &format!("{schema:#}\n"), schema == committed);
}

#[test]
fn every_key_has_words_and_every_number_a_range_that_is_reported() {
    for key in keys::ALL.iter() {
        let (name, parameter) = (&key.name, key.parameter);
        assert!(parameter.text().len() > 10, "{name}: {}", parameter.text());
        let is_reported = parameter.doc.iter().any(|line| line.contains("{range}"));
        assert_eq!(is_reported, parameter.range.is_some(), "{name}");
        let has_range = is_reported || name == "controller.seed";
        if let Some(default) = &key.default {
            let is_number = default.is_float() || default.is_integer();
            let may_be = is_number || name == "controller.rate_weight";
            assert_eq!(has_range, may_be, "{name}");
        }
    }
}
