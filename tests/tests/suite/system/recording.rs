//! `cdcrctl record`, and the commands that read its files.

mod recorded;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::LazyLock;
use std::time::Duration;

use cdcr_client::channels::Topic;
use cdcr_client::{Connection, ObstacleSender, Spiral};
use cdcr_interchange::mcap::{Channel, Item, Reader, Stamp, Writer};
use cdcr_interchange::{decode, encode};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{EventKind, Mode, RequestKind};
use cdcr_shared_types::message::Struct;
use cdcr_tests::{
    Daemon, PATIENT, Place, TIMEOUT, assert_says, ball, refused, text, track, until_undisturbed,
    wait_mode,
};
use rustix::process::{Pid, Resource, Rlimit, Signal, prlimit};
use serde_json::Value;

use crate::own_mounts::{has_own_mounts, mount, name_of};
use recorded::Recorded;

/// Number of lost messages of a topic, as reported by a recorder.
fn lost(said: &str, topic: Topic) -> u64 {
    let counts = said.lines().filter_map(|line| {
        let (count, of) = line.strip_prefix("lost: ")?.split_once(' ')?;
        of.starts_with(topic.noun())
            .then(|| count.parse::<u64>().unwrap())
    });
    counts.sum()
}

fn curve() -> Spiral {
    Spiral {
        duration_s: 1.0,
        ..Spiral::for_sections(&[0.3; 3])
    }
}

/// The sender remains, because pending messages are lost when it leaves.
fn know_an_obstacle(connection: &Connection) -> ObstacleSender {
    let mut telemetry = connection.telemetry().unwrap();
    let sender = connection.obstacle_sender().unwrap();
    let header = sender.upsert(&[ball(1, [0.3, 0.0, 0.5])]).unwrap();
    let outcome = telemetry.outcome_on(EventKind::Obstacles, &header, TIMEOUT);
    assert_eq!(outcome.unwrap().code(), 0);
    sender
}

#[test]
fn a_recording_has_every_cycle_and_what_clients_sent() {
    let (run, records, said) = until_undisturbed("a recorder reads in time", || {
        let mut run = Recorded::start(PATIENT);
        let connection = run.daemon.connect();
        let _sender = know_an_obstacle(&connection);
        let records = track(&connection, &curve());
        let said = run.end();
        let is_whole = [Topic::Telemetry, Topic::Reference, Topic::Obstacles]
            .iter()
            .all(|topic| lost(&said, *topic) == 0);
        is_whole.then_some((run, records, said))
    });
    assert!(said.contains("1 obstacle update,"), "{said}");
    let info = run.info();
    let telemetry = &info["channels"]["telemetry"];
    assert!(telemetry["messages"].as_u64().unwrap() >= records.len() as u64);
    for (name, topic) in [
        ("telemetry", Topic::Telemetry),
        ("reference", Topic::Reference),
        ("obstacles", Topic::Obstacles),
        ("status", Topic::Status),
    ] {
        let channel = &info["channels"][name];
        assert!(channel["messages"].as_u64().unwrap() > 0, "{name}: {info}");
        // Only two snapshots wait for a reader: if it is 0.2 s late, older ones are lost, and counted.
        assert_eq!(channel["missing"], lost(&said, topic), "{info}");
    }
    let place = run.daemon.place();
    place.says("cdcrctl convert run.mcap --csv tables", 0, &[]);
    let table = |name: &str| {
        let path = run.file.with_file_name("tables").join(name);
        let text = fs::read_to_string(path).unwrap();
        let mut rows = text
            .lines()
            .map(|row| row.split(',').map(str::to_owned).collect::<Vec<_>>());
        (rows.next().unwrap(), rows.collect::<Vec<_>>())
    };
    let (heads, rows) = table("telemetry.csv");
    assert_eq!(telemetry["messages"], rows.len());
    let column = |name: &str| heads.iter().position(|head| head == name).unwrap();
    let cycle = column("cycle");
    let at = |record: &Telemetry| {
        rows.iter()
            .find(|row| row[cycle] == record.cycle.to_string())
            .unwrap()
    };
    for record in &records {
        let row = at(record);
        assert_eq!(row[column("command.mode")], "tracking");
        // Written in full precision: the same bits when read.
        assert_eq!(row[column("bend_rad[2]")].parse(), Ok(record.bend_rad[2]));
        assert_eq!(row.len(), heads.len());
    }
    assert!(
        !heads
            .iter()
            .any(|head| head.starts_with("plan[") || head.starts_with("bend_rad[6"))
    );
    let (heads, rows) = table("obstacles.csv");
    assert_eq!(
        (rows.len(), heads.contains(&"radius_m".to_owned())),
        (1, true)
    );
    assert!(
        table("events.csv")
            .1
            .iter()
            .any(|row| row.contains(&"track".to_owned()))
    );
    assert_eq!(info["cut"], false);
    assert!(info["modes"]["tracking"].as_u64().unwrap() > 100);
    let error_m = info["largest_error"]["position_error_m"].as_f64().unwrap();
    assert!((1e-9..0.1).contains(&error_m), "{error_m}");
}

/// Modes change, requests are rejected, obstacles appear, solves exceed their budget: every cycle can be
/// recomputed from the recording alone.
#[test]
fn every_cycle_of_a_recording_is_computed_again() {
    let budget =
        "[cycle]\nmiss_limit = 1000000\nbudget_ms = 0.02\n[reference]\nlease_ms = 60000.0\n";
    let mut run = Recorded::start(budget);
    let connection = run.daemon.connect();
    let _sender = know_an_obstacle(&connection);
    track(&connection, &curve());
    // Rejected: no client feeds.
    refused(&connection, RequestKind::Track);
    let mut telemetry = connection.telemetry().unwrap();
    for (request, mode) in [
        (RequestKind::Home, Mode::Homing),
        (RequestKind::Stop, Mode::Stopped),
        (RequestKind::Reset, Mode::Holding),
    ] {
        connection.request_within(request, TIMEOUT).unwrap();
        wait_mode(&mut telemetry, mode);
    }
    let settings = connection.settings().unwrap();
    let changed = cdcr_shared_types::SolverSettings {
        horizon_steps: settings.horizon_steps + 1,
        ..settings
    };
    connection.change_settings(changed).unwrap();
    track(&connection, &curve());
    run.end();
    let verified = run.daemon.place().json("replay --verify run.mcap");
    assert_eq!(verified["cycles"], verified["reproduced"], "{verified}");
    assert_eq!(verified["first_difference"], Value::Null);
    assert!(verified["solved"].as_u64().unwrap() > 300, "{verified}");
    let info = run.info();
    assert_eq!(
        verified["cycles"],
        info["channels"]["telemetry"]["messages"]
    );
    for mode in ["tracking", "holding", "homing", "stopped"] {
        assert!(info["modes"][mode].as_u64().unwrap() > 0, "{info}");
    }
}

#[test]
fn cycles_of_a_reference_from_before_the_recording_are_counted_apart() {
    let daemon = Daemon::start(PATIENT);
    let connection = daemon.connect();
    let mut run = std::thread::scope(|scope| {
        let feed = scope.spawn(|| track(&daemon.connect(), &curve()));
        let mut telemetry = connection.telemetry().unwrap();
        wait_mode(&mut telemetry, Mode::Tracking);
        let recorder = daemon.place().record("run.mcap");
        feed.join().unwrap();
        recorder
    });
    drop(connection);
    run.signal(Signal::INT);
    assert_says(&run.output(), 0, &["run.mcap"]);
    let said = daemon
        .place()
        .says("cdcrctl replay --verify run.mcap", 0, &["reproduced"]);
    assert!(said.contains("not completely recorded"), "{said}");
}

#[test]
fn a_recording_ends_with_its_daemon() {
    let mut run = Recorded::start(PATIENT);
    run.daemon.stop();
    assert_says(&run.recorder.output(), 0, &["the daemon ended"]);
    assert_eq!(run.info()["cut"], false);
}

#[test]
fn of_a_recorder_that_is_killed_the_last_second_is_missing_at_most() {
    let mut run = Recorded::start(PATIENT);
    let mut telemetry = run.daemon.connect().telemetry().unwrap();
    let begin = telemetry.next_within(TIMEOUT).unwrap().unwrap();
    let newest = loop {
        let record = telemetry.next_within(TIMEOUT).unwrap().unwrap();
        if record.release_ns - begin.release_ns > 2_500_000_000 {
            break record;
        }
    };
    run.recorder.signal(Signal::KILL);
    run.recorder.output();
    let info = run.info();
    assert_eq!(info["cut"], true);
    // If the output of the warning fails, there is no warning.
    let (nobody, unread) = std::io::pipe().unwrap();
    drop(nobody);
    let mut command = run.daemon.place().command("cdcrctl");
    command.arg("info").arg(&run.file).stdout(Stdio::null());
    assert_eq!(command.stderr(unread).status().unwrap().code(), Some(0));
    let seen_s = info["duration_s"].as_f64().unwrap();
    let all_s = (newest.release_ns - begin.release_ns) as f64 * 1e-9;
    // A stalled machine delays the recorder, too; it flushes when it runs.
    assert!(seen_s > all_s - 2.0, "{seen_s} of {all_s} s");
    let place = run.daemon.place();
    place.says("cdcrctl info run.mcap --repair", 0, &["is truncated"]);
    fs::rename(run.file.with_file_name("run-repaired.mcap"), &run.file).unwrap();
    let repaired = run.info();
    assert_eq!(repaired["cut"], false);
    assert_eq!(repaired["channels"], info["channels"]);
}

#[test]
fn a_full_disk_ends_the_recording_and_the_file_is_whole() {
    if !has_own_mounts(&name_of(
        &a_full_disk_ends_the_recording_and_the_file_is_whole,
    )) {
        return;
    }
    let daemon = Daemon::start(PATIENT);
    let disk = daemon.place().folder().join("disk");
    fs::create_dir(&disk).unwrap();
    let folder = disk.display();
    if !mount(&format!("mount -t tmpfs -o size=512k tmpfs {folder}")) {
        return;
    }
    let mut run = Recorded::into(daemon, "disk/run.mcap");
    let output = run.recorder.output();
    assert_says(&output, 3, &["run.mcap", "the recording ended there"]);
    let info = run.daemon.place().json("info disk/run.mcap");
    assert_eq!(info["cut"], false);
    let messages = info["channels"]["telemetry"]["messages"].as_u64().unwrap();
    assert!(messages > 10);
    // If the machine delayed the recorder for more than a second, records are lost, and the recorder reports
    // it.
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains(&format!(": {messages} cycles, ")), "{said}");
    let missing = info["channels"]["telemetry"]["missing"].as_u64().unwrap();
    assert!(
        missing <= lost(&said, Topic::Telemetry),
        "{missing}: {said}"
    );
    // Fails as well if the disk was full before.
    fs::write(disk.join("rest"), vec![0; 1 << 20]).unwrap_err();
    let mut again = run.daemon.place().record("disk/again.mcap");
    assert_says(&again.output(), 3, &["again.mcap", "No space left"]);
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

/// Copies a recording with changed channels and telemetry.
fn rewrite(
    from: &Path,
    to: &Path,
    mut change_channel: impl FnMut(&mut Channel),
    mut change: impl FnMut(&mut Telemetry),
) {
    let mut reader = Reader::new(fs::File::open(from).unwrap()).unwrap();
    let mut writer = Writer::new(fs::File::create(to).unwrap(), "ros2", "test").unwrap();
    let mut ids = BTreeMap::new();
    while let Some(item) = reader.next_item().unwrap() {
        let Item::Message(message) = item else {
            continue;
        };
        let id = *ids.entry(message.channel_id).or_insert_with(|| {
            let mut channel = message.channel.clone();
            change_channel(&mut channel);
            writer.add_channel(&channel).unwrap()
        });
        let mut data = message.data.to_vec();
        if message.channel.schema.ends_with("Telemetry") {
            let mut record = Telemetry::default();
            decode(&data, &mut record).unwrap();
            change(&mut record);
            data = encode(&record).unwrap();
        }
        let stamp = Stamp {
            sequence: message.sequence,
            log_ns: message.log_ns,
            publish_ns: message.publish_ns,
        };
        writer.write(id, stamp, &data).unwrap();
    }
    writer.finish().unwrap();
}

/// A recording of a tracked curve in a new place. Made once: those who read it need no daemon.
fn tracked_curve() -> (Place, PathBuf) {
    static MADE: LazyLock<Vec<u8>> = LazyLock::new(|| {
        let mut run = Recorded::start(PATIENT);
        track(&run.daemon.connect(), &curve());
        run.end();
        fs::read(&run.file).unwrap()
    });
    let place = Place::new();
    let file = place.folder().join("run.mcap");
    fs::write(&file, &*MADE).unwrap();
    (place, file)
}

#[test]
fn the_first_difference_is_named_and_saved_so_that_it_shows_again_alone() {
    let (place, file) = tracked_curve();
    let altered = file.with_file_name("altered.mcap");
    let mut solved = 0;
    rewrite(
        &file,
        &altered,
        |_| {},
        |record| {
            solved += u32::from(record.plan_length > 0);
            // Tracking for a while: chunks were appended meanwhile.
            if solved == 150 || solved == 160 {
                record.plan[3] += f64::EPSILON;
            }
        },
    );
    let verify = |file: &str| -> Value {
        let line = format!("cdcrctl replay --format json --verify {file}");
        let output = place.start(&line).output();
        assert_eq!(output.status.code(), Some(1), "{}", text(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let all = verify("altered.mcap");
    let first = &all["first_difference"];
    assert_eq!(
        (&all["different"], &first["what"]),
        (&2.into(), &"plan[3]".into()),
        "{all}"
    );
    let alone = verify(first["inputs"].as_str().unwrap());
    assert_eq!(
        (&alone["cycles"], &alone["different"]),
        (&1.into(), &1.into()),
        "{alone}"
    );
    for name in ["cycle", "what", "recorded", "computed"] {
        assert_eq!(alone["first_difference"][name], first[name], "{name}");
    }
}

#[test]
fn other_settings_are_compared_with_what_was_commanded() {
    let (place, file) = tracked_curve();
    let with = |changes: &str| place.json(&format!("replay --with {changes} run.mcap"));
    let [same, others] = [
        "velocity_rule=inertia",
        "solver=gauss-newton,horizon_steps=5",
    ]
    .map(with);
    let most = |found: &Value| found["rates_apart_rad_s"]["max"].as_f64().unwrap();
    assert!(same["cycles"].as_u64().unwrap() > 150, "{same}");
    // Only a solve that the machine shortened gives another result.
    let is_cut_short = same["recorded_cut_short"].as_u64().unwrap() > 0;
    assert!(most(&same) == 0.0 || is_cut_short, "{same}");
    assert!(most(&others) > 1e-6, "{others}");
    assert_eq!(same["cycles"], others["cycles"]);
    assert_ne!(same["with"]["evaluations"], others["with"]["evaluations"]);
    place.says("cdcrctl replay --with horizon=5 run.mcap", 2, &["horizon"]);
    // Plans of a version with other control blocks have another length.
    let other = file.with_file_name("other.mcap");
    rewrite(
        &file,
        &other,
        |_| {},
        |record| record.plan_length = record.plan_length.saturating_sub(1),
    );
    for how in ["--with velocity_rule=inertia", "--verify"] {
        let line = format!("cdcrctl replay {how} other.mcap");
        place.says(&line, 1, &["a version with other control blocks"]);
    }
}

#[test]
fn a_recording_of_another_version_is_refused_and_both_are_named() {
    let (place, file) = tracked_curve();
    let other = file.with_file_name("other.mcap");
    rewrite(
        &file,
        &other,
        |channel| {
            // Standard messages have no version of this project.
            if let Some(version) = channel.metadata.get_mut("wire_type") {
                version.push_str("99");
            }
        },
        |_| {},
    );
    let name = <Telemetry as Struct>::layout(&Telemetry::default()).type_name;
    for task in ["info", "replay --verify", "convert --csv tables"] {
        let found = format!("{name}99");
        let ours = format!("reads {name}:");
        // The order of the messages is random; each one has its two versions.
        let said = place.says(
            &format!("cdcrctl {task} other.mcap"),
            1,
            &["was recorded as", "reads"],
        );
        assert!(said.contains(&found) == said.contains(&ours), "{said}");
    }
}

#[test]
fn of_a_damaged_recording_what_is_before_the_damage_is_saved() {
    let (place, file) = tracked_curve();
    let mut bytes = fs::read(&file).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 1000].fill(0x5a);
    fs::write(file.with_file_name("damaged.mcap"), &bytes).unwrap();
    fs::write(file.with_file_name("begun.mcap"), &bytes[..8]).unwrap();
    let says = [
        "error: damaged.mcap: the recording is damaged",
        "; recover the part before the damage with `cdcrctl info --repair damaged.mcap`",
    ];
    place.says("cdcrctl info damaged.mcap", 1, &says);
    let says = ["is damaged", "saved", "the first"];
    place.says("cdcrctl info --repair damaged.mcap", 0, &says);
    place.says("cdcrctl info damaged-repaired.mcap", 0, &["telemetry"]);
    place.says("cdcrctl info --repair begun.mcap", 1, &["no message"]);
    assert!(!file.with_file_name("begun-repaired.mcap").exists());
}

#[test]
fn a_file_at_its_limit_ends_the_recording_like_a_full_disk() {
    let mut run = Recorded::start(PATIENT);
    let limit = Rlimit {
        current: Some(200_000),
        maximum: None,
    };
    let id = Pid::from_raw(run.recorder.id().try_into().unwrap());
    prlimit(id, Resource::Fsize, limit).unwrap();
    let says = ["run.mcap: the recording ended there: File too large"];
    assert_says(&run.recorder.output(), 3, &says);
}

#[test]
fn a_recording_whose_file_was_removed_is_an_error() {
    let mut run = Recorded::start(PATIENT);
    fs::remove_file(&run.file).unwrap();
    run.recorder.signal(Signal::INT);
    let says = ["run.mcap was removed during the recording"];
    assert_says(&run.recorder.output(), 1, &says);
}

#[test]
fn what_is_no_recording_is_refused_with_the_reason() {
    let run = Recorded::start(PATIENT);
    let place = run.daemon.place();
    place.write("empty.mcap", "");
    place.write("foreign.mcap", "time_s,x_m\n0,1\n");
    for (file, reason) in [
        ("empty.mcap", "the file is empty"),
        ("foreign.mcap", "not an MCAP file"),
        ("missing.mcap", "No such file"),
    ] {
        place.says(&format!("cdcrctl info {file}"), 1, &[file, reason]);
    }
    let exists = |file, or| format!("{file} exists: remove it {or}");
    let another = exists("run.mcap", "or name another");
    place.says("cdcrctl record -o run.mcap", 1, &[&another]);
    let table = place.folder().join("tables/telemetry.csv");
    fs::create_dir(table.parent().unwrap()).unwrap();
    fs::write(&table, "mine").unwrap();
    let refused = exists("tables/telemetry.csv", "or use another --csv folder");
    place.says("cdcrctl convert run.mcap --csv tables", 1, &[&refused]);
    // A table without the others is not a result.
    assert_eq!(fs::read_dir(table.parent().unwrap()).unwrap().count(), 1);
    assert_eq!(fs::read_to_string(table).unwrap(), "mine");
}
