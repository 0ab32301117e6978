//! `cdcrctl top`, `scope` and a feed in a terminal, with the keys that people press.

use std::fs::File;
use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::process::Stdio;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_tests::{
    Daemon, Running, STALL_TOLERANT, TIMEOUT, ask_for, wait_record, wait_status, wait_until,
};
use rustix::fs::OFlags;
use rustix::process::Signal;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize};

const NOCTTY: i32 = OFlags::NOCTTY.bits().cast_signed();

/// A terminal, and the file for its keys.
struct Terminal {
    keys: File,
    /// Its screen; `None` after it is closed.
    shown: Arc<Mutex<Option<vt100::Parser>>>,
    reader: JoinHandle<()>,
}

impl Terminal {
    /// Returns the terminal and the program's side.
    fn new(columns: u16, rows: u16) -> (Self, File) {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&ours).unwrap();
        unlockpt(&ours).unwrap();
        let name = ptsname(&ours, Vec::new()).unwrap();
        let mut options = std::fs::OpenOptions::new();
        // A test program that leads a session would get it as its controlling terminal, and SIGHUP when it is
        // closed.
        let theirs = options.read(true).write(true).custom_flags(NOCTTY);
        let theirs = theirs.open(name.to_str().unwrap()).unwrap();
        let size = Winsize {
            ws_row: rows,
            ws_col: columns,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        tcsetwinsize(&ours, size).unwrap();
        let keys = File::from(ours);
        let shown = Arc::new(Mutex::new(Some(vt100::Parser::new(rows, columns, 0))));
        let (mut screen, heard) = (keys.try_clone().unwrap(), Arc::clone(&shown));
        let reader = std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            loop {
                match screen.read(&mut bytes) {
                    Ok(count) if count > 0 => match &mut *heard.lock().unwrap() {
                        Some(shown) => shown.process(&bytes[..count]),
                        None => return,
                    },
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    // The last program with the terminal has ended.
                    _ => return,
                }
            }
        });
        let terminal = Self {
            keys,
            shown,
            reader,
        };
        (terminal, theirs)
    }

    /// Closes the terminal like a window; the reader ends with the next output of a program.
    fn close(self) {
        *self.shown.lock().unwrap() = None;
        self.reader.join().unwrap();
    }

    fn press(&mut self, key: &str) {
        self.keys.write_all(key.as_bytes()).unwrap();
    }

    fn wait_for(&self, words: &str) {
        self.wait_until(words, |screen| screen.contents().contains(words));
    }

    fn wait_until(&self, what: &str, is_it: impl Fn(&vt100::Screen) -> bool) {
        let begin = Instant::now();
        loop {
            let shown = self.shown.lock().unwrap();
            let screen = shown.as_ref().unwrap().screen();
            if is_it(screen) {
                return;
            }
            assert!(begin.elapsed() < TIMEOUT, "{what}:\n{}", screen.contents());
            drop(shown);
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// `cdcrctl` with a terminal.
fn shown(daemon: &Daemon, theirs: &File, arguments: &[&str]) -> Running {
    let mut command = daemon.place().command("cdcrctl");
    let side = || Stdio::from(theirs.try_clone().unwrap());
    command
        .args(arguments)
        .current_dir(daemon.place().folder())
        .envs([("LC_ALL", "C.UTF-8"), ("TERM", "xterm")]);
    Running::start(command.stdin(side()).stdout(side()).stderr(side()))
}

#[test]
fn keys_hold_and_stop_the_robot_and_every_way_out_gives_the_terminal_back() {
    let daemon = Daemon::start("");
    let connection = daemon.connect();
    ask_for(&connection, RequestKind::Home);
    for signal in [
        None,
        Some(Signal::TERM),
        Some(Signal::HUP),
        Some(Signal::QUIT),
    ] {
        let (mut terminal, theirs) = Terminal::new(100, 30);
        let before = tcgetattr(&theirs).unwrap().local_modes;
        assert!(before.contains(LocalModes::ECHO));
        let mut top = shown(&daemon, &theirs, &["top"]);
        terminal.wait_for("STOP");
        terminal.wait_for("side x, z");
        terminal.wait_until("a screen of its own", vt100::Screen::alternate_screen);
        assert!(
            !tcgetattr(&theirs)
                .unwrap()
                .local_modes
                .contains(LocalModes::ECHO)
        );
        if signal.is_none() {
            terminal.press("h");
            wait_status(&connection, |status| status.mode == Mode::Holding.code());
            terminal.press("s");
            wait_status(&connection, |status| status.mode == Mode::Stopped.code());
            terminal.wait_for("stop: accepted");
        }
        match signal {
            None => terminal.press("q"),
            Some(signal) => top.signal(signal),
        }
        assert_eq!(
            top.wait(String::new).code(),
            Some(if signal.is_none() { 0 } else { 130 })
        );
        terminal.wait_until("it is given back", |screen| !screen.alternate_screen());
        assert_eq!(tcgetattr(&theirs).unwrap().local_modes, before);
    }
}

#[test]
fn keys_hold_and_stop_the_robot_while_the_terminal_is_not_read() {
    let daemon = Daemon::start("");
    let connection = daemon.connect();
    let mut feed = daemon.place().command("cdcrctl");
    let line = "ref circle --duration 600s --track";
    feed.args(line.split(' ')).stdout(Stdio::null());
    let _feed = Running::start(feed.stderr(Stdio::null()));
    let is_mode = |mode: Mode| wait_status(&connection, |status| status.mode == mode.code());
    is_mode(Mode::Tracking);
    for key in ["s", " "] {
        let (mut terminal, theirs) = Terminal::new(100, 30);
        let mut top = shown(&daemon, &theirs, &["top"]);
        terminal.wait_for("side x, z");
        // The reader of the terminal waits for this lock, and the output fills the rest.
        let shown = Arc::clone(&terminal.shown);
        let unread = shown.lock().unwrap();
        fill(&terminal.keys);
        if key == "s" {
            terminal.press("h");
            is_mode(Mode::Holding);
        }
        terminal.press(key);
        is_mode(Mode::Stopped);
        drop(unread);
        terminal.wait_for("stop: accepted");
        terminal.press("q");
        assert_eq!(top.wait(String::new).code(), Some(0));
        ask_for(&connection, RequestKind::Reset);
    }
}

#[test]
fn a_feed_goes_on_while_its_terminal_is_not_read_and_an_interrupt_ends_it() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let (terminal, theirs) = Terminal::new(100, 30);
    let line: Vec<_> = "ref circle --duration 600s --track".split(' ').collect();
    let mut feed = shown(&daemon, &theirs, &line);
    terminal.wait_for("of 600.0 s, error");
    let shown = Arc::clone(&terminal.shown);
    let unread = shown.lock().unwrap();
    fill(&terminal.keys);
    // Longer than the points last that are sent ahead, without a picture.
    let begin = wait_record(&mut telemetry, |_| true);
    let end_ns = begin.release_ns + 3_000_000_000;
    let is_over = |record: &Telemetry| {
        assert_eq!(record.mode, Mode::Tracking.code(), "the feed stands still");
        record.release_ns > end_ns
    };
    wait_record(&mut telemetry, is_over);
    feed.signal(Signal::INT);
    wait_record(&mut telemetry, |record| record.mode == Mode::Holding.code());
    assert_eq!(feed.wait(String::new).code(), Some(130));
    drop(unread);
}

#[test]
fn the_scope_records_and_ends_while_its_terminal_is_not_read() {
    let daemon = Daemon::start("");
    let connection = daemon.connect();
    for (fires, interrupted) in [(true, false), (true, true), (false, false)] {
        let (mut terminal, theirs) = Terminal::new(80, 24);
        let before = tcgetattr(&theirs).unwrap().local_modes;
        let line = "scope --trigger mode --before 1s --after 300ms -o unread.mcap";
        let line: Vec<_> = line.split(' ').collect();
        let mut scope = shown(&daemon, &theirs, &line);
        terminal.wait_for("clearance [mm]");
        let shown = Arc::clone(&terminal.shown);
        let unread = shown.lock().unwrap();
        fill(&terminal.keys);
        if fires {
            let kind = if interrupted {
                RequestKind::Stop
            } else {
                RequestKind::Home
            };
            ask_for(&connection, kind);
            let file = daemon.place().folder().join("unread.mcap");
            wait_until("it is recorded", || file.exists());
            if interrupted {
                scope.signal(Signal::INT);
                assert_eq!(scope.wait(String::new).code(), Some(0));
                drop(unread);
                std::fs::remove_file(file).unwrap();
                continue;
            }
            drop(unread);
            terminal.wait_for("before and");
            assert_eq!(scope.wait(String::new).code(), Some(0));
            std::fs::remove_file(file).unwrap();
        } else {
            terminal.press("q");
            assert_eq!(scope.wait(String::new).code(), Some(130));
            assert_eq!(tcgetattr(&theirs).unwrap().local_modes, before);
            drop(unread);
        }
    }
}

/// Writes to a terminal that is not read, until it takes no more.
fn fill(keys: &File) {
    let name = ptsname(keys, Vec::new()).unwrap();
    let mut options = std::fs::OpenOptions::new();
    let flags = NOCTTY | OFlags::NONBLOCK.bits().cast_signed();
    let screen = options.write(true).custom_flags(flags);
    let mut screen = screen.open(name.to_str().unwrap()).unwrap();
    let mut refused = 0;
    while refused < 20 {
        // A terminal shows nothing for this byte.
        match screen.write(&[0; 256]) {
            Ok(length) => {
                assert!(length > 0);
                refused = 0;
            }
            Err(error) => {
                assert_eq!(error.kind(), ErrorKind::WouldBlock);
                refused += 1;
                std::thread::sleep(Duration::from_millis(10));
            }
        }
    }
}

#[test]
fn a_daemon_that_ends_is_reported_and_the_next_one_is_watched() {
    // A period that a stall does not fill: late cycles would displace the awaited event from the list. One of
    // them is not a lost measurement.
    let mut daemon =
        Daemon::start("[cycle]\nperiod_ms = 100.0\n[link]\nmeasurement_timeout_ms = 10000.0\n");
    let (mut terminal, theirs) = Terminal::new(100, 30);
    let mut top = shown(&daemon, &theirs, &["top"]);
    terminal.wait_for("HOLDING");
    daemon.kill();
    terminal.wait_for("no cycle for a second");
    daemon.restart();
    terminal.wait_for("another daemon started");
    terminal.press("q");
    assert_eq!(top.wait(String::new).code(), Some(0));
}

#[test]
fn a_terminal_that_is_closed_ends_what_is_on_it() {
    let daemon = Daemon::start("");
    for (line, words, code) in [
        ("top", "side x, z", 0),
        ("scope --trigger mode -o mode.mcap", "waiting for mode", 130),
    ] {
        let (terminal, theirs) = Terminal::new(100, 30);
        let line: Vec<_> = line.split(' ').collect();
        let mut shown = shown(&daemon, &theirs, &line);
        terminal.wait_for(words);
        terminal.close();
        assert_eq!(shown.wait(String::new).code(), Some(code), "{line:?}");
    }
}

#[test]
fn without_a_terminal_it_names_the_alternatives() {
    let daemon = Daemon::start("");
    daemon
        .place()
        .checked("cdcrctl top", 1, &["needs a terminal", "--format json"]);
}

#[test]
fn the_scope_draws_while_it_waits_and_gives_the_terminal_back() {
    let daemon = Daemon::start("");
    let connection = daemon.connect();
    for fires in [true, false] {
        let (mut terminal, theirs) = Terminal::new(80, 24);
        let before = tcgetattr(&theirs).unwrap().local_modes;
        let line = "scope --trigger mode --before 1s --after 500ms -o mode.mcap";
        let line: Vec<_> = line.split(' ').collect();
        let mut scope = shown(&daemon, &theirs, &line);
        terminal.wait_until("a screen of its own", vt100::Screen::alternate_screen);
        terminal.wait_for("waiting for mode");
        terminal.wait_for("clearance [mm]");
        if fires {
            ask_for(&connection, RequestKind::Home);
        } else {
            terminal.press("q");
        }
        assert_eq!(
            scope.wait(String::new).code(),
            Some(if fires { 0 } else { 130 })
        );
        terminal.wait_until("it is given back", |screen| !screen.alternate_screen());
        assert_eq!(tcgetattr(&theirs).unwrap().local_modes, before);
        let file = daemon.place().folder().join("mode.mcap");
        assert_eq!(file.exists(), fires);
        if fires {
            terminal.wait_for("before and");
            std::fs::remove_file(file).unwrap();
        }
    }
}
