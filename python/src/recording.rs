use std::collections::BTreeSet;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::time::Instant;

use cdcr_client::channels::{Topic, WIRE_TYPE};
use cdcr_interchange::decode;
use cdcr_interchange::mcap::{Item, Message, ReadError, Reader};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::errors::{Class, Failure};
use crate::numbers::count;
use crate::wire::Records;
use crate::worker::SIGNALS_EACH;

/// What to do with a path that leads to none.
const OF_CDCRCTL: &str = "Give the path of a recording, which cdcrctl record writes.";

/// Reads a recording of cdcrctl: a dictionary of structured arrays, "telemetry", "reference", "obstacles", "status" and "incidents", with the fields of the messages
/// Telemetry, ReferenceChunk, ObstacleUpdate, Status and Incident; one for each that the file holds.
///
/// path: an MCAP file. every: keep each so many-th record of telemetry. A record of telemetry has 15.6 kB: an hour at 5 ms are 11 GB, so `every` is for long files.
/// A file that is cut gives what is whole, and a warning. Raises RecordingError for a file that is none, has no message, is damaged, or has messages of another version or of
/// more than one robot.
#[pyfunction]
#[pyo3(signature = (path, *, every = 1) -> "dict[str, Records]")]
pub(crate) fn read(py: Python<'_>, path: PathBuf, every: i128) -> PyResult<Bound<'_, PyDict>> {
    let every = count("every", every, 1..=u32::MAX)? as usize;
    let mut recording = Recording::open(&path, every)?;
    // A recording of an hour takes a while; Python checks for signals in between.
    while py.detach(|| recording.read_more())? {
        py.check_signals()?;
    }
    let found = PyDict::new(py);
    for (topic, records) in Topic::ALL.into_iter().zip(recording.found) {
        if records.count() > 0 {
            found.set_item(topic.service().key(), records)?;
        }
    }
    let name = path.display();
    if found.is_empty() {
        let message = format!("{name} contains no message of cdcrd");
        return Err(Failure::new(Class::Recording, message, OF_CDCRCTL).into());
    }
    if recording.is_cut {
        let text = format!(
            "{name} is truncated: only complete messages were read; recover them with `cdcrctl info --repair {name}`"
        );
        py.import("warnings")?.call_method1("warn", (text,))?;
    }
    Ok(found)
}

struct Recording {
    path: String,
    reader: Reader<BufReader<File>>,
    every: usize,
    passed: usize,
    /// Records by index of their topic.
    found: Vec<Records>,
    robots: BTreeSet<String>,
    is_cut: bool,
}

impl Recording {
    fn open(path: &Path, every: usize) -> Result<Self, Failure> {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|error| {
            Failure::new(Class::Recording, format!("{name}: {error}"), OF_CDCRCTL)
        })?;
        let reader = Reader::new(BufReader::with_capacity(1 << 17, file));
        Ok(Self {
            reader: reader.map_err(|error| unreadable(&name, &error))?,
            path: name,
            every,
            passed: 0,
            found: Topic::ALL.map(|topic| Records::new(topic.layout())).into(),
            robots: BTreeSet::new(),
            is_cut: false,
        })
    }

    /// Reads for a short time; false at the end.
    fn read_more(&mut self) -> Result<bool, Failure> {
        let until = Instant::now() + SIGNALS_EACH;
        while Instant::now() < until {
            let item = match self.reader.next_item() {
                Err(ReadError::Cut) => {
                    self.is_cut = true;
                    return Ok(false);
                }
                item => item.map_err(|error| unreadable(&self.path, &error))?,
            };
            match item {
                None => return Ok(false),
                Some(Item::Message(message)) => {
                    let Some(topic) = Topic::of_schema(&message.channel.schema) else {
                        continue;
                    };
                    check(&self.path, topic, &message)?;
                    self.robots.insert(message.channel.topic.clone());
                    if topic == Topic::Telemetry {
                        self.passed += 1;
                        if !(self.passed - 1).is_multiple_of(self.every) {
                            continue;
                        }
                    }
                    let mut found = topic.zero();
                    decode(message.data, &mut *found)
                        .map_err(|error| refused(&self.path, &error))?;
                    self.found[topic as usize].push(&*found);
                    one_robot(&self.path, &self.robots)?;
                }
                Some(_) => {}
            }
        }
        Ok(true)
    }
}

fn check(path: &str, topic: Topic, message: &Message<'_>) -> Result<(), Failure> {
    let ours = topic.layout().type_name;
    match message.channel.metadata.get(WIRE_TYPE) {
        Some(theirs) if theirs != ours => Err(Failure::new(
            Class::Recording,
            format!("{path} holds {theirs}; this package reads {ours}"),
            "Read it with the package of the version that recorded it.",
        )),
        _ => Ok(()),
    }
}

fn one_robot(path: &str, topics: &BTreeSet<String>) -> Result<(), Failure> {
    let robots: BTreeSet<_> = topics
        .iter()
        .filter_map(|topic| topic.rsplit('/').nth(1))
        .collect();
    if robots.len() <= 1 {
        return Ok(());
    }
    let names: Vec<_> = robots.into_iter().collect();
    Err(Failure::new(
        Class::Recording,
        format!("{path} holds more than one robot: {}", names.join(", ")),
        "Record each robot in a file of its own.",
    ))
}

fn unreadable(path: &str, error: &ReadError) -> Failure {
    let ReadError::Damaged(_) = error else {
        return refused(path, error);
    };
    Failure::new(
        Class::Recording,
        format!("{path}: {error}"),
        format!("Recover all intact parts with: cdcrctl info --repair {path}"),
    )
}

fn refused(path: &str, error: &dyn std::fmt::Display) -> Failure {
    Failure::new(
        Class::Recording,
        format!("{path}: {error}"),
        format!("See what it holds with: cdcrctl info {path}"),
    )
}
