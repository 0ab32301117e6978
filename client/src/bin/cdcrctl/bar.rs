use std::io::{self, IsTerminal as _, stderr};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use cdcr_client::FeedProgress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle, TermLike};
use rustix::termios::tcgetwinsize;

use crate::tell;

/// Minimum terminal width for a bar: the longest line, including a file name.
const COLUMNS_FOR_BAR: u16 = 80;

/// A progress bar on standard error; nothing is shown if that is not a terminal.
pub(crate) struct Bar {
    bar: ProgressBar,
}

impl Bar {
    pub(crate) fn new(what: &str) -> Self {
        let bar = ProgressBar::with_draw_target(Some(1), target());
        // A wrapped line cannot be cleared.
        let columns = columns();
        let template = if columns < COLUMNS_FOR_BAR {
            "{prefix} {percent}%"
        } else {
            "{prefix} [{bar:30}] {msg}"
        };
        let style = ProgressStyle::with_template(template);
        bar.set_style(
            style
                .unwrap_or_else(|_| ProgressStyle::default_bar())
                .progress_chars("=> "),
        );
        bar.set_prefix(what.to_owned());
        Self { bar }
    }

    /// Shows a fraction, 0 to 1.
    pub(crate) fn show_share(&self, share: f64) {
        let percent = 100.0 * share.clamp(0.0, 1.0);
        self.bar.set_length(100);
        self.bar.set_position(percent as u64);
        self.bar.set_message(format!("{percent:.0} %"));
    }

    /// Shows the elapsed time, for an unknown duration.
    pub(crate) fn show_time(&self, played_s: f64) {
        self.bar.set_message(format!("{played_s:.1} s"));
    }

    /// Shows the progress of a feed, and `beside` while the daemon tracks.
    pub(crate) fn show(&self, progress: &FeedProgress, beside: Option<String>) {
        self.bar.set_length(ms(progress.duration_s));
        self.bar.set_position(ms(progress.played_s));
        let tracked = match beside {
            Some(beside) if progress.tracking => beside,
            None if progress.tracking => "tracking".to_owned(),
            _ => "not tracking".to_owned(),
        };
        self.bar.set_message(format!(
            "{:.1} of {:.1} s, {tracked}",
            progress.played_s, progress.duration_s
        ));
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
        if !self.bar.is_hidden() {
            tell::keep_order();
        }
    }
}

fn target() -> ProgressDrawTarget {
    let is_dumb = std::env::var("TERM").is_ok_and(|terminal| terminal == "dumb");
    if !stderr().is_terminal() || is_dumb {
        return ProgressDrawTarget::hidden();
    }
    ProgressDrawTarget::term_like_with_hz(Box::new(BarLine::default()), 10)
}

/// Width of the terminal; 0: unknown.
fn columns() -> u16 {
    tcgetwinsize(stderr()).map_or(0, |size| size.ws_col)
}

/// The one line of a bar. Drawing it never waits for the terminal.
#[derive(Debug, Default)]
struct BarLine {
    text: Mutex<String>,
}

impl TermLike for BarLine {
    fn width(&self) -> u16 {
        match columns() {
            0 => COLUMNS_FOR_BAR,
            columns => columns,
        }
    }

    fn move_cursor_up(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_down(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_right(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn move_cursor_left(&self, _: usize) -> io::Result<()> {
        Ok(())
    }

    fn write_line(&self, text: &str) -> io::Result<()> {
        self.write_str(text)
    }

    fn write_str(&self, text: &str) -> io::Result<()> {
        *self.text.lock().unwrap_or_else(PoisonError::into_inner) += text;
        Ok(())
    }

    fn clear_line(&self) -> io::Result<()> {
        self.text
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clear();
        Ok(())
    }

    fn flush(&self) -> io::Result<()> {
        let mut text = self.text.lock().unwrap_or_else(PoisonError::into_inner);
        // The blanks that fill the line are not shown: only one line can be removed.
        let shown = text.trim_end().chars().take(self.width().into());
        tell::show_bar(shown.collect());
        text.clear();
        Ok(())
    }
}

fn ms(time_s: f64) -> u64 {
    Duration::from_secs_f64(time_s.max(0.0)).as_millis() as u64
}
