//! Options of a run: runs with different options cannot be compared.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::hash::{DefaultHasher, Hasher};
use std::path::Path;

use clap::ArgMatches;
use clap::parser::ValueSource;
use serde::{Deserialize, Serialize};

/// Command and options of a command line, by name.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct RunOptions(BTreeMap<String, String>);

impl RunOptions {
    /// The given options of this program, except those for the place and format of the result.
    pub fn from_matches(command: &clap::Command, matches: &ArgMatches) -> Self {
        let Some((name, matches)) = matches.subcommand() else {
            return Self::default();
        };
        let mut options = BTreeMap::from([("command".to_owned(), name.to_owned())]);
        let arguments = command.find_subcommand(name).into_iter();
        for argument in arguments.flat_map(clap::Command::get_arguments) {
            let id = argument.get_id().as_str();
            let long = argument.get_long().unwrap_or("out");
            let is_given = matches.value_source(id) == Some(ValueSource::CommandLine);
            if !is_given || ["out", "format"].contains(&long) {
                continue;
            }
            let text = |value: &OsStr| match long {
                // The content of the file instead of its path.
                "config" => hash(Path::new(value)),
                _ => value.to_string_lossy().into_owned(),
            };
            let values = matches.get_raw(id).into_iter().flatten().map(text);
            options.insert(long.to_owned(), values.collect::<Vec<_>>().join(","));
        }
        Self(options)
    }

    pub fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    pub fn differing<'a>(&'a self, other: &'a Self) -> Vec<(&'a str, &'a str, &'a str)> {
        let value = |options: &'a Self, name| options.0.get(name).map_or("none", String::as_str);
        let names: BTreeSet<&String> = self.0.keys().chain(other.0.keys()).collect();
        let both = |name: &'a String| (name.as_str(), value(self, name), value(other, name));
        let all = names.into_iter().map(both);
        all.filter(|(_, ours, theirs)| ours != theirs).collect()
    }
}

fn hash(file: &Path) -> String {
    let Ok(text) = std::fs::read(file) else {
        return "not readable".to_owned();
    };
    let mut hasher = DefaultHasher::new();
    hasher.write(&text);
    format!("{:016x}", hasher.finish())
}

#[cfg(test)]
mod tests {
    use clap::Args as _;

    use super::*;
    use crate::deadline::DeadlineOptions;

    #[test]
    fn the_options_of_a_run_are_what_it_was_asked_for() {
        let deadline = DeadlineOptions::augment_args(clap::Command::new("deadline"));
        let command = clap::Command::new("bench").subcommand(deadline);
        let of = |words: &str| {
            let words = format!("bench deadline {words}");
            let matches = command.clone().get_matches_from(words.split(' '));
            RunOptions::from_matches(&command, &matches)
        };
        let one = of("--load=none --load cpu --rounds 3");
        assert_eq!(one, of("--rounds=3 --load none,cpu"));
        let differing = of("--load none,cpu");
        assert_eq!(one.differing(&differing), [("rounds", "3", "none")]);
        // Configurations are compared by content, not by path.
        let with = |file: &str| of(&format!("--config ../configs/{file}"));
        assert_ne!(with("default.toml"), with("one-section.toml"));
        assert_eq!(with("default.toml"), with("../configs/default.toml"));
        assert!(!format!("{:?}", with("default.toml")).contains("toml"));
    }
}
