//! Whom the client does not talk to: services of another version, daemons of another user.

use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use cdcr_client::{ConnectError, Connection};
use cdcr_shared_types::{Service, Status};
use cdcr_tests::{Daemon, Place, ROBOT, binary, text};
use iceoryx2::prelude::{Node, ZeroCopySend, ipc};

/// User and group `nobody`.
const NOBODY: u32 = 65_534;

fn node(place: &Place) -> Node<ipc::Service> {
    let builder = place.location().node_builder().unwrap();
    builder.create().unwrap()
}

fn assert_mismatch(place: &Place) {
    let error = Connection::open(place.location(), ROBOT).expect_err("another type");
    assert!(
        matches!(
            error,
            ConnectError::VersionMismatch {
                service: "status",
                ..
            }
        ),
        "{error:?}"
    );
    let output = place.cdcrctl(&["status"]);
    assert_eq!(output.status.code(), Some(1));
    for part in ["another version of the status service", "of one version"] {
        assert!(text(&output).contains(part), "{part}: {}", text(&output));
    }
}

#[test]
fn a_service_of_another_size_is_refused() {
    let place = Place::new();
    let _other = node(&place)
        .service_builder(&Service::Status.name(ROBOT).unwrap())
        .publish_subscribe::<u64>()
        .create()
        .unwrap();
    assert_mismatch(&place);
}

/// The bytes of our status, with another meaning: only the name tells.
#[derive(Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("cdcr.Status.v999")]
struct OtherStatus(Status);

#[test]
fn a_service_of_the_same_size_and_another_version_is_refused_and_not_misread() {
    let place = Place::new();
    let other = node(&place)
        .service_builder(&Service::Status.name(ROBOT).unwrap())
        .publish_subscribe::<OtherStatus>()
        .history_size(1)
        .create()
        .unwrap();
    let publisher = other.publisher_builder().create().unwrap();
    let mut status = OtherStatus(Status::default());
    status.0.header.sent_ns = cdcr_client::monotonic_ns();
    publisher.send_copy(status).unwrap();
    assert_mismatch(&place);
}

#[test]
fn a_service_of_another_pattern_is_refused() {
    let place = Place::new();
    let _other = node(&place)
        .service_builder(&Service::Status.name(ROBOT).unwrap())
        .event()
        .create()
        .unwrap();
    let error = Connection::open(place.location(), ROBOT).expect_err("another pattern");
    assert!(
        matches!(
            error,
            ConnectError::VersionMismatch { .. } | ConnectError::DaemonNotRunning { .. }
        ),
        "{error:?}"
    );
}

/// `cdcrctl status` as user `nobody`: its words, or why the system does not let us.
fn status_as_nobody(place: &Place, program: &Path) -> Result<String, String> {
    let output = Command::new(program)
        .args(["status", "--robot", ROBOT])
        .args(["--prefix", place.location().prefix(), "--root"])
        .arg(place.location().root())
        .current_dir("/")
        .uid(NOBODY)
        .gid(NOBODY)
        .output()
        .map_err(|error| format!("cannot run a program as user {NOBODY}: {error}"))?;
    assert_eq!(output.status.code(), Some(1), "{}", text(&output));
    Ok(text(&output))
}

/// A copy of `cdcrctl` that any user may run: the build may lie in a folder that is closed to others.
fn open_to_all(place: &Place) -> PathBuf {
    let program = place.folder().join("cdcrctl");
    fs::copy(binary("cdcrctl"), &program).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    fs::set_permissions(place.folder(), fs::Permissions::from_mode(0o755)).unwrap();
    program
}

#[test]
fn a_second_user_is_told_whose_the_daemon_is() {
    if !rustix::process::geteuid().is_root() {
        eprintln!("skipped: only root can start a program as another user");
        return;
    }
    let daemon = Daemon::start("");
    let place = daemon.place();
    let program = open_to_all(place);
    match status_as_nobody(place, &program) {
        Ok(message) => {
            for part in [
                place.location().root().to_str().unwrap(),
                "belongs to user 0, this program runs as user 65534",
                "sudo -u '#0' cdcrctl",
            ] {
                assert!(message.contains(part), "{part}: {message}");
            }
            let names = place.shared_memory_files();
            let owners = names
                .iter()
                .filter_map(|name| fs::metadata(format!("/dev/shm/{name}")).ok());
            assert!(
                owners.into_iter().all(|file| file.uid() != NOBODY),
                "nobody left a file"
            );
        }
        Err(cause) => eprintln!("skipped: {cause}"),
    }
    // A root that cannot even be seen.
    let closed = Place::new();
    fs::create_dir(closed.location().root()).unwrap();
    fs::set_permissions(closed.folder(), fs::Permissions::from_mode(0o700)).unwrap();
    match status_as_nobody(&closed, &program) {
        Ok(message) => assert!(message.contains("permission denied"), "{message}"),
        Err(cause) => eprintln!("skipped: {cause}"),
    }
}

#[test]
fn a_root_that_belongs_to_root_is_not_for_a_normal_user() {
    let user = rustix::process::geteuid();
    if user.is_root() {
        eprintln!(
            "skipped: root may use every folder; see a_second_user_is_told_whose_the_daemon_is"
        );
        return;
    }
    let output = Place::new().cdcrctl(&["status", "--root", "/usr"]);
    let expected = format!(
        "/usr belongs to user 0, this program runs as user {}",
        user.as_raw()
    );
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output).contains(&expected), "{}", text(&output));
}
