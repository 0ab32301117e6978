use std::collections::BTreeMap;
use std::fmt::Display;

use super::ConfigError;

/// Origins of the values that were set, by keys and elements like `robot.sections[1].length_m`: a file with its
/// line, an environment variable or a command-line option. The key `""` has the file, if any.
#[derive(Debug, Clone, Default)]
pub struct Origins(pub(super) BTreeMap<String, String>);

impl Origins {
    /// Origin of the value of `key`, if it was set; an element without one of its own has that of its list.
    pub fn get(&self, key: &str) -> Option<&str> {
        let list = key.split('[').next().unwrap_or(key);
        let set = self.0.get(key).or_else(|| self.0.get(list));
        set.map(String::as_str)
    }

    /// An error of the first of `keys` that was set, or else of the first.
    pub(super) fn error(&self, keys: &[&str], message: impl Display) -> ConfigError {
        let set = keys.iter().find(|key| self.get(key).is_some());
        self.error_of(set.unwrap_or(&keys[0]), keys, message)
    }

    /// An error of `key`, at the place of the first of `keys` that was set, or else of the file.
    pub(super) fn error_of(&self, key: &str, keys: &[&str], message: impl Display) -> ConfigError {
        let place = keys.iter().chain(&[""]).find_map(|key| self.get(key));
        ConfigError::new(place, key, message)
    }
}
