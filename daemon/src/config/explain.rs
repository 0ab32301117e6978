use cdcr_controller::parameters::Parameter;
use serde_json::Value;

use super::{Config, ConfigError, Origin, Settings, keys, schema};

/// Says all about a key, like `cycle.period_ms`, or about a table and its keys: what it is, its type, range and
/// default, and the value in force and where that comes from.
pub fn explain(key: &str, settings: &Settings) -> Result<String, ConfigError> {
    let key = keys::without_indices(key);
    if keys::declared(&key).is_none() {
        return Err(ConfigError::Unknown {
            origin: Origin::Default,
            nearest: keys::nearest(&key),
            key,
        });
    }
    let below = format!("{key}.");
    let all = keys::all().iter();
    let about = all
        .filter(|(known, _)| *known == key || known.starts_with(&below))
        .map(|(key, parameter)| about(key, parameter, settings));
    Ok(about.collect::<Vec<_>>().join("\n"))
}

/// What there is to say about one key or the head of a table.
fn about(key: &str, parameter: &Parameter, settings: &Settings) -> String {
    let schema = schema::committed();
    let node = schema::node(&schema, key).unwrap_or(&Value::Null);
    let mut lines = vec![key.to_owned()];
    lines.extend(parameter.text().lines().map(|line| format!("  {line}")));
    lines.extend(choices(node));
    let mut fact = |name: &str, text: String| lines.push(format!("  {name:<9} {text}"));
    if let Some(kind) = kind(node) {
        fact("type", kind);
    }
    if let Some(range) = parameter.range_text() {
        let also = parameter.also.map(|also| format!(", {also}"));
        fact("range", range + &also.unwrap_or_default());
    }
    if let Some(default) = value(&Config::default(), key) {
        fact("default", default);
    }
    if let Some(value) = value(&settings.config, key) {
        fact("value", value);
        fact("from", settings.origins.of(key).to_string());
    }
    if keys::settable().contains_key(key) {
        fact("variable", keys::variable(key));
    }
    lines.push(String::new());
    lines.join("\n")
}

/// The values that a choice has, each with its meaning.
fn choices(node: &Value) -> Vec<String> {
    let choices = node.get("oneOf").and_then(Value::as_array);
    let each = choices.into_iter().flatten().filter_map(|choice| {
        let description = choice.get("description").and_then(Value::as_str);
        let words = description.unwrap_or_default().replace('\n', " ");
        Some(format!("    {}: {words}", choice.get("const")?))
    });
    each.collect()
}

/// The type of a key in words; none for a table.
fn kind(node: &Value) -> Option<String> {
    if node.get("oneOf").is_some() {
        return Some("one of these strings".to_owned());
    }
    if node.get("anyOf").is_some() {
        return Some("number or \"auto\"".to_owned());
    }
    let words = match node.get("type")?.as_str()? {
        "number" => "number",
        "integer" => "whole number",
        "boolean" => "true or false",
        "array" => "list",
        "string" => "string",
        "object" => "table",
        _ => return None,
    };
    Some(words.to_owned())
}

/// The value of a key; for a key of a list of tables, that of each table.
fn value(config: &Config, key: &str) -> Option<String> {
    let values = keys::values(config);
    if let Some(value) = keys::value(&values, key) {
        return Some(match value.as_array() {
            Some(list) if list.iter().any(toml::Value::is_table) => {
                format!("{} tables, key by key below", list.len())
            }
            _ => value.to_string(),
        });
    }
    let (list, name) = key.rsplit_once('.')?;
    let tables = keys::value(&values, list)?.as_array()?;
    let each = tables.iter().filter_map(|table| table.get(name));
    let each: Vec<String> = each.map(ToString::to_string).collect();
    Some(format!("{} (base first)", each.join(", ")))
}
