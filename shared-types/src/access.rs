//! Access to a root folder.

use std::os::unix::fs::MetadataExt;

use rustix::fs::{Access, AtFlags, CWD, accessat};
use rustix::process::geteuid;

use crate::Location;

impl Location {
    /// True if this process may communicate here. Either the root folder belongs to its user and others cannot write to
    /// it, or the daemon opened it to a group that this process is in. Root counts as in no group: files that others
    /// put into the folder could lead it to change files elsewhere.
    ///
    /// # Errors
    /// If there is no root folder, or this process may not access it.
    pub fn is_open_to_us(&self) -> std::io::Result<bool> {
        let root = std::fs::metadata(self.root())?;
        let user = geteuid();
        if root.uid() == user.as_raw() {
            return Ok(root.mode() & 0o002 == 0);
        }
        if user.is_root() {
            return Ok(false);
        }
        let all = Access::READ_OK | Access::WRITE_OK | Access::EXEC_OK;
        let is_for_group = root.mode() & 0o077 == 0o070
            && accessat(CWD, self.root(), all, AtFlags::EACCESS).is_ok();
        Ok(is_for_group && self.is_sheltered())
    }

    /// True if this process sees the root folder on a read-only file system: a container or a unit mounts it so.
    pub fn is_read_only(&self) -> bool {
        rustix::fs::statvfs(self.root())
            .is_ok_and(|found| found.f_flag.contains(rustix::fs::StatVfsMountFlags::RDONLY))
    }

    /// True if only root can have created the root folder at its path. Other users trust a folder only then.
    pub fn is_sheltered(&self) -> bool {
        let is_folder = self
            .root()
            .symlink_metadata()
            .is_ok_and(|root| root.is_dir());
        let above = self.root().parent().and_then(|above| above.metadata().ok());
        is_folder && above.is_some_and(|above| above.uid() == 0 && above.mode() & 0o022 == 0)
    }
}
