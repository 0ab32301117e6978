use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use super::ConfigError;

/// Where a value comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// Nobody set it.
    Default,
    File {
        file: PathBuf,
        /// Line of the key, from 1; none when it is not known.
        line: Option<usize>,
    },
    /// An environment variable, by its name.
    Variable(String),
    /// An option of the command line, by its name.
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
    /// The error of a value that was set here.
    pub(super) fn error(&self, key: &str, message: &str) -> ConfigError {
        ConfigError::Value {
            origin: self.clone(),
            key: key.to_owned(),
            message: message.trim_end().to_owned(),
        }
    }
}

/// Where each value of a configuration comes from.
#[derive(Debug, Clone, Default)]
pub struct Origins {
    /// The file, where there is one.
    pub(super) file: Option<PathBuf>,
    /// What was set, by keys and elements like `robot.sections[1].length_m`.
    set: BTreeMap<String, Origin>,
}

impl Origins {
    pub(super) fn set(&mut self, key: String, origin: Origin) {
        self.set.insert(key, origin);
    }

    /// Forgets a key and its elements.
    pub(super) fn forget(&mut self, key: &str) {
        self.set.retain(|set, _| whole(set) != key);
    }

    /// Where the value of `key` comes from, which is written like `robot.sections[1].length_m`.
    pub fn of(&self, key: &str) -> Origin {
        let set = self.set.get(key).or_else(|| self.set.get(whole(key)));
        set.cloned().unwrap_or(Origin::Default)
    }

    /// An error at the first of `keys` that anybody set, or else at the first.
    pub(super) fn error(&self, keys: &[&str], message: &str) -> ConfigError {
        let is_set = |key: &&&str| self.of(key) != Origin::Default;
        match (keys.iter().find(is_set), &self.file) {
            (Some(key), _) => self.of(key).error(key, message),
            (None, None) => Origin::Default.error(keys[0], message),
            (None, Some(file)) => {
                let (file, line) = (file.clone(), None);
                Origin::File { file, line }.error(keys[0], message)
            }
        }
    }
}

/// The key that has a value of its own.
fn whole(key: &str) -> &str {
    key.split('[').next().unwrap_or(key)
}
