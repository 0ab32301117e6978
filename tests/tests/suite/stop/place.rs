//! The files by which clients find a daemon are deleted while it runs. The daemon creates them again or ends,
//! no second one starts beside it, and no stop is falsely reported as a success.

use std::fs;
use std::io::ErrorKind;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use cdcr_client::{Connection, LinkError, Liveness, RequestError};
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_shared_types::{Location, NameHolder};
use cdcr_test_skip::{Need, skip};
use cdcr_tests::{
    Daemon, Program, ROBOT, STALL_TOLERANT, TIMEOUT, ask_for, assert_output, text, wait_mode,
    wait_until,
};
use rustix::fs::{FlockOperation, flock};
use rustix::process::{Signal, geteuid};

use crate::faults::trail::{Trail, assert_ramps_to_rest, is, rests};

/// Checks that a second daemon at the same place is rejected with a message that names the first.
fn assert_second_is_refused(daemon: &Daemon) {
    let process = format!("process {}", daemon.id());
    daemon.place().checked("cdcrd run", 69, &[&process]);
}

#[test]
fn a_deleted_lock_file_is_made_again_and_lets_no_second_daemon_in() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let lock = daemon.place().location().lock_file(ROBOT);
    for _ in 0..2 {
        fs::remove_file(&lock).unwrap();
        assert_second_is_refused(&daemon);
        wait_until("it is made again", || {
            let text = fs::read_to_string(&lock).unwrap_or_default();
            text.trim() == daemon.id().to_string()
        });
        assert_second_is_refused(&daemon);
    }
    daemon.place().checked("cdcrctl stop", 0, &[]);
    wait_mode(&mut telemetry, Mode::Stopped);
    assert!(daemon.stop().success(), "{}", daemon.log());
    assert!(!lock.exists(), "the end removes it");
}

/// Checks that a second daemon does not start while the first runs.
fn assert_none_starts_beside(daemon: &mut Daemon) {
    let mut second = daemon.place().start("cdcrd run");
    wait_until("one of them ends", || !second.runs() || !daemon.runs());
    if daemon.runs() {
        let output = second.output();
        assert_eq!(output.status.code(), Some(69), "{}", text(&output));
    } else if second.runs() {
        // The machine stalled for so long that the first had ended.
        second.signal(Signal::TERM);
        second.output();
    }
}

/// Homes the robot slowly, signals when it moves, and follows it to rest: it stops only by its ramp.
fn follow_to_rest(location: &Location, moves: &Sender<()>) {
    let connection = Connection::open_within(location, ROBOT, TIMEOUT).unwrap();
    let mut trail = Trail::new(&connection);
    ask_for(&connection, RequestKind::Home);
    trail.until("moving", |record| !rests(record));
    moves.send(()).unwrap();
    let (before, stopped) = trail.until("stopped", is(Mode::Stopped));
    assert_eq!(before.mode, Mode::Homing.code());
    assert_ramps_to_rest(&mut trail, &stopped, || {});
}

/// Calls `delete` while the robot moves. Then it comes to rest, the daemon ends with its own status, and no
/// other daemon took its place meanwhile.
fn assert_ends_without_its_place(delete: impl FnOnce(&Path)) {
    let mut daemon = Daemon::start(&format!(
        "{STALL_TOLERANT}[link]\ninitial_bend_rad = [[0.8, 0.0], [0.0, 0.0], [0.0, 0.0]]\n[motion]\nhome_rate_rad_s = 0.05\n"
    ));
    let location = daemon.place().location().clone();
    std::thread::scope(|scope| {
        let (moves, moving) = channel();
        let location = &location;
        scope.spawn(move || follow_to_rest(location, &moves));
        moving.recv().unwrap();
        delete(location.root());
        assert_stop_is_not_confirmed(&mut daemon);
    });
    let ended = daemon.stop_after_signal();
    assert_eq!(ended.code(), Some(83), "{}", daemon.log());
    assert!(daemon.log().contains("was emptied or replaced"));
    // It left nothing, and its place is free.
    daemon.restart();
    daemon.place().checked("cdcrctl stop", 0, &[]);
    assert!(daemon.stop().success(), "{}", daemon.log());
    let left = daemon.place().memory_files();
    assert_eq!(left, Vec::<PathBuf>::new());
}

/// Checks that neither a second daemon nor a stop takes a daemon without its files for an ended one.
fn assert_stop_is_not_confirmed(daemon: &mut Daemon) {
    assert_none_starts_beside(daemon);
    let output = daemon.place().cdcrctl(&["stop"]);
    let printed = text(&output);
    // On a stalled machine the daemon may have ended meanwhile.
    assert!(!output.status.success(), "{printed}");
    assert!(
        printed.contains("not confirmed") || !daemon.runs(),
        "a stop that is not true: {printed}"
    );
    if daemon.runs() && printed.contains("not confirmed") {
        assert!(
            printed.contains(&format!("process {}", daemon.id())),
            "{printed}"
        );
    }
}

pub(super) fn empty(folder: &Path) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        let removed = if path.is_dir() {
            fs::remove_dir_all(path)
        } else {
            fs::remove_file(path)
        };
        // Files that vanish meanwhile are gone, too.
        assert!(removed.is_ok() || removed.is_err_and(|error| error.kind() == ErrorKind::NotFound));
    }
}

#[test]
fn an_emptied_root_folder_ends_the_daemon_at_rest() {
    assert_ends_without_its_place(empty);
}

#[test]
fn a_replaced_root_folder_ends_the_daemon_at_rest() {
    assert_ends_without_its_place(|root| {
        fs::rename(root, root.with_extension("away")).unwrap();
        fs::create_dir(root).unwrap();
    });
}

#[test]
fn a_program_that_was_connected_to_an_emptied_root_folder_is_told_to_connect_again() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let obstacles = connection.obstacle_sender().unwrap();
    // A daemon that was killed is followed by the next one.
    daemon.kill();
    daemon.restart();
    connection.status(TIMEOUT).unwrap();
    ask_for(&connection, RequestKind::Hold);
    daemon.kill();
    empty(daemon.place().location().root());
    daemon.restart();
    assert!(daemon.connect().status(TIMEOUT).is_ok());
    wait_until("it is silent, and why", || {
        let status = connection.status(Duration::ZERO);
        let cause = status.map(|_| ()).map_err(|error| match error {
            LinkError::Silent { liveness, .. } => liveness,
            error => panic!("{error}"),
        });
        cause == Err(Liveness::Replaced)
    });
    let asked = connection.request_within(RequestKind::Hold, Duration::from_millis(10));
    let is_told = |liveness: Liveness| liveness.to_string().contains("connect again");
    assert!(
        matches!(&asked, Err(RequestError::Timeout { liveness, .. }) if is_told(*liveness)),
        "{asked:?}"
    );
    wait_until("nobody receives, and why", || {
        matches!(obstacles.clear(), Err(LinkError::Replaced { .. }))
    });
    let error = obstacles.clear().expect_err("for ever").to_string();
    assert!(error.contains("Connect again"), "{error}");
}

#[test]
fn programs_that_delete_old_files_leave_the_root_folder_alone() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let root = fs::File::open(daemon.place().location().root()).unwrap();
    // systemd-tmpfiles locks a folder before it enters it, and skips a locked one.
    wait_until("the folder is locked", || {
        let locked = flock(&root, FlockOperation::NonBlockingLockExclusive);
        if locked.is_ok() {
            flock(&root, FlockOperation::Unlock).unwrap();
        }
        locked.is_err()
    });
}

/// Queries the owner of the daemon's name without end, so that other clients get no answer.
struct Flood {
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Flood {
    fn start(daemon: &Daemon) -> Self {
        let name = daemon.place().location().daemon_name(ROBOT);
        let address = SocketAddr::from_abstract_name(name).unwrap();
        let is_over = Arc::new(AtomicBool::new(false));
        let ask = |(address, seen): (SocketAddr, Arc<AtomicBool>)| {
            while !seen.load(Ordering::Relaxed) {
                // Waits until there is space in the queue, and fills it again. An ending daemon refuses the
                // connection.
                let _ = UnixStream::connect_addr(&address);
            }
        };
        let threads = (0..4).map(|_| (address.clone(), Arc::clone(&is_over)));
        let threads = threads.map(|what| std::thread::spawn(move || ask(what)));
        Self {
            threads: threads.collect(),
            is_over,
        }
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

#[test]
fn a_second_daemon_that_finds_neither_lock_nor_name_is_refused_by_the_services() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let location = daemon.place().location().clone();
    let flood = Flood::start(&daemon);
    wait_until("nobody is answered", || {
        location.name_holder(ROBOT) == NameHolder::Foreign
    });
    fs::remove_file(location.lock_file(ROBOT)).unwrap();
    let mut second = daemon.place().command("cdcrd");
    let second = second
        .arg("run")
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let mut second = second.spawn().unwrap();
    // If the machine stalls for a second, the first saw the other's lock file and came to rest before the
    // other took its place.
    let mut is_over = || second.try_wait().unwrap().is_some();
    wait_until("one of them ended", || is_over() || !daemon.runs());
    let _ = second.kill();
    let output = second.wait_with_output().unwrap();
    if let Some(status) = output.status.code() {
        let printed = text(&output);
        assert_eq!(status, 69, "{printed}");
        // If the machine stalls, the first has created its lock file again.
        let words = ["writes to the service", "already running"];
        assert!(
            words.iter().any(|words| printed.contains(words)),
            "{printed}"
        );
    }
    drop(flood);
    assert_repairs_its_place_or_has_ended(&mut daemon);
}

/// Checks that two daemons never ran at a time: the first has its lock file again, or saw the other's and
/// came to rest.
fn assert_repairs_its_place_or_has_ended(daemon: &mut Daemon) {
    let lock = daemon.place().location().lock_file(ROBOT);
    wait_until("it has repaired its place, or ended", || {
        !daemon.runs() || lock.exists()
    });
    if daemon.runs() {
        assert!(daemon.stop().success(), "{}", daemon.log());
    } else {
        assert_eq!(daemon.stop_after_signal().code(), Some(83));
    }
}

/// Starts a second daemon at the same place in a private network, where the name is free. `None`, with a
/// message, if the system does not permit it.
fn second_in_its_own_network(daemon: &mut Daemon) -> Option<Output> {
    let inner = daemon.place().command("cdcrd");
    let mut command = Command::new("unshare");
    if !geteuid().is_root() {
        command.arg("--map-root-user");
    }
    command.arg("--net").arg(inner.get_program()).arg("run");
    for (key, value) in inner.get_envs() {
        match value {
            Some(value) => command.env(key, value),
            None => command.env_remove(key),
        };
    }
    let mut second = Program::start(&mut command);
    wait_until("one of them ends", || !second.runs() || !daemon.runs());
    if second.runs() {
        second.signal(Signal::TERM);
    }
    let output = second.output();
    let printed = text(&output);
    if output.status.code() == Some(1) && printed.contains("unshare") {
        skip(Need::Mount, format!("no network of its own: {printed}"));
        return None;
    }
    Some(output)
}

#[test]
fn a_second_daemon_in_another_network_is_refused_with_and_without_a_lock_file() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    let Some(second) = second_in_its_own_network(&mut daemon) else {
        return;
    };
    assert_output(&second, 69, &["already running"]);
    assert!(daemon.runs(), "{}", daemon.log());
    fs::remove_file(daemon.place().location().lock_file(ROBOT)).unwrap();
    if let Some(second) = second_in_its_own_network(&mut daemon) {
        // If the machine stalls, the first saw the other's lock file and came to rest: then its place is
        // free.
        let printed = text(&second);
        assert!(
            second.status.code() == Some(69) || !daemon.runs(),
            "{printed}"
        );
    }
    assert_repairs_its_place_or_has_ended(&mut daemon);
}
