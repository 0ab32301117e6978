//! Destination and rate of the log.
//!
//! Under systemd the standard error is the journal (according to `JOURNAL_STREAM` of `systemd.exec(5)`), and
//! the lines go there with their fields: `reason` becomes `CDCR_REASON`. Otherwise they are text on the
//! standard error. Neither blocks a thread. The same line appears at most [`LINES_MAX`] times in
//! [`INTERVAL`]; suppressed lines are counted and reported. Counters in status and telemetry do not pass
//! through the log.

mod journal;
mod standard_error;

use std::backtrace::{Backtrace, BacktraceStatus};
use std::collections::HashMap;
use std::fmt::Arguments;
use std::io::{IsTerminal, Write};
use std::panic::PanicHookInfo;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use iceoryx2::prelude::{LogLevel, set_log_level, set_logger};
use iceoryx2_log::Log as ForeignLog;
use journal::Journal;
use rustix::fs::fstat;
use standard_error::{Text, TextGuard};
use tracing::callsite::Identifier;
use tracing::{Event, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{LevelFilter, ParseError, Targets};
use tracing_subscriber::layer::{Context, SubscriberExt};
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;

/// Lines that one place in the program may log within [`INTERVAL`].
pub const LINES_MAX: u32 = 20;
/// Time in which lines are counted.
pub const INTERVAL: Duration = Duration::from_secs(10);

/// The log of the process, until [`Log::end`].
#[derive(Debug)]
#[must_use]
pub struct Log {
    text: Text,
    guard: TextGuard,
    /// Of the journal, if the lines go there.
    journal: Option<TextGuard>,
}

impl Log {
    /// Sets up the log of the process. `RUST_LOG` is a level, or a list such as
    /// `info,cdcr_daemon::exchange=debug`; the default is `info` and above. Errors of iceoryx2 and panics in
    /// any thread are logged, too.
    pub fn start() -> Self {
        let (text, guard) = Text::new();
        let journal = start_lines(&text);
        set_logger(&Iceoryx2);
        set_log_level(LogLevel::Error);
        let panics = text.clone();
        std::panic::set_hook(Box::new(move |panic| write_line(&panics, &words(panic))));
        Self {
            text,
            guard,
            journal,
        }
    }

    /// Writes a message to the standard error; [`Log::end`] waits for it.
    pub fn write_line(&self, message: &str) {
        write_line(&self.text, message);
    }

    /// Writes the waiting lines for at most 2 s (and as long for the journal), because there may be no
    /// reader.
    pub fn end(self) {
        if let Some(journal) = self.journal {
            journal.end();
        }
        self.guard.end();
    }
}

fn start_lines(text: &Text) -> Option<TextGuard> {
    let (filter, misunderstood) = filter(std::env::var("RUST_LOG").ok().as_deref());
    let log = tracing_subscriber::registry()
        .with(filter)
        .with(RateLimit::new(LINES_MAX, INTERVAL));
    let stream = std::env::var("JOURNAL_STREAM").ok();
    let mut guard = None;
    if stream.is_some_and(|stream| is_standard_error(&stream)) {
        match Journal::new() {
            Ok((journal, ends)) => {
                log.with(journal).init();
                guard = Some(ends);
            }
            Err(error) => {
                log.with(lines(text)).init();
                tracing::warn!(%error, "cannot send fields to the journal: its socket is unusable");
            }
        }
    } else {
        log.with(lines(text)).init();
    }
    if let Some(error) = misunderstood {
        tracing::warn!(
            "ignored RUST_LOG: {error}; use a level (error, warn, info, debug, trace) or \
             target=level, separated by commas"
        );
    }
    guard
}

/// The filter in `RUST_LOG`, or the default with the error of an invalid one.
fn filter(rust_log: Option<&str>) -> (Targets, Option<ParseError>) {
    let default = Targets::new().with_default(LevelFilter::INFO);
    match rust_log
        .filter(|text| !text.trim().is_empty())
        .map(str::parse)
    {
        None => (default, None),
        Some(Ok(filter)) => (filter, None),
        Some(Err(error)) => (default, Some(error)),
    }
}

fn write_line(text: &Text, message: &str) {
    // Cannot fail: lost lines are counted.
    let _ = text
        .clone()
        .write_all(format!("cdcrd: {message}\n").as_bytes());
}

/// Text of a panic: thread, place, message; with a backtrace if `RUST_BACKTRACE` requests it.
fn words(panic: &PanicHookInfo<'_>) -> String {
    let thread = std::thread::current();
    let name = thread.name().unwrap_or("without a name");
    let backtrace = Backtrace::capture();
    if backtrace.status() == BacktraceStatus::Captured {
        format!("the thread {name} {panic}\n{backtrace}")
    } else {
        format!("the thread {name} {panic}")
    }
}

#[derive(Debug)]
struct Iceoryx2;

impl ForeignLog for Iceoryx2 {
    fn log(&self, level: LogLevel, origin: Arguments<'_>, message: Arguments<'_>) {
        // Only errors are passed on here.
        tracing::error!(?level, %origin, "iceoryx2: {message}");
    }
}

/// The standard error is the file `stream` (device:inode).
fn is_standard_error(stream: &str) -> bool {
    let Ok(file) = fstat(std::io::stderr()) else {
        return false;
    };
    device_and_inode(stream) == Some((file.st_dev, file.st_ino))
}

fn device_and_inode(stream: &str) -> Option<(u64, u64)> {
    let (device, inode) = stream.split_once(':')?;
    Some((device.parse().ok()?, inode.parse().ok()?))
}

fn lines<S: Subscriber + for<'a> LookupSpan<'a>>(text: &Text) -> impl Layer<S> + use<S> {
    tracing_subscriber::fmt::layer()
        .with_writer(text.clone())
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
}

/// Limits the lines of each place in the program, and reports the number of suppressed lines before the next
/// line that passes.
#[derive(Debug)]
struct RateLimit {
    limit: Limit,
    places: Mutex<HashMap<Identifier, CallSite>>,
}

#[derive(Debug, Clone, Copy)]
struct Limit {
    lines_max: u32,
    interval: Duration,
}

/// Lines of one place in the program in the current interval.
#[derive(Debug)]
struct CallSite {
    since: Instant,
    lines: u32,
    left_out: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Decision {
    Pass,
    /// Passes, as the first one after suppressed lines.
    PassAfter {
        left_out: u64,
    },
    LeaveOut,
}

impl RateLimit {
    fn new(lines_max: u32, interval: Duration) -> Self {
        Self {
            limit: Limit {
                lines_max,
                interval,
            },
            places: Mutex::default(),
        }
    }

    fn decide(&self, place: Identifier, now: Instant) -> Decision {
        // The counts are valid even if a thread panicked while it held them.
        let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        let place = places.entry(place).or_insert_with(|| CallSite::since(now));
        place.count(self.limit, now)
    }
}

impl CallSite {
    fn since(now: Instant) -> Self {
        Self {
            since: now,
            lines: 0,
            left_out: 0,
        }
    }

    fn count(&mut self, limit: Limit, now: Instant) -> Decision {
        let left_out = self.left_out;
        if now.duration_since(self.since) >= limit.interval {
            *self = Self::since(now);
        }
        if self.lines == limit.lines_max {
            self.left_out += 1;
            return Decision::LeaveOut;
        }
        self.lines += 1;
        if self.lines == 1 && left_out > 0 {
            Decision::PassAfter { left_out }
        } else {
            Decision::Pass
        }
    }
}

impl<S: Subscriber> Layer<S> for RateLimit {
    fn event_enabled(&self, event: &Event<'_>, _: Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if metadata.module_path() == Some(module_path!()) {
            return true;
        }
        let decision = self.decide(metadata.callsite(), Instant::now());
        if let Decision::PassAfter { left_out } = decision {
            // The lock is free again: this line passes through here, too.
            tracing::warn!(left_out, "suppressed {left_out} similar messages");
        }
        decision != Decision::LeaveOut
    }
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use tracing::Level;

    use super::*;

    #[test]
    fn rust_log_is_a_level_or_a_list_of_targets() {
        let enables = |rust_log, target, level| filter(rust_log).0.would_enable(target, &level);
        assert!(enables(None, "cdcr_daemon", Level::INFO));
        assert!(!enables(None, "cdcr_daemon", Level::DEBUG));
        assert!(enables(Some("debug"), "cdcr_daemon", Level::DEBUG));
        let list = Some("warn,cdcr_daemon::exchange=trace");
        assert!(enables(list, "cdcr_daemon::exchange::gather", Level::TRACE));
        assert!(!enables(list, "cdcr_daemon::cycle", Level::INFO));
        let (fallback, error) = filter(Some("cdcr_daemon=loud"));
        assert!(error.is_some() && fallback.would_enable("cdcr_daemon", &Level::INFO));
    }

    #[test]
    fn so_many_lines_pass_and_the_rest_is_counted_and_reported() {
        let limit = Limit {
            lines_max: 20,
            interval: INTERVAL,
        };
        let begin = Instant::now();
        let mut place = CallSite::since(begin);
        let mut count = |now| place.count(limit, now);
        for line in 0..20 {
            assert_eq!(count(begin + INTERVAL / 20 * line), Decision::Pass);
        }
        let end = begin + INTERVAL;
        for _ in 0..1000 {
            assert_eq!(count(begin + INTERVAL / 20 * 19), Decision::LeaveOut);
        }
        assert_eq!(count(end), Decision::PassAfter { left_out: 1000 });
        assert_eq!(count(end), Decision::Pass, "it is reported once");
        assert_eq!(count(end + INTERVAL), Decision::Pass);
    }

    /// The test runs itself: a process has only one log.
    #[test]
    fn every_line_is_either_there_or_counted() {
        const CHILD: &str = "CDCR_TEST_FLOODS";
        let interval = Duration::from_millis(300);
        if std::env::var_os(CHILD).is_some() {
            let log = tracing_subscriber::registry().with(RateLimit::new(3, interval));
            let (text, guard) = Text::new();
            log.with(lines(&text)).init();
            for lines in [50, 50, 1] {
                for line in 0..lines {
                    tracing::info!(line, "flood");
                }
                tracing::info!("a line of another place");
                std::thread::sleep(interval);
            }
            guard.end();
            return;
        }
        let output = Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "log::tests::every_line_is_either_there_or_counted",
            ])
            .arg("--nocapture")
            .env(CHILD, "1")
            .output()
            .unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        let count = |what: &str| text.lines().filter(|line| line.contains(what)).count();
        assert_eq!(count("a line of another place"), 3, "{text}");
        let left_out: usize = text
            .lines()
            .filter_map(|line| line.split_once("left_out=")?.1.trim().parse::<usize>().ok())
            .sum();
        assert!(left_out > 0, "{text}");
        assert_eq!(count("flood") + left_out, 101, "{text}");
    }

    #[test]
    fn the_journal_is_known_by_device_and_inode() {
        assert_eq!(device_and_inode("8:123456"), Some((8, 123_456)));
        for wrong in ["", "8", "8:", ":1", "8:-1", "a:b"] {
            assert_eq!(device_and_inode(wrong), None, "{wrong:?}");
        }
        assert!(!is_standard_error("0:0"));
    }
}
