//! Another user of the machine: cannot read, feed or command, cannot get in the way unseen, and is told so.
//!
//! The other user is a real one, `nobody`. Only root can start programs as another user; elsewhere these tests
//! say that they were skipped.

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, lchown, symlink};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use cdcr_client::{ConnectError, Connection, monotonic_ns};
use cdcr_shared_types::codes::{Mode, Outcome};
use cdcr_shared_types::{Location, Obstacle, Service, Status};
use cdcr_tests::{
    Daemon, PATIENCE, PATIENT, Place, Program, ROBOT, binary, shared_memory_files, text,
    wait_status, wait_until,
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

/// What the other user tries with each file: to read it, to write to it, to put something into it, to open it to
/// all, to take it away. `:` opens and writes nothing; `cat` reads everything.
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
    let mut files: BTreeSet<_> = shared
        .map(|name| Path::new("/dev/shm").join(name))
        .collect();
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

/// Starts a daemon, and connects to it when it has everything. A client that comes earlier may take away what the
/// daemon has just made.
fn start(place: &Place, cdcrd: &mut Command) -> (Program, Connection) {
    in_view(place);
    let daemon = Program::start(cdcrd);
    let services = place.location().root().join("services");
    wait_until("the services", || {
        fs::read_dir(&services).is_ok_and(|all| all.count() == Service::ALL.len())
    });
    let connection = Connection::open_within(place.location(), ROBOT, PATIENCE).unwrap();
    (daemon, connection)
}

/// A daemon, with a client that has every kind of port open, so that every kind of file is there.
fn busy_daemon(place: &Place) -> impl Sized {
    let config = place.write("robot.toml", PATIENT);
    let mut command = place.command("cdcrd");
    let (daemon, connection) = start(place, command.args(["run", "--config"]).arg(config));
    let obstacles = connection.obstacle_sender().unwrap();
    let far = Obstacle {
        id: 7,
        start_m: [5.0; 3],
        end_m: [5.0; 3],
        radius_m: 0.01,
        measured_ns: monotonic_ns(),
        ..Obstacle::default()
    };
    obstacles.upsert(&[far]).unwrap();
    wait_status(&connection, |status| status.obstacle_count == 1);
    let ports = (
        connection.telemetry().unwrap(),
        connection.commands().unwrap(),
        connection.incidents().unwrap(),
        connection.reference_feed().unwrap(),
        connection.driver().unwrap(),
    );
    // In the order in which they go.
    (ports, obstacles, connection, daemon)
}

/// What a stranger must not be able to change.
fn standing(status: &Status) -> (u32, u64, u32, [u64; Outcome::COUNT], u64, u64) {
    (
        status.mode,
        status.lease_holder,
        status.obstacle_count,
        status.outcomes,
        u64::from(status.settings.horizon_steps),
        status.statistics_since_ns,
    )
}

fn assert_says(output: &Output, status: i32, parts: &[&str]) {
    let said = text(output);
    assert_eq!(output.status.code(), Some(status), "{said}");
    for part in parts {
        assert!(said.contains(part), "{part}: {said}");
    }
}

#[test]
fn every_command_of_another_user_is_refused_and_changes_nothing() {
    if !have_a_stranger() {
        return;
    }
    let place = &Place::new();
    let _busy = busy_daemon(place);
    let location = place.location();
    let program = open_to_all(place, &binary("cdcrctl"));
    let path = place.write("path.csv", "t_s,x_m,y_m,z_m\n0,0,0,0.9\n1,0.01,0,0.9\n");
    fs::set_permissions(&path, Permissions::from_mode(0o644)).unwrap();
    let connection = Connection::open(location, ROBOT).unwrap();
    let _lease = connection.acquire_lease().unwrap();
    let before = wait_status(&connection, |status| {
        status.lease_holder == connection.sender_id()
    });
    let files = everything(place);
    let root = location.root().to_str().unwrap();
    for command in COMMANDS {
        let output = of_stranger(&program, location.prefix(), location.root())
            .args(command.split(' ').map(|word| match word {
                "PATH" => path.to_str().unwrap(),
                word => word,
            }))
            .output()
            .unwrap();
        assert_says(
            &output,
            1,
            &[
                root,
                "belongs to user 0, this program runs as user 65534",
                "sudo -u '#0' cdcrctl",
                "a daemon of your own with another --root",
            ],
        );
        assert!(output.stdout.is_empty(), "{command}: {}", text(&output));
    }
    assert_eq!(everything(place), files);
    assert_eq!(left_by_stranger(place), Vec::<PathBuf>::new());
    let after = wait_status(&connection, |status| status.cycles > before.cycles);
    assert_eq!(standing(&after), standing(&before));
    assert_eq!(after.mode, Mode::Holding.code());
    assert_eq!(after.obstacle_count, 1);
}

#[test]
fn a_root_folder_that_the_other_user_cannot_even_see_is_said_to_be_closed() {
    if !have_a_stranger() {
        return;
    }
    let (closed, open) = (Place::new(), Place::new());
    fs::create_dir(closed.location().root()).unwrap();
    fs::set_permissions(closed.folder(), Permissions::from_mode(0o700)).unwrap();
    in_view(&open);
    let [cdcrctl, cdcrd] = ["cdcrctl", "cdcrd"].map(|name| open_to_all(&open, &binary(name)));
    let root = closed.location().root();
    let command = |program| of_stranger(program, closed.location().prefix(), root);
    let output = command(&cdcrctl).arg("status").output().unwrap();
    let words = [root.to_str().unwrap(), "permission denied"];
    assert_says(&output, 1, &words);
    let output = Program::start(command(&cdcrd).arg("run")).output();
    assert_says(&output, EXIT_ROOT, &["Permission denied", "--root"]);
}

#[test]
fn another_user_may_run_the_demo_beside_the_daemon() {
    if !have_a_stranger() {
        return;
    }
    let daemon = Daemon::start(PATIENT);
    let place = daemon.place();
    in_view(place);
    let connection = daemon.connect();
    let before = wait_status(&connection, |status| status.cycles > 0);
    open_to_all(place, &binary("cdcrd"));
    let program = open_to_all(place, &binary("cdcrctl"));
    let output = of_stranger(&program, place.location().prefix(), place.location().root())
        .args(["demo", "--sections", "1", "--duration", "200ms"])
        .output()
        .unwrap();
    assert_says(&output, 0, &["1 section"]);
    let after = wait_status(&connection, |status| status.cycles > before.cycles);
    assert_eq!(standing(&after), standing(&before));
    assert_eq!(left_by_stranger(place), Vec::<PathBuf>::new());
}

/// What the other user could do with the files, one line for each success.
fn attempts(files: &BTreeSet<PathBuf>, group: u32) -> Vec<String> {
    let output = stranger("/bin/sh")
        .gid(group)
        .args(["-c", ATTEMPTS, "attempts"])
        .args(files)
        .output()
        .unwrap();
    let said = text(&output);
    assert!(said.contains(&format!("tried {}", files.len())), "{said}");
    said.lines()
        .filter(|line| !line.starts_with("tried "))
        .map(str::to_owned)
        .collect()
}

#[test]
fn the_kernel_refuses_another_user_every_file() {
    if !have_a_stranger() {
        return;
    }
    let place = &Place::new();
    let _busy = busy_daemon(place);
    let files = everything(place);
    assert!(files.len() > 60, "{}", files.len());
    assert!(files.iter().any(|path| path.ends_with("services")));
    assert!(
        files
            .iter()
            .any(|path| path.to_string_lossy().ends_with(".global_mgmt"))
    );
    assert_eq!(attempts(&files, NOBODY), Vec::<String>::new());
    // One of the daemon's own group may see the names, and no more.
    let group = fs::metadata(place.location().root()).unwrap().gid();
    let mut done = attempts(&files, group);
    done.retain(|line| !line.starts_with("listed "));
    assert_eq!(done, Vec::<String>::new());
    // Somebody opened the root folder for all to look into: the files are still closed.
    fs::set_permissions(place.location().root(), Permissions::from_mode(0o755)).unwrap();
    let mut done = attempts(&files, NOBODY);
    done.retain(|line| !line.starts_with("listed "));
    assert_eq!(done, Vec::<String>::new());
    assert_eq!(everything(place), files);
    // The attempts succeed where they may.
    let open = place.write("open", "");
    fs::set_permissions(&open, Permissions::from_mode(0o666)).unwrap();
    let name = open.display();
    let expected = ["read", "wrote", "opened"].map(|what| format!("{what} {name}"));
    assert_eq!(attempts(&BTreeSet::from([open.clone()]), NOBODY), expected);
}

#[test]
fn another_user_cannot_end_the_daemon_or_look_into_it() {
    if !have_a_stranger() {
        return;
    }
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    let id = connection.status(PATIENCE).unwrap().process_id;
    for attempt in [
        format!("kill -TERM {id}"),
        format!("kill -KILL {id}"),
        format!("kill -STOP {id}"),
        format!("cat /proc/{id}/mem"),
        format!("cat /proc/{id}/environ"),
        format!("ls /proc/{id}/fd/"),
    ] {
        let output = stranger("/bin/sh").args(["-c", &attempt]).output().unwrap();
        assert!(!output.status.success(), "{attempt}");
        assert!(output.stdout.is_empty(), "{attempt}");
    }
    let cycles = connection.status(PATIENCE).unwrap().cycles;
    wait_status(&connection, |status| status.cycles > cycles);
}

#[test]
fn iceoryx2_by_hand_is_refused_to_another_user() {
    if !have_a_stranger() {
        return;
    }
    let place = &Place::new();
    let _busy = busy_daemon(place);
    let program = open_to_all(place, &std::env::current_exe().unwrap());
    let output = stranger(&program)
        .env(PREFIX_VARIABLE, place.location().prefix())
        .env(ROOT_VARIABLE, place.location().root())
        .args([
            "--exact",
            "access::joins_by_hand",
            "--ignored",
            "--nocapture",
        ])
        .output()
        .unwrap();
    assert_says(&output, 0, &["1 passed", "joined nothing as user 65534"]);
    assert_eq!(left_by_stranger(place), Vec::<PathBuf>::new());
}

#[test]
#[ignore = "run by iceoryx2_by_hand_is_refused_to_another_user, as that user"]
fn joins_by_hand() {
    let variable = |name| std::env::var(name).unwrap();
    let root = PathBuf::from(variable(ROOT_VARIABLE));
    let location = Location::new(&variable(PREFIX_VARIABLE), &root).unwrap();
    let refused = Connection::open(&location, ROBOT).unwrap_err();
    assert!(
        matches!(refused, ConnectError::OtherUser { .. }),
        "{refused:?}"
    );
    // Without the client's look at the owner.
    let by_hand = location.node_builder().unwrap().create::<ipc::Service>();
    println!("{:?}", by_hand.unwrap_err());
    // With a root folder of one's own, and the daemon's names in shared memory.
    let own = tempfile::tempdir().unwrap();
    let mut config = Config::default();
    config.global.prefix = FileName::new(location.file_prefix().as_bytes()).unwrap();
    let path = own.path().as_os_str().as_encoded_bytes();
    config
        .global
        .set_root_path(&iceoryx2::prelude::Path::new(path).unwrap());
    let same_names = NodeBuilder::new().config(&config).create::<ipc::Service>();
    println!("{:?}", same_names.unwrap_err());
    println!(
        "joined nothing as user {}",
        rustix::process::geteuid().as_raw()
    );
}

/// A folder that belongs to the other user.
fn folder_of_stranger(place: &Place, name: &str) -> PathBuf {
    let folder = place.folder().join(name);
    fs::create_dir(&folder).unwrap();
    chown(&folder, Some(NOBODY), Some(NOBODY)).unwrap();
    folder
}

#[test]
fn another_user_has_a_daemon_beside_ours_and_neither_sees_the_other() {
    if !have_a_stranger() {
        return;
    }
    let daemon = Daemon::start(PATIENT);
    let place = daemon.place();
    in_view(place);
    let connection = daemon.connect();
    let before = connection.status(PATIENCE).unwrap();
    let prefix = place.location().prefix();
    let cdcrd = open_to_all(place, &binary("cdcrd"));
    let cdcrctl = open_to_all(place, &binary("cdcrctl"));
    let config = place.folder().join("robot.toml");
    // On our root folder: no.
    let mut command = of_stranger(&cdcrd, prefix, place.location().root());
    let output = Program::start(command.arg("run")).output();
    let words = [
        "belongs to user id 0, not to 65534",
        "choose another with --root",
    ];
    assert_says(&output, EXIT_ROOT, &words);
    // On a root folder of its own: yes, with the same prefix and robot.
    let root = folder_of_stranger(place, "theirs").join("root");
    let mut command = of_stranger(&cdcrd, prefix, &root);
    let mut theirs = Program::start(command.args(["run", "--config"]).arg(config));
    let ask = |words: &[&str]| {
        let output = of_stranger(&cdcrctl, prefix, &root).args(words).output();
        output.unwrap()
    };
    let process = format!("process {},", theirs.id());
    wait_until("the other user's daemon", || {
        text(&ask(&["status"])).contains(&process)
    });
    assert_ne!(before.process_id, theirs.id());
    assert_says(
        &ask(&[
            "obstacle", "add", "--id", "1", "--at", "5,5,5", "--radius", "0.1",
        ]),
        0,
        &[],
    );
    assert_says(&ask(&["stop"]), 0, &["accepted"]);
    let after = wait_status(&connection, |status| status.cycles > before.cycles);
    assert_eq!(after.process_id, before.process_id);
    assert_eq!(standing(&after), standing(&before));
    // And what we do does not reach it.
    let said = text(&place.cdcrctl(&["stop"]));
    assert!(said.contains("accepted"), "{said}");
    assert_says(&ask(&["reset"]), 0, &["accepted"]);
    let status = wait_status(&connection, |status| status.mode == Mode::Stopped.code());
    assert_eq!(status.obstacle_count, 0);
    theirs.signal(Signal::TERM);
    assert_says(&theirs.output(), 0, &[]);
    assert_eq!(left_by_stranger(place), Vec::<PathBuf>::new());
}

/// Runs `cdcrd` to its end, which must come.
fn ended(place: &Place) -> Output {
    Program::start(place.command("cdcrd").arg("run")).output()
}

#[test]
fn a_root_folder_that_another_user_put_there_is_refused() {
    if !have_a_stranger() {
        return;
    }
    let place = Place::new();
    in_view(&place);
    let root = place.location().root();
    let foreign = "belongs to user id 65534, not to 0";
    let remedy = "--root";
    let theirs = folder_of_stranger(&place, "root");
    fs::set_permissions(&theirs, Permissions::from_mode(0o777)).unwrap();
    assert_says(&ended(&place), EXIT_ROOT, &[foreign, remedy]);
    // Ours, but open to all.
    chown(root, Some(0), Some(0)).unwrap();
    assert_says(
        &ended(&place),
        EXIT_ROOT,
        &["mode 0777", "chmod go-w", remedy],
    );
    assert_eq!(fs::metadata(root).unwrap().mode() & 0o777, 0o777);
    assert_eq!(files_below(root), BTreeSet::new());
    // A link of theirs to a folder of ours.
    let ours = place.folder().join("ours");
    fs::rename(root, &ours).unwrap();
    fs::set_permissions(&ours, Permissions::from_mode(0o700)).unwrap();
    symlink(&ours, root).unwrap();
    lchown(root, Some(NOBODY), Some(NOBODY)).unwrap();
    let link = "symbolic link that belongs to user id 65534, not to 0";
    assert_says(&ended(&place), EXIT_ROOT, &[link, remedy]);
    assert_eq!(files_below(&ours), BTreeSet::new());
    // A link of ours to a folder of theirs.
    lchown(root, Some(0), Some(0)).unwrap();
    chown(&ours, Some(NOBODY), Some(NOBODY)).unwrap();
    assert_says(&ended(&place), EXIT_ROOT, &[foreign, remedy]);
    assert_eq!(files_below(&ours), BTreeSet::new());
    assert_eq!(place.shared_memory_files(), Vec::<String>::new());
}

/// Lets the other user make the file `path` with the bytes of `source`.
fn plant(path: &Path, source: &Path, mode: &str) {
    let script = r#"umask 0; cat "$1" > "$0" && chmod "$2" "$0""#;
    let mut command = stranger("/bin/sh");
    command.args(["-c", script]).args([path, source]).arg(mode);
    assert!(command.status().unwrap().success());
}

#[test]
fn a_file_that_another_user_put_into_shared_memory_is_not_used_and_not_waited_for() {
    if !have_a_stranger() {
        return;
    }
    let mut daemon = Daemon::start(PATIENT);
    let location = daemon.place().location().clone();
    in_view(daemon.place());
    let names = shared_memory_files(&location.file_prefix());
    let name = names
        .iter()
        .find(|name| name.ends_with(".global_mgmt"))
        .unwrap();
    let path = Path::new("/dev/shm").join(name);
    let bytes = daemon.place().folder().join("bytes");
    fs::write(&bytes, fs::read(&path).unwrap()).unwrap();
    fs::set_permissions(&bytes, Permissions::from_mode(0o644)).unwrap();
    assert!(daemon.stop().success());
    assert!(!path.exists());
    // Empty, closed, and one that looks exactly as iceoryx2's own.
    for (source, mode) in [
        (Path::new("/dev/null"), "666"),
        (&bytes, "600"),
        (&bytes, "666"),
    ] {
        plant(&path, source, mode);
        let content = fs::read(&path).unwrap();
        let words = [
            path.to_str().unwrap(),
            "belongs to user id 65534",
            "remove it",
        ];
        assert_says(&ended(daemon.place()), EXIT_SHARED_MEMORY, &words);
        // A client that finds no daemon says the same, and does not wait, either.
        let words = [path.to_str().unwrap(), "belongs to user 65534", "remove it"];
        for arguments in [&["status"][..], &["stop"]] {
            let mut client = daemon.place().command("cdcrctl");
            let output = Program::start(client.args(arguments)).output();
            assert_says(&output, 1, &words);
        }
        assert_eq!(fs::read(&path).unwrap(), content);
        assert_eq!(fs::metadata(&path).unwrap().uid(), NOBODY);
        assert_eq!(
            files_below(location.root())
                .iter()
                .filter(|path| path.is_file())
                .count(),
            0
        );
        fs::remove_file(&path).unwrap();
    }
    daemon.restart();
    assert_eq!(
        daemon.connect().status(PATIENCE).unwrap().mode,
        Mode::Holding.code()
    );
}

#[test]
fn no_umask_opens_a_file_to_others() {
    let place = Place::new();
    let location = place.location();
    let without_umask = |program: &str, words: &[&str]| {
        let mut command = Command::new("/bin/sh");
        command
            .args(["-c", r#"umask 0; exec "$0" "$@""#])
            .arg(binary(program))
            .args(words)
            .env("CDCR_ROBOT", ROBOT)
            .env("CDCR_PREFIX", location.prefix())
            .env("CDCR_ROOT", location.root());
        command
    };
    let (_daemon, _connection) = start(&place, &mut without_umask("cdcrd", &["run"]));
    let nodes = || {
        let all = fs::read_dir(location.root().join("nodes")).unwrap();
        all.flatten().filter(|entry| entry.path().is_dir())
    };
    let before = nodes().count();
    let _feeder = Program::start(&mut without_umask(
        "cdcrctl",
        &["ref", "spiral", "--duration", "20s"],
    ));
    let _reader = Program::start(&mut without_umask(
        "cdcrctl",
        &["echo", "telemetry", "--rate", "1"],
    ));
    wait_until("files of all three", || {
        let connections = place.shared_memory_files();
        nodes().count() >= before + 2
            && connections.iter().any(|name| name.ends_with(".connection"))
    });
    for path in everything(&place) {
        // What a client has closed meanwhile is not open to anybody.
        let Ok(file) = fs::symlink_metadata(&path) else {
            continue;
        };
        let open = if file.is_dir() { 0o027 } else { 0o077 };
        assert_eq!(
            file.mode() & open,
            0,
            "{} {:o}",
            path.display(),
            file.mode()
        );
    }
}

#[test]
fn the_working_folder_and_foreign_variables_decide_nothing_and_are_not_logged() {
    let place = Place::new();
    let elsewhere = place.folder().join("elsewhere");
    let config = place.folder().join("config");
    fs::create_dir(&config).unwrap();
    // What iceoryx2 would read from the working folder, if it were asked.
    let hostile = format!(
        "[global]\nroot-path = \"{}\"\nprefix = \"cdcrtest_hostile_\"\n",
        elsewhere.display()
    );
    fs::write(config.join("iceoryx2.toml"), hostile).unwrap();
    let secret = "correct-horse-battery-staple";
    let mut command = place.command("cdcrd");
    command
        .arg("run")
        .current_dir(place.folder())
        .env("RUST_LOG", "trace")
        .env("CDCR_TOKEN", secret)
        .env("DATABASE_PASSWORD", secret);
    let mut daemon = Program::start(&mut command);
    let mut connection = None;
    wait_until("the daemon", || {
        connection = Connection::open(place.location(), ROBOT).ok();
        connection.is_some()
    });
    drop(connection);
    daemon.signal(Signal::TERM);
    let output = daemon.output();
    assert_says(&output, 0, &["running"]);
    assert!(!text(&output).contains(secret), "{}", text(&output));
    assert!(!elsewhere.exists());
    assert_eq!(
        shared_memory_files("cdcrtest_hostile_"),
        Vec::<String>::new()
    );
}
