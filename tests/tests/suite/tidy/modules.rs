//! The modules of a crate and which of them name each other, read from the text of its files.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Names from the root of a crate on.
pub(super) type Names = Vec<String>;

/// Each module of a folder with those of this folder that it imports.
pub(super) type Graph = BTreeMap<String, BTreeSet<String>>;

/// Each folder of a crate with the graph of its modules; the root has the empty path.
pub(super) type Graphs = BTreeMap<Names, Graph>;

/// The path of a file's module from the root of its crate.
pub(super) fn module_of(file: &Path) -> Names {
    let parts = file.with_extension("");
    let parts = parts.iter().map(|part| part.to_str().unwrap().to_owned());
    let parts: Names = parts.filter(|part| part != "mod").collect();
    if ["lib", "main"].contains(&parts[0].as_str()) {
        return Names::new();
    }
    parts
}

/// The graphs of a crate. `files` are the paths of its modules with their code.
pub(super) fn graphs(files: &BTreeMap<Names, String>) -> Graphs {
    let mut graphs = Graphs::new();
    for module in files.keys() {
        for (depth, name) in module.iter().enumerate() {
            let graph = graphs.entry(module[..depth].to_vec()).or_default();
            graph.entry(name.clone()).or_default();
        }
    }
    let exports: BTreeMap<Names, Names> = files
        .iter()
        .flat_map(|(module, code)| re_exports(code, module))
        .collect();
    for (module, code) in files {
        for path in imports(code, module) {
            for path in meanings(path, &exports) {
                let shared = module.iter().zip(&path);
                let depth = shared.take_while(|(own, named)| own == named).count();
                // A module and what is below it are not siblings.
                let (Some(own), Some(named)) = (module.get(depth), path.get(depth)) else {
                    continue;
                };
                let graph = graphs.get_mut(&module[..depth]).unwrap();
                if graph.contains_key(named) {
                    graph.get_mut(own).unwrap().insert(named.clone());
                }
            }
        }
    }
    graphs
}

/// The path, and those to which re-exports lead from it.
fn meanings(path: Names, exports: &BTreeMap<Names, Names>) -> Vec<Names> {
    let mut found = vec![path];
    // A name that is exported again by its own module has no end.
    while found.len() < 8 {
        let path = &found[found.len() - 1];
        let begins = (1..=path.len()).find_map(|end| Some((end, exports.get(&path[..end])?)));
        let Some((end, target)) = begins else {
            break;
        };
        found.push([target, &path[end..]].concat());
    }
    found
}

/// The modules of a folder that lie on a circle.
pub(super) fn circle(graph: &Graph) -> BTreeSet<&str> {
    let leads_back = |module: &&str| {
        let mut seen = BTreeSet::new();
        let mut open = vec![*module];
        while let Some(next) = open.pop() {
            let named = graph[next].iter().map(String::as_str);
            open.extend(named.filter(|name| seen.insert(*name)));
        }
        seen.contains(module)
    };
    graph
        .keys()
        .map(String::as_str)
        .filter(leads_back)
        .collect()
}

/// Circles of a crate that cross folders, each as its folder and modules: all of the root, others where a module
/// has modules of its own.
pub(super) fn circles_across_folders(graphs: &Graphs) -> Vec<String> {
    let circles = graphs.iter().map(|(folder, graph)| (folder, circle(graph)));
    let across = circles.filter(|(folder, circle)| {
        let mut modules = circle.iter();
        let is_folder =
            |name: &&str| graphs.contains_key(&[&folder[..], &[(*name).to_owned()]].concat());
        modules.any(|name| folder.is_empty() || is_folder(name))
    });
    across
        .map(|(folder, circle)| format!("{}: {circle:?}", folder.join("/")))
        .collect()
}

/// The paths from the root of the crate that the code of a module names. Names after `$crate` in a macro belong
/// to the place of its use.
pub(super) fn imports(code: &str, module: &[String]) -> BTreeSet<Names> {
    let mut found = Vec::new();
    for (at, word) in code.match_indices("crate::") {
        if !code[..at].ends_with('$') {
            read_tree(&code[at + word.len()..], &[], &mut found);
        }
    }
    // `super::super::` leads up as many modules.
    let mut rest = code;
    while let Some(at) = rest.find("super::") {
        let mut ups = 0;
        rest = &rest[at..];
        while let Some(after) = rest.strip_prefix("super::") {
            (ups, rest) = (ups + 1, after);
        }
        let above = &module[..module.len().saturating_sub(ups)];
        read_tree(rest, above, &mut found);
    }
    found.into_iter().map(|(path, _)| path).collect()
}

/// The paths below another crate that code names, without the crate.
pub(super) fn named_below(code: &str, root: &str) -> BTreeSet<Names> {
    let mut found = Vec::new();
    let word = format!("{root}::");
    for (at, _) in code.match_indices(&word) {
        let is_longer =
            code[..at].ends_with(|before: char| before.is_alphanumeric() || before == '_');
        if !is_longer {
            read_tree(&code[at + word.len()..], &[], &mut found);
        }
    }
    found.into_iter().map(|(path, _)| path).collect()
}

/// Each name that a module imports, as a name in this module, with its path from the root.
pub(super) fn re_exports(code: &str, module: &[String]) -> Vec<(Names, Names)> {
    let mut found = Vec::new();
    let statements = code.split(';').filter_map(|text| text.split_once("use "));
    for (_, mut tree) in statements {
        let mut above = module;
        if let Some(rest) = tree.strip_prefix("crate::") {
            (above, tree) = (&[], rest);
        }
        while let Some(rest) = tree.strip_prefix("super::") {
            (above, tree) = (&above[..above.len().saturating_sub(1)], rest);
        }
        tree = tree.strip_prefix("self::").unwrap_or(tree);
        read_tree(tree, above, &mut found);
    }
    let named = |name| [module, &[name]].concat();
    let names = found.into_iter().map(|(path, name)| (named(name), path));
    names.filter(|(name, path)| name != path).collect()
}

/// Reads the paths of a `use` or an expression, each with the name that it has in its module. Returns the rest.
fn read_tree<'a>(text: &'a str, above: &[String], found: &mut Vec<(Names, String)>) -> &'a str {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    let text = text.trim_start();
    if let Some(mut rest) = text.strip_prefix('{') {
        while !rest.trim_start().starts_with('}') {
            let after = read_tree(rest, above, found);
            let end = after.find([',', '}']).unwrap_or(after.len());
            rest = after[end..].strip_prefix(',').unwrap_or(&after[end..]);
            if rest.is_empty() {
                return rest;
            }
        }
        return rest.trim_start().strip_prefix('}').unwrap_or(rest);
    }
    let (name, rest) = text.split_at(text.find(|c| !is_part(c)).unwrap_or(text.len()));
    let path = match name {
        // `*`, or a type in angle brackets.
        "" | "self" => above.to_vec(),
        _ => [above, &[name.to_owned()]].concat(),
    };
    if let Some(below) = rest.strip_prefix("::") {
        return read_tree(below, &path, found);
    }
    let alias = rest.strip_prefix(" as ");
    let alias = alias.map(|text| text.split(|c| !is_part(c)).next().unwrap().to_owned());
    let last = alias.or_else(|| path.last().cloned());
    found.extend(last.map(|last| (path, last)));
    rest
}
