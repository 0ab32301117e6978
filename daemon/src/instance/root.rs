use std::ffi::{CString, OsStr};
use std::fs::{DirBuilder, File, Permissions, TryLockError};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use cdcr_shared_types::Location;
use rustix::fs::{
    AtFlags, Dir, FlockOperation, Mode, OFlags, StatFs, flock, fstatfs, open, openat, readlinkat,
    statfs, unlinkat,
};
use rustix::io::Errno;

use super::{InstanceError, acl, file_error, owner_of, runs_already};

/// Write permission of group and others.
const OPEN_TO_WRITE: u32 = 0o022;
/// Permission of group and others to open files inside.
const OPEN_TO_ENTER: u32 = 0o011;

/// File systems without a disk: tmpfs and ramfs (`linux/magic.h`).
const IN_MEMORY: [i64; 2] = [0x0102_1994, 0x8584_58f6];

/// Attempts to lock a folder locked by others: for longer than a caretaker needs to restore a changed access.
const TRIES: usize = 150;
const TRY_AGAIN: Duration = Duration::from_millis(10);

/// Creates the root folder if it is missing. Checks that it is in memory, and that only this user, or the
/// group, could write to it. Any other writer could obstruct the daemon with files, or remove the files of
/// its clients. Then closes the folder to all others: only the folder protects its files. While the returned
/// file is open, no daemon changes the access of the folder.
pub(super) fn prepare(
    location: &Location,
    robot: &str,
    group_id: Option<u32>,
) -> Result<File, InstanceError> {
    let root = location.root();
    let failed = |cause| file_error(root, cause);
    DirBuilder::new()
        .recursive(true)
        .mode(0o700)
        .create(root)
        .map_err(failed)?;
    let folder = open_own(root)?;
    let file_system = fstatfs(&folder).map_err(|cause| failed(cause.into()))?;
    if !is_memory(file_system) {
        return Err(InstanceError::RootOnDisk {
            root: root.display().to_string(),
        });
    }
    if group_id.is_some() {
        may_share(location)?;
    }
    settle(&folder, location, robot, group_id)?;
    Ok(folder)
}

/// Opens the folder if it belongs to this user. Owner and type are read from the open file, which nobody can
/// replace.
fn open_own(root: &Path) -> Result<File, InstanceError> {
    let failed = |cause: Errno| file_error(root, cause.into());
    let at = |path: &Path| {
        // With a trailing slash a link would be followed.
        let path: PathBuf = path.components().collect();
        let flags = OFlags::PATH | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        open(path, flags, Mode::empty()).map(File::from)
    };
    let metadata = |file: &File| file.metadata().map_err(|cause| file_error(root, cause));
    let user = rustix::process::geteuid().as_raw();
    let mut place = at(root).map_err(failed)?;
    let found = metadata(&place)?;
    if found.is_symlink() {
        if found.uid() != user && found.uid() != 0 {
            return Err(InstanceError::ForeignLink {
                root: root.display().to_string(),
                owner: found.uid(),
                user,
            });
        }
        let target = readlinkat(&place, c"", Vec::new()).map_err(failed)?;
        let beside = root.parent().unwrap_or(root);
        let target = beside.join(OsStr::from_bytes(target.to_bytes()));
        let target = target.canonicalize();
        place = at(&target.map_err(|cause| file_error(root, cause))?).map_err(failed)?;
    }
    let owner = metadata(&place)?.uid();
    if owner != user {
        return Err(InstanceError::ForeignRoot {
            root: root.display().to_string(),
            owner,
            user,
        });
    }
    let flags = OFlags::DIRECTORY | OFlags::CLOEXEC;
    let folder = openat(&place, c".", flags, Mode::empty());
    folder.map(File::from).map_err(failed)
}

/// Ensures that only the owner and the group have access to the folder, and locks it. Each daemon holds a
/// shared lock as long as it lives. The access changes only under an exclusive lock: the files of other
/// daemons there are protected by the folder alone.
fn settle(
    folder: &File,
    location: &Location,
    robot: &str,
    group_id: Option<u32>,
) -> Result<(), InstanceError> {
    for _ in 0..TRIES {
        let is_shared = flock(folder, FlockOperation::NonBlockingLockShared).is_ok();
        if is_shared && acl::is_for(folder, group_id) {
            return Ok(());
        }
        if flock(folder, FlockOperation::NonBlockingLockExclusive).is_err() {
            // A daemon lives here, or is about to; or a program that deletes old files checks the folder.
            std::thread::sleep(TRY_AGAIN);
        } else if !acl::is_for(folder, group_id) {
            change(folder, location, group_id)?;
        }
    }
    Err(in_use(folder, location, robot, group_id))
}

/// Opens the folder to the group, or closes it, if no other user can have put anything into it.
fn change(folder: &File, location: &Location, group_id: Option<u32>) -> Result<(), InstanceError> {
    let root = location.root();
    let failed = |cause| file_error(root, cause);
    let mode = folder.metadata().map_err(failed)?.mode() & 0o7777;
    if mode & OPEN_TO_WRITE != 0 {
        let root = root.display().to_string();
        return Err(InstanceError::OpenRoot { root, mode });
    }
    if mode & OPEN_TO_ENTER != 0 && !is_emptied(folder).map_err(failed)? {
        let root = root.display().to_string();
        return Err(InstanceError::EnteredRoot { root, mode });
    }
    acl::set_for(folder, None).map_err(failed)?;
    if group_id.is_some() {
        open_folders(root).map_err(failed)?;
        acl::set_for(folder, group_id).map_err(failed)?;
    }
    Ok(())
}

/// True if the folder contains only empty folders, which clients may create before the daemon; removes them
/// in that case.
fn is_emptied(folder: &File) -> std::io::Result<bool> {
    let mut names = Vec::new();
    for entry in Dir::read_from(folder)? {
        let name = entry?.file_name().to_owned();
        if ![c".", c".."].contains(&name.as_c_str()) {
            names.push(name);
        }
    }
    for name in &names {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW;
        let Ok(inside) = openat(folder, name.as_c_str(), flags, Mode::empty()) else {
            return Ok(false);
        };
        // The entries `.` and `..`.
        if Dir::read_from(&inside)?.count() > 2 {
            return Ok(false);
        }
    }
    let removed = |name: &CString| unlinkat(folder, name.as_c_str(), AtFlags::REMOVEDIR).is_ok();
    Ok(names.iter().all(removed))
}

/// The refusal of a daemon that would change the access of other daemons' folder, or cannot lock it.
fn in_use(folder: &File, location: &Location, robot: &str, group_id: Option<u32>) -> InstanceError {
    if let Some(daemon) = location.presence(robot) {
        let process = daemon.process_id.map(|id| id.to_string());
        return runs_already(location, robot, process.unwrap_or("unknown".to_owned()));
    }
    let (root, daemons) = (location.root().display().to_string(), living(location));
    if acl::is_for(folder, group_id) || daemons.is_empty() {
        return InstanceError::RootLocked { root };
    }
    let is_closed = acl::is_for(folder, None);
    InstanceError::RootInUse {
        root,
        access: if is_closed {
            "closed to all but its user"
        } else {
            "open to others"
        },
        daemons: daemons.join(", "),
        group: group_id.map_or("\"\"".to_owned(), |id| id.to_string()),
    }
}

/// The daemons in the root folder, with any prefix.
fn living(location: &Location) -> Vec<String> {
    let entries = std::fs::read_dir(location.root()).into_iter().flatten();
    let locked = entries.flatten().filter_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        let name = name.strip_suffix(".lock")?;
        // Does not follow a link and does not wait for a pipe in its place.
        let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
        let mut options = File::options();
        let mut file = options
            .read(true)
            .custom_flags(flags)
            .open(entry.path())
            .ok()?;
        let Err(TryLockError::WouldBlock) = file.try_lock_shared() else {
            return None;
        };
        let robot = name.strip_prefix(location.prefix()).unwrap_or(name);
        Some(format!("\"{robot}\" (process {})", owner_of(&mut file)))
    });
    let mut daemons: Vec<_> = locked.collect();
    daemons.sort();
    daemons
}

/// Checks that the root folder may be opened to a group.
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

/// Opens the folders in the root: an older version with private files may have left them.
fn open_folders(root: &Path) -> std::io::Result<()> {
    for entry in std::fs::read_dir(root)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            std::fs::set_permissions(entry.path(), Permissions::from_mode(0o777))?;
        }
    }
    Ok(())
}

/// The files in `folder` are not on a disk.
pub fn is_in_memory(folder: &Path) -> std::io::Result<bool> {
    Ok(is_memory(statfs(folder)?))
}

fn is_memory(file_system: StatFs) -> bool {
    let kind = file_system.f_type;
    #[allow(
        clippy::useless_conversion,
        reason = "the type differs between processors"
    )]
    let kind = i64::from(kind);
    IN_MEMORY.contains(&kind)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::set_permissions;

    use cdcr_scratch::Scratch;

    /// A group that need not exist.
    const GROUP: u32 = 64_321;

    fn location(root: &Path) -> Location {
        Location::new("cdcrtest_root_", root).expect("a legal place")
    }

    /// A folder inside a folder of the test, whose access the test has closed.
    fn closed_in(folder: &Scratch) -> PathBuf {
        let root = folder.path().join("root");
        std::fs::create_dir(&root).expect("it is ours");
        set_permissions(&root, Permissions::from_mode(0o700)).expect("it is ours");
        root
    }

    fn prepare(root: &Path) -> Result<File, InstanceError> {
        super::prepare(&location(root), "a", None)
    }

    /// Requests access for `group_id` to the folder while the daemon of `robot` lives in it.
    fn settled_beside(
        robot: &str,
        before: Option<u32>,
        group_id: Option<u32>,
    ) -> Result<(), InstanceError> {
        let folder = Scratch::in_memory().expect("a folder");
        let location = location(&closed_in(&folder));
        let [of_it, of_another] = [0; 2].map(|_| File::open(location.root()).expect("it is there"));
        acl::set_for(&of_it, before).expect("it is ours");
        settle(&of_it, &location, robot, before).expect("it is right");
        let lock = File::create(location.lock_file(robot)).expect("a lock file");
        lock.lock().expect("locked");
        std::fs::write(location.lock_file(robot), "17").expect("its process");
        let settled = settle(&of_another, &location, "b", group_id);
        assert!(acl::is_for(&of_it, before), "it is left as it is");
        drop(of_it);
        assert!(settle(&of_another, &location, "b", before).is_ok());
        settled
    }

    #[test]
    fn who_may_use_the_folder_does_not_change_under_a_daemon_that_lives_there() {
        for (before, group_id, access, group) in [
            (None, Some(GROUP), "closed to all but its user", "64321"),
            (Some(GROUP), None, "open to others", "\"\""),
            (Some(GROUP), Some(GROUP + 1), "open to others", "64322"),
        ] {
            let error = settled_beside("a", before, group_id).expect_err("another lives there");
            let text = error.to_string();
            let group = format!("transport.group = {group}");
            for part in [access, "\"a\" (process 17)", &group, "--root"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            let error = settled_beside("b", before, group_id).expect_err("it runs");
            assert!(matches!(error, InstanceError::Runs { .. }), "{error}");
            settled_beside("a", before, before).expect("they agree");
        }
    }

    #[test]
    fn a_process_that_locks_the_folder_alone_is_reported() {
        let folder = Scratch::in_memory().expect("a folder");
        let root = closed_in(&folder);
        prepare(&root).expect("it is closed to others");
        let locked = File::open(&root).expect("it is there");
        locked.lock().expect("nobody else has it");
        let error = prepare(&root).expect_err("it is locked");
        assert!(matches!(error, InstanceError::RootLocked { .. }), "{error}");
        locked.lock_shared().expect("it is ours");
        prepare(&root).expect("it is shared");
        // Another daemon may live there.
        set_permissions(&root, Permissions::from_mode(0o755)).expect("it is ours");
        let error = prepare(&root).expect_err("it would be changed");
        assert!(matches!(error, InstanceError::RootLocked { .. }), "{error}");
    }

    #[test]
    fn a_lock_that_is_given_up_in_time_keeps_no_daemon_out() {
        let folder = Scratch::in_memory().expect("a folder");
        let root = closed_in(&folder);
        let locked = File::open(&root).expect("it is there");
        locked.lock().expect("nobody else has it");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(TRY_AGAIN);
                locked.unlock().expect("it was locked");
            });
            prepare(&root).expect("it is free after a while");
        });
    }

    #[test]
    fn a_new_root_is_open_to_nobody_else() {
        let folder = Scratch::in_memory().expect("a folder");
        let root = folder.path().join("a/root");
        prepare(&root).expect("it is made");
        let mode = std::fs::metadata(&root).expect("it is there").mode();
        assert_eq!(mode & 0o777, 0o700, "{mode:o}");
    }

    #[test]
    fn a_root_that_others_may_write_to_is_refused_and_left_as_it_is() {
        let folder = Scratch::in_memory().expect("a folder");
        let root = &closed_in(&folder);
        for mode in [0o777, 0o770, 0o757, 0o1777] {
            set_permissions(root, Permissions::from_mode(mode)).expect("it is ours");
            let error = prepare(root).expect_err("it is open");
            let text = error.to_string();
            // A folder of all users, like /dev/shm, must stay open to them.
            let is_shared = mode == 0o1777;
            let remedy = if is_shared {
                "/cdcr-$(id -u)"
            } else {
                "chmod go-rwx"
            };
            for part in [&format!("mode {mode:04o}"), remedy, "--root"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            assert_eq!(text.contains("chmod"), !is_shared, "{text}");
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
    fn a_root_that_others_could_enter_is_refused_unless_it_is_empty() {
        let folder = Scratch::in_memory().expect("a folder");
        let root = &closed_in(&folder);
        std::fs::write(root.join("left"), "").expect("it is ours");
        for mode in [0o711, 0o755, 0o750, 0o701] {
            set_permissions(root, Permissions::from_mode(mode)).expect("it is ours");
            let error = prepare(root).expect_err("a file in it may be open");
            let text = error.to_string();
            for part in [&format!("mode {mode:04o}"), "empty it", "--root"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            let after = std::fs::metadata(root).expect("it is there").mode();
            assert_eq!(after & 0o7777, mode);
        }
        set_permissions(root, Permissions::from_mode(0o744)).expect("it is ours");
        prepare(root).expect("names are all that others could read");
        // Left by a client that searched for a daemon.
        std::fs::remove_file(root.join("left")).expect("it is ours");
        std::fs::create_dir(root.join("nodes")).expect("it is ours");
        set_permissions(root, Permissions::from_mode(0o755)).expect("it is ours");
        prepare(root).expect("an empty folder is nothing");
        assert!(!root.join("nodes").exists(), "others may have it open");
    }

    #[test]
    fn a_link_of_our_own_may_lead_to_the_root() {
        let folder = Scratch::in_memory().expect("a folder");
        let (root, link) = (folder.path().join("root"), folder.path().join("link"));
        prepare(&root).expect("it is made");
        std::os::unix::fs::symlink(&root, &link).expect("a link");
        prepare(&link).expect("both are ours");
        prepare(&link.join("")).expect("with a slash, too");
        // Relative to the link, not to the process.
        std::fs::remove_file(&link).expect("it is ours");
        std::os::unix::fs::symlink("root", &link).expect("a link");
        prepare(&link).expect("both are ours");
    }

    #[test]
    fn what_is_no_folder_is_refused() {
        let folder = Scratch::in_memory().expect("a folder");
        let root = folder.path().join("root");
        for make in [
            |at: &Path| std::fs::write(at, ""),
            |at: &Path| std::os::unix::fs::symlink("nowhere", at),
        ] {
            make(&root).expect("it is ours");
            let error = prepare(&root).expect_err("it is not a folder");
            assert!(matches!(error, InstanceError::File { .. }), "{error}");
            std::fs::remove_file(&root).expect("it is ours");
        }
    }
}
