//! Results of `cdcr-bench latency` from a few samples, and the cleanup by its peer.

use std::hint;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use cdcr_bench::benchmark::{Benchmark, defaults};
use cdcr_bench::latency::baseline::PEER;
use cdcr_bench::latency::{LatencyOptions, Leg};
use cdcr_bench::progress::Progress;
use cdcr_process::Place;
use cdcr_testbed::system::thread::pin;

use crate::{list, machine, number, printed_json, program, stderr};

/// Time limit for a process. Long, because machines stall.
const TIMEOUT: Duration = Duration::from_secs(20);

/// Two rounds: each leg has its samples, and its parts make the whole.
#[test]
fn every_way_is_measured_in_every_round() {
    use Leg::{LeaseAnswer, MeasurementMachinery, ObstacleGrid, ReferenceCommand};
    let _machine = machine();
    let options = LatencyOptions {
        rounds: 2,
        samples: 10,
        ..defaults()
    };
    let report = options.run(&mut Progress::silent()).unwrap();
    let json = report.json();
    let row = |leg: Leg| &json["legs"][leg as usize];
    let samples = |leg: Leg| {
        assert_eq!(row(leg)["leg"], leg.name());
        row(leg)["samples"].as_u64().unwrap()
    };
    for leg in Leg::ALL {
        assert!(samples(leg) > 0, "{}", leg.name());
    }
    for leg in [
        ReferenceCommand,
        ObstacleGrid,
        MeasurementMachinery,
        LeaseAnswer,
    ] {
        assert!(samples(leg) >= 20, "{}: {}", leg.name(), samples(leg));
    }
    assert_eq!(samples(Leg::StopZeroCommand), 8);
    assert_eq!(samples(Leg::StopZeroCommand), samples(Leg::StopGrid));
    assert_eq!(samples(Leg::BareOneWay), 160);
    // An effect cannot precede its cause.
    let least = |leg: Leg| number(&row(leg)["latency_us"], "min");
    assert!(least(Leg::BareRoundTrip) >= least(Leg::BareOneWay));
    assert!(least(Leg::CommandRelease) >= least(Leg::CommandHandover));
    assert!(least(Leg::CommandHandover) >= least(Leg::CommandHop));
    assert!(least(Leg::CommandHop) > 0.0);
    let looks = &json["setting"]["looks"];
    let [all, late] = ["all", "late"].map(|key| looks[key].as_u64().unwrap());
    assert!(all > 0 && late <= all);
    assert_eq!(json["setting"]["period_us"], 5000.0);
    let mut metrics = report.metrics.iter();
    assert!(metrics.all(|metric| metric.rounds.len() == 2));
    assert_eq!(json["targets"][0]["limit_us"], 5100.0);
    assert!(json["unmeasured"]["spoilt_stops"].is_u64());
    assert!(json["unmeasured"]["without_command"].is_u64());
    assert_eq!(report.plots.len(), 1);
}

#[test]
fn the_program_takes_another_period() {
    let _machine = machine();
    let line = "latency --rounds 1 --samples 5 --period 10ms --format json";
    let json = printed_json(&mut program(line));
    assert_eq!(json["setting"]["period_us"], 10_000.0);
    assert_eq!(list(&json, "legs").len(), Leg::ALL.len());
    assert_eq!(json["targets"][0]["limit_us"], 10_100.0);
}

/// Starts a peer at `place` with the process id `parent` as its parent.
fn start_peer(place: &Place, parent: &str) -> Child {
    program(&format!("{PEER} --core 0 --shares"))
        .args(["--prefix", place.location().prefix(), "--root"])
        .arg(place.location().root())
        .args(["--parent", parent])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn wait_until(what: &str, mut is_true: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !is_true() {
        assert!(begin.elapsed() < TIMEOUT, "{what} takes too long");
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_peer_is_only_its_parents() {
    let place = Place::new().unwrap();
    let output = start_peer(&place, "0").wait_with_output().unwrap();
    assert!(!output.status.success());
    assert!(stderr(&output).contains("the parent has ended"));
    assert!(place.memory_files().is_empty());
}

#[test]
fn a_peer_that_is_told_to_end_leaves_no_port() {
    let place = Place::new().unwrap();
    let mut peer = start_peer(&place, &std::process::id().to_string());
    wait_until("the start of the peer", || place.memory_files().len() > 2);
    // Two signals, as from the parent and from the kernel, do not disturb the orderly end.
    let id = rustix::process::Pid::from_child(&peer);
    for _ in 0..2 {
        rustix::process::kill_process(id, rustix::process::Signal::TERM).unwrap();
    }
    wait_until("the end of the peer", || peer.try_wait().unwrap().is_some());
    assert_eq!(place.memory_files(), Vec::<PathBuf>::new());
}

/// Threads that compute on core 0 until they are dropped.
struct Crowd {
    goes: Arc<AtomicBool>,
}

impl Crowd {
    fn of(count: usize) -> Self {
        let goes = Arc::new(AtomicBool::new(true));
        for _ in 0..count {
            let goes = Arc::clone(&goes);
            thread::spawn(move || {
                pin(0);
                while goes.load(Ordering::Relaxed) {
                    hint::spin_loop();
                }
            });
        }
        Self { goes }
    }
}

impl Drop for Crowd {
    fn drop(&mut self) {
        self.goes.store(false, Ordering::Relaxed);
    }
}

/// On a core where other threads take all the time that the peer yields.
#[test]
fn a_peer_whose_parent_is_killed_leaves_nothing() {
    let place = Place::new().unwrap();
    let script = r#""$0" "$@" --parent $$ & wait"#;
    let mut parent = Command::new("sh")
        .args(["-c", script, env!("CARGO_BIN_EXE_cdcr-bench"), PEER])
        .args(["--prefix", place.location().prefix(), "--core", "0"])
        .args(["--shares", "--root"])
        .arg(place.location().root())
        .spawn()
        .unwrap();
    wait_until("the start of the peer", || place.memory_files().len() > 2);
    let _crowd = Crowd::of(4);
    parent.kill().unwrap();
    parent.wait().unwrap();
    wait_until("the end of the peer", || {
        place.memory_files().is_empty() && !place.location().root().exists()
    });
}
