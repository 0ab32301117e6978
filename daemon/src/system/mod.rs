//! Files in which the kernel reports its state, below one root folder, and the choice of a core from them.
//!
//! Invariant: reading never panics, whatever a file contains. Tests create a folder tree of their own.

mod core_choice;
mod core_load;
mod core_set;

use std::fmt::Display;
use std::fs::{DirEntry, File};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

use cdcr_shared_types::proc_stat;

use crate::core_budget::KERNEL_SHARE;

#[cfg(test)]
pub(crate) use core_choice::choose;
pub(crate) use core_choice::{SIBLING_SHARE, can_be_pinned, daemon_process, with_core};
pub(crate) use core_load::{CoreLoad, CoreTimes, core_loads, core_times, share};
pub(crate) use core_set::CoreSet;

/// The kernel's folder of the cores.
pub(crate) const CPU: &str = "/sys/devices/system/cpu";
/// Run time of real-time threads per period of the limit \[µs\]; -1: no limit.
pub(crate) const RT_RUNTIME_US: &str = "/proc/sys/kernel/sched_rt_runtime_us";

/// Limit for files read here: the longest, `/proc/interrupts`, has 5 MB on a machine with 512 cores.
const FILE_BYTES_MAX: u64 = 64 << 20;

/// The system with its files below a folder: `/` for the real one.
#[derive(Debug, Clone)]
pub(crate) struct System(pub(crate) PathBuf);

/// A file that cannot be read, or whose content is invalid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub(crate) struct Unreadable(String);

pub(crate) fn unreadable(what: &str, cause: impl Display) -> Unreadable {
    Unreadable(format!("cannot read {what}: {cause}"))
}

/// What was read.
pub(crate) type Reading<T = String> = Result<T, Unreadable>;

impl System {
    /// The files of this machine.
    pub(crate) fn this() -> Self {
        Self("/".into())
    }

    /// The real path of the system's file `path`.
    pub(crate) fn path(&self, path: impl AsRef<Path>) -> PathBuf {
        let path = path.as_ref();
        self.0.join(path.strip_prefix("/").unwrap_or(path))
    }

    /// The text of a file without surrounding white space. Invalid UTF-8 is replaced.
    pub(crate) fn read(&self, path: &str) -> Reading {
        self.text(path).map_err(|cause| unreadable(path, cause))
    }

    /// As [`System::read`]; `None` if the file does not exist.
    pub(crate) fn read_if_there(&self, path: &str) -> Reading<Option<String>> {
        match self.text(path) {
            Ok(text) => Ok(Some(text)),
            Err(cause) if cause.kind() == ErrorKind::NotFound => Ok(None),
            Err(cause) => Err(unreadable(path, cause)),
        }
    }

    /// A file that contains one number.
    pub(crate) fn number(&self, path: &str) -> Reading<i64> {
        let text = self.read(path)?;
        let odd = |_| unreadable(path, format!("invalid number {text:?}"));
        text.parse().map_err(odd)
    }

    /// The sorted names in a folder; none if it does not exist.
    pub(crate) fn names(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.path(folder));
        let names = entries.into_iter().flatten().flatten();
        let name = |entry: DirEntry| entry.file_name().to_string_lossy().into_owned();
        let mut names: Vec<String> = names.map(name).collect();
        names.sort_unstable();
        names
    }

    /// The numeric names in a folder: processes, threads.
    pub(crate) fn numbers(&self, folder: &str) -> Vec<u32> {
        let names = self.names(folder);
        names.iter().filter_map(|name| name.parse().ok()).collect()
    }

    /// The cores listed by a file in the kernel's folder of the cores.
    pub(crate) fn cores(&self, file: &str) -> Reading<CoreSet> {
        Ok(CoreSet::parse(&self.read(&format!("{CPU}/{file}"))?))
    }

    pub(crate) fn online(&self) -> Reading<CoreSet> {
        self.cores("online")
    }

    /// The other cores on the hardware of `core`.
    pub(crate) fn siblings(&self, core: usize) -> Reading<CoreSet> {
        let siblings = self.cores(&format!("cpu{core}/topology/thread_siblings_list"));
        Ok(siblings?.without(core))
    }

    /// The cores that this process may use.
    pub(crate) fn allowed(&self) -> Reading<CoreSet> {
        Ok(CoreSet::parse(&self.own_status("Cpus_allowed_list")?))
    }

    /// The cores that the thread with this folder may use; none if they cannot be read.
    pub(crate) fn allowed_to(&self, folder: &str) -> CoreSet {
        let status = self.read(&format!("{folder}/status")).unwrap_or_default();
        CoreSet::parse(proc_stat::field(&status, "Cpus_allowed_list").unwrap_or_default())
    }

    /// The share of a core that the kernel leaves to real-time threads. Without a limit (-1) the default one
    /// applies: otherwise ordinary tasks on the core would starve, including those of the kernel.
    pub(crate) fn kernel_share(&self) -> Reading<f64> {
        let runtime_us = self.number(RT_RUNTIME_US)?;
        let period_us = self.number("/proc/sys/kernel/sched_rt_period_us")?;
        if runtime_us < 0 {
            return Ok(KERNEL_SHARE);
        }
        Ok((runtime_us as f64 / period_us.max(1) as f64).min(KERNEL_SHARE))
    }

    /// The last value of `key=value` on the kernel's command line.
    pub(crate) fn boot_option(&self, key: &str) -> Reading<Option<String>> {
        let line = self.read("/proc/cmdline")?;
        let value = |word: &str| Some(word.strip_prefix(key)?.strip_prefix('=')?.to_owned());
        Ok(line.split_whitespace().filter_map(value).next_back())
    }

    pub(crate) fn own_status(&self, field: &str) -> Reading {
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
pub(crate) mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    /// A system over a folder of its own.
    pub(crate) struct Files {
        _folder: Scratch,
        pub(crate) system: System,
    }

    impl Files {
        pub(crate) fn new(files: &[(&str, &str)]) -> Self {
            let folder = Scratch::temporary().unwrap();
            let system = System(folder.path().to_owned());
            let made = Self {
                _folder: folder,
                system,
            };
            for (path, text) in files {
                made.write(path, text);
            }
            made
        }

        pub(crate) fn write(&self, path: &str, content: impl AsRef<[u8]>) {
            let path = self.system.path(path);
            assert!(path.starts_with(&self.system.0));
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, content).unwrap();
        }
    }

    #[test]
    fn what_is_missing_differs_from_what_is_not_readable() {
        let files = Files::new(&[("/number", " 12 \n")]);
        files.write("/folder/odd", b"\xff\xfe\0 x");
        let system = &files.system;
        assert_eq!(system.number("/number"), Ok(12));
        assert!(system.number("/folder/odd").is_err() && system.read("/folder/odd").is_ok());
        assert_eq!(system.read_if_there("/nowhere"), Ok(None));
        let missing = system.read("/nowhere").unwrap_err().to_string();
        assert!(missing.starts_with("cannot read /nowhere: "), "{missing}");
        // A folder exists, but cannot be read as a file.
        assert!(system.read_if_there("/folder").is_err());
        assert_eq!(system.names("/"), ["folder", "number"]);
    }

    #[test]
    fn the_kernels_share_is_read_and_no_limit_is_the_default_one() {
        let files = Files::new(&[("/proc/sys/kernel/sched_rt_period_us", "1000000")]);
        for (runtime_us, share) in [("500000", 0.5), ("1000000", 0.95), ("-1", 0.95)] {
            files.write(RT_RUNTIME_US, runtime_us);
            assert_eq!(files.system.kernel_share(), Ok(share));
        }
    }
}
