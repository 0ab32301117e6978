//! The live charts of `scope`, before and after the trigger.
//!
//! Invariant: only the thread of the screen writes to the terminal. While nobody reads that, the records are still taken,
//! and keys and signals end the program.

use std::io::{self, stdout};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use anyhow::Context as _;
use cdcr_shared_types::codes::Mode;
use ratatui::Frame;
use ratatui::crossterm::terminal::disable_raw_mode;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Line;
use ratatui::widgets::Paragraph;
use ratatui::widgets::canvas::{self, Canvas, Context};

use super::{STRIPS, Sample, Shot, locked, number};
use crate::keys;
use crate::picture::Signs;
use crate::tell::Unread;
use crate::trigger::Trigger;

/// Interval of the pictures: no record is taken while one is computed.
const EVERY: Duration = Duration::from_millis(66);
/// Interval of the checks whether the thread has ended.
const CHECK_INTERVAL: Duration = Duration::from_millis(5);
const COLUMNS_MIN: u16 = 40;
/// A row of names, one of modes, one of keys, and two per chart.
const ROWS_MIN: u16 = 3 + 2 * STRIPS.len() as u16;
/// Width of the numbers beside a chart.
const LABEL_COLUMNS: u16 = 11;

/// A thread with the terminal, which is given back on drop.
#[derive(Debug)]
pub(super) struct ScopeScreen {
    /// `None`: the thread is to end.
    over: Option<Sender<()>>,
    /// `None` after its end.
    thread: Option<JoinHandle<io::Result<()>>>,
}

impl ScopeScreen {
    pub(super) fn begin(shot: Arc<Mutex<Shot>>) -> anyhow::Result<Self> {
        let (over, is_over) = channel();
        let thread = thread::Builder::new().spawn(move || draw_on(&shot, &is_over));
        Ok(Self {
            over: Some(over),
            thread: Some(thread.context("the thread of the screen")?),
        })
    }

    /// Fails when the thread cannot draw.
    pub(super) fn check(&mut self) -> io::Result<()> {
        match self.thread.take_if(|thread| thread.is_finished()) {
            Some(thread) => thread
                .join()
                .unwrap_or_else(|_| Err(io::Error::other("the thread of the screen panicked"))),
            None => Ok(()),
        }
    }
}

impl Drop for ScopeScreen {
    fn drop(&mut self) {
        self.over = None;
        let Some(thread) = &self.thread else { return };
        let mut unread = Unread::default();
        while !thread.is_finished() {
            if unread.is_over(keys::takes_output(&stdout())) {
                // The rest, which a terminal has to read, is lost.
                drop(disable_raw_mode());
                return;
            }
            thread::sleep(CHECK_INTERVAL);
        }
    }
}

/// Draws until the end, and gives the terminal back.
fn draw_on(shot: &Mutex<Shot>, is_over: &Receiver<()>) -> io::Result<()> {
    // From here on a panic restores the terminal, too.
    let mut terminal = ratatui::try_init()?;
    let signs = Signs::of_terminal();
    let drawn = loop {
        let drawn = terminal.draw(|frame| draw(&locked(shot), signs, frame));
        if let Err(error) = keys::drawn(drawn.map(drop)) {
            break Err(error);
        }
        if is_over.recv_timeout(EVERY) != Err(RecvTimeoutError::Timeout) {
            break Ok(());
        }
    };
    let restored = ratatui::try_restore();
    drawn.and(restored)
}

fn draw(shot: &Shot, signs: Signs, frame: &mut Frame<'_>) {
    let area = frame.area();
    if area.width < COLUMNS_MIN || area.height < ROWS_MIN {
        let words = format!("scope needs {COLUMNS_MIN} columns and {ROWS_MIN} rows; q quits");
        let words = Paragraph::new(words).wrap(ratatui::widgets::Wrap { trim: true });
        return frame.render_widget(words, area);
    }
    let rows = [
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(1),
        Constraint::Length(1),
    ];
    let [title, charts, modes, footer] = Layout::vertical(rows).areas(area);
    frame.render_widget(heading(shot), title);
    let axis = Axis::new(shot, usize::from(area.width - LABEL_COLUMNS));
    let places = Layout::vertical([Constraint::Fill(1); STRIPS.len()]).split(charts);
    for (strip, place) in places.iter().enumerate() {
        chart(shot, strip, &axis, signs, frame, *place);
    }
    let letters = format!("{:>10} {}", "mode", axis.modes(shot));
    frame.render_widget(Line::from(letters), modes);
    let (before, after) = (shot.around.before, shot.around.after);
    let words = format!(
        "{:>10} -{:.2} s to +{:.2} s   q quits",
        "time",
        before.as_secs_f64(),
        after.as_secs_f64()
    );
    frame.render_widget(Line::from(words), footer);
}

fn heading(shot: &Shot) -> Line<'static> {
    let trigger = shot.around.trigger;
    let (words, color) = match shot.fired {
        Some(fired) => (format!("{trigger} in cycle {}", fired.cycle), Color::Red),
        None => (format!("waiting for {trigger}"), Color::Green),
    };
    Line::styled(words, Style::new().fg(color).add_modifier(Modifier::BOLD))
}

/// Time axis from left to right, with the trigger, or until then the newest record, at 0.
struct Axis {
    zero_ns: u64,
    bounds_s: [f64; 2],
    columns: usize,
}

impl Axis {
    fn new(shot: &Shot, columns: usize) -> Self {
        let zero = shot.fired.as_ref().or(shot.samples.back());
        Self {
            zero_ns: zero.map_or(0, |sample| sample.release_ns),
            bounds_s: [
                -shot.around.before.as_secs_f64(),
                shot.around.after.as_secs_f64().max(1e-3),
            ],
            columns,
        }
    }

    fn time_s(&self, sample: &Sample) -> f64 {
        (sample.release_ns as f64 - self.zero_ns as f64) * 1e-9
    }

    fn column(&self, sample: &Sample) -> Option<usize> {
        let [begin_s, end_s] = self.bounds_s;
        let share = (self.time_s(sample) - begin_s) / (end_s - begin_s);
        (0.0..=1.0)
            .contains(&share)
            .then(|| ((share * self.columns as f64) as usize).min(self.columns - 1))
    }

    /// First letter of the newest mode in each column.
    fn modes(&self, shot: &Shot) -> String {
        let mut letters = vec![' '; self.columns];
        for sample in &shot.samples {
            let letter = Mode::text_of(sample.mode).chars().next();
            if let (Some(column), Some(letter)) = (self.column(sample), letter) {
                letters[column] = letter.to_ascii_uppercase();
            }
        }
        letters.into_iter().collect()
    }

    /// A polyline through the least and largest value of each column.
    fn way(&self, shot: &Shot, strip: usize) -> Vec<(f64, f64)> {
        let mut found: Vec<Option<[(f64, f64); 2]>> = vec![None; self.columns];
        for sample in &shot.samples {
            let here = (self.time_s(sample), sample.values[strip]);
            if let Some(column) = self.column(sample).filter(|_| here.1.is_finite()) {
                let [least, most] = found[column].get_or_insert([here; 2]);
                if here.1 < least.1 {
                    *least = here;
                }
                if here.1 > most.1 {
                    *most = here;
                }
            }
        }
        let pairs = found.into_iter().flatten();
        pairs
            .flat_map(|[a, b]| if a.0 <= b.0 { [a, b] } else { [b, a] })
            .collect()
    }
}

/// The trigger level, in the unit of its strip.
fn level(trigger: Trigger, strip: usize) -> Option<f64> {
    match (trigger, strip) {
        (Trigger::Error(m), 0) | (Trigger::Clearance(m), 1) => Some(1e3 * m),
        (Trigger::Response(ns), 2) => Some(ns as f64 * 1e-3),
        _ => None,
    }
}

fn chart(shot: &Shot, strip: usize, axis: &Axis, signs: Signs, frame: &mut Frame<'_>, area: Rect) {
    let [title, below] = Layout::vertical([Constraint::Length(1), Constraint::Min(1)]).areas(area);
    let [labels, plot] =
        Layout::horizontal([Constraint::Length(LABEL_COLUMNS), Constraint::Min(1)]).areas(below);
    let newest = shot.samples.back().map_or(f64::NAN, |s| s.values[strip]);
    let level = level(shot.around.trigger, strip);
    let words = format!("{}, now {}", STRIPS[strip].0, number(newest));
    let quiet = Style::new().add_modifier(Modifier::DIM);
    frame.render_widget(Line::styled(words, quiet), title);
    let way = axis.way(shot, strip);
    let values = || way.iter().map(|point| point.1).chain(level);
    let low = values().fold(f64::INFINITY, f64::min);
    let high = values().fold(f64::NEG_INFINITY, f64::max);
    if low > high {
        return;
    }
    let mut numbers = vec![Line::default(); usize::from(labels.height)];
    let last = numbers.len().saturating_sub(1);
    // A constant value is drawn in the middle.
    let places = if low < high { [last, 0] } else { [last / 2; 2] };
    for (place, number) in places.into_iter().zip([low, high]) {
        if let Some(line) = numbers.get_mut(place) {
            *line = Line::from(format!("{number:>10.4}"));
        }
    }
    frame.render_widget(Paragraph::new(numbers), labels);
    let pad = 0.02 * (high - low).max(1e-9 * high.abs()).max(f64::MIN_POSITIVE);
    let (low, high) = (low - pad, high + pad);
    let line = |context: &mut Context<'_>, sign, from: (f64, f64), to: (f64, f64), color| {
        context.marker(signs.marker(sign));
        context.draw(&canvas::Line::new(from.0, from.1, to.0, to.1, color));
    };
    let canvas = Canvas::default()
        .x_bounds(axis.bounds_s)
        .y_bounds([low, high])
        .paint(|context| {
            line(context, '|', (0.0, low), (0.0, high), Color::DarkGray);
            if let Some(level) = level {
                let [begin_s, end_s] = axis.bounds_s;
                line(context, '-', (begin_s, level), (end_s, level), Color::Red);
            }
            for pair in way.windows(2) {
                line(context, '#', pair[0], pair[1], Color::Yellow);
            }
        });
    frame.render_widget(canvas, plot);
}

#[cfg(test)]
mod tests {
    use cdcr_shared_types::Telemetry;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    use super::*;
    use crate::recording::record::Around;

    /// The error rises to 6 mm within 3 s, and passes 4 mm after 2 s.
    fn shot(cycles: u64) -> Shot {
        let mut shot = Shot::new(Around {
            trigger: Trigger::Error(0.004),
            before: Duration::from_secs(1),
            after: Duration::from_secs(1),
        });
        for cycle in 0..cycles {
            let record = Telemetry {
                cycle,
                release_ns: 5_000_000 * cycle,
                position_error_m: 1e-5 * cycle as f64,
                clearance_m: f64::INFINITY,
                mode: Mode::Tracking.code(),
                ..Telemetry::default()
            };
            shot.take(&record, cycle == 401);
        }
        shot
    }

    fn drawn(shot: &Shot, columns: u16, rows: u16, signs: Signs) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("a terminal");
        let draws = |frame: &mut Frame<'_>| draw(shot, signs, frame);
        terminal.draw(draws).expect("it draws");
        let buffer = terminal.backend().buffer();
        let row = |row: Rect| {
            let cells = row
                .positions()
                .map(|place| buffer[place].symbol().to_owned());
            cells.collect::<String>().trim_end().to_owned()
        };
        buffer.area.rows().map(row).collect()
    }

    #[test]
    fn what_was_before_ends_at_the_line_until_it_fires() {
        let lines = drawn(&shot(300), 80, 24, Signs::Ascii);
        let page = lines.join("\n");
        assert!(
            page.is_ascii() && page.contains("waiting for error>4mm"),
            "{page}"
        );
        assert!(lines[1].starts_with("error [mm], now 2.9900"), "{page}");
        // The trigger level, at the top of the chart, over its whole width.
        let level = &lines[2][usize::from(LABEL_COLUMNS)..];
        assert!(lines[2].starts_with("    4.0000"), "{page}");
        assert!(level.matches('-').count() > 60, "{page}");
        // The right half of the chart is empty.
        let middle = usize::from(LABEL_COLUMNS) + 35;
        let right: String = lines[3..6]
            .iter()
            .flat_map(|line| line.chars().skip(middle))
            .collect();
        assert!(
            !right.contains('#') && page.contains('#') && page.contains('|'),
            "{page}"
        );
        let modes = lines
            .iter()
            .find(|line| line.contains("mode "))
            .expect("modes");
        assert_eq!(modes.matches('T').count(), 35, "{page}");
    }

    #[test]
    fn after_it_fired_the_chart_fills_to_the_right() {
        let lines = drawn(&shot(560), 80, 24, Signs::Braille);
        let page = lines.join("\n");
        assert!(page.contains("error>4mm in cycle 401"), "{page}");
        assert!(lines[2].starts_with("    5.5900"), "{page}");
        assert!(
            page.chars().any(|sign| ('⠁'..='⣿').contains(&sign)),
            "{page}"
        );
        let modes = lines
            .iter()
            .find(|line| line.contains("mode "))
            .expect("modes");
        assert!((60..69).contains(&modes.matches('T').count()), "{page}");
    }

    #[test]
    fn what_does_not_change_has_one_number_and_what_is_none_has_a_dash() {
        let mut shot = shot(0);
        let record = Telemetry {
            position_error_m: f64::NAN,
            ..Telemetry::default()
        };
        shot.take(&record, false);
        let lines = drawn(&shot, 80, 24, Signs::Ascii);
        let page = lines.join("\n");
        assert!(page.contains("error [mm], now -\n"), "{page}");
        let labels = lines.iter().filter(|line| line.starts_with("    4.0000"));
        assert_eq!(labels.count(), 1, "{page}");
    }

    #[test]
    fn no_terminal_is_too_small_for_a_sentence() {
        let page = drawn(&shot(300), 39, 24, Signs::Braille).join(" ");
        assert!(page.contains("scope needs 40 columns"), "{page}");
        for (columns, rows) in [(0, 0), (1, 1), (40, 11), (300, 90)] {
            drawn(&shot(500), columns, rows, Signs::Braille);
            drawn(&shot(0), columns, rows, Signs::HalfBlocks);
        }
    }
}
