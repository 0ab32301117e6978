//! The tables of `docs/robustness.md` and `docs/tuning.md` and the picture of the rates are those of the committed results, which tell nothing of the machine; `CDCR_GENERATE=1` writes them.

use std::fmt::Write as _;
use std::path::Path;

use cdcr_bench::dataset::Sheet;
use cdcr_bench::{rate, robustness};
use serde_json::Value;

/// Where a table begins in the document, and where it ends.
const MARKS: (&str, &str) = (
    "<!-- generated from ",
    "<!-- end of what is generated -->\n",
);
const HOW: &str = "CDCR_GENERATE=1 cargo test -p cdcr-bench results";

fn rows(document: &Value, key: &str) -> Vec<Value> {
    document[key].as_array().expect("rows").clone()
}

/// The table that stands for a result, or for one knob of it, in a document.
fn table(file: &str, knob: Option<&str>, document: &Value) -> Sheet {
    match (file, knob) {
        ("results/robustness.json", None) => robustness::comparison(&rows(document, "scenarios")),
        ("results/robustness.json", Some("parts")) => {
            robustness::parts(&rows(document, "scenarios"))
        }
        ("results/tuning.json", Some(knob)) => robustness::knob(knob, &rows(document, "knobs")),
        other => panic!("no table is made from {other:?}"),
    }
}

/// A committed result. What `cdcr-bench` wrote of the machine is taken away where results are generated.
fn result(file: &Path) -> Value {
    let json = std::fs::read_to_string(file).expect("the result");
    let mut document: Value = serde_json::from_str(&json).expect("one object");
    let machine = document.as_object_mut().unwrap().remove("environment");
    if machine.is_some() {
        assert!(generates(), "{} describes a machine: {HOW}", file.display());
        std::fs::write(file, format!("{document}\n")).expect("written");
    }
    document
}

fn generates() -> bool {
    std::env::var_os("CDCR_GENERATE").is_some()
}

#[test]
fn the_tables_of_the_results_are_made_from_the_json_beside_them() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    for (name, row) in [
        ("robustness.md", "| 30 µm of noise |"),
        ("tuning.md", "| smooth |"),
    ] {
        check(&docs, name, row);
    }
}

#[test]
fn the_picture_of_the_rates_is_drawn_from_its_rows() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let place = docs.join("images/results-rate.svg");
    let rows = rows(&result(&docs.join("results/rate.json")), "default");
    let drawn = rate::picture(&rows).expect("a picture").svg;
    if generates() {
        std::fs::write(&place, drawn).expect("written");
        return;
    }
    let picture = std::fs::read_to_string(&place).expect("the picture");
    assert!(
        picture == drawn,
        "{} is not up to date: {HOW}",
        place.display()
    );
}

/// That the tables of a document, of which one has this `row`, are up to date.
fn check(docs: &Path, name: &str, row: &str) {
    let place = docs.join(name);
    let text = std::fs::read_to_string(&place).expect("the document");
    let mut parts = text.split(MARKS.0);
    let mut made = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (file, rest) = part.split_once(" -->\n").expect("a file and its table");
        let (_, rest) = rest.split_once(MARKS.1).expect("an end of the table");
        let (name, knob) = match file.split_once(' ') {
            Some((name, knob)) => (name, Some(knob)),
            None => (file, None),
        };
        let table = table(name, knob, &result(&docs.join(name))).markdown();
        let (begin, end) = MARKS;
        write!(made, "{begin}{file} -->\n{}{end}{rest}", table.trim_start())
            .expect("a string grows");
    }
    assert!(made.contains(row), "the tables of {name}");
    if generates() {
        std::fs::write(&place, &made).expect("written");
        return;
    }
    assert!(made == text, "docs/{name} is not up to date: {HOW}");
}
