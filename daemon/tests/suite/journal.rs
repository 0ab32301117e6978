//! Output of `cdcrd run` to the system journal: the real program, with a journal of the test in the place of
//! the system's, in a mount namespace.

use std::collections::BTreeMap;
use std::io::Read;
use std::os::fd::OwnedFd;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use cdcr_scratch::Scratch;
use cdcr_test_skip::{Need, skip};

/// Time limit of every wait. Generous: machines stall.
const TIMEOUT: Duration = Duration::from_secs(30);
/// Mounts the test's folder over the journal's socket, and executes the program.
const SCRIPT: &str = "mount -t tmpfs none /run && mkdir -p /run/systemd/journal \
    && mount --bind \"$0\" /run/systemd/journal && exec \"$@\"";

/// The fields of an entry in the journal's protocol: a name, then either `=` and a line, or a line feed, the
/// length, and that many bytes.
fn fields(mut entry: &[u8]) -> BTreeMap<String, String> {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let mut fields = BTreeMap::new();
    while let Some(end) = entry.iter().position(|byte| *byte == b'\n') {
        let line = &entry[..end];
        entry = &entry[end + 1..];
        if let Some(equals) = line.iter().position(|byte| *byte == b'=') {
            fields.insert(text(&line[..equals]), text(&line[equals + 1..]));
        } else {
            let (length, rest) = entry.split_at(8);
            let length = u64::from_le_bytes(length.try_into().unwrap());
            let (value, rest) = rest.split_at(usize::try_from(length).unwrap());
            fields.insert(text(line), text(value));
            entry = &rest[1..];
        }
    }
    fields
}

/// `program`, with the journal in `folder`. Needs root, or the permission to create namespaces.
fn with_journal(folder: &Path, program: &str) -> Command {
    let root = rustix::process::geteuid().is_root();
    let mut command = Command::new("unshare");
    command.arg("--mount");
    if !root {
        command.arg("--map-root-user");
    }
    command.args(["sh", "-c", SCRIPT]).arg(folder).arg(program);
    command
}

fn may_have_a_journal(folder: &Path) -> bool {
    match with_journal(folder, "true").output() {
        Ok(output) if output.status.success() => true,
        Ok(output) => {
            let reason = String::from_utf8_lossy(&output.stderr);
            skip(Need::Mount, reason.trim());
            false
        }
        Err(error) => {
            skip(
                Need::UtilLinux,
                format_args!("unshare cannot be run: {error}"),
            );
            false
        }
    }
}

/// The program with the standard error `theirs`; `JOURNAL_STREAM` matches it if `named`.
fn start(place: &Scratch, theirs: UnixStream, named: bool) -> Child {
    let file = rustix::fs::fstat(&theirs).unwrap();
    let inode = if named { file.st_ino } else { file.st_ino + 1 };
    with_journal(place.path(), env!("CARGO_BIN_EXE_cdcrd"))
        .args(["run", "--robot", "journal", "--root"])
        .arg(place.path().join("root"))
        .env("CDCR_PREFIX", place.prefix())
        .env("JOURNAL_STREAM", format!("{}:{inode}", file.st_dev))
        .env_remove("RUST_LOG")
        .env_remove("CDCR_CONFIG")
        .stdin(Stdio::null())
        .stderr(OwnedFd::from(theirs))
        .spawn()
        .unwrap()
}

/// Runs the program until it controls the robot. Returns the fields of the journal's entries, and the text on
/// the standard error.
fn run(named: bool) -> Option<(Vec<BTreeMap<String, String>>, String)> {
    let place = Scratch::in_memory().unwrap();
    let journal = UnixDatagram::bind(place.path().join("socket")).unwrap();
    if !may_have_a_journal(place.path()) {
        return None;
    }
    journal.set_read_timeout(Some(TIMEOUT)).unwrap();
    let (theirs, mut ours) = UnixStream::pair().unwrap();
    ours.set_read_timeout(Some(TIMEOUT)).unwrap();
    let mut child = start(&place, theirs, named);
    let (mut entries, mut text) = (Vec::new(), String::new());
    let mut buffer = vec![0; 65536];
    while !entries.iter().any(is_running) && !text.contains("running") {
        if named {
            let length = journal.recv(&mut buffer).unwrap();
            entries.push(fields(&buffer[..length]));
        } else {
            let length = ours.read(&mut buffer).unwrap();
            assert!(length > 0, "the daemon ended: {text}");
            text += &String::from_utf8_lossy(&buffer[..length]);
        }
    }
    let id = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(id, rustix::process::Signal::TERM).unwrap();
    assert!(child.wait().unwrap().success());
    ours.read_to_string(&mut text).unwrap();
    if !named {
        journal.set_nonblocking(true).unwrap();
        assert!(journal.recv(&mut [0]).is_err(), "it is not the journal");
    }
    Some((entries, text))
}

fn is_running(entry: &BTreeMap<String, String>) -> bool {
    entry
        .get("MESSAGE")
        .is_some_and(|message| message == "running")
}

#[test]
fn lines_come_with_their_fields_when_the_standard_error_is_the_journal() {
    let Some((entries, text)) = run(true) else {
        return;
    };
    let running = entries.iter().find(|entry| is_running(entry)).unwrap();
    for (field, value) in [
        ("CDCR_ROBOT", "journal"),
        ("CDCR_SECTIONS", "3"),
        ("PRIORITY", "6"),
        ("SYSLOG_IDENTIFIER", "cdcrd"),
    ] {
        assert_eq!(
            running.get(field).map(String::as_str),
            Some(value),
            "{field}: {running:?}"
        );
    }
    assert!(!text.contains("running"), "reported twice: {text}");
}

#[test]
fn lines_are_text_when_the_standard_error_is_something_else() {
    let Some((_, text)) = run(false) else {
        return;
    };
    assert!(text.contains("running robot=\"journal\""), "{text}");
}

/// A journal that accepts nothing delays no thread: here the supervisor, which must react to the signal.
#[test]
fn a_journal_that_stands_still_holds_nobody_up() {
    let place = Scratch::in_memory().unwrap();
    let socket = place.path().join("socket");
    let journal = UnixDatagram::bind(&socket).unwrap();
    if !may_have_a_journal(place.path()) {
        return;
    }
    journal.set_read_timeout(Some(TIMEOUT)).unwrap();
    let (theirs, _ours) = UnixStream::pair().unwrap();
    let mut child = start(&place, theirs, true);
    let mut buffer = vec![0; 65536];
    loop {
        let length = journal.recv(&mut buffer).unwrap();
        if is_running(&fields(&buffer[..length])) {
            break;
        }
    }
    // From here on there is no reader, and no space for a single line.
    let filler = UnixDatagram::unbound().unwrap();
    filler.set_nonblocking(true).unwrap();
    let is_full = || filler.send_to(b"MESSAGE=full\n", &socket).is_err();
    let begin = Instant::now();
    while !is_full() {
        assert!(begin.elapsed() < TIMEOUT, "it is never full");
    }
    let id = rustix::process::Pid::from_child(&child);
    let signal = |signal| rustix::process::kill_process(id, signal).unwrap();
    // Each of them makes the daemon log a line.
    signal(rustix::process::Signal::HUP);
    std::thread::sleep(Duration::from_millis(100));
    signal(rustix::process::Signal::USR1);
    std::thread::sleep(Duration::from_millis(100));
    signal(rustix::process::Signal::TERM);
    let begin = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if begin.elapsed() > TIMEOUT {
            child.kill().unwrap();
            child.wait().unwrap();
            panic!("it waits for the journal");
        }
        std::thread::sleep(Duration::from_millis(10));
    };
    assert!(status.success(), "{status}");
}
