//! Ten thousand short runs of a controller: the daemon's cycle on a test clock, with a faulty robot, all
//! drawn from a seed. The invariants of the randomised run with processes are checked on each record.

mod driver;
mod world;

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use cdcr_shared_types::codes::{Mode, Reason};
use cdcr_tests::asked;

use crate::chaos::records::Seen;
use world::{ReplayCounts, World};

/// Cycles of a run: one and a half seconds at 5 ms.
const CYCLES: u32 = 300;

/// Counts of all runs.
#[derive(Debug, Default)]
struct Sum {
    records: u64,
    /// These and the next two: runs with a mild robot.
    mild_records: u64,
    tracked_moving: u64,
    with_tip_beside: u64,
    with_obstacles: u64,
    guarded: u64,
    skipped_periods: u64,
    modes: BTreeMap<&'static str, u64>,
    changes: BTreeMap<String, u64>,
    limited: BTreeMap<&'static str, u64>,
    replayed: ReplayCounts,
}

impl Sum {
    fn add(&mut self, (seen, replayed): (Seen, ReplayCounts), is_mild: bool) {
        for (kind, count) in replayed {
            *self.replayed.entry(kind).or_default() += count;
        }
        self.records += seen.records;
        if is_mild {
            self.mild_records += seen.records;
            self.tracked_moving += seen.tracked_moving;
            self.with_tip_beside += seen.with_tip_beside;
        }
        self.with_obstacles += seen.with_obstacles;
        self.guarded += seen.guarded;
        self.skipped_periods += seen.skipped_periods;
        for (mode, count) in seen.modes {
            *self.modes.entry(mode).or_default() += count;
        }
        for (change, count) in seen.changes {
            *self.changes.entry(change).or_default() += count;
        }
        for (limit, count) in seen.limited {
            *self.limited.entry(limit).or_default() += count;
        }
    }

    /// Checks that all events occurred; otherwise the runs prove nothing.
    fn assert_it_happened(&self, runs: u64) {
        for mode in [
            Mode::Starting,
            Mode::Holding,
            Mode::Tracking,
            Mode::Homing,
            Mode::Stopped,
            Mode::Faulted,
        ] {
            assert!(self.modes.contains_key(mode.text()), "{mode}");
        }
        let often = [
            Reason::MeasurementLost,
            Reason::MeasurementJump,
            Reason::ClearanceBroken,
            Reason::InputsStale,
            Reason::DeadlineMisses,
        ];
        let seldom = [
            Reason::FollowingError,
            Reason::MeasurementFrozen,
            Reason::LimitBroken,
            Reason::Suspended,
        ];
        let seldom = seldom.iter().filter(|_| runs >= 1000);
        for reason in often.iter().chain(seldom) {
            let because = format!("({reason})");
            let mut changes = self.changes.keys();
            assert!(changes.any(|change| change.ends_with(&because)), "{reason}");
        }
        assert!(self.tracked_moving > self.mild_records / 50);
        assert!(self.with_tip_beside > self.mild_records / 10);
        assert!(self.with_obstacles > self.records / 5);
        assert!(self.guarded > 0 && self.skipped_periods > 0);
        assert!(self.replayed.values().all(|count| *count > 0));
    }
}

#[test]
fn whatever_a_misbehaving_robot_does_the_invariants_hold_in_every_cycle() {
    // The same runs each time by default, so that the events they must contain do not depend on chance.
    let (first, runs): (u64, u64) = (
        asked("CDCR_CHAOS_SEED").unwrap_or(1),
        asked("CDCR_CHAOS_RUNS").unwrap_or(100),
    );
    println!("CDCR_CHAOS_SEED={first}, {runs} runs of {CYCLES} cycles");
    let (next, sum) = (AtomicU64::new(0), Mutex::new(Sum::default()));
    let work = || {
        loop {
            let run = next.fetch_add(1, Ordering::Relaxed);
            if run >= runs {
                return;
            }
            let seed = first.wrapping_add(run);
            let world = World::new(seed);
            let is_mild = world.has_mild_robot();
            let seen = world.live(CYCLES).unwrap_or_else(|broken| {
                panic!("{broken}\nrepeat it with CDCR_CHAOS_SEED={seed} CDCR_CHAOS_RUNS=1")
            });
            sum.lock().unwrap().add(seen, is_mild);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().unwrap().get() {
            scope.spawn(work);
        }
    });
    let sum = sum.into_inner().unwrap();
    println!("{sum:#?}");
    // A single run repeats a failure.
    if runs >= 100 {
        sum.assert_it_happened(runs);
    }
}
