//! Text for the standard error, written by a thread of its own.
//!
//! Whoever holds the other end may stop reading: a terminal after Ctrl-S, a full pipe. Then that thread waits,
//! and nobody else. At most [`LINES_QUEUED_MAX`] lines wait with it; what is lost is counted and said.

use std::io::{Result, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;
use std::time::Duration;

use tracing_appender::non_blocking::{ErrorCounter, NonBlocking, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::fmt::MakeWriter;

/// Lines that may wait: far more than an end or a start writes, and less than a megabyte.
pub(super) const LINES_QUEUED_MAX: usize = 4096;
/// How long the end waits for a reader.
const END_MAX: Duration = Duration::from_secs(2);

/// Takes text at once, and writes it when somebody reads.
#[derive(Debug, Clone)]
pub(super) struct Text {
    queue: NonBlocking,
    lost: ErrorCounter,
    lost_said: Arc<AtomicUsize>,
}

/// Writes what waits when it is ended.
#[derive(Debug)]
pub(super) struct TextGuard(WorkerGuard);

impl Text {
    /// The standard error.
    pub(super) fn new() -> (Self, TextGuard) {
        Self::onto(std::io::stderr(), LINES_QUEUED_MAX)
    }

    fn onto(writer: impl Write + Send + 'static, lines_max: usize) -> (Self, TextGuard) {
        let (queue, guard) = NonBlockingBuilder::default()
            .lossy(true)
            .buffered_lines_limit(lines_max)
            .thread_name("cdcr-log")
            .finish(writer);
        let text = Self {
            lost: queue.error_counter(),
            lost_said: Arc::default(),
            queue,
        };
        (text, TextGuard(guard))
    }
}

impl Write for Text {
    fn write(&mut self, line: &[u8]) -> Result<usize> {
        let lost = self.lost.dropped_lines();
        if lost == self.lost_said.load(Ordering::Relaxed) {
            return self.queue.write(line);
        }
        let mut both =
            format!("cdcrd: {lost} lines so far were lost: nobody read the standard error\n")
                .into_bytes();
        both.extend_from_slice(line);
        self.queue.write_all(&both)?;
        // Otherwise it was lost as well, and the next line says so.
        if self.lost.dropped_lines() == lost {
            self.lost_said.store(lost, Ordering::Relaxed);
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

impl<'a> MakeWriter<'a> for Text {
    type Writer = Self;

    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}

impl TextGuard {
    /// Writes what waits, as far as somebody reads it. Takes [`END_MAX`] at most.
    pub(super) fn end(self) {
        let (alive, ended) = channel::<()>();
        // Letting the guard go may itself write, and wait for a reader of the standard output.
        let thread = std::thread::Builder::new().spawn(move || {
            drop(self.0);
            drop(alive);
        });
        if thread.is_ok() {
            let _ = ended.recv_timeout(END_MAX);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(
        clippy::unwrap_used,
        reason = "in a test a panic is the report, in its helpers, too"
    )]

    use std::sync::Mutex;
    use std::sync::mpsc::Receiver;
    use std::time::Instant;

    use super::*;

    const PATIENCE: Duration = Duration::from_secs(30);

    /// Nobody reads it until the other end of the channel goes.
    struct Unread {
        shut: Receiver<()>,
        text: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Unread {
        fn write(&mut self, bytes: &[u8]) -> Result<usize> {
            let _ = self.shut.recv();
            self.text.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    fn unread() -> (Unread, std::sync::mpsc::Sender<()>, Arc<Mutex<Vec<u8>>>) {
        let (open, shut) = channel();
        let text = Arc::<Mutex<Vec<u8>>>::default();
        let writer = Unread {
            shut,
            text: Arc::clone(&text),
        };
        (writer, open, text)
    }

    /// A line comes as a whole, as from the log.
    fn put(text: &mut Text, line: &str) {
        text.write_all(format!("{line}\n").as_bytes()).unwrap();
    }

    #[test]
    fn what_nobody_reads_is_lost_and_counted_and_said() {
        const LINES: usize = 100;
        const LINES_MAX: usize = 8;
        let (writer, open, written) = unread();
        let (mut text, guard) = Text::onto(writer, LINES_MAX);
        for line in 0..LINES {
            put(&mut text, &format!("line {line}"));
        }
        // One more may be in the hands of the thread that waits.
        let lost = text.lost.dropped_lines();
        assert!(lost >= LINES - LINES_MAX - 1, "{lost}");
        drop(open);
        let read = || String::from_utf8(written.lock().unwrap().clone()).unwrap();
        let begin = Instant::now();
        while read().matches("line ").count() < LINES - lost {
            assert!(begin.elapsed() < PATIENCE, "never written: {}", read());
            std::thread::sleep(Duration::from_millis(1));
        }
        put(&mut text, "after");
        put(&mut text, "last");
        guard.end();
        let (first, end) = read()
            .split_once("cdcrd: ")
            .map(|(a, b)| (a.to_owned(), b.to_owned()))
            .unwrap();
        assert_eq!(first.lines().count() + lost, LINES);
        let said =
            format!("{lost} lines so far were lost: nobody read the standard error\nafter\nlast\n");
        assert_eq!(end, said, "it is said once");
    }

    #[test]
    fn the_end_does_not_wait_for_ever() {
        let (writer, open, _) = unread();
        let (mut text, guard) = Text::onto(writer, 1);
        for _ in 0..10 {
            put(&mut text, "a line");
        }
        // It comes back at all: nobody ever reads.
        guard.end();
        drop(open);
    }
}
