//! docs/calibration.md from start to end: its commands, unchanged, with a real daemon and a robot that
//! differs from its configuration.

use std::fs;
use std::path::Path;
use std::process::Command;

use cdcr_client::Connection;
use cdcr_scratch::Scratch;
use cdcr_shared_types::codes::{Mode, RequestKind};
use cdcr_tests::{
    Daemon, Place, Program, STALL_TOLERANT, TIMEOUT, ask_for, assert_output, binary, text,
    until_undisturbed, wait_mode, wait_record, wait_until,
};
use rustix::process::{Pid, Resource, Rlimit, Signal, prlimit};
use serde_json::Value;

const PAGE: &str = include_str!("../../../../docs/calibration.md");

/// The code blocks of the page in this language.
fn blocks(language: &str) -> Vec<&'static str> {
    let begin = format!("```{language}\n");
    let parts = PAGE.split(&begin).skip(1);
    parts
        .map(|part| part.split("```").next().unwrap())
        .collect()
}

/// The commands of the page, in order. With `shorter`, durations are divided by it, and only the commands
/// before the paste are returned.
fn commands(shorter: Option<u32>) -> Vec<Vec<String>> {
    let lines = blocks("console").into_iter().flat_map(str::lines);
    let lines = lines.filter_map(|line| line.strip_prefix("$ "));
    let commands = lines.map(|line| line.split_whitespace().map(str::to_owned).collect());
    let Some(factor) = shorter else {
        return commands.collect();
    };
    let mut commands: Vec<Vec<String>> = commands.collect();
    let is_geometry = |command: &Vec<String>| command.iter().any(|word| word == "geometry");
    let end = commands.iter().position(is_geometry).unwrap();
    commands.truncate(end + 1);
    // Other tests cover the duration of a path, and two seconds show the noise.
    commands.retain(|command| !command.iter().any(|word| word == "--dry-run"));
    for command in &mut commands {
        if command.iter().any(|word| word == "noise") {
            command.extend(["--duration", "6s"].map(str::to_owned));
        }
    }
    for word in commands.iter_mut().flatten() {
        let seconds = word.strip_suffix('s').and_then(|s| s.parse::<u32>().ok());
        if let Some(seconds) = seconds {
            *word = format!("{}ms", 1000 * seconds / factor);
        }
    }
    commands
}

/// Output of a command of the page. Repeated if a busy machine delayed the points for the daemon or the
/// commands for the robot too long.
fn run(place: &Place, folder: &Path, arguments: &[&str]) -> String {
    until_undisturbed(&arguments.join(" "), || {
        let mut command = place.command("cdcrctl");
        let output = command
            .args(arguments)
            .current_dir(folder)
            .output()
            .unwrap();
        let printed = text(&output);
        if output.status.success() {
            return Some(printed);
        }
        let is_late = ["came too late", "bends by", "has sent nothing"].iter();
        assert!(
            is_late.copied().any(|why| printed.contains(why)),
            "{arguments:?}: {printed}"
        );
        fs::remove_file(folder.join(arguments[3])).unwrap();
        place.checked("cdcrctl home --wait", 0, &[]);
        None
    })
}

/// Result of a recording for a daemon's robot, as JSON.
fn geometry(place: &Place, folder: &Path, file: &str) -> Value {
    let arguments = ["calibrate", "geometry", file, "--format", "json"];
    serde_json::from_str(&run(place, folder, &arguments)).unwrap()
}

fn rms_mm(found: &Value, robot: &str) -> f64 {
    1e3 * found["tip_error"][robot]["rms_m"].as_f64().unwrap()
}

/// Checks that the result is the robot of the page's configuration, with everything that positions can
/// determine.
///
/// The whole page is checked against its final numbers. A part of its data is less exact: the truth must be
/// within three of the 95 % bounds stated in the result.
fn check_found(found: &Value, is_whole: bool) {
    let truth = blocks("toml")[0];
    let (_, truth) = truth.split_once("simulated_geometry = ").unwrap();
    let truth: Vec<[f64; 3]> = serde_json::from_str(truth.lines().next().unwrap()).unwrap();
    let list = |key: &str| found[key].as_array().unwrap().clone();
    let check = |name: &str, value: &Value, within: &Value, truth: f64, most: f64| {
        let [value, within] = [value, within].map(|number| number.as_f64().unwrap());
        let off = (value - truth).abs();
        let share = off / within;
        println!("{name}: off by {off}, {share:.2} of its bound; held to {most}");
        let most = if is_whole { most } else { most + 3.0 * within };
        assert!(off < most, "{name}: {off}, of a bound of {within}");
    };
    for (j, [length_m, radius_m, angle_rad]) in truth.into_iter().enumerate() {
        for (parameter, truth, most) in [
            ("length", length_m, 2e-3 * length_m),
            ("cable radius", radius_m, 2e-3 * radius_m),
            ("cable angle", angle_rad, 0.2_f64.to_radians()),
        ] {
            let name = format!("{parameter} of section {}", j + 1);
            let all = list("estimates");
            let one = all.iter().find(|one| one["parameter"] == name.as_str());
            let one = one.expect(&name);
            check(&name, &one["found"], &one["within_95"], truth, most);
        }
    }
    // 0.1 mm in the first cable of each section, relative to their mean.
    for (cable, zero) in list("cable_zeros").iter().enumerate() {
        let is_first = cable.is_multiple_of(3);
        let truth_m = 1e-4 / 3.0 * if is_first { 2.0 } else { -1.0 };
        let name = format!("zero of cable {}", cable + 1);
        check(&name, &zero["found_m"], &zero["within_95_m"], truth_m, 5e-5);
    }
    let held = list("held");
    let mut held: Vec<_> = held
        .iter()
        .map(|held| held["parameter"].as_str().unwrap())
        .collect();
    held.sort_unstable();
    assert_eq!(held, ["base rotation about z", "sensor position z"]);
}

#[test]
fn the_page_finds_the_robot_and_its_paste_makes_the_error_small() {
    let folder = Scratch::temporary().unwrap();
    let folder = folder.path();
    let mut configuration = blocks("toml")[0].to_owned();
    let (mut daemon, mut printed, mut errors_mm) = (None::<Daemon>, String::new(), Vec::new());
    // Three minutes; otherwise half of the page, in a third of the time.
    let is_whole = std::env::var_os("CDCR_CALIBRATION_WHOLE").is_some();
    for command in commands((!is_whole).then_some(3)) {
        let command: Vec<&str> = command.iter().map(String::as_str).collect();
        match command[..] {
            ["cdcrd", "run", ..] => {
                if let Some(mut before) = daemon.take() {
                    // Between the two, the page has the paste.
                    assert_eq!(before.stop().code(), Some(0));
                    let sections = printed.split("# Replaces").nth(1).unwrap();
                    configuration = [configuration.as_str(), "\n# Replaces", sections].concat();
                }
                daemon = Some(Daemon::start(&configuration));
            }
            ["cdcrctl", ref arguments @ ..] => {
                let place = daemon.as_ref().unwrap().place();
                printed = run(place, folder, arguments);
                if let ["calibrate", "geometry", file, ..] = arguments {
                    let found = geometry(place, folder, file);
                    check_found(&found, is_whole);
                    errors_mm.push((
                        rms_mm(&found, "configured_held_out"),
                        rms_mm(&found, "found_held_out"),
                    ));
                }
            }
            _ => panic!("{command:?}"),
        }
    }
    // Before and after the paste: with the configuration of that time, and with the result.
    println!("held out, configured and found: {errors_mm:?} mm");
    let before = errors_mm[0];
    assert!(before.0 > 15.0 && before.1 < 2.0, "{errors_mm:?}");
    assert_eq!(errors_mm.len(), if is_whole { 2 } else { 1 });
    if let Some(after) = errors_mm.get(1) {
        assert!(after.0 < 0.2 * before.0, "{errors_mm:?}");
    }
}

/// One section of a `laboratory` robot whose tip is measured.
fn one_section() -> Daemon {
    let section = include_str!("../../../../configs/one-section.toml");
    let lab = "[link]\nsimulated = \"laboratory\"\nsimulated_tip = true\n";
    Daemon::start(&format!("{STALL_TOLERANT}{lab}{section}"))
}

/// A section longer than configured: when straight, its tip is where no reference is allowed. Its path is
/// accepted nevertheless.
#[test]
fn a_section_that_is_longer_than_configured_is_excited_too() {
    let section = include_str!("../../../../configs/one-section.toml");
    let longer = "simulated_geometry = [[0.315, 0.0125, 0.0]]\n";
    let lab = "[link]\nsimulated = \"laboratory\"\nsimulated_tip = true\n";
    let daemon = Daemon::start(&format!("{STALL_TOLERANT}{lab}{longer}{section}"));
    let folder = daemon.place().folder();
    // The offset exists from the first measurement on, but its estimate takes some seconds.
    let mut telemetry = daemon.connect().telemetry().unwrap();
    wait_record(&mut telemetry, |record| record.tip_offset_m[2] > 0.0148);
    let excite = "calibrate excite -o moved.csv --duration 20s";
    let excite: Vec<&str> = excite.split(' ').collect();
    run(daemon.place(), folder, &excite);
    let found = geometry(daemon.place(), folder, "moved.csv");
    let lengths = found["estimates"].as_array().unwrap();
    let length = |estimate: &&Value| estimate["parameter"] == "length of section 1";
    let found_m = lengths.iter().find(length).unwrap()["found"].as_f64();
    assert!((found_m.unwrap() - 0.315).abs() < 2e-3, "{found_m:?}");
}

/// Two sections reach a point of the tip in two poses. A path that makes them jump from one into the other has no duration that is long
/// enough.
#[test]
fn two_sections_are_excited_within_the_duration_that_is_given() {
    let sections = include_str!("../../../../configs/two-sections.toml");
    let lab = "[link]\nsimulated = \"laboratory\"\nsimulated_tip = true\n\
        simulated_geometry = [[0.315, 0.01275, 0.05], [0.288, 0.0122, 0.65]]\n";
    let daemon = Daemon::start(&format!("{STALL_TOLERANT}{lab}{sections}"));
    let place = daemon.place();
    for options in ["20s", "35s --seed 4", "35s --rate-max 1.5 --seed 1"] {
        let line = format!("cdcrctl calibrate excite -o moved.csv --dry-run --duration {options}");
        place.checked(&line, 0, &["length"]);
    }
    let excite = "calibrate excite -o moved.csv --duration 25s";
    let excite: Vec<&str> = excite.split(' ').collect();
    run(place, place.folder(), &excite);
    let found = geometry(place, place.folder(), "moved.csv");
    for (section, true_m) in [("1", 0.315), ("2", 0.288)] {
        let name = format!("length of section {section}");
        let mut estimates = found["estimates"].as_array().unwrap().iter();
        let length = estimates.find(|estimate| estimate["parameter"] == *name);
        let found_m = length.unwrap()["found"].as_f64().unwrap();
        assert!((found_m - true_m).abs() < 3e-3, "{name}: {found_m}");
    }
}

const EXCITE: &str = "cdcrctl calibrate excite -o moved.csv --duration 30s";

#[test]
fn an_exciting_path_that_cannot_be_is_refused_before_anything_moves() {
    let daemon = one_section();
    let place = daemon.place();
    let refused = |line: &str, why: &str| {
        place.checked(line, 1, &[why]);
        assert!(!place.folder().join("moved.csv").exists(), "{line}");
    };
    place.checked(
        &format!("{EXCITE} --dry-run"),
        0,
        &["length", "rate", "bend", "tip error"],
    );
    refused(
        &format!("{EXCITE} --rate-max 0.05"),
        "too short for --rate-max",
    );
    // The named duration is enough.
    let line = "cdcrctl calibrate excite -o moved.csv --dry-run --duration";
    let short = ["too short for a round of this robot", "use --duration "];
    let reported = place.checked(&format!("{line} 5s"), 1, &short);
    let (_, needed) = reported.split_once("use --duration ").unwrap();
    let (needed, _) = needed.split_once(' ').unwrap();
    place.checked(&format!("{line} {needed}"), 0, &["length"]);
    place.checked(
        "cdcrctl obstacle add --id 1 --at 0.12,0,0.25 --radius 0.03",
        0,
        &[],
    );
    refused(EXCITE, "nothing moved");
    place.checked("cdcrctl obstacle remove 1", 0, &[]);
    place.checked("cdcrctl goto 0.1008,0,0.2761 --speed 0.2", 0, &[]);
    refused(&format!("{EXCITE} --bend-max 0.3"), "section 1 bends by 0.");
    let status = daemon.connect().status(TIMEOUT).unwrap();
    assert_eq!(
        (status.mode, status.lease_holder),
        (Mode::Holding.code(), 0)
    );
    let without_tip = Daemon::start(STALL_TOLERANT);
    without_tip
        .place()
        .checked(EXCITE, 1, &["calibration needs cable lengths and the tip"]);
}

/// A round takes 15 s; with a rate that is asked for, it is as short as the robot and that rate permit.
#[test]
fn an_exciting_path_is_as_fast_as_is_asked_for() {
    let daemon = one_section();
    let rate_rad_s = |options: &str| -> f64 {
        let line = format!("{EXCITE} --dry-run{options}");
        let printed = daemon.place().checked(&line, 0, &["length"]);
        let (_, rest) = printed.split_once("  rate ").unwrap();
        rest.split_whitespace().next().unwrap().parse().unwrap()
    };
    let usual = rate_rad_s("");
    for asked in [1.2, 1.8] {
        let fast = rate_rad_s(&format!(" --rate-max {asked}"));
        println!("{usual} rad/s, asked for {asked}: {fast}");
        assert!(fast > 0.8 * asked && fast <= asked && fast > 1.2 * usual);
    }
}

/// Starts it, and waits until its file contains rows. It ignores SIGXFSZ, which a full disk does not send.
fn excited(daemon: &Daemon, file: &str) -> Program {
    let mut telemetry = daemon.connect().telemetry().unwrap();
    let mut command = daemon.place().command("cdcrctl");
    let environment: Vec<_> = command
        .get_envs()
        .filter_map(|(name, value)| Some((name.to_owned(), value?.to_owned())))
        .collect();
    command = Command::new("sh");
    let line = format!(
        "trap '' XFSZ; exec {} calibrate excite -o {file} --duration 30s",
        binary("cdcrctl").display()
    );
    command.args(["-c", &line]).envs(environment);
    command.current_dir(daemon.place().folder());
    let program = Program::start(&mut command);
    wait_mode(&mut telemetry, Mode::Tracking);
    wait_until("rows", || rows(daemon, file) > 10);
    program
}

fn rows(daemon: &Daemon, file: &str) -> usize {
    let text = fs::read_to_string(daemon.place().folder().join(file));
    text.map_or(0, |text| text.lines().count())
}

#[test]
fn what_comes_between_leaves_the_robot_held_and_the_rows_until_then() {
    let mut daemon = one_section();
    let ends = |mut program: Program, status: i32, parts: &[&str]| {
        assert_output(&program.output(), status, parts);
    };
    let holds = |connection: &Connection| {
        wait_mode(&mut connection.telemetry().unwrap(), Mode::Holding);
    };

    let program = excited(&daemon, "interrupted.csv");
    program.signal(Signal::INT);
    ends(
        program,
        130,
        &["interrupted: released the lease, the daemon holds"],
    );
    holds(&daemon.connect());
    assert!(rows(&daemon, "interrupted.csv") > 10);
    daemon.place().checked("cdcrctl home --wait", 0, &[]);

    let program = excited(&daemon, "held.csv");
    ask_for(&daemon.connect(), RequestKind::Hold);
    ends(
        program,
        1,
        &[
            "held.csv: ",
            "rows until then",
            "A client (cdcrctl hold, stop, ...) or the signal SIGUSR1 asked for it",
        ],
    );
    holds(&daemon.connect());
    daemon.place().checked("cdcrctl home --wait", 0, &[]);

    let program = excited(&daemon, "full.csv");
    let written = fs::metadata(daemon.place().folder().join("full.csv")).unwrap();
    let full = Rlimit {
        current: Some(written.len() + 1000),
        maximum: None,
    };
    let id = Pid::from_raw(program.id().try_into().unwrap());
    prlimit(id, Resource::Fsize, full).unwrap();
    ends(program, 1, &["full.csv", "File too large"]);
    holds(&daemon.connect());
    daemon.place().checked("cdcrctl home --wait", 0, &[]);

    let program = excited(&daemon, "gone.csv");
    daemon.kill();
    ends(program, 1, &["gone.csv: ", "rows until then"]);
}

/// A recording of `cdcrctl record` during an exciting path gives the same result as the rows of that path,
/// also without a daemon. Other files are rejected with a reason.
#[test]
fn a_recording_gives_the_same_result_as_its_rows() {
    const LENGTH_M: f64 = 0.3;
    let mut daemon = one_section();
    let folder = daemon.place().folder().to_owned();
    let whole = folder.join("moved.mcap");
    let mut recorder = daemon.place().record("moved.mcap");
    let excite = [
        "calibrate",
        "excite",
        "-o",
        "moved.csv",
        "--duration",
        "20s",
    ];
    run(daemon.place(), &folder, &excite);
    recorder.signal(Signal::INT);
    assert_output(&recorder.output(), 0, &["moved.mcap"]);
    let of_rows = geometry(daemon.place(), &folder, "moved.csv");
    assert_eq!(daemon.stop().code(), Some(0));
    let of_recording = geometry(daemon.place(), &folder, "moved.mcap");

    let count = |found: &Value| found["rows"].as_u64().unwrap();
    assert!(count(&of_recording) >= count(&of_rows) && count(&of_rows) > 100);
    let [rows, recording] = [&of_rows, &of_recording].map(|found| found["estimates"].as_array());
    let (rows, recording) = (rows.unwrap(), recording.unwrap());
    assert_eq!(rows.len(), recording.len());
    for (row, recorded) in rows.iter().zip(recording) {
        assert_eq!(row["parameter"], recorded["parameter"]);
        let number = |of: &Value, key: &str| of[key].as_f64().unwrap();
        let apart = (number(row, "found") - number(recorded, "found")).abs();
        let within = number(row, "within_95") + number(recorded, "within_95");
        assert!(apart < within, "{row} {recorded}");
        if recorded["parameter"] == "length of section 1" {
            let off_m = (number(recorded, "found") - LENGTH_M).abs();
            let most_m = 2e-3 * LENGTH_M + 3.0 * number(recorded, "within_95");
            assert!(off_m < most_m, "{off_m}");
        }
    }

    let bytes = fs::read(&whole).unwrap();
    let default = include_str!("../../../../configs/default.toml");
    for (name, content) in [
        ("cut.mcap", &bytes[..bytes.len() * 4 / 5]),
        ("begun.mcap", &bytes[..8]),
        ("empty.mcap", b""),
        ("rows.mcap", b"t_s,cable_1_m\n"),
        ("three.toml", default.as_bytes()),
    ] {
        fs::write(folder.join(name), content).unwrap();
    }
    // Detected by its first bytes, independent of the name.
    fs::copy(&whole, folder.join("whole.dat")).unwrap();
    for (arguments, status, expected) in [
        ("cut.mcap", 0, "length of section 1"),
        ("whole.dat", 0, "length of section 1"),
        ("begun.mcap", 1, "contains no telemetry of cdcrd"),
        ("empty.mcap", 1, "the file is empty"),
        ("rows.mcap", 1, "rows.mcap"),
        ("none.mcap", 1, "cannot read none.mcap"),
        (
            "moved.mcap --config three.toml",
            1,
            "moved.mcap is of another robot: it has 1 section, three.toml has 3",
        ),
    ] {
        let line = format!("cdcrctl calibrate geometry {arguments}");
        daemon.place().checked(&line, status, &[expected]);
    }

    let mut command = daemon.place().command("cdcrctl");
    let geometry = ["calibrate", "geometry", "cut.mcap"];
    let output = command.args(geometry).current_dir(&folder).output();
    let reported = text(&output.unwrap());
    let repair = "cut.mcap is truncated: only complete messages were read; recover them with `cdcrctl info --repair cut.mcap`";
    assert!(reported.contains(repair), "{reported}");

    let without_tip = Daemon::start(STALL_TOLERANT);
    let place = without_tip.place();
    place.checked(
        "cdcrctl record -o rest.mcap --duration 500ms",
        0,
        &["rest.mcap"],
    );
    let line = "cdcrctl calibrate geometry rest.mcap";
    place.checked(line, 1, &["rest.mcap: measured: cable lengths, and no tip"]);
}
