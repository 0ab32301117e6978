//! Text for the standard error, or entries for the journal, written by a separate thread.
//!
//! The reader may stop: a terminal after Ctrl-S, a full pipe, a stalled journal. Then only that thread waits.
//! At most [`LINES_QUEUED_MAX`] lines wait with it; lost lines are counted and reported.

use std::io::{Result, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::time::Duration;

use tracing_subscriber::fmt::MakeWriter;

/// Lines that may wait: far more than a start or an end writes, and less than a megabyte.
pub(super) const LINES_QUEUED_MAX: usize = 4096;
/// The thread only writes bytes. With locked memory its whole stack is resident.
const STACK_BYTES: usize = 256 * 1024;
/// Longest wait for a reader at the end.
const END_MAX: Duration = Duration::from_secs(2);

/// Accepts text without waiting, and writes it when the reader accepts it.
#[derive(Debug, Clone)]
pub(super) struct Text {
    queue: SyncSender<Vec<u8>>,
    counts: Arc<Counts>,
    /// The line that reports the number of lost lines.
    loss: fn(usize) -> Vec<u8>,
}

#[derive(Debug, Default)]
struct Counts {
    lost: AtomicUsize,
    /// Number of lost lines reported so far.
    reported: AtomicUsize,
    ending: AtomicBool,
}

/// Writes the waiting lines at the end.
#[derive(Debug)]
pub(super) struct TextGuard {
    text: Text,
    /// Closed when the thread has ended.
    ended: Receiver<()>,
}

impl Text {
    pub(super) fn new() -> (Self, TextGuard) {
        Self::onto(std::io::stderr(), LINES_QUEUED_MAX, "cdcr-log", lost_text)
    }

    /// A queue with a thread named `thread` that writes its lines. `loss` is the line that reports lost
    /// lines.
    pub(super) fn onto(
        writer: impl Write + Send + 'static,
        lines_max: usize,
        thread: &str,
        loss: fn(usize) -> Vec<u8>,
    ) -> (Self, TextGuard) {
        let (queue, lines) = sync_channel(lines_max);
        let (alive, ended) = channel();
        let text = Self {
            queue,
            counts: Arc::default(),
            loss,
        };
        let counts = Arc::clone(&text.counts);
        // Without the thread every line is lost, and counted.
        let _ = std::thread::Builder::new()
            .name(thread.to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || write_all(&lines, writer, &counts, alive));
        let guard = TextGuard {
            text: text.clone(),
            ended,
        };
        (text, guard)
    }

    fn lost(&self) -> usize {
        self.counts.lost.load(Ordering::Relaxed)
    }

    fn put(&self, line: Vec<u8>) {
        if self.queue.try_send(line).is_err() {
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

fn lost_text(lines: usize) -> Vec<u8> {
    format!("cdcrd: lost {lines} log lines so far: the standard error is not read\n").into_bytes()
}

/// Writes lines until the log ends and none is left.
fn write_all(
    lines: &Receiver<Vec<u8>>,
    mut writer: impl Write,
    counts: &Counts,
    alive: Sender<()>,
) {
    while let Ok(line) = lines.recv() {
        // A failed write cannot be reported.
        let _ = writer.write_all(&line);
        if counts.ending.load(Ordering::Acquire) {
            for line in lines.try_iter() {
                let _ = writer.write_all(&line);
            }
            break;
        }
    }
    drop(alive);
}

impl Write for Text {
    fn write(&mut self, line: &[u8]) -> Result<usize> {
        let lost = self.lost();
        // If the queue is full, the line is lost, too, and a later line reports the loss.
        if lost != self.counts.reported.load(Ordering::Relaxed)
            && self.queue.try_send((self.loss)(lost)).is_ok()
        {
            self.counts.reported.store(lost, Ordering::Relaxed);
        }
        self.put(line.to_vec());
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
    /// Writes the waiting lines, as far as the reader accepts them. Takes [`END_MAX`] at most.
    pub(super) fn end(self) {
        self.text.counts.ending.store(true, Ordering::Release);
        // Wakes the thread. A full queue needs no wake-up.
        let _ = self.text.queue.try_send(Vec::new());
        let _ = self.ended.recv_timeout(END_MAX);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::time::Instant;

    use super::*;

    const TIMEOUT: Duration = Duration::from_secs(30);

    /// A writer that blocks until the other end of the channel is dropped.
    struct Unread {
        taken: Sender<()>,
        shut: Receiver<()>,
        text: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Unread {
        fn write(&mut self, bytes: &[u8]) -> Result<usize> {
            let _ = self.taken.send(());
            let _ = self.shut.recv();
            self.text.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    type Written = Arc<Mutex<Vec<u8>>>;

    /// Returned with it: a signal for each accepted line, the end that unblocks the writer, and the written
    /// text.
    fn unread() -> (Unread, Receiver<()>, Sender<()>, Written) {
        let ((open, shut), (taken, takes)) = (channel(), channel());
        let text = Written::default();
        let writer = Unread {
            taken,
            shut,
            text: Arc::clone(&text),
        };
        (writer, takes, open, text)
    }

    /// Writes a line as a whole, as the log does.
    fn put(text: &mut Text, line: &str) {
        text.write_all(format!("{line}\n").as_bytes()).unwrap();
    }

    #[test]
    fn what_nobody_reads_is_lost_and_counted_and_reported() {
        const LINES: usize = 100;
        const LINES_MAX: usize = 8;
        let (writer, takes, open, written) = unread();
        let (mut text, guard) = Text::onto(writer, LINES_MAX, "test", lost_text);
        put(&mut text, "line 0");
        // The thread already holds this line and waits. If it took the line later, the queue would have
        // space, and a first loss would be reported.
        takes.recv_timeout(TIMEOUT).unwrap();
        for line in 1..LINES {
            put(&mut text, &format!("line {line}"));
        }
        let lost = text.lost();
        assert_eq!(lost, LINES - LINES_MAX - 1);
        drop(open);
        let read = || String::from_utf8(written.lock().unwrap().clone()).unwrap();
        let begin = Instant::now();
        while read().matches("line ").count() < LINES - lost {
            assert!(begin.elapsed() < TIMEOUT, "never written: {}", read());
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
        let reported =
            format!("lost {lost} log lines so far: the standard error is not read\nafter\nlast\n");
        assert_eq!(end, reported, "it is reported once");
    }

    #[test]
    fn the_end_does_not_wait_for_ever() {
        let (writer, _, open, _) = unread();
        let (mut text, guard) = Text::onto(writer, 1, "test", lost_text);
        for _ in 0..10 {
            put(&mut text, "a line");
        }
        // Returns although there is never a reader.
        guard.end();
        drop(open);
    }
}
