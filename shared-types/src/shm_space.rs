//! Space in shared memory, asked for before it is used.
//!
//! The system looks for memory when a page is first touched, and kills the process that touches one when there is none
//! left (SIGBUS). A process that asks first can report what is wrong instead.

use core::fmt::{Display, Formatter};
use std::path::{Path, PathBuf};

use rustix::fs::statvfs;

/// What a port takes beside its messages \[bytes\].
pub const PORT_BYTES: u64 = 64 * 1024;

/// There is less space than is needed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InsufficientSpace {
    /// The folder whose file system is full.
    pub folder: PathBuf,
    /// What is needed \[bytes\].
    pub needed_bytes: u64,
    /// What is free \[bytes\].
    pub free_bytes: u64,
}

impl Display for InsufficientSpace {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        let mb = |bytes: u64| bytes as f64 * 1e-6;
        let folder = self.folder.display();
        write!(
            f,
            "the memory of {folder} is full: {:.2} MB are needed, {:.2} MB are free; remove what is not needed, or \
             make it larger (find its mount point with df {folder}, then sudo mount -o remount,size=256M on that; a \
             container: --shm-size=256m)",
            mb(self.needed_bytes),
            mb(self.free_bytes)
        )
    }
}

/// Free bytes of the file system of `folder`; none when the system does not tell, or sets no limit.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    let sizes = statvfs(folder).ok()?;
    (sizes.f_blocks > 0).then_some(sizes.f_bavail * sizes.f_frsize)
}

/// Checks that `folder` has `needed_bytes` free. Where the system does not tell, it has.
///
/// # Errors
/// There is less.
pub fn ask(folder: &Path, needed_bytes: u64) -> Result<(), InsufficientSpace> {
    match free_bytes(folder) {
        Some(free_bytes) if free_bytes < needed_bytes => Err(InsufficientSpace {
            folder: folder.to_owned(),
            needed_bytes,
            free_bytes,
        }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_there_is_is_refused_with_the_numbers() {
        let folder = std::env::temp_dir();
        assert_eq!(ask(&folder, 0), Ok(()));
        let lack = ask(&folder, u64::MAX).expect_err("nobody has so much");
        let InsufficientSpace {
            needed_bytes,
            free_bytes,
            ..
        } = lack;
        assert!(needed_bytes == u64::MAX && free_bytes < u64::MAX);
        let (text, folder) = (lack.to_string(), folder.display().to_string());
        assert!(
            text.contains(&folder) && text.contains("MB are free"),
            "{text}"
        );
    }

    #[test]
    fn a_folder_without_a_limit_has_room_for_everything() {
        let folder = Path::new("/proc");
        assert_eq!(free_bytes(folder), None);
        assert_eq!(ask(folder, u64::MAX), Ok(()));
    }
}
