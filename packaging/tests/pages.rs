//! The pages of the Debian package have the layout of the repository: each relative link leads to a file or a folder
//! of the package.

#![allow(clippy::unwrap_used, reason = "in a test a panic is the report")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

const DAEMON: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../daemon");
const PAGES: &str = "usr/share/doc/cdcr/";

/// The installed documentation: path below its folder, and source.
fn installed() -> BTreeMap<PathBuf, PathBuf> {
    let manifest = fs::read_to_string(Path::new(DAEMON).join("Cargo.toml")).unwrap();
    let (_, package) = manifest.split_once("[package.metadata.deb]").unwrap();
    let lines = package
        .lines()
        .map(|line| line.trim().trim_end_matches(','));
    // An asset is a JSON array, too.
    let assets = lines.filter(|line| line.starts_with("[\"../"));
    let mut files = BTreeMap::new();
    for asset in assets {
        let [source, target, _]: [String; 3] = serde_json::from_str(asset).unwrap();
        let Some(below) = target.strip_prefix(PAGES) else {
            continue;
        };
        for source in sources(&Path::new(DAEMON).join(&source)) {
            let name = source.file_name().unwrap();
            let is_folder = below.is_empty() || below.ends_with('/');
            let path = if is_folder {
                Path::new(below).join(name)
            } else {
                below.into()
            };
            files.insert(path, source);
        }
    }
    files
}

/// The files that an asset names, with at most one `*` in their name.
fn sources(pattern: &Path) -> Vec<PathBuf> {
    let name = pattern.file_name().unwrap().to_str().unwrap();
    let Some((start, end)) = name.split_once('*') else {
        return vec![pattern.to_owned()];
    };
    let entries = fs::read_dir(pattern.parent().unwrap()).unwrap();
    let paths = entries.map(|entry| entry.unwrap().path());
    let is_named = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap();
        path.is_file() && name.starts_with(start) && name.ends_with(end)
    };
    paths.filter(is_named).collect()
}

/// The relative links of a page, without their anchors.
fn links(text: &str) -> Vec<&str> {
    let mut is_code = false;
    let prose = text.lines().filter(|line| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        !is_code && !is_fence
    });
    let starts = prose.flat_map(|line| line.split("](").skip(1));
    let targets = starts.filter_map(|rest| rest.split([')', '#']).next());
    let is_relative = |link: &&str| !link.is_empty() && !link.contains(':');
    targets.filter(is_relative).collect()
}

/// The path with `..` resolved by its text.
fn resolved(path: &Path) -> PathBuf {
    let mut resolved = PathBuf::new();
    for part in path.components() {
        if part == Component::ParentDir {
            assert!(resolved.pop(), "{} leaves the folder", path.display());
        } else {
            resolved.push(part);
        }
    }
    resolved
}

#[test]
fn every_link_of_an_installed_page_leads_to_an_installed_file() {
    let files = installed();
    let mut count = 0;
    for (page, source) in &files {
        if page.extension().is_none_or(|end| end != "md") {
            continue;
        }
        let text = fs::read_to_string(source).unwrap();
        for link in links(&text) {
            count += 1;
            let target = resolved(&page.parent().unwrap().join(link));
            assert_ne!(target, Path::new(""), "{}: {link}", page.display());
            let is_there = files.keys().any(|file| file.starts_with(&target));
            assert!(is_there, "{}: {link}", page.display());
        }
    }
    assert!(count > 100, "{count} links");
}
