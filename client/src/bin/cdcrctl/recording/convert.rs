use std::collections::btree_map::{BTreeMap, Entry};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use cdcr_client::{counted, events};
use cdcr_process::output_folder;
use cdcr_shared_types::codes::{EventKind, Outcome, RequestKind};
use cdcr_shared_types::message::{Array, Field, Kind, Meaning, Struct, Value};

use super::file::{RecordedMessage, Recording};
use crate::args::ConvertOptions;
use crate::done::Done;
use crate::echo::json::text_of;
use crate::files::new_file;
use crate::interrupt::Interrupt;

/// Column name and value; an empty value means none.
type NamedValue = (String, String);

pub(crate) fn run(options: &ConvertOptions) -> anyhow::Result<Done> {
    let is_new = !options.csv.exists();
    let done = convert(options);
    if is_new && !matches!(done, Ok(Done::Good)) {
        // An empty folder only, so nothing of anyone else.
        drop(fs::remove_dir(&options.csv));
    }
    done
}

fn convert(options: &ConvertOptions) -> anyhow::Result<Done> {
    let folder = &options.csv;
    let name = folder.display();
    // A table that reaches its size limit is then an error, too.
    let interrupt = Interrupt::catch()?;
    let mut recording = Recording::open(&options.file)?;
    output_folder(folder)?;
    let mut tables = Tables::new(folder);
    let written = tables.take_all(&mut recording, &interrupt);
    let rows = tables
        .finish(matches!(written, Ok(true)))
        .with_context(|| format!("cannot write into {name}"));
    if !written? {
        return Ok(Done::Interrupted);
    }
    let rows = rows?;
    ensure!(
        !rows.is_empty(),
        "{} contains no message of cdcrd",
        options.file.display()
    );
    let mut out = io::stdout().lock();
    for (path, rows) in rows {
        writeln!(out, "{}: {}", path.display(), counted(rows, "row"))?;
    }
    recording.warn_of_cut();
    Ok(Done::Good)
}

/// Output tables by name.
struct Tables<'a> {
    folder: &'a Path,
    open: BTreeMap<&'static str, Table>,
}

struct Table {
    out: csv::Writer<BufWriter<File>>,
    path: PathBuf,
    rows: u64,
}

impl<'a> Tables<'a> {
    fn new(folder: &'a Path) -> Self {
        Self {
            folder,
            open: BTreeMap::new(),
        }
    }

    /// Returns false if the user interrupts it.
    fn take_all(
        &mut self,
        recording: &mut Recording,
        interrupt: &Interrupt,
    ) -> anyhow::Result<bool> {
        while let Some(message) = recording.next_message()? {
            if interrupt.is_raised() {
                return Ok(false);
            }
            self.take(&message)
                .with_context(|| format!("cannot write into {}", self.folder.display()))?;
        }
        Ok(true)
    }

    fn take(&mut self, message: &RecordedMessage) -> anyhow::Result<()> {
        match message {
            RecordedMessage::Telemetry(record) => {
                self.put("telemetry", &cells(&**record))?;
                for event in events(record) {
                    let mut row = vec![("cycle".to_owned(), record.cycle.to_string())];
                    row.extend(cells(event));
                    let is_request = event.kind == EventKind::Request.code();
                    let request = is_request.then(|| RequestKind::text_of(event.detail));
                    row.push(("request".to_owned(), request.unwrap_or_default().to_owned()));
                    row.push((
                        "accepted".to_owned(),
                        (event.outcome == Outcome::Accepted.code()).to_string(),
                    ));
                    self.put("events", &row)?;
                }
                Ok(())
            }
            RecordedMessage::Reference(chunk) => {
                let used = chunk.points.get(..chunk.count as usize).unwrap_or_default();
                self.put_each("reference", &cells(&**chunk), used)
            }
            RecordedMessage::Obstacles(update) => {
                let used = update
                    .obstacles
                    .get(..update.count as usize)
                    .unwrap_or_default();
                self.put_each("obstacles", &cells(&**update), used)
            }
            RecordedMessage::Status(status) => self.put("status", &cells(&**status)),
            RecordedMessage::Incident(incident) => self.put("incidents", &cells(&**incident)),
        }
    }

    /// A row per part; a single row with empty cells if there is none.
    fn put_each<T: Struct + Default>(
        &mut self,
        name: &'static str,
        whole: &[NamedValue],
        parts: &[T],
    ) -> anyhow::Result<()> {
        let row = |part: Vec<NamedValue>| [whole, &part].concat();
        if parts.is_empty() {
            let mut empty = cells(&T::default());
            for (_, value) in &mut empty {
                value.clear();
            }
            return self.put(name, &row(empty));
        }
        parts
            .iter()
            .try_for_each(|part| self.put(name, &row(cells(part))))
    }

    fn put(&mut self, name: &'static str, row: &[NamedValue]) -> anyhow::Result<()> {
        let table = match self.open.entry(name) {
            Entry::Occupied(table) => table.into_mut(),
            Entry::Vacant(free) => {
                let path = self.folder.join(format!("{name}.csv"));
                let file = new_file(&path, "or use another --csv folder")?;
                let out = csv::Writer::from_writer(BufWriter::new(file));
                let table = free.insert(Table { out, path, rows: 0 });
                table.out.write_record(row.iter().map(|(name, _)| name))?;
                table
            }
        };
        table.out.write_record(row.iter().map(|(_, value)| value))?;
        table.rows += 1;
        Ok(())
    }

    /// Paths and numbers of rows. Deletes all tables if one of them is incomplete.
    fn finish(mut self, are_whole: bool) -> io::Result<Vec<(PathBuf, u64)>> {
        let flushed = self
            .open
            .values_mut()
            .try_for_each(|table| table.out.flush());
        let made = self.open.into_values();
        let made: Vec<_> = made.map(|table| (table.path, table.rows)).collect();
        if flushed.is_err() || !are_whole {
            for (path, _) in &made {
                drop(fs::remove_file(path));
            }
        }
        flushed.map(|()| made)
    }
}

/// A message as one row: `command.mode`, `bend_rad[2]`. Lists of variable length (plans, events, obstacles,
/// points) are omitted, so that each row has the same cells.
fn cells(message: &dyn Struct) -> Vec<NamedValue> {
    let mut paths = ["robot.sections", "telemetry.robot.sections"].iter();
    let sections = paths.find_map(|path| message.number(path));
    let mut row = Vec::new();
    add(message, "", true, sections.unwrap_or(0) as usize, &mut row);
    row
}

fn add(
    message: &dyn Struct,
    before: &str,
    has_meaning: bool,
    sections: usize,
    row: &mut Vec<NamedValue>,
) {
    message.visit(&mut |field, value| {
        let used = message.used(field);
        let has_meaning = has_meaning && used.is_some();
        let name = format!("{before}{}", field.name);
        match (field.meaning, value) {
            (Meaning::Reserved, _) => {}
            (Meaning::Text, Value::Array(array)) => row.push((name, text_of(array))),
            (_, Value::Array(array)) => {
                for i in 0..lasting(field, array, sections) {
                    let has_meaning = has_meaning && used.is_some_and(|used| i < used);
                    let name = format!("{name}[{i}]");
                    put(field, array.element(i), name, has_meaning, sections, row);
                }
            }
            (_, value) => put(field, value, name, has_meaning, sections, row),
        }
    });
}

/// Number of array elements in every message of a robot. (A measurement before the first one has zero
/// sections.)
fn lasting(field: &Field, array: &dyn Array, sections: usize) -> usize {
    match field.used {
        None => array.count(),
        Some(used) if used.count.ends_with("sections") => (sections * used.each).min(array.count()),
        Some(_) => 0,
    }
}

fn put(
    field: &Field,
    value: Value<'_>,
    name: String,
    has_meaning: bool,
    sections: usize,
    row: &mut Vec<NamedValue>,
) {
    let text = match (field.meaning, value) {
        (_, Value::Struct(part)) => {
            return add(part, &format!("{name}."), has_meaning, sections, row);
        }
        (Meaning::Code(codes), Value::U32(code)) if matches!(field.kind, Kind::U32) => {
            codes.text(code).to_owned()
        }
        (Meaning::OrNone, Value::U32(u32::MAX)) => String::new(),
        (_, Value::U8(number)) => number.to_string(),
        (_, Value::U32(number)) => number.to_string(),
        (_, Value::U64(number)) => number.to_string(),
        (_, Value::F64(number)) => number.to_string(),
        (_, Value::Array(_)) => return,
    };
    row.push((name, if has_meaning { text } else { String::new() }));
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::Telemetry;
    use cdcr_shared_types::codes::MeasurementKind;

    use super::*;

    #[test]
    fn a_cycle_before_the_first_measurement_has_the_cells_of_every_other() {
        let mut record = Telemetry::default();
        record.robot.sections = 2;
        let before = cells(&record);
        record.measurement.sections = 2;
        record.measurement.kind = MeasurementKind::CableLengths.code();
        let after = cells(&record);
        let name = |(name, _): &NamedValue| name.clone();
        assert!(before.iter().map(name).eq(after.iter().map(name)));
        let cable = |row: &[NamedValue]| {
            let cable = row
                .iter()
                .find(|cell| cell.0 == "measurement.cable_length_m[5]");
            cable.expect("a column").1.clone()
        };
        assert_eq!([cable(&before), cable(&after)], ["", "0"]);
    }
}
