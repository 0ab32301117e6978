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
    samples: [ReferenceSample; Self::SAMPLES_MAX],
}

impl Default for ReferenceWindow {
    fn default() -> Self {
        Self {
            first_cycle: 0,
            count: 0,
            samples: [ReferenceSample::default(); Self::SAMPLES_MAX],
        }
    }
}

impl ReferenceWindow {
    /// Periods of slack: 20 periods, 100 ms at 5 ms, more than the longest stall that is survived.
    pub const SLACK: usize = 20;
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

    /// The sample at the release of `cycle`; past the window, its last one counts as ended.
    pub fn at(&self, cycle: u64) -> ReferenceSample {
        let offset = cycle.saturating_sub(self.first_cycle) as usize;
        match self.samples[..self.count].get(offset) {
            Some(sample) => *sample,
            None => {
                self.samples[..self.count]
                    .last()
                    .map_or_else(ReferenceSample::default, |last| ReferenceSample {
                        state: ReferenceState::Ended,
                        ..*last
                    })
            }
        }
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

    fn window(first_cycle: u64) -> ReferenceWindow {
        let mut trajectory = Trajectory::with_capacity(1000);
        let points = (0..900).map(|k| ReferencePoint {
            time_ns: k * 10,
            position_m: Vector3::new(k as f64, 0.0, 0.0),
            orientation: Orientation::Free,
            interpolation: Interpolation::Linear,
        });
        trajectory.replace(points).expect("legal points");
        let mut window = ReferenceWindow::default();
        window.fill(&trajectory, first_cycle, first_cycle * 10, 10, 2);
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
        let empty = ReferenceWindow::default();
        assert_eq!(empty.at(7).state, ReferenceState::None);
        assert!(empty.ahead(7, 3).is_empty());
    }
}
