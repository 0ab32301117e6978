use cdcr_controller::estimator::{FAR_LIMIT, Measurement};
use nalgebra::Vector3;

use crate::handover::{TimedMeasurement, TipCause};

/// Distance of the tip from its reference, as measured by a tip sensor: includes the error of the model and
/// the noise of the sensor, without stray measurements: those that jump one by one, or are too far away fewer than [`FAR_LIMIT`] times in a row.
#[derive(Debug)]
pub(super) struct MeasuredError {
    /// The newest release \[ns\], and the reference at that time \[m\]; NaN without one.
    release_ns: u64,
    reference_m: Vector3<f64>,
    measured_ns: u64,
    distance_m: f64,
    /// The newest tip beside bends or cables \[ns\], and the number of refused ones in a row.
    tip_ns: u64,
    refused: u32,
}

impl Default for MeasuredError {
    fn default() -> Self {
        Self {
            release_ns: 0,
            reference_m: Vector3::repeat(f64::NAN),
            measured_ns: 0,
            distance_m: f64::NAN,
            tip_ns: 0,
            refused: 0,
        }
    }
}

impl MeasuredError {
    /// Distance at the newest measurement \[m\]; NaN without a measurement or a reference.
    pub(super) fn distance_m(&self) -> f64 {
        self.distance_m
    }

    /// Takes a cycle with its reference \[m\] (NaN: none) and its newest measurements: of the tip beside bends or cables,
    /// and why that is not used, and of the driver. A measurement is older than the release: its reference is interpolated
    /// linearly from those of the last two releases.
    pub(super) fn take(
        &mut self,
        release_ns: u64,
        reference_m: Vector3<f64>,
        (tip, unused): (Option<&TimedMeasurement>, Option<TipCause>),
        driver: Option<&TimedMeasurement>,
    ) {
        let period_ns = release_ns.saturating_sub(self.release_ns).max(1) as f64;
        let moved_m = reference_m - self.reference_m;
        (self.release_ns, self.reference_m) = (release_ns, reference_m);
        let tip = tip.filter(|tip| !self.is_stray(tip, unused));
        for timed in tip.into_iter().chain(driver) {
            let Measurement::TipPosition(tip_m) = timed.measurement else {
                continue;
            };
            if timed.measured_ns > self.measured_ns || !self.distance_m.is_finite() {
                self.measured_ns = timed.measured_ns;
                let age = release_ns.saturating_sub(timed.measured_ns) as f64 / period_ns;
                self.distance_m = (tip_m - (reference_m - age * moved_m)).norm();
            }
        }
        if !reference_m.x.is_finite() {
            self.distance_m = f64::NAN;
        }
    }

    fn is_stray(&mut self, tip: &TimedMeasurement, unused: Option<TipCause>) -> bool {
        if unused.is_none() {
            self.refused = 0;
        } else if tip.measured_ns > self.tip_ns {
            self.refused = self.refused.saturating_add(1);
        }
        self.tip_ns = self.tip_ns.max(tip.measured_ns);
        match unused {
            Some(TipCause::Jumps) => true,
            Some(TipCause::Far) => self.refused < FAR_LIMIT,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measurement_is_compared_with_the_reference_of_its_time() {
        let at = |x_m| Vector3::new(x_m, 0.0, 0.5);
        let measured = |measured_ns, x_m| TimedMeasurement {
            measurement: Measurement::TipPosition(at(x_m)),
            measured_ns,
            rested_ns: [0; 2],
        };
        let mut error = MeasuredError::default();
        let mut distance_m = |release_ns, reference_m, timed: Option<TimedMeasurement>| {
            error.take(release_ns, reference_m, (None, None), timed.as_ref());
            error.distance_m()
        };
        assert!(distance_m(100, at(0.1), None).is_nan());
        // 0.02 m beside the reference of half a period earlier.
        let known_m = distance_m(110, at(0.2), Some(measured(105, 0.17)));
        assert!((known_m - 0.02).abs() < 1e-12, "{known_m}");
        // A repeated measurement changes nothing.
        let still_m = distance_m(120, at(0.3), Some(measured(105, 0.17)));
        assert!((still_m - 0.02).abs() < 1e-12, "{still_m}");
        let none_m = Vector3::repeat(f64::NAN);
        assert!(distance_m(130, none_m, Some(measured(125, 0.3))).is_nan());
    }

    #[test]
    fn a_stray_tip_has_no_error() {
        use TipCause::{Far, Jumps, WasFar};
        let mut error = MeasuredError::default();
        let reference_m = Vector3::new(0.1, 0.0, 0.5);
        error.take(100, reference_m, (None, None), None);
        for (release_ns, x_m, unused, known_m) in [
            (110, 0.11, None, 0.01),
            (120, 0.4, Some(Jumps), 0.01),
            (130, 0.12, None, 0.02),
            (140, 0.4, Some(Far), 0.02),
            (150, 0.11, None, 0.01),
            (160, 0.4, Some(Far), 0.01),
            (170, 0.4, Some(Far), 0.01),
            (180, 0.4, Some(Far), 0.3),
            (190, 0.3, Some(WasFar), 0.2),
        ] {
            let tip = TimedMeasurement {
                measurement: Measurement::TipPosition(Vector3::new(x_m, 0.0, 0.5)),
                measured_ns: release_ns,
                rested_ns: [0; 2],
            };
            error.take(release_ns, reference_m, (Some(&tip), unused), None);
            // The same tip in the next cycle is not another stray value.
            error.take(release_ns + 5, reference_m, (Some(&tip), unused), None);
            let distance_m = error.distance_m();
            assert!(
                (distance_m - known_m).abs() < 1e-12,
                "{distance_m} {unused:?}"
            );
        }
    }
}
