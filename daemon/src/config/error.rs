use std::borrow::Cow;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::layers::line_at;
use super::{Origin, keys};

/// An error of a configuration with its place.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {}: {cause}{}", short(&file.display().to_string()), start(file, cause))]
    Unreadable {
        file: PathBuf,
        cause: std::io::Error,
    },
    /// The text is not TOML.
    #[error("{}: {cause}", file.display())]
    Syntax {
        file: PathBuf,
        /// The parser's message: line, column, the line itself, and what was expected.
        cause: String,
    },
    /// An unknown key.
    #[error("{}unknown key {key}: {}", place(origin), remedy(*nearest), key = short(key))]
    Unknown {
        origin: Origin,
        key: String,
        /// The most similar known key.
        nearest: Option<&'static str>,
    },
    /// A value is not allowed.
    #[error("{}{key}: {message}", place(origin), key = short(key), message = short(message))]
    Value {
        origin: Origin,
        key: String,
        /// The error, and the allowed values.
        message: String,
    },
}

impl ConfigError {
    pub(super) fn unknown(key: &str, origin: Origin) -> Self {
        Self::Unknown {
            origin,
            key: key.to_owned(),
            nearest: keys::nearest(key),
        }
    }
}

/// Characters of a text that an error quotes: about a line of a terminal.
const QUOTED_MAX: usize = 200;
/// Part of them from the end of the text, which follows a long value.
const QUOTED_END: usize = 120;

/// The text, or its beginning and end if it is too long to read.
pub(super) fn short(text: &str) -> Cow<'_, str> {
    let count = text.chars().count();
    if count <= QUOTED_MAX {
        return text.into();
    }
    let start: String = text.chars().take(QUOTED_MAX - QUOTED_END).collect();
    let end: String = text.chars().skip(count - QUOTED_END).collect();
    format!("{start} … {end}").into()
}

/// The command for a first configuration if there is no file.
fn start(file: &Path, cause: &std::io::Error) -> String {
    if cause.kind() != ErrorKind::NotFound {
        return String::new();
    }
    let file = file.display().to_string();
    format!("\n`cdcrd config default > {}` creates one", short(&file))
}

fn place(origin: &Origin) -> String {
    match origin {
        Origin::Default => String::new(),
        set => format!("{set}: "),
    }
}

fn remedy(nearest: Option<&str>) -> String {
    match nearest {
        Some(key) => format!("did you mean {key}?"),
        None => "see `cdcrd config default` for all keys".to_owned(),
    }
}

/// The parser's message about a syntax error, with the line itself unless it is too long.
pub(super) fn syntax(text: &str, error: &toml::de::Error) -> String {
    let shown = for_people(&error.to_string());
    let offset = error.span().map_or(0, |span| span.start);
    let hint = decimal_point(is_decimal_comma(text, offset));
    if shown.lines().all(|line| line.chars().count() <= QUOTED_MAX) {
        return shown + hint;
    }
    let line = line_at(text, offset);
    let message = for_people(error.message());
    format!("line {line}: {}{hint}", short(&message))
}

/// What an error adds if a number has a comma.
pub(super) fn decimal_point(is_comma: bool) -> &'static str {
    if is_comma {
        "; numbers have a decimal point: 0.25, not 0,25"
    } else {
        ""
    }
}

/// The byte at `offset` is a comma between two digits.
fn is_decimal_comma(text: &str, offset: usize) -> bool {
    let bytes = text.as_bytes();
    let is_digit = |at: usize| bytes.get(at).is_some_and(u8::is_ascii_digit);
    bytes.get(offset) == Some(&b',') && offset > 0 && is_digit(offset - 1) && is_digit(offset + 1)
}

/// The parser's message without Rust type names.
pub(super) fn for_people(message: &str) -> String {
    let words = [
        ("expected u32", "expected a whole number, 0 or more"),
        ("expected u64", "expected a whole number, 0 or more"),
        ("expected i32", "expected a whole number"),
        ("expected i64", "expected a whole number"),
        ("expected f64", "expected a number"),
        ("expected a boolean", "expected true or false"),
        ("expected a string", "expected a string, in quotes"),
        ("expected a sequence", "expected a list"),
    ];
    let mut text = message.to_owned();
    for (rust, plain) in words {
        text = text.replace(rust, plain);
    }
    while let Some(start) = text.find("expected struct ") {
        let end = text[start + 16..]
            .find(|c: char| !c.is_alphanumeric())
            .map_or(text.len(), |length| start + 16 + length);
        text.replace_range(start..end, "expected a table");
    }
    text.trim_end().to_owned()
}
