use cdcr_controller::robot::Configuration;

use super::Cycle;

/// Clearance of the body in the newest cycle, with the radius enlarged by the tip margin \[m\].
#[derive(Debug, Clone, Copy)]
pub(super) struct PresentClearance {
    pub(super) estimated_m: f64,
    /// Where the measured bends, not the estimate, place the body: the estimate hides a lag that is not configured.
    /// Equal to the estimated one if no obstacle is near.
    pub(super) measured_m: f64,
}

impl Default for PresentClearance {
    fn default() -> Self {
        Self {
            estimated_m: f64::INFINITY,
            measured_m: f64::INFINITY,
        }
    }
}

impl Cycle {
    /// `led_m` is the clearance of the commanded configuration; infinite without obstacles.
    pub(super) fn present_clearance(&self, led_m: f64) -> PresentClearance {
        let estimated_m = if self.policy.reference_lead_ns == 0 || !led_m.is_finite() {
            led_m
        } else {
            self.clearance_at_m(self.state.present())
        };
        PresentClearance {
            estimated_m,
            measured_m: self.measured_clearance_m(estimated_m),
        }
    }

    fn measured_clearance_m(&self, estimated_m: f64) -> f64 {
        let beside = self.state.estimator.measured_beside();
        // A bend moves no point of the body by more than its change times the length behind it.
        let reach_m = self.robot.reach_m();
        let sections = 0..self.robot.section_count();
        let moved_m: f64 = sections.map(|j| beside.bend_rad(j) * reach_m).sum();
        if moved_m == 0.0 || estimated_m - moved_m >= self.nmpc.settings().safe_distance_m {
            return estimated_m;
        }
        let mut measured = *self.state.present();
        let pairs = measured.as_mut_slice().iter_mut();
        for (measured, beside) in pairs.zip(beside.as_slice()) {
            *measured += beside;
        }
        self.clearance_at_m(&measured)
    }

    fn clearance_at_m(&self, at: &Configuration) -> f64 {
        let body = self.robot.enlarged(at, self.state.tip_margin_m()).body(at);
        let obstacles = self.known_obstacles.iter();
        body.least_clearance_m(obstacles.map(|known| known.obstacle))
    }

    /// The clearance in the previous cycle was below the fault limit. While the robot may move, also: the measured
    /// one was below the middle between that limit and the safe distance, and as far below the estimated one. Such an
    /// estimate does not keep the body away.
    pub(super) fn is_contact(&self) -> bool {
        let PresentClearance {
            estimated_m,
            measured_m,
        } = self.clearance;
        let fault_m = self.policy.clearance_fault_m;
        let half_m = 0.5 * (self.nmpc.settings().safe_distance_m - fault_m).max(0.0);
        let is_beside = estimated_m - measured_m > half_m && !self.modes.mode().is_latched();
        estimated_m.min(measured_m) < fault_m || is_beside && measured_m < fault_m + half_m
    }
}
