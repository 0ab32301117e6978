use super::{ReferenceSample, ReferenceState, Trajectory};

/// Steps of the longest horizon that a window serves: a quarter of a second at 5 ms.
pub const HORIZON_STEPS_MAX: usize = 50;

/// Samples of the reference on the grid of the cycle: at the release, and at each step of the longest
/// horizon after it, plus some periods of slack for cycles that come late.
///
/// The exchange makes it before a release; the cycle reads it by grid index, so a cycle that was
/// skipped does not make it wrong, only shorter.
#[derive(Debug, Clone)]
pub struct ReferenceWindow {
    first_cycle: u64,
    count: usize,
    /// How many periods past its last sample the window still holds.
    patience: u64,
    samples: [ReferenceSample; Self::SAMPLES_MAX],
}

impl Default for ReferenceWindow {
    fn default() -> Self {
        Self {
            first_cycle: 0,
            count: 0,
            patience: 0,
            samples: [ReferenceSample::default(); Self::SAMPLES_MAX],
        }
    }
}

impl ReferenceWindow {
    /// Periods of slack: 20 periods, 100 ms at 5 ms, more than the longest stall that is survived.
    pub const SLACK: usize = 20;
    /// With shorter periods 20 of them are soon over: for this long after the release that it was made for \[ns\] the
    /// last sample stands for those that are missing.
    pub const PATIENCE_NS: u64 = 100_000_000;
    /// Samples of the longest window.
    pub const SAMPLES_MAX: usize = HORIZON_STEPS_MAX + 1 + Self::SLACK;

    /// Samples `trajectory` at the release of `first_cycle` and `horizon_steps + SLACK` periods
    /// after it.
    pub fn fill(
        &mut self,
        trajectory: &Trajectory,
        first_cycle: u64,
        release_ns: u64,
        period_ns: u64,
        horizon_steps: usize,
    ) {
        self.first_cycle = first_cycle;
        self.count = horizon_steps.min(HORIZON_STEPS_MAX) + 1 + Self::SLACK;
        let slack = Self::SLACK as u64;
        self.patience = (Self::PATIENCE_NS / period_ns.max(1)).saturating_sub(slack);
        if trajectory.is_empty() {
            self.count = 0;
        }
        for (step, sample) in (0..).zip(&mut self.samples[..self.count]) {
            *sample = trajectory.sample(release_ns + step * period_ns);
        }
    }

    /// The cycle of the first sample.
    pub fn first_cycle(&self) -> u64 {
        self.first_cycle
    }

    /// The sample at the release of `cycle`. Past the window its last one, as long as the patience lasts; then the
    /// reference counts as ended, because nobody has said for so long how it goes on.
    pub fn at(&self, cycle: u64) -> ReferenceSample {
        let offset = cycle.saturating_sub(self.first_cycle) as usize;
        match self.samples[..self.count].get(offset) {
            Some(sample) => *sample,
            None => self.beyond((offset - self.count) as u64),
        }
    }

    /// What counts as the sample so many periods past the last one.
    fn beyond(&self, past: u64) -> ReferenceSample {
        let Some(last) = self.samples[..self.count].last() else {
            return ReferenceSample::default();
        };
        let state = if past < self.patience {
            last.state
        } else {
            ReferenceState::Ended
        };
        ReferenceSample { state, ..*last }
    }

    /// The samples at the `steps` releases after that of `cycle`; fewer when the window ends before.
    pub fn ahead(&self, cycle: u64, steps: usize) -> &[ReferenceSample] {
        let offset = cycle.saturating_sub(self.first_cycle) as usize + 1;
        let end = (offset + steps).min(self.count);
        // A cycle so late that nothing is ahead sees the last sample.
        &self.samples[offset.min(self.count.saturating_sub(1)).min(end)..end]
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::reference::{Interpolation, Orientation, ReferencePoint};

    const PERIOD_NS: u64 = 5_000_000;

    fn window(first_cycle: u64) -> ReferenceWindow {
        let mut trajectory = Trajectory::with_capacity(1000);
        let points = (0..900).map(|k| ReferencePoint {
            time_ns: k * PERIOD_NS,
            position_m: Vector3::new(k as f64, 0.0, 0.0),
            orientation: Orientation::Free,
            interpolation: Interpolation::Linear,
        });
        trajectory.replace(points).expect("legal points");
        let mut window = ReferenceWindow::default();
        let release_ns = first_cycle * PERIOD_NS;
        window.fill(&trajectory, first_cycle, release_ns, PERIOD_NS, 2);
        window
    }

    fn x(samples: &[ReferenceSample]) -> Vec<f64> {
        samples.iter().map(|sample| sample.position_m.x).collect()
    }

    #[test]
    fn a_cycle_reads_the_samples_of_its_own_release() {
        let window = window(100);
        assert_eq!(window.at(100).position_m.x, 100.0);
        assert_eq!(x(window.ahead(100, 2)), [101.0, 102.0]);
        // Five periods late, with the same window.
        assert_eq!(window.at(105).position_m.x, 105.0);
        assert_eq!(x(window.ahead(105, 2)), [106.0, 107.0]);
    }

    #[test]
    fn past_its_end_the_window_says_that_the_reference_ended() {
        let window = window(100);
        assert_eq!(window.at(500).state, ReferenceState::Ended);
        assert_eq!(x(window.ahead(500, 2)), [122.0]);
        assert_eq!(x(window.ahead(121, 2)), [122.0]);
        assert_eq!(window.at(123).state, ReferenceState::Ended);
        let empty = ReferenceWindow::default();
        assert_eq!(empty.at(7).state, ReferenceState::None);
        assert!(empty.ahead(7, 3).is_empty());
    }

    #[test]
    fn short_periods_get_the_same_time() {
        let points = [0, 1_000_000_000].map(|time_ns| ReferencePoint {
            time_ns,
            position_m: Vector3::zeros(),
            orientation: Orientation::Free,
            interpolation: Interpolation::Linear,
        });
        let mut trajectory = Trajectory::with_capacity(2);
        trajectory
            .replace(points.into_iter())
            .expect("legal points");
        let mut window = ReferenceWindow::default();
        window.fill(&trajectory, 0, 0, 100_000, 2);
        // 1000 periods are 100 ms, and the horizon comes on top.
        assert_eq!(window.at(1002).state, ReferenceState::Inside);
        assert_eq!(window.at(1003).state, ReferenceState::Ended);
        // A reference that ends within the window ends there.
        window.fill(&trajectory, 0, 999_900_000, 100_000, 2);
        assert_eq!(window.at(30).state, ReferenceState::Ended);
    }
}
