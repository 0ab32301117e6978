use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use super::ConfigError;

/// Origin of a value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// Not set.
    Default,
    File {
        file: PathBuf,
        /// Line of the key, from 1; `None` if unknown.
        line: Option<usize>,
    },
    /// Name of an environment variable.
    Variable(String),
    /// Name of a command-line option.
    Option(&'static str),
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::File { file, line } => {
                write!(f, "{}", file.display())?;
                line.map_or(Ok(()), |line| write!(f, ", line {line}"))
            }
            Self::Variable(name) => f.write_str(name),
            Self::Option(name) => f.write_str(name),
        }
    }
}

impl Origin {
    /// The error of a value with this origin.
    pub(super) fn error(&self, key: &str, message: &str) -> ConfigError {
        ConfigError::Value {
            origin: self.clone(),
            key: key.to_owned(),
            message: message.trim_end().to_owned(),
        }
    }
}

/// Origins of the values of a configuration.
#[derive(Debug, Clone, Default)]
pub struct Origins {
    /// The file, if any.
    pub(super) file: Option<PathBuf>,
    /// Values that were set, by keys and elements like `robot.sections[1].length_m`.
    set: BTreeMap<String, Origin>,
}

impl Origins {
    pub(super) fn set(&mut self, key: String, origin: Origin) {
        self.set.insert(key, origin);
    }

    /// Removes a key and its elements.
    pub(super) fn forget(&mut self, key: &str) {
        self.set.retain(|set, _| whole(set) != key);
    }

    /// Origin of the value of `key`, which may have the form `robot.sections[1].length_m`.
    pub fn get(&self, key: &str) -> Origin {
        let set = self.set.get(key).or_else(|| self.set.get(whole(key)));
        set.cloned().unwrap_or(Origin::Default)
    }

    /// An error at the first of `keys` that was set, or else at the first.
    pub(super) fn error(&self, keys: &[&str], message: &str) -> ConfigError {
        let set = keys.iter().find(|key| self.get(key) != Origin::Default);
        self.place(keys).error(set.unwrap_or(&keys[0]), message)
    }

    /// An error of the first of `keys`, at the place of the first that was set.
    pub(super) fn error_of_first(&self, keys: &[&str], message: &str) -> ConfigError {
        self.place(keys).error(keys[0], message)
    }

    /// The place of the first of `keys` that was set, or else of the file.
    fn place(&self, keys: &[&str]) -> Origin {
        let mut set = keys.iter().map(|key| self.get(key));
        let whole = self.file.as_ref().map_or(Origin::Default, |file| {
            let (file, line) = (file.clone(), None);
            Origin::File { file, line }
        });
        set.find(|origin| *origin != Origin::Default)
            .unwrap_or(whole)
    }
}

/// The settable key that contains `key`.
fn whole(key: &str) -> &str {
    key.split('[').next().unwrap_or(key)
}
