use std::io::stderr;
use std::time::Duration;

use cdcr_client::FeedProgress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rustix::termios::tcgetwinsize;

/// Minimum terminal width for a bar: the longest line, including a file name.
const COLUMNS_FOR_BAR: u16 = 80;

/// A progress bar on standard error; nothing is shown if that is not a terminal.
pub(crate) struct Bar {
    bar: ProgressBar,
}

impl Bar {
    pub(crate) fn new(what: &str) -> Self {
        let bar = ProgressBar::with_draw_target(Some(1), ProgressDrawTarget::stderr_with_hz(10));
        // A wrapped line cannot be cleared.
        let columns = tcgetwinsize(stderr()).map_or(0, |size| size.ws_col);
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
    }
}

fn ms(time_s: f64) -> u64 {
    Duration::from_secs_f64(time_s.max(0.0)).as_millis() as u64
}
