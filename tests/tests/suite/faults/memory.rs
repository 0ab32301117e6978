//! Full shared memory: a private mount of /dev/shm with a small size.

use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::{Duration, Instant};

use cdcr_shared_types::Location;
use cdcr_shared_types::codes::Mode;
use cdcr_tests::{
    Daemon, Place, STALL_TOLERANT, TIMEOUT, assert_output, binary, text, wait_status,
};

use crate::own_mounts::{Filled, has_own_mounts, mount_memory, name_of};

/// Period of the default configuration \[s\].
const PERIOD_S: f64 = 0.005;
/// Longest interval between two status messages of a daemon that is not delayed.
const STATUS_PERIOD: Duration = Duration::from_millis(100);

#[test]
fn a_daemon_that_has_no_room_is_refused_with_what_it_needs() {
    if !has_own_mounts(&name_of(
        &a_daemon_that_has_no_room_is_refused_with_what_it_needs,
    )) {
        return;
    }
    // Slightly and much too small; the default of many containers is large enough.
    for kilobytes in [4, 16, 1_000, 5_000] {
        if !mount_memory(&format!("size={kilobytes}k")) {
            return;
        }
        let parts = [
            Location::MEMORY,
            "is full",
            "MB are free",
            "remount,size=",
            "--shm-size=",
            "cdcrd doctor",
        ];
        let place = Place::new();
        place.checked("cdcrd run", 71, &parts);
        let files = || place.memory_files();
        assert_eq!(files(), Vec::<PathBuf>::new(), "nothing stays behind");
    }
}

/// A daemon whose memory is filled up after its start.
fn assert_survives_full_memory(test: &str, realtime: &str) {
    if !has_own_mounts(test) || !mount_memory("size=64000k") {
        return;
    }
    let configuration =
        format!("[cycle]\nmiss_limit = 1000000\n[realtime]\nmode = \"{realtime}\"\n");
    let mut daemon = Daemon::start(&configuration);
    // Releases until the newest status, executed and skipped, and the time of the request.
    let releases = |daemon: &Daemon| {
        let asked = Instant::now();
        let status = daemon.connect().status(TIMEOUT).unwrap();
        assert_eq!(status.mode, Mode::Holding.code());
        (status.cycles + status.skipped_periods, asked)
    };
    let (releases_before, _) = releases(&daemon);
    let answered = Instant::now();
    // So little that each client fails at another step of its connection.
    for kilobytes in [0, 8, 24, 40, 200] {
        let _filled = Filled::but_kilobytes(kilobytes);
        for arguments in [
            &["ref", "line", "--track"][..],
            &["echo", "telemetry", "--count", "1"],
        ] {
            let output = daemon.place().cdcrctl(arguments);
            let got_in = output.status.success();
            assert!(!got_in || kilobytes > 8, "{arguments:?}: {}", text(&output));
            println!(
                "{kilobytes} kB left, cdcrctl {}: exit {:?}, signal {:?}, {:?}",
                arguments[0],
                output.status.code(),
                output.status.signal(),
                text(&output).lines().next().unwrap_or_default()
            );
            // It ends by itself, with the reason.
            assert_eq!(output.status.signal(), None, "{arguments:?}");
            assert!(got_in || text(&output).starts_with("error: "));
            assert!(daemon.runs(), "the daemon died of a client without room");
        }
        let other = daemon.place().cdcrctl(&["hold"]);
        let is_reported = other.status.success() || text(&other).contains("is full");
        assert!(is_reported, "{}", text(&other));
        // The daemon publishes a few status messages with the remaining memory.
        std::thread::sleep(2 * STATUS_PERIOD);
    }
    // The loop kept running: the status may be behind by half of the passed time at most.
    let (releases, asked) = releases(&daemon);
    let passed_s = asked.duration_since(answered).as_secs_f64();
    let counted_s = (releases - releases_before) as f64 * PERIOD_S;
    assert!(
        counted_s > 0.5 * passed_s,
        "{counted_s} s of cycles in {passed_s} s"
    );
    assert!(daemon.stop().success(), "{}", daemon.log());
}

fn doctor(place: &Place) -> String {
    text(&place.command("cdcrd").arg("doctor").output().unwrap())
}

#[test]
fn too_few_inodes_are_reported_at_the_start_and_to_clients_and_a_stop_gets_through() {
    if !has_own_mounts(&name_of(
        &too_few_inodes_are_reported_at_the_start_and_to_clients_and_a_stop_gets_through,
    )) {
        return;
    }
    for inodes in [3, 8, 30, 50] {
        if !mount_memory(&format!("size=64000k,nr_inodes={inodes}")) {
            return;
        }
        let place = Place::new();
        place.checked("cdcrd run", 71, &["nr_inodes="]);
        assert!(doctor(&place).contains("nr_inodes="));
    }
    if !mount_memory("size=64000k,nr_inodes=400") {
        return;
    }
    let mut daemon = Daemon::start("[cycle]\nmiss_limit = 1000000\n");
    let reported = doctor(daemon.place());
    assert!(!reported.contains("nr_inodes="), "{reported}");
    // Without any file, and with so few that each client fails at another step of its connection.
    for files in [0, 3, 6, 8, 12, 16] {
        let _filled = Filled::but_files(files);
        for request in ["status", "reset", "stop"] {
            let output = daemon.place().cdcrctl(&[request]);
            let printed = text(&output);
            println!("{files} files left, cdcrctl {request}: {printed}");
            let got_in = output.status.success();
            assert!(!got_in || files > 8, "{request}: {printed}");
            assert!(got_in || printed.contains("nr_inodes="), "{printed}");
            let is_vague = printed.contains("internal") || printed.contains("delayed");
            assert!(!is_vague, "{printed}");
            if request == "stop" && !got_in {
                assert!(printed.contains("SIGUSR1"), "{printed}");
            }
        }
        assert!(daemon.runs());
    }
    wait_status(&daemon.connect(), |status| {
        status.mode == Mode::Stopped.code()
    });
    assert!(daemon.stop().success(), "{}", daemon.log());
}

#[test]
fn too_few_files_that_a_process_may_open_are_reported_and_a_stop_gets_through() {
    let mut daemon = Daemon::start(STALL_TOLERANT);
    for files in [12, 20, 30] {
        let started = limited(&Place::new(), files, "cdcrd", "run");
        assert_output(&started, 71, &["ulimit -n"]);
    }
    // Each client fails at another step of its connection.
    for files in [7, 9, 11, 13, 15, 17, 20, 24, 28, 64] {
        for request in ["status", "reset", "stop"] {
            let output = limited(daemon.place(), files, "cdcrctl", request);
            let printed = text(&output);
            println!("{files} files, cdcrctl {request}: {printed}");
            let got_in = output.status.success();
            assert!(got_in || printed.contains("ulimit -n"), "{printed}");
            let is_stop = request == "stop" && !got_in;
            assert!(!is_stop || printed.contains("SIGUSR1"), "{printed}");
            assert!(got_in || files < 64, "{printed}");
        }
        assert!(daemon.runs());
    }
    assert!(daemon.stop().success(), "{}", daemon.log());
}

/// Runs a program that may open `files` files.
fn limited(place: &Place, files: u32, program: &str, argument: &str) -> Output {
    // Children inherit open files of iceoryx2 from other tests of this process.
    let close =
        "for fd in /proc/self/fd/*; do fd=${fd##*/}; [ $fd -le 2 ] || eval \"exec $fd>&-\"; done";
    let script = format!("{close}; ulimit -n {files}; exec \"$0\" {argument}");
    let mut shell = place.command_of(Path::new("bash"));
    shell.args(["-c", &script]).arg(binary(program));
    shell.output().expect("bash")
}

#[test]
fn memory_that_fills_up_later_keeps_clients_out_and_the_daemon_running() {
    assert_survives_full_memory(
        &name_of(&memory_that_fills_up_later_keeps_clients_out_and_the_daemon_running),
        "off",
    );
}

#[test]
fn memory_that_fills_up_later_does_not_matter_to_locked_memory_either() {
    assert_survives_full_memory(
        &name_of(&memory_that_fills_up_later_does_not_matter_to_locked_memory_either),
        "prefer",
    );
}
