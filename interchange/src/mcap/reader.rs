use std::collections::{BTreeMap, HashMap};
use std::io::{self, Read, Seek};

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError, McapResult, parse_record};

use super::Channel;
use super::salvage::Whole;

/// Maximum size of a record or chunk \[bytes\]; recordings of this project have smaller ones.
pub(super) const RECORD_MAX: usize = 64 << 20;

/// Why a recording cannot be read, or not completely.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// An error of the input.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file has no bytes.
    #[error("the file is empty")]
    Empty,
    /// The file does not begin as an MCAP file.
    #[error("this is not an MCAP file")]
    Foreign,
    /// The file is truncated; everything before was read.
    #[error("the recording is truncated: it ends within a record")]
    Cut,
    /// Chunks have an unsupported compression.
    #[error(
        "its chunks are compressed with {0}: convert it with `mcap compress --compression lz4`"
    )]
    Compressed(String),
    /// A record is invalid.
    #[error("the recording is damaged: {}", cause(.0))]
    Damaged(McapError),
}

/// The decoder calls every failed decompression "I/O error from writing, or reading a compression stream".
fn cause(error: &McapError) -> String {
    match error {
        McapError::Io(error) => error.to_string(),
        error => error.to_string(),
    }
}

/// Content of a recording, in the order of the file.
#[derive(Debug)]
pub enum Item<'a> {
    /// A message of a channel.
    Message(Message<'a>),
    /// An attached file.
    Attachment {
        /// Name of the file.
        name: String,
        /// Media type, such as `application/toml`.
        media_type: String,
        /// Time since 1970 \[ns\].
        time_ns: u64,
        /// Content of the file.
        data: Vec<u8>,
    },
    /// Named values.
    Metadata {
        /// Name of the group of values.
        name: String,
        /// The values by name.
        values: BTreeMap<String, String>,
    },
}

/// A message of a channel.
#[derive(Debug, Clone, Copy)]
pub struct Message<'a> {
    /// Number of the channel in this file.
    pub channel_id: u16,
    /// Declaration of this channel.
    pub channel: &'a Channel,
    /// Sequence number in the channel.
    pub sequence: u32,
    /// Time of recording since 1970 \[ns\].
    pub log_ns: u64,
    /// Time of sending since 1970 \[ns\].
    pub publish_ns: u64,
    /// Encoded content.
    pub data: &'a [u8],
}

/// Reads a recording from start to end, with one chunk in memory.
pub struct Reader<R> {
    input: R,
    events: LinearReader,
    /// Data of the newest message.
    data: Vec<u8>,
    ended: bool,
    schemas: HashMap<u16, (String, String)>,
    channels: HashMap<u16, Channel>,
}

/// An item without borrowed data.
enum OwnedItem {
    Message(mcap::records::MessageHeader),
    Item(Item<'static>),
}

impl<R: Read> Reader<R> {
    /// Starts reading.
    ///
    /// # Errors
    /// When the input is not a recording.
    pub fn new(mut input: R) -> Result<Self, ReadError> {
        let mut magic = Vec::new();
        let mut first = input.by_ref().take(MAGIC.len() as u64);
        first.read_to_end(&mut magic)?;
        if magic.is_empty() {
            return Err(ReadError::Empty);
        }
        if magic != MAGIC {
            return Err(ReadError::Foreign);
        }
        Ok(Self {
            input,
            events: LinearReader::new_with_options(options()),
            data: Vec::new(),
            ended: false,
            schemas: HashMap::new(),
            channels: HashMap::new(),
        })
    }

    /// The next item; `None` at the end, and after an error.
    ///
    /// # Errors
    /// When the input cannot be read, or is invalid from here on.
    pub fn next_item(&mut self) -> Result<Option<Item<'_>>, ReadError> {
        let found = self.find();
        self.ended |= !matches!(found, Ok(Some(_)));
        Ok(match found? {
            None => None,
            Some(OwnedItem::Item(item)) => Some(item),
            Some(OwnedItem::Message(header)) => {
                let unknown = || McapError::UnknownChannel(header.sequence, header.channel_id);
                let channel = self.channels.get(&header.channel_id);
                Some(Item::Message(Message {
                    channel_id: header.channel_id,
                    channel: channel.ok_or_else(|| ReadError::Damaged(unknown()))?,
                    sequence: header.sequence,
                    log_ns: header.log_time,
                    publish_ns: header.publish_time,
                    data: &self.data,
                }))
            }
        })
    }

    fn find(&mut self) -> Result<Option<OwnedItem>, ReadError> {
        while !self.ended {
            let (opcode, data) = match self.events.next_event() {
                None => break,
                Some(Ok(LinearReadEvent::ReadRequest(count))) => {
                    let buffer = self.events.insert(count);
                    let count = self.input.read(buffer)?;
                    self.events.notify_read(count);
                    continue;
                }
                Some(Ok(LinearReadEvent::Record { data, opcode })) => (opcode, data),
                Some(Err(error)) => return Err(error.into()),
            };
            match parse(opcode, data)? {
                Record::Message { header, data } => {
                    self.data.clear();
                    self.data.extend_from_slice(&data);
                    return Ok(Some(OwnedItem::Message(header)));
                }
                Record::Schema { header, data } => {
                    let text = String::from_utf8_lossy(&data).into_owned();
                    self.schemas.insert(header.id, (header.name, text));
                }
                Record::Channel(channel) => {
                    let schema = self.schemas.get(&channel.schema_id);
                    let (schema, text) = schema.cloned().unwrap_or_default();
                    let known = Channel {
                        topic: channel.topic,
                        schema,
                        text,
                        metadata: channel.metadata,
                    };
                    self.channels.insert(channel.id, known);
                }
                Record::Attachment { header, data, .. } => {
                    return Ok(Some(OwnedItem::Item(Item::Attachment {
                        name: header.name,
                        media_type: header.media_type,
                        time_ns: header.log_time,
                        data: data.into_owned(),
                    })));
                }
                Record::Metadata(metadata) => {
                    return Ok(Some(OwnedItem::Item(Item::Metadata {
                        name: metadata.name,
                        values: metadata.metadata,
                    })));
                }
                // Only the index follows.
                Record::DataEnd(_) => break,
                _ => {}
            }
        }
        Ok(None)
    }
}

impl<R: Read + Seek> Reader<Whole<R>> {
    /// Starts reading everything that is whole of a damaged recording.
    ///
    /// # Errors
    /// When the input is not a recording.
    pub fn around_damage(input: R) -> Result<Self, ReadError> {
        let mut reader = Self::new(Whole::new(input)?)?;
        // The index repeats the channels, which stand in the first chunk only.
        let summary = reader.input.summary.as_ref();
        let channels = summary.into_iter().flat_map(|summary| &summary.channels);
        reader.channels = channels
            .map(|(id, channel)| {
                let schema = channel.schema.as_ref();
                let text = schema.map(|schema| String::from_utf8_lossy(&schema.data).into_owned());
                let known = Channel {
                    topic: channel.topic.clone(),
                    schema: schema.map(|schema| schema.name.clone()).unwrap_or_default(),
                    text: text.unwrap_or_default(),
                    metadata: channel.metadata.clone(),
                };
                (*id, known)
            })
            .collect();
        Ok(reader)
    }

    /// The input, which knows what was lost.
    pub fn whole(&self) -> &Whole<R> {
        &self.input
    }
}

/// Records are read from the first one on; no data of a damaged chunk is returned.
pub(super) fn options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(RECORD_MAX)
}

pub(super) fn parse(opcode: u8, body: &[u8]) -> McapResult<Record<'_>> {
    // The crate panics at an attachment that is shorter than its head and its checksum.
    if opcode == op::ATTACHMENT && !has_attachment_head(body) {
        return Err(McapError::UnexpectedEof);
    }
    parse_record(opcode, body)
}

/// Two times, two names and the length of the data, before data and checksum.
fn has_attachment_head(body: &[u8]) -> bool {
    let after_text = |at: usize| {
        let length = body.get(at..)?.first_chunk()?;
        Some(at + 4 + u32::from_le_bytes(*length) as usize)
    };
    let head = after_text(16).and_then(after_text);
    head.is_some_and(|end| end + 8 + 4 <= body.len())
}

impl From<McapError> for ReadError {
    fn from(error: McapError) -> Self {
        match error {
            // Reported by the decoder, also for a chunk that cannot be decompressed.
            McapError::UnexpectedEof => Self::Cut,
            McapError::UnsupportedCompression(name) => Self::Compressed(name),
            error => Self::Damaged(error),
        }
    }
}
