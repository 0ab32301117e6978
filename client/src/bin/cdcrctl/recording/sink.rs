use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{self, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use cdcr_client::text;
use cdcr_interchange::mcap::{self, Channel, Stamp, Writer};
use cdcr_shared_types::Status;

use super::record::OR;
use super::topic::{Drawn, Topic};
use crate::files::new_file;

/// Channels of a file: those of the services, then the drawn ones.
pub(super) const CHANNELS: usize = Topic::ALL.len() + Drawn::ALL.len();
/// Maximum memory of the kept messages, whatever their time span.
const RING_BYTES: usize = 64 << 20;

/// Maximum size of a chunk that is not written yet, of the findings of the doctor and of the end without the index.
const END_BYTES: u64 = 512_000;
/// The index is at most one part of so many of the data before it: 0.8 % at 200 Hz, 2.9 % at 10 Hz, where chunks are small.
const INDEX_PART: u64 = 25;

/// Metadata at the start of a file.
pub(super) struct Head {
    channels: Vec<Channel>,
    about: BTreeMap<String, String>,
    attachments: Vec<Attachment>,
}

struct Attachment {
    name: &'static str,
    media_type: &'static str,
    data: Vec<u8>,
}

impl Head {
    /// For a recording of this daemon; `offset_ns` converts `CLOCK_MONOTONIC` to the time since 1970.
    pub(super) fn new(robot: &str, status: &Status, offset_ns: u64) -> anyhow::Result<Self> {
        let services = Topic::ALL.map(|topic| topic.channel(robot));
        let mut channels = services.into_iter().collect::<Result<Vec<_>, _>>()?;
        channels.extend(Drawn::ALL.map(|drawn| drawn.channel(robot)));
        let kernel = std::fs::read_to_string("/proc/sys/kernel/osrelease").unwrap_or_default();
        let about = [
            ("robot", robot.to_owned()),
            ("robot_fingerprint", status.robot.fingerprint.to_string()),
            ("daemon", text(&status.build)),
            ("recorder", library()),
            ("kernel", kernel.trim().to_owned()),
            ("unix_minus_monotonic_ns", offset_ns.to_string()),
        ];
        Ok(Self {
            channels,
            about: about
                .map(|(name, value)| (name.to_owned(), value))
                .into_iter()
                .collect(),
            attachments: Vec::new(),
        })
    }

    pub(super) fn attach(&mut self, name: &'static str, media_type: &'static str, data: Vec<u8>) {
        self.attachments.push(Attachment {
            name,
            media_type,
            data,
        });
    }
}

fn library() -> String {
    concat!("cdcrctl ", env!("CARGO_PKG_VERSION")).to_owned()
}

/// A queued message.
struct Held {
    channel: usize,
    stamp: Stamp,
    data: Vec<u8>,
}

/// The newest messages, limited by age.
struct Ring {
    held: VecDeque<Held>,
    bytes: usize,
    kept_ns: u64,
}

impl Ring {
    fn push(&mut self, held: Held) {
        let oldest_ns = held.stamp.log_ns.saturating_sub(self.kept_ns);
        self.bytes += held.data.len();
        self.held.push_back(held);
        while self
            .held
            .front()
            .is_some_and(|first| first.stamp.log_ns < oldest_ns || self.bytes > RING_BYTES)
        {
            self.bytes -= self.held.pop_front().map_or(0, |first| first.data.len());
        }
    }
}

/// Destination of the messages: memory until the file is created, then the file.
pub(super) struct Sink {
    head: Head,
    ring: Ring,
    file: Option<(Writer<File>, Vec<u16>)>,
    /// The same open file, to detect its removal.
    opened: Option<File>,
    path: PathBuf,
    /// Messages of each channel passed to the file.
    counts: [u64; CHANNELS],
    /// Messages of each channel at the last flush.
    pub(super) whole: [u64; CHANNELS],
}

impl Sink {
    /// Keeps the messages of the last `kept` until [`begin`](Self::begin).
    pub(super) fn new(head: Head, path: &Path, kept: Duration) -> Self {
        Self {
            head,
            ring: Ring {
                held: VecDeque::new(),
                bytes: 0,
                kept_ns: kept.as_nanos() as u64,
            },
            file: None,
            opened: None,
            path: path.to_owned(),
            counts: [0; CHANNELS],
            whole: [0; CHANNELS],
        }
    }

    /// Creates the file and writes the kept messages; the inner error is an I/O error such as a full disk.
    pub(super) fn begin(&mut self, unix_ns: u64) -> anyhow::Result<io::Result<()>> {
        let name = self.path.display();
        let cannot_write = || format!("cannot write {name}");
        let file = new_file(&self.path, OR)?;
        self.opened = Some(file.try_clone().with_context(cannot_write)?);
        let writer = Writer::new(file, "ros2", &library());
        let mut writer = writer
            .inspect_err(|_| self.remove())
            .with_context(cannot_write)?;
        let mut begun = || {
            let ids = self.head.channels.iter();
            let ids = ids
                .map(|channel| writer.add_channel(channel))
                .collect::<io::Result<_>>()?;
            writer.add_metadata("cdcr", self.head.about.clone())?;
            for attachment in &self.head.attachments {
                let Attachment {
                    name,
                    media_type,
                    data,
                } = attachment;
                writer.attach(name, media_type, unix_ns, data)?;
            }
            Ok(ids)
        };
        let ids = begun();
        let (ids, begun) = ids.map_or_else(|cause| (Vec::new(), Err(cause)), |ids| (ids, Ok(())));
        self.file = Some((writer, ids));
        Ok(begun.and_then(|()| {
            let held = std::mem::take(&mut self.ring.held);
            held.into_iter()
                .try_for_each(|held| self.put(held.channel, held.stamp, held.data))
        }))
    }

    /// Whether the file has no name any more. A renamed file has one.
    pub(super) fn is_removed(&self) -> bool {
        let metadata = self.opened.as_ref().map(File::metadata);
        matches!(metadata, Some(Ok(metadata)) if metadata.nlink() == 0)
    }

    pub(super) fn has_begun(&self) -> bool {
        self.file.is_some()
    }

    /// Adds a message to the channel with this index.
    pub(super) fn put(&mut self, channel: usize, stamp: Stamp, data: Vec<u8>) -> io::Result<()> {
        let Some((writer, ids)) = &mut self.file else {
            self.ring.push(Held {
                channel,
                stamp,
                data,
            });
            return Ok(());
        };
        writer.write(ids[channel], stamp, &data)?;
        self.counts[channel] += 1;
        Ok(())
    }

    pub(super) fn flush(&mut self) -> io::Result<()> {
        if let Some((writer, _)) = &mut self.file {
            writer.flush()?;
            self.whole = self.counts;
        }
        Ok(())
    }

    /// Whether the file, with its end, would be larger than this after the next messages.
    pub(super) fn is_at(&self, max_bytes: u64) -> bool {
        let written_bytes = (self.file.as_ref()).map_or(0, |(writer, _)| writer.written_bytes());
        written_bytes + written_bytes / INDEX_PART + END_BYTES > max_bytes
    }

    /// Removes a file without a message.
    fn remove(&self) {
        drop(std::fs::remove_file(&self.path));
    }

    /// Completes the file, if there is one, even when the disk is nearly full. `about` and `attachment` are
    /// its last entries. After a failure, a file without a message is removed.
    pub(super) fn finish(
        mut self,
        is_good: bool,
        about: BTreeMap<String, String>,
        attachment: Option<(&str, u64, Vec<u8>)>,
    ) -> io::Result<()> {
        let Some((mut writer, _)) = self.file.take() else {
            return Ok(());
        };
        if !is_good && self.whole.iter().all(|count| *count == 0) {
            self.remove();
            return Ok(());
        }
        let whole_bytes = writer.whole_bytes();
        if !is_good {
            return cut(writer.abandon(), whole_bytes);
        }
        let attached = attachment.map_or(Ok(()), |(name, unix_ns, data)| {
            writer.attach(name, "application/json", unix_ns, &data)
        });
        let whole_bytes = writer.whole_bytes();
        if attached
            .and_then(|()| writer.add_metadata("cdcr_end", about))
            .is_err()
        {
            return cut(writer.abandon(), whole_bytes);
        }
        let whole_bytes = writer.whole_bytes();
        match writer.finish() {
            Ok(_) => Ok(()),
            Err((file, _)) => cut(file, whole_bytes),
        }
    }
}

/// Removes the incomplete end, and completes the rest.
fn cut(mut file: File, whole_bytes: u64) -> io::Result<()> {
    file.set_len(whole_bytes)?;
    file.seek(SeekFrom::Start(whole_bytes))?;
    mcap::end(&mut file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_holds_the_newest_and_no_more_than_it_may() {
        let mut ring = Ring {
            held: VecDeque::new(),
            bytes: 0,
            kept_ns: 10,
        };
        let held = |log_ns, bytes| Held {
            channel: 0,
            stamp: Stamp {
                sequence: 0,
                log_ns,
                publish_ns: 0,
            },
            data: vec![0; bytes],
        };
        (0..100).for_each(|log_ns| ring.push(held(log_ns, 3)));
        assert_eq!((ring.held.len(), ring.bytes), (11, 33));
        assert_eq!(ring.held[0].stamp.log_ns, 89);
        ring.push(held(100, RING_BYTES - 2));
        assert_eq!((ring.held.len(), ring.bytes), (1, RING_BYTES - 2));
    }
}
