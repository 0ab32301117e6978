//! What another user put in our way: folders, files, masks, variables.

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown, lchown, symlink};
use std::path::Path;
use std::process::{Command, Output};

use cdcr_client::Connection;
use cdcr_shared_types::codes::Mode;
use cdcr_tests::{
    Daemon, PATIENCE, PATIENT, Place, Program, ROBOT, binary, shared_memory_files, text, wait_until,
};
use rustix::process::Signal;

use super::stranger::{
    EXIT_ROOT, EXIT_SHARED_MEMORY, NOBODY, assert_says, everything, files_below,
    folder_of_stranger, have_a_stranger, in_view, start, stranger,
};

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
