use std::io::stderr;
use std::time::Duration;

use cdcr_client::FeedProgress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use rustix::termios::tcgetwinsize;

/// The longest line with a bar, with room for a file's name.
const COLUMNS_FOR_BAR: u16 = 80;

/// A progress bar on the terminal's standard error; nothing at all when that is no terminal.
pub(crate) struct Bar {
    bar: ProgressBar,
}

impl Bar {
    pub(crate) fn new(what: &str) -> Self {
        let bar = ProgressBar::with_draw_target(Some(1), ProgressDrawTarget::stderr_with_hz(10));
        // A line that wraps is not cleared.
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

    /// A part of the whole, 0 to 1.
    pub(crate) fn show_share(&self, share: f64) {
        let percent = 100.0 * share.clamp(0.0, 1.0);
        self.bar.set_length(100);
        self.bar.set_position(percent as u64);
        self.bar.set_message(format!("{percent:.0} %"));
    }

    /// How long it has gone on, where nobody knows how long it lasts.
    pub(crate) fn show_time(&self, played_s: f64) {
        self.bar.set_message(format!("{played_s:.1} s"));
    }

    /// How far it is, and beside it what else is to be told while it tracks.
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
