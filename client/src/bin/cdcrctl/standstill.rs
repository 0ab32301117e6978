use std::collections::VecDeque;

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::limits::COORDINATES_MAX;

/// Averaging time of the motion \[ns\].
pub(crate) const WINDOW_NS: u64 = 200_000_000;
/// Largest average rate of a bend at rest \[rad/s\]. Encoder noise of 1e-3 rad causes an apparent rate of a
/// fifth of it, with 40 measurements.
pub(crate) const REST_RAD_S: f64 = 0.02;
/// Minimum number of measurements, for rates so low that the window holds fewer.
const LEAST: usize = 8;

/// Detects whether a robot is measured at rest after its command is rest: motors with a lag still move.
///
/// It uses the estimate, which covers every kind of measurement.
#[derive(Debug, Default)]
pub(crate) struct Standstill {
    /// The first cycle with the command rest, and its release \[ns\].
    commanded: Option<(u64, u64)>,
    samples: VecDeque<BendSample>,
}

#[derive(Debug)]
struct BendSample {
    measured_ns: u64,
    bend_rad: [f64; COORDINATES_MAX],
}

impl Standstill {
    /// Adds a record with the command rest, if its measurement is newer than that command and all earlier
    /// ones.
    pub(crate) fn note(&mut self, record: &Telemetry) {
        let here = (record.cycle, record.release_ns);
        let (_, since_ns) = *self.commanded.get_or_insert(here);
        let newest_ns = self.samples.back().map_or(0, |sample| sample.measured_ns);
        let measured_ns = record.measurement.measured_ns;
        if measured_ns < since_ns || measured_ns <= newest_ns {
            return;
        }
        let bend_rad = record.present_rad;
        self.samples.push_back(BendSample {
            measured_ns,
            bend_rad,
        });
        let is_enough = |second: &BendSample| measured_ns - second.measured_ns >= WINDOW_NS;
        while self.samples.len() > LEAST && self.samples.get(1).is_some_and(is_enough) {
            self.samples.pop_front();
        }
    }

    /// The first cycle with the command rest.
    pub(crate) fn commanded_cycle(&self) -> Option<u64> {
        self.commanded.map(|(cycle, _)| cycle)
    }

    pub(crate) fn is_at_rest(&self) -> bool {
        self.rate_rad_s().is_some_and(|rate| rate < REST_RAD_S)
    }

    /// Rate of the fastest bend component \[rad/s\], from the means of the earlier and the later half. `None`
    /// with too few measurements.
    pub(crate) fn rate_rad_s(&self) -> Option<f64> {
        let (first, last) = (self.samples.front()?, self.samples.back()?);
        let is_whole =
            self.samples.len() >= LEAST && last.measured_ns - first.measured_ns >= WINDOW_NS;
        is_whole.then(|| {
            let half = self.samples.len() / 2;
            let mean = |of: &dyn Fn(&BendSample) -> f64, earlier: bool| {
                let (skip, take) = if earlier {
                    (0, half)
                } else {
                    (half, usize::MAX)
                };
                let values = self.samples.iter().skip(skip).take(take).map(of);
                let count = values.len();
                values.sum::<f64>() / count as f64
            };
            let moved = |of: &dyn Fn(&BendSample) -> f64| mean(of, false) - mean(of, true);
            let passed_s = moved(&|sample| (sample.measured_ns - first.measured_ns) as f64 * 1e-9);
            let rates = (0..COORDINATES_MAX)
                .map(|i| (moved(&|sample| sample.bend_rad[i]) / passed_s).abs());
            rates.fold(0.0, f64::max)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 5_000_000;

    /// A robot with lagging motors, from the cycle in which the command became rest.
    fn record(cycle: u64, lag_s: f64, noise_rad: f64) -> Telemetry {
        let mut record = Telemetry {
            cycle,
            release_ns: (1000 + cycle) * PERIOD_NS,
            ..Telemetry::default()
        };
        record.measurement.measured_ns = record.release_ns - 300_000;
        let passed_s = cycle as f64 * 5e-3;
        let sign = [1.0, -1.0, -1.0, 1.0, 1.0][(cycle % 5) as usize];
        record.present_rad[3] = 0.7 + 0.5 * lag_s * (-passed_s / lag_s).exp() + sign * noise_rad;
        record
    }

    /// The cycle in which it is detected at rest.
    fn found(lag_s: f64, noise_rad: f64) -> u64 {
        let mut standstill = Standstill::default();
        let rests = |cycle: &u64| {
            standstill.note(&record(*cycle, lag_s, noise_rad));
            standstill.is_at_rest()
        };
        (0..2000).find(rests).expect("it comes to rest")
    }

    #[test]
    fn rest_is_measured_and_not_only_commanded() {
        // The length of the window, plus a measurement that is older than the command.
        assert_eq!(found(1e-3, 0.0), 41);
        assert_eq!(found(1e-3, 1e-3), 41);
        for lag_s in [0.1, 0.4, 1.0] {
            let rate_rad_s = 0.5 * (-(found(lag_s, 0.0) as f64) * 5e-3 / lag_s).exp();
            assert!((0.005..0.02).contains(&rate_rad_s), "{lag_s}: {rate_rad_s}");
        }
    }

    #[test]
    fn a_measurement_that_repeats_is_no_rest_and_rare_ones_take_longer() {
        let mut frozen = Standstill::default();
        let mut rare = Standstill::default();
        for cycle in 0..200 {
            let mut record = record(cycle, 1e-3, 0.0);
            if cycle % 20 == 0 {
                rare.note(&record);
            }
            assert_eq!(rare.is_at_rest(), cycle >= 160, "{cycle}");
            record.measurement.measured_ns = 1010 * PERIOD_NS;
            frozen.note(&record);
        }
        assert_eq!(frozen.rate_rad_s(), None);
        assert_eq!(frozen.commanded_cycle(), Some(0));
    }
}
