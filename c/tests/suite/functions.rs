//! The functions of `cdcr.h` are those of `src/abi.rs`, with the same arguments in the same order.

use std::collections::BTreeSet;

use super::header;

const SOURCE: &str = include_str!("../../src/abi.rs");

/// C names of the Rust types at the interface.
const TYPES: [(&str, &str); 8] = [
    ("u64", "uint64_t"),
    ("u32", "uint32_t"),
    ("usize", "size_t"),
    ("f64", "double"),
    ("c_int", "int"),
    ("c_char", "char"),
    ("Session", "CdcrConnection"),
    ("Update", "CdcrDriverUpdate"),
];

fn c_type(rust: &str) -> String {
    if let Some(to) = rust.strip_prefix("*mut ") {
        return format!("{} *", c_type(to)).replace("* *", "**");
    }
    if let Some(to) = rust.strip_prefix("*const ") {
        return format!("const {} *", c_type(to));
    }
    let known = TYPES.iter().find(|(known, _)| *known == rust);
    known.map_or_else(|| format!("Cdcr{rust}"), |(_, c)| (*c).to_owned())
}

/// Converts a signature such as `fn name(a: u32, b: *const X) -> c_int` to a prototype.
fn prototype(signature: &str) -> String {
    let (name, rest) = signature.split_once('(').unwrap();
    let (arguments, returned) = rest.split_once(')').unwrap();
    let arguments: Vec<_> = arguments
        .split(',')
        .map(str::trim)
        .filter(|argument| !argument.is_empty())
        .map(|argument| {
            let (name, rust) = argument.split_once(": ").unwrap();
            format!("{} {name}", c_type(rust)).replace("* ", "*")
        })
        .collect();
    let returned = c_type(returned.trim().strip_prefix("-> ").unwrap());
    let arguments = if arguments.is_empty() {
        "void".to_owned()
    } else {
        arguments.join(", ")
    };
    format!("{returned} {name}({arguments})").replace("* ", "*")
}

/// The functions exported by `abi.rs`.
fn exported() -> BTreeSet<String> {
    let parts = SOURCE.split("#[unsafe(no_mangle)]").skip(1);
    let signature = |part: &str| {
        let (_, rest) = part.split_once("extern \"C\" fn ").unwrap();
        let (signature, _) = rest.split_once(" {").unwrap();
        signature.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    parts.map(|part| prototype(&signature(part))).collect()
}

/// The functions declared in the header.
fn declared() -> BTreeSet<String> {
    let text = header("cdcr.h");
    let mut code = String::new();
    let mut rest = text.as_str();
    while let Some((before, comment)) = rest.split_once("/*") {
        code.push_str(before);
        rest = comment.split_once("*/").unwrap().1;
    }
    code.push_str(rest);
    let parts = code.split(';').map(str::trim);
    let prototypes = parts.filter(|part| part.contains(" cdcr_") || part.contains("*cdcr_"));
    let one_line = |part: &str| part.split_whitespace().collect::<Vec<_>>().join(" ");
    prototypes
        // The first prototype follows a directive.
        .map(|part| one_line(part.rsplit("\n\n").next().unwrap()))
        .collect()
}

#[test]
fn the_header_declares_what_the_library_exports() {
    let exported = exported();
    assert_eq!(
        exported.len(),
        SOURCE.matches("#[unsafe(no_mangle)]").count()
    );
    assert_eq!(declared(), exported);
    let driver = "int cdcr_driver_connect(uint64_t layout, const CdcrPlace *place, uint32_t interface, uint64_t timeout_ns, CdcrDriver **driver)";
    assert!(exported.contains(driver), "{exported:#?}");
}

// Functions run inside `call`, which catches panics. The two without a code cannot fail.
#[test]
fn every_function_with_a_code_catches_panics() {
    let parts = || SOURCE.split("#[unsafe(no_mangle)]").skip(1);
    let with_code = || parts().filter(|part| part.contains("-> c_int {"));
    assert_eq!(with_code().count() + 2, parts().count());
    for part in with_code() {
        let (signature, body) = part.split_once("-> c_int {\n    ").unwrap();
        let (body, _) = body.split_once("\n}\n").unwrap();
        // The call ends with the function: no statement follows at its indentation.
        let inside = body
            .strip_prefix("call(|| ")
            .and_then(|rest| rest.strip_suffix(')'));
        let inside = inside.unwrap_or_else(|| panic!("{signature}"));
        assert_eq!(
            inside.matches("\n    }").count(),
            inside.matches('\n').count().min(1),
            "{signature}"
        );
    }
}

// A comment is right above each function.
#[test]
fn every_function_is_described() {
    let text = header("cdcr.h");
    for prototype in exported() {
        let (begin, _) = prototype.split_once('(').unwrap();
        let (before, _) = text.split_once(&format!("{begin}(")).unwrap();
        assert!(before.ends_with("*/\n"), "{begin}");
    }
}
