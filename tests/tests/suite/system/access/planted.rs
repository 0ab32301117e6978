//! Obstructions by another user: folders, files, masks, variables.

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, lchown, symlink};
use std::os::unix::net::{SocketAddr, UnixListener};
use std::path::PathBuf;
use std::process::Command;

use cdcr_client::Connection;
use cdcr_shared_types::codes::Mode;
use cdcr_shared_types::{Location, NameHolder};
use cdcr_tests::{
    Daemon, Place, Program, ROBOT, STALL_TOLERANT, TIMEOUT, assert_output, binary,
    in_public_memory, text, wait_status, wait_until,
};
use rustix::process::{Signal, Uid};
use rustix::thread::set_thread_res_uid;

use super::stranger::{
    EXIT_ROOT, NOBODY, attempts, everything, folder_of_stranger, have_a_stranger, in_view,
    paths_below, start, stranger,
};

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
    folder_of_stranger(root);
    fs::set_permissions(root, Permissions::from_mode(0o777)).unwrap();
    place.checked("cdcrd run", EXIT_ROOT, &[foreign, remedy]);
    // Owned by this user, but open to all.
    chown(root, Some(0), Some(0)).unwrap();
    place.checked(
        "cdcrd run",
        EXIT_ROOT,
        &["mode 0777", "chmod go-rwx", remedy],
    );
    assert_eq!(fs::metadata(root).unwrap().mode() & 0o777, 0o777);
    let words = "every user can write to the root path";
    place.checked("cdcrctl status", 1, &[words]);
    assert_eq!(paths_below(root), BTreeSet::new());
    // A link of the other user to a folder of this user.
    let ours = root.with_file_name(format!("{}ours", place.location().prefix()));
    fs::rename(root, &ours).unwrap();
    fs::set_permissions(&ours, Permissions::from_mode(0o700)).unwrap();
    symlink(&ours, root).unwrap();
    lchown(root, Some(NOBODY), Some(NOBODY)).unwrap();
    let link = "symbolic link that belongs to user id 65534, not to 0";
    place.checked("cdcrd run", EXIT_ROOT, &[link, remedy]);
    assert_eq!(paths_below(&ours), BTreeSet::new());
    // A link of this user to a folder of the other user.
    lchown(root, Some(0), Some(0)).unwrap();
    chown(&ours, Some(NOBODY), Some(NOBODY)).unwrap();
    place.checked("cdcrd run", EXIT_ROOT, &[foreign, remedy]);
    assert_eq!(paths_below(&ours), BTreeSet::new());
    fs::remove_file(root).unwrap();
    fs::remove_dir(&ours).unwrap();
}

/// Runs a script as the other user, with these arguments, in the public shared-memory folder.
fn as_stranger(script: &str, arguments: &[String]) {
    let mut command = stranger("/bin/sh");
    command.current_dir(Location::MEMORY).args(["-c", script]);
    let output = command.arg("attack").args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", text(&output));
}

/// Checks that the daemon works without disturbance: it publishes, accepts clients that read and feed, and
/// stops on request.
fn assert_serves(daemon: &Daemon) {
    let connection = daemon.connect();
    let before = connection.status(TIMEOUT).unwrap();
    assert_eq!(before.process_id, daemon.id());
    let mut telemetry = connection.telemetry().unwrap();
    assert!(telemetry.next_within(TIMEOUT).unwrap().is_some());
    connection.obstacle_sender().unwrap().clear().unwrap();
    wait_status(&connection, |status| status.cycles > before.cycles);
    for (request, mode) in [
        ("cdcrctl stop", Mode::Stopped),
        ("cdcrctl reset", Mode::Holding),
    ] {
        daemon.place().checked(request, 0, &["accepted"]);
        wait_status(&connection, |status| status.mode == mode.code());
    }
}

/// The first eight bytes of a connection, in which iceoryx2 stores its version, in the format of `printf`.
fn version_of_connection(place: &Place) -> String {
    let is_connection = |path: &PathBuf| path.extension().is_some_and(|end| end == "connection");
    let connection = place.memory_files().into_iter().find(is_connection);
    let bytes = fs::read(connection.expect("a client is connected")).unwrap();
    let version: [u8; 8] = bytes[..8].try_into().unwrap();
    assert_ne!(version, [0; 8]);
    version.map(|byte| format!("\\{byte:03o}")).concat()
}

/// Attacks on a daemon that had its memory in `/dev/shm` under public names. The daemon died of a file that
/// it mapped (SIGBUS), clients waited for ever for an empty one, and the supervisor had too many files to
/// check. One kept every client and every start away.
#[test]
fn what_another_user_puts_into_public_memory_is_nobodys_concern() {
    if !have_a_stranger() {
        return;
    }
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let _client = daemon.connect();
    let prefix = daemon.place().location().file_prefix();
    // The names used by the daemon and its clients, and the one of iceoryx2's management.
    let mut names: Vec<_> = daemon
        .place()
        .memory_files()
        .iter()
        .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        .collect();
    names.push(format!("{prefix}node.0_10_0.global_mgmt"));
    assert!(names.len() > 10, "{names:?}");
    // A client would accept a planted connection by its version, map it, and die when it became shorter.
    let write = format!(
        r#"for name; do {{ printf '{}'; head -c 100000 /dev/zero; }} > "$name" && chmod 666 "$name"; done"#,
        version_of_connection(daemon.place())
    );
    let shorten = r#"for name; do truncate -s 0 "$name"; done"#;
    let attacks: [(&str, &str, &[String]); 5] = [
        ("files that look like connections", &write, &names),
        (
            "and get shorter while they could be mapped",
            shorten,
            &names,
        ),
        (
            "empty files",
            r#"umask 0; for name; do : > "$name"; done"#,
            &names,
        ),
        (
            "files that nobody may open",
            r#"umask 777; for name; do : > "$name"; done"#,
            &names,
        ),
        (
            "40 000 empty files",
            r#"seq -f "$1%.0f.connection" 40000 | xargs touch"#,
            std::slice::from_ref(&prefix),
        ),
    ];
    for (what, script, arguments) in attacks {
        println!("{what}");
        as_stranger(script, arguments);
        assert_serves(&daemon);
        // Neither its end nor its next start is affected, whether it is killed or asked to end.
        daemon.kill();
        daemon.restart();
        assert!(daemon.stop().success(), "{what}: {}", daemon.log());
        daemon.restart();
        assert_serves(&daemon);
        let planted = in_public_memory(&prefix);
        assert!(planted.len() >= arguments.len(), "{what}: {planted:?}");
        if script == write {
            continue;
        }
        for path in planted {
            assert_eq!(fs::metadata(&path).unwrap().uid(), NOBODY, "{what}");
            fs::remove_file(path).unwrap();
        }
    }
    assert!(daemon.stop().success(), "{}", daemon.log());
}

#[test]
fn a_file_in_the_place_of_the_root_folder_keeps_the_daemon_out_with_words() {
    if !have_a_stranger() {
        return;
    }
    let place = Place::new();
    let root = place.location().root();
    as_stranger(r#": > "$1""#, &[root.to_str().unwrap().to_owned()]);
    place.checked("cdcrd run", EXIT_ROOT, &[root.to_str().unwrap(), "--root"]);
    assert_eq!(fs::metadata(root).unwrap().uid(), NOBODY);
    fs::remove_file(root).unwrap();
}

/// An abstract socket of this name that belongs to the other user.
fn listen_as_stranger(name: String) -> UnixListener {
    let listen = move || {
        let nobody = Uid::from_raw(NOBODY);
        // For this thread only.
        set_thread_res_uid(nobody, nobody, nobody).unwrap();
        UnixListener::bind_addr(&SocketAddr::from_abstract_name(name).unwrap()).unwrap()
    };
    std::thread::spawn(listen).join().unwrap()
}

#[test]
fn a_name_that_another_user_has_taken_keeps_neither_the_daemon_nor_a_stop_out() {
    if !have_a_stranger() {
        return;
    }
    let mut daemon = Daemon::start(STALL_TOLERANT);
    assert!(daemon.stop().success(), "{}", daemon.log());
    let location = daemon.place().location().clone();
    let _taken = listen_as_stranger(location.daemon_name(ROBOT));
    assert_eq!(location.name_holder(ROBOT), NameHolder::Foreign);
    daemon.restart();
    assert!(daemon.log().contains("another user holds the socket name"));
    daemon
        .place()
        .checked("cdcrd run", 69, &["already running"]);
    daemon.place().checked("cdcrctl stop", 0, &[]);
    assert!(daemon.stop().success(), "{}", daemon.log());
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
        let connections = place.memory_files();
        nodes().count() >= before + 2
            && connections
                .iter()
                .any(|path| path.extension().is_some_and(|end| end == "connection"))
    });
    // It is on the path to every file.
    let mode = fs::metadata(location.root()).unwrap().mode();
    assert_eq!(mode & 0o7777, 0o700, "{mode:o}");
    if have_a_stranger() {
        assert_eq!(attempts(&everything(&place), NOBODY), Vec::<String>::new());
    }
}

#[test]
fn the_working_folder_and_foreign_variables_decide_nothing_and_are_not_logged() {
    let place = Place::new();
    let elsewhere = place.folder().join("elsewhere");
    let config = place.folder().join("config");
    fs::create_dir(&config).unwrap();
    // Contents that iceoryx2 would read from the working folder by default.
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
    assert_output(&output, 0, &[]);
    let log = text(&output);
    assert!(log.contains("running") && !log.contains(secret), "{log}");
    assert!(!elsewhere.exists());
    assert_eq!(in_public_memory("cdcrtest_hostile_"), Vec::<PathBuf>::new());
}
