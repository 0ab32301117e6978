//! The access control list of the root folder: for its owner alone, or for a group as well. See `acl(5)`.

use std::io::Result;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use rustix::fs::{XattrFlags, getxattr, removexattr, setxattr};
use rustix::io::Errno;

/// Name of the list.
const ACCESS: &str = "system.posix_acl_access";

/// Whether the folder is open to its owner and the group, and to nobody else.
pub(super) fn is_for_group(folder: &Path, group_id: u32) -> bool {
    let list = list(group_id);
    let mut found = vec![0; list.len() + 1];
    getxattr(folder, ACCESS, &mut found).is_ok_and(|length| found[..length] == list)
}

/// Opens the folder to a group.
pub(super) fn open_to_group(folder: &Path, group_id: u32) -> Result<()> {
    setxattr(folder, ACCESS, &list(group_id), XattrFlags::empty())?;
    Ok(())
}

/// Closes the folder to all but its owner.
pub(super) fn close(folder: &Path) -> Result<()> {
    match removexattr(folder, ACCESS) {
        // There is none, or the file system has no lists.
        Ok(()) | Err(Errno::NODATA | Errno::OPNOTSUPP) => {}
        Err(error) => return Err(error.into()),
    }
    std::fs::set_permissions(folder, PermissionsExt::from_mode(0o700))
}

/// The owner and the group may do everything, all others nothing (`linux/posix_acl_xattr.h`).
fn list(group_id: u32) -> Vec<u8> {
    const VERSION: u32 = 2;
    const NOBODY_NAMED: u32 = u32::MAX;
    let (owner, owners_group, group, mask, others): (u16, u16, u16, u16, u16) =
        (0x01, 0x04, 0x08, 0x10, 0x20);
    let entries = [
        (owner, 7_u16, NOBODY_NAMED),
        (owners_group, 0, NOBODY_NAMED),
        (group, 7, group_id),
        (mask, 7, NOBODY_NAMED),
        (others, 0, NOBODY_NAMED),
    ];
    let mut list = VERSION.to_le_bytes().to_vec();
    for (tag, permissions, id) in entries {
        list.extend(tag.to_le_bytes());
        list.extend(permissions.to_le_bytes());
        list.extend(id.to_le_bytes());
    }
    list
}
