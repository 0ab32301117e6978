//! What no file tells: it is tried, and undone.

use std::path::{Path, PathBuf};

use cdcr_shared_types::shm_space::{free_files, mount_point};
use rustix::fs::statvfs;
use rustix::mm::{MlockAllFlags, mlockall, munlockall};
use rustix::process::{Resource, geteuid, getrlimit};
use rustix::thread::{disable_transparent_huge_pages, transparent_huge_pages_are_disabled};

use super::plan::Plan;
use super::system::System;
use crate::instance::is_in_memory;
use crate::rt::sys;

#[derive(Debug, Clone)]
pub(crate) struct Probe {
    /// `SCHED_FIFO` at the cycle's priority, on a thread that ended at once; what the kernel said.
    pub(crate) fifo: Result<(), String>,
    /// Whether that thread could be pinned to the core.
    pub(crate) pinned: bool,
    /// All memory of this process locked, and unlocked again; what the kernel said.
    pub(crate) memory_lock: Result<(), String>,
    /// This process exempted from transparent huge pages, and put back; what the kernel said.
    pub(crate) no_huge_pages: Result<(), String>,
    /// `RLIMIT_RTPRIO`; none: unlimited.
    pub(crate) rtprio_max: Option<u64>,
    /// `RLIMIT_MEMLOCK` \[bytes\]; none: unlimited.
    pub(crate) memlock_max_bytes: Option<u64>,
    /// `/dev/cpu_dma_latency` opened for writing, without a request.
    pub(crate) deep_sleep_lock: Result<(), String>,
    /// Where the file system of the root folder begins, or of the folder that it will be made in.
    pub(crate) shared_memory_mount: PathBuf,
    /// Its size and free space \[bytes\].
    pub(crate) shared_memory_bytes: Result<(u64, u64), String>,
    /// Files (inodes) that can still be made there; none: as many as fit, or the system does not tell.
    pub(crate) shared_memory_files: Option<u64>,
    pub(crate) root_in_memory: Result<bool, String>,
    pub user_id: u32,
}

impl Probe {
    pub(crate) fn new(system: &System, plan: &Plan) -> Self {
        let (fifo, pinned) = try_thread(plan);
        let folder = first_that_exists(&system.path(&plan.root.display().to_string()));
        Self {
            fifo,
            pinned,
            memory_lock: try_memory_lock(),
            no_huge_pages: try_no_huge_pages(),
            rtprio_max: getrlimit(Resource::Rtprio).current,
            memlock_max_bytes: getrlimit(Resource::Memlock).current,
            deep_sleep_lock: try_deep_sleep_lock(&system.path("/dev/cpu_dma_latency")),
            shared_memory_bytes: shared_memory_bytes(&folder),
            shared_memory_files: free_files(&folder),
            root_in_memory: is_in_memory(&folder).map_err(|error| error.to_string()),
            shared_memory_mount: mount_point(&folder),
            user_id: geteuid().as_raw(),
        }
    }
}

/// What the cycle thread will do first, on a thread that ends right after it.
fn try_thread(plan: &Plan) -> (Result<(), String>, bool) {
    let (priority, core) = (plan.cycle_priority, plan.core);
    let trial = std::thread::spawn(move || {
        let fifo = sys::set_fifo(priority).map_err(|error| error.to_string());
        let pin = |id| core_affinity::set_for_current(core_affinity::CoreId { id });
        (fifo, core.is_some_and(pin))
    });
    let panicked = || (Err("the trial thread panicked".to_owned()), false);
    trial.join().unwrap_or_else(|_| panicked())
}

fn try_memory_lock() -> Result<(), String> {
    mlockall(MlockAllFlags::CURRENT)
        .and_then(|()| munlockall())
        .map_err(|error| error.to_string())
}

fn try_no_huge_pages() -> Result<(), String> {
    let before = transparent_huge_pages_are_disabled();
    before
        .and_then(|before| {
            disable_transparent_huge_pages(true)?;
            disable_transparent_huge_pages(before)
        })
        .map_err(|error| error.to_string())
}

/// A request would only be made by writing a number, so that opening changes nothing.
fn try_deep_sleep_lock(path: &Path) -> Result<(), String> {
    let opened = std::fs::OpenOptions::new().write(true).open(path);
    opened.map(|_| ()).map_err(|error| error.to_string())
}

fn first_that_exists(folder: &Path) -> PathBuf {
    let there = folder.ancestors().find(|folder| folder.exists());
    there.unwrap_or(folder).to_owned()
}

fn shared_memory_bytes(path: &Path) -> Result<(u64, u64), String> {
    let sizes = statvfs(path).map_err(|error| error.to_string())?;
    let bytes = |blocks: u64| blocks.saturating_mul(sizes.f_frsize);
    Ok((bytes(sizes.f_blocks), bytes(sizes.f_bavail)))
}
