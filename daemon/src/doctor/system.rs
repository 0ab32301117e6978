//! The files in which the kernel tells about itself, below one root folder.
//!
//! Invariant: whatever stands in a file, reading it does not panic. Tests lay out a tree of their own.

use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::CPU;
use super::core_set::CoreSet;

/// No file that is read here is longer: the longest, `/proc/interrupts`, has 5 MB on a machine with 512 cores.
const FILE_BYTES_MAX: u64 = 64 << 20;

/// The system, as its files show it.
#[derive(Debug, Clone)]
pub(crate) struct System {
    root: PathBuf,
}

/// Something that could not be read, and why.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} cannot be read: {cause}")]
pub(crate) struct Unreadable {
    /// File, or what stands in it.
    pub(crate) what: String,
    pub(crate) cause: String,
}

impl Unreadable {
    pub(crate) fn new(what: impl Into<String>, cause: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            cause: cause.into(),
        }
    }
}

impl System {
    /// The system whose files are below `root`: `/` for the real one.
    pub(crate) fn at(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
        }
    }

    /// Where the file `path` of the system is.
    pub(crate) fn path(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    /// The text of a file without the white space around it. Bytes that are no UTF-8 are replaced.
    pub(crate) fn read(&self, path: &str) -> Result<String, Unreadable> {
        self.text(path)
            .map_err(|cause| Unreadable::new(path, cause.to_string()))
    }

    /// As [`System::read`]; none when there is no such file.
    pub(crate) fn read_if_there(&self, path: &str) -> Result<Option<String>, Unreadable> {
        match self.text(path) {
            Ok(text) => Ok(Some(text)),
            Err(cause) if cause.kind() == ErrorKind::NotFound => Ok(None),
            Err(cause) => Err(Unreadable::new(path, cause.to_string())),
        }
    }

    /// A number that stands alone in a file.
    pub(crate) fn number(&self, path: &str) -> Result<i64, Unreadable> {
        let text = self.read(path)?;
        text.parse()
            .map_err(|_| Unreadable::new(path, format!("{text:?} is no number")))
    }

    /// The names in a folder, in order; none when there is no such folder.
    pub(crate) fn names(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.path(folder));
        let names = entries.into_iter().flatten().flatten();
        let mut names: Vec<_> = names
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort_unstable();
        names
    }

    /// The names in a folder that are numbers: processes, threads.
    pub(crate) fn numbers(&self, folder: &str) -> Vec<u32> {
        let names = self.names(folder);
        names.iter().filter_map(|name| name.parse().ok()).collect()
    }

    /// The cores that a file below the folder of the cores lists.
    pub(crate) fn cores(&self, file: &str) -> Result<CoreSet, Unreadable> {
        Ok(CoreSet::parse(&self.read(&format!("{CPU}/{file}"))?))
    }

    pub(crate) fn online(&self) -> Result<CoreSet, Unreadable> {
        self.cores("online")
    }

    /// The other cores on the hardware of `core`.
    pub(crate) fn siblings(&self, core: usize) -> Result<CoreSet, Unreadable> {
        let siblings = self.cores(&format!("cpu{core}/topology/thread_siblings_list"));
        Ok(siblings?.without(core))
    }

    /// The cores that this process may use.
    pub(crate) fn allowed(&self) -> Result<CoreSet, Unreadable> {
        Ok(CoreSet::parse(&self.own_status("Cpus_allowed_list")?))
    }

    /// The last value of `key=value` on the kernel's command line.
    pub(crate) fn boot_option(&self, key: &str) -> Result<Option<String>, Unreadable> {
        let line = self.read("/proc/cmdline")?;
        let mut values = line.split_whitespace().filter_map(|word| {
            let value = word.strip_prefix(key)?.strip_prefix('=')?;
            Some(value.to_owned())
        });
        Ok(values.next_back())
    }

    /// A field of `/proc/self/status`.
    pub(crate) fn own_status(&self, field: &str) -> Result<String, Unreadable> {
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
    use cdcr_scratch::Scratch;

    use super::*;

    #[test]
    fn what_is_missing_differs_from_what_is_not_readable() {
        let folder = Scratch::temporary().unwrap();
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
