use serde_json::Value;

use super::error::Result;
use super::keys::{self, Key};
use super::{Config, ConfigDraft, ConfigError};

/// A JSON schema of the configuration (draft 2020-12), generated from the declarations. It is committed, so
/// that the program needs no generator; a test compares it, and writes it if `CDCR_GENERATE` is set.
pub const SCHEMA_TEXT: &str = include_str!("../../../configs/schema.json");

/// Explains a key, like `cycle.period_ms`, or a table with its keys: description, type, range, default,
/// present value and its origin.
pub fn explain(key: &str, settings: &ConfigDraft) -> Result<String> {
    let name = keys::without_indices(key);
    if keys::get(&name).is_none() {
        return Err(ConfigError::unknown(None, &name));
    }
    let schema = serde_json::from_str(SCHEMA_TEXT).unwrap_or_default();
    let below = format!("{name}.");
    let all = keys::all().iter();
    let about = all
        .filter(|key| key.name == name || key.name.starts_with(&below))
        .map(|key| about(key, node(&schema, &key.name), settings));
    Ok(about.collect::<Vec<_>>().join("\n"))
}

/// The schema's node of a key or a table.
fn node<'a>(schema: &'a Value, key: &str) -> &'a Value {
    key.split('.').fold(schema, |node, part| {
        let node = node.get("items").unwrap_or(node);
        &node["properties"][part]
    })
}

/// The explanation of one key, or of a table without its keys.
fn about(key: &Key, node: &Value, settings: &ConfigDraft) -> String {
    let parameter = key.parameter;
    let mut lines = vec![key.name.clone()];
    lines.extend(parameter.text().lines().map(|line| format!("  {line}")));
    lines.extend(choices(node));
    let range = parameter.range_text().map(|range| match parameter.also {
        Some(also) => format!("{range}, {also}"),
        None => range,
    });
    let value_in_force = value(&settings.config, &key.name);
    let origin = settings.origins.get(&key.name).unwrap_or("default");
    let variable = key.default.as_ref().map(|_| keys::variable(&key.name));
    let facts = [
        ("type", kind(node).map(str::to_owned)),
        ("range", range),
        ("usual", parameter.usual_text()),
        ("default", value(&Config::default(), &key.name)),
        ("value", value_in_force.clone()),
        ("from", value_in_force.map(|_| origin.to_owned())),
        ("variable", variable),
    ];
    let fact = |(name, fact): (_, Option<String>)| Some(format!("  {name:<9} {}", fact?));
    lines.extend(facts.into_iter().filter_map(fact));
    lines.push(String::new());
    lines.join("\n")
}

/// The values of a choice with their descriptions.
fn choices(node: &Value) -> Vec<String> {
    let choices = node["oneOf"].as_array().into_iter().flatten();
    let each = choices.map(|choice| {
        let words = choice["description"].as_str().unwrap_or_default();
        format!("    {}: {}", choice["const"], words.replace('\n', " "))
    });
    each.collect()
}

/// The type of a key as text; `None` for a table.
fn kind(node: &Value) -> Option<&'static str> {
    match node["type"].as_str() {
        _ if node.get("oneOf").is_some() => Some("one of these strings"),
        _ if node.get("anyOf").is_some() => Some("number or \"auto\""),
        Some("number") => Some("number"),
        Some("integer") => Some("whole number"),
        Some("boolean") => Some("true or false"),
        Some("array") => Some("list"),
        Some("string") => Some("string"),
        Some("object") => Some("table"),
        _ => None,
    }
}

/// The value of a key; for a key of a list of tables, the values of all tables.
fn value(config: &Config, key: &str) -> Option<String> {
    let values = keys::values(config);
    let each = keys::each(&values, key);
    let tables = |list: &Vec<_>| {
        list.first()
            .is_some_and(toml::Value::is_table)
            .then_some(list.len())
    };
    match &*each {
        [] => None,
        [(name, value)] if name == key => match value.as_array().and_then(tables) {
            Some(count) => Some(format!("{count} tables, key by key below")),
            None => Some(keys::text(value)),
        },
        each => {
            let each: Vec<_> = each.iter().map(|(_, value)| keys::text(value)).collect();
            Some(each.join(", ") + " (base first)")
        }
    }
}
