//! Core share of the real-time threads, as a separate program, because it needs the core of the loop for
//! itself. If an ordinary task wants the core, Linux throttles real-time threads beyond their share for 50
//! ms.

#![allow(
    clippy::unwrap_used,
    reason = "in a test a panic is the report, in its helpers, too"
)]

use std::fmt::Write as _;
use std::slice;
use std::sync::{Mutex, PoisonError};

use cdcr_client::{Connection, Spiral};
use cdcr_shared_types::codes::{LateCause, ObstacleShape, timing};
use cdcr_shared_types::limits::OBSTACLES_MAX;
use cdcr_shared_types::{Obstacle, Telemetry};
use cdcr_test_skip::{Need, skip};
use cdcr_testbed::load::{Load, RunningLoad};
use cdcr_testbed::system::cores::Cores;
use cdcr_tests::{Daemon, STALL_TOLERANT, asked, ball, wait_status};
use rustix::thread::sched_getaffinity;

/// Serialises the tests: two daemons on one core would load each other.
static ALONE: Mutex<()> = Mutex::new(());

/// Duration of the tracking: `CDCR_CORE_BUDGET_S`, or 8 s, in which the kernel would throttle it six times.
fn duration_s() -> f64 {
    asked("CDCR_CORE_BUDGET_S").unwrap_or(8.0)
}

/// Six sections and the longest horizon.
fn demanding() -> String {
    let mut configuration = format!("{STALL_TOLERANT}[controller]\nhorizon_steps = 50\n");
    for section in 0..6 {
        write!(
            configuration,
            "[[robot.sections]]\nlength_m = 0.15\ncable_radius_m = 0.0125\ncable_offset_rad = 0.{section}\n\
             bend_max_rad = 2.8\nrate_max_rad_s = 2.0\nbody_radius_m = 0.015\n"
        )
        .unwrap();
    }
    configuration
}

/// The largest number of capsules, eight around each of eight heights, half a millimetre inside the safe
/// distance. All of them are within reach in every cycle.
fn cage() -> Vec<Obstacle> {
    (0..OBSTACLES_MAX)
        .map(|index| {
            let (sin, cos) = (index as f64 * std::f64::consts::FRAC_PI_4).sin_cos();
            let height_m = 0.06 + 0.1 * (index / 8) as f64;
            let at = |z| [0.0445 * cos, 0.0445 * sin, z];
            Obstacle {
                shape: ObstacleShape::Capsule.code(),
                end_m: at(height_m + 0.09),
                ..ball(index as u32 + 1, at(height_m))
            }
        })
        .collect()
}

/// An ordinary task that always wants the core of the loop.
fn busy_task(core: usize) -> RunningLoad {
    let mut cores = Cores::find().unwrap();
    cores.others = vec![core];
    RunningLoad::start(Load::Cpu, &cores, None).unwrap()
}

/// Records of tracking cycles.
fn track(connection: &Connection, duration_s: f64) -> Vec<Telemetry> {
    let spiral = Spiral {
        duration_s,
        ..Spiral::for_sections(&[0.15; 6])
    };
    cdcr_tests::track(connection, &spiral)
}

/// Whether the kernel took the core from its highest priority and gave it to an ordinary task.
fn is_halt(record: &Telemetry) -> bool {
    record.scheduling.run_delay_ns > 30_000_000
}

/// Whether other real-time threads used more of the core than its reserve, and so exhausted the share of the
/// loop.
fn is_hogged(records: &[Telemetry]) -> bool {
    let waited_ns = |record: &Telemetry| record.scheduling.run_delay_ns;
    let others = records.iter().filter(|record| !is_halt(record));
    share_of(records, others.map(waited_ns).sum()) > 0.02
}

/// Whether other daemons run on this machine: their other threads are real-time threads, too, on any core.
fn others_run(ours: &[Daemon]) -> bool {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let mut ids = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    ids.any(|id: u32| {
        let name = std::fs::read_to_string(format!("/proc/{id}/comm"));
        ours.iter().all(|daemon| daemon.id() != id) && name.is_ok_and(|name| name.trim() == "cdcrd")
    })
}

/// Share of `ns` in the time of the records.
fn share_of(records: &[Telemetry], ns: u64) -> f64 {
    let passed_ns: u64 = records.iter().map(|record| record.elapsed_ns).sum();
    ns as f64 / passed_ns as f64
}

/// A miss caused by the cycle itself.
fn is_own_miss(record: &Telemetry) -> bool {
    record.timing_flags & timing::DEADLINE_MISS != 0
        && record.scheduling.late_cause == LateCause::Compute.code()
}

#[test]
fn six_sections_among_64_obstacles_beside_an_ordinary_task_are_never_halted() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let daemon = Daemon::start(&demanding());
    let connection = daemon.connect();
    let status = wait_status(&connection, |status| status.cycles > 5);
    if status.realtime_missing != 0 {
        skip(Need::Realtime, "the daemon is not granted real time");
        return;
    }
    let sender = connection.obstacle_sender().unwrap();
    sender.upsert(&cage()).unwrap();
    wait_status(&connection, |status| {
        status.obstacle_count as usize == OBSTACLES_MAX
    });
    let begins_alone = !others_run(slice::from_ref(&daemon));
    let busy = busy_task(status.core as usize);
    let records = track(&connection, duration_s());
    drop(busy);
    let count = |is_it: fn(&Telemetry) -> bool| records.iter().filter(|r| is_it(r)).count();
    let on_core_ns = records.iter().map(|record| record.scheduling.on_core_ns);
    let taken = share_of(&records, on_core_ns.sum());
    let (halts, own) = (count(is_halt), count(is_own_miss));
    let misses = count(|record| record.timing_flags & timing::DEADLINE_MISS != 0);
    println!(
        "{} cycles, {:.1} % of the core in the cycle thread, {halts} halts, {own} own misses, {misses} misses",
        records.len(),
        100.0 * taken,
    );
    for record in records.iter().filter(|record| is_own_miss(record)) {
        let after_us = |ns: u64| ns.saturating_sub(record.release_ns) / 1000;
        println!(
            "own miss in cycle {}: started {} µs after the release, solved from {} to {}, handed over {}; {:?}",
            record.cycle,
            after_us(record.start_ns),
            after_us(record.solve_start_ns),
            after_us(record.solve_end_ns),
            after_us(record.handed_over_ns),
            record.scheduling,
        );
    }
    assert!(records.len() > 100, "{}", records.len());
    let is_alone = begins_alone && !is_hogged(&records) && !others_run(slice::from_ref(&daemon));
    // Another task on the core also empties its caches, and a guard with cold caches takes longer than
    // measured.
    let own_most = if is_alone { 0 } else { misses / 20 };
    assert!(own <= own_most, "{}", daemon.log());
    if !is_alone {
        skip(Need::Alone, "other real-time threads: halts may be theirs");
        return;
    }
    // The solver had work for all of its time.
    let spent = count(|record| record.report.budget_spent == 1);
    assert!(2 * spent > records.len(), "{spent} of {}", records.len());
    assert_eq!(halts, 0, "{}", daemon.log());
}

#[test]
fn two_loops_have_a_core_each() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    if sched_getaffinity(None).unwrap().count() < 2 {
        skip(Need::Cores, "two loops need two cores");
        return;
    }
    let daemons = [Daemon::start(STALL_TOLERANT), Daemon::start(STALL_TOLERANT)];
    let statuses = daemons
        .each_ref()
        .map(|daemon| wait_status(&daemon.connect(), |status| status.cycles > 5));
    if statuses.iter().any(|status| status.realtime_missing != 0) {
        skip(Need::Realtime, "the daemon is not granted real time");
        return;
    }
    // When other loops have all cores but one, there is no choice.
    if others_run(&daemons) && statuses[0].core == statuses[1].core {
        skip(Need::Alone, "another daemon has a core");
        return;
    }
    assert_ne!(statuses[0].core, statuses[1].core);
}
