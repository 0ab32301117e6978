use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::str::FromStr;

use toml::{Table, Value};
use toml_edit::{Document, DocumentMut, Item};

use super::error::{for_people, syntax};
use super::origin::{key_at, line_at};
use super::{Config, ConfigError, Origin, Origins, Settings, keys};

/// Largest configuration \[bytes\]: a hundred times one with every key.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// What was set, layer upon layer: what comes later wins, key by key. Begin with the file.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    values: Table,
    origins: Origins,
}

impl Layers {
    /// Takes over what a file sets.
    pub fn file(self, path: &Path) -> Result<Self, ConfigError> {
        let text = read(path).map_err(|cause| ConfigError::Unreadable {
            file: path.to_owned(),
            cause,
        })?;
        self.text(&text, path)
    }

    /// Takes over what the text of a file sets; `file` is for the messages.
    pub fn text(mut self, text: &str, file: &Path) -> Result<Self, ConfigError> {
        let document = Document::parse(text.to_owned()).map_err(|error| ConfigError::Syntax {
            file: file.to_owned(),
            cause: syntax(text, error.span(), &error.to_string(), error.message()),
        })?;
        if let Some((key, offset)) = keys::first_unknown(document.as_table()) {
            let line = offset.map(|offset| line_at(text, offset));
            let file = file.to_owned();
            return Err(unknown(&key, Origin::File { file, line }));
        }
        let mistyped = |cause: &toml::de::Error| {
            let line = cause.span().map(|span| line_at(text, span.start));
            let file = file.to_owned();
            mistyped(text, "the file", &Origin::File { file, line }, cause)
        };
        toml::from_str::<Config>(text).map_err(|cause| mistyped(&cause))?;
        let values: Table = toml::from_str(text).map_err(|cause| mistyped(&cause))?;
        self.take_over(values);
        self.origins.set_file(file.to_owned(), document);
        Ok(self)
    }

    /// Takes over what the environment sets: `CDCR_CYCLE_PERIOD_MS` is `cycle.period_ms`. Empty variables
    /// count as not set. Others that begin with `CDCR_` may belong to another program: one whose name is near
    /// to that of a key comes back as a warning.
    pub fn variables(
        mut self,
        variables: impl IntoIterator<Item = (OsString, OsString)>,
    ) -> Result<(Self, Vec<String>), ConfigError> {
        let mut warnings = Vec::new();
        for (name, value) in variables {
            let Some(name) = name.to_str().filter(|name| name.starts_with("CDCR_")) else {
                continue;
            };
            if value.is_empty() {
                continue;
            }
            let mut known = keys::settable().keys();
            if let Some(key) = known.find(|key| keys::variable(key) == name) {
                let origin = Origin::Variable(name.to_owned());
                let text = text_of(&value, key, &origin)?;
                self = self.key(key, text, origin)?;
            } else if let Some(near) = keys::nearest_variable(name) {
                warnings.push(format!("{name} sets nothing: did you mean {near}?"));
            }
        }
        Ok((self, warnings))
    }

    /// Sets one key, as TOML; a string needs no quotes.
    pub fn key(self, key: &str, text: &str, origin: Origin) -> Result<Self, ConfigError> {
        let Some(default) = keys::settable().get(key) else {
            return Err(not_settable(key, origin));
        };
        let value = value_of(text, default).map_err(|message| error(key, &origin, &message))?;
        self.put(key, value, origin)
    }

    /// Sets one key to a string, whatever is in it.
    pub fn string(self, key: &str, text: &str, origin: Origin) -> Result<Self, ConfigError> {
        self.put(key, text.into(), origin)
    }

    fn put(
        mut self,
        key: &str,
        value: toml_edit::Value,
        origin: Origin,
    ) -> Result<Self, ConfigError> {
        let document = document_of(key, value);
        if let Some((inner, _)) = keys::first_unknown(document.as_table()) {
            return Err(unknown(&inner, origin));
        }
        let text = document.to_string();
        if let Err(cause) = toml::from_str::<Config>(&text) {
            return Err(mistyped(&text, key, &origin, &cause));
        }
        let values =
            Table::from_str(&text).map_err(|cause| error(key, &origin, cause.message()))?;
        self.take_over(values);
        self.origins.set_key(key.to_owned(), origin);
        Ok(self)
    }

    /// All layers as one typed configuration.
    pub fn settings(self) -> Result<Settings, ConfigError> {
        let Self { values, origins } = self;
        // By way of the text that each layer was checked as: a second way would be compiled, too.
        let config = toml::from_str(&values.to_string())
            .map_err(|cause| error("the configuration", &Origin::Default, cause.message()))?;
        Ok(Settings::new(config, origins))
    }

    fn take_over(&mut self, values: Table) {
        for (table, keys) in values {
            let below = self
                .values
                .entry(table)
                .or_insert_with(|| Value::Table(Table::new()));
            match (below, keys) {
                (Value::Table(below), Value::Table(keys)) => below.extend(keys),
                (below, other) => *below = other,
            }
        }
    }
}

/// The text of a file. What is no file is not opened: a pipe may never end, and a device may do something.
fn read(path: &Path) -> io::Result<String> {
    let refused = |words: &str| Err(io::Error::other(words));
    let metadata = std::fs::metadata(path)?;
    if !metadata.is_file() {
        return refused("it is not a file");
    }
    let mut text = String::new();
    let file = File::open(path)?;
    file.take(FILE_BYTES_MAX + 1).read_to_string(&mut text)?;
    if text.len() as u64 > FILE_BYTES_MAX {
        return refused("it is larger than 1 MiB");
    }
    Ok(text)
}

/// The error of a value in `text` that has not the type of its key, at the innermost key that holds it.
fn mistyped(text: &str, key: &str, origin: &Origin, cause: &toml::de::Error) -> ConfigError {
    let inner = cause.span().and_then(|span| {
        let document = Document::parse(text).ok()?;
        key_at(document.as_item(), span.start)
    });
    let key = inner.as_deref().unwrap_or(key);
    error(key, origin, &for_people(cause.message()))
}

/// The text of a variable.
fn text_of<'a>(value: &'a OsString, key: &str, origin: &Origin) -> Result<&'a str, ConfigError> {
    let text = value.to_str();
    text.ok_or_else(|| error(key, origin, "the value is not UTF-8 text"))
}

fn error(key: &str, origin: &Origin, message: &str) -> ConfigError {
    ConfigError::Value {
        origin: origin.clone(),
        key: key.to_owned(),
        message: message.trim_end().to_owned(),
    }
}

fn unknown(key: &str, origin: Origin) -> ConfigError {
    ConfigError::Unknown {
        origin,
        key: key.to_owned(),
        nearest: keys::nearest(key),
    }
}

/// Why a key cannot be set by itself.
fn not_settable(key: &str, origin: Origin) -> ConfigError {
    let plain = keys::without_indices(key);
    if keys::declared(&plain).is_none() {
        return unknown(key, origin);
    }
    let message = match plain.rsplit_once('.') {
        None => "it is a table: set its keys one by one".to_owned(),
        Some((list, _)) => format!("{list} is set as a whole: {list}=[{{ … }}, {{ … }}]"),
    };
    error(key, &origin, &message)
}

/// A value as TOML; where a string is expected, a bare word is one.
fn value_of(text: &str, default: &Value) -> Result<toml_edit::Value, String> {
    let is_quoted = text.trim_start().starts_with(['"', '\'']);
    // What is "auto" by default may be a number.
    let is_number = default.as_str() == Some("auto") && text.trim().parse::<f64>().is_ok();
    if default.is_str() && !is_quoted && !is_number {
        return Ok(text.into());
    }
    toml_edit::Value::from_str(text.trim())
        .map_err(|_| format!("{text:?} is no TOML value: expected one like {default}"))
}

/// A document that sets nothing but `key`.
fn document_of(key: &str, value: toml_edit::Value) -> DocumentMut {
    let mut document = DocumentMut::new();
    if let Some((table, name)) = key.split_once('.') {
        let mut keys = toml_edit::Table::new();
        keys.insert(name, Item::Value(value));
        document.insert(table, Item::Table(keys));
    }
    document
}
