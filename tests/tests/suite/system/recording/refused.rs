//! Files that are not recordings, of another version, or damaged.

use std::fs;

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::message::Struct;
use cdcr_tests::STALL_TOLERANT;

use super::recorded::Recorded;
use super::{rewrite, tracked_curve};

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
        let reported = place.checked(
            &format!("cdcrctl {task} other.mcap"),
            1,
            &["was recorded as", "reads"],
        );
        assert!(
            reported.contains(&found) == reported.contains(&ours),
            "{reported}"
        );
    }
}

#[test]
fn of_a_damaged_recording_all_that_is_whole_is_saved() {
    let (place, file) = tracked_curve();
    let whole = place.json("replay --verify run.mcap");
    let bytes = fs::read(&file).unwrap();
    let at = |part: &[u8]| {
        let found = bytes.windows(part.len()).position(|bytes| bytes == part);
        found.unwrap()
    };
    let early = bytes.len() / 4;
    // The length of the attachment status.json lies 25 bytes before its name.
    let length = at(b"status.json") - 4 - 16 - 8 + 1;
    let mut wrong = bytes.clone();
    wrong[early] ^= 1;
    wrong[length] ^= 1;
    wrong[bytes.len() / 2..][..1000].fill(0x5a);
    fs::write(file.with_file_name("damaged.mcap"), &wrong).unwrap();
    let says = [
        "error: damaged.mcap: the recording is damaged",
        "; recover all intact parts with `cdcrctl info --repair damaged.mcap`",
    ];
    place.checked("cdcrctl info damaged.mcap", 1, &says);
    let says = [
        "damaged.mcap: the recording is damaged; ",
        " saved in damaged-repaired.mcap, ",
        ", attachment status.json",
        " s from ",
    ];
    let reported = place.checked("cdcrctl info --repair damaged.mcap", 0, &says);
    // Two damaged places may lie in one chunk, or in adjacent ones, which are one loss.
    let losses = reported.matches("\nlost: ").count();
    assert!((2..=3).contains(&losses), "{reported}");
    place.checked("cdcrctl info damaged-repaired.mcap", 0, &["telemetry"]);
    place.checked("cdcrctl convert damaged-repaired.mcap --csv tables", 0, &[]);
    let says = ["cycles reproduced", "missing: ", "after cycle "];
    place.checked("cdcrctl replay --verify damaged-repaired.mcap", 0, &says);
    let saved = place.json("replay --verify damaged-repaired.mcap");
    let count = |verified: &serde_json::Value, name: &str| verified[name].as_u64().unwrap();
    let [saved_cycles, missing] = ["cycles", "missing_records"].map(|name| count(&saved, name));
    assert_eq!(saved_cycles + missing, count(&whole, "cycles"), "{saved}");
    assert!(missing > 0 && 4 * missing < saved_cycles, "{saved}");
    assert_eq!(count(&saved, "different"), 0, "{saved}");
    fs::write(file.with_file_name("begun.mcap"), &bytes[..8]).unwrap();
    place.checked("cdcrctl info --repair begun.mcap", 1, &["no message"]);
    assert!(!file.with_file_name("begun-repaired.mcap").exists());
}

#[test]
fn what_is_no_recording_is_refused_with_the_reason() {
    let run = Recorded::start(STALL_TOLERANT);
    let place = run.daemon.place();
    place.write("empty.mcap", "");
    place.write("foreign.mcap", "time_s,x_m\n0,1\n");
    for (file, reason) in [
        ("empty.mcap", "the file is empty"),
        ("foreign.mcap", "not an MCAP file"),
        ("missing.mcap", "No such file"),
    ] {
        place.checked(&format!("cdcrctl info {file}"), 1, &[file, reason]);
    }
    let exists = |file, or| format!("{file} exists: remove it {or}");
    let another = exists("run.mcap", "or name another");
    place.checked("cdcrctl record -o run.mcap", 1, &[&another]);
    let table = place.folder().join("tables/telemetry.csv");
    fs::create_dir(table.parent().unwrap()).unwrap();
    fs::write(&table, "mine").unwrap();
    let refused = exists("tables/telemetry.csv", "or use another --csv folder");
    place.checked("cdcrctl convert run.mcap --csv tables", 1, &[&refused]);
    // A table without the others is not a result.
    assert_eq!(fs::read_dir(table.parent().unwrap()).unwrap().count(), 1);
    assert_eq!(fs::read_to_string(table).unwrap(), "mine");
}
