use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, ensure};
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::MeasurementKind;
use cdcr_shared_types::limits::CABLES_MAX;

use super::recording::header;
use super::resting::{Sensors, next};
use crate::Done;
use crate::args::{RecordOptions, Target};
use crate::bar::Bar;
use crate::interrupt::Interrupt;

/// Cables are remembered for so many records, for a tip that is measured later than they arrive.
const REMEMBERED: usize = 200;

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
    tell(&options.output, rows.finish()?, passed_ns as f64 * 1e-9)?;
    Ok(Done::Good)
}

/// Refuses a robot of which too little is measured.
pub(super) fn check_sensors(record: &Telemetry) -> anyhow::Result<()> {
    let sensors = Sensors::of(record);
    ensure!(
        sensors.cables && sensors.tip,
        "measured are {}: calibration needs cable lengths and the tip, which a driver sends beside them (docs/drivers.md)",
        sensors.text()
    );
    Ok(())
}

/// Says what was written in `passed_s`, and fails where that is nothing.
pub(super) fn tell(output: &Path, rows: u64, passed_s: f64) -> anyhow::Result<()> {
    let name = output.display();
    ensure!(
        rows > 0,
        "{name}: no row: the tip was not measured meanwhile"
    );
    writeln!(
        std::io::stdout(),
        "{name}: {rows} rows in {passed_s:.1} s; next: cdcrctl calibrate geometry {name}"
    )?;
    Ok(())
}

/// Before anything is computed or moves: what was recorded before is kept.
pub(super) fn check_new(output: &Path) -> anyhow::Result<()> {
    let name = output.display();
    ensure!(
        !output.exists(),
        "{name} exists: remove it or name another file"
    );
    Ok(())
}

/// Rows of cables and tips, as they were at the time of the tip.
pub(super) struct Rows {
    out: csv::Writer<BufWriter<File>>,
    name: String,
    cables: usize,
    /// When the recording begins \[ns\].
    start_ns: u64,
    /// Cables and when they were measured \[ns\], oldest first.
    seen: VecDeque<(u64, [f64; CABLES_MAX])>,
    /// Tips that wait for cables that were measured after them.
    waiting: VecDeque<(u64, [f64; 3])>,
    newest_tip_ns: u64,
    written: u64,
}

impl Rows {
    /// A new file, for what is measured from the cycle of `first` on.
    pub(super) fn create(output: &Path, first: &Telemetry) -> anyhow::Result<Self> {
        check_sensors(first)?;
        let cables = 3 * first.command.sections as usize;
        let name = output.display().to_string();
        let file = File::create_new(output).with_context(|| format!("cannot write {name}"))?;
        let mut out = csv::Writer::from_writer(BufWriter::new(file));
        out.write_record(header(cables))?;
        Ok(Self {
            out,
            name,
            cables,
            start_ns: first.release_ns,
            seen: VecDeque::new(),
            waiting: VecDeque::new(),
            newest_tip_ns: 0,
            written: 0,
        })
    }

    pub(super) fn take(&mut self, record: &Telemetry) -> anyhow::Result<()> {
        let measured = &record.measurement;
        let newest_ns = self.seen.back().map_or(0, |(newest_ns, _)| *newest_ns);
        let is_cables = measured.kind == MeasurementKind::CableLengths.code();
        if is_cables && measured.measured_ns > newest_ns {
            let lengths_m = measured.cable_length_m;
            self.seen.push_back((measured.measured_ns, lengths_m));
            if self.seen.len() > REMEMBERED {
                self.seen.pop_front();
            }
        }
        if record.tip_measured_ns > self.newest_tip_ns {
            self.newest_tip_ns = record.tip_measured_ns;
            if record.tip_measured_ns >= self.start_ns {
                self.waiting
                    .push_back((record.tip_measured_ns, record.tip_measured_m));
            }
        }
        while let Some((tip_ns, tip_m)) = self.waiting.front().copied() {
            if self
                .seen
                .back()
                .is_none_or(|(newest_ns, _)| *newest_ns < tip_ns)
            {
                break;
            }
            self.waiting.pop_front();
            if let Some(lengths_m) = self.lengths_at(tip_ns) {
                self.write(tip_ns, &lengths_m, &tip_m)?;
            }
        }
        Ok(())
    }

    /// The cables at a time between two measurements of them; none where that was too long ago.
    fn lengths_at(&self, time_ns: u64) -> Option<[f64; CABLES_MAX]> {
        let after = self.seen.iter().position(|(ns, _)| *ns >= time_ns)?;
        let (after_ns, after_m) = self.seen[after];
        if after_ns == time_ns {
            return Some(after_m);
        }
        let (before_ns, before_m) = *self.seen.get(after.checked_sub(1)?)?;
        let part = (time_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
        Some(core::array::from_fn(|i| {
            before_m[i] + part * (after_m[i] - before_m[i])
        }))
    }

    fn write(&mut self, tip_ns: u64, lengths_m: &[f64], tip_m: &[f64; 3]) -> anyhow::Result<()> {
        let time_s = (tip_ns - self.start_ns) as f64 * 1e-9;
        let numbers = lengths_m[..self.cables].iter().chain(tip_m);
        let texts = numbers.map(|number| format!("{number:.7}"));
        self.out
            .write_record([format!("{time_s:.6}")].into_iter().chain(texts))
            .with_context(|| format!("cannot write {}", self.name))?;
        self.written += 1;
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

    use super::*;

    /// The tip is measured between two measurements of cables that move evenly, and arrives a cycle later.
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
        for cycle in 1..=4_u64 {
            let mut record = Telemetry::default();
            record.measurement.kind = MeasurementKind::CableLengths.code();
            record.measurement.measured_ns = 5_000_000 * cycle;
            record.measurement.cable_length_m[1] = 0.1 * cycle as f64;
            // Of 2 ms after the cables before, and of before the start in the first.
            record.tip_measured_ns = 5_000_000 * (cycle - 1) + 2_000_000;
            record.tip_measured_m[2] = cycle as f64;
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
        assert!(check_new(&output).is_err() && Rows::create(&output, &first).is_err());
    }
}
