use super::Cycle;

impl Cycle {
    /// Clearance \[m\] of the body at its present configuration, with the radius enlarged by the tip margin.
    /// `led_m` is the clearance of the commanded configuration; infinite without obstacles.
    pub(super) fn present_clearance_m(&self, led_m: f64) -> f64 {
        if self.policy.reference_lead_ns == 0 || !led_m.is_finite() {
            return led_m;
        }
        let (present, margin_m) = (self.state.present(), self.state.tip_margin_m());
        let body = self.robot.enlarged(present, margin_m).body(present);
        let obstacles = self.known_obstacles.iter();
        body.least_clearance_m(obstacles.map(|known| known.obstacle))
    }

    /// The clearance in the previous cycle was below the fault limit.
    pub(super) fn is_contact(&self) -> bool {
        self.clearance_m < self.policy.clearance_fault_m
    }
}
