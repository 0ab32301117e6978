//! Properties that no file reports: they are tried, and undone.

use std::fmt::Display;
use std::fs::OpenOptions;
use std::path::{Path, PathBuf};

use cdcr_shared_types::shm_space::{free_files, mount_point};
use rustix::fs::statvfs;
use rustix::mm::{MlockAllFlags, mlockall, munlockall};
use rustix::process::{Resource, geteuid, getrlimit};
use rustix::thread::{disable_transparent_huge_pages, transparent_huge_pages_are_disabled};

use crate::config::{Config, Validated};
use crate::instance::is_in_memory;
use crate::rt::sys;
use crate::start;
use crate::system::{System, can_be_pinned};

#[derive(Debug, Clone)]
#[cfg_attr(test, derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Probe {
    /// `SCHED_FIFO` at the cycle's priority, on a thread that ended at once; otherwise the kernel's error.
    pub(super) fifo: Result<(), String>,
    /// Another thread could be pinned to the core.
    pub(super) pinned: bool,
    /// All memory of this process locked, and unlocked again; otherwise the kernel's error.
    pub(super) memory_lock: Result<(), String>,
    /// This process exempted from transparent huge pages, and restored; otherwise the kernel's error.
    pub(super) no_huge_pages: Result<(), String>,
    /// `RLIMIT_RTPRIO`; `None`: unlimited.
    pub(super) rtprio_max: Option<u64>,
    /// `RLIMIT_MEMLOCK` \[bytes\]; `None`: unlimited.
    pub(super) memlock_max_bytes: Option<u64>,
    /// `/dev/cpu_dma_latency` opened for writing, without a request.
    pub(super) deep_sleep_lock: Result<(), String>,
    /// Mount point of the root folder, or of the nearest existing parent.
    pub(super) shared_memory_mount: PathBuf,
    /// Size and free space of that file system \[bytes\].
    pub(super) shared_memory_bytes: Result<(u64, u64), String>,
    /// Files (inodes) that can still be created there; `None`: no limit, or unknown.
    pub(super) shared_memory_files: Option<u64>,
    pub(super) root_in_memory: Result<bool, String>,
    pub(super) user_id: u32,
    /// The daemon of this robot is running.
    pub(super) daemon_runs: bool,
}

impl Probe {
    pub(super) fn new(system: &System, validated: &Validated) -> Self {
        let Config {
            realtime, robot, ..
        } = &validated.config;
        let root = system.path(validated.location.root());
        let folder = root.ancestors().find(|folder| folder.exists());
        let folder = folder.unwrap_or(&root);
        // Opening has no effect: only a written number is a request.
        let deep_sleep = system.path("/dev/cpu_dma_latency");
        let deep_sleep_lock = OpenOptions::new().write(true).open(deep_sleep);
        Self {
            fifo: try_fifo(realtime.cycle_priority),
            pinned: start::core(realtime).is_some_and(can_be_pinned),
            memory_lock: reported(mlockall(MlockAllFlags::CURRENT).and_then(|()| munlockall())),
            no_huge_pages: reported(try_no_huge_pages()),
            rtprio_max: getrlimit(Resource::Rtprio).current,
            memlock_max_bytes: getrlimit(Resource::Memlock).current,
            deep_sleep_lock: reported(deep_sleep_lock.map(drop)),
            shared_memory_bytes: reported(shared_memory_bytes(folder)),
            shared_memory_files: free_files(folder),
            root_in_memory: reported(is_in_memory(folder)),
            shared_memory_mount: mount_point(folder),
            user_id: geteuid().as_raw(),
            daemon_runs: validated.location.presence(&robot.name).is_some(),
        }
    }
}

/// Converts the kernel's error to text.
fn reported<T, E: Display>(tried: Result<T, E>) -> Result<T, String> {
    tried.map_err(|error| error.to_string())
}

fn try_fifo(priority: i32) -> Result<(), String> {
    let trial = std::thread::spawn(move || reported(sys::set_fifo(priority)));
    let panicked = |_| Err("the trial thread panicked".to_owned());
    trial.join().unwrap_or_else(panicked)
}

fn try_no_huge_pages() -> rustix::io::Result<()> {
    let before = transparent_huge_pages_are_disabled()?;
    disable_transparent_huge_pages(true)?;
    disable_transparent_huge_pages(before)
}

/// Size and free space of the file system of a folder \[bytes\].
fn shared_memory_bytes(folder: &Path) -> rustix::io::Result<(u64, u64)> {
    let sizes = statvfs(folder)?;
    let bytes = |blocks: u64| blocks.saturating_mul(sizes.f_frsize);
    Ok((bytes(sizes.f_blocks), bytes(sizes.f_bavail)))
}
