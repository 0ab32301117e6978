//! Space in shared memory, asked for before it is used.
//!
//! The system looks for memory when a page is first touched, and kills whoever touches one when there is none
//! left (SIGBUS). A client that asks first can say what is wrong instead.

use core::fmt::{Display, Formatter};
use std::path::{Path, PathBuf};

use rustix::fs::statvfs;

/// What a connection takes without further ports \[bytes\]. No more than it needs: a stop has to get in.
pub(crate) const CONNECTION_BYTES: u64 = 64 * 1024;
/// What a port takes beside its messages \[bytes\].
pub(crate) const PORT_BYTES: u64 = 64 * 1024;

/// There is less space than is needed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct InsufficientSpace {
    folder: PathBuf,
    needed_bytes: u64,
    free_bytes: u64,
}

impl Display for InsufficientSpace {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        let mb = |bytes: u64| bytes as f64 * 1e-6;
        let folder = self.folder.display();
        write!(
            f,
            "the memory of {folder} is full: {:.2} MB are needed, {:.2} MB are free; remove what is not needed, or \
             make it larger (find its mount point with df {folder}, then mount -o remount,size=256M on that; a \
             container: --shm-size=256m)",
            mb(self.needed_bytes),
            mb(self.free_bytes)
        )
    }
}

/// Whether the memory of `folder` has `needed_bytes`. Where the system does not tell, or sets no limit, it has.
pub(crate) fn ask(folder: &Path, needed_bytes: u64) -> Result<(), InsufficientSpace> {
    let free_bytes = match statvfs(folder) {
        Ok(folder) if folder.f_blocks > 0 => folder.f_bavail * folder.f_frsize,
        _ => return Ok(()),
    };
    if free_bytes >= needed_bytes {
        return Ok(());
    }
    Err(InsufficientSpace {
        folder: folder.to_owned(),
        needed_bytes,
        free_bytes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_has_is_refused_in_words() {
        let folder = Path::new("/dev/shm");
        assert_eq!(ask(folder, 0), Ok(()));
        // A shared memory without a limit has room for everything.
        if let Err(lack) = ask(folder, u64::MAX) {
            let text = lack.to_string();
            assert!(
                text.contains("/dev/shm") && text.contains("MB are free"),
                "{text}"
            );
        }
    }
}
