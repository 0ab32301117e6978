//! How the robot comes to rest after a command: the duration and path of its ramp, and rates that are scaled together.

use crate::robot::BendRates;

/// How the robot comes to rest when no further command arrives: it executes the last command for `moving_s`,
/// then all rates shrink together, with a constant deceleration of the fastest component.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stopping {
    /// Time for which the robot executes a command \[s\].
    pub(super) moving_s: f64,
    /// Deceleration of the fastest component after that \[rad/s²\]; infinite: the robot stops at once.
    pub(super) deceleration_rad_s2: f64,
}

/// The motion caused by one command and the ramp after it: a straight line in the bends, bend + s q̇, with s
/// from 0 to `path_s`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StoppingPath {
    moving_s: f64,
    /// Value of s at the end \[s\]: `moving_s` plus half the duration of the ramp.
    pub(super) path_s: f64,
}

impl Stopping {
    /// For rates whose fastest component is `fastest_rad_s`.
    pub(super) fn path(&self, fastest_rad_s: f64) -> StoppingPath {
        StoppingPath {
            moving_s: self.moving_s,
            path_s: self.moving_s + 0.5 * fastest_rad_s / self.deceleration_rad_s2,
        }
    }

    /// Derivative of `path_s` with respect to the fastest component \[s²\].
    pub(super) fn path_slope_s2(&self) -> f64 {
        0.5 / self.deceleration_rad_s2
    }
}

impl StoppingPath {
    /// Time after the command at which the robot is at s = `path_s` \[s\].
    pub(super) fn time_s(&self, path_s: f64) -> f64 {
        let (beyond_s, ramp_path_s) = (path_s - self.moving_s, self.path_s - self.moving_s);
        if beyond_s <= 0.0 || ramp_path_s <= 0.0 {
            return path_s;
        }
        let left = (1.0 - beyond_s / ramp_path_s).max(0.0);
        self.moving_s + 2.0 * ramp_path_s * (1.0 - left.sqrt())
    }

    /// Whether the robot moves at constant rates up to s = `path_s`.
    pub(super) fn has_constant_speed_until(&self, path_s: f64) -> bool {
        path_s <= self.moving_s
    }

    /// The value of s at a time after the command \[s\].
    pub(super) fn path_after_s(&self, time_s: f64) -> f64 {
        let (beyond_s, ramp_path_s) = (time_s - self.moving_s, self.path_s - self.moving_s);
        if beyond_s <= 0.0 || ramp_path_s <= 0.0 {
            return time_s;
        }
        let left = (1.0 - 0.5 * beyond_s / ramp_path_s).max(0.0);
        self.moving_s + ramp_path_s * (1.0 - left * left)
    }
}

/// The fastest component \[rad/s\].
pub(super) fn fastest(rates: &BendRates) -> f64 {
    let components = rates.as_slice().iter();
    components.fold(0.0, |most, rate| rate.abs().max(most))
}

/// The rates, each times `factor`.
pub(super) fn scaled_by(rates: &BendRates, factor: f64) -> BendRates {
    let mut scaled = *rates;
    for rate in scaled.as_mut_slice() {
        *rate *= factor;
    }
    scaled
}

/// The rates, scaled so that no component exceeds `fastest_rad_s`.
pub(super) fn shortened_to(rates: BendRates, fastest_rad_s: f64) -> BendRates {
    let present_rad_s = fastest(&rates);
    if present_rad_s <= fastest_rad_s {
        return rates;
    }
    // A little shorter, so that rounding does not exceed the limit.
    scaled_by(&rates, fastest_rad_s / present_rad_s * (1.0 - 1e-15))
}
