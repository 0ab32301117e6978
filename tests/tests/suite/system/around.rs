//! Recordings around an event, and what viewers draw of a recording.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

use cdcr_client::Spiral;
use cdcr_client::channels::Drawn;
use cdcr_interchange::cdr;
use cdcr_interchange::mcap::{Item, Reader};
use cdcr_interchange::standard::{Log, MarkerArray};
use cdcr_shared_types::codes::RequestKind;
use cdcr_tests::{
    Daemon, Program, STALL_TOLERANT, ask_for, assert_output, text, track, until_undisturbed,
    wait_until,
};
use rustix::process::Signal;
use serde_json::Value;

/// Contents of a file: bytes of each message by the last part of its topic, and the names of the attachments.
fn content(file: &Path) -> (BTreeMap<String, Vec<Vec<u8>>>, BTreeSet<String>) {
    let mut reader = Reader::new(fs::File::open(file).unwrap()).unwrap();
    let (mut messages, mut attachments) = (BTreeMap::<_, Vec<_>>::new(), BTreeSet::new());
    while let Some(item) = reader.next_item().unwrap() {
        match item {
            Item::Message(message) => {
                let name = message.channel.topic.rsplit('/').next().unwrap().to_owned();
                let all = messages.entry(name).or_default();
                all.push(message.data.to_vec());
            }
            Item::Attachment { name, .. } => {
                attachments.insert(name);
            }
            Item::Metadata { .. } => {}
        }
    }
    (messages, attachments)
}

fn info(daemon: &Daemon, file: &str) -> Value {
    daemon.place().json(&format!("info {file}"))
}

#[test]
fn a_recording_has_what_viewers_draw_and_what_the_machine_is_like() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let file = daemon.place().folder().join("run.mcap");
    let mut recorder = daemon.place().record("run.mcap");
    let curve = Spiral {
        duration_s: 1.5,
        ..Spiral::for_sections(&[0.3; 3])
    };
    let connection = daemon.connect();
    track(&connection, &curve);
    recorder.signal(Signal::INT);
    assert_output(&recorder.output(), 0, &["run.mcap"]);
    let (messages, attachments) = content(&file);
    let all = [
        "configuration.toml",
        "daemon.json",
        "doctor.json",
        "settings.toml",
        "status.json",
    ]
    .map(str::to_owned);
    assert_eq!(attachments, all.into());
    let seconds = info(&daemon, "run.mcap")["duration_s"].as_f64().unwrap();
    for drawn in Drawn::ALL {
        let topic = drawn.channel(cdcr_tests::ROBOT).topic;
        assert!(
            messages.contains_key(topic.rsplit('/').next().unwrap()),
            "{topic}"
        );
    }
    // Records lost in a stall of the machine have no scene.
    let pictures = messages["scene"].len() as f64;
    assert!(
        (0.5..1.05).contains(&(pictures / (30.0 * seconds))),
        "{pictures} in {seconds} s"
    );
    let scene: MarkerArray = cdr::from_bytes(messages["scene"].last().unwrap()).unwrap();
    let names: BTreeSet<_> = scene.markers.iter().map(|marker| &*marker.ns).collect();
    for name in ["body", "discs", "tip way", "reference way", "text"] {
        assert!(names.contains(name), "{name}: {names:?}");
    }
    let log = messages["log"].iter();
    let log: Vec<Log> = log.map(|bytes| cdr::from_bytes(bytes).unwrap()).collect();
    assert!(
        log.iter().any(|line| line.msg.starts_with("tracking")),
        "{log:?}"
    );
}

/// A disk may block under the load of a build; here, standard error is not read.
#[test]
fn what_makes_a_recorder_wait_loses_nothing() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let (mut unread, mut full) = std::io::pipe().unwrap();
    // One page, independent of the page size and of the default capacity of pipes.
    let room = rustix::pipe::fcntl_setpipe_size(&full, 1).unwrap();
    let reported = "waiting for mode; Ctrl-C to end\n";
    full.write_all(&vec![b'.'; room - 1 - reported.len()])
        .unwrap();
    let mut command = daemon.place().command("cdcrctl");
    let line = "record --around mode --before 0s --after 1s -o run.mcap";
    command.args(line.split(' '));
    command.current_dir(daemon.place().folder());
    command.stdout(Stdio::null()).stderr(full);
    let mut recorder = command.spawn().unwrap();
    drop(command);
    wait_until("it waits", || {
        rustix::io::ioctl_fionread(&unread).unwrap() == room as u64 - 1
    });
    ask_for(&daemon.connect(), RequestKind::Home);
    // Longer than the queue of telemetry, and than the duration of the recording.
    std::thread::sleep(Duration::from_secs(3));
    std::io::copy(&mut unread, &mut std::io::sink()).unwrap();
    assert!(recorder.wait().unwrap().success());
    let info = info(&daemon, "run.mcap");
    for (name, channel) in info["channels"].as_object().unwrap() {
        assert_eq!(channel["missing"], 0, "{name}: {info}");
    }
    // By the stamps of the records, not by the time of writing. A stall may separate a release from its
    // stamp.
    let seconds = info["duration_s"].as_f64().unwrap();
    assert!((0.5..2.0).contains(&seconds), "{info}");
}

/// Output of a program that ends by itself; `None` if it has not ended in time and is stopped.
fn output_of_one_that_ends(mut program: Program) -> Option<Output> {
    let begin = Instant::now();
    while program.runs() && begin.elapsed() < Duration::from_secs(10) {
        std::thread::sleep(Duration::from_millis(20));
    }
    (!program.runs()).then(|| program.output())
}

#[test]
fn what_was_before_a_change_of_mode_is_recorded_with_what_comes_after() {
    let around = "cdcrctl record --around mode --before 1s --after 500ms -o mode.mcap";
    let (daemon, found) = until_undisturbed("a recorder ends half a second later", || {
        let daemon = Daemon::start(STALL_TOLERANT);
        let recorder = daemon.place().start(around);
        let file = daemon.place().folder().join("mode.mcap");
        // Long enough to fill its memory.
        std::thread::sleep(Duration::from_secs(2));
        assert!(!file.exists());
        let connection = daemon.connect();
        ask_for(&connection, RequestKind::Stop);
        // A recorder delayed for longer by the machine misses the change.
        assert_output(&output_of_one_that_ends(recorder)?, 0, &["mode.mcap"]);
        let found = info(&daemon, "mode.mcap");
        let cycles = |mode: &str| found["modes"][mode].as_u64().unwrap_or(0);
        // One second before and half a second after: fewer records if the machine skipped periods, more if it
        // delayed the recorder.
        let is_meant =
            (100..=201).contains(&cycles("holding")) && (20..=220).contains(&cycles("stopped"));
        is_meant.then_some((daemon, found))
    });
    assert_eq!(found["cut"], false);
    // The cycles follow no reference, so all of them can be recomputed.
    daemon
        .place()
        .checked("cdcrctl replay --verify mode.mcap", 0, &["reproduced"]);
}

#[test]
fn the_scope_waits_draws_and_records() {
    let line = "cdcrctl scope --trigger mode --before 500ms --after 500ms -o shot.mcap";
    let (daemon, output) = until_undisturbed("a scope sees a stop after a second", || {
        let daemon = Daemon::start(STALL_TOLERANT);
        let scope = daemon.place().start(line);
        std::thread::sleep(Duration::from_secs(1));
        let connection = daemon.connect();
        ask_for(&connection, RequestKind::Stop);
        Some((daemon, output_of_one_that_ends(scope)?))
    });
    let reported = assert_output(&output, 0, &["mode in cycle", "stopped", "response [us]"]);
    assert!(reported.lines().count() > 15, "{reported}");
    assert!(
        info(&daemon, "shot.mcap")["modes"]["stopped"]
            .as_u64()
            .unwrap()
            > 0
    );
}

#[test]
fn what_does_not_happen_leaves_no_file() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    let line = "cdcrctl record --around error>500mm --duration 500ms -o none.mcap";
    place.checked(line, 1, &["nothing was recorded"]);
    let output = until_undisturbed("a recorder hears a signal after half a second", || {
        let mut recorder = place.start("cdcrctl record --around fault -o none.mcap");
        std::thread::sleep(Duration::from_millis(500));
        recorder.signal(Signal::INT);
        let output = recorder.output();
        // Before its handler is installed, the signal ends it.
        output.status.signal().is_none().then_some(output)
    });
    assert_eq!(output.status.code(), Some(130), "{}", text(&output));
    assert!(!place.folder().join("none.mcap").exists());
    fs::write(place.folder().join("none.mcap"), "mine").unwrap();
    place.checked(
        "cdcrctl record --around fault -o none.mcap",
        1,
        &["none.mcap exists: remove it"],
    );
    // What could not be written is reported before the wait for the trigger.
    place.checked(
        "cdcrctl record --around fault -o nowhere/none.mcap",
        1,
        &["cannot write into nowhere"],
    );
    place.checked("cdcrctl scope --trigger error>5", 2, &["unit"]);
}
