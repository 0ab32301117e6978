use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::str::FromStr;

use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

use super::error::{DECIMAL_POINT, Result, for_people, short, syntax};
use super::{Config, ConfigDraft, ConfigError, Origins, keys};

/// Largest configuration \[bytes\]: a hundred times one with every key.
const FILE_BYTES_MAX: usize = 1 << 20;

/// Layers of settings: a later layer overrides an earlier one, key by key. Begin with the file.
#[derive(Debug, Clone, Default)]
pub struct Layers {
    values: Table,
    origins: Origins,
}

impl Layers {
    /// Adds the settings of a file.
    pub fn file(self, path: &Path) -> Result<Self> {
        let text = read(path).map_err(|cause| {
            let name = path.display().to_string();
            let file = short(&name);
            let mut message = format!("cannot read the configuration {file}: {cause}");
            if cause.kind() == io::ErrorKind::NotFound {
                message = format!("{message}\n`cdcrd config default > {file}` creates one");
            }
            ConfigError::with_place(None, message)
        })?;
        self.text(&text, path)
    }

    /// Adds the settings in the text of a file; `file` is for messages.
    pub fn text(mut self, text: &str, file: &Path) -> Result<Self> {
        let whole = file.display().to_string();
        self.origins.0.insert(String::new(), whole.clone());
        // Every element of a list has a line of its own.
        let line_ends: Vec<usize> = text.match_indices('\n').map(|(end, _)| end).collect();
        let line = |offset| 1 + line_ends.partition_point(|end| *end < offset);
        self.add(text, &whole, |offset| {
            format!("{whole}, line {}", line(offset))
        })
    }

    /// Adds the settings of environment variables: `CDCR_CYCLE_PERIOD_MS` is `cycle.period_ms`. Empty
    /// variables count as not set. Other variables with `CDCR_` may belong to another program: a name similar
    /// to that of a key is returned as a warning.
    pub fn variables(
        mut self,
        variables: impl IntoIterator<Item = (OsString, OsString)>,
    ) -> Result<(Self, Vec<String>)> {
        let mut warnings = Vec::new();
        for (name, value) in variables.into_iter().filter(|(_, value)| !value.is_empty()) {
            let Some(name) = name.to_str().filter(|name| name.starts_with("CDCR_")) else {
                continue;
            };
            let mut known = keys::settable().map(|(key, _)| key);
            if let Some(key) = known.find(|key| keys::variable(key) == name) {
                self = self.key(key, text_of(&value, key, name)?, name)?;
            } else if let Some(near) = keys::nearest_variable(name) {
                warnings.push(format!("{name} sets nothing: did you mean {near}?"));
            }
        }
        Ok((self, warnings))
    }

    /// Sets one key, as TOML; a string needs no quotes.
    pub fn key(self, key: &str, text: &str, origin: &str) -> Result<Self> {
        let known = keys::get(key).and_then(|known| known.default.as_ref());
        let default = known.ok_or_else(|| not_settable(key, origin))?;
        let trimmed = text.trim();
        let is_quoted = trimmed.starts_with(['"', '\'']);
        // A key whose default is "auto" may be a number.
        let is_number = default.as_str() == Some("auto") && trimmed.parse::<f64>().is_ok();
        if default.is_str() && !is_quoted && !is_number {
            return self.put(key, &text.into(), origin);
        }
        let value = Value::from_str(trimmed).map_err(|_| {
            let is_comma = trimmed.replacen(',', ".", 1).parse::<f64>().is_ok();
            let hint = if is_comma { DECIMAL_POINT } else { "" };
            let message =
                format!("invalid TOML value {text:?}: expected a value like {default}{hint}");
            ConfigError::new(Some(origin), key, message)
        })?;
        self.put(key, &value, origin)
    }

    /// Sets one key to a string with any content.
    pub fn string(self, key: &str, text: &OsStr, origin: &str) -> Result<Self> {
        self.put(key, &text_of(text, key, origin)?.into(), origin)
    }

    fn put(self, key: &str, value: &Value, origin: &str) -> Result<Self> {
        self.add(&format!("{key} = {value}"), origin, |_| origin.to_owned())
    }

    /// Checks the keys and types of a text, and adds its settings; `whole` is the origin of the text, `origin`
    /// that of a byte of it.
    fn add(mut self, text: &str, whole: &str, origin: impl Fn(usize) -> String) -> Result<Self> {
        let invalid = |error| ConfigError::with_place(Some(whole), syntax(text, &error));
        let places = places(text).map_err(invalid)?;
        let mut each = places.iter();
        if let Some(place) = each.find(|place| keys::get(&place.declared).is_none()) {
            let origin = origin(place.offset);
            return Err(ConfigError::unknown(Some(&origin), &place.key));
        }
        // The innermost key that contains the value.
        let mistyped = |cause: toml::de::Error| {
            let offset = cause.span().map_or(0, |span| span.start);
            let exact = places.iter().filter(|place| place.value == offset);
            let inner = exact.max_by_key(|place| place.key.len());
            let inner = inner.or_else(|| places.iter().rfind(|place| place.offset <= offset));
            let key = inner.map_or("the file", |place| &place.key);
            let message = type_message(key, cause.message());
            ConfigError::new(Some(&origin(offset)), key, message)
        };
        toml::from_str::<Config>(text).map_err(mistyped)?;
        for (table, keys) in toml::from_str::<Table>(text).map_err(mistyped)? {
            let below = self.values.entry(&table);
            let below = below.or_insert_with(|| Table::new().into());
            if let (Value::Table(below), Value::Table(keys)) = (below, keys) {
                below.extend(keys);
            }
        }
        for TextPlace { key, offset, .. } in places {
            self.origins.0.insert(key, origin(offset));
        }
        Ok(self)
    }

    /// All layers as one typed configuration.
    pub fn settings(self) -> Result<ConfigDraft> {
        // Parsed from text, like each layer: a second deserialiser would add code.
        let config = toml::from_str(&self.values.to_string());
        let config = config.map_err(|cause| ConfigError::with_place(None, cause.message()))?;
        Ok(ConfigDraft::new(config, self.origins))
    }
}

/// The text of a file. Only regular files are opened: a pipe may never end, and opening a device may have
/// effects.
fn read(path: &Path) -> io::Result<String> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(io::Error::other("it is not a file"));
    }
    let (file, mut bytes) = (File::open(path)?, Vec::new());
    file.take(FILE_BYTES_MAX as u64 + 1)
        .read_to_end(&mut bytes)?;
    if bytes.len() > FILE_BYTES_MAX {
        return Err(io::Error::other("it is larger than 1 MiB"));
    }
    let not_text = |_| io::Error::other("it is not UTF-8 text: save it with this encoding");
    String::from_utf8(bytes).map_err(not_text)
}

/// A table, a key or a list element in a text.
#[derive(Default)]
struct TextPlace {
    /// As declared: `robot.sections.length_m`.
    declared: String,
    /// As in messages: `robot.sections[1].length_m`.
    key: String,
    /// Byte offset in the text.
    offset: usize,
    /// Byte offset of the value; that of a table is its heading.
    value: usize,
}

/// All places in a text, in its order.
fn places(text: &str) -> std::result::Result<Vec<TextPlace>, toml::de::Error> {
    let mut places = Vec::new();
    let table = DeValue::Table(DeTable::parse(text)?.into_inner());
    add_places(&table, TextPlace::default(), &mut places);
    // The text itself.
    places.pop();
    places.sort_by_key(|place| place.offset);
    Ok(places)
}

/// Adds the places below a value, and its own.
fn add_places(value: &DeValue, place: TextPlace, places: &mut Vec<TextPlace>) {
    match value {
        DeValue::Table(table) if !keys::below(&place.declared).is_empty() => {
            for (name, value) in table {
                let below = TextPlace {
                    declared: keys::join(&place.declared, name.get_ref()),
                    key: keys::join(&place.key, name.get_ref()),
                    offset: name.span().start,
                    value: value.span().start,
                };
                add_places(value.get_ref(), below, places);
            }
        }
        DeValue::Array(list) if keys::get(&place.declared).is_some() => {
            for (index, element) in list.iter().enumerate() {
                let below = TextPlace {
                    declared: place.declared.clone(),
                    key: format!("{}[{index}]", place.key),
                    offset: element.span().start,
                    value: element.span().start,
                };
                add_places(element.get_ref(), below, places);
            }
        }
        _ => {}
    }
    places.push(place);
}

/// The parser's message about the type of a key, and how to write the value.
fn type_message(key: &str, message: &str) -> String {
    let name = key.rsplit('.').next().unwrap_or(key);
    let is_table_for_list = message.starts_with("invalid type: map, expected a sequence");
    let is_no_preset = key == "link.simulated" && message.starts_with("unknown variant");
    match keys::below(key) {
        [] if is_table_for_list => format!("is a list: write {name} = [ … ]"),
        _ if is_table_for_list => {
            format!("is a list: write [[{key}]], or {name} = [{{ … }}, {{ … }}]")
        }
        _ if is_no_preset => format!("{message}; a real robot is link.kind = \"driver\""),
        _ => for_people(message),
    }
}

fn text_of<'a>(value: &'a OsStr, key: &str, origin: &str) -> Result<&'a str> {
    let message = format_args!("{} is not UTF-8 text", value.display());
    let refused = || ConfigError::new(Some(origin), key, message);
    value.to_str().ok_or_else(refused)
}

/// The reason why a key cannot be set by itself.
fn not_settable(key: &str, origin: &str) -> ConfigError {
    let plain = keys::without_indices(key);
    let message = match (keys::get(&plain), plain.rsplit_once('.')) {
        (None, _) => return ConfigError::unknown(Some(origin), key),
        (_, None) => "is a table: set its keys one by one".to_owned(),
        (_, Some((list, _))) => format!("{list} is set as a whole: {list}=[{{ … }}, {{ … }}]"),
    };
    ConfigError::new(Some(origin), key, message)
}
