//! Notifications of `cdcrd run` to the service manager that started it: the real program on a real socket.

use std::fs::DirEntry;
use std::io::{ErrorKind, PipeReader, PipeWriter, Write};
use std::os::unix::net::UnixDatagram;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use cdcr_daemon::exit::ExitCause;
use cdcr_scratch::Scratch;
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};

/// Time limit of every wait. Generous: machines stall.
const TIMEOUT: Duration = Duration::from_secs(30);
/// A stalled machine must not stop the robot.
const PATIENT: &str = "[cycle]\nmiss_limit = 1000000\n";

/// A service manager that started the daemon.
struct Manager {
    daemon: Child,
    socket: UnixDatagram,
    place: Scratch,
}

impl Manager {
    fn start() -> Self {
        Self::start_onto(Stdio::null())
    }

    /// Starts the daemon with this standard error.
    fn start_onto(stderr: impl Into<Stdio>) -> Self {
        let place = Scratch::in_memory().unwrap();
        let path = place.path().join("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_read_timeout(Some(TIMEOUT)).unwrap();
        let daemon = cdcrd(&place)
            .env("NOTIFY_SOCKET", &path)
            .env("WATCHDOG_USEC", "200000")
            .env_remove("WATCHDOG_PID")
            .env("RUST_LOG", "debug")
            .stderr(stderr)
            .spawn()
            .unwrap();
        Self {
            daemon,
            socket,
            place,
        }
    }

    /// All received lines, up to a line that starts with `what`.
    fn hear_until(&self, what: &str) -> Vec<String> {
        let begin = Instant::now();
        let mut heard = Vec::new();
        let mut buffer = [0; 4096];
        while begin.elapsed() < TIMEOUT {
            let length = self.socket.recv(&mut buffer);
            let length = length.unwrap_or_else(|error| panic!("{what}: {error}; heard {heard:?}"));
            let text = String::from_utf8(buffer[..length].to_vec()).unwrap();
            heard.extend(text.lines().map(str::to_owned));
            if heard.iter().any(|line| line.starts_with(what)) {
                return heard;
            }
        }
        panic!("{what} never came; heard {heard:?}")
    }

    /// Waits until a signal has stopped each thread of the daemon.
    fn wait_until_it_stands_still(&self) {
        let begin = Instant::now();
        let folder = format!("/proc/{}/task", self.daemon.id());
        let stands = |thread: std::io::Result<DirEntry>| {
            let stat = std::fs::read_to_string(thread.unwrap().path().join("stat")).unwrap();
            let state = stat.rsplit(')').next().unwrap();
            state.trim_start().starts_with('T')
        };
        while !std::fs::read_dir(&folder).unwrap().all(stands) {
            assert!(begin.elapsed() < TIMEOUT, "it does not stand still");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn end(&mut self) -> ExitStatus {
        kill_process(Pid::from_child(&self.daemon), Signal::TERM).unwrap();
        wait(&mut self.daemon)
    }
}

fn wait(daemon: &mut Child) -> ExitStatus {
    let begin = Instant::now();
    loop {
        if let Some(status) = daemon.try_wait().unwrap() {
            return status;
        }
        if begin.elapsed() > TIMEOUT {
            let _ = daemon.kill();
            panic!("the daemon does not end");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

impl Drop for Manager {
    fn drop(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.daemon.wait();
    }
}

fn cdcrd(place: &Scratch) -> Command {
    let configuration = place.path().join("robot.toml");
    std::fs::write(&configuration, PATIENT).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_cdcrd"));
    command
        .args(["run", "--robot", "cdcr"])
        // In the environment, not as an option, so that a sweep finds it.
        .env("CDCR_PREFIX", place.prefix())
        .arg("--config")
        .arg(configuration)
        .arg("--root")
        .arg(place.path().join("root"))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    command
}

/// A full pipe without a reader.
fn full_pipe() -> (PipeReader, PipeWriter) {
    let (reader, mut writer) = std::io::pipe().unwrap();
    let flags = fcntl_getfl(&writer).unwrap();
    fcntl_setfl(&writer, flags | OFlags::NONBLOCK).unwrap();
    let full = loop {
        if let Err(error) = writer.write(&[b' '; 4096]) {
            break error;
        }
    };
    assert_eq!(full.kind(), ErrorKind::WouldBlock, "{full}");
    fcntl_setfl(&writer, flags).unwrap();
    (reader, writer)
}

fn count(heard: &[String], what: &str) -> usize {
    heard.iter().filter(|line| line.starts_with(what)).count()
}

#[test]
fn a_life_is_told_from_ready_to_stopping() {
    let mut manager = Manager::start();
    let mut heard = manager.hear_until("READY=1");
    heard.extend(manager.hear_until("STATUS="));
    heard.extend(manager.hear_until("WATCHDOG=1"));
    heard.extend(manager.hear_until("WATCHDOG=1"));
    kill_process(Pid::from_child(&manager.daemon), Signal::TERM).unwrap();
    heard.extend(manager.hear_until("STOPPING=1"));
    assert!(manager.end().success());
    assert_eq!(count(&heard, "READY=1"), 1, "{heard:?}");
    let ready = heard.iter().position(|line| line == "READY=1").unwrap();
    let stopping = heard.iter().position(|line| line == "STOPPING=1").unwrap();
    assert!(ready < stopping, "{heard:?}");
    let status = heard
        .iter()
        .find(|line| line.starts_with("STATUS="))
        .unwrap();
    for part in [" Hz, ", " miss", " skipped period"] {
        assert!(status.contains(part), "{status}");
    }
}

#[test]
fn a_daemon_that_stands_still_does_not_feed_the_watchdog() {
    let mut manager = Manager::start();
    manager.hear_until("WATCHDOG=1");
    kill_process(Pid::from_child(&manager.daemon), Signal::STOP).unwrap();
    manager.wait_until_it_stands_still();
    manager.socket.set_nonblocking(true).unwrap();
    // Messages sent before the signal.
    let mut buffer = [0; 4096];
    while manager.socket.recv(&mut buffer).is_ok() {}
    std::thread::sleep(Duration::from_millis(500));
    assert!(manager.socket.recv(&mut buffer).is_err(), "it stands still");
    manager.socket.set_nonblocking(false).unwrap();
    kill_process(Pid::from_child(&manager.daemon), Signal::CONT).unwrap();
    manager.hear_until("WATCHDOG=1");
    assert!(manager.end().success());
}

#[test]
fn a_daemon_that_cannot_start_is_never_ready() {
    let mut manager = Manager::start();
    manager.hear_until("READY=1");
    let path = manager.place.path().join("second");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_nonblocking(true).unwrap();
    // A second daemon for the same robot at the same location.
    let status = cdcrd(&manager.place)
        .env("NOTIFY_SOCKET", &path)
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(69));
    let mut buffer = [0; 4096];
    while let Ok(length) = socket.recv(&mut buffer) {
        let text = String::from_utf8_lossy(&buffer[..length]);
        assert!(!text.contains("READY=1"), "{text}");
    }
    assert!(manager.end().success());
}

#[test]
fn a_log_that_nobody_reads_stops_neither_the_status_nor_the_end() {
    let (_reader, writer) = full_pipe();
    let mut manager = Manager::start_onto(writer);
    manager.hear_until("READY=1");
    for _ in 0..3 {
        manager.hear_until("STATUS=");
        manager.hear_until("WATCHDOG=1");
    }
    assert!(manager.end().success());
}

#[test]
fn a_failure_whose_message_nobody_reads_ends_the_process_with_its_status() {
    let (_reader, writer) = full_pipe();
    let place = Scratch::in_memory().unwrap();
    let mut daemon = cdcrd(&place)
        .args(["--set", "cycle.period_ms=-1"])
        .stderr(writer)
        .spawn()
        .unwrap();
    assert_eq!(wait(&mut daemon).code(), Some(78));
}

#[test]
fn the_unit_leaves_alone_what_a_restart_cannot_mend() {
    let unit = include_str!("../../../packaging/cdcrd.service");
    let line = unit
        .lines()
        .find_map(|line| line.strip_prefix("RestartPreventExitStatus="));
    let named: Vec<u8> = line
        .unwrap()
        .split_whitespace()
        .map(|number| number.parse().unwrap())
        .collect();
    let hopeless = [
        ExitCause::Usage,
        ExitCause::AlreadyRuns,
        ExitCause::Root,
        ExitCause::NotRealtime,
        ExitCause::Configuration,
    ];
    assert_eq!(named, hopeless.map(ExitCause::code));
}

/// Clients find a daemon by its name among the abstract sockets, which also refuses a second daemon if the
/// files are gone.
#[test]
fn the_unit_hides_the_daemons_name_from_nobody_and_leaves_it_no_network() {
    let unit = include_str!("../../../packaging/cdcrd.service");
    assert!(!unit.lines().any(|line| line == "PrivateNetwork=yes"));
    for line in ["RestrictAddressFamilies=AF_UNIX", "IPAddressDeny=any"] {
        assert!(unit.lines().any(|set| set == line), "{line}");
    }
}

#[test]
fn the_unit_starts_a_daemon_again_that_is_killed_fifty_times_in_a_row() {
    let unit = include_str!("../../../packaging/cdcrd.service");
    let value = |key: &str| {
        unit.lines()
            .find_map(|line| line.strip_prefix(key))
            .unwrap()
    };
    let starts: u32 = value("StartLimitBurst=").parse().unwrap();
    assert!(starts > 50, "the first start, and one after each kill");
    assert_eq!(value("RestartSec="), "100ms");
}
