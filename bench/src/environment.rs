//! The machine of a result, without which its numbers cannot be compared with others.
//!
//! Invariant: nothing here contains the name of the machine, its user or one of its folders.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::time::SystemTime;

use anyhow::Result;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::dataset::{flat, joined};
use crate::system::cores::Cores;
use crate::system::machine;

const MOVING: [&str; 11] = [
    "debug build",
    "hypervisor",
    "kernel clock source",
    "kernel isolation",
    "kernel release",
    "privileges lock memory",
    "privileges realtime",
    "processor cores",
    "processor governor",
    "processor model",
    "virtual machine",
];

/// The machine at the start of a run. Unavailable properties are null.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Environment(Map<String, Value>);

impl Environment {
    /// Reads the properties of this machine. Call it before any thread of this process is pinned.
    pub fn find() -> Result<Self> {
        let run = json!({
            // Start of the run in UTC, like `2026-11-21T12:00:00Z`.
            "started_utc": humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
            "cdcr_version": env!("CARGO_PKG_VERSION"),
            "commit": commit(),
            // Built without optimisation: its times are meaningless.
            "debug_build": cfg!(debug_assertions),
        });
        let all = joined([run, machine::describe(&Cores::find()?)]);
        Ok(serde_json::from_value(all)?)
    }

    pub fn is_realtime(&self) -> bool {
        self.value("privileges realtime") == true
    }

    fn value(&self, property: &str) -> Value {
        self.properties().remove(property).unwrap_or_default()
    }

    fn text(&self, property: &str) -> String {
        self.value(property).as_str().unwrap_or_default().to_owned()
    }

    fn properties(&self) -> BTreeMap<String, Value> {
        let named = |(key, value): (String, Value)| (key.replace('_', " "), value);
        flat(&json!(self)).into_iter().map(named).collect()
    }

    pub fn rows(&self) -> Vec<Value> {
        let row = |(property, value)| json!({ "property": property, "value": value });
        self.properties().into_iter().map(row).collect()
    }

    /// Properties that differ and affect absolute times. An older file may lack a property.
    pub(crate) fn differing(&self, other: &Self) -> Vec<(&'static str, Value, Value)> {
        let empty = [json!(null), json!(""), json!(false), json!(0), json!([])];
        let mut both = Vec::from(MOVING.map(|name| (name, self.value(name), other.value(name))));
        both.retain(|(_, old, new)| old != new && !(empty.contains(old) && empty.contains(new)));
        both
    }

    fn model_and_kernel(&self) -> String {
        let [model, release] = ["processor model", "kernel release"].map(|name| self.text(name));
        format!("{model}, kernel {release}")
    }

    /// The minimal description for a number: processor, kernel, real-time rights.
    pub fn line(&self) -> String {
        let realtime = ["refused", "granted"][usize::from(self.is_realtime())];
        let machine = self.model_and_kernel();
        format!("Measured on {machine}, real time {realtime}.")
    }

    pub(crate) fn run(&self) -> String {
        let [version, started] = ["cdcr version", "started utc"].map(|name| self.text(name));
        let commit = self.text("commit");
        let commit = Some(format!(" ({commit})")).filter(|_| !commit.is_empty());
        let (commit, machine) = (commit.unwrap_or_default(), self.model_and_kernel());
        format!("cdcr {version}{commit}, {started}, {machine}")
    }
}

/// The commit, with a `+` for changed files; `None` without git or outside a working copy of this project.
fn commit() -> Option<String> {
    let git = |arguments: &str| {
        let mut git = Command::new("git");
        git.arg("--no-optional-locks").args(arguments.split(' '));
        let output = git.output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        output.status.success().then(|| text.trim().to_owned())
    };
    let root = git("rev-parse --show-toplevel")?;
    let manifest = std::fs::read_to_string(Path::new(&root).join("bench/Cargo.toml")).ok()?;
    let is_ours = manifest.contains("name = \"cdcr-bench\"");
    let commit = || git("describe --always --abbrev=12 --exclude=* --dirty=+");
    is_ours.then(commit)?
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn what_was_written_is_read_again_and_names_neither_the_machine_nor_a_folder() {
        let here = Environment::find().expect("a machine");
        let json = serde_json::to_string(&here).expect("JSON");
        let read = |json: &str| serde_json::from_str::<Environment>(json).expect("few keys");
        assert_eq!(read(&json), here);
        let known = here.properties();
        assert!(MOVING.iter().all(|name| known.contains_key(*name)));
        let older = read("{\"kernel\":{}}");
        assert!(older.differing(&Environment::default()).is_empty());
        let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
        let folder = std::env::current_dir().expect("a folder");
        // Skipped if the host name is a word of the description.
        let host = host.trim();
        assert!(host.len() <= 4 || !json.contains(host), "{json}");
        assert!(!json.contains(&*folder.to_string_lossy()), "{json}");
    }
}
