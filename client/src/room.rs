//! Room in shared memory, asked for before it is used.
//!
//! The system looks for memory when a page is first touched, and kills whoever touches one when there is none
//! left (SIGBUS). A client that asks first can say what is wrong instead.

use core::fmt::{Display, Formatter};

use rustix::fs::statvfs;

/// Where the files are.
const FOLDER: &str = "/dev/shm";
/// What a connection takes without further ports \[bytes\]. No more than it needs: a stop has to get in.
pub(crate) const CONNECTION_BYTES: u64 = 64 * 1024;
/// What a port takes beside its messages \[bytes\].
pub(crate) const PORT_BYTES: u64 = 64 * 1024;

/// There is less room than is needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct NoRoom {
    needed_bytes: u64,
    free_bytes: u64,
}

impl Display for NoRoom {
    fn fmt(&self, f: &mut Formatter<'_>) -> core::fmt::Result {
        let mb = |bytes: u64| bytes as f64 * 1e-6;
        write!(
            f,
            "shared memory ({FOLDER}) is full: {:.2} MB are needed, {:.2} MB are free; remove what is not needed \
             (ls -l {FOLDER}), or make it larger (mount -o remount,size=256M {FOLDER}; a container: --shm-size=256m)",
            mb(self.needed_bytes),
            mb(self.free_bytes)
        )
    }
}

/// Whether `needed_bytes` are free. Where the system does not tell, or sets no limit, they are.
pub(crate) fn ask(needed_bytes: u64) -> Result<(), NoRoom> {
    let free_bytes = match statvfs(FOLDER) {
        Ok(folder) if folder.f_blocks > 0 => folder.f_bavail * folder.f_frsize,
        _ => return Ok(()),
    };
    if free_bytes >= needed_bytes {
        return Ok(());
    }
    Err(NoRoom {
        needed_bytes,
        free_bytes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_has_is_refused_in_words() {
        assert_eq!(ask(0), Ok(()));
        // A shared memory without a limit has room for everything.
        if let Err(no_room) = ask(u64::MAX) {
            let text = no_room.to_string();
            assert!(
                text.contains("/dev/shm") && text.contains("MB are free"),
                "{text}"
            );
        }
    }
}
