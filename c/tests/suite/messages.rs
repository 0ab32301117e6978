//! Generates `cdcr_messages.h` from the declarations (`CDCR_GENERATE=1`), and checks that it is up to date.

use std::fmt::Write as _;

use cdcr_c::layout::LAYOUT;
use cdcr_shared_types::message::{Field, Kind, Meaning, MessageLayout};
use cdcr_shared_types::{LAYOUTS, declared, limits};

const NAME: &str = "cdcr_messages.h";
const HOW: &str = "CDCR_GENERATE=1 cargo test -p cdcr-c messages";
/// Maximum length of a comment line.
const COLUMNS: usize = 110;

const HEAD: &str = "\
/* The messages of cdcrd: structs, codes and limits, as they lie in shared memory and as the functions of cdcr.h take them.
 *
 * Made from the declarations in shared-types/src by `CDCR_GENERATE=1 cargo test -p cdcr-c messages`; do not edit it. What
 * each message is for: docs/wire-protocol.md. A comment begins with the offset in bytes.
 *
 * SI units. Times are nanoseconds of CLOCK_MONOTONIC. Little-endian, without padding. Set a struct to zeros before you fill it in. A text is
 * UTF-8 padded with zeros, and has none when it is full: print it with \"%.*s\" and CDCR_TEXT_BYTES. */
#ifndef CDCR_MESSAGES_H
#define CDCR_MESSAGES_H

#include <stddef.h>
#include <stdint.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error \"cdcrd runs on little-endian machines\"
#endif

#ifdef __cplusplus
#define CDCR_ASSERT_SIZE(type, bytes) static_assert(sizeof(type) == (bytes), \"the compiler pads \" #type)
#elif __STDC_VERSION__ >= 201112L
#define CDCR_ASSERT_SIZE(type, bytes) _Static_assert(sizeof(type) == (bytes), \"the compiler pads \" #type)
#else
#define CDCR_ASSERT_SIZE(type, bytes) typedef char cdcr_size_of_##type[sizeof(type) == (bytes) ? 1 : -1]
#endif
";

/// Converts `NoLease`, `late start` and `SCHED_FIFO` to parts of the name of a constant.
fn upper(name: &str) -> String {
    let mut text = String::new();
    let mut was_lower = false;
    for letter in name.chars() {
        if letter.is_uppercase() && was_lower {
            text.push('_');
        }
        was_lower = letter.is_lowercase();
        let is_word = letter.is_ascii_alphanumeric();
        text.push(if is_word {
            letter.to_ascii_uppercase()
        } else {
            '_'
        });
    }
    text
}

/// A comment of one line, or of several with the same indentation.
fn comment(indent: &str, text: &str) -> String {
    let text = text.replace("*/", "* /");
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.last_mut().unwrap();
        if !last.is_empty() && last.chars().count() + word.chars().count() >= COLUMNS {
            lines.push(word.to_owned());
        } else {
            last.push_str(if last.is_empty() { "" } else { " " });
            last.push_str(word);
        }
    }
    format!("{indent}/* {} */\n", lines.join(&format!("\n{indent} * ")))
}

fn c_type(kind: &Kind, meaning: Meaning) -> String {
    match kind {
        Kind::U8 if matches!(meaning, Meaning::Text) => "char".to_owned(),
        Kind::U8 => "uint8_t".to_owned(),
        Kind::U32 => "uint32_t".to_owned(),
        Kind::U64 => "uint64_t".to_owned(),
        Kind::F64 => "double".to_owned(),
        Kind::Struct(layout) => format!("Cdcr{}", layout.name),
        Kind::Array(each, _) => c_type(each, meaning),
    }
}

fn dimensions(kind: &Kind) -> String {
    match kind {
        Kind::Array(each, count) => format!("[{count}]{}", dimensions(each)),
        _ => String::new(),
    }
}

/// Unit, codes and used length as text, unless `doc` contains them.
fn notes(field: &Field, doc: &str) -> String {
    let mut notes = Vec::new();
    match field.meaning {
        Meaning::Code(codes) => notes.push(format!("Cdcr{}", codes.name)),
        Meaning::Bits(_) => notes.push(format!("bits CDCR_{}_…", upper(field.name))),
        Meaning::Per(codes, first) => {
            notes.push(format!("one for each Cdcr{} from {first} on", codes.name));
        }
        Meaning::Yes => notes.push("1: yes, 0: no".to_owned()),
        Meaning::OrNone => notes.push("largest value: none".to_owned()),
        Meaning::Text => notes.push("text".to_owned()),
        Meaning::Quantity
        | Meaning::Length
        | Meaning::Sum(_)
        | Meaning::Max(_)
        | Meaning::Reserved => {}
    }
    if !field.unit.is_empty() && !doc.contains(&format!("[{}", field.unit)) {
        notes.push(field.unit.to_owned());
    }
    if let Some(used) = field.used {
        notes.push(format!("used: {} * {}", used.each, used.count));
    }
    if let Some((other, code)) = field.when {
        notes.push(format!("where {other} is {code}"));
    }
    notes.retain(|note| !doc.contains(note.as_str()));
    notes.join("; ")
}

fn structure(layout: &MessageLayout) -> String {
    let (name, type_name, size) = (layout.name, layout.type_name, layout.size);
    let mut text = format!("/* {type_name}, {size} bytes. */\ntypedef struct Cdcr{name} {{\n");
    for field in layout.fields {
        let doc = declared::words(field.doc).replace('`', "");
        let doc = doc.replace("codes::", "Cdcr");
        let notes = notes(field, &doc);
        let separator = if notes.is_empty() { "" } else { ". " };
        let words = format!("{}: {notes}{separator}{doc}", field.offset);
        text.push_str(&comment("    ", &words));
        let (kind, dimensions) = (c_type(&field.kind, field.meaning), dimensions(&field.kind));
        writeln!(text, "    {kind} {}{dimensions};", field.name).unwrap();
    }
    writeln!(
        text,
        "}} Cdcr{name};\nCDCR_ASSERT_SIZE(Cdcr{name}, {size});\n"
    )
    .unwrap();
    text
}

fn codes() -> String {
    let mut text = String::new();
    for (name, values) in declared::codes() {
        let prefix = upper(name);
        if declared::is_bits(name) {
            writeln!(text, "/* Bits of {name}. */").unwrap();
            for (bit, name, _) in values {
                let name = upper(name);
                writeln!(text, "#define CDCR_{prefix}_{name} UINT32_C({bit})").unwrap();
            }
            text.push('\n');
            continue;
        }
        writeln!(text, "typedef enum Cdcr{name} {{").unwrap();
        for (at, (value, name, words)) in values.iter().enumerate() {
            let comma = if at + 1 < values.len() { "," } else { "" };
            let name = upper(name);
            writeln!(
                text,
                "    CDCR_{prefix}_{name} = {value}{comma} /* {words} */"
            )
            .unwrap();
        }
        writeln!(text, "}} Cdcr{name};\n").unwrap();
    }
    text
}

fn made() -> String {
    let mut text = format!(
        "{HEAD}\n/* What cdcr_connect and cdcr_driver_connect ask for: of which version this header is. */\n\
         #define CDCR_LAYOUT UINT64_C({LAYOUT:#018x})\n\n"
    );
    for (name, value, doc) in limits::ALL {
        text.push_str(&comment("", &declared::words(doc).replace('`', "")));
        writeln!(text, "#define CDCR_{name} {value}\n").unwrap();
    }
    text.push_str(&codes());
    for layout in LAYOUTS {
        text.push_str(&structure(layout));
    }
    text + "#endif\n"
}

#[test]
fn the_header_is_what_is_declared() {
    let made = made();
    if std::env::var_os("CDCR_GENERATE").is_some() {
        std::fs::write(super::include().join(NAME), made).unwrap();
        return;
    }
    assert!(super::header(NAME) == made, "{NAME} is out of date: {HOW}");
}

#[test]
fn names_become_constants() {
    let names = [
        "NoLease",
        "late start",
        "SCHED_FIFO",
        "timing_flags",
        "not finite",
    ]
    .map(upper);
    let constants = [
        "NO_LEASE",
        "LATE_START",
        "SCHED_FIFO",
        "TIMING_FLAGS",
        "NOT_FINITE",
    ];
    assert_eq!(names, constants);
}
