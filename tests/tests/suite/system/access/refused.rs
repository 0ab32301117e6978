//! Requests, reads, messages and signals of another user are rejected without an effect.

use std::collections::BTreeSet;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use cdcr_client::Connection;
use cdcr_shared_types::codes::{Mode, Outcome};
use cdcr_shared_types::{Location, Status};
use cdcr_test_skip::{Need, skip};
use cdcr_tests::{
    Daemon, Place, Program, ROBOT, STALL_TOLERANT, TIMEOUT, assert_output, binary, text,
    wait_status, wait_until,
};
use rustix::process::Signal;

use super::stranger::{
    EXIT_ROOT, NOBODY, attempts, busy_daemon, everything, folder_of_stranger, have_a_stranger,
    in_view, left_by_stranger, of_stranger, open_to_all, stranger,
};
use crate::own_mounts::{has_own_mounts, mount, name_of};

/// All requests of `cdcrctl` to a daemon. PATH stands for a file that the other user can read.
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

/// The state that the other user must not be able to change.
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
    let _lease = connection.acquire_lease_within(TIMEOUT).unwrap();
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
        assert_output(
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
fn a_root_that_belongs_to_root_is_not_for_a_normal_user() {
    let place = &Place::new();
    let ours = rustix::process::geteuid();
    let (user, mut cdcrctl) = if ours.is_root() {
        if !have_a_stranger() {
            return;
        }
        in_view(place);
        (NOBODY, stranger(open_to_all(place, &binary("cdcrctl"))))
    } else {
        (ours.as_raw(), place.command("cdcrctl"))
    };
    let output = cdcrctl.args(["status", "--root", "/usr"]).output().unwrap();
    let refusal = format!("/usr belongs to user 0, this program runs as user {user}");
    assert_output(&output, 1, &[&refusal]);
}

#[test]
fn a_root_folder_that_the_other_user_cannot_even_see_is_reported_to_be_closed() {
    if !have_a_stranger() {
        return;
    }
    let place = Place::new();
    let closed = place.location().root();
    let root = &closed.join("root");
    fs::create_dir_all(root).unwrap();
    fs::set_permissions(closed, Permissions::from_mode(0o700)).unwrap();
    in_view(&place);
    let [cdcrctl, cdcrd] = ["cdcrctl", "cdcrd"].map(|name| open_to_all(&place, &binary(name)));
    let command = |program| of_stranger(program, place.location().prefix(), root);
    let output = command(&cdcrctl).arg("status").output().unwrap();
    let words = [root.to_str().unwrap(), "permission denied"];
    assert_output(&output, 1, &words);
    let output = Program::start(command(&cdcrd).arg("run")).output();
    assert_output(&output, EXIT_ROOT, &["Permission denied", "--root"]);
}

#[test]
fn another_user_may_run_the_demo_beside_the_daemon() {
    if !have_a_stranger() {
        return;
    }
    let daemon = Daemon::start(STALL_TOLERANT);
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
    assert_output(&output, 0, &["1 section"]);
    let after = wait_status(&connection, |status| status.cycles > before.cycles);
    assert_eq!(standing(&after), standing(&before));
    assert_eq!(left_by_stranger(place), Vec::<PathBuf>::new());
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
    for part in ["services", "nodes", ".data", ".connection", ".lock"] {
        let is_it = |path: &PathBuf| path.to_string_lossy().ends_with(part);
        assert!(files.iter().any(is_it), "{part}");
    }
    assert_eq!(attempts(&files, NOBODY), Vec::<String>::new());
    let root = place.location().root();
    let group = fs::metadata(root).unwrap().gid();
    assert_eq!(attempts(&files, group), Vec::<String>::new());
    // The root folder was opened for all to read: the daemon closes it again.
    fs::set_permissions(root, Permissions::from_mode(0o755)).unwrap();
    wait_until("it is closed", || {
        fs::metadata(root).unwrap().mode() & 0o777 == 0o700
    });
    assert_eq!(attempts(&files, NOBODY), Vec::<String>::new());
    assert_eq!(everything(place), files);
    // The attempts succeed where they are permitted.
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
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let id = connection.status(TIMEOUT).unwrap().process_id;
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
    let cycles = connection.status(TIMEOUT).unwrap().cycles;
    wait_status(&connection, |status| status.cycles > cycles);
}

#[test]
fn iceoryx2_by_hand_is_refused_to_another_user() {
    if !have_a_stranger() {
        return;
    }
    let place = &Place::new();
    let _busy = busy_daemon(place);
    let program = open_to_all(place, &binary("cdcr-test-stranger"));
    let output = stranger(&program)
        .arg(place.location().prefix())
        .arg(place.location().root())
        .output()
        .unwrap();
    assert_output(&output, 0, &["joined nothing as user 65534"]);
    assert_eq!(left_by_stranger(place), Vec::<PathBuf>::new());
}

#[test]
fn another_user_has_a_daemon_beside_ours_and_neither_sees_the_other() {
    if !have_a_stranger() {
        return;
    }
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    in_view(place);
    let connection = daemon.connect();
    let before = connection.status(TIMEOUT).unwrap();
    let prefix = place.location().prefix();
    let cdcrd = open_to_all(place, &binary("cdcrd"));
    let cdcrctl = open_to_all(place, &binary("cdcrctl"));
    let config = place.folder().join("robot.toml");
    // On this user's root folder: no.
    let mut command = of_stranger(&cdcrd, prefix, place.location().root());
    let output = Program::start(command.arg("run")).output();
    let words = [
        "belongs to user id 0, not to 65534",
        "use another one with --root",
    ];
    assert_output(&output, EXIT_ROOT, &words);
    // On a root folder of its own: yes, with the same prefix and robot.
    let root = Path::new(Location::MEMORY).join(format!("{prefix}theirs"));
    folder_of_stranger(&root);
    fs::set_permissions(&root, Permissions::from_mode(0o700)).unwrap();
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
    assert_output(
        &ask(&[
            "obstacle", "add", "--id", "1", "--at", "5,5,5", "--radius", "0.1",
        ]),
        0,
        &[],
    );
    assert_output(&ask(&["stop"]), 0, &["accepted"]);
    let after = wait_status(&connection, |status| status.cycles > before.cycles);
    assert_eq!(after.process_id, before.process_id);
    assert_eq!(standing(&after), standing(&before));
    // This user's requests do not reach it.
    place.checked("cdcrctl stop", 0, &["accepted"]);
    assert_output(&ask(&["reset"]), 0, &["accepted"]);
    let status = wait_status(&connection, |status| status.mode == Mode::Stopped.code());
    assert_eq!(status.obstacle_count, 0);
    theirs.signal(Signal::TERM);
    assert_output(&theirs.output(), 0, &[]);
    assert_eq!(left_by_stranger(place), Vec::<PathBuf>::new());
    fs::remove_dir_all(&root).unwrap();
}

/// As in a container or a unit with `ReadOnlyPaths` only.
#[test]
fn a_root_folder_that_is_mounted_read_only_is_reported_to_be_so() {
    let test = &name_of(&a_root_folder_that_is_mounted_read_only_is_reported_to_be_so);
    if !has_own_mounts(test) {
        return;
    }
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let root = daemon.place().location().root().display().to_string();
    let bind = format!("mount --bind '{root}' '{root}' && mount -o remount,ro,bind '{root}'");
    if !mount(&bind) {
        return;
    }
    let remedy = format!("ReadWritePaths={root}");
    for request in ["status", "track"] {
        let line = format!("cdcrctl {request}");
        daemon.place().checked(&line, 1, &["read-only", &remedy]);
    }
    // A stop is sent by the signal.
    let words = ["not confirmed", "read-only"];
    daemon.place().checked("cdcrctl stop", 1, &words);
    assert!(mount(&format!("umount '{root}'")));
    // The next cycle takes the signal, and the next status shows it.
    wait_until("stopped", || {
        text(&daemon.place().cdcrctl(&["status"])).contains("stopped")
    });
    assert!(daemon.stop().success(), "{}", daemon.log());
}

/// Every message would be stamped in the future, and every status be old.
#[test]
fn a_client_in_another_time_namespace_gets_an_error_and_can_stop_the_robot() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let client = |line: &str| {
        let mut command = daemon.place().command_of(Path::new("unshare"));
        if !rustix::process::geteuid().is_root() {
            command.arg("--map-root-user");
        }
        command.args(["--time", "--monotonic", "1000", "--"]);
        command
            .arg(binary("cdcrctl"))
            .args(line.split(' '))
            .output()
    };
    match client("--version") {
        Ok(output) if output.status.success() => {}
        no => {
            return skip(
                Need::UtilLinux,
                format!("no time namespace of its own: {no:?}"),
            );
        }
    }
    // The kernel shows the daemon's clock to root alone: others get the error of a silent daemon or of a wrong time.
    let reported: &[&str] = if rustix::process::geteuid().is_root() {
        &[
            "another time namespace",
            "differs by -1000 s",
            "cdcrctl stop",
        ]
    } else {
        &[]
    };
    for line in ["status", "hold", "ref line --track", "plant"] {
        let output = client(line).unwrap();
        assert_output(&output, 1, reported);
        let is_named = [
            "another time namespace",
            "has sent no status",
            "a time is in the future",
            "in the past",
        ];
        assert!(
            is_named.iter().any(|words| text(&output).contains(words)),
            "{}",
            text(&output)
        );
    }
    assert_output(&client("stop").unwrap(), 0, &["the daemon is stopped"]);
}
