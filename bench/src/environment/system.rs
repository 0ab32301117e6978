//! Files of the kernel, read below a root that a test can replace.

use std::fs;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone)]
pub(super) struct System {
    root: PathBuf,
}

impl System {
    pub(super) fn real() -> Self {
        Self::below(Path::new("/"))
    }

    pub(super) fn below(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
        }
    }

    /// The text of a file without the space around it; none where it cannot be read, or is empty.
    pub(super) fn read(&self, file: &str) -> Option<String> {
        let text = fs::read(self.root.join(file.trim_start_matches('/'))).ok()?;
        // Texts of firmware end with a zero.
        let text = String::from_utf8_lossy(&text);
        let text = text.trim_matches(|c: char| c.is_whitespace() || c == '\0');
        (!text.is_empty()).then(|| text.to_owned())
    }

    /// The value of the first line `key : value`.
    pub(super) fn field(&self, file: &str, key: &str) -> Option<String> {
        let text = self.read(file)?;
        let mut lines = text.lines().filter_map(|line| line.split_once(':'));
        let (_, value) = lines.find(|(name, _)| name.trim() == key)?;
        Some(value.trim().to_owned()).filter(|value| !value.is_empty())
    }

    /// The word in brackets of a file that lists what could be chosen.
    pub(super) fn chosen(&self, file: &str, brackets: [char; 2]) -> Option<String> {
        let text = self.read(file)?;
        let (_, rest) = text.split_once(brackets[0])?;
        Some(rest.split_once(brackets[1])?.0.to_owned())
    }
}

/// A folder with these files, for tests.
#[cfg(test)]
pub(super) fn fake(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in files {
        let file = folder.path().join(name);
        fs::create_dir_all(file.parent().expect("a folder above")).expect("made");
        fs::write(file, text).expect("written");
    }
    folder
}
