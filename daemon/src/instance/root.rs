use std::fs::{DirBuilder, Metadata, Permissions};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::Path;

use cdcr_shared_types::Location;
use rustix::fs::statfs;

use super::{InstanceError, acl, file_error};

/// Write permission of group and others.
const OPEN_TO_WRITE: u32 = 0o022;

/// File systems that have nothing but memory: tmpfs and ramfs (`linux/magic.h`).
const IN_MEMORY: [i64; 2] = [0x0102_1994, 0x8584_58f6];

/// Makes the root folder if it is missing, and sees that it is in memory, and was ours alone to write to, or the group's: who
/// may write there can put files in our way, or take them away from our clients. Then closes it to all others: it alone
/// keeps them from the files in it.
pub(super) fn prepare(location: &Location, group_id: Option<u32>) -> Result<(), InstanceError> {
    let root = location.root();
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(root)
        .map_err(|cause| file_error(root, cause))?;
    let user = rustix::process::geteuid().as_raw();
    let read = |metadata: std::io::Result<Metadata>| metadata.map_err(|e| file_error(root, e));
    let link = read(std::fs::symlink_metadata(root))?;
    if link.is_symlink() && link.uid() != user && link.uid() != 0 {
        return Err(InstanceError::ForeignLink {
            root: root.display().to_string(),
            owner: link.uid(),
            user,
        });
    }
    let folder = read(std::fs::metadata(root))?;
    if folder.uid() != user {
        return Err(InstanceError::ForeignRoot {
            root: root.display().to_string(),
            owner: folder.uid(),
            user,
        });
    }
    let is_for_group = group_id.is_some_and(|group_id| acl::is_for_group(root, group_id));
    if folder.mode() & OPEN_TO_WRITE != 0 && !is_for_group {
        return Err(InstanceError::OpenRoot {
            root: root.display().to_string(),
            mode: folder.mode() & 0o7777,
        });
    }
    if !is_in_memory(root).map_err(|cause| file_error(root, cause))? {
        return Err(InstanceError::RootOnDisk {
            root: root.display().to_string(),
        });
    }
    if group_id.is_some() {
        may_share(location)?;
    }
    let done = match group_id {
        Some(_) if is_for_group => Ok(()),
        Some(group_id) => share(root, group_id),
        None => acl::close(root),
    };
    done.map_err(|cause| file_error(root, cause))
}

/// Lets a group in. Nobody else is let in meanwhile.
fn share(root: &Path, group_id: u32) -> std::io::Result<()> {
    std::fs::set_permissions(root, Permissions::from_mode(0o700))?;
    open_folders(root)?;
    acl::open_to_group(root, group_id)
}

/// Whether a group may be let into the root.
fn may_share(location: &Location) -> Result<(), InstanceError> {
    let root = location.root().display().to_string();
    if rustix::process::geteuid().is_root() {
        return Err(InstanceError::GroupOfRoot { root });
    }
    if location.is_sheltered() {
        Ok(())
    } else {
        Err(InstanceError::GroupRoot { root })
    }
}

/// Opens the folders in the root: an older version, whose files were private, may have left them.
fn open_folders(root: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(root)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            std::fs::set_permissions(entry.path(), Permissions::from_mode(0o777))?;
        }
    }
    Ok(())
}

/// Whether files in `folder` have no disk behind them.
///
/// # Errors
/// When the system does not tell, because there is no such folder, for example.
pub fn is_in_memory(folder: &Path) -> std::io::Result<bool> {
    let kind = statfs(folder)?.f_type;
    #[allow(
        clippy::useless_conversion,
        reason = "the type differs between processors"
    )]
    let kind = i64::from(kind);
    Ok(IN_MEMORY.contains(&kind))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::set_permissions;

    fn prepare(root: &Path) -> Result<(), InstanceError> {
        let location = Location::new("cdcrtest_root_", root).expect("a legal place");
        super::prepare(&location, None)
    }

    #[test]
    fn a_new_root_is_open_to_nobody_else() {
        let folder = tempfile::tempdir_in(Location::MEMORY).expect("a folder");
        let root = folder.path().join("a/root");
        prepare(&root).expect("it is made");
        let mode = std::fs::metadata(&root).expect("it is there").mode();
        assert_eq!(mode & 0o777, 0o700, "{mode:o}");
    }

    #[test]
    fn a_root_that_others_may_write_to_is_refused_and_left_as_it_is() {
        let folder = tempfile::tempdir_in(Location::MEMORY).expect("a folder");
        let root = folder.path();
        for mode in [0o777, 0o770, 0o757, 0o1777] {
            set_permissions(root, Permissions::from_mode(mode)).expect("it is ours");
            let error = prepare(root).expect_err("it is open");
            let text = error.to_string();
            for part in [&format!("mode {mode:04o}"), "chmod go-rwx", "--root"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            let after = std::fs::metadata(root).expect("it is there").mode();
            assert_eq!(after & 0o7777, mode);
        }
        for mode in [0o755, 0o750, 0o700] {
            set_permissions(root, Permissions::from_mode(mode)).expect("it is ours");
            prepare(root).expect("only we may write to it");
            let after = std::fs::metadata(root).expect("it is there").mode();
            assert_eq!(after & 0o777, 0o700, "others may not look into it");
        }
    }

    #[test]
    fn a_link_of_our_own_may_lead_to_the_root() {
        let folder = tempfile::tempdir_in(Location::MEMORY).expect("a folder");
        let (root, link) = (folder.path().join("root"), folder.path().join("link"));
        prepare(&root).expect("it is made");
        std::os::unix::fs::symlink(&root, &link).expect("a link");
        prepare(&link).expect("both are ours");
    }

    #[test]
    fn a_root_on_a_disk_is_refused() {
        // A file system that is neither memory nor ours; where it is memory, there is nothing to refuse.
        let folder = tempfile::tempdir_in(env!("CARGO_MANIFEST_DIR")).expect("a folder");
        if is_in_memory(folder.path()).expect("it is there") {
            return;
        }
        let error = prepare(folder.path()).expect_err("it is on a disk");
        let text = error.to_string();
        for part in ["on a disk", "--root", "/dev/shm"] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}
