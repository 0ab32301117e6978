use std::borrow::Cow;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::layers::line_at;
use super::{Origin, keys};

/// What is wrong with a configuration, and where.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {}: {cause}{}", short(&file.display().to_string()), start(file, cause))]
    Unreadable {
        file: PathBuf,
        cause: std::io::Error,
    },
    /// The text is no TOML.
    #[error("{}: {cause}", file.display())]
    Syntax {
        file: PathBuf,
        /// What the parser says: line, column, the line itself, and what was expected.
        cause: String,
    },
    /// A key that nobody knows.
    #[error("{}unknown key {key}: {}", place(origin), remedy(*nearest), key = short(key))]
    Unknown {
        origin: Origin,
        key: String,
        /// The known key that is nearest to it.
        nearest: Option<&'static str>,
    },
    /// A value is not allowed.
    #[error("{}{key}: {message}", place(origin), key = short(key), message = short(message))]
    Value {
        origin: Origin,
        key: String,
        /// What is wrong, and what is allowed.
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
/// Of them, how many are from its end, where the words about a long value are.
const QUOTED_END: usize = 120;

/// A text, or its beginning and its end when it is longer than anybody reads.
pub(super) fn short(text: &str) -> Cow<'_, str> {
    let count = text.chars().count();
    if count <= QUOTED_MAX {
        return text.into();
    }
    let start: String = text.chars().take(QUOTED_MAX - QUOTED_END).collect();
    let end: String = text.chars().skip(count - QUOTED_END).collect();
    format!("{start} … {end}").into()
}

/// The way to a first configuration, where there is no file.
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

/// Where a text is no TOML, as the parser shows it: with the line itself, unless nobody could read that.
pub(super) fn syntax(text: &str, error: &toml::de::Error) -> String {
    let shown = for_people(&error.to_string());
    if shown.lines().all(|line| line.chars().count() <= QUOTED_MAX) {
        return shown;
    }
    let line = line_at(text, error.span().map_or(0, |span| span.start));
    format!("line {line}: {}", short(&for_people(error.message())))
}

/// What the parser says, without the names that types have in Rust.
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
    let mut text = words
        .iter()
        .fold(message.to_owned(), |text, (rust, plain)| {
            text.replace(rust, plain)
        });
    while let Some(start) = text.find("expected struct ") {
        let end = text[start + 16..]
            .find(|c: char| !c.is_alphanumeric())
            .map_or(text.len(), |length| start + 16 + length);
        text.replace_range(start..end, "expected a table");
    }
    text.trim_end().to_owned()
}
