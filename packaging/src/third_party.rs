//! Prints names, versions, licences and licence texts of all packages linked into the programs of the Debian
//! package. `cargo run -p cdcr-packaging --bin third-party > packaging/generated/THIRD-PARTY`

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::Value;

/// The packages whose programs are in the Debian package.
const OURS: [&str; 3] = ["cdcr-daemon", "cdcr-client", "cdcr-bench"];
/// The platforms of the list.
const PLATFORMS: [&str; 2] = ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"];

/// The id of a package.
type Id<'a> = &'a str;

/// A third-party package.
struct Foreign<'a> {
    title: String,
    licence: &'a str,
    folder: &'a Path,
}

fn main() -> Result<()> {
    let metadata = metadata()?;
    let mut foreign = linked(&metadata)?;
    foreign.sort_by(|a, b| a.title.cmp(&b.title));
    print!("{}", document(&foreign)?);
    Ok(())
}

/// Metadata of the workspace and its dependencies from cargo.
fn metadata() -> Result<Value> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(["metadata", "--format-version", "1", "--locked"]);
    for platform in PLATFORMS {
        command.args(["--filter-platform", platform]);
    }
    let output = command
        .args([
            "--manifest-path",
            concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"),
        ])
        .output()
        .context("cargo cannot be run")?;
    let complaint = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "cargo metadata: {complaint}");
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// All third-party packages that are linked into the project's programs.
fn linked(metadata: &Value) -> Result<Vec<Foreign<'_>>> {
    let packages = by_id(&metadata["packages"])?;
    let nodes = by_id(&metadata["resolve"]["nodes"])?;
    let is_ours = |id: &Id<'_>| packages[id]["source"].is_null();
    let mut open: Vec<Id<'_>> = packages
        .iter()
        .filter(|(_, package)| {
            package["name"]
                .as_str()
                .is_some_and(|name| OURS.contains(&name))
        })
        .map(|(id, _)| *id)
        .collect();
    ensure!(
        open.len() == OURS.len(),
        "not all of {OURS:?} are in the workspace"
    );
    let mut seen = BTreeSet::new();
    while let Some(id) = open.pop() {
        if seen.insert(id) {
            let below = linked_below(nodes[id]);
            open.extend(below.filter(|id| !is_macro(packages[id])));
        }
    }
    let foreign = seen.into_iter().filter(|id| !is_ours(id));
    foreign
        .map(|id| Foreign::from_package(packages[id]))
        .collect()
}

fn by_id(list: &Value) -> Result<BTreeMap<Id<'_>, &Value>> {
    let entries = list.as_array().context("cargo metadata has no list")?;
    entries
        .iter()
        .map(|entry| Ok((entry["id"].as_str().context("an entry has no id")?, entry)))
        .collect()
}

/// The packages linked into a package: neither build nor test dependencies.
fn linked_below(node: &Value) -> impl Iterator<Item = Id<'_>> {
    let below = node["deps"].as_array().into_iter().flatten();
    below
        .filter(|dependency| {
            let kinds = dependency["dep_kinds"].as_array();
            kinds.is_some_and(|kinds| kinds.iter().any(|kind| kind["kind"].is_null()))
        })
        .filter_map(|dependency| dependency["pkg"].as_str())
}

/// A procedural macro runs in the compiler.
fn is_macro(package: &Value) -> bool {
    let targets = package["targets"].as_array().into_iter().flatten();
    let mut kinds = targets
        .filter_map(|target| target["kind"].as_array())
        .flatten();
    kinds.any(|kind| kind == "proc-macro")
}

impl<'a> Foreign<'a> {
    fn from_package(package: &'a Value) -> Result<Self> {
        let text = |key: &str| package[key].as_str();
        let name = text("name").context("a package without a name")?;
        let version = text("version").context("a package without a version")?;
        let manifest = text("manifest_path").context("a package without a manifest")?;
        Ok(Self {
            title: format!("{name} {version}"),
            licence: text("license").with_context(|| format!("{name} names no licence"))?,
            folder: Path::new(manifest)
                .parent()
                .context("a manifest without a folder")?,
        })
    }

    /// The licence texts contained in the package.
    fn texts(&self) -> Result<Vec<String>> {
        let mut files: Vec<_> = fs::read_dir(self.folder)
            .with_context(|| self.title.clone())?
            .filter_map(Result::ok)
            .filter(|file| is_licence(&file.file_name().to_string_lossy()))
            .map(|file| file.path())
            .filter(|path| path.is_file())
            .collect();
        files.sort();
        let read = |path| Ok(String::from_utf8_lossy(&fs::read(path)?).into_owned());
        files.into_iter().map(read).collect()
    }
}

fn is_licence(file: &str) -> bool {
    let file = file.to_ascii_uppercase();
    let starts = [
        "LICENSE",
        "LICENCE",
        "COPYING",
        "COPYRIGHT",
        "NOTICE",
        "UNLICENSE",
    ];
    starts.iter().any(|start| file.starts_with(start))
}

/// The list, then each text once with the names of its packages.
fn document(foreign: &[Foreign<'_>]) -> Result<String> {
    let mut text = String::from(HEAD);
    let mut texts: BTreeMap<String, (String, Vec<&str>)> = BTreeMap::new();
    let mut without = Vec::new();
    for package in foreign {
        writeln!(text, "  {:40} {}", package.title, package.licence)?;
        let own = package.texts()?;
        if own.is_empty() {
            without.push(package.title.as_str());
        }
        for licence in own {
            // Texts that differ only in line breaks are equal.
            let words = licence.split_whitespace().collect::<Vec<_>>().join(" ");
            let entry = texts.entry(words).or_insert_with(|| (licence, Vec::new()));
            entry.1.push(&package.title);
        }
    }
    text += "\nPackages whose source brings no licence text; that of their licence is among those below:\n";
    for title in without {
        writeln!(text, "  {title}")?;
    }
    let mut texts: Vec<_> = texts.into_values().collect();
    texts.sort_by(|(_, a), (_, b)| a.cmp(b));
    for (licence, mut titles) in texts {
        titles.dedup();
        let line = "-".repeat(78);
        let licence: Vec<_> = licence.lines().map(str::trim_end).collect();
        writeln!(text, "\n{line}\n{}\n{line}\n", titles.join(", "))?;
        text += licence.join("\n").trim_matches('\n');
        text += "\n";
    }
    Ok(text)
}

const HEAD: &str = "\
What is linked into cdcrd, cdcrctl and cdcr-bench besides their own code
========================================================================

The standard library of Rust, MIT OR Apache-2.0 (Copyright (c) The Rust Project Contributors), and the
packages below, with their licences in the words of SPDX. Where a licence offers a choice with MIT, MIT
is chosen. Made by `cargo run -p cdcr-packaging --bin third-party`.

";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_builds_tests_or_expands_is_not_linked() {
        let node = serde_json::json!({"deps": [
            {"pkg": "linked", "dep_kinds": [{"kind": "dev"}, {"kind": null}]},
            {"pkg": "tests", "dep_kinds": [{"kind": "dev"}]},
            {"pkg": "builds", "dep_kinds": [{"kind": "build"}]},
        ]});
        assert_eq!(linked_below(&node).collect::<Vec<_>>(), ["linked"]);
        assert!(is_macro(
            &serde_json::json!({"targets": [{"kind": ["proc-macro"]}]})
        ));
        assert!(!is_macro(
            &serde_json::json!({"targets": [{"kind": ["lib"]}]})
        ));
    }

    #[test]
    fn every_linked_package_is_listed_with_its_licence_and_no_helper_is() {
        let metadata = metadata().expect("cargo runs");
        let foreign = linked(&metadata).expect("legal");
        let has = |name: &str| {
            foreign
                .iter()
                .any(|package| package.title.starts_with(name))
        };
        for name in ["iceoryx2 ", "nalgebra ", "clap ", "plotters "] {
            assert!(has(name), "{name}");
        }
        for name in [
            "cdcr",
            "criterion ",
            "clap_mangen ",
            "serde_derive ",
            "proptest ",
        ] {
            assert!(!has(name), "{name}");
        }
        let clap = foreign
            .iter()
            .find(|package| package.title.starts_with("clap "));
        let texts = clap.expect("checked above").texts().expect("readable");
        assert!(
            texts
                .iter()
                .any(|text| text.contains("Permission is hereby granted"))
        );
    }
}
