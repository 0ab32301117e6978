//! Files in which the kernel reports its state, below one root folder, and the choice of a core from them.
//!
//! Invariant: reading never panics, whatever a file contains. The tests of `doctor` create folder trees.

mod core_choice;
mod core_set;

use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use cdcr_shared_types::proc_stat::{self, CoreTicks, core_ticks};
use rustix::io::Errno;

use crate::core_budget::KERNEL_SHARE;

#[cfg(test)]
pub(crate) use core_choice::choose;
pub(crate) use core_choice::{SIBLING_SHARE, can_be_pinned, daemon_process, with_core};
pub(crate) use core_set::CoreSet;

/// The kernel's folder of the cores.
pub(crate) const CPU: &str = "/sys/devices/system/cpu";

/// Time of each core.
pub(crate) type CoreTimes = BTreeMap<usize, CoreTicks>;

/// The times between two readings; a core that was off before counts from its start.
pub(crate) fn times_between(before: &CoreTimes, after: &CoreTimes) -> CoreTimes {
    let each = after.iter().map(|(core, now)| {
        let earlier = before.get(core).copied().unwrap_or_default();
        (*core, now.since(earlier))
    });
    each.collect()
}

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
        let text = self.read_if_there(path)?;
        text.ok_or_else(|| unreadable(path, Errno::NOENT))
    }

    /// As [`System::read`]; `None` if the file does not exist.
    pub(crate) fn read_if_there(&self, path: &str) -> Reading<Option<String>> {
        match std::fs::read(self.path(path)) {
            Ok(bytes) => Ok(Some(String::from_utf8_lossy(&bytes).trim().to_owned())),
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

    /// A field in the `status` of the process or thread with this folder.
    pub(crate) fn status(&self, folder: &str, field: &str) -> Reading {
        let path = format!("{folder}/status");
        let status = self.read(&path)?;
        let value = proc_stat::field(&status, field).map(str::to_owned);
        value.ok_or_else(|| unreadable(&path, format!("it has no {field}")))
    }

    /// The last value of `key=value` on the kernel's command line.
    pub(crate) fn boot_option(&self, key: &str) -> Reading<Option<String>> {
        let line = self.read("/proc/cmdline")?;
        let value = |word: &str| Some(word.strip_prefix(key)?.strip_prefix('=')?.to_owned());
        Ok(line.split_whitespace().filter_map(value).next_back())
    }

    /// The cores listed by a file in the kernel's folder of the cores.
    pub(crate) fn cores(&self, file: &str) -> Reading<CoreSet> {
        Ok(CoreSet::parse(&self.read(&format!("{CPU}/{file}"))?))
    }

    pub(crate) fn online(&self) -> Reading<CoreSet> {
        self.cores("online")
    }

    /// The cores that the process or thread with this folder may use.
    pub(crate) fn allowed(&self, folder: &str) -> Reading<CoreSet> {
        Ok(CoreSet::parse(&self.status(folder, "Cpus_allowed_list")?))
    }

    /// The other cores on the hardware of `core`.
    pub(crate) fn siblings(&self, core: usize) -> Reading<CoreSet> {
        let siblings = self.cores(&format!("cpu{core}/topology/thread_siblings_list"));
        Ok(siblings?.without(core))
    }

    /// The time of each core since the machine started.
    pub(crate) fn core_times(&self) -> Reading<CoreTimes> {
        let stat = self.read("/proc/stat")?;
        let each = core_ticks(&stat).filter_map(|(core, ticks)| Some((core?, ticks)));
        let times: CoreTimes = each.collect();
        let found = Some(times).filter(|times| !times.is_empty());
        found.ok_or_else(|| unreadable("/proc/stat", "no line of a core"))
    }

    /// The share of a core that the kernel leaves to real-time threads; `None`: it sets no limit.
    pub(crate) fn kernel_share(&self) -> Reading<Option<f64>> {
        let runtime_us = self.number("/proc/sys/kernel/sched_rt_runtime_us")?;
        let period_us = self.number("/proc/sys/kernel/sched_rt_period_us")?;
        let share = runtime_us as f64 / period_us.max(1) as f64;
        Ok((runtime_us >= 0).then_some(share.min(KERNEL_SHARE)))
    }

    /// Process, id and folder of every thread.
    pub(crate) fn threads(&self) -> impl Iterator<Item = (u32, u32, String)> {
        let of = |process| {
            let threads = self.threads_of(process);
            threads.map(move |(id, folder)| (process, id, folder))
        };
        self.processes().into_iter().flat_map(of)
    }

    /// Id and folder of every thread of a process.
    pub(crate) fn threads_of(&self, process: u32) -> impl Iterator<Item = (u32, String)> + use<> {
        let folder = format!("/proc/{process}/task");
        let ids = self.numbers(&folder).into_iter();
        ids.map(move |id| (id, format!("{folder}/{id}")))
    }

    pub(crate) fn processes(&self) -> Vec<u32> {
        self.numbers("/proc")
    }

    /// The numeric names in a folder; none if it does not exist.
    fn numbers(&self, folder: &str) -> Vec<u32> {
        let entries = std::fs::read_dir(self.path(folder)).into_iter().flatten();
        let number = |entry: std::fs::DirEntry| entry.file_name().to_str()?.parse().ok();
        entries.flatten().filter_map(number).collect()
    }
}
