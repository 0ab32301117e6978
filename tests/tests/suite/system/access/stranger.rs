//! The other user, and what both sides share.

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::io::ErrorKind;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use cdcr_client::Connection;
use cdcr_shared_types::Service;
use cdcr_shared_types::codes::Interface;
use cdcr_test_skip::{Need, skip};
use cdcr_tests::{
    Place, Program, ROBOT, STALL_TOLERANT, TIMEOUT, ball, text, wait_status, wait_until,
};

/// User and group `nobody`.
pub(super) const NOBODY: u32 = 65_534;

/// The exit status in the manual.
pub(super) const EXIT_ROOT: i32 = 73;

/// Opens the place's folder to the other user, for programs and files; the root folder stays closed.
pub(super) fn in_view(place: &Place) {
    fs::set_permissions(place.folder(), Permissions::from_mode(0o755)).unwrap();
}

/// `program` as the other user, without this user's environment.
pub(super) fn stranger(program: impl AsRef<Path>) -> Command {
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

/// Whether the test can act as another user here. If not, it is skipped.
pub(super) fn have_a_stranger() -> bool {
    if !rustix::process::geteuid().is_root() {
        skip(Need::Root, "only root can start a program as another user");
        return false;
    }
    match stranger("/bin/true").status() {
        Ok(status) if status.success() => true,
        other => {
            skip(
                Need::Root,
                format_args!("cannot run a program as user {NOBODY}: {other:?}"),
            );
            false
        }
    }
}

/// A copy that any user may run, because the build may be in a folder closed to others. Another process makes
/// the copy: children of other tests could inherit a file open for writing from this process ("text file
/// busy").
pub(super) fn open_to_all(place: &Place, program: &Path) -> PathBuf {
    let copy = place.folder().join(program.file_name().unwrap());
    let copied = Command::new("cp").args([program, &copy]).status().unwrap();
    assert!(copied.success());
    fs::set_permissions(&copy, Permissions::from_mode(0o755)).unwrap();
    copy
}

/// `cdcrctl` or `cdcrd` of the other user, for the daemon with this prefix and root.
pub(super) fn of_stranger(program: &Path, prefix: &str, root: &Path) -> Command {
    let mut command = stranger(program);
    command
        .env("CDCR_ROBOT", ROBOT)
        .env("CDCR_PREFIX", prefix)
        .env("CDCR_ROOT", root);
    command
}

/// Every file and folder below a folder. Running programs may remove them meanwhile: then they are left out.
pub(super) fn paths_below(folder: &Path) -> BTreeSet<PathBuf> {
    let mut paths = BTreeSet::new();
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == ErrorKind::NotFound => return paths,
        entries => entries.unwrap(),
    };
    for path in entries.flatten().map(|entry| entry.path()) {
        if fs::symlink_metadata(&path).is_ok_and(|file| file.is_dir()) {
            paths.extend(paths_below(&path));
        }
        paths.insert(path);
    }
    paths
}

/// Every file and folder of the daemon.
pub(super) fn everything(place: &Place) -> BTreeSet<PathBuf> {
    let mut files = paths_below(place.location().root());
    files.insert(place.location().root().to_owned());
    files
}

/// The files among them that belong to the other user.
pub(super) fn left_by_stranger(place: &Place) -> Vec<PathBuf> {
    let files = everything(place).into_iter();
    files
        .filter(|path| fs::symlink_metadata(path).is_ok_and(|file| file.uid() == NOBODY))
        .collect()
}

/// Starts a daemon, and connects when it has created all of its files. An earlier client may remove files
/// that the daemon has just created.
pub(super) fn start(place: &Place, cdcrd: &mut Command) -> (Program, Connection) {
    in_view(place);
    let daemon = Program::start(cdcrd);
    let services = place.location().root().join("services");
    wait_until("the services", || {
        fs::read_dir(&services).is_ok_and(|all| all.count() == Service::ALL.len())
    });
    let connection = Connection::open_within(place.location(), ROBOT, TIMEOUT).unwrap();
    (daemon, connection)
}

/// A daemon, with a client that has opened every kind of port, so that every kind of file exists.
pub(super) fn busy_daemon(place: &Place) -> impl Sized {
    let config = place.write("robot.toml", STALL_TOLERANT);
    let mut command = place.command("cdcrd");
    let (daemon, connection) = start(place, command.args(["run", "--config"]).arg(config));
    let obstacles = connection.obstacle_sender().unwrap();
    obstacles.upsert(&[ball(7, [5.0; 3])]).unwrap();
    wait_status(&connection, |status| status.obstacle_count == 1);
    let ports = (
        connection.telemetry().unwrap(),
        connection.commands().unwrap(),
        connection.incidents().unwrap(),
        connection.reference_feed().unwrap(),
        connection.driver(Interface::Velocity).unwrap(),
    );
    // In the order in which they are dropped.
    (ports, obstacles, connection, daemon)
}

/// Creates a folder that belongs to the other user.
pub(super) fn folder_of_stranger(folder: &Path) {
    fs::create_dir(folder).unwrap();
    chown(folder, Some(NOBODY), Some(NOBODY)).unwrap();
}

/// Attempts of the other user on each file: to read it, to write to it, to put something into it, to open it
/// to all, to remove it. `:` opens and writes nothing; `cat` reads everything.
const ATTEMPTS: &str = r#"
for file in "$@"; do
    if ( cat "$file" > /dev/null ) 2> /dev/null; then echo "read $file"; fi
    if ( : >> "$file" ) 2> /dev/null; then echo "wrote $file"; fi
    if ( : <> "$file" ) 2> /dev/null; then echo "opened $file"; fi
    if ls "$file/" > /dev/null 2>&1; then echo "listed $file"; fi
    if ln -s /etc/passwd "$file/planted" 2> /dev/null; then echo "planted a link in $file"; fi
    if chmod 0666 "$file" 2> /dev/null; then echo "opened to all $file"; fi
    if mv "$file" "$file.taken" 2> /dev/null; then echo "moved $file"; fi
    if rm -rf "$file" 2> /dev/null; then echo "removed $file"; fi
done
echo "tried $#"
"#;

/// Successful attempts on the files, one line each.
pub(super) fn attempts(files: &BTreeSet<PathBuf>, group: u32) -> Vec<String> {
    let output = stranger("/bin/sh")
        .gid(group)
        .args(["-c", ATTEMPTS, "attempts"])
        .args(files)
        .output()
        .unwrap();
    let printed = text(&output);
    assert!(
        printed.contains(&format!("tried {}", files.len())),
        "{printed}"
    );
    printed
        .lines()
        .filter(|line| !line.starts_with("tried "))
        .map(str::to_owned)
        .collect()
}
