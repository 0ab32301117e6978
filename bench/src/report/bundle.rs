//! Files that belong together, and how they reach a folder: all of them, or none.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};

/// More files of one kind than this are counted, not named.
const NAMED_MAX: usize = 4;

/// Files by their name, which may have a folder in front.
#[derive(Debug, Default)]
pub struct Bundle {
    files: BTreeMap<String, String>,
}

impl Bundle {
    pub fn add(&mut self, name: impl Into<String>, text: String) -> Result<()> {
        let name = name.into();
        ensure!(
            !self.files.contains_key(&name),
            "two files of one result are called {name}"
        );
        self.files.insert(name, text);
        Ok(())
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.files.keys().map(String::as_str)
    }

    /// Writes all files into `folder`, which is made if it does not exist. They are written beside their place
    /// first, and take it once all are complete: a disk that is full leaves the older files alone.
    pub fn write(&self, folder: &Path) -> Result<()> {
        make(folder)?;
        let fresh = tempfile::Builder::new()
            .prefix(".new-")
            .tempdir_in(folder)
            .with_context(|| format!("cannot write into the folder {}", folder.display()))?;
        for (name, text) in &self.files {
            let file = fresh.path().join(name);
            make(file.parent().unwrap_or(fresh.path()))?;
            fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))?;
        }
        for name in self.files.keys() {
            let place = folder.join(name);
            make(place.parent().unwrap_or(folder))?;
            fs::rename(fresh.path().join(name), &place)
                .with_context(|| format!("cannot write {}", place.display()))?;
        }
        Ok(())
    }

    /// What is in it, in words: few files by name, many counted by kind.
    pub fn words(&self) -> String {
        let mut kinds: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for name in self.names() {
            let (_, kind) = name.rsplit_once('.').unwrap_or((name, "file"));
            kinds.entry(kind).or_default().push(name);
        }
        let words: Vec<String> = kinds
            .into_iter()
            .map(|(kind, names)| {
                if names.len() <= NAMED_MAX {
                    names.join(", ")
                } else {
                    format!("{} {}", names.len(), kind.to_uppercase())
                }
            })
            .collect();
        words.join(", ")
    }
}

fn make(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bundle(text: &str) -> Bundle {
        let mut bundle = Bundle::default();
        bundle.add("a.txt", text.to_owned()).expect("a first");
        bundle.add("deep/b.hlog", text.to_owned()).expect("another");
        bundle
    }

    #[test]
    fn a_folder_holds_the_files_and_nothing_else() {
        let place = tempfile::tempdir().expect("a folder");
        let folder = place.path().join("new");
        bundle("old").write(&folder).expect("written");
        bundle("new").write(&folder).expect("written over");
        for name in ["a.txt", "deep/b.hlog"] {
            assert_eq!(fs::read_to_string(folder.join(name)).expect(name), "new");
        }
        let entries = fs::read_dir(&folder).expect("a folder").count();
        assert_eq!(entries, 2, "no file for the time between is left");
    }

    #[test]
    fn a_file_that_cannot_be_made_leaves_the_older_ones_alone() {
        let place = tempfile::tempdir().expect("a folder");
        bundle("old").write(place.path()).expect("written");
        let mut broken = bundle("new");
        let too_long = "x".repeat(300);
        broken.add(too_long, String::new()).expect("a name");
        broken
            .write(place.path())
            .expect_err("a name that no file can have");
        assert_eq!(
            fs::read_to_string(place.path().join("a.txt")).expect("a.txt"),
            "old"
        );
        assert_eq!(fs::read_dir(place.path()).expect("a folder").count(), 2);
    }
}
