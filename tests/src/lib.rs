//! Common parts of the system tests: a real daemon as a process with its own prefix.
//!
//! Binaries are found beside the test executable, where cargo puts them. Dropping a [`Daemon`] removes
//! everything that its test left, even after a panic. What a killed run left is removed by the next one.

#![allow(
    missing_docs,
    clippy::missing_panics_doc,
    clippy::unwrap_used,
    reason = "of tests: a comment that repeats a name helps nobody, and a panic is the report"
)]

pub mod driver;
pub mod load;
pub mod managed;
mod program;
pub mod record;
pub mod robot;
pub mod system_calls;
pub mod threads;

use std::iter::from_fn;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use cdcr_client::{
    Connection, FeedEnd, FeedEvent, FeedOptions, Line, RequestError, TelemetryStream, Trajectory,
    monotonic_ns,
};
use cdcr_controller::plant::RobotPreset;
pub use cdcr_process::in_public_memory;
use cdcr_shared_types::codes::{Mode, Outcome, RequestKind};
use cdcr_shared_types::{Obstacle, Response, Status, Telemetry};
pub use cdcr_test_cases::asked;
/// Configuration for tests whose subject is not timing, as text that tables may follow.
pub use cdcr_testbed::subject::daemon::STALL_TOLERANT;
use cdcr_testbed::system::thread::pin;
use derive_more::{Deref, DerefMut};
pub use program::{Program, Running, unread_pipe};
use rustix::process::Signal;
use rustix::thread::{CpuSet, sched_getaffinity};
use serde_json::Value;

pub const ROBOT: &str = "cdcr";
/// Selects the robot that a daemon simulates; empty counts as unset.
const SIMULATED: &str = "CDCR_LINK_SIMULATED";
/// Time limit of a test's waits. Long, because machines stall; only a failing test takes so long.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// Path of a program of this project.
pub fn binary(name: &str) -> PathBuf {
    cdcr_process::program(name).unwrap_or_else(|error| panic!("{error}"))
}

/// A place in shared memory that no other test uses, and a folder for other files, possibly on a disk.
/// Dropping it removes both.
#[derive(Debug, Deref)]
pub struct Place(cdcr_process::PrivatePlace);

impl Place {
    /// Creates a place. The first one of a process sweeps what killed processes left.
    pub fn new() -> Self {
        Self(cdcr_process::PrivatePlace::new().expect("a place"))
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.folder().join(name);
        std::fs::write(&path, text).expect("the folder is writable");
        path
    }

    /// A command of this project that uses this place. A daemon there simulates the
    /// [laboratory](RobotPreset::Laboratory)'s robot.
    pub fn command(&self, name: &str) -> Command {
        let mut command = self.command_of(&binary(name));
        command.envs((name == "cdcrd").then_some((SIMULATED, RobotPreset::Laboratory.name())));
        command
    }

    /// A command of any program that uses this place.
    pub fn command_of(&self, program: &Path) -> Command {
        let mut command = Command::new(program);
        command
            .env_remove("CDCR_CONFIG")
            .env("CDCR_ROBOT", ROBOT)
            .env("CDCR_PREFIX", self.location().prefix())
            .env("CDCR_ROOT", self.location().root())
            .stdin(Stdio::null());
        command
    }

    /// Starts the words of `line`, a program of this project with its arguments, in the place's folder, so that
    /// file names are short.
    pub fn start(&self, line: &str) -> Program {
        let mut words = line.split_whitespace();
        let mut command = self.command(words.next().expect("a program"));
        Program::start(command.args(words).current_dir(self.folder()))
    }

    /// Runs the same to its end. Returns its output, checked by [`assert_output`].
    pub fn checked(&self, line: &str, status: i32, parts: &[&str]) -> String {
        assert_output(&self.start(line).output(), status, parts)
    }

    /// The same for `cdcrctl`, which prints one JSON value.
    pub fn json(&self, line: &str) -> Value {
        let printed = self.checked(&format!("cdcrctl {line} --format json"), 0, &[]);
        serde_json::from_str(&printed).unwrap_or_else(|error| panic!("{error}: {printed}"))
    }

    /// Starts a recording into this file of the place's folder, and waits until its streams are open.
    pub fn record(&self, file: &str) -> Program {
        let recorder = self.start(&format!("cdcrctl record -o {file}"));
        wait_until("the recorder has begun", || {
            self.folder().join(file).exists()
        });
        recorder
    }

    /// Runs `cdcrctl` with `arguments` to its end.
    pub fn cdcrctl(&self, arguments: &[&str]) -> Output {
        self.command("cdcrctl")
            .args(arguments)
            .output()
            .expect("cdcrctl runs")
    }
}

/// The output of a program on both streams.
pub fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    format!("{out}{err}")
}

/// Fails unless a program ended with `status` and its output contains all of `parts`: on standard output for
/// a success, otherwise on standard error. Returns that output.
pub fn assert_output(output: &Output, status: i32, parts: &[&str]) -> String {
    let printed = text(output);
    assert_eq!(output.status.code(), Some(status), "{printed}");
    let stream = if status == 0 {
        &output.stdout
    } else {
        &output.stderr
    };
    let reported = String::from_utf8_lossy(stream);
    for part in parts {
        assert!(reported.contains(part), "{part}: {printed}");
    }
    reported.into_owned()
}

/// A reference that begins after one second and is tracked.
pub fn tracked() -> FeedOptions {
    FeedOptions {
        lead: Duration::from_secs(1),
        track: true,
        ..FeedOptions::default()
    }
}

/// The paper's line of three sections with this duration.
pub fn paper_line(duration_s: f64) -> Line {
    Line {
        duration_s,
        ..Line::for_sections(&[0.3; 3])
    }
}

pub const BALL_RADIUS_M: f64 = 0.02;

/// A ball at rest, measured now.
pub fn ball(id: u32, start_m: [f64; 3]) -> Obstacle {
    Obstacle {
        id,
        start_m,
        radius_m: BALL_RADIUS_M,
        measured_ns: monotonic_ns(),
        ..Obstacle::default()
    }
}

/// Tracks a trajectory to its end, and returns the records of the tracking cycles.
pub fn track(connection: &Connection, trajectory: &dyn Trajectory) -> Vec<Telemetry> {
    let mut records = Vec::new();
    let feeder = connection.feed(trajectory, tracked()).expect("a lease");
    let report = feeder.run(|event| {
        if let FeedEvent::Record(record) = event
            && record.mode == Mode::Tracking.code()
        {
            records.push(*record);
        }
        ControlFlow::Continue(())
    });
    let report = report.expect("the daemon lives");
    assert!(report.tracked && report.end == FeedEnd::Played);
    records
}

impl Default for Place {
    fn default() -> Self {
        Self::new()
    }
}

/// A running `cdcrd`.
#[derive(Debug, Deref, DerefMut)]
pub struct Daemon {
    // Declared before the place, so that the process ends first.
    #[deref]
    #[deref_mut]
    child: Running,
    place: Place,
    log: PathBuf,
    configuration: String,
    simulated: RobotPreset,
}

impl Daemon {
    /// Starts a daemon with `configuration` (TOML) at a new place and waits until it is up. The simulated
    /// robot is the [laboratory](RobotPreset::Laboratory)'s unless configured.
    pub fn start(configuration: &str) -> Self {
        Self::start_simulated(configuration, RobotPreset::Laboratory, |_| {})
    }

    /// The same with a command modified by `change`, for example to redirect its log.
    pub fn start_with(configuration: &str, change: impl FnOnce(&mut Command)) -> Self {
        Self::start_simulated(configuration, RobotPreset::Laboratory, change)
    }

    /// The same with the [ideal](RobotPreset::Ideal) robot, for a test that needs a robot equal to its model.
    pub fn ideal(configuration: &str) -> Self {
        Self::start_simulated(configuration, RobotPreset::Ideal, |_| {})
    }

    fn start_simulated(
        configuration: &str,
        simulated: RobotPreset,
        change: impl FnOnce(&mut Command),
    ) -> Self {
        let place = Place::new();
        let log = place.folder().join("cdcrd.log");
        let mut command = command_of(&place, configuration, simulated, &log);
        change(&mut command);
        let daemon = Self {
            child: Running::start(&mut command),
            place,
            log,
            configuration: configuration.to_owned(),
            simulated,
        };
        daemon.wait_until_up();
        daemon
    }

    /// Restarts the daemon at the same place after its end.
    pub fn restart(&mut self) {
        let mut command = command_of(&self.place, &self.configuration, self.simulated, &self.log);
        self.child = Running::start(&mut command);
        self.wait_until_up();
    }

    pub fn place(&self) -> &Place {
        &self.place
    }

    pub fn connect(&self) -> Connection {
        Connection::open_within(self.place.location(), ROBOT, TIMEOUT)
            .unwrap_or_else(|error| panic!("{error}\n{}", self.log()))
    }

    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    fn wait_until_up(&self) {
        let is_up = || {
            Connection::open(self.place.location(), ROBOT)
                .ok()
                .map(drop)
        };
        wait_for(
            || format!("the daemon did not come up:\n{}", self.log()),
            is_up,
        );
    }

    /// Sends SIGTERM and waits for the end.
    pub fn stop(&mut self) -> ExitStatus {
        self.signal(Signal::TERM);
        self.stop_after_signal()
    }

    /// Ends the daemon, and checks its success and that nothing is left in shared memory.
    pub fn end_clean(&mut self) {
        assert!(self.stop().success(), "{}", self.log());
        assert_eq!(self.place().memory_files(), Vec::<PathBuf>::new());
    }

    /// Waits for the end after a signal.
    pub fn stop_after_signal(&mut self) -> ExitStatus {
        let Self { child, log, .. } = self;
        child.wait(|| std::fs::read_to_string(&*log).unwrap_or_default())
    }

    /// Kills the daemon with SIGKILL.
    pub fn kill(&mut self) {
        self.signal(Signal::KILL);
        self.stop_after_signal();
    }
}

/// Without an explicit mode, a configuration with a driver also runs on machines without real time.
fn command_of(place: &Place, configuration: &str, preset: RobotPreset, log: &Path) -> Command {
    let path = place.write("robot.toml", configuration);
    let is_set = |key: &str| configuration.contains(&format!("\n{key} = "));
    let log = std::fs::File::create(log).expect("the folder is writable");
    let mut command = place.command("cdcrd");
    command
        .args(["run", "--config"])
        .arg(path)
        .envs((!is_set("mode")).then_some(("CDCR_REALTIME_MODE", "prefer")))
        .env(
            SIMULATED,
            if is_set("simulated") {
                ""
            } else {
                preset.name()
            },
        )
        .stdout(Stdio::null())
        .stderr(log);
    command
}

/// Asks until there is an answer. Fails after the time limit with `words`.
pub fn wait_for<T>(words: impl Fn() -> String, mut ask: impl FnMut() -> Option<T>) -> T {
    let begin = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return answer;
        }
        assert!(begin.elapsed() < TIMEOUT, "{}", words());
        std::thread::sleep(Duration::from_millis(5));
    }
}

pub fn wait_until(what: &str, mut is_it: impl FnMut() -> bool) {
    let words = || format!("it never came: {what}");
    wait_for(words, || is_it().then_some(()));
}

pub fn wait_record(
    stream: &mut TelemetryStream,
    mut is_it: impl FnMut(&Telemetry) -> bool,
) -> Telemetry {
    let mut next = || stream.try_next().expect("the daemon lives");
    let words = || "no such record".to_owned();
    wait_for(words, || from_fn(&mut next).find(&mut is_it))
}

/// Sets a flag for another thread when dropped, even if the test fails.
#[derive(Debug)]
pub struct EndWhenDropped<'a>(pub &'a AtomicBool);

impl Drop for EndWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

pub fn wait_mode(stream: &mut TelemetryStream, mode: Mode) -> Telemetry {
    wait_record(stream, |record| record.mode == mode.code())
}

pub fn wait_status(connection: &Connection, is_it: impl Fn(&Status) -> bool) -> Status {
    let status = || connection.status(TIMEOUT).expect("a status");
    let words = || format!("no such status: {:?}", status());
    wait_for(words, || Some(status()).filter(&is_it))
}

/// Sends a request that the daemon accepts, and returns its answer.
#[track_caller]
pub fn ask_for(connection: &Connection, kind: RequestKind) -> Response {
    connection.request_within(kind, TIMEOUT).unwrap()
}

/// Resets the robot and accepts where it is measured.
#[track_caller]
pub fn reset_here(connection: &Connection) -> Response {
    connection.reset_within(true, TIMEOUT).unwrap()
}

/// Sends a request that the daemon rejects, and returns the reason. A missing answer is not a rejection.
#[track_caller]
pub fn refused(connection: &Connection, kind: RequestKind) -> Outcome {
    match connection.request_within(kind, TIMEOUT) {
        Err(RequestError::Refused { outcome, .. }) => outcome,
        other => panic!("{kind} was not refused: {other:?}"),
    }
}

/// Repeats `case` until it is undisturbed. `case` returns `None` when the machine disturbed it, for example
/// when a client lost its lease before the test could kill it. A sleeping thread on each core checks this:
/// fails if a try was disturbed without a long sleep on any core.
pub fn until_undisturbed<R>(what: &str, mut case: impl FnMut() -> Option<R>) -> R {
    for _ in 0..UNDISTURBED_TRIES {
        let (result, overslept) = beside_sleepers(&mut case);
        if let Some(result) = result {
            return result;
        }
        println!("once more: {what}; meanwhile a sleep of a millisecond took {overslept:?} longer");
        assert!(overslept >= STALL_MIN, "the machine did not stall: {what}");
    }
    panic!("in {UNDISTURBED_TRIES} tries the machine never let it happen: {what}");
}

/// The first try and three more.
const UNDISTURBED_TRIES: usize = 4;
/// A shorter oversleep does not explain a disturbed case: stale inputs or a late client take about a period
/// of 5 ms.
const STALL_MIN: Duration = Duration::from_millis(3);

/// Result of `case`, and the longest oversleep on any core meanwhile.
fn beside_sleepers<R>(case: &mut impl FnMut() -> R) -> (R, Duration) {
    let ending = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _ends = EndWhenDropped(&ending);
        let cores = sched_getaffinity(None).expect("the cores of this thread");
        let cores = (0..CpuSet::MAX_CPU).filter(|core| cores.is_set(*core));
        let sleepers = cores.map(|core| {
            let ending = &ending;
            scope.spawn(move || {
                assert!(pin(core), "a core of this thread");
                oversleep_until(ending)
            })
        });
        let sleepers: Vec<_> = sleepers.collect();
        let result = case();
        ending.store(true, Ordering::Relaxed);
        let longest = sleepers
            .into_iter()
            .filter_map(|sleeper| sleeper.join().ok());
        (result, longest.max().unwrap_or_default())
    })
}

/// The longest oversleep of a sleep of one millisecond until `ending`.
pub fn oversleep_until(ending: &AtomicBool) -> Duration {
    const SLEEP: Duration = Duration::from_millis(1);
    let mut longest = Duration::ZERO;
    while !ending.load(Ordering::Relaxed) {
        let begin = Instant::now();
        std::thread::sleep(SLEEP);
        longest = longest.max(begin.elapsed().saturating_sub(SLEEP));
    }
    longest
}
