use nalgebra::Vector3;

use super::{
    Approach, ApproachLimits, HORIZON_STEPS_MAX, ReferenceSample, ReferenceState, ReferenceWindow,
};
use crate::robot::Pose;

/// A release on the grid of the cycles.
#[derive(Debug, Clone, Copy)]
pub struct GridPoint {
    /// Number of the cycle.
    pub cycle: u64,
    /// Its release \[ns\].
    pub release_ns: u64,
    /// Time to the next release \[ns\].
    pub period_ns: u64,
}

/// The reference that the tip follows: that of the client, and an approach if it begins away from the tip, begins in
/// motion, or is replaced.
///
/// Invariant: allocates nothing. Corners and jumps within one trajectory are intended by its client and are kept.
#[derive(Debug, Clone)]
pub struct FollowedReference {
    /// `None`: the reference is followed without an approach.
    limits: Option<ApproachLimits>,
    approach: Approach,
    last: Option<PreviousCycle>,
    /// Largest speed of what is followed, from the release to the end of the horizon \[m/s\].
    speed_m_s: f64,
    samples: [ReferenceSample; HORIZON_STEPS_MAX],
}

/// What the tip follows at the releases of the horizon.
#[derive(Debug, Clone, Copy)]
pub struct Followed<'a> {
    /// One for each step of the horizon.
    pub samples: &'a [ReferenceSample],
    /// Largest speed of a tip that is behind them and returns: the largest one of the samples, from the release to the end
    /// of the horizon, plus that of an approach \[m/s\]. Infinite without an approach. A jump inside the reference counts:
    /// it is followed at any speed while it is in the horizon.
    pub pace_m_s: f64,
}

/// State of the previous cycle.
#[derive(Debug, Clone, Copy)]
struct PreviousCycle {
    cycle: u64,
    /// Followed at the next release.
    next_m: Vector3<f64>,
    velocity_m_s: Vector3<f64>,
    state: ReferenceState,
    replacements: u64,
}

impl FollowedReference {
    /// With `limits` of the approach; `None`: without an approach.
    pub fn new(limits: Option<ApproachLimits>) -> Self {
        Self {
            limits,
            approach: Approach::default(),
            last: None,
            speed_m_s: 0.0,
            samples: [ReferenceSample::default(); HORIZON_STEPS_MAX],
        }
    }

    /// Stops following; the next reference is approached.
    pub fn forget(&mut self) {
        self.last = None;
        self.approach = Approach::default();
    }

    /// True if the reference was replaced by one that is not yet followed.
    pub fn is_replaced(&self, window: &ReferenceWindow) -> bool {
        self.last
            .is_some_and(|last| last.replacements != window.replacements())
    }

    /// The approach of the last planned cycle; it does not run while the reference itself is followed.
    pub fn approach(&self) -> &Approach {
        &self.approach
    }

    /// Samples to follow at the `steps` releases after `now`. `tip` returns the tip pose to which the commands so far
    /// lead; it is called only if an approach may begin. `offset_m` is the tip offset from the model. It is subtracted,
    /// so the positions are targets of the model's tip.
    pub fn ahead<'a>(
        &'a mut self,
        window: &'a ReferenceWindow,
        now: GridPoint,
        steps: usize,
        tip: impl FnOnce() -> Pose,
        offset_m: &Vector3<f64>,
    ) -> Followed<'a> {
        if let Some(limits) = self.limits {
            self.plan(&limits, window, now, tip);
        }
        let reference = window.ahead(now.cycle, steps);
        let pace_m_s = self.limits.map_or(f64::INFINITY, |limits| {
            self.measure_speed(reference, now);
            self.speed_m_s + limits.speed_m_s
        });
        if !self.approach.is_active() && *offset_m == Vector3::zeros() {
            return Followed {
                samples: reference,
                pace_m_s,
            };
        }
        let samples = &mut self.samples[..reference.len()];
        for ((followed, sample), step) in samples.iter_mut().zip(reference).zip(1..) {
            let time_ns = now.release_ns + step * now.period_ns;
            *followed = self
                .approach
                .followed_sample(sample, time_ns)
                .moved(&-offset_m);
        }
        Followed { samples, pace_m_s }
    }

    fn measure_speed(&mut self, reference: &[ReferenceSample], now: GridPoint) {
        let period_s = now.period_ns as f64 * 1e-9;
        let mut before_m = None;
        for (sample, step) in reference.iter().zip(1..) {
            let time_ns = now.release_ns + step * now.period_ns;
            let here_m = self.approach.followed_sample(sample, time_ns).position_m;
            if let Some(before_m) = before_m.replace(here_m) {
                let speed_m_s: f64 = (here_m - before_m).norm() / period_s;
                self.speed_m_s = self.speed_m_s.max(speed_m_s);
            }
        }
    }

    /// Begins an approach if needed, and ends a completed one.
    fn plan(
        &mut self,
        limits: &ApproachLimits,
        window: &ReferenceWindow,
        now: GridPoint,
        tip: impl FnOnce() -> Pose,
    ) {
        let [Some(first), second] = [0, 1].map(|i| window.ahead(now.cycle, 2).get(i)) else {
            return;
        };
        let period_s = now.period_ns as f64 * 1e-9;
        let next_ns = now.release_ns + now.period_ns;
        let second = second.unwrap_or(first);
        let reference_m_s = (second.position_m - first.position_m) / period_s;
        let begins = self.last.is_none_or(|last| {
            let starts_moving = last.state == ReferenceState::Before && last.state != first.state;
            starts_moving || last.replacements != window.replacements()
        });
        if begins {
            let velocity_m_s = self.last.map_or(Vector3::zeros(), |last| last.velocity_m_s);
            let here = first.moved(&(-period_s * reference_m_s));
            let (from, to) = ((&tip(), &velocity_m_s), (&here, &reference_m_s));
            self.approach = Approach::plan(limits, now.release_ns, from, to, now.period_ns);
        } else if self.approach.is_over(next_ns) {
            self.approach = Approach::default();
        }
        let [here, there] = [(first, 0), (second, now.period_ns)].map(|(sample, later_ns)| {
            self.approach
                .followed_sample(sample, next_ns + later_ns)
                .position_m
        });
        let passed = self
            .last
            .filter(|last| !begins && last.cycle < now.cycle)
            .map(|last| (now.cycle - last.cycle, last.next_m));
        self.speed_m_s = passed.map_or(0.0, |(cycles, before_m)| {
            (here - before_m).norm() / (cycles as f64 * period_s)
        });
        self.last = Some(PreviousCycle {
            cycle: now.cycle,
            next_m: here,
            velocity_m_s: (there - here) / period_s,
            state: first.state,
            replacements: window.replacements(),
        });
    }
}
