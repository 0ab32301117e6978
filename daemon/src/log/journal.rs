//! Lines with their fields for the system journal, in its own protocol: one datagram for each.
//!
//! A stalled journal blocks its senders once its socket is full. So the datagrams pass through a bounded
//! queue like that for the standard error, and only a separate thread waits.

use std::fmt::Debug;
use std::io::{Result, Write};
use std::os::unix::net::UnixDatagram;

use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;

use super::standard_error::{LINES_QUEUED_MAX, Text, TextGuard};

/// Socket of the journal.
const SOCKET: &str = "/run/systemd/journal/socket";
/// Prefix of the names of our fields.
const PREFIX: &str = "CDCR_";
const IDENTIFIER: &str = "cdcrd";

/// Sends events to the journal, with one field for each of theirs.
#[derive(Debug)]
pub(super) struct Journal {
    entries: Text,
}

impl Journal {
    /// Fails if there is no journal. A stalled journal still accepts the connection.
    pub(super) fn new() -> Result<(Self, TextGuard)> {
        UnixDatagram::unbound()?.connect(SOCKET)?;
        // Not connected: a restarted journal has a new socket.
        let socket = UnixDatagram::unbound()?;
        let (entries, guard) = Text::onto(Socket(socket), LINES_QUEUED_MAX, "cdcr-journal", lost);
        Ok((Self { entries }, guard))
    }
}

impl<S: Subscriber> Layer<S> for Journal {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let metadata = event.metadata();
        let mut entry = Entry::new(*metadata.level());
        entry.put("TARGET", metadata.target());
        if let (Some(file), Some(line)) = (metadata.file(), metadata.line()) {
            entry.put("CODE_FILE", file);
            entry.put("CODE_LINE", &line.to_string());
        }
        event.record(&mut entry);
        // Cannot fail: lost entries are counted.
        let _ = self.entries.clone().write_all(&entry.0);
    }
}

/// The entry about lines that the journal did not accept.
fn lost(lines: usize) -> Vec<u8> {
    let mut entry = Entry::new(Level::WARN);
    entry.put(
        "MESSAGE",
        &format!("lost {lines} log lines so far: the journal accepts none"),
    );
    entry.put("CDCR_LOST", &lines.to_string());
    entry.0
}

/// One entry in the journal's protocol.
struct Entry(Vec<u8>);

impl Entry {
    fn new(level: Level) -> Self {
        let mut entry = Self(Vec::with_capacity(512));
        entry.put(
            "PRIORITY",
            match level {
                Level::ERROR => "3",
                Level::WARN => "4",
                Level::INFO => "6",
                Level::DEBUG | Level::TRACE => "7",
            },
        );
        entry.put("SYSLOG_IDENTIFIER", IDENTIFIER);
        entry
    }

    /// A field with arbitrary content: name, length, value.
    fn put(&mut self, name: &str, value: &str) {
        self.0.extend_from_slice(name.as_bytes());
        self.0.push(b'\n');
        self.0
            .extend_from_slice(&(value.len() as u64).to_le_bytes());
        self.0.extend_from_slice(value.as_bytes());
        self.0.push(b'\n');
    }
}

impl Visit for Entry {
    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            "message" => self.put("MESSAGE", value),
            // The journal accepts capitals, digits and underscores.
            name => {
                let name = name.replace('.', "_").to_ascii_uppercase();
                self.put(&format!("{PREFIX}{name}"), value);
            }
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.record_str(field, &format!("{value:?}"));
    }
}

/// The socket to the journal. A datagram is accepted whole or not at all.
struct Socket(UnixDatagram);

impl Write for Socket {
    fn write(&mut self, entry: &[u8]) -> Result<usize> {
        self.0.send_to(entry, SOCKET)
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}
