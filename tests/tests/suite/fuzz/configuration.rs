//! Configurations: arbitrary text, and the default one with changed lines, values and characters.

use std::path::Path;

use cdcr_daemon::config::{Config, DEFAULT_TEXT, Validated};
use cdcr_shared_types::codes::{Interpolation, RequestKind};
use cdcr_shared_types::{ReferenceChunk, ReferencePoint, Request};
use cdcr_test_cases::{Tally, replay, try_cases};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;

use crate::fuzz::rig::{Rig, simulated};

/// Values that are rarely valid.
const ODD: [&str; 30] = [
    "nan",
    "-nan",
    "inf",
    "-inf",
    "-0",
    "-0.0",
    "1e308",
    "-1e308",
    "1e309",
    "5e-324",
    "9223372036854775807",
    "-9223372036854775808",
    "99999999999999999999999999",
    "0x7fff_ffff_ffff_ffff",
    "4294967296",
    "true",
    "\"\"",
    "\"\\u0000\"",
    "\"\\uD800\"",
    "'🤖'",
    "\"\"\"\n\n\"\"\"",
    "[]",
    "[[]]",
    "[[0.1, 0.2], [0.1], []]",
    "[nan, inf]",
    "{}",
    "{ a.b.c = 1, a.b.d = {} }",
    "1979-05-27T07:32:00Z",
    "",
    "=",
];

#[derive(Debug, Clone)]
enum Edit {
    /// Another value behind the `=` of a line.
    Value(usize, String),
    /// A slightly larger or smaller number.
    Scale(usize, f64),
    Double(usize),
    Remove(usize),
    Swap(usize, usize),
    Insert(usize, String),
    Character(usize, char),
    Cut(usize),
}

fn deep() -> impl Strategy<Value = String> {
    let depth = prop_oneof![1..100_usize, 100..20_000_usize];
    (0..5, depth).prop_map(|(kind, depth)| match kind {
        0 => "[".repeat(depth),
        1 => format!("{}{}", "[".repeat(depth), "]".repeat(depth)),
        2 => format!("{}1{}", "{ a = ".repeat(depth), " }".repeat(depth)),
        3 => "9".repeat(depth),
        _ => format!("\"{}\"", "ü".repeat(depth)),
    })
}

fn line() -> impl Strategy<Value = String> {
    let table = select(vec![
        "[robot]",
        "[[robot.sections]]",
        "[robot.sections]",
        "[link.kind]",
    ]);
    let dotted = (1..20_000_usize).prop_map(|count| format!("a{} = 1", ".a".repeat(count)));
    prop_oneof![
        4 => table.prop_map(str::to_owned),
        1 => dotted.clone(),
        1 => dotted.prop_map(|key| format!("[{}]", &key[..key.len() - 4])),
        4 => any::<String>(),
        2 => deep().prop_map(|value| format!("[safety]\nclearance_fault_m = {value}")),
    ]
}

fn edit() -> impl Strategy<Value = Edit> {
    let at = || any::<u16>().prop_map(usize::from);
    let odd = select(ODD.as_slice()).prop_map(str::to_owned);
    let number = any::<f64>().prop_map(|x| format!("{x:e}"));
    let whole = (-2..2000_i64).prop_map(|x| x.to_string());
    prop_oneof![
        4 => (at(), odd).prop_map(|(at, value)| Edit::Value(at, value)),
        2 => (at(), number).prop_map(|(at, value)| Edit::Value(at, value)),
        3 => (at(), whole).prop_map(|(at, value)| Edit::Value(at, value)),
        1 => (at(), deep()).prop_map(|(at, value)| Edit::Value(at, value)),
        12 => (at(), 0.2..3.0).prop_map(|(at, factor)| Edit::Scale(at, factor)),
        1 => at().prop_map(Edit::Double),
        4 => at().prop_map(Edit::Remove),
        1 => (at(), at()).prop_map(|(a, b)| Edit::Swap(a, b)),
        2 => (at(), line()).prop_map(|(at, line)| Edit::Insert(at, line)),
        2 => (at(), any::<char>()).prop_map(|(at, c)| Edit::Character(at, c)),
        1 => at().prop_map(Edit::Cut),
    ]
}

/// The default text without comments, after the edits.
fn edited(edits: &[Edit]) -> String {
    let is_content = |line: &&str| !line.is_empty() && !line.starts_with('#');
    let mut lines: Vec<String> = DEFAULT_TEXT
        .lines()
        .filter(is_content)
        .map(str::to_owned)
        .collect();
    let assigned: Vec<usize> = (0..lines.len())
        .filter(|&i| lines[i].contains(" = "))
        .collect();
    for edit in edits {
        let count = lines.len().max(1);
        let line_of_value = |at: &usize| assigned[at % assigned.len()];
        match edit {
            Edit::Value(at, value) => {
                if let Some(line) = lines.get_mut(line_of_value(at)) {
                    let key = line.split(" = ").next().unwrap_or_default();
                    *line = format!("{key} = {value}");
                }
            }
            Edit::Scale(at, factor) => {
                if let Some(line) = lines.get_mut(line_of_value(at))
                    && let Some((key, value)) = line.split_once(" = ")
                    && let Ok(number) = value.parse::<f64>()
                {
                    let scaled = number * factor;
                    let is_whole = !value.contains(['.', 'e']);
                    let text = if is_whole {
                        format!("{scaled:.0}")
                    } else {
                        format!("{scaled:?}")
                    };
                    *line = format!("{key} = {text}");
                }
            }
            Edit::Double(at) => lines.insert(at % count, lines[at % count].clone()),
            Edit::Remove(at) => drop(lines.remove(at % count)),
            Edit::Swap(a, b) => lines.swap(a % count, b % count),
            Edit::Insert(at, line) => lines.insert(at % count, line.clone()),
            Edit::Character(at, character) => {
                insert(&mut lines[at % count], at / count, *character);
            }
            Edit::Cut(at) => lines.truncate(1 + at % count),
        }
    }
    lines.join("\n")
}

fn insert(line: &mut String, at: usize, character: char) {
    let end = line.chars().count() + 1;
    let place = line
        .char_indices()
        .nth(at % end)
        .map_or(line.len(), |(place, _)| place);
    line.insert(place, character);
}

/// Runs an accepted configuration: the simulated robot follows a reference for some cycles. Returns whether
/// it was accepted.
fn evaluate(text: &str) -> bool {
    match Config::parse(text, Path::new("robot.toml")) {
        Ok(validated) => {
            follow(&validated);
            true
        }
        Err(error) => {
            assert!(error.to_string().starts_with("robot.toml"), "{error}");
            false
        }
    }
}

fn follow(validated: &Validated) {
    let mut rig = Rig::new(validated, simulated(validated));
    let mut reference = ReferenceChunk {
        interpolation: Interpolation::Linear.code(),
        count: 2,
        ..ReferenceChunk::default()
    };
    let reach_m = validated.robot.reach_m();
    for (index, point) in reference.points[..2].iter_mut().enumerate() {
        *point = ReferencePoint {
            time_ns: rig.now_ns() + 1 + 10_000_000_000 * index as u64,
            position_m: [0.3 * reach_m * index as f64, 0.0, 0.8 * reach_m],
            ..ReferencePoint::default()
        };
    }
    assert!(rig.take_chunk(&reference));
    rig.run_cycle(0);
    let track = Request {
        kind: RequestKind::Track.code(),
        ..Request::default()
    };
    assert!(rig.take_request(&track));
    for skipped in [0, 1, 0] {
        rig.run_cycle(skipped);
    }
}

#[test]
fn any_text_is_a_configuration_or_an_error() {
    replay(
        concat!(env!("CARGO_MANIFEST_DIR"), "/corpus/config"),
        |bytes| {
            evaluate(&String::from_utf8_lossy(bytes));
        },
    );
    let any_bytes = vec(any::<u8>(), 0..400);
    let texts = prop_oneof![
        any::<String>(),
        any_bytes.prop_map(|bytes| String::from_utf8_lossy(&bytes).into_owned()),
        "[a-z_\\[\\]=.\"'#{},0-9e \n-]{0,200}",
        line(),
    ];
    try_cases(1024, texts, |text| {
        evaluate(&text);
    });
}

#[test]
fn an_edited_configuration_is_refused_or_runs() {
    let tally = Tally::default();
    try_cases(1024, vec(edit(), 1..4), |edits| {
        tally.count("configuration", evaluate(&edited(&edits)));
    });
    tally.both_at_least("configuration", 0.15);
}
