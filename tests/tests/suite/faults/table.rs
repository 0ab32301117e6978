//! The table of faults says what is tested: each row names a test that is there.

use std::path::Path;

use cdcr_daemon::exit::ExitCause;

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// Rows of the table under a heading, cell by cell.
fn rows(heading: &str) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(workspace().join("docs/faults.md")).unwrap();
    let section = text.split_once(&format!("\n## {heading}\n")).unwrap().1;
    let section = section.split("\n## ").next().unwrap();
    let lines = section.lines().filter(|line| line.starts_with('|'));
    let cells = |line: &str| {
        let cells = line.trim_matches('|').split('|');
        cells.map(|cell| cell.trim().to_owned()).collect()
    };
    // Without head and rule.
    lines.skip(2).map(cells).collect()
}

/// What is in `backticks`.
fn quoted(cell: &str) -> Vec<&str> {
    cell.split('`').skip(1).step_by(2).collect()
}

#[test]
fn every_row_names_a_test_that_is_there() {
    let rows = rows("The table");
    assert!(rows.len() >= 20, "{} rows", rows.len());
    for row in rows {
        assert_eq!(row.len(), 6, "{row:?}");
        assert!(row.iter().all(|cell| !cell.is_empty()), "{row:?}");
        let tests = quoted(&row[5]);
        assert!(!tests.is_empty(), "no test: {row:?}");
        for test in tests {
            let (file, function) = test.split_once("::").unwrap();
            // Of this folder, of its neighbours, or of a unit.
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

#[test]
fn every_end_has_its_row() {
    let rows = rows("Exit statuses");
    let statuses: Vec<u8> = rows.iter().filter_map(|row| row[0].parse().ok()).collect();
    let expected = ExitCause::ALL.map(ExitCause::code);
    assert_eq!(statuses, expected);
}
