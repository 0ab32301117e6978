use std::fmt::Write as _;
use std::io::Write;

use anyhow::ensure;
use cdcr_client::STATUS_TIMEOUT;
use cdcr_controller::calibration::{DEVIATION_OF_MEDIAN, median};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{MeasurementKind, Mode};
use serde::Serialize;
use serde_json::json;

use super::resting::{Sensors, next, rests};
use crate::args::{Format, NoiseOptions, Target};
use crate::bar::Bar;
use crate::done::Done;
use crate::interrupt::Interrupt;

/// Minimum number of measurements for a standard deviation.
const LEAST: usize = 20;
/// Noise multiple for a threshold: noise exceeds it about once in a million measurements.
const SAFE: f64 = 5.0;
/// A measurement with a number farther from the median than this, in standard deviations, is a stray: noise is not.
const STRAY: f64 = 6.0;
/// Rounding of a value \[m\].
const ROUNDING_M: f64 = 1e-12;

/// The values of each number of a sensor, and the times of its measurements.
#[derive(Default)]
struct Sensor {
    values: Vec<Vec<f64>>,
    newest_ns: u64,
    first_ns: u64,
    ages_ns: Vec<u64>,
}

#[derive(Serialize)]
struct SensorNoise {
    deviation_m: Vec<f64>,
    /// Smallest step between two values.
    step_m: Vec<f64>,
    rate_hz: f64,
    age_ms: f64,
    measurements: usize,
    /// Strays, which are left out of deviation and step, and the largest distance of one from the median.
    left_out: usize,
    left_out_max_m: f64,
}

pub(super) fn run(target: &Target, options: &NoiseOptions) -> anyhow::Result<Done> {
    let connection = target.connect()?;
    let mut telemetry = connection.telemetry()?;
    let first = rests(&mut telemetry)?;
    let sensors = Sensors::from_record(&first);
    ensure!(
        sensors.cables || sensors.tip,
        "measured: {}; there is no noise to measure",
        sensors.text()
    );
    let interrupt = Interrupt::catch()?;
    let bar = Bar::new("noise");
    let (mut cables, mut tip) = (Sensor::default(), Sensor::default());
    let duration_ns = options.duration.as_nanos() as u64;
    loop {
        let record = next(&mut telemetry)?;
        ensure!(
            record.mode == Mode::Holding.code() && record.command.bend_rate_rad_s == [0.0; _],
            "the robot was moved during the measurement: the daemon is {}",
            Mode::text_of(record.mode)
        );
        if interrupt.is_raised() {
            return Ok(Done::Interrupted);
        }
        take(&record, &mut cables, &mut tip);
        let passed_ns = record.release_ns.saturating_sub(first.release_ns);
        bar.show_share(passed_ns as f64 / duration_ns as f64);
        if passed_ns >= duration_ns {
            break;
        }
    }
    drop(bar);
    let [cables, tip] = [cables, tip].map(Sensor::noise);
    ensure!(
        cables.is_some() || tip.is_some(),
        "too few measurements in {:?}: at least {LEAST} are needed; use a longer --duration",
        options.duration
    );
    let mut notes = notes(&first, cables.is_some(), tip.is_some());
    for (name, sensor) in [("cables", &cables), ("tip", &tip)] {
        notes.extend(sensor.as_ref().and_then(|sensor| sensor.strays_note(name)));
    }
    let status = connection.status(STATUS_TIMEOUT)?;
    let radii_m = status.robot.section.map(|section| section.cable_radius_m);
    let mut out = std::io::stdout().lock();
    match options.format {
        Format::Text => write!(
            out,
            "{}",
            text(cables.as_ref(), tip.as_ref(), &notes, &radii_m)?
        )?,
        Format::Json => writeln!(
            out,
            "{:#}",
            json!({
                "cables": cables,
                "tip": tip,
                "notes": notes,
                "toml": fragment(cables.as_ref(), tip.as_ref(), &radii_m)?,
            })
        )?,
    }
    Ok(Done::Good)
}

/// Why the noise of the cables, of which that of the bends follows, or of the tip is not shown.
fn notes(record: &Telemetry, has_cables: bool, has_tip: bool) -> Vec<String> {
    let sensors = Sensors::from_record(record);
    let too_few = format!("fewer than {LEAST} measurements; use a longer --duration");
    let mut notes = Vec::new();
    if !has_cables {
        let cause = match MeasurementKind::try_from(record.measurement.kind) {
            _ if sensors.cables => &too_few,
            Ok(MeasurementKind::Configuration) => {
                "the driver measures bends and no cable lengths; this command does not evaluate the noise of bends"
            }
            _ => "not measured, the driver sends the tip alone; the bends are estimated from it",
        };
        notes.push(format!("cables and bends: {cause}"));
    }
    if !has_tip {
        let cause = if sensors.tip {
            &too_few
        } else {
            "not measured"
        };
        notes.push(format!("tip: {cause}"));
    }
    notes
}

fn take(record: &Telemetry, cables: &mut Sensor, tip: &mut Sensor) {
    let measured = &record.measurement;
    let release_ns = record.release_ns;
    let used = 3 * record.command.sections as usize;
    if measured.kind == MeasurementKind::CableLengths.code() {
        cables.take(
            release_ns,
            measured.measured_ns,
            &measured.cable_length_m[..used],
        );
    }
    if measured.kind == MeasurementKind::TipPose.code() {
        tip.take(release_ns, measured.measured_ns, &measured.tip_position_m);
    } else {
        tip.take(release_ns, record.tip_measured_ns, &record.tip_measured_m);
    }
}

impl Sensor {
    /// Adds a measurement, if it is newer than the last.
    fn take(&mut self, release_ns: u64, measured_ns: u64, numbers: &[f64]) {
        if measured_ns <= self.newest_ns {
            return;
        }
        if self.values.is_empty() {
            self.first_ns = measured_ns;
            self.values = vec![Vec::new(); numbers.len()];
        }
        self.newest_ns = measured_ns;
        self.ages_ns.push(release_ns.saturating_sub(measured_ns));
        for (values, number) in self.values.iter_mut().zip(numbers) {
            values.push(*number);
        }
    }

    fn noise(mut self) -> Option<SensorNoise> {
        let count = self.ages_ns.len();
        let strays_m = self.strays_m();
        for values in &mut self.values {
            let mut strays = strays_m.iter();
            values.retain(|_| strays.next().is_none_or(|away_m| *away_m == 0.0));
        }
        let left_out = strays_m.iter().filter(|away_m| **away_m > 0.0).count();
        (count - left_out >= LEAST).then(|| SensorNoise {
            deviation_m: self.values.iter().map(|values| deviation(values)).collect(),
            step_m: self.values.into_iter().map(smallest_step).collect(),
            rate_hz: (count - 1) as f64 * 1e9 / (self.newest_ns - self.first_ns) as f64,
            age_ms: self.ages_ns.iter().sum::<u64>() as f64 / count as f64 * 1e-6,
            measurements: count,
            left_out,
            left_out_max_m: strays_m.into_iter().fold(0.0, f64::max),
        })
    }

    /// For each measurement the distance of its farthest number from the median, if it is a stray; else 0. The spread
    /// is a median, too, which strays hardly change; quantised values have at least that of their smallest step.
    fn strays_m(&self) -> Vec<f64> {
        let mut strays_m = vec![0.0_f64; self.ages_ns.len()];
        for values in &self.values {
            let middle_m = median(values.clone());
            let away_m: Vec<_> = values.iter().map(|m| (m - middle_m).abs()).collect();
            let steps_m = away_m.iter().copied().filter(|m| *m > ROUNDING_M);
            let step_m = steps_m.fold(f64::INFINITY, f64::min);
            let spread_m = match DEVIATION_OF_MEDIAN * median(away_m.clone()) {
                spread_m if spread_m > ROUNDING_M => spread_m,
                _ => step_m,
            };
            for (stray_m, away_m) in strays_m.iter_mut().zip(away_m) {
                if away_m > STRAY * spread_m {
                    *stray_m = stray_m.max(away_m);
                }
            }
        }
        strays_m
    }
}

fn deviation(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / (count - 1.0)).sqrt()
}

/// The smallest step between two of the values; 0 if all are equal.
fn smallest_step(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
    let smallest = steps
        .filter(|step| *step > ROUNDING_M)
        .fold(f64::INFINITY, f64::min);
    if smallest.is_finite() { smallest } else { 0.0 }
}

impl SensorNoise {
    fn largest_m(&self) -> f64 {
        self.deviation_m.iter().copied().fold(0.0, f64::max)
    }

    /// True if no value differed from the others.
    fn is_constant(&self) -> bool {
        self.step_m.iter().all(|step_m| *step_m == 0.0)
    }

    fn strays_note(&self, name: &str) -> Option<String> {
        let Self {
            measurements,
            left_out,
            left_out_max_m,
            ..
        } = self;
        (*left_out > 0).then(|| {
            format!(
                "{name}: {left_out} of {measurements} measurements left out, up to {:.1} mm from the others: the sensor jumps",
                1e3 * left_out_max_m
            )
        })
    }
}

fn text(
    cables: Option<&SensorNoise>,
    tip: Option<&SensorNoise>,
    notes: &[String],
    radii_m: &[f64],
) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    let head = ["deviation [mm]", "step [mm]", "rate [Hz]", "age [ms]"];
    writeln!(
        out,
        "{:<12}{:>16}{:>14}{:>12}{:>12}",
        "", head[0], head[1], head[2], head[3]
    )?;
    for (sensor, name) in [(cables, "cable"), (tip, "tip axis")] {
        let Some(SensorNoise {
            deviation_m,
            step_m,
            rate_hz,
            age_ms,
            ..
        }) = sensor
        else {
            continue;
        };
        for (i, (deviation_m, step_m)) in deviation_m.iter().zip(step_m).enumerate() {
            let [deviation, step] = [deviation_m, step_m].map(|m| 1e3 * m);
            let name = format!("{name} {}", i + 1);
            let step = if step == 0.0 {
                "unchanged".to_owned()
            } else {
                format!("{step:.6}")
            };
            writeln!(
                out,
                "{name:<12}{deviation:>16.4}{step:>14}{rate_hz:>12.1}{age_ms:>12.2}"
            )?;
        }
    }
    for note in notes {
        writeln!(out, "{note}")?;
    }
    write!(out, "\n{}", fragment(cables, tip, radii_m)?)?;
    Ok(out)
}

/// Configuration keys that depend on the noise.
fn fragment(
    cables: Option<&SensorNoise>,
    tip: Option<&SensorNoise>,
    radii_m: &[f64],
) -> Result<String, std::fmt::Error> {
    let mut out = String::new();
    if let Some(tip) = tip {
        if tip.is_constant() {
            writeln!(
                out,
                "# The measured tip did not change: its noise is below its resolution. Set estimator.tip_noise_m to the smallest step of the sensor."
            )?;
        } else {
            writeln!(out, "[estimator]")?;
            writeln!(out, "tip_noise_m = {:.7}", tip.largest_m().max(1e-6))?;
        }
    }
    if let Some(cables) = cables {
        if cables.is_constant() {
            writeln!(
                out,
                "# The measured cables did not change: their noise is below their resolution. Set motion.home_tolerance_rad above one count of an \
                 encoder, as a length, divided by the distance of the cable from the backbone."
            )?;
            return Ok(out);
        }
        let sections = cables.deviation_m.chunks(3).zip(radii_m);
        let bends_rad = sections.map(|(section, radius_m)| {
            // Three cables at 120 degrees: each bend component has two thirds of their variance.
            let squares: f64 = section.iter().map(|m| m * m).sum();
            (squares / 3.0 / 1.5).sqrt() / radius_m
        });
        let largest_rad = bends_rad.fold(0.0, f64::max);
        writeln!(
            out,
            "# A bend is measured with {largest_rad:.6} rad of noise: set motion.home_tolerance_rad above {:.6}.",
            SAFE * largest_rad
        )?;
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_that_is_not_shown_is_named_with_the_cause() {
        for (kind, tip_measured_ns, shown, causes) in [
            (MeasurementKind::CableLengths, 5, (true, true), &[][..]),
            (
                MeasurementKind::TipPose,
                0,
                (false, true),
                &["cables and bends: not measured, the driver sends the tip alone"],
            ),
            (
                MeasurementKind::Configuration,
                5,
                (false, true),
                &["cables and bends: the driver measures bends"],
            ),
            (
                MeasurementKind::CableLengths,
                0,
                (false, false),
                &["cables and bends: fewer than 20", "tip: not measured"],
            ),
        ] {
            let mut record = Telemetry::default();
            record.measurement.kind = kind.code();
            record.tip_measured_ns = tip_measured_ns;
            let notes = notes(&record, shown.0, shown.1);
            assert_eq!(notes.len(), causes.len(), "{notes:?}");
            let is_named = |(note, cause): (&String, &&str)| note.starts_with(*cause);
            assert!(notes.iter().zip(causes).all(is_named), "{notes:?}");
        }
    }

    // Counts of 0.1 mm around a length, every second release, 2 ms old.
    #[test]
    fn deviation_step_rate_and_age_are_found() {
        let (mut cables, mut tip) = (Sensor::default(), Sensor::default());
        for cycle in 0..401_u64 {
            let mut record = Telemetry::default();
            record.command.sections = 1;
            record.release_ns = 1_000_000_000 + 5_000_000 * cycle;
            record.measurement.kind = MeasurementKind::CableLengths.code();
            record.measurement.measured_ns =
                record.release_ns - 5_000_000 * (cycle % 2) - 2_000_000;
            let count = [-1.0, 0.0, 1.0, 0.0][(cycle / 2 % 4) as usize];
            record.measurement.cable_length_m[1] = 0.3 + 1e-4 * count;
            take(&record, &mut cables, &mut tip);
        }
        let noise = cables.noise().expect("enough");
        assert!((noise.deviation_m[1] - 1e-4 * 0.5_f64.sqrt()).abs() < 1e-6);
        assert!((noise.step_m[1] - 1e-4).abs() < 1e-12);
        assert!(noise.step_m[0] == 0.0 && noise.deviation_m[0] == 0.0);
        assert!((noise.rate_hz - 100.0).abs() < 1e-9 && (noise.age_ms - 2.0).abs() < 1e-9);
        assert!(tip.noise().is_none());
        let text = fragment(Some(&noise), None, &[0.0125]).expect("text");
        // √(0.5e-8 / 3 / 1.5) / 0.0125.
        assert!(text.contains("measured with 0.002680 rad"), "{text}");
    }

    /// A sensor that measures these values in turn, every 5 ms.
    fn sensor(values_m: &[f64]) -> Sensor {
        let mut sensor = Sensor::default();
        for (i, value_m) in values_m.iter().enumerate() {
            let at_ns = 1_000_000_000 + 5_000_000 * i as u64;
            sensor.take(at_ns, at_ns, &[*value_m, 0.2, 0.1]);
        }
        sensor
    }

    #[test]
    fn stray_measurements_are_left_out_and_counted() {
        // 0.4 mm of noise, and a coarse sensor of which most values are equal.
        let noise_m = |i: u32| 4e-4 * 2.0_f64.sqrt() * f64::from(i).sin();
        let counts_m = |i: u32| if i.is_multiple_of(4) { 1e-4 } else { 0.0 };
        for value_m in [noise_m as fn(u32) -> f64, counts_m] {
            let mut values_m: Vec<_> = (0..130).map(value_m).collect();
            let clean = sensor(&values_m).noise().expect("enough");
            assert_eq!((clean.left_out, clean.strays_note("tip")), (0, None));
            values_m[60] += 0.13;
            let found = sensor(&values_m).noise().expect("enough");
            assert_eq!((found.measurements, found.left_out), (130, 1));
            assert!((found.left_out_max_m - 0.13).abs() < 1e-3);
            let share = found.deviation_m[0] / clean.deviation_m[0];
            assert!((share - 1.0).abs() < 0.02, "{share}");
            let note = found.strays_note("tip").expect("a stray");
            assert!(note.starts_with("tip: 1 of 130"), "{note}");
        }
    }

    #[test]
    fn values_that_do_not_change_give_no_advice_of_zero() {
        let still = sensor(&[0.3; 100]).noise().expect("enough");
        let text = text(Some(&still), Some(&still), &[], &[0.0125]).expect("text");
        assert!(text.contains("unchanged"), "{text}");
        for absent in ["above 0.0", "tip_noise_m = ", "0.000000"] {
            assert!(!text.contains(absent), "{text}");
        }
    }
}
