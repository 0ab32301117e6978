use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use mcap::records::{Record, Statistics, op};
use mcap::sans_io::{
    LinearReadEvent, LinearReader, SummaryReadEvent, SummaryReader, SummaryReaderOptions,
};
use mcap::{MAGIC, McapError, McapResult, Summary};

use super::reader::{RECORD_MAX, options, parse};

/// Opcode and length of a record.
const HEAD: u64 = 9;
/// Bytes searched at once.
const WINDOW: u64 = 64 * 1024;

/// A lost part of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Loss {
    /// Its place in the file.
    pub bytes: Range<u64>,
    /// Times since 1970 \[ns\] of the messages before and after it, where they are known.
    pub time_ns: [Option<u64>; 2],
    /// Names of the attachments in it, where the index of the file is readable.
    pub attachments: Vec<String>,
}

/// The whole records of a recording, without its damaged parts: input of a [`Reader`](super::Reader).
///
/// A chunk or an attachment is whole if its checksum is right; another record, if it can be parsed and one more
/// follows. After a damage, the next whole record is searched byte by byte. One record is in memory.
#[derive(Debug)]
pub struct Whole<R> {
    input: R,
    length: u64,
    /// Place of the next record.
    at: u64,
    record: Vec<u8>,
    /// Bytes of the record that were read.
    given: usize,
    ended: bool,
    /// Times of the first message, and of the last one so far.
    first_ns: Option<u64>,
    last_ns: Option<u64>,
    losses: Vec<Loss>,
    /// The index at the end of the file.
    pub(super) summary: Option<Summary>,
}

impl<R: Read + Seek> Whole<R> {
    pub(super) fn new(mut input: R) -> io::Result<Self> {
        let length = input.seek(SeekFrom::End(0))?;
        let summary = summary(&mut input, length)?;
        input.rewind()?;
        let mut magic = Vec::new();
        input
            .by_ref()
            .take(MAGIC.len() as u64)
            .read_to_end(&mut magic)?;
        let statistics = summary.as_ref().and_then(|summary| summary.stats.as_ref());
        let first_ns = statistics.map(|statistics| statistics.message_start_time);
        Ok(Self {
            input,
            length,
            at: magic.len() as u64,
            record: magic,
            given: 0,
            ended: false,
            first_ns,
            last_ns: None,
            losses: Vec::new(),
            summary,
        })
    }

    /// The parts lost so far.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// Time of the first message since 1970 \[ns\].
    pub fn first_ns(&self) -> Option<u64> {
        self.first_ns
    }

    /// Number of messages of the recording before the damage, where its index is readable.
    pub fn message_count(&self) -> Option<u64> {
        Some(self.statistics()?.message_count)
    }

    /// Reads the next whole record.
    fn advance(&mut self) -> io::Result<()> {
        let begin = self.at;
        let found = loop {
            if self.load(self.at)? {
                break true;
            }
            match self.candidate()? {
                Some(at) => self.at = at,
                None => break false,
            }
        };
        if !found {
            self.at = self.length;
            self.record.clear();
        }
        if begin < self.at {
            self.note_loss(begin..self.at);
        }
        if let Some([start_ns, end_ns]) = chunk_times(&self.record) {
            self.first_ns.get_or_insert(start_ns);
            self.end_losses(start_ns);
            self.last_ns = self.last_ns.max(Some(end_ns));
        }
        self.ended = !found || self.record.first() == Some(&op::DATA_END);
        if self.ended
            && let Some(statistics) = self.statistics()
        {
            self.end_losses(statistics.message_end_time);
        }
        self.at += self.record.len() as u64;
        self.given = 0;
        Ok(())
    }

    fn note_loss(&mut self, bytes: Range<u64>) {
        let indexes = self.summary.iter();
        let indexes = indexes.flat_map(|summary| &summary.attachment_indexes);
        let lost = indexes.filter(|index| bytes.contains(&index.offset));
        let attachments = lost.map(|index| index.name.clone()).collect();
        self.losses.push(Loss {
            bytes,
            time_ns: [self.last_ns.or(self.first_ns), None],
            attachments,
        });
    }

    /// Sets the time of the first message after the newest losses.
    fn end_losses(&mut self, next_ns: u64) {
        let ends = self
            .losses
            .iter_mut()
            .rev()
            .map(|loss| &mut loss.time_ns[1]);
        ends.take_while(|end_ns| end_ns.is_none())
            .for_each(|end_ns| *end_ns = Some(next_ns));
    }

    fn statistics(&self) -> Option<&Statistics> {
        self.summary.as_ref()?.stats.as_ref()
    }

    /// Reads the record at a place; false if there is no whole one.
    fn load(&mut self, at: u64) -> io::Result<bool> {
        let head = self.read_at(at, HEAD)?;
        let Some(length) = record_length(&head, self.length - at) else {
            return Ok(false);
        };
        self.record = self.read_at(at, length)?;
        if self.record.len() as u64 != length || !is_whole(&self.record) {
            return Ok(false);
        }
        match self.record[0] {
            op::CHUNK | op::ATTACHMENT if !has_padding(&self.record) => return Ok(true),
            op::DATA_END => return Ok(length == HEAD + 4),
            _ => {}
        }
        let next = at + length;
        let head = self.read_at(next, HEAD)?;
        let rest = self.length - next;
        // Of a killed recorder's file the next one may be incomplete.
        Ok(rest < HEAD || record_length(&head, u64::MAX).is_some())
    }

    /// The next place at which a record may begin.
    fn candidate(&mut self) -> io::Result<Option<u64>> {
        const KINDS: [u8; 4] = [op::CHUNK, op::ATTACHMENT, op::METADATA, op::DATA_END];
        let mut from = self.at + 1;
        while from + HEAD <= self.length {
            let bytes = self.read_at(from, WINDOW + HEAD - 1)?;
            let heads = bytes.windows(HEAD as usize).zip(from..);
            let mut places = heads.filter(|(head, at)| {
                KINDS.contains(&head[0]) && record_length(head, self.length - at).is_some()
            });
            if let Some((_, at)) = places.next() {
                return Ok(Some(at));
            }
            from += WINDOW;
        }
        Ok(None)
    }

    /// Fewer bytes at the end of the file.
    fn read_at(&mut self, at: u64, count: u64) -> io::Result<Vec<u8>> {
        self.input.seek(SeekFrom::Start(at))?;
        let mut bytes = Vec::new();
        self.input.by_ref().take(count).read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

impl<R: Read + Seek> Read for Whole<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.given == self.record.len() && !self.ended {
            self.advance()?;
        }
        let rest = &self.record[self.given..];
        let count = rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&rest[..count]);
        self.given += count;
        Ok(count)
    }
}

/// Length of a record with its head, if it is one of a data section and has at most `room` bytes.
fn record_length(head: &[u8], room: u64) -> Option<u64> {
    let (opcode, length) = head.split_first()?;
    let length = u64::from_le_bytes(length.try_into().ok()?);
    let is_known = matches!(
        *opcode,
        op::HEADER
            | op::SCHEMA
            | op::CHANNEL
            | op::MESSAGE
            | op::CHUNK
            | op::MESSAGE_INDEX
            | op::ATTACHMENT
            | op::METADATA
            | op::DATA_END
    );
    (is_known && length <= RECORD_MAX as u64 && HEAD + length <= room).then_some(HEAD + length)
}

/// Whether a record can be parsed, with a correct checksum if it has one.
fn is_whole(record: &[u8]) -> bool {
    let mut events = LinearReader::new_with_options(options().with_skip_end_magic(true));
    let mut rest = record;
    let parsed = (|| -> McapResult<()> {
        while let Some(event) = events.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(count) => {
                    let (next, later) = rest.split_at(count.min(rest.len()));
                    events.insert(count)[..next.len()].copy_from_slice(next);
                    events.notify_read(next.len());
                    rest = later;
                }
                LinearReadEvent::Record { data, opcode } => drop(parse(opcode, data)?),
            }
        }
        Ok(())
    })();
    // Reading reports an unsupported compression.
    matches!(&parsed, Ok(()))
        || matches!(&parsed, Err(McapError::UnsupportedCompression(name)) if name == "zstd")
}

/// Whether bytes follow the content of a chunk or an attachment, as after a wrong bit in its length.
fn has_padding(record: &[u8]) -> bool {
    let content = match record.split_at_checked(HEAD as usize) {
        Some((head, body)) => parse(head[0], body),
        None => return true,
    };
    let length = match content {
        Ok(Record::Chunk { header, data }) => {
            3 * 8 + 4 + 4 + header.compression.len() + 8 + data.len()
        }
        Ok(Record::Attachment { header, data, .. }) => {
            2 * 8 + 4 + header.name.len() + 4 + header.media_type.len() + 8 + data.len() + 4
        }
        _ => return true,
    };
    HEAD as usize + length < record.len()
}

/// Times of the first and the last message of a chunk \[ns\].
fn chunk_times(record: &[u8]) -> Option<[u64; 2]> {
    let (head, body) = record.split_at_checked(HEAD as usize)?;
    match parse(*head.first()?, body) {
        Ok(Record::Chunk { header, .. }) if header.message_end_time > 0 => {
            Some([header.message_start_time, header.message_end_time])
        }
        _ => None,
    }
}

/// The index of a file; `None` if it has none, or a damaged one.
fn summary(input: &mut (impl Read + Seek), length: u64) -> io::Result<Option<Summary>> {
    let options = SummaryReaderOptions::default()
        .with_file_size(length)
        .with_record_length_limit(RECORD_MAX);
    let mut events = SummaryReader::new_with_options(options);
    while let Some(event) = events.next_event() {
        match event {
            Ok(SummaryReadEvent::ReadRequest(count)) => {
                let count = input.read(events.insert(count))?;
                events.notify_read(count);
            }
            Ok(SummaryReadEvent::SeekRequest(place)) => match input.seek(place) {
                Ok(place) => events.notify_seeked(place),
                // Before the begin of the file.
                Err(_) => return Ok(None),
            },
            Err(_) => return Ok(None),
        }
    }
    Ok(events.finish())
}
