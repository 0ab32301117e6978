//! Messages that the daemon must reject.

use std::time::{Duration, Instant};

use cdcr_client::monotonic_ns;
use cdcr_shared_types::codes::{ChunkMode, Interpolation, RequestKind};
use cdcr_shared_types::{ReferencePoint, SolverSettings};

use super::Director;
use crate::chaos::dice::Dice;
use crate::chaos::{CheckResult, ensure, obstacles};

/// Time limit for taking the lease while other clients hold it.
const LEASE_TIMEOUT: Duration = Duration::from_secs(3);

impl Director<'_> {
    /// Sends ten valid points that `spoil` has modified, by index.
    pub(super) fn send_points(&mut self, spoil: impl FnOnce(&mut Dice, &mut [ReferencePoint; 10])) {
        let begin_ns = monotonic_ns() + 50_000_000;
        let mut points: [ReferencePoint; 10] = core::array::from_fn(|i| ReferencePoint {
            time_ns: begin_ns + i as u64 * 10_000_000,
            position_m: [0.01 * i as f64, 0.0, 0.8],
            ..ReferencePoint::default()
        });
        spoil(&mut self.dice, &mut points);
        let (mode, between) = (ChunkMode::Replace, Interpolation::Cubic);
        self.feed.send(mode, between, &points).unwrap();
    }

    pub(super) fn next_turn(&mut self, of: usize) -> u32 {
        self.turns[of] += 1;
        self.turns[of]
    }

    /// Takes the lease when it becomes free, so that the points themselves are checked. Returns whether it
    /// succeeded.
    fn hold_lease(&self) -> bool {
        let begin = Instant::now();
        while begin.elapsed() < LEASE_TIMEOUT {
            if let Ok(lease) = self.connection.acquire_lease() {
                std::mem::forget(lease);
                return true;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        false
    }

    pub(super) fn late_points(&mut self) {
        let has_lease = self.hold_lease();
        self.send_points(|dice, points| {
            let late_ns = u64::from(200_000_000 + dice.below(1_000_000_000));
            for point in points {
                point.time_ns -= late_ns;
            }
        });
        self.give_back(has_lease);
    }

    pub(super) fn bad_points(&mut self) {
        let (has_lease, turn) = (self.hold_lease(), self.next_turn(0));
        self.send_points(|dice, points| {
            let first_ns = points[0].time_ns;
            let point = &mut points[1 + dice.below(9) as usize];
            match turn % 5 {
                0 => point.position_m[1] = f64::NAN,
                1 => point.position_m = dice.vector(3.0),
                2 => point.orientation_kind = 77,
                3 => point.time_ns = first_ns,
                // A tip axis of zero length.
                _ => point.orientation_kind = 1,
            }
        });
        self.give_back(has_lease);
    }

    fn give_back(&mut self, has_lease: bool) {
        let words = if has_lease { "with" } else { "without" };
        self.tally
            .count(format!("bad or late points: {words} the lease"));
        if has_lease && self.dice.chance(50) {
            let _ = self.connection.request(RequestKind::ReleaseLease);
        }
    }

    pub(super) fn too_many_obstacles(&mut self) {
        for ids in [0..64, 40..70] {
            let crowd: Vec<_> = ids.map(obstacles::far).collect();
            self.obstacles.upsert(&crowd).unwrap();
        }
    }

    pub(super) fn bad_settings(&mut self) -> CheckResult {
        let first = self.first_settings;
        let bad = match self.next_turn(2) % 4 {
            0 => SolverSettings {
                solver: 99,
                ..first
            },
            1 => SolverSettings {
                horizon_steps: 51,
                ..first
            },
            2 => SolverSettings {
                position_weight: f64::NAN,
                ..first
            },
            _ => SolverSettings {
                safe_distance_m: -0.01,
                ..first
            },
        };
        let answer = self.connection.change_settings(bad);
        ensure(answer.is_err(), || {
            format!("bad settings were accepted: {bad:?}")
        })
    }
}
