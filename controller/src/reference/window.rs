use super::{ReferenceSample, ReferenceState, Trajectory};

/// Steps of the longest horizon of a window: a quarter of a second at 5 ms.
pub const HORIZON_STEPS_MAX: usize = 50;

/// Samples of the reference on the grid of the cycle: at the release, and at each step of the longest horizon after it.
/// Slack for late cycles and for a delayed exchange follows.
///
/// A robot whose motors lag behind their commands must be commanded ahead of the reference. For such a robot, the
/// samples of the horizon are taken `lead_ns` later.
///
/// The exchange fills it before a release. The cycle reads it by grid index, so a skipped cycle shortens it but does
/// not invalidate it.
#[derive(Debug, Clone)]
pub struct ReferenceWindow {
    first_cycle: u64,
    count: usize,
    /// Periods past its last sample for which the window remains valid.
    timeout_cycles: u64,
    /// At the releases; sized for the longest window, allocated once.
    samples: Box<[ReferenceSample]>,
    /// The samples `lead_ns` later; filled only if the lead is not 0.
    lead_samples: Box<[ReferenceSample]>,
    has_lead: bool,
    replacements: u64,
    inputs: WindowInputs,
}

/// Inputs from which the samples were made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct WindowInputs {
    revision: u64,
    period_ns: u64,
    lead_ns: u64,
    release_ns: u64,
}

impl Default for ReferenceWindow {
    fn default() -> Self {
        let samples = vec![ReferenceSample::default(); Self::SAMPLES_MAX].into_boxed_slice();
        Self {
            first_cycle: 0,
            count: 0,
            timeout_cycles: 0,
            lead_samples: samples.clone(),
            samples,
            has_lead: false,
            replacements: 0,
            inputs: WindowInputs::default(),
        }
    }
}

impl ReferenceWindow {
    /// Longest time for which cycles without a new window continue with an old one \[ns\]. Past its slack, the last
    /// sample is held. The exchange may wait for a starved client that holds the lock of the folder; 0.3 s were
    /// observed. An exchange that hangs for longer is handled by the watchdog.
    pub const TIMEOUT_NS: u64 = 1_000_000_000;
    /// Minimum slack in periods, unless this exceeds the timeout.
    pub const SLACK_MIN: usize = 20;
    /// Maximum slack in periods.
    pub const SLACK_MAX: usize = 60;
    /// A sample costs about 0.1 µs. One sample of slack for each of these intervals in the period \[ns\] keeps its
    /// share of the time near a thousandth. At short periods [`Self::SLACK_MIN`] costs more.
    const PERIOD_PER_SAMPLE_NS: u64 = 80_000;
    /// Number of samples of the longest window.
    pub const SAMPLES_MAX: usize = HORIZON_STEPS_MAX + 1 + Self::SLACK_MAX;

    /// Slack in periods: 60, 0.3 s, at 5 ms; at most the [timeout](Self::TIMEOUT_NS) at longer periods, fewer at
    /// shorter ones. Past the slack, the last sample is held until the timeout.
    pub fn slack(period_ns: u64) -> usize {
        let affordable = period_ns / Self::PERIOD_PER_SAMPLE_NS;
        let useful = Self::TIMEOUT_NS / period_ns.max(1);
        let wanted = affordable.clamp(Self::SLACK_MIN as u64, Self::SLACK_MAX as u64);
        wanted.min(useful) as usize
    }

    /// Samples `trajectory` at the release of `first_cycle`, at those of the horizon, and for the [slack](Self::slack)
    /// after it. The samples of [`Self::ahead`] are taken `lead_ns` later.
    pub fn fill(
        &mut self,
        trajectory: &Trajectory,
        first_cycle: u64,
        release_ns: u64,
        period_ns: u64,
        horizon_steps: usize,
        lead_ns: u64,
    ) {
        let inputs = WindowInputs {
            revision: trajectory.revision(),
            period_ns,
            lead_ns,
            release_ns,
        };
        let known = self.keep_valid(&inputs);
        self.replacements = trajectory.replacements();
        self.first_cycle = first_cycle;
        let slack = Self::slack(period_ns);
        self.count = horizon_steps.min(HORIZON_STEPS_MAX) + 1 + slack;
        self.timeout_cycles = (Self::TIMEOUT_NS / period_ns.max(1)).saturating_sub(slack as u64);
        if trajectory.is_empty() {
            self.count = 0;
        }
        self.has_lead = lead_ns > 0;
        for step in known..self.count {
            let time_ns = release_ns + step as u64 * period_ns;
            self.samples[step] = trajectory.sample(time_ns);
            if self.has_lead {
                self.lead_samples[step] = trajectory.sample(time_ns + lead_ns);
            }
        }
    }

    /// Moves samples that remain valid, from the same points and the same grid, to the front. Returns their number.
    fn keep_valid(&mut self, inputs: &WindowInputs) -> usize {
        let before = core::mem::replace(&mut self.inputs, *inputs);
        let same_grid = WindowInputs {
            release_ns: before.release_ns,
            ..*inputs
        };
        let passed_ns = inputs.release_ns.checked_sub(before.release_ns);
        let Some(passed_ns) = passed_ns.filter(|_| before == same_grid) else {
            return 0;
        };
        let passed = (passed_ns / inputs.period_ns.max(1)).min(self.count as u64) as usize;
        if passed as u64 * inputs.period_ns != passed_ns {
            return 0;
        }
        self.samples.copy_within(passed..self.count, 0);
        if self.has_lead {
            self.lead_samples.copy_within(passed..self.count, 0);
        }
        self.count - passed
    }

    /// Number of replacements of the trajectory when it was sampled.
    pub fn replacements(&self) -> u64 {
        self.replacements
    }

    /// Cycle of the first sample.
    pub fn first_cycle(&self) -> u64 {
        self.first_cycle
    }

    /// The sample at the release of `cycle`. Past the window, the last sample is held until the timeout. Then the
    /// reference counts as ended, because the exchange has not renewed it.
    pub fn get(&self, cycle: u64) -> ReferenceSample {
        let offset = cycle.saturating_sub(self.first_cycle) as usize;
        match self.samples[..self.count].get(offset) {
            Some(sample) => *sample,
            None => self.past_end((offset - self.count) as u64),
        }
    }

    /// The sample `past` periods beyond the last one.
    fn past_end(&self, past: u64) -> ReferenceSample {
        let Some(last) = self.samples[..self.count].last() else {
            return ReferenceSample::default();
        };
        let state = if past < self.timeout_cycles {
            last.state
        } else {
            ReferenceState::Ended
        };
        ReferenceSample { state, ..*last }
    }

    /// The samples at the `steps` releases after that of `cycle`, or the lead later; fewer if the window ends before.
    pub fn ahead(&self, cycle: u64, steps: usize) -> &[ReferenceSample] {
        let samples = if self.has_lead {
            &self.lead_samples
        } else {
            &self.samples
        };
        let offset = cycle.saturating_sub(self.first_cycle) as usize + 1;
        let end = (offset + steps).min(self.count);
        // A cycle so late that no sample is ahead gets the last one.
        &samples[offset.min(self.count.saturating_sub(1)).min(end)..end]
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::reference::{Interpolation, Orientation, ReferencePoint};

    const PERIOD_NS: u64 = 5_000_000;

    fn window(first_cycle: u64, lead_ns: u64) -> ReferenceWindow {
        let mut trajectory = Trajectory::with_capacity(1000, f64::INFINITY);
        let points = (0..900).map(|k| ReferencePoint {
            time_ns: k * PERIOD_NS,
            position_m: Vector3::new(k as f64, 0.0, 0.0),
            orientation: Orientation::Free,
            interpolation: Interpolation::Linear,
        });
        trajectory.replace(points).expect("legal points");
        let mut window = ReferenceWindow::default();
        let release_ns = first_cycle * PERIOD_NS;
        window.fill(&trajectory, first_cycle, release_ns, PERIOD_NS, 2, lead_ns);
        window
    }

    fn x(samples: &[ReferenceSample]) -> Vec<f64> {
        samples.iter().map(|sample| sample.position_m.x).collect()
    }

    #[test]
    fn a_cycle_reads_the_samples_of_its_own_release() {
        let window = window(100, 0);
        assert_eq!(window.get(100).position_m.x, 100.0);
        assert_eq!(x(window.ahead(100, 2)), [101.0, 102.0]);
        // Five periods late, with the same window.
        assert_eq!(window.get(105).position_m.x, 105.0);
        assert_eq!(x(window.ahead(105, 2)), [106.0, 107.0]);
    }

    #[test]
    fn the_horizon_is_ahead_by_the_lead_and_the_release_is_not() {
        let window = window(100, 2 * PERIOD_NS + PERIOD_NS / 2);
        assert_eq!(window.get(100).position_m.x, 100.0);
        assert_eq!(x(window.ahead(100, 2)), [103.5, 104.5]);
        assert_eq!(x(window.ahead(500, 2)), [164.5]);
    }

    #[test]
    fn past_its_end_the_window_reports_an_ended_reference() {
        let window = window(100, 0);
        assert_eq!(window.get(500).state, ReferenceState::Ended);
        assert_eq!(x(window.ahead(500, 2)), [162.0]);
        assert_eq!(x(window.ahead(161, 2)), [162.0]);
        // The timeout of a second, beyond the horizon; the last sample is held from 0.3 s on.
        assert_eq!(window.get(302).position_m.x, 162.0);
        assert_eq!(window.get(302).state, ReferenceState::Inside);
        assert_eq!(window.get(303).state, ReferenceState::Ended);
        let empty = ReferenceWindow::default();
        assert_eq!(empty.get(7).state, ReferenceState::None);
        assert!(empty.ahead(7, 3).is_empty());
    }

    #[test]
    fn short_periods_have_the_same_timeout() {
        let points = [0, 2_000_000_000].map(|time_ns| ReferencePoint {
            time_ns,
            position_m: Vector3::zeros(),
            orientation: Orientation::Free,
            interpolation: Interpolation::Linear,
        });
        let mut trajectory = Trajectory::with_capacity(2, f64::INFINITY);
        trajectory
            .replace(points.into_iter())
            .expect("legal points");
        let mut window = ReferenceWindow::default();
        window.fill(&trajectory, 0, 0, 100_000, 2, 0);
        // 10 000 periods are a second, beyond the horizon.
        assert_eq!(window.get(10_002).state, ReferenceState::Inside);
        assert_eq!(window.get(10_003).state, ReferenceState::Ended);
        // A reference that ends within the window ends there.
        window.fill(&trajectory, 0, 1_999_900_000, 100_000, 2, 0);
        assert_eq!(window.get(30).state, ReferenceState::Ended);
    }

    #[test]
    fn slack_is_cheap_and_at_most_the_timeout() {
        let slack = |period_us: u64| ReferenceWindow::slack(period_us * 1000);
        assert_eq!([100_000, 20_000, 10_000].map(slack), [10, 50, 60]);
        assert_eq!([5000, 2000, 500, 100].map(slack), [60, 25, 20, 20]);
    }

    /// A kept sample equals one made anew, whatever happened between two windows.
    #[test]
    fn a_moved_window_equals_a_new_one() {
        let points = |from: u64, count: u64, scale: f64| {
            (from..from + count).map(move |k| ReferencePoint {
                time_ns: 1_000_000_000 + k * 17_000_000,
                position_m: Vector3::new(scale * (k as f64).sin(), 0.1, 0.2),
                orientation: Orientation::Free,
                interpolation: Interpolation::Cubic,
            })
        };
        for lead_ns in [0, 33_000_000] {
            let mut trajectory = Trajectory::with_capacity(256, 0.3);
            let mut moved = ReferenceWindow::default();
            let mut cycle = 100_u64;
            for turn in 0..400_u64 {
                match turn % 50 {
                    7 => trajectory.replace(points(turn, 20, 0.1)).expect("in order"),
                    19 => {
                        let end_ns = trajectory.end_ns().unwrap_or(0);
                        let next = (end_ns.saturating_sub(1_000_000_000) / 17_000_000) + 1;
                        trajectory.append(points(next, 9, 0.05)).expect("in order");
                    }
                    31 => trajectory.forget_before(cycle * PERIOD_NS),
                    43 if turn > 200 => trajectory.clear(),
                    _ => {}
                }
                cycle += [1, 1, 1, 2, 0, 1, 130][(turn % 7) as usize * usize::from(turn % 3 == 0)];
                // A new origin of the grid from time to time.
                let release_ns = cycle * PERIOD_NS + turn / 90 * 1_000;
                let steps = if turn % 11 == 0 { 50 } else { 2 };
                moved.fill(&trajectory, cycle, release_ns, PERIOD_NS, steps, lead_ns);
                let mut made = ReferenceWindow::default();
                made.fill(&trajectory, cycle, release_ns, PERIOD_NS, steps, lead_ns);
                assert_eq!(moved.count, made.count);
                assert_eq!(
                    moved.samples[..made.count],
                    made.samples[..made.count],
                    "{turn}"
                );
                assert_eq!(
                    moved.ahead(cycle, steps),
                    made.ahead(cycle, steps),
                    "{turn}"
                );
            }
        }
    }
}
