use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use cdcr_client::TelemetryStream;
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::{MeasurementKind, Mode};

use crate::interrupt::QUIET;
use crate::standstill::Standstill;

/// Timeout for a resting robot to be detected at rest.
const TIMEOUT: Duration = Duration::from_secs(2);

pub(super) fn next(telemetry: &mut TelemetryStream) -> anyhow::Result<Telemetry> {
    let record = telemetry.next_within(QUIET)?;
    record.context("the daemon has sent no telemetry for 1 s; see cdcrctl status")
}

/// A record of a robot that holds and is measured at rest; refuses a moving one.
pub(super) fn rests(telemetry: &mut TelemetryStream) -> anyhow::Result<Telemetry> {
    let begun = Instant::now();
    let mut standstill = Standstill::default();
    loop {
        let record = next(telemetry)?;
        let is_held = record.mode == Mode::Holding.code();
        if !is_held || record.command.bend_rate_rad_s != [0.0; _] {
            let first = match Mode::try_from(record.mode) {
                Ok(Mode::Stopped | Mode::Faulted) => "cdcrctl reset --wait",
                Ok(Mode::Starting) => "start its driver",
                _ => "cdcrctl hold --wait or home --wait",
            };
            bail!(
                "the robot is not held at rest, the daemon is {}: first {first}",
                Mode::text_of(record.mode)
            );
        }
        standstill.note(&record);
        if standstill.is_at_rest() {
            return Ok(record);
        }
        if begun.elapsed() > TIMEOUT {
            bail!("the robot is held, but measured in motion; see cdcrctl status");
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sensors {
    pub(super) cables: bool,
    pub(super) tip: bool,
}

impl Sensors {
    pub(super) fn from_record(record: &Telemetry) -> Self {
        let kind = record.measurement.kind;
        Self {
            cables: kind == MeasurementKind::CableLengths.code(),
            tip: kind == MeasurementKind::TipPose.code() || record.tip_measured_ns > 0,
        }
    }

    pub(super) fn text(self) -> &'static str {
        match (self.cables, self.tip) {
            (true, true) => "cable lengths and the position of the tip",
            (true, false) => "cable lengths, and no tip",
            (false, true) => "the position of the tip, and no cable lengths",
            (false, false) => "neither cable lengths nor a tip",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_measured_quantities_are_read_from_a_record() {
        let mut record = Telemetry::default();
        for (kind, tip_measured_ns, cables, tip) in [
            (MeasurementKind::None, 0, false, false),
            (MeasurementKind::Configuration, 0, false, false),
            (MeasurementKind::CableLengths, 0, true, false),
            (MeasurementKind::CableLengths, 5, true, true),
            (MeasurementKind::Configuration, 5, false, true),
            (MeasurementKind::TipPose, 0, false, true),
        ] {
            record.measurement.kind = kind.code();
            record.tip_measured_ns = tip_measured_ns;
            assert_eq!(Sensors::from_record(&record), Sensors { cables, tip });
        }
    }
}
