//! Files in which the kernel reports its state, below one root folder.
//!
//! Invariant: reading never panics, whatever a file contains. Tests create a folder tree of their own.

use std::fs::{DirEntry, File};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use cdcr_shared_types::proc_stat;

use super::CPU;
use super::core_set::CoreSet;
use super::finding::{Assessed, unreadable};

/// Limit for files read here: the longest, `/proc/interrupts`, has 5 MB on a machine with 512 cores.
const FILE_BYTES_MAX: u64 = 64 << 20;

/// The system with its files below a folder: `/` for the real one.
#[derive(Debug, Clone)]
pub(crate) struct System(pub(crate) PathBuf);

impl System {
    /// The real path of the system's file `path`.
    pub(super) fn path(&self, path: impl AsRef<Path>) -> PathBuf {
        let path = path.as_ref();
        self.0.join(path.strip_prefix("/").unwrap_or(path))
    }

    /// The text of a file without surrounding white space. Invalid UTF-8 is replaced.
    pub(super) fn read(&self, path: &str) -> Assessed {
        self.text(path).map_err(|cause| unreadable(path, cause))
    }

    /// As [`System::read`]; `None` if the file does not exist.
    pub(super) fn read_if_there(&self, path: &str) -> Assessed<Option<String>> {
        match self.text(path) {
            Ok(text) => Ok(Some(text)),
            Err(cause) if cause.kind() == ErrorKind::NotFound => Ok(None),
            Err(cause) => Err(unreadable(path, cause)),
        }
    }

    /// A file that contains one number.
    pub(super) fn number(&self, path: &str) -> Assessed<i64> {
        let text = self.read(path)?;
        let odd = |_| unreadable(path, format!("invalid number {text:?}"));
        text.parse().map_err(odd)
    }

    /// The sorted names in a folder; none if it does not exist.
    pub(super) fn names(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.path(folder));
        let names = entries.into_iter().flatten().flatten();
        let name = |entry: DirEntry| entry.file_name().to_string_lossy().into_owned();
        let mut names: Vec<String> = names.map(name).collect();
        names.sort_unstable();
        names
    }

    /// The numeric names in a folder: processes, threads.
    pub(super) fn numbers(&self, folder: &str) -> Vec<u32> {
        let names = self.names(folder);
        names.iter().filter_map(|name| name.parse().ok()).collect()
    }

    /// The cores listed by a file in the kernel's folder of the cores.
    pub(super) fn cores(&self, file: &str) -> Assessed<CoreSet> {
        Ok(CoreSet::parse(&self.read(&format!("{CPU}/{file}"))?))
    }

    pub(super) fn online(&self) -> Assessed<CoreSet> {
        self.cores("online")
    }

    /// The other cores on the hardware of `core`.
    pub(super) fn siblings(&self, core: usize) -> Assessed<CoreSet> {
        let siblings = self.cores(&format!("cpu{core}/topology/thread_siblings_list"));
        Ok(siblings?.without(core))
    }

    /// The cores that this process may use.
    pub(super) fn allowed(&self) -> Assessed<CoreSet> {
        Ok(CoreSet::parse(&self.own_status("Cpus_allowed_list")?))
    }

    /// The last value of `key=value` on the kernel's command line.
    pub(super) fn boot_option(&self, key: &str) -> Assessed<Option<String>> {
        let line = self.read("/proc/cmdline")?;
        let value = |word: &str| Some(word.strip_prefix(key)?.strip_prefix('=')?.to_owned());
        Ok(line.split_whitespace().filter_map(value).next_back())
    }

    pub(super) fn own_status(&self, field: &str) -> Assessed {
        let path = "/proc/self/status";
        let status = self.read(path)?;
        let value = proc_stat::field(&status, field).map(str::to_owned);
        value.ok_or_else(|| unreadable(path, format!("it has no {field}")))
    }

    fn text(&self, path: &str) -> std::io::Result<String> {
        let mut bytes = Vec::new();
        File::open(self.path(path))?
            .take(FILE_BYTES_MAX)
            .read_to_end(&mut bytes)?;
        Ok(String::from_utf8_lossy(&bytes).trim().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Machine;

    #[test]
    fn what_is_missing_differs_from_what_is_not_readable() {
        let machine = Machine::new(&[("/number", " 12 \n"), ("/folder/odd", "x")]);
        let system = &machine.scene.system;
        std::fs::write(system.0.join("folder/odd"), b"\xff\xfe\0 x".as_slice()).unwrap();
        assert_eq!(system.number("/number"), Ok(12));
        assert!(system.number("/folder/odd").is_err() && system.read("/folder/odd").is_ok());
        assert_eq!(system.read_if_there("/nowhere"), Ok(None));
        let missing = system.read("/nowhere").unwrap_err().value;
        assert!(missing.starts_with("cannot read /nowhere"), "{missing}");
        // A folder exists, but cannot be read as a file.
        assert!(system.read_if_there("/folder").is_err());
        assert_eq!(system.names("/"), ["folder", "number"]);
    }
}
