//! What is allowed for each number, whatever the other keys say: the ranges that are declared.

use cdcr_controller::parameters::number_text;
use toml::Value;

use super::{Config, ConfigError, Origins, keys};

/// Refuses the first number outside its range, NaN included.
pub(super) fn check(config: &Config, origins: &Origins) -> Result<(), ConfigError> {
    // Not by way of JSON, which has neither NaN nor infinity.
    let values = Value::try_from(config)
        .map_err(|error| origins.error(&["the configuration"], &error.to_string()))?;
    for (key, parameter) in keys::all() {
        let Some(range) = &parameter.range else {
            continue;
        };
        for (key, value) in found(&values, key) {
            if !range.contains(&value) {
                let allowed = format!(
                    "{} to {}",
                    number_text(*range.start()),
                    number_text(*range.end())
                );
                let message = format!("{value} is out of range: allowed is {allowed}");
                return Err(origins.error(&[&key], &message));
            }
        }
    }
    Ok(())
}

/// The numbers of a key, one for each table of a list.
fn found(values: &Value, key: &str) -> Vec<(String, f64)> {
    let mut at = vec![(String::new(), values)];
    for part in key.split('.') {
        let below = at.into_iter().filter_map(|(path, value)| {
            let dot = if path.is_empty() { "" } else { "." };
            Some((format!("{path}{dot}{part}"), value.get(part)?))
        });
        at = below.flat_map(each).collect();
    }
    at.into_iter()
        .map(|(key, value)| {
            let whole = value.as_integer().map(|value| value as f64);
            (key, value.as_float().or(whole).unwrap_or(f64::NAN))
        })
        .collect()
}

/// The elements of a list; anything else as it is.
fn each((path, value): (String, &Value)) -> Vec<(String, &Value)> {
    match value.as_array() {
        Some(list) => {
            let elements = list.iter().enumerate();
            elements
                .map(|(index, value)| (format!("{path}[{index}]"), value))
                .collect()
        }
        None => vec![(path, value)],
    }
}
