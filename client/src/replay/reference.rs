use std::collections::{BTreeMap, HashMap, VecDeque};

use cdcr_controller::reference::{ReferenceWindow, Trajectory};
use cdcr_controller::robot::Robot;
use cdcr_shared_types::codes::{ChunkMode, EventKind, Outcome};
use cdcr_shared_types::limits::REFERENCE_POINTS_MAX;
use cdcr_shared_types::{InputEvent, ReferenceChunk, Telemetry};

use crate::events;
use crate::model::reference_points;

/// Maximum number of chunks without an outcome yet. A daemon buffers 32.
const CHUNKS_MAX: usize = 512;

/// Sender and sequence number of a chunk.
type Key = (u64, u64);

/// The reference of the daemon, rebuilt from the chunks and the events with their outcomes.
#[derive(Debug, Default)]
pub(super) struct Reference {
    chunks: HashMap<Key, Box<ReferenceChunk>>,
    /// The same chunks, oldest first.
    order: VecDeque<Key>,
    /// Events by the gather in which they took effect.
    events: BTreeMap<u64, Vec<InputEvent>>,
    trajectory: Option<Trajectory>,
    window: ReferenceWindow,
    /// Chunks of the trajectory with points not passed yet, and the one before.
    in_force: VecDeque<Box<ReferenceChunk>>,
    last: Option<Key>,
    /// Whether the trajectory is complete.
    is_known: bool,
    /// Whether missing records may have continued it.
    has_gap: bool,
    /// Accepted requests that no cycle has executed yet, with their gather, in order.
    requests: VecDeque<(u64, InputEvent)>,
}

impl Reference {
    pub(super) fn take_chunk(&mut self, chunk: &ReferenceChunk) {
        let key = (chunk.header.sender_id, chunk.header.sequence);
        if self.chunks.insert(key, Box::new(*chunk)).is_none() {
            self.order.push_back(key);
        }
        if self.order.len() > CHUNKS_MAX
            && let Some(oldest) = self.order.pop_front()
        {
            self.chunks.remove(&oldest);
        }
    }

    pub(super) fn take_events(&mut self, record: &Telemetry) {
        for event in events(record) {
            let gather = record.gather.saturating_sub(event.gathers_ago.into());
            self.events.entry(gather).or_default().push(*event);
        }
    }

    /// Discards the events of the previous daemon: gathers are counted from the start.
    pub(super) fn forget_events(&mut self) {
        self.events.clear();
        self.requests.clear();
    }

    /// Starts without a reference, for this robot.
    pub(super) fn begin(&mut self, robot: &Robot) {
        // Larger than the daemon's, which discards old points a little earlier.
        let capacity = 2 * REFERENCE_POINTS_MAX;
        self.trajectory = Some(Trajectory::with_capacity(capacity, robot.reach_m()));
        self.in_force.clear();
        (self.last, self.is_known, self.has_gap) = (None, false, false);
    }

    /// Records are missing: the trajectory may have been continued or replaced.
    pub(super) fn note_missing_records(&mut self) {
        self.has_gap = true;
    }

    pub(super) fn is_known(&self) -> bool {
        self.is_known && !self.has_gap
    }

    /// Repeats the daemon's steps up to the gather of a record.
    pub(super) fn advance_to(&mut self, record: &Telemetry) {
        // A delayed exchange gathers for a cycle that has passed long ago.
        let needed_ns = record.release_ns.min(window_release_ns(record));
        let behind_ns = needed_ns.saturating_sub(2 * record.period_ns);
        if let Some(trajectory) = &mut self.trajectory {
            trajectory.forget_before(behind_ns);
        }
        let ends_ns = |chunk: &ReferenceChunk| {
            let last = chunk.count.saturating_sub(1) as usize;
            chunk.points.get(last).map_or(0, |point| point.time_ns)
        };
        // A sample needs its neighbours, which may be in the previous chunk.
        while self.in_force.len() > 2 && ends_ns(&self.in_force[1]) < behind_ns {
            self.in_force.pop_front();
        }
        while let Some(entry) = self.events.first_entry()
            && *entry.key() <= record.gather
        {
            let (gather, events) = entry.remove_entry();
            for event in events {
                if event.outcome != Outcome::Accepted.code() {
                    continue;
                }
                if event.kind == EventKind::Reference.code() {
                    self.apply((event.sender_id, event.sequence));
                } else if event.kind == EventKind::Request.code() {
                    self.requests.push_back((gather, event));
                }
            }
        }
    }

    /// Applies an accepted chunk.
    fn apply(&mut self, key: Key) {
        let (sender, number) = key;
        let Some(chunk) = self.chunks.remove(&key) else {
            // The chunk was sent before the recording began, or was lost.
            (self.is_known, self.last) = (false, Some(key));
            return;
        };
        if chunk.mode == ChunkMode::Replace.code() {
            self.put(chunk, key);
            return;
        }
        // Appended chunks follow each other without a gap: those between were accepted, too.
        let Some((_, last)) = self
            .last
            .filter(|(of, last)| *of == sender && *last < number)
        else {
            (self.is_known, self.last) = (false, Some(key));
            return;
        };
        for between in last + 1..number {
            let Some(chunk) = self.chunks.remove(&(sender, between)) else {
                self.is_known = false;
                break;
            };
            self.put(chunk, (sender, between));
        }
        self.put(chunk, key);
    }

    fn put(&mut self, chunk: Box<ReferenceChunk>, key: Key) {
        self.order.retain(|kept| *kept != key);
        self.has_gap = false;
        self.last = Some(key);
        let begins = chunk.mode == ChunkMode::Replace.code();
        let Some((points, trajectory)) = reference_points(&chunk).zip(self.trajectory.as_mut())
        else {
            self.is_known = false;
            return;
        };
        let taken = if begins {
            self.in_force.clear();
            self.is_known = true;
            trajectory.replace(points.into_iter())
        } else {
            trajectory.append(points.into_iter())
        };
        self.is_known &= taken.is_ok();
        self.in_force.push_back(chunk);
    }

    /// The reference window of a record for a horizon of `steps`.
    pub(super) fn window(&mut self, record: &Telemetry, steps: usize) -> &ReferenceWindow {
        if let Some(trajectory) = &self.trajectory {
            self.window.fill(
                trajectory,
                record.window_first_cycle,
                window_release_ns(record),
                record.period_ns,
                steps,
                record.reference_lead_ns,
            );
        }
        &self.window
    }

    /// The accepted requests executed by the cycle of a record; `later` is the next record.
    pub(super) fn requests(
        &mut self,
        record: &Telemetry,
        later: Option<&Telemetry>,
    ) -> Vec<InputEvent> {
        let is_next = |(gather, event): &(u64, InputEvent)| {
            *gather < record.gather
                || later.is_none_or(|later| {
                    later.gather > *gather || event.evaluated_ns < later.handed_over_ns
                })
        };
        let mut requests = Vec::new();
        while self.requests.front().is_some_and(is_next) {
            requests.extend(self.requests.pop_front().map(|(_, event)| event));
        }
        requests
    }

    pub(super) fn chunks_in_force(&self) -> Vec<ReferenceChunk> {
        self.in_force.iter().map(|chunk| **chunk).collect()
    }
}

/// The release of the first sample of a record's window: a late cycle has inputs that were gathered for the
/// next one.
fn window_release_ns(record: &Telemetry) -> u64 {
    let ahead = record.window_first_cycle.cast_signed() - record.cycle.cast_signed();
    let ahead_ns = ahead.wrapping_mul(record.period_ns.cast_signed());
    record.release_ns.saturating_add_signed(ahead_ns)
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::RobotParameters;

    use super::*;

    const PERIOD_NS: u64 = 5_000_000;

    #[test]
    fn a_window_of_an_exchange_that_was_held_up_is_sampled_as_it_was() {
        let robot = Robot::new(&RobotParameters::paper(1)).expect("a robot");
        let mut chunk = ReferenceChunk {
            mode: ChunkMode::Replace.code(),
            count: 120,
            ..ReferenceChunk::default()
        };
        for (k, point) in chunk.points.iter_mut().take(120).enumerate() {
            point.time_ns = k as u64 * PERIOD_NS;
            point.position_m[0] = 1e-3 * k as f64;
        }
        let mut reference = Reference::default();
        reference.begin(&robot);
        reference.take_chunk(&chunk);
        let record = |cycle, gather, window_first_cycle| Telemetry {
            cycle,
            release_ns: cycle * PERIOD_NS,
            period_ns: PERIOD_NS,
            gather,
            window_first_cycle,
            ..Telemetry::default()
        };
        let mut first = record(2, 1, 2);
        first.event_count = 1;
        first.events[0].kind = EventKind::Reference.code();
        reference.take_events(&first);
        let mut check = |record: &Telemetry, last: u64| {
            reference.advance_to(record);
            let window = reference.window(record, 2);
            assert!((window.get(last).position_m.x - 1e-3 * last as f64).abs() < 1e-12);
            assert_eq!(window.get(last + 1), window.get(last));
        };
        check(&first, 64);
        // 76 periods later, with a window that was gathered for the third cycle.
        check(&record(78, 2, 3), 65);
    }
}
