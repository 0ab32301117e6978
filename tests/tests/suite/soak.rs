//! A daemon at 5 ms under all floods does not grow in memory, file descriptors, mappings, threads or files.
//! `docs/testing.md` describes a run of half an hour and its output.

use std::fmt::Write as _;
use std::fs;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError, RwLock};
use std::time::{Duration, Instant};

use cdcr_client::Connection;
use cdcr_shared_types::{Service, ipc};
use cdcr_testbed::system::counts::{files, status};
use cdcr_tests::load::{self, Busy, Done};
use cdcr_tests::{Daemon, EndWhenDropped, Place, TIMEOUT, asked, wait_until};

/// Timing is not the subject; everything else is as in operation.
const CONFIGURATION: &str = "[cycle]\nmiss_limit = 1000000\nwatchdog_ms = 60000.0\n";
/// Turns until the daemon has reached its size: the first clients of each kind map its memory and theirs.
const WARM_UP_TURNS: usize = 3;
/// Least number of turns after that. At least six turns lie between the first and the last quarter, so growth
/// in one turn of six always shows.
const TURNS_MIN: usize = 12;
/// Duration of the spiral of one turn, which gives one sample.
const TURN_S: f64 = 0.15;
/// Time without changes after which the daemon has noticed that the clients of a turn have left.
const SETTLED: Duration = Duration::from_millis(100);
/// Least load, as one part in this many of the nominal load.
const LOAD_PART: u64 = 5;
/// Largest number of rows in the printed table.
const ROWS: usize = 40;

/// Two flooded daemons would load each other.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Measured quantities, and the allowed growth of the median from the first to the last quarter.
///
/// Counts must not grow at all. Memory may grow by one part in fifty or 1 MB: the allocator keeps memory, and
/// the high-water marks of its arenas rise slightly while the mix of clients changes.
const COLUMNS: [(&str, u64, u64); 13] = [
    ("rss_kB", 50, 1024),
    ("locked_kB", 50, 1024),
    ("peak_kB", 50, 1024),
    ("data_kB", 50, 1024),
    ("fds", 0, 0),
    ("maps", 0, 0),
    ("threads", 0, 0),
    ("shm_files", 0, 0),
    ("shm_kB", 0, 0),
    ("root_files", 0, 0),
    ("living", 0, 0),
    ("dead", 0, 0),
    ("cycles", 0, u64::MAX),
];

#[derive(Debug, Clone, Copy)]
struct Sample {
    time_s: f64,
    values: [u64; COLUMNS.len()],
}

/// Duration: `CDCR_SOAK_S`, or 8 s.
fn duration() -> Duration {
    Duration::from_secs(asked("CDCR_SOAK_S").unwrap_or(8))
}

#[test]
fn a_flooded_daemon_with_a_simulated_robot_does_not_grow() {
    soak("simulated");
}

#[test]
fn a_flooded_daemon_behind_a_driver_does_not_grow() {
    soak("driver");
}

/// Floods a daemon, and measures it whenever the temporary clients are away.
fn soak(link: &str) {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let duration = duration();
    let mut daemon = Daemon::start(&format!("[link]\nkind = \"{link}\"\n{CONFIGURATION}"));
    let (place, ending, done) = (daemon.place(), AtomicBool::new(false), Done::default());
    let least = Done::part_of(duration.as_secs(), LOAD_PART);
    let (gate, killed) = (RwLock::new(()), AtomicU64::new(0));
    let mut samples = Vec::new();
    std::thread::scope(|scope| {
        let _ends = EndWhenDropped(&ending);
        for _ in 0..load::COMERS {
            scope.spawn(|| load::come_and_go(place, &gate, &ending, &done));
        }
        scope.spawn(|| load::flood_references(place, &ending, &done));
        scope.spawn(|| load::flood_obstacles(place, &ending, &done));
        scope.spawn(|| read(place, &ending));
        scope.spawn(|| never_read(place, &ending));
        if link == "driver" {
            scope.spawn(|| load::drive(place, &ending));
        }
        let (begin, mut busy) = (Instant::now(), Busy::new(place));
        while begin.elapsed() < duration
            || samples.len() < WARM_UP_TURNS + TURNS_MIN
            || busy.tracked == 0
            || !done.reaches(&least)
        {
            let passed = begin.elapsed();
            assert!(passed < duration + 2 * TIMEOUT, "{done:?}, not {least:?}");
            let mut victim = echo(place);
            busy.turn(TURN_S, &done);
            // A client killed while connecting leaves more; see below.
            wait_until_it_reads(&mut victim);
            kill(victim);
            killed.fetch_add(1, Ordering::Relaxed);
            let _alone = gate.write().unwrap_or_else(PoisonError::into_inner);
            // Removes what the killed client left.
            drop(load::connect(place));
            settle(&daemon);
            let time_s = begin.elapsed().as_secs_f64();
            samples.push(Sample::take(&daemon, &busy.connection, time_s));
        }
        println!("{link}: {} records of tracking cycles", busy.tracked);
    });
    println!("{done:?}, {killed:?} clients killed\n{}", table(&samples));
    write_csv(link, &samples);
    assert_no_growth(&samples);
    daemon.end_clean();
}

/// A reader that keeps up.
fn read(place: &Place, ending: &AtomicBool) {
    let connection = load::connect(place);
    let mut telemetry = connection.telemetry().unwrap();
    while !ending.load(Ordering::Relaxed) {
        let _ = telemetry.next_within(Duration::from_millis(50)).unwrap();
    }
}

fn never_read(place: &Place, ending: &AtomicBool) {
    let connection = load::connect(place);
    let _telemetry = connection.telemetry().unwrap();
    let _commands = connection.commands().unwrap();
    while !ending.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A client process, to be killed.
fn echo(place: &Place) -> Child {
    let mut command = place.command("cdcrctl");
    command.args(["echo", "telemetry"]);
    command.stdout(Stdio::piped()).stderr(Stdio::null());
    command.spawn().unwrap()
}

/// Waits until a client reads: it has printed its heading and the first record. Later records fill its pipe,
/// and it stops reading.
fn wait_until_it_reads(client: &mut Child) {
    let mut lines = BufReader::new(client.stdout.as_mut().unwrap()).lines();
    assert!(lines.by_ref().take(2).all(|line| line.is_ok()));
}

/// Kills and reaps a client, because a zombie is not dead for iceoryx2.
fn kill(mut victim: Child) {
    victim.kill().unwrap();
    victim.wait().unwrap();
}

/// Waits until the daemon has noticed that the clients of a turn have left: its descriptors and mappings, and
/// the files and nodes of the place, no longer change.
fn settle(daemon: &Daemon) {
    let counts = || {
        (
            descriptors(daemon),
            mappings(daemon),
            inventory(daemon.place()),
        )
    };
    let (begin, mut before) = (Instant::now(), counts());
    loop {
        std::thread::sleep(SETTLED);
        let now = counts();
        // A daemon that never settles grows, which the samples show.
        if now == before || begin.elapsed() > TIMEOUT {
            return;
        }
        before = now;
    }
}

fn descriptors(daemon: &Daemon) -> usize {
    let folder = format!("/proc/{}/fd", daemon.id());
    fs::read_dir(folder).unwrap().count()
}

fn mappings(daemon: &Daemon) -> usize {
    let maps = fs::read_to_string(format!("/proc/{}/maps", daemon.id()));
    maps.unwrap().lines().count()
}

impl Sample {
    fn take(daemon: &Daemon, connection: &Connection, time_s: f64) -> Self {
        let keys = ["VmRSS", "VmLck", "VmHWM", "VmData", "Threads"];
        let [rss_kb, locked_kb, peak_kb, data_kb, threads] = status(daemon.id(), keys).unwrap();
        let place = daemon.place();
        let (shm_files, shm_bytes) = shared_memory(place);
        let [living, dead] = nodes(place);
        let values = [
            rss_kb,
            locked_kb,
            peak_kb,
            data_kb,
            descriptors(daemon) as u64,
            mappings(daemon) as u64,
            threads,
            shm_files,
            shm_bytes / 1024,
            files_below(place.location().root()),
            living,
            dead,
            connection.status(TIMEOUT).unwrap().cycles,
        ];
        Self { time_s, values }
    }
}

fn shared_memory(place: &Place) -> (u64, u64) {
    let names = place.memory_files();
    let sizes = names.iter().filter_map(|path| fs::metadata(path).ok());
    (names.len() as u64, sizes.map(|file| file.len()).sum())
}

/// Number of files, without folders.
pub(crate) fn files_below(folder: &Path) -> u64 {
    files(&[folder.to_owned()]).0
}

/// Numbers of living and dead iceoryx2 nodes here.
pub(crate) fn nodes(place: &Place) -> [u64; 2] {
    use iceoryx2::prelude::{CallbackProgression, Node, NodeState};
    let mut count = [0, 0];
    let config = place.location().iceoryx2_config().unwrap();
    Node::<ipc::Variant>::list(&config, |state| {
        count[usize::from(!matches!(state, NodeState::Alive(_)))] += 1;
        CallbackProgression::Continue
    })
    .unwrap();
    count
}

fn median(samples: &[Sample], column: usize) -> u64 {
    let mut values: Vec<_> = samples.iter().map(|sample| sample.values[column]).collect();
    values.sort_unstable();
    values[values.len() / 2]
}

/// Compares the last quarter after the warm-up with the first: in growth, every sample of the last is above
/// the largest of the first. Files of a recently killed client are in some samples of both.
fn assert_no_growth(samples: &[Sample]) {
    let warm = &samples[WARM_UP_TURNS..];
    let quarter = warm.len() / 4;
    assert!(quarter > 0, "too short: only {} samples", warm.len());
    let (first, last) = (&warm[..quarter], &warm[warm.len() - quarter..]);
    let mut grown = String::new();
    println!(
        "median of the first and of the last quarter after the warm-up, largest of the first, least of the last:"
    );
    for (column, (name, part, least)) in COLUMNS.into_iter().enumerate() {
        let (before, after) = (median(first, column), median(last, column));
        let values = |part: &[Sample]| {
            part.iter()
                .map(|sample| sample.values[column])
                .collect::<Vec<_>>()
        };
        let (before_max, after_min) = (
            values(first).into_iter().max(),
            values(last).into_iter().min(),
        );
        let (before_max, after_min) = (before_max.unwrap_or(0), after_min.unwrap_or(0));
        println!("  {name:<10} {before:>10} {after:>10} {before_max:>10} {after_min:>10}");
        let share = before_max.checked_div(part).unwrap_or(0);
        if after_min > before_max.saturating_add(least.max(share)) {
            writeln!(grown, "{name} grew from {before_max} to {after_min}").unwrap();
        }
    }
    assert!(grown.is_empty(), "{grown}");
}

/// The samples, reduced to a page.
fn table(samples: &[Sample]) -> String {
    let mut text = format!("{:>7}", "time_s");
    for (name, ..) in COLUMNS {
        write!(text, " {name:>10}").unwrap();
    }
    let step = samples.len().div_ceil(ROWS).max(1);
    for sample in samples.iter().step_by(step) {
        write!(text, "\n{:>7.1}", sample.time_s).unwrap();
        for value in sample.values {
            write!(text, " {value:>10}").unwrap();
        }
    }
    text
}

/// Writes all samples to the file named by `CDCR_SOAK_CSV`, with the link before its extension.
fn write_csv(link: &str, samples: &[Sample]) {
    let Some(path) = std::env::var_os("CDCR_SOAK_CSV") else {
        return;
    };
    let mut text = String::from("time_s");
    for (name, ..) in COLUMNS {
        write!(text, ",{name}").unwrap();
    }
    for sample in samples {
        write!(text, "\n{:.3}", sample.time_s).unwrap();
        for value in sample.values {
            write!(text, ",{value}").unwrap();
        }
    }
    let path = Path::new(&path).with_extension(format!("{link}.csv"));
    fs::write(&path, text + "\n").unwrap();
}

/// Counts of a place: files in shared memory, files below its root, living and dead nodes.
fn inventory(place: &Place) -> [u64; 4] {
    let [living, dead] = nodes(place);
    let files = files_below(place.location().root());
    [shared_memory(place).0, files, living, dead]
}

/// A client may be killed between announcing that it will open a service and opening it. iceoryx2 0.10 cannot
/// remove all of it: a few small files below the root remain until the folder is removed. No place of a
/// service is lost.
#[test]
fn clients_killed_while_they_connect_take_no_place_from_others() {
    let daemon = Daemon::start(CONFIGURATION);
    let place = daemon.place();
    let before = inventory(place);
    // Without the queues to single clients, of which the daemon keeps the last until it connects to another
    // one.
    let memory = || {
        let mut names = place.memory_files();
        names.retain(|path| path.extension().is_none_or(|end| end != "connection"));
        names.sort();
        names
    };
    let memory_before = memory();
    // More than a service accepts at one time.
    let count = Service::NODES as u64 + 10;
    for turn in 0..count {
        let victim = echo(place);
        wait_until("it connects", || nodes(place)[0] > before[2]);
        std::thread::sleep(Duration::from_millis(turn % 10));
        kill(victim);
    }
    let clients: Vec<_> = (0..6).map(|_| daemon.connect()).collect();
    for client in &clients {
        let mut telemetry = client.telemetry().unwrap();
        assert!(telemetry.next_within(TIMEOUT).unwrap().is_some());
    }
    drop(clients);
    let after = inventory(place);
    assert_eq!(memory(), memory_before, "memory was left behind");
    println!("files in shared memory and below the root, living and dead nodes: {before:?}");
    println!("after {count} clients were killed while they connected: {after:?}");
    assert!(after[1] <= before[1] + 20 * count, "{after:?}");
}

/// A client killed between the two steps in which iceoryx2 creates a file in shared memory leaves an empty
/// file; the test creates one. iceoryx2 0.10 alone waits for it for ever, in every later client and in the
/// ending daemon.
#[test]
fn a_file_that_a_killed_client_began_holds_nobody_up() {
    let mut daemon = Daemon::start(CONFIGURATION);
    let place = daemon.place();
    let mut victim = echo(place);
    wait_until_it_reads(&mut victim);
    let names = place.memory_files();
    let newest = names
        .iter()
        .filter(|path| path.extension().is_some_and(|end| end == "connection"))
        .max_by_key(|path| fs::metadata(path).unwrap().modified().unwrap());
    let newest = newest.unwrap().to_str().unwrap();
    // <prefix><hash>_<writer>_<reader>.connection: the same reader, and an unknown writer.
    let [reader, _, start] = *newest.rsplitn(3, '_').collect::<Vec<_>>() else {
        panic!("another name: {newest:?}");
    };
    let begun = PathBuf::from(format!("{start}_1_{reader}"));
    fs::write(&begun, "").unwrap();
    fs::set_permissions(&begun, fs::Permissions::from_mode(0o200)).unwrap();
    kill(victim);
    let mut next = place.start("cdcrctl status");
    wait_until("the next client is served", || !next.runs());
    daemon.end_clean();
}

#[test]
fn growth_is_found() {
    const EVERY: usize = 6;
    let samples = |first: usize| {
        let sample = move |turn: usize| {
            let mut values = [1_000_000; COLUMNS.len()];
            values[4] = 20 + ((turn + EVERY - first) / EVERY) as u64;
            Sample {
                time_s: turn as f64,
                values,
            }
        };
        (0..WARM_UP_TURNS + TURNS_MIN).map(sample)
    };
    for first in 0..EVERY {
        let samples: Vec<_> = samples(first).collect();
        let found = std::panic::catch_unwind(|| assert_no_growth(&samples));
        let message = *found.unwrap_err().downcast::<String>().unwrap();
        assert!(message.contains("fds grew from 2"), "{first}: {message}");
    }
    assert_no_growth(&vec![samples(0).next().unwrap(); WARM_UP_TURNS + TURNS_MIN]);
}
