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
    let schema: Value = serde_json::from_str(SCHEMA_TEXT).unwrap_or_default();
    let below = format!("{name}.");
    let all = keys::ALL.iter();
    let shown = all.filter(|key| key.name == name || key.name.starts_with(&below));
    let about =
        shown.filter_map(|key| Some(about(key, schema.pointer(&pointer(&key.name))?, settings)));
    Ok(about.collect::<Vec<_>>().join("\n"))
}

/// Where the schema has a key or a table.
pub(super) fn pointer(key: &str) -> String {
    let key = key.replace("sections.", "sections/items.");
    format!("/properties/{}", key.replace('.', "/properties/"))
}

/// The explanation of one key, or of a table without its keys.
fn about(key: &Key, node: &Value, settings: &ConfigDraft) -> String {
    let parameter = key.parameter;
    let mut lines = vec![key.name.clone()];
    lines.extend(parameter.text().lines().map(|line| format!("  {line}")));
    let choices = node["oneOf"].as_array().into_iter().flatten();
    lines.extend(choices.map(|choice| {
        let words = choice["description"].as_str().unwrap_or_default();
        format!("    {}: {}", choice["const"], words.replace('\n', " "))
    }));
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

/// The type of a key as text.
fn kind(node: &Value) -> Option<&str> {
    match node["type"].as_str() {
        _ if node.get("oneOf").is_some() => Some("one of these strings"),
        _ if node.get("anyOf").is_some() => Some("number or \"auto\""),
        Some("integer") => Some("whole number"),
        Some("boolean") => Some("true or false"),
        Some("array") => Some("list"),
        Some("object") => Some("table"),
        other => other,
    }
}

/// The value of a key; for a key of a list of tables, the values of all tables.
fn value(config: &Config, key: &str) -> Option<String> {
    let values = keys::values(config);
    let each = keys::each(&values, key);
    let texts = each.iter().map(|(_, value)| keys::text(value));
    match (&*each, keys::value(&values, key)) {
        ([], _) => None,
        (_, Some(toml::Value::Array(list))) if list.iter().any(toml::Value::is_table) => {
            Some(format!("{} tables, key by key below", list.len()))
        }
        (_, Some(_)) => Some(texts.collect()),
        _ => Some(texts.collect::<Vec<_>>().join(", ") + " (base first)"),
    }
}
