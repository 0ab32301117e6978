//! Reference files: arbitrary bytes, and the file of the examples with changed cells and lines.

use std::path::Path;

use cdcr_scratch::Scratch;
use cdcr_test_cases::{Tally, replay, try_cases};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;

use crate::{FileTrajectory, Orientation, Trajectory};

const EXAMPLE: &str = include_str!("../../../../configs/path.csv");

const ODD: [&str; 22] = [
    "nan",
    "-nan",
    "inf",
    "-infinity",
    "1e308",
    "-1e308",
    "1.7e308",
    "1e309",
    "5e-324",
    "-0",
    "1e22",
    "",
    " ",
    "\"",
    "\"\"",
    "\"0.5\"",
    "0,5",
    "0x10",
    "1e",
    "١",
    "\u{feff}",
    "\0",
];

#[derive(Debug, Clone)]
enum Edit {
    Cell(usize, usize, String),
    Header(usize, &'static str),
    Row(usize, String),
    Remove(usize),
    Swap(usize, usize),
    Ends,
}

fn edit() -> impl Strategy<Value = Edit> {
    let row = || 0..20_usize;
    let numbers = || prop_oneof![1 => any::<f64>(), 5 => -1.0..1.0, 1 => Just(-4e9)];
    let cell = prop_oneof![
        1 => select(ODD.as_slice()).prop_map(str::to_owned),
        4 => numbers().prop_map(|x| x.to_string()),
    ];
    let name = select(vec!["", "t_s", "x_m", "qx", "qw", "time", "\u{feff}t_s"]);
    let line = prop_oneof![
        any::<String>(),
        Just("# remark".to_owned()),
        Just("1,2,3,4".to_owned())
    ];
    prop_oneof![
        8 => (row(), 0..8_usize, cell).prop_map(|(row, column, cell)| Edit::Cell(row, column, cell)),
        1 => (0..8_usize, name).prop_map(|(column, name)| Edit::Header(column, name)),
        1 => (row(), line).prop_map(|(row, line)| Edit::Row(row, line)),
        2 => row().prop_map(Edit::Remove),
        1 => (row(), row()).prop_map(|(a, b)| Edit::Swap(a, b)),
        1 => Just(Edit::Ends),
    ]
}

/// The first rows of the example, with or without orientations, after the edits.
fn edited(turned: bool, edits: &[Edit]) -> String {
    let (names, tail) = if turned {
        (",qx,qy,qz,qw", ",0,0,0.6,0.8")
    } else {
        ("", "")
    };
    let tails = [names].into_iter().chain(std::iter::repeat(tail));
    let rows = EXAMPLE.lines().take(20).zip(tails);
    let mut rows: Vec<Vec<String>> = rows
        .map(|(line, tail)| {
            format!("{line}{tail}")
                .split(',')
                .map(str::to_owned)
                .collect()
        })
        .collect();
    let mut end = "\n";
    for edit in edits {
        let count = rows.len();
        match edit {
            Edit::Cell(row, column, cell) => set(&mut rows[row % count], *column, cell),
            Edit::Header(column, name) => set(&mut rows[0], *column, name),
            Edit::Row(row, line) => rows.insert(row % count, vec![line.clone()]),
            Edit::Remove(row) => drop(rows.remove(row % count)),
            Edit::Swap(a, b) => rows.swap(a % count, b % count),
            Edit::Ends => end = "\r\n",
        }
    }
    let lines: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
    lines.join(end) + end
}

fn set(row: &mut [String], column: usize, cell: &str) {
    let count = row.len();
    if count > 0 {
        cell.clone_into(&mut row[column % count]);
    }
}

/// Checks that an accepted file gives finite positions and unit orientations at any time. Returns whether it
/// was accepted.
fn evaluate(text: &str) -> bool {
    let file = match FileTrajectory::parse(Path::new("path.csv"), text) {
        Ok(file) => file,
        Err(error) => {
            assert!(error.to_string().starts_with("path.csv"), "{error}");
            return false;
        }
    };
    let knots_s = file.knots_s().unwrap();
    let end_s = file.duration_s();
    assert!(
        knots_s.len() >= 2 && knots_s[0] == 0.0 && end_s.is_finite(),
        "{knots_s:?}"
    );
    assert!(knots_s.is_sorted_by(|a, b| a < b), "{knots_s:?}");
    let between_s = knots_s
        .windows(2)
        .map(|pair| pair[0] + 0.3 * (pair[1] - pair[0]));
    let outside_s = [-1.0, f64::MIN, f64::MAX, end_s + 1.0];
    for time_s in knots_s.iter().copied().chain(between_s).chain(outside_s) {
        let position_m = file.position_m(time_s);
        assert!(
            position_m.iter().all(|x| x.is_finite()),
            "{position_m:?} at {time_s} s"
        );
        if let Orientation::Full(quaternion) = file.orientation(time_s) {
            let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!((norm - 1.0).abs() < 1e-9, "{quaternion:?}");
        }
    }
    true
}

#[test]
fn any_bytes_are_a_reference_file_or_an_error() {
    replay(concat!(env!("CARGO_MANIFEST_DIR"), "/corpus"), |bytes| {
        evaluate(&String::from_utf8_lossy(bytes));
    });
    let folder = Scratch::temporary().unwrap();
    let path = folder.path().join("any.csv");
    let table = "(t_s,x_m,y_m,z_m\n)?([0-9e.,\"#\r\n-]{0,40}\n){0,8}".prop_map(String::into_bytes);
    let contents = prop_oneof![vec(any::<u8>(), 0..300), table];
    try_cases(1024, contents, |bytes| {
        std::fs::write(&path, &bytes).unwrap();
        let read = FileTrajectory::read(&path);
        match std::str::from_utf8(&bytes) {
            Ok(text) => assert_eq!(evaluate(text), read.is_ok()),
            Err(_) => assert!(read.is_err(), "no text, but a reference"),
        }
    });
}

#[test]
fn an_edited_reference_file_is_refused_or_is_finite() {
    let tally = Tally::default();
    try_cases(
        2048,
        (any::<bool>(), vec(edit(), 1..4)),
        |(turned, edits)| {
            tally.count("reference file", evaluate(&edited(turned, &edits)));
        },
    );
    tally.both_at_least("reference file", 0.15);
}
