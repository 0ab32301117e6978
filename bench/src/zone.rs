//! Which samples of the circle count as tracking, and which belong to the approach or the detour.

use std::ops::Range;

use nalgebra::Vector3;

use crate::closed_loop::Sample;

/// The approach ends when the error first falls below this \[mm\]: the printed constants of the circle
/// are rounded and leave 7.2e-3 mm.
pub const ARRIVED_MM: f64 = 0.02;
/// The detour is where the reference is nearer to the obstacle than this many safe distances.
pub const DETOUR_DISTANCES: f64 = 2.0;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Zone {
    /// Samples from the arrival on; empty when the tip never arrives.
    pub arrived: Range<usize>,
    pub is_detour: Vec<bool>,
}

impl Zone {
    /// Sorts the samples of a run around an obstacle at `obstacle_m`.
    pub fn of(samples: &[Sample], obstacle_m: &Vector3<f64>, safe_distance_m: f64) -> Self {
        let arrival = samples.iter().position(|s| s.error_mm() < ARRIVED_MM);
        let reach_m = DETOUR_DISTANCES * safe_distance_m;
        let is_near = |s: &Sample| (s.reference_m - obstacle_m).norm() < reach_m;
        Self {
            arrived: arrival.unwrap_or(samples.len())..samples.len(),
            is_detour: samples.iter().map(is_near).collect(),
        }
    }

    /// Mean error after the approach and outside the detour \[mm\]; none when no sample is there.
    pub fn mean_error_outside_mm(&self, samples: &[Sample]) -> Option<f64> {
        let outside = self.arrived.clone().filter(|&i| !self.is_detour[i]);
        let errors_mm: Vec<f64> = outside.map(|i| samples[i].error_mm()).collect();
        let sum_mm: f64 = errors_mm.iter().sum();
        (!errors_mm.is_empty()).then(|| sum_mm / errors_mm.len() as f64)
    }

    /// Largest error after the approach \[mm\]; none when the tip never arrives.
    pub fn peak_error_mm(&self, samples: &[Sample]) -> Option<f64> {
        let errors_mm = samples[self.arrived.clone()].iter().map(Sample::error_mm);
        errors_mm.reduce(f64::max)
    }
}

#[cfg(test)]
mod tests {
    use cdcr_controller::robot::{BendRates, Configuration, Pose};

    use super::*;

    /// A sample with its reference on the x axis, and this error.
    fn sample(reference_x_m: f64, error_mm: f64) -> Sample {
        let reference_m = Vector3::new(reference_x_m, 0.0, 0.0);
        let mut tip = Pose::identity();
        tip.position_m = reference_m + Vector3::new(0.0, 1e-3 * error_mm, 0.0);
        Sample {
            time_s: 0.0,
            reference_m,
            tip,
            configuration: Configuration::straight(1),
            rates: BendRates::zero(1),
            clearance_m: f64::INFINITY,
            solve_ns: 0,
        }
    }

    #[test]
    fn approach_and_detour_are_left_out_of_the_mean_and_only_the_approach_of_the_peak() {
        let samples = [
            sample(-0.1, 100.0),
            sample(-0.09, 0.01),
            // Above the threshold again: the approach is over all the same.
            sample(-0.08, 0.03),
            sample(-0.019, 12.0),
            sample(0.0, 10.0),
            sample(0.021, 0.02),
        ];
        let zone = Zone::of(&samples, &Vector3::zeros(), 0.01);
        assert_eq!(zone.arrived, 1..6);
        assert_eq!(zone.is_detour, [false, false, false, true, true, false]);
        let mean_mm = zone.mean_error_outside_mm(&samples).expect("some outside");
        assert!((mean_mm - 0.02).abs() < 1e-12, "{mean_mm}");
        let peak_mm = zone.peak_error_mm(&samples).expect("arrived");
        assert!((peak_mm - 12.0).abs() < 1e-12, "{peak_mm}");
    }

    #[test]
    fn a_tip_that_never_arrives_has_neither_mean_nor_peak() {
        let samples = [sample(0.5, 3.0), sample(0.5, 0.02)];
        let zone = Zone::of(&samples, &Vector3::zeros(), 0.01);
        assert_eq!(zone.mean_error_outside_mm(&samples), None);
        assert_eq!(zone.peak_error_mm(&samples), None);
    }
}
