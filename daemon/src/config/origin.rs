use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::PathBuf;

use toml_edit::{Document, Item};

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
            Self::File { file, line: None } => write!(f, "{}", file.display()),
            Self::File {
                file,
                line: Some(line),
            } => write!(f, "{}, line {line}", file.display()),
            Self::Variable(name) => f.write_str(name),
            Self::Option(name) => f.write_str(name),
        }
    }
}

/// Where each value of a configuration comes from.
#[derive(Debug, Clone, Default)]
pub struct Origins {
    file: Option<(PathBuf, Document<String>)>,
    /// What was set over the file, key by key.
    set: BTreeMap<String, Origin>,
}

impl Origins {
    pub(super) fn set_file(&mut self, file: PathBuf, document: Document<String>) {
        self.file = Some((file, document));
    }

    pub(super) fn set_key(&mut self, key: String, origin: Origin) {
        self.set.insert(key, origin);
    }

    /// Where the value of `key` comes from, which is written like `robot.sections[1].length_m`.
    pub fn of(&self, key: &str) -> Origin {
        let whole = key.split('[').next().unwrap_or(key);
        if let Some(origin) = self.set.get(whole) {
            return origin.clone();
        }
        let in_file = self.file.as_ref().and_then(|(file, document)| {
            let (_, span) = found(document.as_item(), key)?;
            Some(Origin::File {
                file: file.clone(),
                line: span.map(|span| line_at(document.raw(), span.start)),
            })
        });
        in_file.unwrap_or(Origin::Default)
    }

    /// An error at the first of `keys` that anybody set, or else at the first.
    pub(super) fn error(&self, keys: &[&str], message: &str) -> ConfigError {
        let mut places = keys.iter().map(|key| (self.of(key), *key));
        let set = places.find(|(origin, _)| *origin != Origin::Default);
        let (origin, key) = set.unwrap_or_else(|| {
            let file = self.file.as_ref().map(|(file, _)| file.clone());
            let origin = file.map(|file| Origin::File { file, line: None });
            let key = keys.first().copied().unwrap_or_default();
            (origin.unwrap_or(Origin::Default), key)
        });
        ConfigError::Value {
            origin,
            key: key.to_owned(),
            message: message.to_owned(),
        }
    }
}

/// The line, from 1, of a byte of a text.
pub(super) fn line_at(text: &str, offset: usize) -> usize {
    let before = text.as_bytes().iter().take(offset);
    1 + before.filter(|byte| **byte == b'\n').count()
}

/// The key whose value stands at a byte of the text, written like `robot.sections[1].length_m`.
pub(super) fn key_at(root: &Item, offset: usize) -> Option<String> {
    fn below(item: &Item, key: &str, offset: usize) -> Option<String> {
        let dot = if key.is_empty() { "" } else { "." };
        let named = item.as_table_like().and_then(|table| {
            let mut keys = table.iter();
            keys.find_map(|(name, item)| below(item, &format!("{key}{dot}{name}"), offset))
        });
        let mut numbered = (0..).map_while(|index| Some((index, item.get(index)?)));
        named
            .or_else(|| {
                numbered.find_map(|(at, item)| below(item, &format!("{key}[{at}]"), offset))
            })
            .or_else(|| item.span()?.contains(&offset).then(|| key.to_owned()))
    }
    below(root, "", offset).filter(|key| !key.is_empty())
}

/// The value of a key, and which bytes of the text the key is, where that is known.
fn found<'a>(root: &'a Item, key: &str) -> Option<(&'a Item, Option<Range<usize>>)> {
    let mut item = root;
    let mut span = None;
    for part in key.split('.') {
        let (name, index) = match part.split_once('[') {
            Some((name, rest)) => (name, rest.trim_end_matches(']').parse::<usize>().ok()),
            None => (part, None),
        };
        let (key, value) = item.as_table_like()?.get_key_value(name)?;
        (item, span) = (value, key.span().or_else(|| value.span()));
        if let Some(index) = index {
            item = item.get(index)?;
            span = item.span();
        }
    }
    Some((item, span))
}
