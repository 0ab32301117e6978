mod screen;

use std::collections::VecDeque;
use std::io::{self, ErrorKind, IsTerminal as _, Write, stdin, stdout};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::Context as _;
use cdcr_shared_types::Telemetry;
use cdcr_shared_types::codes::Mode;
use ratatui::crossterm::terminal;

use super::record::{Around, RecordTask, RecordWatch, record};
use crate::args::{ScopeOptions, Target};
use crate::done::Done;
use crate::keys::Keys;
use crate::tell;
use crate::top;
use crate::trigger::Trigger;
use screen::ScopeScreen;

/// Columns of a chart, without its numbers.
const COLUMNS: usize = 64;
const ROWS: usize = 5;
/// Width of the numbers beside a chart.
const LABEL_COLUMNS: usize = 13;

pub(crate) fn run(target: &Target, options: &ScopeOptions) -> anyhow::Result<Done> {
    let around = Around {
        trigger: options.trigger,
        before: options.before,
        after: options.after,
    };
    let mut scope = Scope {
        shot: Arc::new(Mutex::new(Shot::new(around))),
        on_terminal: stdout().is_terminal() && stdin().is_terminal(),
        screen: None,
        keys: Keys::default(),
    };
    let task = RecordTask {
        output: options.output.as_deref(),
        duration: options.duration,
        max_bytes: None,
        around: Some(around),
        watch: &mut scope,
    };
    let done = record(target, task)?;
    if done == Done::Good && tell::results_are_read() {
        let columns = if scope.on_terminal {
            terminal::size()?.0.into()
        } else {
            usize::MAX
        };
        let text = locked(&scope.shot).text();
        write!(stdout().lock(), "{}", fitting(&text, columns))?;
    }
    Ok(done)
}

/// The records, and the screen, which draws them in its own thread.
struct Scope {
    shot: Arc<Mutex<Shot>>,
    on_terminal: bool,
    screen: Option<ScopeScreen>,
    keys: Keys,
}

impl RecordWatch for Scope {
    fn take(&mut self, record: &Telemetry, fires: Option<Trigger>) {
        if self.screen.is_none() {
            ().take(record, fires);
        }
        locked(&self.shot).take(record, fires.is_some());
    }

    fn should_end(&mut self) -> anyhow::Result<bool> {
        if !self.on_terminal {
            return Ok(false);
        }
        let screen = match &mut self.screen {
            Some(screen) => screen,
            none => none.insert(ScopeScreen::begin(Arc::clone(&self.shot))?),
        };
        let mut is_quit = || -> io::Result<bool> {
            screen.check()?;
            while let Some(key) = self.keys.next_within(Duration::ZERO)? {
                if top::quits(&key) {
                    return Ok(true);
                }
            }
            Ok(false)
        };
        match is_quit() {
            // The terminal is closed: no key can be pressed any more.
            Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(true),
            quit => quit.context("the terminal"),
        }
    }

    fn end(&mut self) {
        self.screen = None;
    }
}

/// The thread that draws holds this while it computes a picture, and never while it writes.
fn locked(shot: &Mutex<Shot>) -> MutexGuard<'_, Shot> {
    shot.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A strip chart: its name with unit, and the value of a record in that unit.
type Strip = (&'static str, fn(&Telemetry) -> f64);

const STRIPS: [Strip; 4] = [
    ("error [mm]", |record| 1e3 * record.position_error_m),
    ("clearance [mm]", |record| 1e3 * record.clearance_m),
    ("response [us]", |record| {
        record.handed_over_ns.saturating_sub(record.due_ns) as f64 * 1e-3
    }),
    ("fastest bend [rad/s]", |record| {
        let rates = record.command.bend_rate_rad_s.iter();
        rates.fold(0.0, |most: f64, rate| most.max(rate.abs()))
    }),
];

/// The part of a record that the charts need.
#[derive(Debug, Clone, Copy)]
struct Sample {
    release_ns: u64,
    cycle: u64,
    mode: u32,
    values: [f64; STRIPS.len()],
}

/// The samples around the trigger.
#[derive(Debug)]
struct Shot {
    around: Around,
    samples: VecDeque<Sample>,
    fired: Option<Sample>,
}

impl Shot {
    fn new(around: Around) -> Self {
        Self {
            around,
            samples: VecDeque::new(),
            fired: None,
        }
    }

    fn take(&mut self, record: &Telemetry, fires: bool) {
        let sample = Sample {
            release_ns: record.release_ns,
            cycle: record.cycle,
            mode: record.mode,
            values: STRIPS.map(|(_, value)| value(record)),
        };
        self.samples.push_back(sample);
        if fires {
            self.fired = Some(sample);
        }
        if self.fired.is_none() || fires {
            let before_ns = self.around.before.as_nanos() as u64;
            let begin_ns = record.release_ns.saturating_sub(before_ns);
            let is_old = |sample: &Sample| sample.release_ns < begin_ns;
            while self.samples.front().is_some_and(is_old) {
                self.samples.pop_front();
            }
        }
    }

    /// A sentence, and a chart per strip.
    fn text(&self) -> String {
        let (Some(fired), Some(first), Some(last)) =
            (self.fired, self.samples.front(), self.samples.back())
        else {
            return String::new();
        };
        let seconds = |from: &Sample, to: &Sample| (to.release_ns - from.release_ns) as f64 * 1e-9;
        let mut lines = vec![format!(
            "{} in cycle {}, {}: {:.2} s before and {:.2} s after",
            self.around.trigger,
            fired.cycle,
            Mode::text_of(fired.mode),
            seconds(first, &fired),
            seconds(&fired, last),
        )];
        let all_s = seconds(first, last).max(f64::MIN_POSITIVE);
        let column = |sample: &Sample| {
            let share = seconds(first, sample) / all_s;
            ((share * COLUMNS as f64) as usize).min(COLUMNS - 1)
        };
        for (i, (name, _)) in STRIPS.iter().enumerate() {
            let values = self.samples.iter();
            let values = values.map(|sample| (column(sample), sample.values[i]));
            lines.push(format!("{name}, {} at the line", number(fired.values[i])));
            lines.extend(strip(values, column(&fired)));
        }
        let begin = format!("-{:.2} s", seconds(first, &fired));
        let end = format!("+{:.2} s", seconds(&fired, last));
        let gap = (COLUMNS + 1).saturating_sub(begin.len() + end.len());
        lines.push(format!("{:>12} {begin}{:gap$}{end}", "", ""));
        lines.join("\n") + "\n"
    }
}

/// Only the sentence, if the charts would be wrapped.
fn fitting(text: &str, columns: usize) -> &str {
    if columns <= LABEL_COLUMNS + COLUMNS {
        text.split_inclusive('\n').next().unwrap_or_default()
    } else {
        text
    }
}

/// Empty for a value that is not finite.
fn number(value: f64) -> String {
    if value.is_finite() {
        format!("{value:.4}")
    } else {
        "-".to_owned()
    }
}

/// One chart: the least to the largest value of each column, within the range of all. A constant value is
/// printed once. Columns without values stay empty.
fn strip(values: impl Iterator<Item = (usize, f64)>, fired: usize) -> Vec<String> {
    let mut columns: [Option<(f64, f64)>; COLUMNS] = [None; COLUMNS];
    for (column, value) in values.filter(|(_, value)| value.is_finite()) {
        let (least, most) = columns[column].unwrap_or((value, value));
        columns[column] = Some((least.min(value), most.max(value)));
    }
    let all = columns.iter().flatten();
    let range = all.fold(None, |range: Option<(f64, f64)>, &(least, most)| {
        let (low, high) = range.unwrap_or((least, most));
        Some((low.min(least), high.max(most)))
    });
    let Some((low, high)) = range else {
        return vec![format!("{:>12} no number", "")];
    };
    let row_of = |value: f64| {
        let share = (value - low) / (high - low).max(f64::MIN_POSITIVE);
        (ROWS - 1) - ((share * ROWS as f64) as usize).min(ROWS - 1)
    };
    let (top, bottom) = (number(high), number(low));
    let rows = (0..ROWS).map(|row| {
        let label = match row {
            _ if row == ROWS - 1 => &bottom,
            0 if top != bottom => &top,
            _ => "",
        };
        let sign = |(column, found): (usize, &Option<(f64, f64)>)| match found {
            Some((least, most)) if (row_of(*most)..=row_of(*least)).contains(&row) => '#',
            _ if column == fired => '|',
            _ => ' ',
        };
        let signs: String = columns.iter().enumerate().map(sign).collect();
        format!("{label:>12} {}", signs.trim_end())
    });
    rows.collect()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::trigger::Trigger;

    #[test]
    fn a_chart_shows_where_it_fired_and_how_far_each_number_went() {
        let mut shot = Shot::new(Around {
            trigger: Trigger::Error(0.005),
            before: Duration::from_secs(1),
            after: Duration::from_secs(1),
        });
        for cycle in 0..=600_u64 {
            let record = Telemetry {
                cycle,
                release_ns: 5_000_000 * cycle,
                position_error_m: 1e-5 * cycle as f64,
                clearance_m: f64::INFINITY,
                ..Telemetry::default()
            };
            shot.take(&record, cycle == 400);
        }
        let text = shot.text();
        let lines: Vec<_> = text.lines().collect();
        assert!(lines[0].starts_with("error>5mm in cycle 400"), "{text}");
        assert!(
            lines[0].ends_with(": 1.00 s before and 1.00 s after"),
            "{text}"
        );
        assert_eq!(lines[1], "error [mm], 4.0000 at the line");
        // From 2 mm to 6 mm, rising; the line of the trigger is in the middle column.
        assert!(
            lines[2].starts_with("      6.0000 ") && lines[2].ends_with('#'),
            "{text}"
        );
        assert!(lines[6].starts_with("      2.0000 ####"), "{text}");
        assert_eq!(lines[2].chars().nth(13 + 32), Some('|'), "{text}");
        assert_eq!(lines[8].trim(), "no number");
        assert_eq!(fitting(&text, 20).trim_end(), lines[0]);
        assert_eq!(fitting(&text, 78), text);
        assert!(lines[1..].iter().all(|line| line.len() <= 78), "{text}");
    }

    #[test]
    fn what_never_changes_is_a_line() {
        let rows = strip((0..COLUMNS).map(|column| (column, 2.0)), 3);
        assert_eq!(rows.len(), ROWS);
        assert_eq!(rows[ROWS - 1].matches('#').count(), COLUMNS);
        assert_eq!(rows.concat().matches("2.0000").count(), 1);
    }
}
