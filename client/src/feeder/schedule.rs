use std::collections::VecDeque;
use std::time::Duration;

use cdcr_shared_types::ReferencePoint;
use cdcr_shared_types::limits::{CHUNK_POINTS_MAX, REFERENCE_POINTS_MAX};

use super::{DURATION_MAX_S, FeedError, FeedOptions};
use crate::Trajectory;

/// Largest excess of a chunk over the time to be covered: few chunks, small buffer.
const CHUNK_EXTRA_NS: u64 = 250_000_000;
/// Time after its release for which a point counts as buffered: the daemon keeps the neighbours that its
/// interpolation needs.
const PLAYED_AFTER_NS: u64 = 100_000_000;

/// Shortest time between two points \[s\]: the daemon rejects less than 1 µs.
const GAP_S: f64 = 2e-6;

/// Determines the due points of a trajectory and the next chunk.
pub(super) struct Schedule<'t> {
    trajectory: &'t dyn Trajectory,
    step_s: f64,
    start_ns: u64,
    ahead_ns: u64,
    points: u64,
    next: u64,
    /// Times of the points that are sent but not yet played.
    in_flight_ns: VecDeque<u64>,
    last_sent_ns: u64,
}

impl<'t> Schedule<'t> {
    /// A schedule that begins `options.lead` after `now_ns`.
    pub(super) fn new(
        trajectory: &'t dyn Trajectory,
        options: &FeedOptions,
        now_ns: u64,
    ) -> Result<Self, FeedError> {
        let duration_s = trajectory.duration_s();
        if !(0.0..=DURATION_MAX_S).contains(&duration_s) {
            return Err(FeedError::Duration { duration_s });
        }
        let step_s = options.step.as_secs_f64();
        let points = match trajectory.knots_s() {
            Some(knots_s) => knots_s.len() as u64,
            None => sample_count(duration_s, step_s),
        };
        Ok(Self {
            trajectory,
            step_s,
            start_ns: now_ns + ns(options.lead),
            ahead_ns: ns(options.ahead),
            points,
            next: 0,
            in_flight_ns: VecDeque::new(),
            last_sent_ns: 0,
        })
    }

    pub(super) fn start_ns(&self) -> u64 {
        self.start_ns
    }

    pub(super) fn end_ns(&self) -> u64 {
        self.time_ns(self.points.saturating_sub(1))
    }

    pub(super) fn points(&self) -> u64 {
        self.points
    }

    pub(super) fn sent(&self) -> u64 {
        self.next
    }

    /// Played time of the trajectory at `now_ns` \[s\].
    pub(super) fn played_s(&self, now_ns: u64) -> f64 {
        let played_s = now_ns.saturating_sub(self.start_ns) as f64 * 1e-9;
        played_s.min(self.trajectory.duration_s())
    }

    /// Time of a point since the start of the trajectory \[s\].
    pub(super) fn time_s(&self, index: u64) -> f64 {
        match self.trajectory.knots_s() {
            Some(knots_s) => knots_s.get(index as usize).copied().unwrap_or(0.0),
            None => (index as f64 * self.step_s).min(self.trajectory.duration_s()),
        }
    }

    fn time_ns(&self, index: u64) -> u64 {
        self.start_ns + (self.time_s(index) * 1e9).round() as u64
    }

    /// The points to send now. Empty when the sent reference reaches far enough ahead, the daemon's buffer is
    /// full, or all points are sent.
    pub(super) fn next_chunk(&mut self, now_ns: u64) -> Vec<ReferencePoint> {
        self.forget_played(now_ns);
        let must_reach_ns = now_ns + self.ahead_ns;
        let mut chunk = Vec::new();
        if self.next > 0 && self.last_sent_ns >= must_reach_ns {
            return chunk;
        }
        while self.next < self.points
            && chunk.len() < CHUNK_POINTS_MAX
            && self.in_flight_ns.len() < REFERENCE_POINTS_MAX
            && (chunk.is_empty() || self.last_sent_ns < must_reach_ns + CHUNK_EXTRA_NS)
        {
            let time_ns = self.time_ns(self.next);
            chunk.push(self.trajectory.point(self.time_s(self.next), time_ns));
            self.in_flight_ns.push_back(time_ns);
            self.last_sent_ns = time_ns;
            self.next += 1;
        }
        chunk
    }

    fn forget_played(&mut self, now_ns: u64) {
        while let Some(&time_ns) = self.in_flight_ns.front()
            && time_ns + PLAYED_AFTER_NS < now_ns
        {
            self.in_flight_ns.pop_front();
        }
    }
}

/// Number of points at 0, step, 2 step, …, and one at the end.
fn sample_count(duration_s: f64, step_s: f64) -> u64 {
    let steps = duration_s / step_s;
    // A remainder below a millionth of a step is due to rounding.
    let whole = (steps + 1e-6).floor();
    let remainder = u64::from((steps - whole) * step_s > GAP_S);
    whole as u64 + 1 + remainder
}

fn ns(duration: Duration) -> u64 {
    duration.as_nanos() as u64
}

#[cfg(all(test, feature = "csv"))]
mod tests {
    use super::*;
    use crate::{FileTrajectory, Spiral};
    use std::path::Path;

    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn the_spiral_has_995_points_and_reaches_its_end() {
        let spiral = Spiral::for_sections(&[0.3]);
        let schedule = Schedule::new(&spiral, &FeedOptions::default(), SECOND_NS).expect("valid");
        assert_eq!(schedule.points(), 995);
        assert_eq!(schedule.start_ns(), 1_300_000_000);
        assert_eq!(schedule.end_ns(), 1_300_000_000 + 4_970_000_000);
    }

    #[test]
    fn a_remainder_gets_a_point_at_the_end() {
        assert_eq!(sample_count(0.0, 0.005), 1);
        assert_eq!(sample_count(0.012, 0.005), 4);
        assert_eq!(sample_count(2.55, 0.005), 511);
        // The daemon would reject a point 0.5 µs after the last one.
        assert_eq!(sample_count(1.000_000_5, 0.005), 201);
        assert_eq!(sample_count(1.000_005, 0.005), 202);
    }

    #[test]
    fn chunks_stay_ahead_follow_each_other_and_respect_the_limits() {
        let spiral = Spiral::for_sections(&[0.3]);
        let options = FeedOptions::default();
        let mut schedule = Schedule::new(&spiral, &options, 0).expect("valid");
        let mut times = Vec::new();
        let mut now_ns = 0;
        while schedule.sent() < schedule.points() {
            let mut chunk = schedule.next_chunk(now_ns);
            while !chunk.is_empty() {
                assert!(chunk.len() <= CHUNK_POINTS_MAX);
                times.extend(chunk.iter().map(|p| p.time_ns));
                chunk = schedule.next_chunk(now_ns);
            }
            let last = *times.last().expect("points were sent");
            assert!(last >= now_ns + SECOND_NS || last == schedule.end_ns());
            assert!(last <= now_ns + 2 * SECOND_NS);
            now_ns += 5_000_000;
        }
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(times.len(), 995);
    }

    #[test]
    fn a_dense_file_never_overfills_the_buffer() {
        let rows = (0..20_000).map(|i| format!("{},0,0,0.3\n", f64::from(i) * 1e-4));
        let text = format!("t_s,x_m,y_m,z_m\n{}", rows.collect::<String>());
        let file = FileTrajectory::parse(Path::new("dense.csv"), &text).expect("good");
        let mut schedule = Schedule::new(&file, &FeedOptions::default(), 0).expect("valid");
        let mut sent = 0;
        loop {
            let chunk = schedule.next_chunk(0);
            if chunk.is_empty() {
                break;
            }
            sent += chunk.len();
        }
        assert_eq!(sent, REFERENCE_POINTS_MAX);
    }

    #[test]
    fn sparse_files_send_one_point_beyond() {
        let text = "t_s,x_m,y_m,z_m\n0,0,0,0.3\n10,0.1,0,0.3\n20,0,0,0.3\n";
        let file = FileTrajectory::parse(Path::new("sparse.csv"), text).expect("good");
        let mut schedule = Schedule::new(&file, &FeedOptions::default(), 0).expect("valid");
        assert_eq!(schedule.next_chunk(0).len(), 2);
        assert!(schedule.next_chunk(0).is_empty());
        assert_eq!(schedule.next_chunk(9_400_000_000).len(), 1);
    }
}
