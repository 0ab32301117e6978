//! The root folder in which daemon and clients find each other.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;

use rustix::fs::{Access, access};

use super::{Assessed, Assessment, Scene};

checks! {
    Always root_folder, "root folder",
        "Whoever may write here can disturb the robot; where the daemon may not, it does not start.";
}

const IN_MEMORY: &str =
    "choose a folder in memory (tmpfs), below /dev/shm or /run: --root DIR, or transport.root";
const ANOTHER: &str = "choose a folder of your own: --root DIR, or transport.root";

#[allow(clippy::unnecessary_wraps, reason = "every check has this signature")]
fn root_folder(scene: &Scene) -> Assessed {
    let shown = scene.plan.root.display().to_string();
    if let Ok(false) = scene.probe.root_in_memory {
        let value = format!("{shown} lies on a disk");
        return Ok(Assessment::fault(value, IN_MEMORY));
    }
    let path = scene.system.path(&shown);
    let folder = match std::fs::metadata(&path) {
        Ok(folder) => folder,
        Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => {
            return Ok(not_there_yet(&shown, &path));
        }
        Err(cause) => {
            return Ok(Assessment::fault(format!("{shown}: {cause}"), ANOTHER));
        }
    };
    if !folder.is_dir() {
        return Ok(Assessment::fault(format!("{shown} is no folder"), ANOTHER));
    }
    let (owner, user) = (folder.uid(), scene.probe.user_id);
    if owner != user {
        let value = format!("{shown} belongs to user id {owner}, not to {user}");
        return Ok(Assessment::fault(value, ANOTHER));
    }
    let mode = folder.permissions().mode() & 0o7777;
    let value = format!("{shown}, owner {owner}, mode {mode:o}");
    let foreign = if scene.plan.is_for_group {
        0o002
    } else {
        0o022
    };
    if mode & foreign == 0 {
        return Ok(Assessment::ok(value));
    }
    let value = format!("{value}: others may write");
    Ok(Assessment::warning(value, format!("chmod 700 '{shown}'")))
}

/// The daemon creates the folder, with all above it, if the first one that is there lets it.
fn not_there_yet(shown: &str, path: &Path) -> Assessment {
    let above = path.ancestors().skip(1).find(|folder| folder.exists());
    let is_writable = above.is_some_and(|folder| {
        folder.is_dir() && access(folder, Access::WRITE_OK | Access::EXEC_OK).is_ok()
    });
    if is_writable {
        Assessment::ok(format!("{shown}, created at the first start"))
    } else {
        Assessment::fault(
            format!("{shown} is not there and cannot be created"),
            ANOTHER,
        )
    }
}
