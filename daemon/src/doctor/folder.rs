//! The root folder in which daemon and clients find each other.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;

use rustix::fs::{Access, access};

use super::Scene;
use super::finding::{Assessed, fault, warning};

const IN_MEMORY: &str =
    "choose a folder in memory (tmpfs), below /dev/shm or /run: --root DIR, or transport.root";
const ANOTHER: &str = "choose a folder of your own: --root DIR, or transport.root";

pub(super) fn root_folder(scene: &Scene) -> Assessed {
    let shown = scene.root().display();
    if let Ok(false) = scene.probe.root_in_memory {
        return Err(fault(format!("{shown} lies on a disk"), IN_MEMORY));
    }
    let path = scene.system.path(scene.root());
    let folder = match std::fs::metadata(&path) {
        Ok(folder) => folder,
        Err(cause) if cause.kind() != std::io::ErrorKind::NotFound => {
            return Err(fault(format!("{shown}: {cause}"), ANOTHER));
        }
        Err(_) if can_be_created(&path) => {
            return Ok(format!("{shown}, created at the first start"));
        }
        Err(_) => {
            let value = format!("{shown} is not there and cannot be created");
            return Err(fault(value, ANOTHER));
        }
    };
    if !folder.is_dir() {
        return Err(fault(format!("{shown} is no folder"), ANOTHER));
    }
    let (owner, user) = (folder.uid(), scene.probe.user_id);
    if owner != user {
        let value = format!("{shown} belongs to user id {owner}, not to {user}");
        return Err(fault(value, ANOTHER));
    }
    let mode = folder.permissions().mode() & 0o7777;
    let value = format!("{shown}, owner {owner}, mode {mode:o}");
    let is_for_group = scene.validated.group_id.is_some();
    let foreign = if is_for_group { 0o002 } else { 0o022 };
    if mode & foreign == 0 {
        return Ok(value);
    }
    let value = format!("{value}: others may write");
    Err(warning(value, format!("chmod 700 '{shown}'")))
}

/// The daemon creates the folder, with all above it, if the first one that is there lets it.
fn can_be_created(path: &Path) -> bool {
    let above = path.ancestors().skip(1).find(|folder| folder.exists());
    above.is_some_and(|folder| {
        folder.is_dir() && access(folder, Access::WRITE_OK | Access::EXEC_OK).is_ok()
    })
}
