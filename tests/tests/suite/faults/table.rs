//! `docs/faults.md` matches the tests: each fault names existing tests.

use std::path::Path;

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

fn page() -> String {
    std::fs::read_to_string(workspace().join("docs/faults.md")).unwrap()
}

/// Fields of a fault, in this order.
const FIELDS: [&str; 5] = ["Detection", "Reaction", "What you see", "Recovery", "Tests"];

/// The text of a field of a fault, up to the next field.
fn field<'f>(fault: &'f str, name: &str) -> &'f str {
    let (_, text) = fault
        .split_once(&format!("\n- **{name}**: "))
        .unwrap_or_else(|| panic!("no {name}: {fault}"));
    text.split("\n- **").next().unwrap()
}

/// The texts in `backticks`.
fn quoted(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

#[test]
fn every_fault_names_a_test_that_is_there() {
    let page = page();
    let (faults, _) = page.split_once("\n## Exit statuses\n").unwrap();
    let faults: Vec<_> = faults.split("\n### ").skip(1).collect();
    assert!(faults.len() >= 54, "{} faults", faults.len());
    for fault in faults {
        for name in FIELDS {
            assert!(!field(fault, name).trim().is_empty(), "{name}: {fault}");
        }
        assert_eq!(fault.matches("\n- **").count(), FIELDS.len(), "{fault}");
        let tests = quoted(field(fault, "Tests"));
        assert!(!tests.is_empty(), "no test: {fault}");
        for test in tests {
            let (file, function) = test.split_once("::").unwrap();
            // A file of this folder or of a neighbour, or a unit test.
            let folder = match file.split_once('/') {
                None => "tests/tests/suite/faults/",
                Some(("daemon" | "controller" | "client", _)) => "",
                Some(_) => "tests/tests/suite/",
            };
            let path = workspace().join(format!("{folder}{file}.rs"));
            let source = std::fs::read_to_string(&path).unwrap_or_default();
            let is_there = source.contains(&format!("#[test]\nfn {function}()"));
            assert!(is_there, "{} has no test {function}", path.display());
        }
    }
}
