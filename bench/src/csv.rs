//! Rows of nested values as CSV: what JSON nests, a column names with both keys.

use std::fmt;

use anyhow::Result;
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde::{Serialize, de};

/// A value of JSON, its keys in their order.
enum Value {
    Object(Vec<(String, Self)>),
    Text(String),
}

/// One line for each row under the names of all columns. A field that a row lacks stays empty.
pub fn csv<T: Serialize>(rows: &[T]) -> Result<String> {
    let mut columns: Vec<String> = Vec::new();
    let mut lines = Vec::new();
    for row in rows {
        let mut cells = Vec::new();
        serde_json::from_str::<Value>(&serde_json::to_string(row)?)?.flatten("", &mut cells);
        for (name, _) in &cells {
            if !columns.contains(name) {
                columns.push(name.clone());
            }
        }
        lines.push(cells);
    }
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(&columns)?;
    for cells in &lines {
        let cell = |column| cells.iter().find(|(name, _)| name == column);
        writer.write_record(
            columns
                .iter()
                .map(|column| cell(column).map_or("", |c| &c.1)),
        )?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

impl Value {
    fn flatten(self, name: &str, cells: &mut Vec<(String, String)>) {
        match self {
            Self::Text(text) => cells.push((name.to_owned(), text)),
            Self::Object(fields) => {
                for (key, value) in fields {
                    let inner = if name.is_empty() {
                        key
                    } else {
                        format!("{name}_{key}")
                    };
                    value.flatten(&inner, cells);
                }
            }
        }
    }
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ValueVisitor)
    }
}

struct ValueVisitor;

impl<'de> Visitor<'de> for ValueVisitor {
    type Value = Value;

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("a number, a text, true, false or an object")
    }

    fn visit_bool<E: de::Error>(self, value: bool) -> Result<Value, E> {
        Ok(Value::Text(value.to_string()))
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Value, E> {
        Ok(Value::Text(value.to_string()))
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Value, E> {
        Ok(Value::Text(value.to_string()))
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Value, E> {
        Ok(Value::Text(format!("{value:?}")))
    }

    fn visit_str<E: de::Error>(self, value: &str) -> Result<Value, E> {
        Ok(Value::Text(value.to_owned()))
    }

    fn visit_unit<E: de::Error>(self) -> Result<Value, E> {
        Ok(Value::Text(String::new()))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
        let mut fields = Vec::new();
        while let Some(field) = map.next_entry()? {
            fields.push(field);
        }
        Ok(Value::Object(fields))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Row {
        name: &'static str,
        good: bool,
        times: Times,
        #[serde(skip_serializing_if = "Option::is_none")]
        more: Option<f64>,
    }

    #[derive(Serialize)]
    struct Times {
        mean: f64,
        count: u32,
    }

    #[test]
    fn nested_names_are_joined_and_missing_fields_stay_empty() {
        let times = Times {
            mean: 5e-9,
            count: 3,
        };
        let rows = [
            Row {
                name: "a",
                good: true,
                times,
                more: None,
            },
            Row {
                name: "b, c",
                good: false,
                times: Times {
                    mean: f64::NAN,
                    count: 0,
                },
                more: Some(0.5),
            },
        ];
        let expected =
            "name,good,times_mean,times_count,more\na,true,5e-9,3,\n\"b, c\",false,,0,0.5\n";
        assert_eq!(csv(&rows).expect("written"), expected);
    }
}
