//! Result of a benchmark: rows under columns, plots, metrics, raw latencies. Only this module formats them as text,
//! Markdown, CSV and JSON. A column names its value by the keys that lead to it, joined by `_`.

mod declaration;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::ops::RangeInclusive;

use anyhow::Result;
use cdcr_chart::Panel;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

pub use declaration::{Column, Declaration, Plot, Table};

use crate::metric::{Better, Metric, median};

#[derive(Default)]
pub struct Dataset {
    pub name: &'static str,
    pub declaration: Declaration,
    /// The most important remark, one sentence.
    pub note: String,
    pub warns: bool,
    /// Keys of the JSON in addition to those of the tables.
    pub facts: Map<String, Value>,
    pub metrics: Vec<Metric>,
    /// Rows of the targets that are not for a metric: see [`Self::target`].
    pub targets: Vec<Value>,
    /// All measured latencies, from which other percentiles can be computed.
    pub recordings: Vec<Recording>,
}

#[derive(Debug, Clone)]
pub struct Recording {
    /// What was measured: words joined by dots, like `none.daemon.response`.
    pub tag: String,
    /// After the start of the run \[s\].
    pub start_s: f64,
    pub duration_s: f64,
    pub histogram_ns: Histogram<u64>,
}

impl Dataset {
    pub fn new(name: &'static str, declaration: &str) -> Self {
        Self {
            name,
            declaration: toml::from_str(declaration).expect("a declaration"),
            ..Self::default()
        }
    }

    /// Adds a metric of which less is better; nothing if no round measured it.
    pub fn lower(&mut self, name: String, unit: &str, rounds: impl IntoIterator<Item = f64>) {
        self.add_metric(Metric::new(name, unit, Better::Lower, rounds));
    }

    pub fn add_metric(&mut self, metric: Metric) {
        let measured = Some(metric).filter(|metric| !metric.rounds.is_empty());
        self.metrics.extend(measured);
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

    pub fn all_targets(&self) -> Vec<Value> {
        let mut all = Self::default();
        for target in &self.declaration.targets {
            let split = target.metric.split_once('*');
            let (begin, end) = split.unwrap_or((&target.metric, ""));
            let found = self.metrics.iter().filter_map(|metric| {
                let case = metric.name.strip_prefix(begin)?.strip_suffix(end)?;
                let is_it = case.is_empty() || target.metric.contains('*');
                is_it.then_some(())?;
                Some((metric.median()?, json!(metric.range()), case.to_owned()))
            });
            let worst = found.max_by(|one, other| one.0.total_cmp(&other.0));
            let words = [&*target.what, &target.bound, &target.unit];
            all.target(words, worst, f64::MIN..=target.most);
        }
        all.targets.extend_from_slice(&self.targets);
        all.targets
    }

    pub(crate) fn table(&mut self, name: &str) -> &mut Table {
        let mut tables = self.declaration.tables.iter_mut();
        let found = tables.find(|table| table.name == name);
        found.unwrap_or_else(|| panic!("{} declares no table {name}", self.name))
    }

    /// Adds the declared metrics of a row of a table from its rounds. Shares with the unit % are scaled by 100.
    pub fn compare(&mut self, table: &str, row: &Value, rounds: &[Value]) {
        let table = self.table(table);
        let metric = |(name, unit, key): &(String, String, String)| {
            let factor = if unit == "%" { 100.0 } else { 1.0 };
            let values = each(rounds, key).map(|value| factor * value);
            let better = [Better::Lower, Better::Higher][usize::from(table.higher.contains(name))];
            let name = filled(&format!("{}/{name}", table.path), row);
            Metric::new(name, unit, better, values)
        };
        let metrics: Vec<Metric> = table.metrics.iter().map(metric).collect();
        for metric in metrics {
            self.add_metric(metric);
        }
    }

    /// Merges the rounds of one row of a table, see [`together`], and adds its metrics.
    pub fn merge(&mut self, table: &str, rounds: &[Value]) -> Value {
        let row = together(rounds, &self.table(table).counts);
        self.compare(table, &row, rounds);
        row
    }

    /// Adds a table whose rows every round measured in the same order. Adds nothing without measurements.
    pub(crate) fn add_rounds(&mut self, table: &str, rounds: &[Vec<Value>]) {
        let of_rows = by_rows(rounds).into_iter();
        let rows = of_rows.map(|rounds| self.merge(table, &rounds));
        let rows: Vec<Value> = rows.collect();
        if !rows.is_empty() {
            self.add(table, rows);
        }
    }

    pub fn add(&mut self, table: &str, rows: Vec<Value>) {
        self.add_titled(table, &[], rows);
    }

    /// Adds the rows of a declared table, with null for what was not measured. Words replace the pairs of braces in its title.
    pub fn add_titled(&mut self, table: &str, words: &[&str], rows: Vec<Value>) {
        let table = self.table(table);
        debug_assert_eq!(table.unknown_key(&rows), None, "a key of no row");
        for word in words {
            table.title = table.title.replacen("{}", word, 1);
        }
        table.rows = Some(rows);
    }

    /// Draws a declared plot; nothing without panels.
    pub fn plot(&mut self, name: &str, panels: &[Panel]) -> Result<()> {
        let mut plots = self.declaration.plots.iter_mut();
        let plot = plots.find(|declared| declared.name == name);
        let plot = plot.unwrap_or_else(|| panic!("{} declares no plot {name}", self.name));
        if !panels.is_empty() {
            plot.svg = cdcr_chart::svg(plot.size, panels)?;
        }
        Ok(())
    }

    pub fn plots(&self) -> impl Iterator<Item = &Plot> {
        let plots = self.declaration.plots.iter();
        plots.filter(|plot| !plot.svg.is_empty())
    }

    fn filled_tables(&self) -> impl Iterator<Item = (&Table, &Vec<Value>)> {
        let tables = self.declaration.tables.iter();
        tables.filter_map(|table| Some((table, table.rows.as_ref()?)))
    }

    pub fn rows(&self, table: &str) -> &[Value] {
        let mut tables = self.filled_tables();
        let found = tables.find(|(declared, _)| declared.name == table);
        found.map_or(&[], |(_, rows)| rows)
    }

    pub fn fact(&mut self, key: &str, value: impl Into<Value>) {
        self.facts.insert(key.to_owned(), value.into());
    }

    pub fn json(&self) -> Map<String, Value> {
        let mut json = self.facts.clone();
        let tables = self.filled_tables().filter(|(table, _)| table.json);
        json.extend(tables.map(|(table, rows)| (table.name.clone(), rows.clone().into())));
        json
    }

    /// The tables that have a title and rows, as people read them.
    pub fn tables(&self) -> impl Iterator<Item = ShownTable> {
        let is_shown =
            |(table, rows): &(&Table, &Vec<_>)| !(table.title.is_empty() || rows.is_empty());
        let shown = self.filled_tables().filter(is_shown);
        shown.map(|(table, _)| table.shown())
    }

    pub fn shown(&self) -> Value {
        json!(self.tables().collect::<Vec<_>>())
    }

    pub fn text(&self) -> String {
        self.joined(ShownTable::text)
    }

    pub fn markdown(&self) -> String {
        self.joined(ShownTable::markdown)
    }

    fn joined(&self, form: fn(&ShownTable) -> String) -> String {
        let note = Some(format!("{}\n", self.note)).filter(|_| !self.note.is_empty());
        let texts = self.tables().map(|table| form(&table)).chain(note);
        texts.collect::<Vec<_>>().join("\n")
    }

    pub fn csv(&self) -> impl Iterator<Item = (&str, Result<String>)> {
        let tables = self.filled_tables();
        tables.filter_map(|(table, rows)| Some((table.file.as_deref()?, table.csv(rows))))
    }
}

impl Table {
    /// The key of a column that no row has, neither with a value nor as null or in an object that is null.
    fn unknown_key(&self, rows: &[Value]) -> Option<&str> {
        let fields: Vec<_> = rows.iter().flat_map(flat).collect();
        let is_known = |key: &str| {
            let is_it = |name: &str, value: &Value| value.is_null() && key.starts_with(name);
            (fields.iter()).any(|(name, value)| name == key || is_it(name, value))
        };
        let mut keys = self.columns.iter().map(|column| &*column.key);
        keys.find(|key| !fields.is_empty() && !is_known(key))
    }

    /// Every value of the rows, beginning with the columns of the table.
    fn csv(&self, rows: &[Value]) -> Result<String> {
        let rows: Vec<_> = rows.iter().map(flat).collect();
        let keys: BTreeSet<&String> = rows.iter().flat_map(BTreeMap::keys).collect();
        // A key that is null in all rows is a column; an object that is null in some rows is not.
        let is_object = |key: &str| {
            let fields = format!("{key}_");
            keys.iter().any(|other| other.starts_with(&fields))
                && (rows.iter()).all(|row| row.get(key).is_none_or(Value::is_null))
        };
        let mut known: Vec<&str> = keys.iter().map(|key| key.as_str()).collect();
        known.retain(|key| !is_object(key));
        let shown = self.columns.iter().map(|column| &*column.key);
        let mut heads: Vec<&str> = shown.filter(|key| known.contains(key)).collect();
        known.retain(|key| !heads.contains(key));
        heads.extend(known);
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

    fn shown(&self) -> ShownTable {
        let columns = || self.columns.iter();
        let cells = |row: &Value| {
            let values = flat(row);
            let cell = |column: &Column| column.cell(values.get(&column.key));
            columns().map(cell).collect()
        };
        ShownTable {
            title: self.title.clone(),
            heads: columns().map(|column| column.head.clone()).collect(),
            words: columns().map(Column::is_word).collect(),
            lines: self.rows.iter().flatten().map(cells).collect(),
        }
    }
}

/// A table as people read it: the JSON of every result has them, and those of the documents are made from them.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ShownTable {
    pub title: String,
    pub heads: Vec<String>,
    /// Whether a column has words, which are left-aligned.
    pub words: Vec<bool>,
    pub lines: Vec<Vec<String>>,
}

impl ShownTable {
    pub fn text(&self) -> String {
        let lines = || [&self.heads].into_iter().chain(&self.lines);
        let width = |place: usize| lines().map(|line| line[place].chars().count()).max();
        let mut text = format!("{}\n", self.title);
        for line in lines() {
            let mut padded = String::new();
            for (place, cell) in line.iter().enumerate() {
                let width = width(place).unwrap_or(0);
                let _ = if self.words[place] {
                    write!(padded, "{cell:<width$}  ")
                } else {
                    write!(padded, "{cell:>width$}  ")
                };
            }
            let _ = writeln!(text, "{}", padded.trim_end());
        }
        text
    }

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
pub(crate) fn filled(name: &str, row: &Value) -> String {
    let values = flat(row);
    let parts = name.split(['{', '}']).enumerate();
    let part = |(place, part): (usize, &str)| match place % 2 {
        0 => part.to_owned(),
        _ => Column::default().cell(values.get(part)),
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
pub fn together(rounds: &[Value], counts: &[String]) -> Value {
    merged(rounds, &|key| counts.iter().any(|count| count == key))
}

fn merged(rounds: &[Value], is_count: &dyn Fn(&str) -> bool) -> Value {
    let objects: Vec<_> = rounds.iter().filter_map(Value::as_object).collect();
    let keys: BTreeSet<&String> = objects.iter().flat_map(|row| row.keys()).collect();
    let of_key = |key: &String| {
        let values = objects.iter().filter_map(|row| row.get(key)).cloned();
        let values: Vec<Value> = values.filter(|value| !value.is_null()).collect();
        let numbers = || values.iter().filter_map(Value::as_f64);
        let is = |starts: &[&str]| starts.iter().any(|start| key.starts_with(start));
        let is_equal = || values.iter().all(|value| *value == values[0]);
        let value = match values.first() {
            Some(Value::Object(_)) if is_count(key) => merged(&values, &|_| true),
            Some(Value::Object(_)) => merged(&values, is_count),
            Some(Value::Number(_)) if is_count(key) => (numbers().sum::<f64>() as u64).into(),
            Some(Value::Number(_) | Value::String(_)) if is_equal() => values[0].clone(),
            Some(Value::Number(_)) if is(&["min"]) => numbers().reduce(f64::min).into(),
            Some(Value::Number(_)) if is(&["max", "below"]) => numbers().reduce(f64::max).into(),
            Some(Value::Number(_)) => median(numbers()).into(),
            Some(_) => return None,
            None => Value::Null,
        };
        Some((key.clone(), value))
    };
    Value::Object(keys.into_iter().filter_map(of_key).collect())
}

pub fn joined<const N: usize>(objects: [Value; N]) -> Value {
    let fields = |object| serde_json::from_value::<Map<_, _>>(object).unwrap_or_default();
    objects.into_iter().flat_map(fields).collect()
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

    fn dataset() -> Dataset {
        let mut dataset = Dataset::new(
            "two",
            r#"
            heading = "Two"
            explanation = ""
            [[tables]]
            name = "both"
            title = "Two"
            file = "both"
            counts = ["count", "of"]
            path = "{name}"
            metrics = [["mean", "µs", "times_mean"], ["gone", "", "gone"]]
            columns = [
              ["name", "name", "word"], ["mean s", "times_mean", "power"], ["more %", "more", "percent 1"],
              ["from", "ends", "fixed 1"],
            ]
            "#,
        );
        let rows = json!([
            { "name": "a", "good": true, "times": { "mean": 5e-9, "count": 3 }, "more": null, "ends": [1.0, 2.5], "x": null },
            { "name": "b, c", "good": false, "times": { "mean": f64::NAN, "count": 0 }, "more": 0.5, "x": { "y": null } },
        ]);
        dataset.add("both", rows.as_array().expect("a list").clone());
        dataset
    }

    #[test]
    fn a_value_that_was_not_measured_is_empty_in_a_csv_and_a_dash_in_every_table() {
        let dataset = dataset();
        let (file, csv) = dataset.csv().next().expect("a file");
        let expected = "name,times_mean,more,ends,good,times_count,x_y\na,5e-9,,\"[1.0,2.5]\",true,3,\n\"b, c\",,0.5,,false,0,\n";
        assert_eq!((file, &*csv.expect("written")), ("both", expected));
        let text = "Two\nname  mean s  more %        from\na     5.0e-9       -  1.0 to 2.5\nb, c       -    50.0           -\n";
        assert_eq!(dataset.text(), text);
        assert!(dataset.markdown().ends_with("| b, c | - | 50.0 | - |\n"));
        let row = json!({ "name": "a", "times": null, "mores": 1, "ends": null });
        let unknown = dataset.declaration.tables[0].unknown_key(&[row]);
        assert_eq!(unknown, Some("more"));
    }

    #[test]
    fn rounds_become_one_row() {
        let rounds = [(1.0, 3, 9.0), (4.0, 4, 2.0), (2.0, 5, 5.0)].map(|(mean, count, most)| {
            json!({ "times": { "mean": mean, "max": most, "min": most }, "count": count, "of": { "a": count }, "size": count, "name": "a", "none": null })
        });
        // A whole number is only a count if it is declared as one.
        let expected = json!({
            "times": { "mean": 2.0, "max": 9.0, "min": 2.0 }, "count": 12, "of": { "a": 12 }, "size": 4.0, "name": "a", "none": null,
        });
        let mut dataset = dataset();
        assert_eq!(dataset.merge("both", &rounds), expected);
        let metrics = dataset.metrics.into_iter();
        let metrics: Vec<_> = metrics.map(|metric| (metric.name, metric.rounds)).collect();
        assert_eq!(metrics, [("a/mean".to_owned(), vec![1.0, 4.0, 2.0])]);
    }
}
