//! What a process takes of the machine's memory, as the kernel counts it.

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

/// Memory and descriptors of a process at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Memory {
    pub resident_bytes: u64,
    pub peak_bytes: u64,
    /// Locked, counted by address range \[bytes\] (`VmLck`): more than what is resident.
    pub locked_bytes: u64,
    /// Of the resident: its own, heap and stacks \[bytes\] (`RssAnon`).
    pub own_bytes: u64,
    /// Of the resident: pages of files, the program itself \[bytes\] (`RssFile`).
    pub file_bytes: u64,
    /// Of the resident: shared memory \[bytes\] (`RssShmem`).
    pub shared_bytes: u64,
    /// Faults that needed no disk, since its start.
    pub minor_faults: u64,
    pub major_faults: u64,
    /// Open files and sockets; none where this user may not look.
    pub descriptors: Option<u64>,
}

impl Memory {
    pub fn of(process: u32) -> Result<Self> {
        let folder = PathBuf::from(format!("/proc/{process}"));
        let read = |name: &str| {
            let file = folder.join(name);
            fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))
        };
        let (minor_faults, major_faults) =
            faults_in(&read("stat")?).context("/proc/PID/stat has no faults")?;
        let status = read("status")?;
        let bytes = |key: &str| {
            bytes_in(&status, key).with_context(|| format!("/proc/PID/status has no {key}"))
        };
        let descriptors = fs::read_dir(folder.join("fd")).ok();
        Ok(Self {
            resident_bytes: bytes("VmRSS")?,
            peak_bytes: bytes("VmHWM")?,
            locked_bytes: bytes("VmLck")?,
            own_bytes: bytes("RssAnon")?,
            file_bytes: bytes("RssFile")?,
            shared_bytes: bytes("RssShmem")?,
            minor_faults,
            major_faults,
            descriptors: descriptors.map(|entries| entries.count() as u64),
        })
    }

    pub fn faults(&self) -> u64 {
        self.minor_faults + self.major_faults
    }
}

/// A value of `/proc/PID/status`, which the kernel gives in units of 1024 bytes (proc(5)).
fn bytes_in(status: &str, key: &str) -> Option<u64> {
    let value = status
        .lines()
        .find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
    let kilobytes: u64 = value.split_ascii_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024)
}

/// The 10th and 12th number of `/proc/PID/stat`. The 2nd is a name in brackets that may hold anything.
fn faults_in(stat: &str) -> Option<(u64, u64)> {
    let behind_name = &stat[stat.rfind(')')? + 1..];
    let numbers: Vec<&str> = behind_name.split_ascii_whitespace().collect();
    let number = |index: usize| numbers.get(index)?.parse().ok();
    Some((number(7)?, number(9)?))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Files {
    pub files: u64,
    pub bytes: u64,
    /// What is really there of them \[bytes\]: pages that nobody touched take nothing.
    pub stored_bytes: u64,
}

impl Files {
    /// Of these files; those that are gone are left out.
    pub fn of(paths: &[PathBuf]) -> Self {
        let mut all = Self::default();
        for metadata in paths.iter().filter_map(|path| fs::metadata(path).ok()) {
            all.files += 1;
            all.bytes += metadata.len();
            all.stored_bytes += metadata.blocks() * 512;
        }
        all
    }

    pub fn below(folder: &Path) -> Self {
        let mut all = Vec::new();
        let mut folders = vec![folder.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
                match entry.file_type() {
                    Ok(kind) if kind.is_dir() => folders.push(entry.path()),
                    Ok(_) => all.push(entry.path()),
                    Err(_) => {}
                }
            }
        }
        Self::of(&all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn we_have_memory_ourselves() {
        let ours = Memory::of(std::process::id()).unwrap();
        let parts = ours.own_bytes + ours.file_bytes + ours.shared_bytes;
        assert!(ours.resident_bytes > 0 && ours.resident_bytes == parts);
        assert!(ours.peak_bytes > 0 && ours.faults() > 0);
        assert!(ours.descriptors.unwrap() > 0);
    }

    #[test]
    fn files_below_a_folder_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("inner")).unwrap();
        fs::write(folder.path().join("a"), [1; 10]).unwrap();
        fs::write(folder.path().join("inner/b"), [1; 5]).unwrap();
        let found = Files::below(folder.path());
        assert_eq!((found.files, found.bytes), (2, 15));
        assert_eq!(Files::below(&folder.path().join("none")), Files::default());
    }

    #[test]
    fn values_are_read_as_proc_says() {
        let status = "Name:\ta\nVmHWM:\t   20 kB\nVmRSS:\t   10 kB\nRssAnon:\t 0 kB\n";
        assert_eq!(bytes_in(status, "VmRSS"), Some(10_240));
        assert_eq!(bytes_in(status, "RssAnon"), Some(0));
        assert_eq!(bytes_in(status, "Vm"), None);
        let stat = "7 (a ) b) S 1 2 3 4 5 6 70 8 90 10";
        assert_eq!(faults_in(stat), Some((70, 90)));
        assert_eq!(faults_in("7 (a"), None);
    }
}
