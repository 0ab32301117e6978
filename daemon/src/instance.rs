//! One daemon per robot and location.

use std::fs::{DirBuilder, File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use cdcr_shared_types::Location;

/// The right to be the daemon of one robot at one location: a locked file in the root folder. The
/// kernel gives the lock back when the process ends, however it ends.
#[derive(Debug)]
pub struct Instance {
    path: PathBuf,
    location: Location,
    _locked: File,
}

/// Why this process may not be the daemon.
#[derive(Debug, thiserror::Error)]
pub enum InstanceError {
    /// Another one is.
    #[error(
        "a daemon for robot \"{robot}\" runs already (process {process}) with prefix {prefix} below \
         {root}\nend it with `kill {process}`, or choose another --robot, --prefix or --root"
    )]
    Runs {
        /// Name of the robot.
        robot: String,
        /// Process id of the other daemon, as far as it could be read.
        process: String,
        /// Prefix.
        prefix: String,
        /// Root folder.
        root: String,
    },
    /// The root folder belongs to another user, or is open to others.
    #[error(
        "the root folder {root} belongs to user id {owner}, not to {user}\nchoose another with --root"
    )]
    ForeignRoot {
        /// Root folder.
        root: String,
        /// Who owns it.
        owner: u32,
        /// Who we are.
        user: u32,
    },
    /// The lock file cannot be used.
    #[error("cannot use {path}: {cause}\nchoose a root folder that you may write to with --root")]
    File {
        /// The file or folder.
        path: String,
        /// Why.
        cause: std::io::Error,
    },
}

impl Instance {
    /// Becomes the daemon of `robot` at `location`.
    ///
    /// # Errors
    /// [`InstanceError`] when another daemon is, or the folder cannot be used.
    pub fn claim(location: &Location, robot: &str) -> Result<Self, InstanceError> {
        let root = location.root();
        DirBuilder::new()
            .recursive(true)
            .mode(0o750)
            .create(root)
            .map_err(|cause| file_error(root, cause))?;
        check_owner(root)?;
        let path = root.join(format!("{}{robot}.lock", location.prefix()));
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .open(&path)
            .map_err(|cause| file_error(&path, cause))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(InstanceError::Runs {
                    robot: robot.to_owned(),
                    process: owner_of(&mut file),
                    prefix: location.prefix().to_owned(),
                    root: root.display().to_string(),
                });
            }
            Err(TryLockError::Error(cause)) => return Err(file_error(&path, cause)),
        }
        write_process_id(&mut file).map_err(|cause| file_error(&path, cause))?;
        Ok(Self {
            path,
            location: location.clone(),
            _locked: file,
        })
    }
}

impl Drop for Instance {
    /// Removes the lock file, and what iceoryx2 keeps for a prefix when its last node is gone.
    fn drop(&mut self) {
        remove_if_there(&self.path);
        leave_nothing(&self.location);
    }
}

fn check_owner(root: &Path) -> Result<(), InstanceError> {
    let owner = std::fs::metadata(root)
        .map_err(|cause| file_error(root, cause))?
        .uid();
    let user = rustix::process::geteuid().as_raw();
    if owner == user {
        return Ok(());
    }
    Err(InstanceError::ForeignRoot {
        root: root.display().to_string(),
        owner,
        user,
    })
}

fn file_error(path: &Path, cause: std::io::Error) -> InstanceError {
    InstanceError::File {
        path: path.display().to_string(),
        cause,
    }
}

fn owner_of(file: &mut File) -> String {
    let mut text = String::new();
    match file.read_to_string(&mut text) {
        Ok(_) if !text.trim().is_empty() => text.trim().to_owned(),
        _ => "unknown".to_owned(),
    }
}

fn write_process_id(file: &mut File) -> std::io::Result<()> {
    file.set_len(0)?;
    file.rewind()?;
    writeln!(file, "{}", std::process::id())
}

fn remove_if_there(path: &Path) {
    if let Err(error) = std::fs::remove_file(path)
        && error.kind() != std::io::ErrorKind::NotFound
    {
        tracing::warn!(path = %path.display(), %error, "cannot be removed");
    }
}

/// iceoryx2 keeps one small management file per prefix in `/dev/shm` for ever. When no node uses the
/// prefix any more, it goes.
fn leave_nothing(location: &Location) {
    use iceoryx2::prelude::{CallbackProgression, Node, ipc};
    let Ok(config) = location.iceoryx2_config() else {
        return;
    };
    let mut nodes = 0;
    let listed = Node::<ipc::Service>::list(&config, |_| {
        nodes += 1;
        CallbackProgression::Continue
    });
    if listed.is_err() || nodes > 0 {
        return;
    }
    let Ok(entries) = std::fs::read_dir("/dev/shm") else {
        return;
    };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(location.prefix()) && name.ends_with(".global_mgmt") {
            remove_if_there(&entry.path());
        }
    }
}
