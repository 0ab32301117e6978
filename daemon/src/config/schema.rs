use serde_json::Value;

/// A JSON schema of the configuration (draft 2020-12): types and defaults of the structs, ranges that are checked,
/// descriptions from the comments of `configs/default.toml`. It is committed, so that the program needs nothing to make
/// it; a test makes it, and writes it when `CDCR_GENERATE` is set.
pub const SCHEMA_TEXT: &str = include_str!("../../../configs/schema.json");

/// What [`SCHEMA_TEXT`] says.
pub(super) fn committed() -> Value {
    serde_json::from_str(SCHEMA_TEXT).expect("a test compares it with what it is made from")
}

pub(super) fn node<'a>(schema: &'a Value, key: &str) -> Option<&'a Value> {
    key.split('.').try_fold(schema, |node, part| {
        let node = node.get("items").unwrap_or(node);
        node.get("properties")?.get(part)
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use cdcr_controller::parameters::Parameter;
    use cdcr_controller::robot::ranges::SECTION_COUNT;
    use schemars::generate::SchemaSettings;
    use serde_json::{Map, json};

    use super::*;
    use crate::config::{Config, keys};

    /// The schema as it has to be.
    fn made() -> Value {
        let mut settings = SchemaSettings::draft2020_12().for_deserialize();
        settings.inline_subschemas = true;
        let generator = settings.into_generator();
        let mut schema = generator.into_root_schema_for::<Config>().to_value();
        schema["title"] = json!("Configuration of cdcrd");
        for (key, parameter) in keys::all() {
            if let Some(node) = node_mut(&mut schema, key) {
                complete(node, key, parameter);
            }
        }
        schema
    }

    fn node_mut<'a>(schema: &'a mut Value, key: &str) -> Option<&'a mut Map<String, Value>> {
        let mut node = schema;
        for part in key.split('.') {
            if node.get("items").is_some() {
                node = node.get_mut("items")?;
            }
            node = node.get_mut("properties")?.get_mut(part)?;
        }
        node.as_object_mut()
    }

    /// Adds words and range.
    fn complete(node: &mut Map<String, Value>, key: &str, parameter: &Parameter) {
        let words = parameter.text().replace('\n', " ");
        node.insert("description".to_owned(), json!(words));
        if let Some(range) = &parameter.range {
            let is_whole = node.get("type").is_some_and(|kind| kind == "integer");
            let limit = |limit: f64| {
                if is_whole {
                    json!(limit as i64)
                } else {
                    json!(limit)
                }
            };
            node.insert("minimum".to_owned(), limit(*range.start()));
            node.insert("maximum".to_owned(), limit(*range.end()));
        }
        if key == "robot.sections" {
            node.insert("minItems".to_owned(), json!(SECTION_COUNT.start()));
            node.insert("maxItems".to_owned(), json!(SECTION_COUNT.end()));
        }
        if let Some(items) = node.get_mut("items").and_then(Value::as_object_mut) {
            // What Rust calls one table of a list is nothing to people.
            items.remove("description");
        }
        if node.contains_key("properties") {
            // The defaults are with the keys.
            node.remove("default");
        }
    }

    #[test]
    fn the_committed_schema_is_what_it_is_made_from() {
        let made = made();
        if std::env::var_os("CDCR_GENERATE").is_some() {
            let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/schema.json");
            std::fs::write(file, format!("{made:#}\n")).unwrap();
        } else {
            assert!(
                committed() == made,
                "run `CDCR_GENERATE=1 cargo test -p cdcr-daemon --lib schema` and commit what it writes"
            );
        }
    }

    fn leaves(node: &Value, path: &str, found: &mut Vec<String>) {
        let node = node.get("items").unwrap_or(node);
        let Some(properties) = node.get("properties").and_then(Value::as_object) else {
            return;
        };
        for (name, below) in properties {
            let dot = if path.is_empty() { "" } else { "." };
            let key = format!("{path}{dot}{name}");
            leaves(below, &key, found);
            found.push(key);
        }
    }

    #[test]
    fn the_schema_has_every_key_and_no_other() {
        let schema = committed();
        assert_eq!(
            schema["$schema"],
            "https://json-schema.org/draft/2020-12/schema"
        );
        assert_eq!(schema["additionalProperties"], false);
        let mut found = Vec::new();
        leaves(&schema, "", &mut found);
        let mut known: Vec<_> = keys::all().iter().map(|(key, _)| key.clone()).collect();
        found.sort();
        known.sort();
        assert_eq!(found, known);
        assert!(
            !schema.to_string().contains("$ref"),
            "editors follow no links"
        );
    }

    #[test]
    fn every_key_is_described_as_in_the_default_file_and_has_its_default() {
        let schema = committed();
        for (key, parameter) in keys::all() {
            let node = node(&schema, key).unwrap();
            let description = node["description"].as_str().unwrap();
            assert_eq!(description, parameter.text().replace('\n', " "));
            if let Some(default) = keys::settable().get(key) {
                let default = serde_json::to_value(default).unwrap();
                assert_eq!(node["default"], default, "{key}");
            }
        }
    }

    #[test]
    fn numbers_have_limits_of_their_type() {
        let schema = committed();
        for (key, parameter) in keys::all() {
            let Some(range) = &parameter.range else {
                continue;
            };
            let node = node(&schema, key).unwrap();
            assert_eq!(node["minimum"].as_f64(), Some(*range.start()), "{key}");
            assert_eq!(node["maximum"].as_f64(), Some(*range.end()), "{key}");
            let is_whole = node["type"] == "integer";
            assert_eq!(node["maximum"].is_i64(), is_whole, "{key}: {node}");
        }
        for (key, default) in keys::settable() {
            let has_range = keys::declared(key).unwrap().range.is_some();
            let is_limited = has_range || key == "controller.seed";
            let is_number = default.is_float() || default.is_integer();
            let is_number = is_number || key == "controller.rate_weight";
            assert_eq!(is_limited, is_number, "{key}");
        }
        let solver = node(&schema, "controller.solver").unwrap();
        assert_eq!(solver["oneOf"].as_array().unwrap().len(), 3, "{solver}");
    }
}
