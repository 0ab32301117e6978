use std::fs::{DirBuilder, Metadata};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::Path;

use rustix::fs::statfs;

use super::{InstanceError, file_error};

/// Write permission of group and others.
const OPEN_TO_WRITE: u32 = 0o022;

/// File systems that have nothing but memory: tmpfs and ramfs (`linux/magic.h`).
const IN_MEMORY: [i64; 2] = [0x0102_1994, 0x8584_58f6];

/// Makes the root folder if it is missing, and sees that it is in memory, and ours alone to write to: who may write
/// there can put files in our way, or take them away from our clients.
pub(super) fn prepare(root: &Path) -> Result<(), InstanceError> {
    DirBuilder::new()
        .recursive(true)
        .mode(0o750)
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
    if folder.mode() & OPEN_TO_WRITE != 0 {
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
    use cdcr_shared_types::Location;
    use std::fs::{Permissions, set_permissions};
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_new_root_is_open_to_nobody_else() {
        let folder = tempfile::tempdir_in(Location::MEMORY).expect("a folder");
        let root = folder.path().join("a/root");
        prepare(&root).expect("it is made");
        let mode = std::fs::metadata(&root).expect("it is there").mode();
        assert_eq!(mode & 0o027, 0, "{mode:o}");
    }

    #[test]
    fn a_root_that_others_may_write_to_is_refused_and_left_as_it_is() {
        let folder = tempfile::tempdir_in(Location::MEMORY).expect("a folder");
        let root = folder.path();
        for mode in [0o777, 0o770, 0o757, 0o1777] {
            set_permissions(root, Permissions::from_mode(mode)).expect("it is ours");
            let error = prepare(root).expect_err("it is open");
            let text = error.to_string();
            for part in [&format!("mode {mode:04o}"), "chmod go-w", "--root"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            let after = std::fs::metadata(root).expect("it is there").mode();
            assert_eq!(after & 0o7777, mode);
        }
        for mode in [0o755, 0o750, 0o700] {
            set_permissions(root, Permissions::from_mode(mode)).expect("it is ours");
            prepare(root).expect("only we may write to it");
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
