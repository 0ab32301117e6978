//! Access to the root folder: its owner alone, or also a group, by an access control list. See `acl(5)`.

use std::fs::{File, Permissions};
use std::io::Result;
use std::os::unix::fs::{MetadataExt, PermissionsExt};

use rustix::fs::{XattrFlags, fgetxattr, fremovexattr, fsetxattr};
use rustix::io::Errno;

const ACCESS: &str = "system.posix_acl_access";

/// True if only its owner and `group_id` have access to the folder.
pub(super) fn is_for(folder: &File, group_id: Option<u32>) -> bool {
    let has_mode = |mode| {
        let found = folder.metadata().map(|folder| folder.mode() & 0o7777);
        found.is_ok_and(|found| found == mode)
    };
    match group_id {
        None => has_mode(0o700) && list_of(folder).is_empty(),
        Some(group_id) => has_mode(0o770) && list_of(folder) == list_for(group_id),
    }
}

/// Gives only its owner and `group_id` access to the folder, without a moment of wider access.
pub(super) fn set_for(folder: &File, group_id: Option<u32>) -> Result<()> {
    let Some(group_id) = group_id else {
        // In this order: without the list the mode applies.
        folder.set_permissions(Permissions::from_mode(0o700))?;
        return match fremovexattr(folder, ACCESS) {
            // No list, or the file system has none.
            Ok(()) | Err(Errno::NODATA | Errno::OPNOTSUPP) => Ok(()),
            Err(error) => Err(error.into()),
        };
    };
    fsetxattr(folder, ACCESS, &list_for(group_id), XattrFlags::empty())?;
    folder.set_permissions(Permissions::from_mode(0o770))
}

/// The access control list of the folder; empty without one.
fn list_of(folder: &File) -> Vec<u8> {
    let mut list = vec![0; LONGEST];
    match fgetxattr(folder, ACCESS, &mut list) {
        Ok(length) => list.truncate(length),
        Err(Errno::NODATA | Errno::OPNOTSUPP) => list.clear(),
        // Longer than any of ours, or unreadable: not one of ours.
        Err(_) => {}
    }
    list
}

/// Capacity for a list \[bytes\]; one of ours has 44.
const LONGEST: usize = 256;

/// Full access for the owner and the group, none for others (`linux/posix_acl_xattr.h`).
fn list_for(group_id: u32) -> Vec<u8> {
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
