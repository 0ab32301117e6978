use std::path::PathBuf;

use super::Origin;

/// What is wrong with a configuration, and where.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error(
        "cannot read the configuration {}: {cause}\n\
         `cdcrd config default > {}` writes one to start from", file.display(), file.display()
    )]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// The text is no TOML, or has wrong types.
    #[error("{}: {cause}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// What the parser says: line, column, the line itself, and what was expected.
        cause: String,
    },
    /// A key that nobody knows.
    #[error("{}unknown key {key}: {}", place(origin), remedy(*nearest))]
    Unknown {
        /// Where it was set.
        origin: Origin,
        /// The key.
        key: String,
        /// The known key that is nearest to it.
        nearest: Option<&'static str>,
    },
    /// A value is not allowed.
    #[error("{}{key}: {message}", place(origin))]
    Value {
        /// Where it was set.
        origin: Origin,
        /// Full key.
        key: String,
        /// What is wrong, and what is allowed.
        message: String,
    },
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
        None => "`cdcrd config default` shows every key".to_owned(),
    }
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
