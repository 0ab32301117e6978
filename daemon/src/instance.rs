//! One daemon per robot and location, at a location that no other user can disturb.

mod acl;
mod name;
mod place;
mod root;

use std::fs::{File, OpenOptions, Permissions, TryLockError};
use std::io::{ErrorKind, Read, Seek, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use cdcr_shared_types::Location;
use nalgebra::Vector3;
use rustix::fs::OFlags;
use rustix::io::Errno;

use crate::kept_obstacles::KeptObstacles;
use crate::latch::Latch;
use crate::obstacles::ObstacleSet;
use crate::services::{ServiceError, ask_for_space, stale};
pub(crate) use place::{PlaceCheck, PlaceWatch};
pub use root::is_in_memory;

/// Longest content read from a lock file \[bytes\]: a writer may put more than a process id into it.
const PROCESS_ID_MAX: u64 = 32;

/// Longer than a client holds the lock to check for a daemon.
const LOCK_TIMEOUT: Duration = Duration::from_millis(200);

/// The right to be the daemon of one robot at one location: a locked file in the root folder, and a name
/// among the abstract Unix sockets. The kernel releases both however the process ends.
#[derive(Debug)]
pub struct Instance {
    path: PathBuf,
    location: Location,
    /// The locked root folder: its access does not change.
    root: Arc<File>,
    group_id: Option<u32>,
    locked: Arc<Mutex<File>>,
    /// Held as long as the process lives, even if the files are deleted.
    name: Option<Arc<UnixListener>>,
    latch: Latch,
    obstacles: KeptObstacles,
}

/// The reason why this process may not be the daemon.
#[derive(Debug, thiserror::Error)]
pub enum InstanceError {
    /// Another daemon is running.
    #[error(
        "a daemon for robot \"{robot}\" is already running (process {process}) with prefix {prefix} in {root}\nend \
         it with `kill {process}`, or use another --robot, --prefix or --root"
    )]
    Runs {
        robot: String,
        /// Process id of the other daemon, if it could be read.
        process: String,
        prefix: String,
        root: String,
    },
    #[error(
        "the root folder {root} belongs to user id {owner}, not to {user}\nuse another one with --root"
    )]
    ForeignRoot { root: String, owner: u32, user: u32 },
    /// Another user has put a link in the place of the root folder.
    #[error(
        "the root folder {root} is a symbolic link that belongs to user id {owner}, not to {user}\n\
         name the folder itself with --root, or choose another"
    )]
    ForeignLink { root: String, owner: u32, user: u32 },
    #[error(
        "other users can write to the root folder {root} (mode {mode:04o}) and could keep clients from the \
         daemon\n{}",
        instead_of_open(.root, *.mode)
    )]
    OpenRoot { root: String, mode: u32 },
    /// Another daemon lives in the root folder, with an access for other users than this one requires.
    #[error(
        "the root folder {root} is {access}, and other daemons run in it: {daemons}\nthis daemon, with transport.group = \
         {group}, would change the permissions for them: use the same group for all daemons of a root folder, end \
         the others first, or use another one with --root"
    )]
    RootInUse {
        root: String,
        /// Present access.
        access: &'static str,
        daemons: String,
        /// Group required by this daemon.
        group: String,
    },
    #[error(
        "other users can enter the root folder {root} (mode {mode:04o}), and files they have opened stay accessible \
         to them\n\
         empty it, or use another one with --root"
    )]
    EnteredRoot { root: String, mode: u32 },
    /// Another process than a running daemon has locked the root folder.
    #[error(
        "another process has locked the root folder {root}: a starting daemon, or a program that deletes old files \
         (find it with `fuser -v {root}`)\ntry again in a moment, or use another folder with --root"
    )]
    RootLocked { root: String },
    #[error(
        "the root folder {root} is on a disk, which would delay the daemon\n\
         use a folder in memory (tmpfs) with --root, for example below /dev/shm, or below /run where `df /run` says tmpfs"
    )]
    RootOnDisk { root: String },
    #[error(
        "a daemon that runs as root cannot share {root} with a group: its members could change files of root through \
         links\n\
         run the daemon as its own user, or leave transport.group empty"
    )]
    GroupOfRoot { root: String },
    /// Another user could replace a folder that a group trusts.
    #[error(
        "cannot share {root} with a group: its parent folder must be owned by root and closed to others, like \
         /run\ncreate one as root: install -d -o <user of the daemon> -m 0700 /run/cdcr; or leave transport.group \
         empty"
    )]
    GroupRoot { root: String },
    #[error(transparent)]
    InsufficientSpace(ServiceError),
    #[error(
        "cannot use {path}: {cause}\nremove it if another program put it there, or use a root folder with write permission (--root)"
    )]
    File { path: String, cause: std::io::Error },
}

impl InstanceError {
    /// The file system of the root folder is full.
    pub(crate) fn is_full(&self) -> bool {
        match self {
            Self::InsufficientSpace(_) => true,
            Self::File { cause, .. } => cause.kind() == ErrorKind::StorageFull,
            _ => false,
        }
    }
}

impl Instance {
    /// Claims to be the daemon of `robot` at `location`, for its user and a group.
    pub fn claim(
        location: &Location,
        robot: &str,
        group_id: Option<u32>,
    ) -> Result<Self, InstanceError> {
        Self::claim_now(location, robot, group_id)
            .map_err(|error| with_missing_space(error, location))
    }

    fn claim_now(
        location: &Location,
        robot: &str,
        group_id: Option<u32>,
    ) -> Result<Self, InstanceError> {
        let root = root::prepare(location, robot, group_id)?;
        let name = name::take(location, robot)?.map(Arc::new);
        let path = location.lock_file(robot);
        let mut locked = lock(&path, location, robot)?;
        write_process_id(&mut locked).map_err(|cause| file_error(&path, cause))?;
        let latched = latch_file(&path);
        let latch =
            Latch::open(&latched).map_err(|cause| file_error(&latched, without_link(cause)))?;
        let obstacles = open_obstacles(&obstacle_file(&path), latch)?;
        // Before the first node of this process, which would count as a user of the location.
        stale::sweep(location);
        Ok(Self {
            path,
            location: location.clone(),
            root: Arc::new(root),
            group_id,
            locked: Arc::new(Mutex::new(locked)),
            name,
            latch,
            obstacles,
        })
    }

    /// The latch of the robot's stop.
    pub(crate) fn latch(&self) -> Latch {
        self.latch
    }

    /// The robot's obstacles without a lifetime.
    pub(crate) fn kept_obstacles(&self) -> KeptObstacles {
        self.obstacles
    }

    /// The files that must remain while the daemon of `robot` runs. Call it when the services exist.
    pub(crate) fn watch(&self, robot: &str) -> PlaceWatch {
        PlaceWatch::new(self, robot)
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // Dead nodes that the caretaker has not cleared yet.
        self.location.clear_dead_nodes(usize::MAX);
        let locked = self.locked.lock().unwrap_or_else(PoisonError::into_inner);
        let latched = latch_file(&self.path);
        let is_free = self.latch.leave(&latched).unwrap_or_else(|error| {
            tracing::error!(path = %latched.display(), %error, "cannot store the latch: the next daemon will not know that the robot was stopped");
            false
        });
        let kept = obstacle_file(&self.path);
        let is_empty = self.obstacles.leave(&kept).unwrap_or_else(|error| {
            tracing::error!(path = %kept.display(), %error, "cannot store the obstacles: the next daemon will not know them");
            false
        });
        // Otherwise they belong to another daemon, started after ours had been deleted.
        if is_file_at(&locked, &self.path) {
            for (path, is_needless) in [(latched, is_free), (kept, is_empty)] {
                if is_needless {
                    remove_if_there(&path);
                }
            }
            // Leftovers of killed clients that iceoryx2 does not remove.
            stale::sweep(&self.location);
            remove_if_there(&self.path);
        }
    }
}

/// The file beside the lock file that keeps the latch.
fn latch_file(lock: &Path) -> PathBuf {
    lock.with_extension("latch")
}

/// The file beside the lock file that keeps the obstacles without a lifetime.
fn obstacle_file(lock: &Path) -> PathBuf {
    lock.with_extension("obstacles")
}

/// Opens the obstacles that the daemon before has kept in the file at `path`. If they cannot be read, a person
/// decides: the robot stays stopped, because it may move into one of them.
fn open_obstacles(path: &Path, latch: Latch) -> Result<KeptObstacles, InstanceError> {
    let kept = KeptObstacles::open(path).map_err(|cause| file_error(path, without_link(cause)))?;
    let set = kept.read();
    let known = set.iter().flat_map(ObstacleSet::iter);
    let moving = known.filter(|known| known.obstacle.velocity_m_s() != Vector3::zeros());
    let moving = moving.count();
    if moving > 0 {
        tracing::warn!(
            "kept obstacles that move: {moving}; their positions are extrapolated from old measurements. \
             Measure them again before the robot moves"
        );
    }
    match set.map(|set| set.count()) {
        Some(0) => {}
        Some(1) => tracing::warn!(
            "1 obstacle of the previous daemon is kept; `cdcrctl obstacle clear` removes it"
        ),
        Some(count) => tracing::warn!(
            "{count} obstacles of the previous daemon are kept; `cdcrctl obstacle clear` removes them"
        ),
        None => {
            tracing::error!(
                path = %path.display(),
                "the obstacles of the previous daemon are lost: another version of cdcrd or another program has \
                 written the file; add them again before `cdcrctl reset`"
            );
            // Before the file is overwritten: a kill in between loses neither.
            latch.lose_obstacles();
            kept.write(&ObstacleSet::default());
        }
    }
    Ok(kept)
}

/// Locks the file at `path`. A daemon that ended between the opening and the locking has removed the file;
/// then the lock is useless, and the new file is tried.
fn lock(path: &Path, location: &Location, robot: &str) -> Result<File, InstanceError> {
    let begin = Instant::now();
    loop {
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .custom_flags(OFlags::NOFOLLOW.bits().cast_signed())
            .open(path)
            .map_err(|cause| file_error(path, without_link(cause)))?;
        match file.try_lock() {
            Ok(()) if is_file_at(&file, path) => return Ok(file),
            Ok(()) => {}
            // A client that checks for a daemon holds the lock for microseconds.
            Err(TryLockError::WouldBlock) if begin.elapsed() < LOCK_TIMEOUT => {
                std::thread::sleep(LOCK_TIMEOUT / 20);
            }
            Err(TryLockError::WouldBlock) => {
                return Err(runs_already(location, robot, owner_of(&mut file)));
            }
            Err(TryLockError::Error(cause)) => return Err(file_error(path, cause)),
        }
    }
}

/// The cause for which a file was not opened, with an own text for a link in its place.
fn without_link(cause: std::io::Error) -> std::io::Error {
    match Errno::from_io_error(&cause) {
        Some(Errno::LOOP) => std::io::Error::other("it is a symbolic link"),
        _ => cause,
    }
}

/// The refusal of a second daemon beside `process`.
fn runs_already(location: &Location, robot: &str, process: String) -> InstanceError {
    InstanceError::Runs {
        robot: robot.to_owned(),
        process,
        prefix: location.prefix().to_owned(),
        root: location.root().display().to_string(),
    }
}

fn is_file_at(file: &File, path: &Path) -> bool {
    let opened = file.metadata().map(|file| (file.dev(), file.ino()));
    let there = std::fs::metadata(path).map(|file| (file.dev(), file.ino()));
    matches!((opened, there), (Ok(opened), Ok(there)) if opened == there)
}

/// Adds the needed and the free space to the error of a full file system.
fn with_missing_space(error: InstanceError, location: &Location) -> InstanceError {
    match error.is_full().then(|| ask_for_space(location)) {
        Some(Err(missing)) => InstanceError::InsufficientSpace(missing),
        _ => error,
    }
}

fn file_error(path: &Path, cause: std::io::Error) -> InstanceError {
    InstanceError::File {
        path: path.display().to_string(),
        cause,
    }
}

fn owner_of(file: &mut File) -> String {
    let mut text = String::new();
    match file.take(PROCESS_ID_MAX).read_to_string(&mut text) {
        Ok(_) if !text.trim().is_empty() => text.trim().to_owned(),
        _ => "unknown".to_owned(),
    }
}

fn write_process_id(file: &mut File) -> std::io::Result<()> {
    // As for all files here, the root folder decides who may check for a daemon.
    file.set_permissions(Permissions::from_mode(0o666))?;
    file.set_len(0)?;
    file.rewind()?;
    writeln!(file, "{}", std::process::id())
}

fn remove_if_there(path: &Path) {
    if let Err(error) = std::fs::remove_file(path)
        && error.kind() != ErrorKind::NotFound
    {
        tracing::warn!(path = %path.display(), %error, "cannot remove the file");
    }
}

/// What to do about a root folder into which other users can write. One with the sticky bit is made for all of them.
fn instead_of_open(root: &str, mode: u32) -> String {
    const STICKY: u32 = 0o1000;
    if mode & STICKY == 0 {
        return format!(
            "check its contents, close it with `chmod go-rwx {root}`, or use another one with --root"
        );
    }
    let root = root.trim_end_matches('/');
    format!(
        "it is shared by all users: use a folder in it, for example --root {root}/cdcr-$(id -u)"
    )
}

#[cfg(test)]
mod tests {
    use cdcr_scratch::Scratch;

    use super::*;

    #[test]
    fn what_killed_clients_left_is_gone_after_the_end_and_what_is_new_stays() {
        let folder = Scratch::in_memory().unwrap();
        let location = Location::new("cdcrtest_left_", &folder.path().join("root")).unwrap();
        let instance = Instance::claim(&location, "a", None).unwrap();
        let [old, new] = ["old.connection", "new.connection"].map(|name| {
            let name = location.file_prefix() + name;
            location.root().join(name)
        });
        let made = File::create(&old).unwrap();
        let now = made.metadata().unwrap().modified().unwrap();
        made.set_modified(now - Duration::from_mins(1)).unwrap();
        File::create(&new).unwrap();
        drop(instance);
        assert!(!old.exists() && new.exists());
    }

    #[test]
    fn a_link_in_the_place_of_the_lock_file_is_not_followed() {
        let folder = Scratch::in_memory().unwrap();
        let location = Location::new("cdcrtest_lock_", &folder.path().join("root")).unwrap();
        root::prepare(&location, "a", None).unwrap();
        let elsewhere = folder.path().join("elsewhere");
        std::fs::write(&elsewhere, "theirs").unwrap();
        std::os::unix::fs::symlink(&elsewhere, location.lock_file("a")).unwrap();
        let refused = Instance::claim(&location, "a", None)
            .unwrap_err()
            .to_string();
        assert!(
            refused.contains("a.lock: it is a symbolic link"),
            "{refused}"
        );
        assert_eq!(std::fs::read_to_string(&elsewhere).unwrap(), "theirs");
        // Checks for a daemon do not follow the link either, even if its target is locked.
        let locked = File::open(&elsewhere).unwrap();
        locked.try_lock().unwrap();
        assert_eq!(location.presence("a"), None);
    }
}
