//! What a run was asked for: two runs that were asked for different things are no measure of each other.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::hash::{DefaultHasher, Hasher};

use serde::{Deserialize, Serialize};

/// Where and how the result is written changes nothing that is measured.
const OF_THE_OUTPUT: [&str; 2] = ["out", "format"];

/// The option that names a file: its content is told, not its place.
const CONFIG: &str = "config";

/// The command and the options of a command line, by name, as they were written.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RunOptions(BTreeMap<String, String>);

impl RunOptions {
    pub fn find() -> Self {
        Self::of(std::env::args_os().skip(1))
    }

    /// Of a command line without the program. Every option has two dashes; one without a value is `true`.
    fn of(words: impl IntoIterator<Item = OsString>) -> Self {
        let mut options = BTreeMap::new();
        let mut words = words.into_iter().peekable();
        while let Some(word) = words.next() {
            let text = word.to_string_lossy().into_owned();
            let Some(option) = text.strip_prefix("--") else {
                options.insert("command".to_owned(), text);
                continue;
            };
            let (name, value) = match option.split_once('=') {
                Some((name, value)) => (name, Some(OsString::from(value))),
                None => (
                    option,
                    words.next_if(|next| !next.to_string_lossy().starts_with("--")),
                ),
            };
            if OF_THE_OUTPUT.contains(&name) {
                continue;
            }
            let value = match value {
                Some(file) if name == CONFIG => hash(&file),
                Some(value) => value.to_string_lossy().into_owned(),
                None => "true".to_owned(),
            };
            // An option that takes several values may be given several times.
            options
                .entry(name.to_owned())
                .and_modify(|all: &mut String| *all = format!("{all},{value}"))
                .or_insert(value);
        }
        Self(options)
    }

    /// Names and values of the options that differ, `none` where an option was not given.
    pub fn differing<'a>(&'a self, other: &'a Self) -> Vec<(&'a str, &'a str, &'a str)> {
        let value = |options: &'a Self, name| options.0.get(name).map_or("none", String::as_str);
        let only_theirs = other.0.keys().filter(|name| !self.0.contains_key(*name));
        let names = self.0.keys().chain(only_theirs);
        names
            .map(|name| (name.as_str(), value(self, name), value(other, name)))
            .filter(|(_, ours, theirs)| ours != theirs)
            .collect()
    }
}

/// Of the text of a file, in hexadecimal digits.
fn hash(file: &OsStr) -> String {
    let Ok(text) = fs::read(file) else {
        return "not readable".to_owned();
    };
    let mut hasher = DefaultHasher::new();
    hasher.write(&text);
    format!("{:016x}", hasher.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(words: &[&str]) -> RunOptions {
        RunOptions::of(words.iter().map(OsString::from))
    }

    #[test]
    fn the_same_line_written_differently_is_the_same() {
        let one = of(&[
            "deadline",
            "--rounds",
            "3",
            "--load=none",
            "--load",
            "cpu",
            "--out",
            "a",
        ]);
        let other = of(&[
            "deadline",
            "--load",
            "none,cpu",
            "--format=csv",
            "--rounds=3",
        ]);
        assert_eq!(one, other);
        assert!(one.differing(&other).is_empty());
        assert_eq!(
            serde_json::to_string(&one).expect("JSON"),
            r#"{"command":"deadline","load":"none,cpu","rounds":"3"}"#
        );
    }

    #[test]
    fn a_configuration_is_known_by_its_text_and_not_by_its_place() {
        let folder = tempfile::tempdir().expect("a folder");
        let with = |name: &str, text: &str| {
            let file = folder.path().join(name);
            fs::write(&file, text).expect("written");
            of(&["all", "--config", &file.to_string_lossy()])
        };
        let one = with("a.toml", "x = 1");
        assert_eq!(one, with("b.toml", "x = 1"));
        assert_ne!(one, with("a.toml", "x = 2"));
        let json = serde_json::to_string(&one).expect("JSON");
        assert!(!json.contains("toml"), "{json}");
    }
}
