//! Progress of a long measurement, and its remaining time.

use std::io::Write as _;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

const LINE_EVERY: Duration = Duration::from_secs(10);

/// A bar on a terminal, otherwise occasional lines, both on standard error.
#[derive(Debug)]
pub struct Progress {
    /// The current part, a prefix of every message.
    part: String,
    /// In milliseconds. Hidden without a terminal.
    bar: ProgressBar,
    has_lines: bool,
    last_line: Option<Instant>,
}

impl Progress {
    pub fn new(total_s: f64) -> Self {
        let bar = ProgressBar::new(milliseconds(total_s));
        // A stretch may take minutes; the remaining time is updated meanwhile.
        if !bar.is_hidden() {
            bar.enable_steady_tick(Duration::from_millis(500));
        }
        let style = ProgressStyle::with_template("{bar:24} {percent:>3} %, {eta} left: {msg}");
        let bar = style.map_or(bar.clone(), |style| bar.with_style(style));
        Self {
            part: String::new(),
            has_lines: bar.is_hidden(),
            bar,
            last_line: None,
        }
    }

    pub fn silent() -> Self {
        let mut progress = Self::new(0.0);
        (progress.bar, progress.has_lines) = (ProgressBar::hidden(), false);
        progress
    }

    /// Begins one of several measurements; `left_s` is the duration of this and all later ones \[s\].
    pub fn begin_part(&mut self, part: &str, left_s: f64) {
        let done_ms = self.bar.position();
        self.bar.set_length(done_ms + milliseconds(left_s));
        self.part = format!("{part}: ");
        // Each part is printed, however short the previous one was.
        self.last_line = None;
        self.begin("begins");
    }

    pub fn begin(&mut self, what: &str) {
        let what = format!("{}{what}", self.part);
        let is_early = |last: Instant| last.elapsed() < LINE_EVERY;
        if self.has_lines && !self.last_line.is_some_and(is_early) {
            self.last_line = Some(Instant::now());
            self.write_line(&what);
        }
        self.bar.set_message(what);
    }

    pub fn advance(&mut self, seconds: f64) {
        self.bar.inc(milliseconds(seconds));
    }

    /// Changes the expected duration by `more_s`, which may be negative \[s\].
    pub fn expect(&mut self, more_s: f64) {
        let total_ms = self.total_ms().saturating_add_signed((1e3 * more_s) as i64);
        self.bar.set_length(total_ms.max(self.bar.position()));
    }

    fn total_ms(&self) -> u64 {
        self.bar.length().unwrap_or(0)
    }

    fn write_line(&self, what: &str) {
        let (done_ms, total_ms) = (self.bar.position(), self.total_ms());
        let percent = 100.0 * (done_ms as f64 / total_ms.max(1) as f64).min(1.0);
        // Completed time counts measurement only; the work around it takes time, too.
        let slower = match done_ms {
            0 => 1.0,
            done_ms => self.bar.elapsed().as_millis() as f64 / done_ms as f64,
        };
        let left_s = 1e-3 * total_ms.saturating_sub(done_ms) as f64 * slower;
        let left = humantime::format_duration(Duration::from_secs(left_s.round() as u64));
        let _ = writeln!(std::io::stderr(), "{percent:>3.0} %, {left} left: {what}");
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn milliseconds(seconds: f64) -> u64 {
    (seconds.max(0.0) * 1e3) as u64
}
