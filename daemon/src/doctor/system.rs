//! The files in which the kernel tells about itself, below one root folder.
//!
//! Invariant: whatever stands in a file, reading it does not panic. Tests lay out a tree of their own.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::core_set::CoreSet;

/// No file that is read here is longer: the longest, `/proc/interrupts`, has 5 MB on a machine with 512 cores.
const FILE_BYTES_MAX: u64 = 64 << 20;

/// The system, as its files show it.
#[derive(Debug, Clone)]
pub struct System {
    root: PathBuf,
}

/// Something that could not be read, and why.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} cannot be read: {cause}")]
pub struct Unreadable {
    /// File, or what stands in it.
    pub what: String,
    /// Why.
    pub cause: String,
}

impl Unreadable {
    /// Something that cannot be read, and why.
    pub fn new(what: impl Into<String>, cause: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            cause: cause.into(),
        }
    }
}

impl System {
    /// The system whose files are below `root`: `/` for the real one.
    pub fn at(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
        }
    }

    /// Where the file `path` of the system is.
    pub fn path(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// The text of a file without the white space around it. Bytes that are no UTF-8 are replaced.
    ///
    /// # Errors
    /// [`Unreadable`], also when there is no such file.
    pub fn read(&self, path: &str) -> Result<String, Unreadable> {
        self.text(path)
            .map_err(|cause| Unreadable::new(path, cause.to_string()))
    }

    /// As [`System::read`]; none when there is no such file.
    ///
    /// # Errors
    /// [`Unreadable`].
    pub fn read_if_there(&self, path: &str) -> Result<Option<String>, Unreadable> {
        match self.text(path) {
            Ok(text) => Ok(Some(text)),
            Err(cause) if cause.kind() == ErrorKind::NotFound => Ok(None),
            Err(cause) => Err(Unreadable::new(path, cause.to_string())),
        }
    }

    /// A number that stands alone in a file.
    ///
    /// # Errors
    /// [`Unreadable`], also when it is no number.
    pub fn number(&self, path: &str) -> Result<i64, Unreadable> {
        let text = self.read(path)?;
        text.parse()
            .map_err(|_| Unreadable::new(path, format!("{text:?} is no number")))
    }

    /// The names in a folder, in order; none when there is no such folder.
    pub fn names(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.path(folder));
        let names = entries.into_iter().flatten().flatten();
        let mut names: Vec<_> = names
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort_unstable();
        names
    }

    /// The names in a folder that are numbers: processes, threads.
    pub fn numbers(&self, folder: &str) -> Vec<u32> {
        let names = self.names(folder);
        names.iter().filter_map(|name| name.parse().ok()).collect()
    }

    /// The cores that run.
    ///
    /// # Errors
    /// [`Unreadable`].
    pub fn online(&self) -> Result<CoreSet, Unreadable> {
        Ok(CoreSet::parse(
            &self.read("/sys/devices/system/cpu/online")?,
        ))
    }

    /// The last value of `key=value` on the kernel's command line.
    ///
    /// # Errors
    /// [`Unreadable`].
    pub fn boot_option(&self, key: &str) -> Result<Option<String>, Unreadable> {
        let line = self.read("/proc/cmdline")?;
        let mut values = line.split_whitespace().filter_map(|word| {
            let value = word.strip_prefix(key)?.strip_prefix('=')?;
            Some(value.to_owned())
        });
        Ok(values.next_back())
    }

    /// A field of `/proc/self/status`.
    ///
    /// # Errors
    /// [`Unreadable`], also when there is no such field.
    pub fn own_status(&self, field: &str) -> Result<String, Unreadable> {
        let path = "/proc/self/status";
        field_of(&self.read(path)?, field)
            .ok_or_else(|| Unreadable::new(path, format!("it has no {field}")))
    }

    fn text(&self, path: &str) -> std::io::Result<String> {
        let mut bytes = Vec::new();
        File::open(self.path(path))?
            .take(FILE_BYTES_MAX)
            .read_to_end(&mut bytes)?;
        Ok(String::from_utf8_lossy(&bytes).trim().to_owned())
    }
}

/// The value of the line `field: value`.
pub(super) fn field_of(text: &str, field: &str) -> Option<String> {
    text.lines().find_map(|line| {
        let (name, value) = line.split_once(':')?;
        (name.trim() == field).then(|| value.trim().to_owned())
    })
}

/// The chosen one of alternatives: the word in brackets.
pub(super) fn chosen_of(text: &str, brackets: [char; 2]) -> Option<&str> {
    let (_, rest) = text.split_once(brackets[0])?;
    let (chosen, _) = rest.split_once(brackets[1])?;
    Some(chosen)
}

#[cfg(test)]
mod tests {
    #![allow(
        clippy::unwrap_used,
        reason = "in a test a panic is the report, in its helpers, too"
    )]

    use super::*;

    #[test]
    fn what_is_missing_differs_from_what_is_not_readable() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("number"), " 12 \n").unwrap();
        std::fs::write(folder.path().join("odd"), b"\xff\xfe\0 x".as_slice()).unwrap();
        let system = System::at(folder.path());
        assert_eq!(system.number("/number"), Ok(12));
        assert!(system.number("/odd").is_err());
        assert!(system.read("/odd").is_ok());
        assert_eq!(system.read_if_there("/nowhere"), Ok(None));
        let missing = system.read("/nowhere").unwrap_err().to_string();
        assert!(missing.starts_with("/nowhere cannot be read"), "{missing}");
        // A folder is no file: there, but not to be read.
        std::fs::create_dir(folder.path().join("folder")).unwrap();
        assert!(system.read_if_there("/folder").is_err());
        assert_eq!(system.names("/folder"), Vec::<String>::new());
        assert_eq!(system.names("/"), ["folder", "number", "odd"]);
    }

    #[test]
    fn fields_and_choices_are_found() {
        assert_eq!(field_of("a:\t1\nb : 2 3\n", "b").as_deref(), Some("2 3"));
        assert_eq!(field_of("a:\t1", "c"), None);
        assert_eq!(chosen_of("always [never]", ['[', ']']), Some("never"));
        assert_eq!(chosen_of("always ]never[", ['[', ']']), None);
    }
}
