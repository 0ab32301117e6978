use std::cell::Cell;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use cdcr_interchange::decode;
use cdcr_interchange::mcap::{Item, Message, ReadError, Reader, Whole};
use cdcr_shared_types::message::Struct;
use cdcr_shared_types::{Incident, ObstacleUpdate, ReferenceChunk, Status, Telemetry};

use super::topic::{Topic, WIRE_TYPE};
use crate::bar::Bar;

/// Time after which progress is shown.
const SHORT: Duration = Duration::from_secs(1);

/// A message of this project.
#[derive(Debug)]
pub(crate) enum RecordedMessage {
    Telemetry(Box<Telemetry>),
    Reference(Box<ReferenceChunk>),
    Obstacles(Box<ObstacleUpdate>),
    Status(Box<Status>),
    Incident(Box<Incident>),
}

/// A recording read from start to end, with one chunk in memory.
pub(crate) struct Recording<R = BufReader<Counted>> {
    path: PathBuf,
    reader: Reader<R>,
    all_bytes: u64,
    read_bytes: Rc<Cell<u64>>,
    /// Whether the file is truncated.
    is_cut: bool,
    progress: Option<ReadProgress>,
}

/// A recording of which everything that is whole is read.
pub(super) type DamagedRecording = Recording<Whole<Counted>>;

/// Counts the bytes read from a file.
pub(crate) struct Counted {
    file: File,
    read_bytes: Rc<Cell<u64>>,
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.read_bytes.set(self.read_bytes.get() + count as u64);
        Ok(count)
    }
}

impl Seek for Counted {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// Shows progress on a terminal after some time.
struct ReadProgress {
    begin: Instant,
    /// Bytes read when it was last shown.
    shown_bytes: u64,
    bar: Option<Bar>,
}

impl ReadProgress {
    fn update(&mut self, path: &Path, [read_bytes, all_bytes]: [u64; 2], elapsed: Duration) {
        if read_bytes != self.shown_bytes && elapsed > SHORT {
            self.shown_bytes = read_bytes;
            let bar = self.bar.get_or_insert_with(|| {
                // A path may be longer than a line.
                let name = path.file_name().unwrap_or_default();
                Bar::new(&name.to_string_lossy())
            });
            bar.show_share(read_bytes as f64 / all_bytes.max(1) as f64);
        }
    }
}

impl Recording {
    pub(crate) fn open(path: &Path) -> anyhow::Result<Self> {
        Self::start(path, |counted| {
            Reader::new(BufReader::with_capacity(1 << 17, counted))
        })
    }

    /// Opens what is whole of a damaged recording.
    pub(super) fn open_damaged(path: &Path) -> anyhow::Result<DamagedRecording> {
        DamagedRecording::start(path, Reader::around_damage)
    }
}

impl DamagedRecording {
    pub(super) fn whole(&self) -> &Whole<Counted> {
        self.reader.whole()
    }
}

impl<R: Read> Recording<R> {
    fn start(
        path: &Path,
        reader: impl FnOnce(Counted) -> Result<Reader<R>, ReadError>,
    ) -> anyhow::Result<Self> {
        let name = || path.display().to_string();
        let file = File::open(path).with_context(name)?;
        let all_bytes = file.metadata().with_context(name)?.len();
        let read_bytes = Rc::<Cell<u64>>::default();
        let counted = Counted {
            file,
            read_bytes: Rc::clone(&read_bytes),
        };
        let reader = reader(counted).with_context(name)?;
        Ok(Self {
            path: path.to_owned(),
            reader,
            all_bytes,
            read_bytes,
            is_cut: false,
            progress: Some(ReadProgress {
                begin: Instant::now(),
                shown_bytes: 0,
                bar: None,
            }),
        })
    }

    /// Disables the progress bar.
    pub(super) fn unseen(self) -> Self {
        Self {
            progress: None,
            ..self
        }
    }

    /// The next item of any kind; `None` at the end, also of a truncated file.
    pub(super) fn next_item(&mut self) -> anyhow::Result<Option<Item<'_>>> {
        let read_of_all_bytes = self.read_of_all_bytes();
        if let Some(progress) = &mut self.progress {
            progress.update(&self.path, read_of_all_bytes, progress.begin.elapsed());
        }
        let item = self.reader.next_item();
        if !matches!(item, Ok(Some(_))) {
            self.progress = None;
        }
        match item {
            Err(ReadError::Cut) => {
                self.is_cut = true;
                Ok(None)
            }
            item => item.with_context(|| self.path.display().to_string()),
        }
    }

    /// The next message of this project. Other content is skipped.
    pub(crate) fn next_message(&mut self) -> anyhow::Result<Option<RecordedMessage>> {
        loop {
            let name = self.path.display().to_string();
            let item = self
                .next_item()
                .map_err(|error| match error.downcast_ref() {
                    Some(ReadError::Damaged(_)) => anyhow!(
                        "{error:#}; recover all intact parts with `cdcrctl info --repair {name}`"
                    ),
                    _ => error,
                })?;
            match item {
                None => return Ok(None),
                Some(Item::Message(message)) => {
                    if let Some(message) = decoded(&message).with_context(|| name)? {
                        return Ok(Some(message));
                    }
                }
                Some(_) => {}
            }
        }
    }

    /// Bytes read, and the total.
    pub(super) fn read_of_all_bytes(&self) -> [u64; 2] {
        [self.read_bytes.get(), self.all_bytes]
    }

    /// Whether the file is truncated; known at its end.
    pub(super) fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// Prints how to repair a truncated recording.
    pub(crate) fn warn_of_cut(&self) {
        if self.is_cut {
            let name = self.path.display();
            tell!(
                "{name} is truncated: only complete messages were read; recover them with `cdcrctl info --repair {name}`"
            );
        }
    }
}

/// The decoded message, if it is one of this project. A message of another version is an error that names
/// both.
fn decoded(message: &Message<'_>) -> anyhow::Result<Option<RecordedMessage>> {
    let Some(topic) = Topic::of_schema(&message.channel.schema) else {
        return Ok(None);
    };
    check_version(topic, message)?;
    Ok(Some(match topic {
        Topic::Telemetry => RecordedMessage::Telemetry(content(message)?),
        Topic::Reference => RecordedMessage::Reference(content(message)?),
        Topic::Obstacles => RecordedMessage::Obstacles(content(message)?),
        Topic::Status => RecordedMessage::Status(content(message)?),
        Topic::Incidents => RecordedMessage::Incident(content(message)?),
    }))
}

fn content<T: Struct + Default>(message: &Message<'_>) -> anyhow::Result<Box<T>> {
    let mut content = Box::<T>::default();
    decode(message.data, &mut *content)
        .with_context(|| format!("message {} of {}", message.sequence, message.channel.topic))?;
    Ok(content)
}

fn check_version(topic: Topic, message: &Message<'_>) -> anyhow::Result<()> {
    let ours = topic.layout().type_name;
    let wire_type = message.channel.metadata.get(WIRE_TYPE);
    let found = wire_type.map_or("an unnamed type", String::as_str);
    if found != ours {
        bail!(
            "{} was recorded as {found}, but this cdcrctl ({}) reads {ours}: use the cdcrctl that recorded it",
            message.channel.topic,
            env!("CARGO_PKG_VERSION")
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_long_shows_how_far_it_is() {
        let shows = |elapsed| {
            let mut progress = ReadProgress {
                begin: Instant::now(),
                shown_bytes: 0,
                bar: None,
            };
            progress.update(Path::new("run.mcap"), [50, 100], elapsed);
            progress.bar.is_some()
        };
        assert!(!shows(SHORT) && shows(2 * SHORT));
    }
}
