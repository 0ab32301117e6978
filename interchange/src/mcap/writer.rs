use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, ErrorKind, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, Compression, MAGIC, McapError, WriteOptions};

use super::{Channel, MESSAGE_ENCODING, SCHEMA_ENCODING};

/// Size at which a chunk is written; a truncated file loses later data.
const CHUNK_BYTES: u64 = 64 * 1024;

/// Sequence number and times of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    /// Sequence number in its channel.
    pub sequence: u32,
    /// Time of recording since 1970 \[ns\].
    pub log_ns: u64,
    /// Time of sending since 1970 \[ns\].
    pub publish_ns: u64,
}

/// Writes a recording: chunks of 64 KiB, compressed with LZ4.
///
/// Every error comes from the output. After an error, the only valid operation is [`end`] on the output
/// returned by [`abandon`](Self::abandon).
pub struct Writer<W: Write> {
    inner: mcap::Writer<NoSeek<Counting<W>>>,
    counted: Arc<Counted>,
    whole_bytes: u64,
}

/// State of the output.
#[derive(Debug, Default)]
struct Counted {
    bytes: AtomicU64,
    /// Kind of its first error.
    failed: OnceLock<ErrorKind>,
}

struct Counting<W> {
    out: W,
    counted: Arc<Counted>,
}

impl<W: Write> Write for Counting<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes);
        match &written {
            Ok(count) => {
                let count = *count as u64;
                self.counted.bytes.fetch_add(count, Ordering::Relaxed);
            }
            Err(error) if error.kind() != ErrorKind::Interrupted => {
                let _ = self.counted.failed.set(error.kind());
            }
            Err(_) => {}
        }
        written
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

impl<W: Write> Writer<W> {
    /// Starts a recording. `profile` names the kind of messages, such as `ros2`; `library` the writing
    /// program.
    ///
    /// # Errors
    /// When the output cannot be written.
    pub fn new(out: W, profile: &str, library: &str) -> io::Result<Self> {
        let counted = Arc::<Counted>::default();
        let out = Counting {
            out,
            counted: Arc::clone(&counted),
        };
        let options = WriteOptions::new()
            .profile(profile)
            .library(library)
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK_BYTES))
            // Each chunk is written at once with its length, so that a truncated one is detected.
            .disable_seeking(true);
        let writer = options.create(NoSeek::new(out));
        let writer = writer.map_err(|error| counted.error(error))?;
        let mut writer = Self {
            inner: writer,
            counted,
            whole_bytes: 0,
        };
        writer.flush()?;
        Ok(writer)
    }

    /// Adds a channel and returns its number. The same channel gets the same number.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn add_channel(&mut self, channel: &Channel) -> io::Result<u16> {
        let Channel {
            topic,
            schema,
            text,
            metadata,
        } = channel;
        let writer = &mut self.inner;
        let id = writer
            .add_schema(schema, SCHEMA_ENCODING, text.as_bytes())
            .and_then(|schema| writer.add_channel(schema, topic, MESSAGE_ENCODING, metadata));
        self.checked(id)
    }

    /// Adds a message to a channel.
    ///
    /// # Errors
    /// As [`new`](Self::new), and for a channel number that was not added.
    pub fn write(&mut self, channel_id: u16, stamp: Stamp, data: &[u8]) -> io::Result<()> {
        let header = MessageHeader {
            channel_id,
            sequence: stamp.sequence,
            log_time: stamp.log_ns,
            publish_time: stamp.publish_ns,
        };
        let written = self.inner.write_to_known_channel(&header, data);
        self.checked(written)
    }

    /// Adds a file.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn attach(
        &mut self,
        name: &str,
        media_type: &str,
        time_ns: u64,
        data: &[u8],
    ) -> io::Result<()> {
        let attachment = Attachment {
            log_time: time_ns,
            create_time: time_ns,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(data),
        };
        let written = self.inner.attach(&attachment);
        self.checked(written)?;
        self.flush()
    }

    /// Adds named values.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn add_metadata(&mut self, name: &str, values: BTreeMap<String, String>) -> io::Result<()> {
        let metadata = Metadata {
            name: name.to_owned(),
            metadata: values,
        };
        let written = self.inner.write_metadata(&metadata);
        self.checked(written)?;
        self.flush()
    }

    /// Writes everything added since the last chunk.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn flush(&mut self) -> io::Result<()> {
        let flushed = self.inner.flush();
        self.checked(flushed)?;
        self.whole_bytes = self.written_bytes();
        Ok(())
    }

    /// Number of complete bytes after the last flush; the bytes after them may be truncated.
    pub fn whole_bytes(&self) -> u64 {
        self.whole_bytes
    }

    /// Number of bytes written so far. What the next [`flush`](Self::flush) adds, and the index, is not in it.
    pub fn written_bytes(&self) -> u64 {
        self.counted.bytes.load(Ordering::Relaxed)
    }

    /// Completes the recording with its index, and returns the output.
    ///
    /// # Errors
    /// As [`new`](Self::new); the error contains the output.
    pub fn finish(mut self) -> Result<W, (W, io::Error)> {
        let finished = self.flush().and_then(|()| {
            let finished = self.inner.finish();
            self.checked(finished).map(drop)
        });
        let mut out = self.abandon();
        match finished.and_then(|()| out.flush()) {
            Ok(()) => Ok(out),
            Err(error) => Err((out, error)),
        }
    }

    /// Returns the incomplete output. The caller truncates it to its [complete bytes](Self::whole_bytes).
    pub fn abandon(self) -> W {
        self.inner.into_inner().into_inner().out
    }

    fn checked<T>(&self, result: Result<T, McapError>) -> io::Result<T> {
        result.map_err(|error| self.counted.error(error))
    }
}

impl Counted {
    /// The error of the output, however the crate wraps it.
    fn error(&self, error: McapError) -> io::Error {
        match (self.failed.get(), error) {
            (_, McapError::Io(error)) => error,
            (Some(kind), _) => (*kind).into(),
            (None, error) => io::Error::other(error),
        }
    }
}

/// Completes a recording that was truncated to its complete bytes, without an index: readers read it from the
/// start.
///
/// # Errors
/// When the output cannot be written.
pub fn end(out: &mut impl Write) -> io::Result<()> {
    // A data end without a checksum, then a footer without a summary: each has its code, its length and
    // zeros.
    let mut bytes = vec![mcap::records::op::DATA_END];
    bytes.extend(4_u64.to_le_bytes());
    bytes.extend([0; 4]);
    bytes.push(mcap::records::op::FOOTER);
    bytes.extend(20_u64.to_le_bytes());
    bytes.extend([0; 20]);
    bytes.extend(MAGIC);
    out.write_all(&bytes)?;
    out.flush()
}
