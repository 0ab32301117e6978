use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::str::FromStr;

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::error::{decimal_point, for_people, syntax};
use super::{Config, ConfigDraft, ConfigError, Origin, Origins, keys};

/// Largest configuration \[bytes\]: a hundred times one with every key.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// Layers of settings: a later layer overrides an earlier one, key by key. Begin with the file.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    values: Table,
    origins: Origins,
}

impl Layers {
    /// Adds the settings of a file.
    pub fn file(self, path: &Path) -> Result<Self, ConfigError> {
        let file = path.to_owned();
        let text = read(path).map_err(|cause| ConfigError::Unreadable { file, cause })?;
        self.text(&text, path)
    }

    /// Adds the settings in the text of a file; `file` is for messages.
    pub fn text(mut self, text: &str, file: &Path) -> Result<Self, ConfigError> {
        let places = places(text).map_err(|error| ConfigError::Syntax {
            file: file.to_owned(),
            cause: syntax(text, &error),
        })?;
        // Every element of a list has a line of its own.
        let line_ends: Vec<usize> = text.match_indices('\n').map(|(end, _)| end).collect();
        self.origins.file = Some(file.to_owned());
        self.add(text, &places, |offset| Origin::File {
            file: file.to_owned(),
            line: Some(1 + line_ends.partition_point(|end| *end < offset)),
        })
    }

    /// Adds the settings of environment variables: `CDCR_CYCLE_PERIOD_MS` is `cycle.period_ms`. Empty
    /// variables count as not set. Other variables with `CDCR_` may belong to another program: a name similar
    /// to that of a key is returned as a warning.
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
            let mut known = keys::settable().map(|(key, _)| key);
            if let Some(key) = known.find(|key| keys::variable(key) == name) {
                let origin = Origin::Variable(name.to_owned());
                self = self.key(key, text_of(&value, key, &origin)?, &origin)?;
            } else if let Some(near) = keys::nearest_variable(name) {
                warnings.push(format!("{name} sets nothing: did you mean {near}?"));
            }
        }
        Ok((self, warnings))
    }

    /// Sets one key, as TOML; a string needs no quotes.
    pub fn key(self, key: &str, text: &str, origin: &Origin) -> Result<Self, ConfigError> {
        let known = keys::get(key).and_then(|known| known.default.as_ref());
        let default = known.ok_or_else(|| not_settable(key, origin))?;
        let value = value_of(text, default).map_err(|message| origin.error(key, &message))?;
        self.put(key, &value, origin)
    }

    /// Sets one key to a string with any content.
    pub fn string(self, key: &str, text: &OsStr, origin: &Origin) -> Result<Self, ConfigError> {
        self.put(key, &text_of(text, key, origin)?.into(), origin)
    }

    fn put(self, key: &str, value: &Value, origin: &Origin) -> Result<Self, ConfigError> {
        let text = format!("{key} = {value}");
        let places = places(&text).map_err(|cause| origin.error(key, cause.message()))?;
        self.add(&text, &places, |_| origin.clone())
    }

    /// Checks the keys and types of a text, and adds its settings; `origin` is the origin of a byte of the
    /// text.
    fn add(
        mut self,
        text: &str,
        places: &[KeyPlace],
        origin: impl Fn(usize) -> Origin,
    ) -> Result<Self, ConfigError> {
        let mut each = places.iter();
        if let Some(place) = each.find(|place| keys::get(&place.declared).is_none()) {
            return Err(ConfigError::unknown(&place.key, origin(place.offset)));
        }
        if let Some(place) = places.iter().find(|place| place.is_table_for_list) {
            return Err(origin(place.offset).error(&place.key, &list_remedy(&place.key)));
        }
        // The innermost key that contains the value.
        let mistyped = |cause: toml::de::Error| {
            let offset = cause.span().map_or(0, |span| span.start);
            let inner = places.iter().rfind(|place| place.offset <= offset);
            let key = inner.map_or("the file", |place| &place.key);
            let message = for_people(cause.message()) + simulated_remedy(key, cause.message());
            origin(offset).error(key, &message)
        };
        toml::from_str::<Config>(text).map_err(mistyped)?;
        let values: Table = toml::from_str(text).map_err(mistyped)?;
        for (table, keys) in values {
            let below = self.values.entry(&table);
            let below = below.or_insert_with(|| Table::new().into());
            if let (Value::Table(below), Value::Table(keys)) = (below, keys) {
                for key in keys.keys() {
                    self.origins.forget(&format!("{table}.{key}"));
                }
                below.extend(keys);
            }
        }
        for KeyPlace { key, offset, .. } in places {
            self.origins.set(key.clone(), origin(*offset));
        }
        Ok(self)
    }

    /// All layers as one typed configuration.
    pub fn settings(self) -> Result<ConfigDraft, ConfigError> {
        let Self { values, origins } = self;
        // Parsed from text, like each layer: a second deserialiser would add code.
        let config = toml::from_str(&values.to_string())
            .map_err(|cause| Origin::Default.error("the configuration", cause.message()))?;
        Ok(ConfigDraft::new(config, origins))
    }
}

/// The text of a file. Only regular files are opened: a pipe may never end, and opening a device may have
/// effects.
fn read(path: &Path) -> io::Result<String> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(io::Error::other("it is not a file"));
    }
    let mut text = String::new();
    let file = File::open(path)?;
    let read = file.take(FILE_BYTES_MAX + 1).read_to_string(&mut text);
    read.map_err(|cause| match cause.kind() {
        io::ErrorKind::InvalidData => {
            io::Error::other("it is not UTF-8 text: save it with this encoding")
        }
        _ => cause,
    })?;
    if text.len() as u64 > FILE_BYTES_MAX {
        return Err(io::Error::other("it is larger than 1 MiB"));
    }
    Ok(text)
}

/// A table, a key or a list element in a text.
struct KeyPlace {
    /// As declared: `robot.sections.length_m`.
    declared: String,
    /// As in messages: `robot.sections[1].length_m`.
    key: String,
    /// Byte offset in the text.
    offset: usize,
    /// A table was written where the key is a list.
    is_table_for_list: bool,
}

/// All places in a text, in its order.
fn places(text: &str) -> Result<Vec<KeyPlace>, toml::de::Error> {
    let mut places = Vec::new();
    below_table(DeTable::parse(text)?.get_ref(), "", "", &mut places);
    places.sort_by_key(|place| place.offset);
    Ok(places)
}

fn below_table(table: &DeTable, declared: &str, key: &str, places: &mut Vec<KeyPlace>) {
    let dot = if key.is_empty() { "" } else { "." };
    for (name, value) in table {
        let declared = format!("{declared}{dot}{}", name.get_ref());
        let key = format!("{key}{dot}{}", name.get_ref());
        below_value(value.get_ref(), &declared, &key, places);
        let is_table = matches!(value.get_ref(), DeValue::Table(_));
        places.push(KeyPlace {
            is_table_for_list: is_table && is_list(&declared),
            declared,
            key,
            offset: name.span().start,
        });
    }
}

fn is_list(key: &str) -> bool {
    let default = keys::get(key).and_then(|known| known.default.as_ref());
    default.is_some_and(Value::is_array)
}

/// How to write a list.
fn list_remedy(key: &str) -> String {
    let name = key.rsplit('.').next().unwrap_or(key);
    if keys::below(key).is_empty() {
        format!("is a list: write {name} = [ … ]")
    } else {
        format!("is a list: write [[{key}]], or {name} = [{{ … }}, {{ … }}]")
    }
}

fn below_value(value: &DeValue, declared: &str, key: &str, places: &mut Vec<KeyPlace>) {
    match value {
        DeValue::Table(table) if !keys::below(declared).is_empty() => {
            below_table(table, declared, key, places);
        }
        DeValue::Array(list) if keys::get(declared).is_some() => {
            for (index, element) in list.iter().enumerate() {
                let key = format!("{key}[{index}]");
                below_value(element.get_ref(), declared, &key, places);
                places.push(KeyPlace {
                    declared: declared.to_owned(),
                    key,
                    offset: element.span().start,
                    is_table_for_list: false,
                });
            }
        }
        _ => {}
    }
}

/// What an unknown preset of the simulated robot may have been meant for.
fn simulated_remedy(key: &str, message: &str) -> &'static str {
    if key == "link.simulated" && message.starts_with("unknown variant") {
        "; a real robot is link.kind = \"driver\""
    } else {
        ""
    }
}

/// The line of a byte of a text, from 1.
pub(super) fn line_at(text: &str, offset: usize) -> usize {
    let before = text.as_bytes().iter().take(offset);
    1 + before.filter(|byte| **byte == b'\n').count()
}

fn text_of<'a>(value: &'a OsStr, key: &str, origin: &Origin) -> Result<&'a str, ConfigError> {
    let refused = || origin.error(key, &format!("{} is not UTF-8 text", value.display()));
    value.to_str().ok_or_else(refused)
}

/// The reason why a key cannot be set by itself.
fn not_settable(key: &str, origin: &Origin) -> ConfigError {
    let plain = keys::without_indices(key);
    if keys::get(&plain).is_none() {
        return ConfigError::unknown(key, origin.clone());
    }
    let message = match plain.rsplit_once('.') {
        None => "is a table: set its keys one by one".to_owned(),
        Some((list, _)) => format!("{list} is set as a whole: {list}=[{{ … }}, {{ … }}]"),
    };
    origin.error(key, &message)
}

/// A value as TOML; where a string is expected, a bare word is accepted.
fn value_of(text: &str, default: &Value) -> Result<Value, String> {
    let is_quoted = text.trim_start().starts_with(['"', '\'']);
    // A key whose default is "auto" may be a number.
    let is_number = default.as_str() == Some("auto") && text.trim().parse::<f64>().is_ok();
    if default.is_str() && !is_quoted && !is_number {
        return Ok(text.into());
    }
    Value::from_str(text.trim()).map_err(|_| {
        let with_point = text.trim().replacen(',', ".", 1);
        let hint = decimal_point(with_point.parse::<f64>().is_ok());
        format!("invalid TOML value {text:?}: expected a value like {default}{hint}")
    })
}
