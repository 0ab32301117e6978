//! The tables of `docs/results.md` and of the pages beside it, and the plot of the rates, match the committed
//! results, which do not describe the machine. `CDCR_GENERATE=1` writes them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use cdcr_bench::dataset::ShownTable;
use cdcr_bench::rate;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::list;

/// Markers at the begin and the end of a table in the document.
const BEGIN: &str = "<!-- generated from ";
const END: &str = "<!-- end of what is generated -->\n";
const HOW: &str = "CDCR_GENERATE=1 cargo test -p cdcr-bench results";

/// A part of a table of a result: rows with one of these words in a column, and some columns.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Choice {
    /// One of those in a report of `all`.
    benchmark: Option<String>,
    /// Begin of its title.
    title: String,
    #[serde(default)]
    hides_title: bool,
    #[serde(default)]
    rows: BTreeMap<String, Vec<String>>,
    /// All if empty. Of several columns with the same head the first, or the second as "head#2".
    #[serde(default)]
    columns: Vec<String>,
    /// Other heads of chosen columns.
    #[serde(default)]
    heads: BTreeMap<String, String>,
}

impl Choice {
    fn select(&self, result: &Value) -> ShownTable {
        let tables = match &self.benchmark {
            Some(name) => &result["tables"][name],
            None => &result["tables"],
        };
        let tables: Vec<ShownTable> = serde_json::from_value(tables.clone()).expect("tables");
        let mut tables = tables.into_iter();
        let table = tables.find(|table| table.title.starts_with(&self.title));
        let mut table = table.unwrap_or_else(|| panic!("no table {:?}", self.title));
        let place = |wanted: &String| {
            let (head, number) = wanted.split_once('#').unwrap_or((wanted, "1"));
            let mut places = (0..table.heads.len()).filter(|at| table.heads[*at] == head);
            let place = places.nth(number.parse::<usize>().expect("a number") - 1);
            place.unwrap_or_else(|| panic!("no column {wanted:?}"))
        };
        let rows = self.rows.iter();
        let wanted: Vec<_> = rows.map(|(head, of)| (place(head), of)).collect();
        let columns: Vec<usize> = match &self.columns[..] {
            [] => (0..table.heads.len()).collect(),
            heads => heads.iter().map(place).collect(),
        };
        let is_wanted = |line: &Vec<String>| wanted.iter().all(|(at, of)| of.contains(&line[*at]));
        table.lines.retain(is_wanted);
        let has_rows = !table.lines.is_empty();
        assert!(has_rows, "no row of {:?} is chosen", self.title);
        let kept = |cells: &[String]| columns.iter().map(|at| cells[*at].clone()).collect();
        let heads: Vec<String> = kept(&table.heads);
        let renamed = |head| self.heads.get(&head).cloned().unwrap_or(head);
        ShownTable {
            heads: heads.into_iter().map(renamed).collect(),
            words: columns.iter().map(|at| table.words[*at]).collect(),
            lines: table.lines.iter().map(|line| kept(line)).collect(),
            title: [table.title, String::new()][usize::from(self.hides_title)].clone(),
        }
    }
}

/// A committed result below `docs`. With `CDCR_GENERATE`, what no document needs is removed: the description of
/// the machine, and of the report of `all` everything but its tables.
pub(crate) fn result(file: &str) -> Value {
    let file = docs().join(file);
    let json = std::fs::read_to_string(&file).expect("the result");
    let mut document: Value = serde_json::from_str(&json).expect("one object");
    if document.get("environment").is_some() {
        assert!(generates(), "{} describes a machine: {HOW}", file.display());
        if let Some(Value::Object(tables)) = document.get_mut("tables") {
            tables.remove("robustness");
            document = json!({ "tables": document["tables"] });
        }
        document.as_object_mut().unwrap().remove("environment");
        std::fs::write(&file, format!("{document}\n")).expect("written");
    }
    document
}

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs")
}

fn generates() -> bool {
    std::env::var_os("CDCR_GENERATE").is_some()
}

/// The files below `docs` that are generated from a committed result are up to date.
#[test]
fn documents_hold_what_is_made_from_the_json_beside_them() {
    let picture = rate::picture(list(&result("results/rate.json"), "default")).expect("a picture");
    for (name, contained) in [
        ("results.md", "<!-- generated from results/report.json"),
        ("paper.md", "| kpso-refined |"),
        ("realtime.md", "| + SCHED_FIFO |"),
        ("robustness.md", "| 30 µm of noise |"),
        ("tuning.md", "| smooth |"),
        ("images/results-rate.svg", "<svg"),
    ] {
        let place = docs().join(name);
        let text = std::fs::read_to_string(&place).expect("the document");
        let made = match contained {
            "<svg" => picture.clone(),
            _ => with_tables(&text),
        };
        assert!(made.contains(contained), "the tables of {name}");
        if generates() {
            std::fs::write(&place, &made).expect("written");
        } else {
            assert!(made == text, "docs/{name} is not up to date: {HOW}");
        }
    }
}

/// A document with regenerated tables. No other table has a column of numbers.
fn with_tables(text: &str) -> String {
    let mut parts = text.split(BEGIN);
    let mut made = parts.next().unwrap_or_default().to_owned();
    let is_typed = |text: &str| text.contains("--:|") || text.contains("--: |");
    assert!(!is_typed(&made), "numbers are typed in a table: {HOW}");
    for part in parts {
        let (begin, rest) = part.split_once(" -->\n").expect("a file and its table");
        let (_, rest) = rest.split_once(END).expect("an end of the table");
        assert!(
            !is_typed(rest),
            "numbers are typed in a table after {begin}"
        );
        let (file, choice) = begin.split_once(' ').expect("a file and a choice");
        let choice: Choice = serde_json::from_str(choice).expect("a choice");
        let table = choice.select(&result(file)).markdown();
        made += &[BEGIN, begin, " -->\n", table.trim_start(), END, rest].concat();
    }
    made
}
