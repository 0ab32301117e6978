//! Rules of ARCHITECTURE.md that the compiler does not enforce: forbidden imports of a folder, and the length
//! of a file.

mod forbidden;
mod modules;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use modules::{
    Graph, Graphs, Names, circle, circles_across_folders, graphs, imports, module_of, re_exports,
};

/// Sources of the crates with several modules, which import each other in one direction only.
const SOURCES: [&str; 17] = [
    "controller/src",
    "shared-types/src",
    "daemon/src",
    "client/src",
    "client/src/bin/cdcrctl",
    "interchange/src",
    "testbed/src",
    "testbed/process/src",
    "testbed/scratch/src",
    "bench/src",
    "c/src",
    "python/src",
    "tests/src",
    "tests/tests/suite",
    "tests/cases/src",
    "tests/skip/src",
    "packaging/src",
];

/// The folders of the controller in their order: each knows only those before it.
const CONTROLLER: [&str; 11] = [
    "parameters",
    "wide",
    "robot",
    "optimizer",
    "reference",
    "estimator",
    "nmpc",
    "safety",
    "calibration",
    "plant",
    "closed_loop",
];

/// Crates that only tests depend on.
const PROGRAMS: [&str; 5] = ["daemon", "view", "python", "bench", "tests"];

/// Largest length of a source file \[lines\].
const LINES_MAX: usize = 500;

/// Largest length of all Rust files of the instrument, which grows more easily than what it measures \[lines\].
const BENCH_LINES_MAX: usize = 10_000;

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

/// The code of a file without its unit tests and comments.
fn code(file: &Path) -> String {
    without_tests(&std::fs::read_to_string(file).unwrap())
}

/// Removes comments, and each item after `#[cfg(test)]` up to its end, a line `;` or `}`.
fn without_tests(text: &str) -> String {
    let mut kept = Vec::new();
    let mut lines = text
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"));
    while let Some(line) = lines.next() {
        let Some(indent) = line.strip_suffix("#[cfg(test)]") else {
            kept.push(line);
            continue;
        };
        let end = format!("{indent}}}");
        let _ = lines.find(|line| line.ends_with(';') && indent_of(line) == indent || *line == end);
    }
    kept.join("\n")
}

fn indent_of(line: &str) -> &str {
    &line[..line.len() - line.trim_start().len()]
}

/// The modules of a crate with their code.
fn modules_of(source: &str) -> BTreeMap<Names, String> {
    let root = workspace().join(source);
    let mut files = BTreeMap::<Names, String>::new();
    for file in sources(source) {
        let module = module_of(file.strip_prefix(&root).unwrap());
        if module.first().is_none_or(|name| name != "bin") {
            // The roots of a library and of a program beside it are one.
            files.entry(module).or_default().push_str(&code(&file));
        }
    }
    files
}

fn graphs_of(source: &str) -> Graphs {
    graphs(&modules_of(source))
}

/// Each top-level module of a crate with its imports.
fn graph(source: &str) -> Graph {
    graphs_of(source).remove(&vec![]).unwrap()
}

#[test]
fn the_folders_of_a_crate_import_each_other_in_one_direction_only() {
    for name in SOURCES {
        let graphs = graphs_of(name);
        let root = &graphs[&vec![]];
        assert!(!root.is_empty(), "{name} is not there");
        assert_eq!(circles_across_folders(&graphs), [""; 0], "{name}");
    }
}

/// `main.rs` knows each module, so what a module takes from it is a circle, too.
#[test]
fn no_module_of_cdcrctl_names_what_main_declares() {
    let files = modules_of("client/src/bin/cdcrctl");
    let modules: BTreeSet<_> = files.keys().filter_map(|module| module.first()).collect();
    for (module, code) in files.iter().filter(|(module, _)| !module.is_empty()) {
        let named = imports(code, module);
        let of_main = named.iter().find(|path| !modules.contains(&path[0]));
        assert_eq!(of_main, None, "{}", module.join("/"));
    }
}

#[test]
fn a_folder_of_the_controller_sees_only_those_above_it() {
    let graph = graph("controller/src");
    assert_eq!(graph.len(), CONTROLLER.len(), "{:?}", graph.keys());
    for (at, module) in CONTROLLER.iter().enumerate() {
        let mut imports = graph[*module].iter();
        let below = imports.find(|name| !CONTROLLER[..at].contains(&name.as_str()));
        assert_eq!(below, None, "{module}");
    }
}

/// A file at the root of the workspace.
fn text(path: &str) -> String {
    std::fs::read_to_string(workspace().join(path)).unwrap()
}

/// The folders of the packages.
fn members() -> Vec<String> {
    let root = text("Cargo.toml");
    let members = root.lines().find(|line| line.starts_with("members = "));
    let members = members.unwrap().split('"').skip(1).step_by(2);
    let members: Vec<_> = members.map(str::to_owned).collect();
    assert!(members.len() > 10, "{members:?}");
    members
}

#[test]
fn no_crate_with_several_modules_is_left_out() {
    let sources_of = members().into_iter().map(|member| format!("{member}/src"));
    let left_out = sources_of.filter(|folder| !SOURCES.contains(&&**folder));
    for folder in left_out {
        assert!(sources(&folder).len() <= 1, "{folder}");
    }
}

/// Each package of the workspace by its name without `cdcr-`, with its manifest.
fn packages() -> Vec<(String, String)> {
    let package = |member: String| {
        let manifest = text(&format!("{member}/Cargo.toml"));
        let (_, name) = manifest.split_once("name = \"cdcr-").unwrap();
        (name.split('"').next().unwrap().to_owned(), manifest)
    };
    members().into_iter().map(package).collect()
}

/// Our packages in the lines of a manifest.
fn ours<'a>(lines: impl Iterator<Item = &'a str>) -> BTreeSet<&'a str> {
    let lines = lines.filter_map(|line| line.strip_prefix("cdcr-"));
    lines
        .map(|line| line.split(['.', ' ']).next().unwrap())
        .collect()
}

#[test]
fn no_crate_but_the_tests_depends_on_a_program() {
    for (name, manifest) in packages().iter().filter(|(name, _)| name != "tests") {
        let ours = ours(manifest.lines());
        let found: Vec<_> = PROGRAMS
            .iter()
            .filter(|name| ours.contains(**name))
            .collect();
        assert!(found.is_empty(), "{name}: {found:?}");
    }
}

#[test]
fn the_page_shows_what_each_crate_depends_on() {
    let page = text("ARCHITECTURE.md");
    let (_, table) = page.split_once("\nDependencies among our crates").unwrap();
    let (table, _) = table.split_once("\n###").unwrap();
    let rows = table.lines().filter_map(|line| line.split_once(" → "));
    let shown: BTreeMap<&str, BTreeSet<&str>> = rows
        .map(|(name, rest)| {
            let names = rest.split("  ").next().unwrap().split(", ");
            let names = names.map(str::trim).filter(|name| *name != "-");
            (name.trim(), names.collect())
        })
        .collect();
    let packages = packages();
    assert_eq!(shown.len(), packages.len(), "{:?}", shown.keys());
    for (name, manifest) in packages.iter().filter(|(name, _)| name != "tests") {
        let lines = manifest
            .lines()
            .skip_while(|line| *line != "[dependencies]")
            .skip(1);
        let ours = ours(lines.take_while(|line| !line.starts_with('[')));
        assert_eq!(shown.get(&**name), Some(&ours), "{name}");
    }
}

/// See docs/decisions/0009: of the messages, `rt` names the numbers that it finds, and no message.
#[test]
fn rt_imports_nothing_of_the_daemon_and_three_things_of_the_messages() {
    assert_eq!(graph("daemon/src")["rt"], BTreeSet::new());
    let code: Vec<String> = sources("daemon/src/rt")
        .iter()
        .map(|file| code(file))
        .collect();
    let lines = code.iter().flat_map(|code| code.lines());
    let named = lines.filter_map(|line| line.split_once("cdcr_shared_types"));
    let names: BTreeSet<&str> = named.map(|(_, name)| name).collect();
    let expected = [
        "::codes::LateCause;",
        "::codes::realtime;",
        "::proc_stat::page_faults;",
    ];
    assert_eq!(names, BTreeSet::from(expected));
}

#[test]
fn a_circle_is_found() {
    let graph = |edges: &[(&str, &str)]| {
        let mut graph = Graph::new();
        for (from, to) in edges {
            graph.entry((*to).to_owned()).or_default();
            let imports = graph.entry((*from).to_owned()).or_default();
            imports.insert((*to).to_owned());
        }
        graph
    };
    assert!(circle(&graph(&[("a", "b"), ("b", "c"), ("a", "c")])).is_empty());
    let with_circle = graph(&[("a", "b"), ("b", "c"), ("c", "b"), ("c", "d")]);
    assert_eq!(circle(&with_circle), BTreeSet::from(["b", "c"]));
}

#[test]
fn a_circle_across_folders_is_found_at_any_depth() {
    let found = |files: &[(&str, &str)]| {
        let files = files.iter();
        let files = files.map(|(file, code)| (module_of(Path::new(file)), (*code).to_owned()));
        circles_across_folders(&graphs(&files.collect()))
    };
    let upper = ("lib.rs", "mod upper;");
    let exports = (
        "upper/mod.rs",
        "mod one;\nmod two;\npub use two::{Two, sum as total};",
    );
    let two = ("upper/two.rs", "use crate::upper::one::One;");
    let total = "fn f() { super::super::total() }";
    let circle = ["upper: {\"one\", \"two\"}"];
    assert_eq!(
        found(&[upper, exports, two, ("upper/one/part.rs", total)]),
        circle
    );
    // Neither a circle among the files of a folder nor one of a module and its parts.
    assert!(found(&[upper, exports, two, ("upper/one.rs", "use super::Two;")]).is_empty());
    let part = ("upper/one/part.rs", "use super::One;");
    assert!(found(&[upper, exports, two, ("upper/one.rs", "use part::f;"), part]).is_empty());
    // A circle of top-level modules, each a file.
    let (a, b) = (("a.rs", "use crate::b::B;"), ("b.rs", "use super::a::A;"));
    assert_eq!(found(&[a, b]), [": {\"a\", \"b\"}"]);
}

#[test]
fn every_way_to_name_a_module_is_seen() {
    let module = |path: &[&str]| {
        path.iter()
            .map(|part| (*part).to_owned())
            .collect::<Vec<_>>()
    };
    let names = |code, path: &[&str]| {
        let paths = imports(code, &module(path)).into_iter();
        paths.map(|path| path.join(" ")).collect::<Vec<_>>()
    };
    let code = "use crate::one::A;\nuse crate::{two::{x, self, y as z}, three::*};\nlet x = crate::four::<T>($crate::five);";
    let expected = ["four", "one A", "three", "two", "two x", "two y"];
    assert_eq!(names(code, &["own"]), expected);
    let code = "use super::{one, two::{A, B}};\nuse super::super::three::C;";
    assert_eq!(names(code, &["own"]), ["one", "three C", "two A", "two B"]);
    let expected = ["own one", "own two A", "own two B", "three C"];
    assert_eq!(names(code, &["own", "part"]), expected);
    let code = "use super::one;\nsuper::super::two();";
    assert_eq!(
        names(code, &["own", "part", "file"]),
        ["own part one", "own two"]
    );
    assert_eq!(
        module_of(Path::new("a/mod.rs")),
        module_of(Path::new("a.rs"))
    );
    let code = "mod one;\npub use one::A;\npub(crate) use crate::two::{B, b as c};\n#[cfg(x)]\npub use super::three::{C,\n    d,\n};";
    let exports = re_exports(code, &module(&["own"])).into_iter();
    let exports: Vec<_> = exports
        .map(|(name, path)| format!("{} = {}", name.join(" "), path.join(" ")))
        .collect();
    let expected = [
        "own A = own one A",
        "own B = two B",
        "own c = two b",
        "own C = three C",
        "own d = three d",
    ];
    assert_eq!(exports, expected);
}

#[test]
fn only_tests_are_left_out() {
    let text = "use a;\n#[cfg(test)]\nmod fake;\nuse b;\n#[cfg(test)]\nfn f(\n) {\n    g();\n}\n// c\nuse d;\n\
        #[cfg(test)]\nmod tests {\n    use e;\n}\n";
    assert_eq!(without_tests(text), "use a;\nuse b;\nuse d;");
}

#[test]
fn no_file_is_too_long() {
    let mut folders = vec![workspace().to_owned()];
    let (mut count, mut bench_lines) = (0, 0);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            let end = path.extension().and_then(|end| end.to_str());
            if path.is_dir() && name != "target" && !name.starts_with('.') {
                folders.push(path);
            } else if let Some("rs" | "py") = end {
                let lines = std::fs::read_to_string(&path).unwrap().lines().count();
                assert!(lines <= LINES_MAX, "{} has {lines} lines", path.display());
                count += 1;
                if end == Some("rs") && path.starts_with(workspace().join("bench")) {
                    bench_lines += lines;
                }
            }
        }
    }
    assert!(count > 500, "{count} files");
    assert!(
        bench_lines <= BENCH_LINES_MAX,
        "bench has {bench_lines} lines"
    );
}
