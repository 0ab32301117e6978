//! The tables of `docs/robustness.md` and `docs/tuning.md` and the plot of the rates match the committed
//! results, which do not describe the machine. `CDCR_GENERATE=1` writes them.

use std::path::{Path, PathBuf};

use cdcr_bench::dataset::Sheet;
use cdcr_bench::{rate, robustness};
use serde_json::Value;

/// Markers at the begin and the end of a table in the document.
const MARKS: (&str, &str) = (
    "<!-- generated from ",
    "<!-- end of what is generated -->\n",
);
const HOW: &str = "CDCR_GENERATE=1 cargo test -p cdcr-bench results";

fn rows(document: &Value, key: &str) -> Vec<Value> {
    document[key].as_array().expect("rows").clone()
}

/// The table of a result, or of one knob of it, in a document.
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

/// A committed result below `docs`. With `CDCR_GENERATE`, its description of the machine is removed.
pub(crate) fn result(file: &str) -> Value {
    let file = docs().join(file);
    let json = std::fs::read_to_string(&file).expect("the result");
    let mut document: Value = serde_json::from_str(&json).expect("one object");
    let machine = document.as_object_mut().unwrap().remove("environment");
    if machine.is_some() {
        assert!(generates(), "{} describes a machine: {HOW}", file.display());
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
    let picture = rows(&result("results/rate.json"), "default");
    let picture = rate::picture(&picture).expect("a picture").svg;
    for (name, contained) in [
        ("robustness.md", "| 30 µm of noise |"),
        ("tuning.md", "| smooth |"),
        ("images/results-rate.svg", "<svg"),
    ] {
        let place = docs().join(name);
        let text = std::fs::read_to_string(&place).expect("the document");
        let made = if contained == "<svg" {
            picture.clone()
        } else {
            with_tables(&text)
        };
        assert!(made.contains(contained), "the tables of {name}");
        if generates() {
            std::fs::write(&place, &made).expect("written");
        } else {
            assert!(made == text, "docs/{name} is not up to date: {HOW}");
        }
    }
}

/// A document with regenerated tables.
fn with_tables(text: &str) -> String {
    let (begin, end) = MARKS;
    let mut parts = text.split(begin);
    let mut made = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (file, rest) = part.split_once(" -->\n").expect("a file and its table");
        let (_, rest) = rest.split_once(end).expect("an end of the table");
        let (name, knob) = file
            .split_once(' ')
            .map_or((file, None), |(name, knob)| (name, Some(knob)));
        let table = table(name, knob, &result(name)).markdown();
        made += &[begin, file, " -->\n", table.trim_start(), end, rest].concat();
    }
    made
}
