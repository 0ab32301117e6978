//! Result of a benchmark: rows under columns, plots, single numbers, raw latencies.
//!
//! A row is anything that serde serialises as an object. Only this module formats it as text, Markdown, CSV
//! and JSON. A column names its value by the keys that lead to it, joined by `_`, as in CSV.

mod column;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::ops::RangeInclusive;

use anyhow::Result;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use column::Show;
pub use column::{Column, fixed, percent, plain, power, shorted, signed, word};

use crate::metric::{Better, Metric, median};
use crate::study::Rounds;

/// The result of one benchmark, for people, for programs and for comparison with the next run.
#[derive(Default)]
pub struct Dataset {
    pub name: &'static str,
    pub heading: &'static str,
    /// Method and reading guide: paragraphs of HTML.
    pub explanation: &'static str,
    /// The most important remark, one sentence.
    pub note: String,
    /// Whether the note is a warning about a failure or about meaningless numbers.
    pub warns: bool,
    /// Keys of the JSON in addition to those of the sheets.
    pub facts: Map<String, Value>,
    pub sheets: Vec<Sheet>,
    pub plots: Vec<Plot>,
    pub metrics: Vec<Metric>,
    /// Rows of the project's targets: see [`Self::target`].
    pub targets: Vec<Value>,
    /// All measured latencies, from which other percentiles can be computed.
    pub recordings: Vec<Recording>,
}

/// A table of what a benchmark measures in each round.
pub struct RoundTable {
    pub key: &'static str,
    pub file: &'static str,
    pub title: &'static str,
    pub columns: &'static [Column],
    /// Keys of counts that are added over the rounds: see [`together`].
    pub counts: &'static [&'static str],
    /// Name, unit and row key of each number: see [`Dataset::compare`].
    pub numbers: &'static [(&'static str, &'static str, &'static str)],
    /// Prefix of the names of a row's numbers: see `filled`.
    pub path: &'static str,
}

pub struct Plot {
    pub name: &'static str,
    pub caption: &'static str,
    pub svg: String,
}

#[derive(Debug, Clone)]
pub struct Recording {
    /// What was measured: words joined by dots, like `none.daemon.response`.
    pub tag: String,
    /// Start of the recording after the start of the run \[s\].
    pub start_s: f64,
    pub duration_s: f64,
    pub histogram_ns: Histogram<u64>,
}

impl Dataset {
    pub fn new(name: &'static str, heading: &'static str, explanation: &'static str) -> Self {
        Self {
            name,
            heading,
            explanation,
            ..Self::default()
        }
    }

    /// Adds a number of which less is better; nothing if no round measured it.
    pub fn lower(&mut self, name: String, unit: &str, rounds: impl IntoIterator<Item = f64>) {
        self.add(Metric::new(name, unit, Better::Lower, rounds));
    }

    pub fn higher(&mut self, name: String, unit: &str, rounds: impl IntoIterator<Item = f64>) {
        self.add(Metric::new(name, unit, Better::Higher, rounds));
    }

    fn add(&mut self, metric: Metric) {
        self.metrics
            .extend(Some(metric).filter(|metric| !metric.rounds.is_empty()));
    }

    /// Adds a target of the project: description, target in words and unit; the value, the range of its rounds, and
    /// its case or the amount of data; the values that reach it. Adds nothing without a value.
    pub fn target(
        &mut self,
        [what, target, unit]: [&str; 3],
        found: Option<(f64, Value, String)>,
        reached: RangeInclusive<f64>,
    ) {
        self.targets.extend(found.map(|(value, range, of)| {
            let reached = reached.contains(&value);
            json!({
                "what": what, "target": target, "unit": unit, "found": value, "range": range, "of": of, "reached": reached,
            })
        }));
    }

    /// Adds numbers of the same rounds of which less is better: name, unit and row key of each. Shares with
    /// the unit % are scaled by 100.
    pub fn compare(&mut self, path: &str, rounds: &[Value], numbers: &[(&str, &str, &str)]) {
        for (name, unit, key) in numbers {
            let factor = if *unit == "%" { 100.0 } else { 1.0 };
            let values = each(rounds, key).map(|value| factor * value);
            self.lower(format!("{path}/{name}"), unit, values);
        }
    }

    /// Adds a table whose rows every round measured in the same order, see [`together`], and the numbers of
    /// each row. Adds nothing without measurements.
    pub(crate) fn add_rounds(&mut self, table: &RoundTable, found: &Rounds) {
        let mut rows = Vec::new();
        for of_row in by_rows(found.of(table.key)) {
            let row = together(&of_row, table.counts);
            self.compare(&filled(table.path, &row), &of_row, table.numbers);
            rows.push(row);
        }
        if !rows.is_empty() {
            let sheet = Sheet::of(table.title, table.columns, rows);
            self.sheets.push(sheet.key(table.key).file(table.file));
        }
    }

    pub fn rows(&self, key: &str) -> &[Value] {
        let mut sheets = self.sheets.iter();
        let sheet = sheets.find(|sheet| sheet.key == Some(key));
        sheet.map_or(&[], |sheet| &sheet.rows)
    }

    pub fn fact(&mut self, key: &str, value: impl Into<Value>) {
        self.facts.insert(key.to_owned(), value.into());
    }

    pub fn json(&self) -> Map<String, Value> {
        let mut json = self.facts.clone();
        for sheet in &self.sheets {
            if let Some(key) = sheet.key {
                json.insert(key.to_owned(), sheet.rows.clone().into());
            }
        }
        json
    }

    pub fn tables(&self) -> impl Iterator<Item = &Sheet> {
        self.sheets.iter().filter(|sheet| !sheet.title.is_empty())
    }

    pub fn text(&self) -> String {
        self.joined(Sheet::text)
    }

    pub fn markdown(&self) -> String {
        self.joined(Sheet::markdown)
    }

    fn joined(&self, form: fn(&Sheet) -> String) -> String {
        let note = Some(format!("{}\n", self.note)).filter(|_| !self.note.is_empty());
        let texts: Vec<String> = self.tables().map(form).chain(note).collect();
        texts.join("\n")
    }

    pub fn csv(&self) -> impl Iterator<Item = (&'static str, Result<String>)> {
        let sheets = self.sheets.iter();
        sheets.filter_map(|sheet| Some((sheet.file?, sheet.csv())))
    }
}

#[derive(Debug)]
pub struct Sheet {
    key: Option<&'static str>,
    file: Option<&'static str>,
    title: String,
    columns: Vec<Column>,
    rows: Vec<Value>,
}

impl Sheet {
    /// Rows for a table, unless the title is empty. The columns also begin the CSV.
    pub fn of(title: &str, columns: &[Column], rows: Vec<Value>) -> Self {
        Self {
            key: None,
            file: None,
            title: title.to_owned(),
            columns: columns.to_vec(),
            rows,
        }
    }

    #[must_use]
    pub fn key(mut self, key: &'static str) -> Self {
        self.key = Some(key);
        self
    }

    #[must_use]
    pub fn file(mut self, name: &'static str) -> Self {
        self.file = Some(name);
        self
    }

    fn cells(&self) -> Vec<Vec<String>> {
        let cells = |row: &Value| {
            let values = flat(row);
            self.columns.iter().map(|c| c.cell(&values)).collect()
        };
        self.rows.iter().map(cells).collect()
    }

    pub fn text(&self) -> String {
        let heads = self.columns.iter().map(|c| c.head.to_owned()).collect();
        let mut lines = vec![heads];
        lines.extend(self.cells());
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max();
        let widths: Vec<usize> = (0..self.columns.len()).filter_map(width).collect();
        let mut text = format!("{}\n", self.title);
        for line in &lines {
            let mut padded = String::new();
            for ((cell, width), column) in
                line.iter().zip(widths.iter().copied()).zip(&self.columns)
            {
                let _ = match column.show {
                    Show::Word => write!(padded, "{cell:<width$}  "),
                    _ => write!(padded, "{cell:>width$}  "),
                };
            }
            let _ = writeln!(text, "{}", padded.trim_end());
        }
        text
    }

    pub fn markdown(&self) -> String {
        self.shown().markdown()
    }

    pub fn shown(&self) -> ShownTable {
        let is_word = |column: &Column| matches!(column.show, Show::Word);
        ShownTable {
            title: self.title.clone(),
            heads: self.columns.iter().map(|c| c.head.to_owned()).collect(),
            words: self.columns.iter().map(is_word).collect(),
            lines: self.cells(),
        }
    }

    /// Every value of the rows, beginning with the columns of the table.
    fn csv(&self) -> Result<String> {
        let rows: Vec<_> = self.rows.iter().map(flat).collect();
        let keys: BTreeSet<&String> = rows.iter().flat_map(BTreeMap::keys).collect();
        // A key that is null in all rows gets a column. An object that is null in some rows gets the columns
        // of its fields.
        let is_object = |key: &str| {
            let fields = format!("{key}_");
            keys.iter().any(|other| other.starts_with(&fields))
                && rows
                    .iter()
                    .all(|row| row.get(key).is_none_or(Value::is_null))
        };
        let known: Vec<&str> = keys
            .iter()
            .map(|key| key.as_str())
            .filter(|key| !is_object(key))
            .collect();
        let shown = self.columns.iter().map(|column| column.key);
        let mut heads: Vec<&str> = shown.filter(|key| known.contains(key)).collect();
        let others = known.iter().filter(|key| !heads.contains(key));
        heads.extend(others.copied().collect::<Vec<_>>());
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(&heads)?;
        for row in &rows {
            writer.write_record(heads.iter().map(|head| match row.get(*head) {
                None | Some(Value::Null) => String::new(),
                Some(Value::String(text)) => text.clone(),
                Some(value) => value.to_string(),
            }))?;
        }
        Ok(String::from_utf8(writer.into_inner()?)?)
    }
}

/// A table as people read it. `report.json` has those of all benchmarks, and `docs/results.md` is made from
/// them.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ShownTable {
    pub title: String,
    pub heads: Vec<String>,
    /// Whether a column has words, which are left-aligned.
    pub words: Vec<bool>,
    pub lines: Vec<Vec<String>>,
}

impl ShownTable {
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | ").replace('\n', " "));
        let mark = |is_word: &bool| if *is_word { "---" } else { "--:" }.to_owned();
        let marks: Vec<String> = self.words.iter().map(mark).collect();
        let body: String = self.lines.iter().map(|cells| line(cells)).collect();
        format!("{}\n\n", self.title) + &line(&self.heads) + &line(&marks) + &body
    }
}

/// Transposes rounds with the same rows: for each row, its values in all rounds.
pub(crate) fn by_rows(rounds: &[Vec<Value>]) -> Vec<Vec<Value>> {
    let count = rounds.first().map_or(0, Vec::len);
    let of_row = |index: usize| rounds.iter().map(|rows| rows[index].clone()).collect();
    (0..count).map(of_row).collect()
}

/// Replaces the keys in braces in a name by the values of a row.
pub(crate) fn filled(name: &'static str, row: &Value) -> String {
    let values = flat(row);
    let parts = name.split(['{', '}']).enumerate();
    let part = |(place, part): (usize, &'static str)| match place % 2 {
        0 => part.to_owned(),
        _ => plain("", part).cell(&values),
    };
    parts.map(part).collect()
}

/// The number under a key, joined as in CSV; `None` if missing.
pub fn number(row: &Value, key: &str) -> Option<f64> {
    flat(row).get(key)?.as_f64()
}

pub fn each<'a>(rounds: &'a [Value], key: &'a str) -> impl Iterator<Item = f64> {
    rounds.iter().filter_map(move |row| number(row, key))
}

/// Merges rounds into one row. Counts under the given keys are added, objects of counts field by field. Other
/// numbers become their median, but `min…` the smallest, `max…` and `below…` the largest. Numbers and texts
/// that are equal in all rounds stay; other texts, and lists, are left out.
pub fn together(rounds: &[Value], counts: &[&str]) -> Value {
    merged(rounds, &|key| counts.contains(&key))
}

fn merged(rounds: &[Value], is_count: &dyn Fn(&str) -> bool) -> Value {
    let objects: Vec<_> = rounds.iter().filter_map(Value::as_object).collect();
    let keys: BTreeSet<&String> = objects.iter().flat_map(|row| row.keys()).collect();
    let of_key = |key: &String| {
        let values = objects.iter().filter_map(|row| row.get(key)).cloned();
        let values: Vec<Value> = values.filter(|value| !value.is_null()).collect();
        let numbers = || values.iter().filter_map(Value::as_f64);
        let value = match values.first() {
            Some(Value::Object(_)) if is_count(key) => merged(&values, &|_| true),
            Some(Value::Object(_)) => merged(&values, is_count),
            Some(Value::Number(_)) if is_count(key) => {
                values.iter().filter_map(Value::as_u64).sum::<u64>().into()
            }
            Some(Value::Number(_) | Value::String(_)) if values.iter().all(|v| *v == values[0]) => {
                values[0].clone()
            }
            Some(Value::Number(_)) if key.starts_with("min") => numbers().reduce(f64::min).into(),
            Some(Value::Number(_)) if key.starts_with("max") || key.starts_with("below") => {
                numbers().reduce(f64::max).into()
            }
            Some(Value::Number(_)) => median(numbers()).into(),
            Some(_) => return None,
            None => Value::Null,
        };
        Some((key.clone(), value))
    };
    Value::Object(keys.into_iter().filter_map(of_key).collect())
}

pub fn joined<const N: usize>(objects: [Value; N]) -> Value {
    let mut all = Map::new();
    for object in objects {
        if let Value::Object(fields) = object {
            all.extend(fields);
        }
    }
    Value::Object(all)
}

/// Flattens nested JSON objects into joined names. A list stays one value.
pub(crate) fn flat(row: &Value) -> BTreeMap<String, Value> {
    fn add(name: &str, value: &Value, values: &mut BTreeMap<String, Value>) {
        let Value::Object(fields) = value else {
            values.insert(name.to_owned(), value.clone());
            return;
        };
        for (key, value) in fields {
            let separator = if name.is_empty() { "" } else { "_" };
            add(&format!("{name}{separator}{key}"), value, values);
        }
    }
    let mut values = BTreeMap::new();
    add("", row, &mut values);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet() -> Sheet {
        let rows = [
            json!({ "name": "a", "good": true, "times": { "mean": 5e-9, "count": 3 }, "more": null, "ends": [1.0, 2.5] }),
            json!({ "name": "b, c", "good": false, "times": { "mean": f64::NAN, "count": 0 }, "more": 0.5 }),
        ];
        let columns = [
            word("name", "name"),
            power("mean s", "times_mean"),
            percent("more %", "more", 1),
            fixed("from", "ends", 1),
        ];
        Sheet::of("Two", &columns, rows.into())
    }

    #[test]
    fn csv_joins_nested_names_and_leaves_what_is_missing_empty() {
        let expected = "name,times_mean,more,ends,good,times_count\na,5e-9,,\"[1.0,2.5]\",true,3\n\"b, c\",,0.5,,false,0\n";
        assert_eq!(sheet().csv().expect("written"), expected);
    }

    #[test]
    fn a_csv_has_a_column_for_what_nobody_measured() {
        let rows = serde_json::json!([
            {"a": null, "b": {"x": 1, "y": null}, "c": {"x": null}},
            {"a": null, "b": null, "c": {"x": null}},
        ]);
        let rows = rows.as_array().expect("a list").clone();
        let csv = Sheet::of("", &[], rows).csv().expect("written");
        assert_eq!(csv, "a,b_x,b_y,c_x\n,1,,\n,,,\n");
    }

    #[test]
    fn rounds_become_one_row() {
        let rounds = [(1.0, 3, 9.0), (4.0, 4, 2.0), (2.0, 5, 5.0)].map(|(time, count, most)| {
            json!({ "us": { "p50": time, "max": most, "min": most }, "count": count, "of": { "a": count }, "size": count, "word": "a", "none": null })
        });
        // A whole number is only a count if it is declared as one.
        let expected = json!({
            "us": { "p50": 2.0, "max": 9.0, "min": 2.0 }, "count": 12, "of": { "a": 12 }, "size": 4.0, "word": "a", "none": null,
        });
        assert_eq!(together(&rounds, &["count", "of"]), expected);
        let mut dataset = Dataset::default();
        dataset.compare(
            "a",
            &rounds,
            &[("p50", "µs", "us_p50"), ("gone", "", "gone")],
        );
        assert_eq!(dataset.metrics.len(), 1);
        assert_eq!(dataset.metrics[0].rounds, [1.0, 4.0, 2.0]);
    }

    #[test]
    fn a_value_that_was_not_measured_is_a_dash_in_every_table() {
        let text = "Two\nname  mean s  more %        from\na     5.0e-9       -  1.0 to 2.5\nb, c       -    50.0           -\n";
        assert_eq!(sheet().text(), text);
        assert!(sheet().markdown().ends_with("| b, c | - | 50.0 | - |\n"));
    }
}
