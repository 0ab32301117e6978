//! The rules of ARCHITECTURE.md that the compiler does not keep: what a folder must not import, and how long a file may be.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Crates whose folders import each other in one direction only.
const CRATES: [&str; 4] = ["controller", "shared-types", "daemon", "client"];

/// No file is longer \[lines\].
const LINES_MAX: usize = 550;

/// What must not stand in the sources below a path, and why.
const FORBIDDEN: &[(&str, &str, &str)] = &[
    (
        "controller/src",
        "iceoryx2",
        "the mathematics knows no shared memory",
    ),
    (
        "controller/src",
        "std::time",
        "the mathematics knows no clock",
    ),
    (
        "controller/src",
        "std::thread",
        "the mathematics starts no thread",
    ),
    ("controller/src", "std::fs", "the mathematics reads no file"),
    ("daemon/src/rt", "cdcr_controller", "rt knows no robot"),
    (
        "daemon/src/rt",
        "crate::config",
        "rt knows no configuration",
    ),
    ("daemon/src/rt", "iceoryx2", "rt knows no shared memory"),
    (
        "daemon/src/cycle",
        "iceoryx2",
        "the cycle knows no shared memory",
    ),
    (
        "daemon/src/cycle",
        "cdcr_shared_types",
        "the cycle knows no message",
    ),
    ("daemon/src/cycle", "tracing::", "the cycle does not log"),
    (
        "daemon/src/handover",
        "iceoryx2",
        "what threads exchange knows no shared memory",
    ),
    (
        "daemon/src/bare",
        "iceoryx2",
        "the bare loop knows no shared memory",
    ),
];

fn workspace() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// The Rust files below a folder, and `<folder>.rs`, without tests.
fn sources(place: &str) -> Vec<PathBuf> {
    let mut folders = vec![workspace().join(place)];
    let mut files = vec![workspace().join(format!("{place}.rs"))];
    files.retain(|file| file.exists());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            if path.is_dir() && name != "tests" {
                folders.push(path);
            } else if path.extension().is_some_and(|end| end == "rs") && name != "tests.rs" {
                files.push(path);
            }
        }
    }
    files
}

/// The code of a file before its unit tests, without comments.
fn code(file: &Path) -> String {
    let text = std::fs::read_to_string(file).unwrap();
    let code = text.split("#[cfg(test)]\nmod ").next().unwrap();
    let lines = code
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"));
    lines.collect::<Vec<_>>().join("\n")
}

/// Modules of the crate that `code` names: the first name of each path that begins with `crate::`.
fn imports(code: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for after in code.split("crate::").skip(1) {
        let group = after
            .strip_prefix('{')
            .and_then(|group| group.split_once("};"));
        let paths = match group {
            Some((paths, _)) => paths.split(',').collect(),
            None => vec![after],
        };
        for path in paths {
            let name = path
                .trim()
                .split(|c: char| !c.is_alphanumeric() && c != '_')
                .next();
            names.extend(name.filter(|name| !name.is_empty()).map(str::to_owned));
        }
    }
    names
}

/// Each top module of a crate with those that it imports.
fn graph(source: &str) -> BTreeMap<String, BTreeSet<String>> {
    let root = workspace().join(source);
    let mut graph = BTreeMap::<String, BTreeSet<String>>::new();
    for file in sources(source) {
        let below = file.strip_prefix(&root).unwrap().iter().next().unwrap();
        let module = below.to_str().unwrap().trim_end_matches(".rs").to_owned();
        if !["lib", "main", "bin"].contains(&module.as_str()) {
            graph
                .entry(module)
                .or_default()
                .extend(imports(&code(&file)));
        }
    }
    let modules: BTreeSet<_> = graph.keys().cloned().collect();
    for (module, imports) in &mut graph {
        imports.retain(|name| name != module && modules.contains(name));
    }
    graph
}

/// What is left when every module that imports nothing is taken away, again and again: empty without a circle.
fn circles(mut graph: BTreeMap<String, BTreeSet<String>>) -> BTreeMap<String, BTreeSet<String>> {
    loop {
        let (free, rest): (BTreeMap<_, _>, BTreeMap<_, _>) = graph
            .into_iter()
            .partition(|(_, imports)| imports.is_empty());
        if free.is_empty() {
            return rest;
        }
        graph = rest;
        for imports in graph.values_mut() {
            imports.retain(|name| !free.contains_key(name));
        }
    }
}

#[test]
fn the_folders_of_a_crate_import_each_other_in_one_direction_only() {
    for name in CRATES {
        let graph = graph(&format!("{name}/src"));
        assert!(graph.len() > 1, "{name}: {graph:?}");
        let circles = circles(graph);
        assert!(
            circles.is_empty(),
            "{name} has a circle among: {circles:#?}"
        );
    }
}

#[test]
fn a_circle_is_found() {
    let graph = |edges: &[(&str, &str)]| {
        let mut graph = BTreeMap::<String, BTreeSet<String>>::new();
        for (from, to) in edges {
            graph.entry((*to).to_owned()).or_default();
            graph
                .entry((*from).to_owned())
                .or_default()
                .insert((*to).to_owned());
        }
        graph
    };
    assert!(circles(graph(&[("a", "b"), ("b", "c"), ("a", "c")])).is_empty());
    let left = circles(graph(&[("a", "b"), ("b", "c"), ("c", "b"), ("c", "d")]));
    assert_eq!(left.keys().collect::<Vec<_>>(), ["a", "b", "c"]);
    let code = "use crate::one::A;\nuse crate::{two, three::B};\nlet x = crate::four(1);";
    assert_eq!(
        imports(code),
        ["four", "one", "three", "two"].map(str::to_owned).into()
    );
}

#[test]
fn no_folder_knows_what_it_must_not() {
    for (place, word, why) in FORBIDDEN {
        let files = sources(place);
        assert!(!files.is_empty(), "{place} is not there");
        for file in files {
            let found = code(&file).lines().position(|line| line.contains(word));
            assert_eq!(found, None, "{}: {word}: {why}", file.display());
        }
    }
}

#[test]
fn no_file_is_too_long() {
    for name in CRATES.iter().chain(&["bench", "tests", "packaging"]) {
        for part in ["src", "tests"] {
            for file in sources(&format!("{name}/{part}")) {
                let lines = std::fs::read_to_string(&file).unwrap().lines().count();
                assert!(lines <= LINES_MAX, "{} has {lines} lines", file.display());
            }
        }
    }
}
