use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use toml_edit::{Document, Item};

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
    /// The text is no TOML, or has unknown keys or wrong types.
    #[error("{}: {cause}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// What the parser says: line, column, the line itself, and what was expected.
        cause: String,
    },
    /// A value is not allowed.
    #[error("{}{}: {key}: {message}", file.display(), line.map(|l| format!(", line {l}")).unwrap_or_default())]
    Value {
        /// The file.
        file: PathBuf,
        /// Line of the key; none when the key is not in the file.
        line: Option<usize>,
        /// Full key.
        key: String,
        /// What is wrong, and what is allowed.
        message: String,
    },
}

/// Finds the line of a key in the text of a configuration.
pub(super) struct Place<'a> {
    text: &'a str,
    file: &'a Path,
}

impl<'a> Place<'a> {
    pub(super) fn in_text(text: &'a str, file: &'a Path) -> Self {
        Self { text, file }
    }

    /// An error at `key`, written like `robot.sections[1].length_m`.
    pub(super) fn error(&self, key: &str, message: &str) -> ConfigError {
        ConfigError::Value {
            file: self.file.to_owned(),
            line: self.line_of(key),
            key: key.to_owned(),
            message: message.to_owned(),
        }
    }

    /// Of two keys that contradict each other, the first one that the text has.
    pub(super) fn written_of(&self, keys: [&'static str; 2]) -> &'static str {
        let written = keys.into_iter().find(|key| self.line_of(key).is_some());
        written.unwrap_or(keys[0])
    }

    /// An error unless `value` lies in `range`.
    pub(super) fn check(
        &self,
        key: &str,
        value: f64,
        range: RangeInclusive<f64>,
    ) -> Result<(), ConfigError> {
        if range.contains(&value) {
            return Ok(());
        }
        let (low, high) = range.into_inner();
        Err(self.error(
            key,
            &format!("{value} is out of range: allowed is {low} to {high}"),
        ))
    }

    fn line_of(&self, key: &str) -> Option<usize> {
        let document = Document::parse(self.text).ok()?;
        let mut item: &Item = document.as_item();
        for part in key.split('.') {
            let (name, index) = match part.split_once('[') {
                Some((name, rest)) => (name, rest.trim_end_matches(']').parse::<usize>().ok()),
                None => (part, None),
            };
            item = item.get(name)?;
            if let Some(index) = index {
                item = item.get(index)?;
            }
        }
        let start = item.span()?.start;
        Some(self.text[..start].matches('\n').count() + 1)
    }
}
