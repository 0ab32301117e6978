//! Periods, budgets, statistics and incidents of a running daemon.

use std::collections::BTreeMap;
use std::time::Duration;

use cdcr_client::Connection;
use cdcr_shared_types::codes::{LateCause, Mode, realtime, timing};
use cdcr_shared_types::limits::INCIDENTS_MAX;
use cdcr_shared_types::proc_stat::stat_field;
use cdcr_shared_types::{Incident, SolverSettings, Telemetry};
use cdcr_test_skip::{Need, skip};
use cdcr_tests::{
    Daemon, STALL_TOLERANT, TIMEOUT, paper_line, track, wait_mode, wait_record, wait_status,
    wait_until,
};

use super::{error_max_m, freeze};

#[test]
fn periods_from_half_a_millisecond_to_a_tenth_of_a_second_keep_their_grid() {
    for (period_ms, lead_ms, duration_s) in [(0.5, 0.1, 0.5), (2.0, 0.2, 0.5), (100.0, 5.0, 3.0)] {
        let timeout_ms = 100.0 * period_ms;
        let daemon = Daemon::start(&format!(
            "[cycle]\nperiod_ms = {period_ms}\ngather_lead_ms = {lead_ms}\nmiss_limit = 1000000\n\
             watchdog_ms = 20000.0\n[reference]\nlease_ms = 60000.0\n[link]\nmeasurement_timeout_ms = {timeout_ms}\n"
        ));
        let connection = daemon.connect();
        let records = track(&connection, &paper_line(duration_s));
        let status = connection.status(TIMEOUT).unwrap();
        let period_ns = (period_ms * 1e6) as u64;
        assert_eq!(status.period_ns, period_ns);
        assert!(
            records.len() > 5,
            "{period_ms} ms: {} records",
            records.len()
        );
        for record in &records {
            assert_eq!(
                record.release_ns,
                status.origin_ns + record.cycle * period_ns
            );
            assert_eq!(record.elapsed_ns % period_ns, 0);
            assert!(record.start_ns >= record.due_ns);
        }
        // Gathered in the period before the release. Also on a machine that stalls, most cycles are on time.
        let is_fresh = |record: &&Telemetry| record.release_ns < record.gather_ns + period_ns;
        let fresh = records.iter().filter(is_fresh).count();
        assert!(
            2 * fresh > records.len(),
            "{period_ms} ms: inputs of {fresh} of {} cycles are of the last period",
            records.len()
        );
        let cycles = records.iter().map(|record| {
            let lost_ns = record.elapsed_ns.saturating_sub(period_ns);
            (lost_ns as f64 * 1e-9, period_ns as f64 * 1e-9)
        });
        let error_max_m = error_max_m(1e-3, cycles);
        let last = records.last().unwrap();
        assert!(
            last.position_error_m < error_max_m,
            "{period_ms} ms, {error_max_m} m are accounted for: {last:?}"
        );
    }
}

#[test]
fn a_budget_that_changes_while_it_tracks_ends_solves_and_never_worsens_the_plan() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let (connection, feeding) = (daemon.connect(), daemon.connect());
    let settings = connection.status(TIMEOUT).unwrap().settings;
    assert_eq!(settings.budget_ns, 0);
    let tight = SolverSettings {
        budget_ns: 1_000,
        swarm_size: 64,
        ..settings
    };
    connection.change_settings(tight).unwrap();
    let records = track(&feeding, &paper_line(0.5));
    assert!(records.iter().all(|record| record.settings == tight));
    let solved: Vec<_> = records
        .iter()
        .filter(|record| record.plan_length > 0)
        .collect();
    let spent = solved
        .iter()
        .filter(|record| record.report.budget_spent == 1);
    assert!(
        2 * spent.count() > solved.len(),
        "1 µs is not enough for 64 particles"
    );
    for record in solved {
        assert!(record.report.cost <= record.report.warm_cost);
    }
    connection.change_settings(settings).unwrap();
    let free = track(&feeding, &paper_line(0.5));
    let quanta = |records: &[Telemetry]| records.iter().map(|r| u64::from(r.report.quanta)).max();
    assert!(quanta(&free) > quanta(&records));
    wait_status(&connection, |status| {
        status.budget_hits > 0 && status.since_reset.budget_hits > 0
    });
}

/// All kept incidents: they come at once, new ones one by one.
fn kept(connection: &Connection) -> Vec<Incident> {
    let mut kept = Vec::new();
    wait_until("all that is kept", || {
        let mut stream = connection.incidents().unwrap();
        kept.clear();
        while kept.len() < INCIDENTS_MAX
            && let Some(incident) = stream.next_within(TIMEOUT).unwrap()
        {
            kept.push(incident);
        }
        // A reader that the machine delayed loses some.
        stream.lost() == 0
    });
    kept
}

/// Largest number of stalls that the test causes; newer ones of the machine may displace each of them.
const STALLS_MAX: usize = 20;

#[test]
fn a_stall_is_kept_whole_with_its_cause_for_who_asks_later() {
    let daemon = Daemon::start(STALL_TOLERANT);
    let connection = daemon.connect();
    let mut telemetry = connection.telemetry().unwrap();
    wait_mode(&mut telemetry, Mode::Holding);
    let flags = timing::LATE_START | timing::DEADLINE_MISS;
    // On a bad machine, more cycles than are kept may be late before the read: then the next stall is used.
    let (bad, incident, late) = (0..STALLS_MAX)
        .find_map(|_| {
            freeze(&daemon, Duration::from_millis(200));
            let bad = wait_record(&mut telemetry, |record| record.skipped_periods > 20);
            // A stall that began within a cycle made that one late. One between a command and the sleep after
            // it made none late, but releases are lost.
            if bad.timing_flags & flags != flags {
                return None;
            }
            let late = daemon.connect();
            let mut stream = late.incidents().unwrap();
            loop {
                let incident = stream.next_within(TIMEOUT).unwrap().expect("it is kept");
                if incident.telemetry.cycle == bad.cycle {
                    break Some((bad, incident, late));
                } else if incident.telemetry.cycle > bad.cycle {
                    break None;
                }
            }
        })
        .expect("one of them is kept");
    assert_eq!(incident.telemetry.header, bad.header);
    let cause = LateCause::try_from(incident.telemetry.scheduling.late_cause).unwrap();
    assert_ne!(cause, LateCause::None);
    // The steal may change the cause seen by the exchange, and nothing else.
    let mut as_seen = incident.telemetry;
    as_seen.scheduling.late_cause = bad.scheduling.late_cause;
    assert_eq!(as_seen.scheduling, bad.scheduling);
    assert!(cause == LateCause::Platform || incident.telemetry.scheduling == bad.scheduling);
    let status = wait_status(&late, |status| status.since_reset.longest_streak > 20);
    assert!(status.since_reset.causes[cause.code() as usize] >= 1);
}

#[test]
fn the_newest_bad_cycles_are_kept_and_older_ones_go() {
    // Without an early wake-up, every start of a thread is late by this measure.
    let daemon = Daemon::start(
        "[cycle]\nlate_start_ms = 0.001\nmiss_limit = 1000000\n[realtime]\nspin_us = 0.0\n",
    );
    let connection = daemon.connect();
    wait_status(&connection, |status| {
        status.late_starts > 2 * INCIDENTS_MAX as u64
    });
    let incidents = kept(&connection);
    assert_eq!(incidents.len(), INCIDENTS_MAX);
    assert!(
        incidents[0].header.sequence > INCIDENTS_MAX as u64 / 2,
        "the first ones are gone"
    );
    for pair in incidents.windows(2) {
        assert!(pair[0].telemetry.cycle < pair[1].telemetry.cycle);
    }
    for incident in &incidents {
        assert_ne!(incident.telemetry.timing_flags & timing::LATE_START, 0);
        assert_ne!(
            incident.telemetry.scheduling.late_cause,
            LateCause::None.code()
        );
    }
}

#[test]
fn a_thread_that_spins_starts_more_punctually() {
    // Of the most punctual tenth: the others depend on the load of the machine.
    let wake_ns = |spin_us: f64| {
        let daemon = Daemon::start(&format!(
            "{STALL_TOLERANT}[realtime]\nspin_us = {spin_us}\n"
        ));
        let connection = daemon.connect();
        let mut telemetry = connection.telemetry().unwrap();
        let mut wakes_ns = Vec::new();
        while wakes_ns.len() < 300 {
            let record = wait_record(&mut telemetry, |_| true);
            wakes_ns.push(record.start_ns - record.due_ns);
        }
        wakes_ns.sort_unstable();
        wakes_ns[wakes_ns.len() / 10]
    };
    let (plain_ns, spinning_ns) = (wake_ns(0.0), wake_ns(500.0));
    assert!(
        spinning_ns <= plain_ns,
        "{spinning_ns} against {plain_ns} ns"
    );
}

/// Scheduling policy and real-time priority of a thread: fields 41 and 40 of `stat`.
fn policy_and_priority(stat: &str) -> (u32, u32) {
    let [policy, priority] = [41, 40].map(|field| stat_field(stat.as_bytes(), field).unwrap());
    (policy, priority)
}

#[test]
fn every_thread_runs_before_those_that_may_wait() {
    const SCHED_OTHER: u32 = 0;
    const SCHED_FIFO: u32 = 1;
    let daemon = Daemon::start(STALL_TOLERANT);
    let status = daemon.connect().status(TIMEOUT).unwrap();
    if status.realtime_missing & realtime::FIFO != 0 {
        skip(Need::Realtime, "the daemon is not granted SCHED_FIFO");
        return;
    }
    let folder = format!("/proc/{}/task", daemon.id());
    let threads = std::fs::read_dir(folder).unwrap().flatten();
    let found: BTreeMap<String, (u32, u32)> = threads
        .map(|thread| {
            let read = |name: &str| std::fs::read_to_string(thread.path().join(name)).unwrap();
            (
                read("comm").trim().to_owned(),
                policy_and_priority(&read("stat")),
            )
        })
        .collect();
    let expected = [
        ("cdcr-cycle", (SCHED_FIFO, 80)),
        ("cdcr-exchange", (SCHED_FIFO, 70)),
        // Off the real-time core, with priority over ordinary tasks.
        ("cdcr-reporter", (SCHED_FIFO, 1)),
        // The supervisor, which shares the lock of the address space with the exchange.
        ("cdcrd", (SCHED_FIFO, 1)),
        // As the supervisor: it removes the files of dead clients.
        ("cdcr-caretaker", (SCHED_FIFO, 1)),
        ("cdcr-status", (SCHED_FIFO, 1)),
        ("cdcr-log", (SCHED_OTHER, 0)),
    ];
    assert_eq!(
        found,
        expected
            .map(|(name, policy)| (name.to_owned(), policy))
            .into()
    );
}
