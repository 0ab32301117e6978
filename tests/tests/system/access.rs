//! Another user of the machine: cannot read, feed or command, cannot get in the way unseen, and is told so.
//!
//! The other user is a real one, `nobody`. Only root can start programs as another user; elsewhere these tests
//! say that they were skipped.

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use cdcr_client::{ConnectError, Connection};
use cdcr_shared_types::codes::{Mode, Outcome};
use cdcr_shared_types::{Location, ObstacleUpdate, Service, Status};
use cdcr_tests::{
    Daemon, PATIENCE, PATIENT, Place, Program, ROBOT, binary, shared_memory_files, text, wait_status,
    wait_until,
};
use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, NodeBuilder, SemanticString, ipc};
use rustix::process::Signal;

/// User and group `nobody`.
const NOBODY: u32 = 65_534;

/// Statuses that the manual gives.
const EXIT_SHARED_MEMORY: i32 = 71;
const EXIT_ROOT: i32 = 73;

/// Where the tests hand a place to a process of their own.
const PREFIX_VARIABLE: &str = "CDCR_TEST_PREFIX";
const ROOT_VARIABLE: &str = "CDCR_TEST_ROOT";

/// Everything that `cdcrctl` can ask of a daemon. PATH stands for a file that the other user can read.
const COMMANDS: &[&str] = &[
    "status",
    "status --format json",
    "status --watch",
    "status --reset-statistics",
    "echo telemetry --count 1",
    "echo command --count 1",
    "echo status --count 1",
    "echo incidents --count 1",
    "echo reference --count 1",
    "echo obstacles --count 1",
    "ref spiral --track",
    "ref line --track",
    "ref circle --track",
    "ref file PATH --track",
    "track",
    "hold",
    "home",
    "stop",
    "reset",
    "incidents",
    "settings",
    "settings set horizon_steps=5",
    "obstacle add --id 1 --at 0.1,0,0.5 --radius 0.02",
    "obstacle remove 7",
    "obstacle clear",
];

/// What the other user tries with each file: to read it, to write to it, to open it to all, to take it away.
/// `:` opens and writes nothing; `cat` reads everything.
const ATTEMPTS: &str = r#"
for file in "$@"; do
    if ( cat "$file" > /dev/null ) 2> /dev/null; then echo "read $file"; fi
    if ( : >> "$file" ) 2> /dev/null; then echo "wrote $file"; fi
    if ( : <> "$file" ) 2> /dev/null; then echo "opened $file"; fi
    if chmod 0666 "$file" 2> /dev/null; then echo "opened to all $file"; fi
    if mv "$file" "$file.taken" 2> /dev/null; then echo "moved $file"; fi
    if rm -f "$file" 2> /dev/null && [ -n "$REMOVES" ]; then echo "removed $file"; fi
done
echo "tried $#"
"#;

/// A place that the other user can see into, as far as its folder goes: what keeps the user out is the root.
fn in_view(place: &Place) {
    fs::set_permissions(place.folder(), Permissions::from_mode(0o755)).unwrap();
}

/// `program` as the other user, with nothing of our environment.
fn stranger(program: impl AsRef<Path>) -> Command {
    let mut command = Command::new(program.as_ref());
    command
        .env_clear()
        .env("PATH", "/usr/bin:/bin")
        .current_dir("/")
        .stdin(Stdio::null())
        .uid(NOBODY)
        .gid(NOBODY);
    command
}

/// Whether we can be another user here. Says why not.
fn have_a_stranger() -> bool {
    if !rustix::process::geteuid().is_root() {
        eprintln!("skipped: only root can start a program as another user");
        return false;
    }
    match stranger("/bin/true").status() {
        Ok(status) if status.success() => true,
        other => {
            eprintln!("skipped: cannot run a program as user {NOBODY}: {other:?}");
            false
        }
    }
}

/// A copy that any user may run: the build may lie in a folder that is closed to others.
fn open_to_all(place: &Place, program: &Path) -> PathBuf {
    let copy = place.folder().join(program.file_name().unwrap());
    fs::copy(program, &copy).unwrap();
    fs::set_permissions(&copy, Permissions::from_mode(0o755)).unwrap();
    copy
}

/// `cdcrctl` or `cdcrd` of the other user, for the daemon with this prefix and root.
fn of_stranger(program: &Path, prefix: &str, root: &Path) -> Command {
    let mut command = stranger(program);
    command
        .env("CDCR_ROBOT", ROBOT)
        .env("CDCR_PREFIX", prefix)
        .env("CDCR_ROOT", root);
    command
}

fn files_below(folder: &Path) -> BTreeSet<PathBuf> {
    let mut files = BTreeSet::new();
    for entry in fs::read_dir(folder).unwrap().flatten() {
        if entry.file_type().unwrap().is_dir() {
            files.extend(files_below(&entry.path()));
        }
        files.insert(entry.path());
    }
    files
}

/// Every file and folder of the daemon: below its root and in shared memory.
fn everything(place: &Place) -> BTreeSet<PathBuf> {
    let shared = place.shared_memory_files().into_iter();
    let mut files: BTreeSet<_> = shared.map(|name| Path::new("/dev/shm").join(name)).collect();
    files.extend(files_below(place.location().root()));
    files.insert(place.location().root().to_owned());
    files
}

/// Of all that, what is the other user's.
fn left_by_stranger(place: &Place) -> Vec<PathBuf> {
    let files = everything(place).into_iter();
    files
        .filter(|path| fs::symlink_metadata(path).is_ok_and(|file| file.uid() == NOBODY))
        .collect()
}

/// A daemon, with a client that has every kind of port open, so that every kind of file is there.
fn busy_daemon() -> (Daemon, impl Sized) {
    let daemon = Daemon::start(PATIENT);
    in_view(daemon.place());
    let connection = daemon.connect();
    let mut update = ObstacleUpdate::default();
    update.obstacle[0].id = 7;
    update.obstacle[0].radius_m = 0.01;
    update.obstacle[0].end_a_m = [5.0; 3];
    update.obstacle[0].end_b_m = [5.0; 3];
    update.count = 1;
    let mut obstacles = connection.obstacle_sender().unwrap();
    obstacles.send(&mut update).unwrap();
    wait_status(&connection, |status| status.obstacle_count == 1);
    let ports = (
        connection.telemetry().unwrap(),
        connection.commands().unwrap(),
        connection.incidents().unwrap(),
        connection.reference_feed().unwrap(),
        connection.driver().unwrap(),
    );
    (daemon, (ports, obstacles, connection))
}

/// What a stranger must not be able to change.
fn standing(status: &Status) -> (u32, u64, u32, [u64; Outcome::COUNT], u64, u64) {
    (
        status.mode,
        status.lease_holder,
        status.obstacle_count,
        status.outcomes,
        status.settings.horizon_steps.into(),
        status.statistics_since_ns,
    )
}
