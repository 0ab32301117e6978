use std::borrow::Cow;
use std::fmt::Display;

use super::keys;

/// What is wrong with a configuration, with its place and the allowed values.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ConfigError(String);

/// A result that is refused with the place.
pub(super) type Result<T> = std::result::Result<T, ConfigError>;

impl ConfigError {
    /// The value of a key is not allowed.
    pub(super) fn new(place: Option<&str>, key: &str, message: impl Display) -> Self {
        let message = message.to_string();
        let (key, message) = (short(key), short(message.trim_end()));
        Self::with_place(place, format_args!("{key}: {message}"))
    }

    pub(super) fn unknown(place: Option<&str>, key: &str) -> Self {
        let remedy = match keys::nearest(key) {
            Some(key) => format!("did you mean {key}?"),
            None => "see `cdcrd config default` for all keys".to_owned(),
        };
        Self::with_place(place, format_args!("unknown key {}: {remedy}", short(key)))
    }

    pub(super) fn with_place(place: Option<&str>, message: impl Display) -> Self {
        let place = place.map(|place| format!("{place}: "));
        Self(format!("{}{message}", place.unwrap_or_default()))
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

/// What an error adds if a number has a comma.
pub(super) const DECIMAL_POINT: &str = "; numbers have a decimal point: 0.25, not 0,25";

/// The parser's message about a syntax error: line, column, the line itself unless it is too long, and what was
/// expected.
pub(super) fn syntax(text: &str, error: &toml::de::Error) -> String {
    let offset = error.span().map_or(0, |span| span.start);
    let (before, after) = text.split_at_checked(offset).unwrap_or_default();
    let mut shown = error.to_string();
    if shown.lines().any(|line| line.chars().count() > QUOTED_MAX) {
        let line = 1 + before.matches('\n').count();
        shown = format!("line {line}: {}", short(error.message()));
    }
    let is_digit = |c: char| c.is_ascii_digit();
    let fraction = after.strip_prefix(',').unwrap_or_default();
    let is_comma = before.ends_with(is_digit) && fraction.starts_with(is_digit);
    shown.trim_end().to_owned() + if is_comma { DECIMAL_POINT } else { "" }
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
    let replace = |text: String, (rust, plain): (&str, &str)| text.replace(rust, plain);
    words.into_iter().fold(message.to_owned(), replace)
}
