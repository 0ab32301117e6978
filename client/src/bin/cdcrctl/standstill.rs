use std::collections::VecDeque;

use cdcr_shared_types::Telemetry;
use cdcr_shared_types::limits::COORDINATES_MAX;

/// The movement is averaged over this time \[ns\].
const WINDOW_NS: u64 = 200_000_000;
/// Of a robot at rest no bend moves faster on average \[rad/s\]. Encoders with a noise of 1e-3 rad seem to move at a fifth of it,
/// where there are 40 measurements.
const REST_RAD_S: f64 = 0.02;
/// Measurements at least, where they are so rare that the window has fewer.
const LEAST: usize = 8;

/// Whether a robot that is commanded to rest is measured to rest: motors with a lag are still on their way.
///
/// What moves is the estimate, which follows every kind of measurement.
#[derive(Debug, Default)]
pub(crate) struct Standstill {
    /// The first cycle whose command was rest, and its release \[ns\].
    commanded: Option<(u64, u64)>,
    looks: VecDeque<Look>,
}

#[derive(Debug)]
struct Look {
    measured_ns: u64,
    bend_rad: [f64; COORDINATES_MAX],
}

impl Standstill {
    /// Takes note of a record with rest as its command, if it has a measurement that is newer than that command and all before.
    pub(crate) fn note(&mut self, record: &Telemetry) {
        let here = (record.cycle, record.release_ns);
        let (_, since_ns) = *self.commanded.get_or_insert(here);
        let newest_ns = self.looks.back().map_or(0, |look| look.measured_ns);
        let measured_ns = record.measurement.measured_ns;
        if measured_ns < since_ns || measured_ns <= newest_ns {
            return;
        }
        let bend_rad = record.present_rad;
        self.looks.push_back(Look {
            measured_ns,
            bend_rad,
        });
        let is_enough = |second: &Look| measured_ns - second.measured_ns >= WINDOW_NS;
        while self.looks.len() > LEAST && self.looks.get(1).is_some_and(is_enough) {
            self.looks.pop_front();
        }
    }

    /// The first cycle whose command was rest.
    pub(crate) fn commanded_cycle(&self) -> Option<u64> {
        self.commanded.map(|(cycle, _)| cycle)
    }

    pub(crate) fn is_at_rest(&self) -> bool {
        self.rate_rad_s().is_some_and(|rate| rate < REST_RAD_S)
    }

    /// How fast the fastest component of the bends moves \[rad/s\]: between the means of the earlier and of the later half.
    /// None: there are too few measurements.
    pub(crate) fn rate_rad_s(&self) -> Option<f64> {
        let (first, last) = (self.looks.front()?, self.looks.back()?);
        let is_whole =
            self.looks.len() >= LEAST && last.measured_ns - first.measured_ns >= WINDOW_NS;
        is_whole.then(|| {
            let half = self.looks.len() / 2;
            let mean = |of: &dyn Fn(&Look) -> f64, earlier: bool| {
                let (skip, take) = if earlier {
                    (0, half)
                } else {
                    (half, usize::MAX)
                };
                let values = self.looks.iter().skip(skip).take(take).map(of);
                let count = values.len();
                values.sum::<f64>() / count as f64
            };
            let moved = |of: &dyn Fn(&Look) -> f64| mean(of, false) - mean(of, true);
            let passed_s = moved(&|look| (look.measured_ns - first.measured_ns) as f64 * 1e-9);
            let rates =
                (0..COORDINATES_MAX).map(|i| (moved(&|look| look.bend_rad[i]) / passed_s).abs());
            rates.fold(0.0, f64::max)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 5_000_000;

    /// A robot whose motors lag, from the cycle in which the command became rest.
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

    /// The cycle in which it is found to rest.
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
        // The window, and the first measurement is older than the command.
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
