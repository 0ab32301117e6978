//! Fields of a message by path: names and element indices, separated by points.

use anyhow::bail;
use cdcr_client::counted;
use cdcr_shared_types::message::{Field, Meaning, Struct, Value as FieldValue};
use serde_json::{Map, Value};

use super::json::{self, shown_name};

/// Fails for a name that no such message has, and for an index beyond its array. A field or an index that only other messages use is none: kinds
/// of measurements, obstacles and events come and go.
pub(crate) fn check(message: &dyn Struct, paths: &[String]) -> anyhow::Result<()> {
    let check = |path: &String| check_part(FieldValue::Struct(message), None, path, Some(path));
    paths.iter().try_for_each(check)
}

/// `count`: elements of an array of which this robot uses a part. `rest`: end of the path from here on.
fn check_part(
    value: FieldValue<'_>,
    count: Option<usize>,
    path: &str,
    rest: Option<&str>,
) -> anyhow::Result<()> {
    let Some(rest) = rest else { return Ok(()) };
    let (part, after) = match rest.split_once('.') {
        Some((part, after)) => (part, Some(after)),
        None => (rest, None),
    };
    match value {
        FieldValue::Struct(message) => {
            let mut checked = None;
            let mut names = Vec::new();
            message.visit(&mut |field, value| {
                if matches!(field.meaning, Meaning::Reserved | Meaning::Length) {
                    return;
                }
                names.push(shown_name(field));
                let is_array = !matches!(field.meaning, Meaning::Text | Meaning::Per(..));
                if shown_name(field) == part {
                    let count = count_of_robot(message, field);
                    checked = Some(if is_array {
                        check_part(value, count, path, after)
                    } else {
                        Ok(())
                    });
                }
            });
            checked.unwrap_or_else(|| {
                // Flags that are shown under names of their own.
                if json::message(message).get(part).is_some() {
                    return Ok(());
                }
                bail!(
                    "unknown field {part:?} in --field {path}: use one of {}",
                    names.join(", ")
                )
            })
        }
        FieldValue::Array(array) => {
            let count = count.unwrap_or(array.count());
            let name = &path[..path.len() - rest.len() - 1];
            match part.parse() {
                Ok(index) if index < count => check_part(array.element(index), None, path, after),
                _ => bail!(
                    "invalid index {part:?} in --field {path}: {name} has {}, numbered from 0",
                    counted(count, "element")
                ),
            }
        }
        _ => Ok(()),
    }
}

/// Elements of an array that depend on the number of sections only.
fn count_of_robot(message: &dyn Struct, field: &Field) -> Option<usize> {
    let is_of_robot = field.used?.count.ends_with("sections");
    message.used(field).filter(|used| is_of_robot && *used > 0)
}

/// The value at `path`; null for an element that this message does not use.
fn get<'a>(message: &'a Value, path: &str) -> anyhow::Result<&'a Value> {
    let mut value = message;
    for part in path.split('.') {
        value = match value {
            Value::Object(fields) => fields.get(part).unwrap_or(&Value::Null),
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
pub(crate) fn select(message: &Value, paths: &[String]) -> anyhow::Result<Value> {
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
    use cdcr_shared_types::{Status, Telemetry};
    use serde_json::json;

    fn paths(paths: &[&str]) -> Vec<String> {
        paths.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_path_leads_to_its_value_or_lists_the_known_ones() {
        let message =
            json!({"cycle": 7, "mode": "tracking", "tip": [1.0, null], "report": {"cost": 2.5}});
        let good = paths(&["cycle", "mode", "tip.1", "tip.9", "report.cost", "tip"]);
        let shown = line(&message, &good).expect("known");
        assert_eq!(shown, "7\ttracking\tnull\tnull\t2.5\t[1.0,null]");
        let found = select(&message, &paths(&["tip.0", "report"])).expect("known");
        assert_eq!(found, json!({"tip.0": 1.0, "report": {"cost": 2.5}}));
        for (bad, part) in [
            ("tip.x", "use a number from 0"),
            ("cycle.0", "follows a value"),
        ] {
            let error = select(&message, &paths(&[bad])).expect_err(bad).to_string();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn an_index_beyond_its_array_is_refused_with_the_length() {
        let mut status = Status::default();
        status.robot.sections = 3;
        let check_of_status = |path: &str| check(&status, &paths(&[path]));
        for good in ["cycles", "robot.sections.2.length_m", "robot_name.x"] {
            check_of_status(good).expect(good);
        }
        for (bad, part) in [
            ("robot.sections.3.length_m", "robot.sections has 3 elements"),
            ("following_error_m.9", "following_error_m has 9 elements"),
            ("robot.sections.x", "robot.sections has 3 elements"),
        ] {
            let error = check_of_status(bad).expect_err(bad).to_string();
            assert!(error.contains(part), "{error}");
        }
        let error = check_of_status("cycle").expect_err("no such field");
        assert!(error.to_string().contains("use one of "), "{error}");
        let check = |path: &str| check(&Telemetry::default(), &paths(&[path]));
        check("obstacles.7.radius_m").expect("there may be so many");
        check("measurement.cable_length_m.2").expect("of another kind of measurement");
        check("measurement.cable_lengths").expect_err("of none");
        let error = check("tip_position_m.7").expect_err("of three").to_string();
        assert!(error.contains("tip_position_m has 3 elements"), "{error}");
    }

    #[test]
    fn what_is_null_is_absent() {
        let value = json!({"a": null, "b": [1, null, 3], "c": {"d": null}, "e": [1, 2]});
        let left = json!({"b": {"0": 1, "2": 3}, "e": [1, 2]});
        assert_eq!(without_null(value), Some(left));
        assert_eq!(without_null(json!({"a": [null]})), None);
    }
}
