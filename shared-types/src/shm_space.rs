//! Check of the space in shared memory before it is used.
//!
//! The kernel allocates memory when a page is first accessed, and kills the process if none is left (SIGBUS). A process
//! that checks first can report the cause instead. The same file system may also run out of files (inodes), and the
//! process out of file descriptors; iceoryx2 reports these as internal errors.

use core::fmt::{Display, Formatter};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use rustix::fs::statvfs;
use rustix::io::Errno;
use rustix::process::{Resource as Limited, getrlimit};

/// Shared memory of a port beside its messages \[bytes\].
pub const PORT_BYTES: u64 = 64 * 1024;
/// Files of a port: its tag, its memory, a connection, and one back from the daemon.
pub const PORT_FILES: u64 = 4;
/// Files of a node without services: its folder, its description, and three that monitor its life. Each service adds
/// one.
pub const NODE_FILES: u64 = 5;
/// Files that are open temporarily while a service is opened or a first message is received.
const TRANSIENT_FILES: u64 = 7;

/// There is less space than needed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InsufficientSpace {
    /// Mount point of the file system that is full.
    pub mount: PathBuf,
    /// The scarce resource.
    pub resource: Resource,
    /// Amount needed.
    pub needed: u64,
    /// Amount free.
    pub free: u64,
}

/// Resources that may run out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Resource {
    /// Memory \[bytes\].
    Bytes,
    /// Files (inodes).
    Files,
    /// Files that this process may open.
    Descriptors,
}

impl Display for InsufficientSpace {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        let (mount, needed, free) = (self.mount.display(), self.needed, self.free);
        match self.resource {
            Resource::Bytes => write!(
                f,
                "the memory of {mount} is full: {:.2} MB are needed, {:.2} MB are free; remove unneeded files (ls -l \
                 {mount}), or enlarge it (sudo mount -o remount,size=256M {mount}; a container: --shm-size=256m)",
                needed as f64 * 1e-6,
                free as f64 * 1e-6
            ),
            Resource::Files => write!(
                f,
                "{mount} has too few free inodes: {needed} needed, {free} free; remove unneeded files (ls -l \
                 {mount}), or raise the limit (sudo mount -o remount,nr_inodes=100k {mount})"
            ),
            Resource::Descriptors => write!(
                f,
                "this process can open too few files: {needed} more needed, {free} left; raise the limit (ulimit -n 1024; \
                 a service: LimitNOFILE=1024)"
            ),
        }
    }
}

/// Free bytes of the file system of `folder`; `None` if the system does not report them or sets no limit.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    let sizes = statvfs(folder).ok()?;
    (sizes.f_blocks > 0).then_some(sizes.f_bavail * sizes.f_frsize)
}

/// Files (inodes) that can still be created in the file system of `folder`; `None` if the system does not report them
/// or sets no limit.
pub fn free_files(folder: &Path) -> Option<u64> {
    let sizes = statvfs(folder).ok()?;
    (sizes.f_files > 0).then_some(sizes.f_favail)
}

/// Files that this process can still open; `None` if the system does not report them or sets no limit.
fn free_descriptors() -> Option<u64> {
    let limit = getrlimit(Limited::Nofile).current?;
    match std::fs::read_dir("/proc/self/fd") {
        Ok(open) => {
            let numbers = open.filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
            // Descriptors above a lowered limit use none below it; one is that of this folder.
            let taken = numbers.filter(|number: &u64| *number < limit).count() as u64;
            Some((limit + 1).saturating_sub(taken))
        }
        Err(error) if error.raw_os_error() == Some(Errno::MFILE.raw_os_error()) => Some(0),
        Err(_) => None,
    }
}

/// Checks that `folder` has `needed_bytes` free and can hold `needed_files`, and that this process may open these.
/// Resources that the system does not report count as sufficient.
///
/// # Errors
/// [`InsufficientSpace`], for the first resource of which there is less.
pub fn check(folder: &Path, needed_bytes: u64, needed_files: u64) -> Result<(), InsufficientSpace> {
    let asked = [
        (Resource::Bytes, needed_bytes, free_bytes(folder)),
        (Resource::Files, needed_files, free_files(folder)),
        (
            Resource::Descriptors,
            needed_files.saturating_add(TRANSIENT_FILES),
            free_descriptors(),
        ),
    ];
    for (resource, needed, free) in asked {
        if let Some(free) = free.filter(|free| *free < needed) {
            return Err(InsufficientSpace {
                mount: mount_point(folder),
                resource,
                needed,
                free,
            });
        }
    }
    Ok(())
}

/// The topmost folder of the file system of `folder`.
pub fn mount_point(folder: &Path) -> PathBuf {
    let device = |folder: &Path| folder.metadata().map(|folder| folder.dev()).ok();
    let own = device(folder);
    let same = folder.ancestors().take_while(|above| device(above) == own);
    same.last().unwrap_or(folder).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn insufficient_space_is_reported_with_the_numbers() {
        let folder = std::env::temp_dir();
        assert_eq!(check(&folder, 0, 0), Ok(()));
        for (bytes, files, resource, words) in [
            (u64::MAX, 0, Resource::Bytes, "MB are free"),
            (0, u64::MAX, Resource::Files, "nr_inodes="),
        ] {
            if resource == Resource::Files && free_files(&folder).is_none() {
                continue;
            }
            let lack = check(&folder, bytes, files).expect_err("nobody has so much");
            assert!(lack.resource == resource && lack.needed == u64::MAX && lack.free < u64::MAX);
            let (text, mount) = (lack.to_string(), mount_point(&folder).display().to_string());
            assert!(text.contains(&mount) && text.contains(words), "{text}");
        }
    }

    #[test]
    fn a_file_system_without_a_limit_has_space_for_everything() {
        let folder = Path::new("/proc");
        assert_eq!(free_bytes(folder), None);
        assert_eq!(free_files(folder), None);
        assert_eq!(check(folder, u64::MAX, 0), Ok(()));
    }

    #[test]
    fn too_few_descriptors_are_reported_with_the_command() {
        let lack = check(Path::new("/proc"), 0, u64::MAX).expect_err("nobody may open so many");
        assert!(
            lack.resource == Resource::Descriptors && lack.free > 0,
            "{lack:?}"
        );
        assert!(lack.to_string().contains("ulimit -n"), "{lack}");
    }

    #[test]
    fn the_file_system_of_a_folder_begins_where_it_is_mounted() {
        assert_eq!(mount_point(Path::new("/proc/self")), Path::new("/proc"));
        assert_eq!(mount_point(Path::new("/")), Path::new("/"));
    }
}
