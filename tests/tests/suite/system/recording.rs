//! `cdcrctl record`, and the commands that read its files.

mod disk;
mod recomputed;
mod recorded;
mod refused;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;

use cdcr_client::channels::Topic;
use cdcr_client::{Connection, ObstacleSender, Spiral};
use cdcr_interchange::mcap::{Channel, Item, Reader, Stamp, Writer};
use cdcr_interchange::{decode, encode};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::EventKind;
use cdcr_tests::{Place, STALL_TOLERANT, TIMEOUT, assert_output, ball, track, until_undisturbed};
use rustix::process::Signal;

use recorded::Recorded;

/// Number of lost messages of a topic, as reported by a recorder.
fn lost(reported: &str, topic: Topic) -> u64 {
    let counts = reported.lines().filter_map(|line| {
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
    let (run, records, reported) = until_undisturbed("a recorder reads in time", || {
        let mut run = Recorded::start(STALL_TOLERANT);
        let connection = run.daemon.connect();
        let _sender = know_an_obstacle(&connection);
        let records = track(&connection, &curve());
        let reported = run.end();
        let is_whole = [Topic::Telemetry, Topic::Reference, Topic::Obstacles]
            .iter()
            .all(|topic| lost(&reported, *topic) == 0);
        is_whole.then_some((run, records, reported))
    });
    assert!(reported.contains("1 obstacle update,"), "{reported}");
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
        assert_eq!(channel["missing"], lost(&reported, topic), "{info}");
    }
    let place = run.daemon.place();
    let small = "ulimit -f 8 && exec \"$0\" convert run.mcap --csv tables";
    let mut limited = Command::new("sh");
    let program = place.command("cdcrctl");
    limited.args(["-c", small]).arg(program.get_program());
    let output = limited.current_dir(place.folder()).output().unwrap();
    assert_output(&output, 1, &["cannot write into tables", "File too large"]);
    assert!(!run.file.with_file_name("tables").exists());
    place.checked("cdcrctl convert run.mcap --csv tables", 0, &[]);
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

#[test]
fn a_recording_ends_with_its_daemon() {
    let mut run = Recorded::start(STALL_TOLERANT);
    run.daemon.stop();
    assert_output(&run.recorder.output(), 0, &["the daemon ended"]);
    assert_eq!(run.info()["cut"], false);
}

#[test]
fn of_a_recorder_that_is_killed_the_last_second_is_missing_at_most() {
    let mut run = Recorded::start(STALL_TOLERANT);
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
    place.checked("cdcrctl info run.mcap --repair", 0, &["is truncated"]);
    fs::rename(run.file.with_file_name("run-repaired.mcap"), &run.file).unwrap();
    let repaired = run.info();
    assert_eq!(repaired["cut"], false);
    assert_eq!(repaired["channels"], info["channels"]);
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
        let mut run = Recorded::start(STALL_TOLERANT);
        track(&run.daemon.connect(), &curve());
        run.end();
        fs::read(&run.file).unwrap()
    });
    let place = Place::new();
    let file = place.folder().join("run.mcap");
    fs::write(&file, &*MADE).unwrap();
    (place, file)
}
