//! The safety checks of each command.

use cdcr_controller::robot::BendRates;
use cdcr_controller::safety::{Lag, Reason, SafeCommand, Situation, safe_command};

use super::Cycle;

impl Cycle {
    /// Applies the limits and the clearance guard to every command, in every mode, and notes the clearance.
    pub(super) fn make_safe(
        &mut self,
        desired_rates: &BendRates,
        comes_to_rest: bool,
    ) -> SafeCommand {
        let safe = safe_command(&self.situation(comes_to_rest), desired_rates);
        if safe.limits_hit.non_finite {
            self.modes.fault(Reason::NonFinite);
        }
        self.clearance = self.present_clearance(safe.clearance_m);
        safe
    }

    pub(super) fn situation(&self, comes_to_rest: bool) -> Situation<'_> {
        Situation {
            robot: &self.robot,
            at: self.state.configuration(),
            lag: Some(Lag {
                delayed: self.state.delayed(),
                time_constant_s: self.policy.motor_time_constant_ns() as f64 * 1e-9,
            }),
            commanded: self.state.commanded_motors(),
            slack: self.state.commanded_slack(),
            previous: &self.rates,
            obstacles: &self.obstacles,
            safe_distance_m: self.nmpc.settings().safe_distance_m,
            tip_offset_m: self.state.tip_margin_m(),
            acceleration_rad_s2: self.policy.acceleration_rad_s2,
            period_s: self.period_ns as f64 * 1e-9,
            moving_s: self.policy.moving_ns(u64::MAX, self.period_ns) as f64 * 1e-9,
            deceleration_rad_s2: self.policy.deceleration_rad_s2,
            comes_to_rest,
        }
    }
}
