use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

/// The start of a daemon, as far as this user may read it from the system: no service contains its
/// configuration.
pub(super) struct Invocation {
    process: PathBuf,
    command_line: Vec<String>,
    /// Environment variables that begin with `CDCR_`; `None` for another user's daemon.
    variables: Option<Map<String, Value>>,
}

impl Invocation {
    /// For the daemon with this process id; `None` in another container.
    pub(super) fn from_process(process_id: u32) -> Option<Self> {
        let process = PathBuf::from(format!("/proc/{process_id}"));
        let name = fs::read_to_string(process.join("comm")).ok()?;
        let words = words(&fs::read(process.join("cmdline")).ok()?);
        let variables = fs::read(process.join("environ")).ok();
        let of_ours = |variable: &String| {
            let (name, value) = variable.split_once('=')?;
            let is_ours = name.starts_with("CDCR_");
            is_ours.then(|| (name.to_owned(), Value::from(value)))
        };
        (name.trim() == "cdcrd").then(|| Self {
            process,
            command_line: words,
            variables: variables
                .map(|bytes| self::words(&bytes).iter().filter_map(of_ours).collect()),
        })
    }

    pub(super) fn json(&self) -> Value {
        json!({"command_line": self.command_line, "variables": self.variables})
    }

    /// The present content of its configuration file.
    pub(super) fn configuration(&self) -> Option<Vec<u8>> {
        let file = self.file()?;
        // A relative path refers to the working directory of the daemon.
        fs::read(self.process.join("cwd").join(file)).ok()
    }

    fn file(&self) -> Option<&Path> {
        let words = &self.command_line;
        let by_option = words.iter().enumerate().find_map(|(i, word)| {
            let rest = word.strip_prefix("--config")?;
            match rest.strip_prefix('=') {
                Some(file) => Some(file),
                None if rest.is_empty() => words.get(i + 1).map(String::as_str),
                None => None,
            }
        });
        let by_variable = || self.variables.as_ref()?.get("CDCR_CONFIG")?.as_str();
        by_option.or_else(by_variable).map(Path::new)
    }
}

/// Splits strings that end with a zero.
fn words(bytes: &[u8]) -> Vec<String> {
    let words = bytes
        .split(|byte| *byte == 0)
        .filter(|word| !word.is_empty());
    words
        .map(|word| String::from_utf8_lossy(word).into_owned())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_that_of_the_option_or_of_the_variable() {
        let file = |line: &str, variable: Option<&str>| {
            let variables = variable.map(|value| [("CDCR_CONFIG".to_owned(), value.into())]);
            let started = Invocation {
                process: PathBuf::new(),
                command_line: line.split(' ').map(str::to_owned).collect(),
                variables: variables.map(|all| all.into_iter().collect()),
            };
            started.file().map(Path::to_owned)
        };
        for (line, variable, expected) in [
            ("cdcrd run --config a.toml --set a=b", None, Some("a.toml")),
            ("cdcrd run --config=a.toml", Some("b.toml"), Some("a.toml")),
            ("cdcrd run", Some("b.toml"), Some("b.toml")),
            ("cdcrd run --config", None, None),
            ("cdcrd run --configs x", None, None),
        ] {
            assert_eq!(file(line, variable), expected.map(PathBuf::from), "{line}");
        }
    }
}
