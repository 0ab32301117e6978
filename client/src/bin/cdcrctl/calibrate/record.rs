use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, ensure};
use cdcr_client::counted;
use cdcr_shared_types::Telemetry;

use super::pairs::Pairs;
use super::recording::header;
use super::resting::{Sensors, next};
use crate::args::{RecordOptions, Target};
use crate::bar::Bar;
use crate::done::Done;
use crate::files::new_file;
use crate::interrupt::Interrupt;

pub(super) fn run(target: &Target, options: &RecordOptions) -> anyhow::Result<Done> {
    let mut telemetry = target.connect()?.telemetry()?;
    let first = next(&mut telemetry)?;
    let mut rows = Rows::create(&options.output, &first)?;
    let interrupt = Interrupt::catch()?;
    let bar = Bar::new("record");
    let duration_ns = options.duration.as_nanos() as u64;
    let mut passed_ns = 0;
    while passed_ns < duration_ns && !interrupt.is_raised() {
        let record = next(&mut telemetry)?;
        rows.take(&record)?;
        passed_ns = record.release_ns.saturating_sub(first.release_ns);
        bar.show_share(passed_ns as f64 / duration_ns as f64);
    }
    drop(bar);
    print_rows(&options.output, rows.finish()?, passed_ns as f64 * 1e-9)?;
    Ok(Done::Good)
}

/// Refuses a robot without the required measurements.
pub(super) fn check_sensors(sensors: Sensors) -> anyhow::Result<()> {
    ensure!(
        sensors.cables && sensors.tip,
        "measured: {}; calibration needs cable lengths and the tip from the driver (docs/drivers.md)",
        sensors.text()
    );
    Ok(())
}

/// Prints the rows written in `passed_s`, and fails if there are none.
pub(super) fn print_rows(output: &Path, rows: u64, passed_s: f64) -> anyhow::Result<()> {
    let name = output.display();
    ensure!(rows > 0, "{name}: no row, because the tip was not measured");
    writeln!(
        std::io::stdout(),
        "{name}: {} in {passed_s:.1} s; next: cdcrctl calibrate geometry {name}",
        counted(rows, "row")
    )?;
    Ok(())
}

/// What the user can do when the file exists, instead of removing it.
pub(super) const OR: &str = "or use another file";

/// Rows of tips, with the cables at the time of the tip.
pub(super) struct Rows {
    out: csv::Writer<BufWriter<File>>,
    name: String,
    cables: usize,
    pairs: Pairs,
    written: u64,
}

impl Rows {
    /// Creates a file for measurements from the cycle of `first` on.
    pub(super) fn create(output: &Path, first: &Telemetry) -> anyhow::Result<Self> {
        check_sensors(Sensors::from_record(first))?;
        let cables = 3 * first.command.sections as usize;
        let name = output.display().to_string();
        let file = new_file(output, OR)?;
        let mut out = csv::Writer::from_writer(BufWriter::new(file));
        out.write_record(header(cables))?;
        Ok(Self {
            out,
            name,
            cables,
            pairs: Pairs::new(first),
            written: 0,
        })
    }

    pub(super) fn take(&mut self, record: &Telemetry) -> anyhow::Result<()> {
        self.pairs.take(record);
        while let Some(pair) = self.pairs.next_pair() {
            let lengths_m = &pair.cable_length_m[..self.cables];
            let numbers = lengths_m.iter().chain(&pair.tip_position_m);
            let texts = numbers.map(|number| format!("{number:.7}"));
            let row = [format!("{:.6}", pair.time_s)].into_iter().chain(texts);
            let written = self.out.write_record(row);
            written.with_context(|| format!("cannot write {}", self.name))?;
            self.written += 1;
        }
        Ok(())
    }

    pub(super) fn finish(mut self) -> anyhow::Result<u64> {
        let flushed = self.out.flush();
        flushed.with_context(|| format!("cannot write {}", self.name))?;
        Ok(self.written)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use cdcr_scratch::Scratch;
    use cdcr_shared_types::codes::MeasurementKind;

    use super::*;

    // The tip is measured between two measurements of evenly moving cables, and arrives a cycle later. The
    // last one is NaN.
    #[test]
    fn cables_are_taken_at_the_time_of_the_tip() {
        let folder = Scratch::temporary().expect("a folder");
        let output = folder.path().join("a.csv");
        let mut first = Telemetry {
            release_ns: 4_000_000,
            tip_measured_ns: 1,
            ..Telemetry::default()
        };
        first.measurement.kind = MeasurementKind::CableLengths.code();
        first.command.sections = 1;
        let mut rows = Rows::create(&output, &first).expect("a new file");
        for cycle in 1..=5_u64 {
            let mut record = Telemetry::default();
            record.measurement.kind = MeasurementKind::CableLengths.code();
            record.measurement.measured_ns = 5_000_000 * cycle;
            record.measurement.cable_length_m[1] = 0.1 * cycle as f64;
            // 2 ms after the cables; in the first cycle before the start.
            record.tip_measured_ns = 5_000_000 * (cycle - 1) + 2_000_000;
            record.tip_measured_m[2] = if cycle == 5 { f64::NAN } else { cycle as f64 };
            rows.take(&record).expect("written");
        }
        assert_eq!(rows.finish().expect("written"), 3);
        let text = fs::read_to_string(&output).expect("written");
        assert_eq!(
            text,
            "t_s,cable_1_m,cable_2_m,cable_3_m,x_m,y_m,z_m\n\
             0.003000,0.0000000,0.1400000,0.0000000,0.0000000,0.0000000,2.0000000\n\
             0.008000,0.0000000,0.2400000,0.0000000,0.0000000,0.0000000,3.0000000\n\
             0.013000,0.0000000,0.3400000,0.0000000,0.0000000,0.0000000,4.0000000\n"
        );
        assert!(
            crate::files::check_new(&output, OR).is_err() && Rows::create(&output, &first).is_err()
        );
    }
}
