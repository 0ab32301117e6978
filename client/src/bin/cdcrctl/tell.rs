//! Messages and progress for the user on standard error, written by a thread of their own.
//!
//! Invariant: no other thread writes there. A write blocks while nobody reads the terminal (Ctrl-S, a full pipe); a feed
//! or a driver goes on meanwhile, and an interrupt ends the program.

use std::collections::VecDeque;
use std::io::{Write as _, stderr, stdout};
use std::sync::{Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use crate::interrupt::Interrupt;
use crate::keys;

// Prints a line to standard error. If it is closed, the work continues; `eprintln!` would panic.
macro_rules! tell {
    ($($text:tt)*) => { $crate::tell::line(format!($($text)*)) };
}

/// Longest wait for the thread, so that the lines of both streams keep their order on a terminal.
const ORDER: Duration = Duration::from_millis(50);
/// Time after which an interrupted program ends without the rest of its messages, if nobody reads them.
pub(crate) const UNREAD: Duration = Duration::from_secs(1);
/// Number of lines kept for a terminal that is not read. The oldest are discarded.
const LINES_MAX: usize = 1000;
/// Interval of the checks whether standard output takes the results.
const OUTPUT_CHECK: Duration = Duration::from_millis(5);
/// Terminal sequence that removes the line of the cursor.
const REMOVE_LINE: &str = "\r\x1b[2K";

static WAITING: Mutex<Waiting> = Mutex::new(Waiting {
    lines: VecDeque::new(),
    bar: None,
    is_writing: false,
    is_stuck: false,
});
static CHANGED: Condvar = Condvar::new();
/// Whether the thread could be started.
static STARTED: OnceLock<bool> = OnceLock::new();

/// What is not written yet.
#[derive(Debug)]
struct Waiting {
    lines: VecDeque<String>,
    /// The newest picture of the progress, empty to remove it.
    bar: Option<String>,
    /// The thread writes what it has taken from here.
    is_writing: bool,
    /// A wait for the thread was in vain since it last wrote everything.
    is_stuck: bool,
}

impl Waiting {
    /// No holder of the lock waits for anything.
    fn lock() -> MutexGuard<'static, Self> {
        WAITING.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn has_some(&self) -> bool {
        !self.lines.is_empty() || self.bar.is_some()
    }

    fn is_written(&self) -> bool {
        !self.is_writing && !self.has_some()
    }

    fn wait_until_written() -> MutexGuard<'static, Self> {
        let waited = CHANGED.wait_timeout_while(Self::lock(), ORDER, |it| !it.is_written());
        waited.unwrap_or_else(PoisonError::into_inner).0
    }
}

/// Prints a line, before the next one on standard output if the terminal is read.
pub(crate) fn line(text: String) {
    later(text);
    keep_order();
}

/// Prints a line and waits for nothing: for the loop of a driver.
pub(crate) fn later(text: String) {
    if !has_thread() {
        drop(writeln!(stderr(), "{text}"));
        return;
    }
    let mut waiting = Waiting::lock();
    if waiting.lines.len() == LINES_MAX {
        waiting.lines.pop_front();
    }
    waiting.lines.push_back(text);
    drop(waiting);
    CHANGED.notify_all();
}

/// Shows a picture of the progress in the last line of the terminal, instead of the one before; none if it is empty.
pub(crate) fn show_bar(picture: String) {
    if has_thread() {
        Waiting::lock().bar = Some(picture);
        CHANGED.notify_all();
    }
}

/// Waits for the thread, at most [`ORDER`], and not again while it hangs.
pub(crate) fn keep_order() {
    if !Waiting::lock().is_stuck {
        let mut waiting = Waiting::wait_until_written();
        waiting.is_stuck = !waiting.is_written();
    }
}

/// Waits until everything is written. After an interrupt it ends also while nobody reads the messages.
pub(crate) fn finish() {
    let mut unread = Unread::default();
    while !Waiting::wait_until_written().is_written() {
        if unread.is_over(keys::takes_output(&stderr())) && Interrupt::was_raised() {
            return;
        }
    }
}

/// Waits until standard output takes the results. `false`: nobody reads it, and an interrupt has ended the program.
pub(crate) fn results_are_read() -> bool {
    let mut unread = Unread::default();
    while !keys::takes_output(&stdout()) {
        if unread.is_over(false) && Interrupt::was_raised() {
            return false;
        }
        thread::sleep(OUTPUT_CHECK);
    }
    true
}

/// How long nobody has read a terminal. A thread that the machine delays is not taken for one that hangs.
#[derive(Debug, Default)]
pub(crate) struct Unread {
    since: Option<Instant>,
}

impl Unread {
    /// Whether the terminal has taken no output for [`UNREAD`].
    pub(crate) fn is_over(&mut self, takes_output: bool) -> bool {
        if takes_output {
            self.since = None;
            return false;
        }
        self.since.get_or_insert_with(Instant::now).elapsed() > UNREAD
    }
}

fn has_thread() -> bool {
    *STARTED.get_or_init(|| {
        let thread = thread::Builder::new().name("cdcrctl-tell".to_owned());
        thread.spawn(write_on).is_ok()
    })
}

/// Writes all lines and the newest picture, without end.
fn write_on() {
    let mut shown = String::new();
    loop {
        let idle = CHANGED.wait_while(Waiting::lock(), |waiting| !waiting.has_some());
        let mut waiting = idle.unwrap_or_else(PoisonError::into_inner);
        let (lines, bar) = (core::mem::take(&mut waiting.lines), waiting.bar.take());
        waiting.is_writing = true;
        drop(waiting);
        let text = text_of(&lines, bar, &mut shown);
        drop(stderr().write_all(text.as_bytes()));
        let mut waiting = Waiting::lock();
        waiting.is_writing = false;
        waiting.is_stuck &= waiting.has_some();
        drop(waiting);
        CHANGED.notify_all();
    }
}

/// Lines above the picture of the progress that is `shown`, or above the new one.
fn text_of(lines: &VecDeque<String>, bar: Option<String>, shown: &mut String) -> String {
    let mut text = String::new();
    if !shown.is_empty() {
        text += REMOVE_LINE;
    }
    for line in lines {
        text += line;
        text.push('\n');
    }
    if let Some(bar) = bar {
        *shown = bar;
    }
    text + &*shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_above_the_progress_which_stays() {
        let mut shown = String::new();
        let lines = |lines: &[&str]| lines.iter().map(|&line| line.to_owned()).collect();
        let mut text = |some: &[&str], bar: Option<&str>| {
            text_of(&lines(some), bar.map(str::to_owned), &mut shown)
        };
        assert_eq!(text(&["a"], None), "a\n");
        assert_eq!(text(&[], Some("=> 1")), "=> 1");
        assert_eq!(text(&["b", "c"], None), "\r\x1b[2Kb\nc\n=> 1");
        assert_eq!(text(&["d"], Some("=> 2")), "\r\x1b[2Kd\n=> 2");
        assert_eq!(text(&[], Some("")), "\r\x1b[2K");
        assert_eq!(text(&["e"], None), "e\n");
    }
}
