use std::fs::File;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, ensure};
use cdcr_controller::calibration::CalibrationRow;
use cdcr_shared_types::{RobotDescription, Telemetry};

use super::pairs::Pairs;
use super::record::check_sensors;
use super::recording::CalibrationRows;
use super::resting::Sensors;
use crate::recording::file::{self, RecordedMessage};

/// The first bytes of an MCAP file.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// Whether a file is a recording (MCAP), by its name or its first bytes.
pub(super) fn is_recording(path: &Path) -> anyhow::Result<bool> {
    let cannot_read = || format!("cannot read {}", path.display());
    let mut begin = Vec::new();
    let file = File::open(path).with_context(cannot_read)?;
    let read = file.take(MAGIC.len() as u64).read_to_end(&mut begin);
    read.with_context(cannot_read)?;
    Ok(begin == MAGIC || path.extension().is_some_and(|end| end == "mcap"))
}

/// The robot of a recording, and a row for each tip measurement, with the motors' lengths at that time and the configured play.
pub(super) fn read(path: &Path) -> anyhow::Result<(RobotDescription, CalibrationRows)> {
    let name = path.display();
    let mut file = file::Recording::open(path)?;
    let mut records: Option<Records> = None;
    while let Some(message) = file.next_message()? {
        if let RecordedMessage::Telemetry(record) = message {
            let records = records.get_or_insert_with(|| Records::begin(&record));
            records.take(&record).with_context(|| name.to_string())?;
        }
    }
    file.warn_of_cut();
    let records = records.with_context(|| format!("{name} contains no telemetry of cdcrd"))?;
    records.finish().with_context(|| name.to_string())
}

/// Content of the records.
struct Records {
    robot: RobotDescription,
    play_m: f64,
    sensors: Sensors,
    pairs: Pairs,
    rows: Vec<CalibrationRow>,
    /// Times of the first row and the last \[s\].
    ends_s: Option<(f64, f64)>,
}

impl Records {
    fn begin(first: &Telemetry) -> Self {
        Self {
            robot: first.robot,
            play_m: first.play_m,
            sensors: Sensors::from_record(first),
            pairs: Pairs::new(first),
            rows: Vec::new(),
            ends_s: None,
        }
    }

    fn take(&mut self, record: &Telemetry) -> anyhow::Result<()> {
        ensure!(
            record.robot.fingerprint == self.robot.fingerprint,
            "the robot changes in cycle {}: record each robot into its own file",
            record.cycle
        );
        let sensors = Sensors::from_record(record);
        self.sensors.cables |= sensors.cables;
        self.sensors.tip |= sensors.tip;
        self.pairs.take(record);
        while let Some(pair) = self.pairs.next_pair() {
            self.ends_s.get_or_insert((pair.time_s, pair.time_s)).1 = pair.time_s;
            self.rows.push(CalibrationRow {
                cable_length_m: pair.cable_length_m,
                tip_position_m: pair.tip_position_m.into(),
                tip_rotation: None,
            });
        }
        Ok(())
    }

    fn finish(self) -> anyhow::Result<(RobotDescription, CalibrationRows)> {
        check_sensors(self.sensors)?;
        let recording = CalibrationRows {
            rows: self.rows,
            duration_s: self
                .ends_s
                .map_or(0.0, |(first_s, last_s)| last_s - first_s),
            play_m: self.play_m,
        };
        Ok((self.robot, recording))
    }
}
