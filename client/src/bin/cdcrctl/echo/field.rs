//! Fields of a message by path: names and element indices, separated by points.

use anyhow::{Context, bail};
use serde_json::{Map, Value};

/// The value at `path`; null for an unused element.
fn get<'a>(message: &'a Value, path: &str) -> anyhow::Result<&'a Value> {
    let mut value = message;
    for part in path.split('.') {
        value = match value {
            Value::Object(fields) => {
                let field = fields.get(part).with_context(|| {
                    let names: Vec<_> = fields.keys().map(String::as_str).collect();
                    let names = names.join(", ");
                    format!("unknown field {part:?} in --field {path}: use one of {names}")
                });
                field?
            }
            Value::Array(elements) => match part.parse::<usize>() {
                Ok(index) => elements.get(index).unwrap_or(&Value::Null),
                Err(_) => bail!("invalid index {part:?} in --field {path}: use a number from 0"),
            },
            Value::Null => value,
            _ => bail!("--field {path}: {part:?} follows a value that has no fields"),
        };
    }
    Ok(value)
}

/// The values at several paths, each under its path.
pub(crate) fn of(message: &Value, paths: &[String]) -> anyhow::Result<Value> {
    let mut found = Map::new();
    for path in paths {
        found.insert(path.clone(), get(message, path)?.clone());
    }
    Ok(Value::Object(found))
}

/// The values as one line of text, separated by tabs.
pub(super) fn line(message: &Value, paths: &[String]) -> anyhow::Result<String> {
    let mut words = Vec::new();
    for path in paths {
        words.push(match get(message, path)? {
            Value::String(text) => text.clone(),
            value => value.to_string(),
        });
    }
    Ok(words.join("\t"))
}

/// Removes null values, which include NaN and infinity: plotters cannot draw them. `None` if nothing is left.
pub(crate) fn without_null(value: Value) -> Option<Value> {
    match value {
        Value::Null => None,
        Value::Object(fields) => {
            let fields = fields.into_iter();
            let left: Map<_, _> = fields
                .filter_map(|(name, value)| Some((name, without_null(value)?)))
                .collect();
            (!left.is_empty()).then_some(Value::Object(left))
        }
        // The index of an element is its name: without names, elements after a gap would shift.
        Value::Array(elements) if elements.iter().any(Value::is_null) => {
            let named = elements.into_iter().enumerate();
            let named = named.map(|(index, value)| (index.to_string(), value));
            without_null(Value::Object(named.collect()))
        }
        value => Some(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn paths(paths: &[&str]) -> Vec<String> {
        paths.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_path_leads_to_its_value_or_says_what_there_is() {
        let message =
            json!({"cycle": 7, "mode": "tracking", "tip": [1.0, null], "report": {"cost": 2.5}});
        let good = paths(&["cycle", "mode", "tip.1", "tip.9", "report.cost", "tip"]);
        let shown = line(&message, &good).expect("known");
        assert_eq!(shown, "7\ttracking\tnull\tnull\t2.5\t[1.0,null]");
        let found = of(&message, &paths(&["tip.0", "report"])).expect("known");
        assert_eq!(found, json!({"tip.0": 1.0, "report": {"cost": 2.5}}));
        for (bad, part) in [
            ("cycles", "use one of cycle, mode, tip, report"),
            ("report.costs", "use one of cost"),
            ("tip.x", "use a number from 0"),
            ("cycle.0", "follows a value"),
        ] {
            let error = of(&message, &paths(&[bad])).expect_err(bad).to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn what_is_null_is_absent() {
        let value = json!({"a": null, "b": [1, null, 3], "c": {"d": null}, "e": [1, 2]});
        let left = json!({"b": {"0": 1, "2": 3}, "e": [1, 2]});
        assert_eq!(without_null(value), Some(left));
        assert_eq!(without_null(json!({"a": [null]})), None);
    }
}
