//! Pins the layout of every message: `layout.txt`. A line that differs means that the wire contract changed: then the
//! version in the type's name has to change with it. `CDCR_GENERATE=1` writes the file anew.

use std::fmt::Write as _;

use cdcr_shared_types::message::{Field, Kind, Meaning, MessageLayout, Struct, Value};
use cdcr_shared_types::{
    Incident, LAYOUTS, Measurement, ObstacleUpdate, ReferenceChunk, Response, Status, Telemetry,
    codes,
};

const PINNED: &str = include_str!("layout.txt");

fn kind_text(kind: &Kind) -> String {
    match kind {
        Kind::U8 => "u8".to_owned(),
        Kind::U32 => "u32".to_owned(),
        Kind::U64 => "u64".to_owned(),
        Kind::F64 => "f64".to_owned(),
        Kind::Array(kind, count) => format!("{} x {count}", kind_text(kind)),
        Kind::Struct(layout) => layout.type_name.to_owned(),
    }
}

fn fields() -> impl Iterator<Item = (&'static MessageLayout, &'static Field)> {
    let layouts = LAYOUTS.iter();
    layouts.flat_map(|layout| layout.fields.iter().map(|field| (*layout, field)))
}

/// Decision 3 weighs what a record costs, and Python's pages warn of it: their numbers are those of today's record.
#[test]
fn the_decision_for_whole_records_names_their_size() {
    let bytes = size_of::<Telemetry>();
    let size = format!("{} {:03} bytes", bytes / 1000, bytes % 1000);
    let rate_bytes_s = 200.0 * bytes as f64;
    let rate = format!("{:.1} MB/s at 200 Hz", 1e-6 * rate_bytes_s);
    let short = format!("has {:.1} kB", 1e-3 * bytes as f64);
    let hour = format!("at 5 ms are {:.0} GB", 3600e-9 * rate_bytes_s);
    for (page, words) in [
        (
            "docs/decisions/0003-self-contained-records.md",
            [&size, &rate],
        ),
        ("docs/python.md", [&short, &short]),
        ("python/src/recording.rs", [&short, &hour]),
    ] {
        let path = format!("{}/../{page}", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(path).unwrap();
        let missing = words.into_iter().find(|&words| !text.contains(words));
        assert_eq!(missing, None, "{page}");
    }
}

#[test]
fn sizes_and_offsets_are_pinned() {
    let mut text = String::new();
    for layout in LAYOUTS {
        writeln!(text, "{} {}", layout.type_name, layout.size).unwrap();
        for field in layout.fields {
            let kind = kind_text(&field.kind);
            writeln!(text, "{:>8} {} {kind}", field.offset, field.name).unwrap();
        }
    }
    if std::env::var_os("CDCR_GENERATE").is_some() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/layout.txt");
        std::fs::write(path, &text).unwrap();
        return;
    }
    let mut lines = text.lines().zip(PINNED.lines());
    let changed = lines.find(|(is, was)| is != was);
    assert_eq!(changed, None, "(is, was)");
    assert_eq!(text.lines().count(), PINNED.lines().count());
}

#[test]
fn fields_follow_each_other_without_gaps() {
    for layout in LAYOUTS {
        let mut end = 0;
        for field in layout.fields {
            assert_eq!(field.offset, end, "{}.{}", layout.name, field.name);
            end += field.kind.size();
        }
        assert_eq!(end, layout.size, "{}", layout.name);
        assert!(
            layout
                .type_name
                .starts_with(&format!("cdcr.{}.v", layout.name))
        );
    }
}

#[test]
fn what_is_zero_is_called_reserved() {
    for (layout, field) in fields() {
        let is_reserved = matches!(field.meaning, Meaning::Reserved);
        assert_eq!(
            is_reserved,
            field.name == "reserved",
            "{}.{}",
            layout.name,
            field.name
        );
    }
}

/// Where a code or a length is named, there is such a field, and a number in it.
#[test]
fn lengths_and_conditions_name_fields() {
    fn check(message: &dyn Struct) {
        message.visit(&mut |field, value| {
            let name = format!("{}.{}", message.layout().name, field.name);
            if let Some(used) = field.used {
                assert_eq!(message.number(used.count), Some(0), "{name}");
                assert_eq!(message.used(field).unwrap_or(0), 0, "{name}");
            }
            if let Some((other, _)) = field.when {
                assert_eq!(message.number(other), Some(0), "{name}");
            }
            match value {
                Value::Struct(part) => check(part),
                Value::Array(parts) => {
                    if let Value::Struct(part) = parts.element(0) {
                        check(part);
                    }
                }
                _ => {}
            }
        });
    }
    check(&Incident::default());
    check(&Status::default());
    check(&Response::default());
    check(&ReferenceChunk::default());
    check(&ObstacleUpdate::default());
}

#[test]
fn only_what_is_meant_is_used() {
    let field = |name: &str| {
        let mut fields = Measurement::LAYOUT.fields.iter();
        fields.find(|field| field.name == name).unwrap()
    };
    let mut measurement = Measurement {
        kind: codes::MeasurementKind::Configuration.code(),
        sections: 2,
        ..Measurement::default()
    };
    let used = |measurement: &Measurement, name| (measurement as &dyn Struct).used(field(name));
    assert_eq!(used(&measurement, "bend_rad"), Some(4));
    assert_eq!(used(&measurement, "cable_length_m"), None);
    measurement.sections = u32::MAX;
    assert_eq!(
        used(&measurement, "bend_rad"),
        Some(12),
        "never more than there is"
    );
    measurement.kind = codes::MeasurementKind::TipPose.code();
    assert_eq!(used(&measurement, "tip_position_m"), Some(3));
}

#[test]
fn units_come_from_the_names() {
    let unit = |name: &str| {
        let mut all = fields();
        all.find(|(_, field)| field.name == name).unwrap().1.unit
    };
    assert_eq!(
        [
            "acceleration_rad_s2",
            "bend_rate_rad_s",
            "cable_speed_m_s",
            "bend_rad",
            "sent_ns",
            "radius_m",
            "cost",
            "plan"
        ]
        .map(unit),
        ["rad/s²", "rad/s", "m/s", "rad", "ns", "m", "", "rad/s"]
    );
}
