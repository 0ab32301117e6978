//! Compares field offsets and code values of a C compiler with those of Rust.

use std::fmt::Write as _;

use cdcr_c::code::CODES;
use cdcr_c::layout::{LAYOUT, STRUCTS};
use cdcr_shared_types::codes::{Mode, Outcome, guard};
use cdcr_shared_types::{LAYOUTS, limits};
use cdcr_test_skip::{Need, skip};

use super::{include, refused};

/// A source that compiles only if each offset is that of Rust plus `more`.
fn source(more: usize, assert: &str) -> String {
    let mut text = String::from("#include \"cdcr.h\"\n");
    let mut check = |what: String, value: i128| {
        let suffix = if value > i128::from(i64::MAX) {
            "u"
        } else {
            ""
        };
        writeln!(text, "{assert}({what} == {value}{suffix}, \"{what}\");").unwrap();
    };
    let mut field = |name: &str, field: &str, offset: usize, size: usize| {
        check(
            format!("offsetof({name}, {field})"),
            (offset + more) as i128,
        );
        check(format!("sizeof((({name} *)0)->{field})"), size as i128);
    };
    for layout in LAYOUTS {
        let name = format!("Cdcr{}", layout.name);
        for part in layout.fields {
            field(&name, part.name, part.offset, part.kind.size());
        }
    }
    for (name, _, fields) in STRUCTS {
        for (part, offset, size) in *fields {
            field(name, part, *offset, *size);
        }
    }
    for layout in LAYOUTS {
        check(format!("sizeof(Cdcr{})", layout.name), layout.size as i128);
    }
    for (name, size, _) in STRUCTS {
        check(format!("sizeof({name})"), *size as i128);
    }
    for (name, code) in CODES {
        check(name.to_owned(), code as i128);
    }
    for (name, value, _) in limits::ALL {
        // A static assertion of standard C compares integers only.
        if value.fract() == 0.0 {
            check(format!("CDCR_{name}"), *value as i128);
        }
    }
    // These names are written by hand; the generator derives them. All values come from one list.
    for (name, value) in [
        ("CDCR_MODE_FAULTED", Mode::Faulted.code()),
        ("CDCR_OUTCOME_NO_LEASE", Outcome::NoLease.code()),
        ("CDCR_GUARD_FLAGS_CABLE_SPEED", guard::CABLE_SPEED),
    ] {
        check(name.to_owned(), value.into());
    }
    check("CDCR_LAYOUT".to_owned(), LAYOUT.into());
    text
}

#[test]
fn c_lays_everything_out_as_rust_does() {
    for language in ["c11", "c17"] {
        let reported = refused("cc", language, &source(0, "_Static_assert"));
        assert_eq!(reported.expect("a C compiler"), "", "{language}");
    }
    // With C99, the compiler checks the sizes, too.
    let reported = refused("cc", "c99", "#include \"cdcr.h\"\n");
    assert_eq!(reported.unwrap(), "");
}

#[test]
fn the_examples_compile_in_strict_c() {
    for example in ["driver.c", "feed.c"] {
        let path = include().join("../examples").join(example);
        let source = std::fs::read_to_string(path).unwrap();
        let reported = refused("cc", "c11", &source);
        assert_eq!(reported.expect("a C compiler"), "", "{example}");
    }
}

#[test]
fn a_wrong_offset_is_found() {
    let reported = refused("cc", "c11", &source(1, "_Static_assert")).unwrap();
    assert!(
        reported.contains("offsetof(CdcrHeader, sent_ns)"),
        "{reported}"
    );
}

#[test]
fn cpp_lays_everything_out_as_rust_does() {
    for language in ["c++11", "c++20"] {
        match refused("c++", language, &source(0, "static_assert")) {
            Some(reported) => assert_eq!(reported, "", "{language}"),
            None => skip(Need::Cpp, "no c++"),
        }
    }
}
