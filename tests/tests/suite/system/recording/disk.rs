//! A disk that ends a recording.

use std::fs;
use std::time::Duration;

use cdcr_client::channels::Topic;
use cdcr_shared_types::codes::Mode;
use cdcr_tests::{Daemon, STALL_TOLERANT, assert_output};
use rustix::process::{Pid, Resource, Rlimit, Signal, prlimit};

use super::lost;
use super::recorded::Recorded;
use crate::own_mounts::{has_own_mounts, mount, name_of};

#[test]
fn a_full_disk_ends_the_recording_and_the_file_is_whole() {
    if !has_own_mounts(&name_of(
        &a_full_disk_ends_the_recording_and_the_file_is_whole,
    )) {
        return;
    }
    let daemon = Daemon::start(STALL_TOLERANT);
    let disk = daemon.place().folder().join("disk");
    fs::create_dir(&disk).unwrap();
    let folder = disk.display();
    if !mount(&format!("mount -t tmpfs -o size=512k tmpfs {folder}")) {
        return;
    }
    let mut run = Recorded::into(daemon, "disk/run.mcap");
    let output = run.recorder.output();
    assert_output(&output, 3, &["run.mcap", "the recording ended there"]);
    let info = run.daemon.place().json("info disk/run.mcap");
    assert_eq!(info["cut"], false);
    let messages = info["channels"]["telemetry"]["messages"].as_u64().unwrap();
    assert!(messages > 10);
    // If the machine delayed the recorder for more than a second, records are lost, and the recorder reports
    // it.
    let reported = String::from_utf8_lossy(&output.stdout);
    assert!(
        reported.contains(&format!(": {messages} cycles, ")),
        "{reported}"
    );
    let missing = info["channels"]["telemetry"]["missing"].as_u64().unwrap();
    assert!(
        missing <= lost(&reported, Topic::Telemetry),
        "{missing}: {reported}"
    );
    // If the disk was full before, no empty file stays.
    fs::write(disk.join("rest"), vec![0; 1 << 20]).unwrap_err();
    let expected = [
        "cannot write disk/again.mcap",
        "No space left",
        "name a file on another disk with -o",
    ];
    let place = run.daemon.place();
    place.checked("cdcrctl record -o disk/again.mcap", 3, &expected);
    assert!(!disk.join("again.mcap").exists());
    // The loop was not affected.
    let status = run
        .daemon
        .connect()
        .status(Duration::from_secs(10))
        .unwrap();
    assert_eq!(status.mode, Mode::Holding.code());
    // Unmounted before the folder that contains it is removed.
    assert!(mount(&format!("umount {folder}")));
}

#[test]
fn a_file_at_its_limit_ends_the_recording_like_a_full_disk() {
    let mut run = Recorded::start(STALL_TOLERANT);
    let limit = Rlimit {
        current: Some(200_000),
        maximum: None,
    };
    let id = Pid::from_raw(run.recorder.id().try_into().unwrap());
    prlimit(id, Resource::Fsize, limit).unwrap();
    // The limit may come before or after the first flush.
    let expected = ["run.mcap", "File too large", "raise the limit (ulimit -f)"];
    assert_output(&run.recorder.output(), 3, &expected);
}

#[test]
fn a_recording_ends_before_its_file_is_larger_than_asked() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    let expected = ["run.mcap", "the file has its maximum size"];
    place.checked("cdcrctl record -o run.mcap --max-size 2MB", 0, &expected);
    let bytes = fs::metadata(place.folder().join("run.mcap")).unwrap().len();
    assert!((1_000_000..=2_000_000).contains(&bytes), "{bytes}");
    assert_eq!(place.json("info run.mcap")["cut"], false);
}

#[test]
fn a_recording_whose_file_was_removed_is_an_error() {
    let mut run = Recorded::start(STALL_TOLERANT);
    fs::remove_file(&run.file).unwrap();
    run.recorder.signal(Signal::INT);
    let expected = ["run.mcap was removed during the recording"];
    assert_output(&run.recorder.output(), 1, &expected);
}

#[test]
fn an_output_that_cannot_be_written_is_no_full_disk() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let place = daemon.place();
    for line in ["record --duration 500ms -o run.mcap", "status"] {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let mut command = place.command("cdcrctl");
        command.args(line.split(' ')).current_dir(place.folder());
        let output = command.stdout(full).output().unwrap();
        assert_output(&output, 1, &["cannot write the output: No space left"]);
    }
    place.checked("cdcrctl info run.mcap", 0, &["telemetry"]);
}
