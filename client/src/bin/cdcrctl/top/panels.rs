//! Renders the observed state of the daemon into the cells of a terminal.

use cdcr_client::{realtime_missing, text};
use cdcr_shared_types::codes::{Mode, Reason, RequestKind, RobotLink};
use cdcr_shared_types::{Status, Telemetry};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::bar;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Paragraph, Sparkline};

use super::recent::Recent;
use super::seen::Seen;
use crate::echo::line::clearance_text;
use crate::picture::{FRONT, SIDE, Signs, TOP};

/// Minimum size for all panels.
pub(super) const COLUMNS_MIN: u16 = 80;
pub(super) const ROWS_MIN: u16 = 24;
const HEADER_ROWS: u16 = 4;
const CHARTS: u16 = 3;
/// Rows for the name, percentiles and bars.
const CHART_ROWS: u16 = 3;
const EVENTS_MIN: u16 = 3;

/// Bars for a terminal without Unicode.
const ASCII_BARS: bar::Set<'_> = bar::Set {
    full: "#",
    seven_eighths: "#",
    three_quarters: "=",
    five_eighths: "=",
    half: "-",
    three_eighths: "-",
    one_quarter: ".",
    one_eighth: ".",
    empty: " ",
};

/// Content of the screen, and its options.
#[derive(Debug)]
pub(super) struct Screen<'a> {
    /// The newest state.
    pub(super) live: &'a Seen,
    /// State in charts and picture: the newest one, or the one at the start of the pause.
    pub(super) shown: &'a Seen,
    pub(super) is_paused: bool,
    pub(super) zoom: f64,
    pub(super) signs: Signs,
    /// Requests without an answer yet.
    pub(super) asked: &'a [RequestKind],
    /// Why no records arrive, if none do.
    pub(super) silent: Option<&'a str>,
}

impl Screen<'_> {
    pub(super) fn draw(&self, frame: &mut Frame<'_>) {
        let area = frame.area();
        if area.width < COLUMNS_MIN || area.height < ROWS_MIN {
            let words = format!(
                "top needs {COLUMNS_MIN} columns and {ROWS_MIN} rows; this terminal has {} and {}. \
                 q quits, s stops the robot.",
                area.width, area.height
            );
            let words = Paragraph::new(words).wrap(ratatui::widgets::Wrap { trim: true });
            return frame.render_widget(words, area);
        }
        let sections = self
            .live
            .record
            .as_ref()
            .map_or(1, |record| record.robot.sections as u16);
        let robot_rows = 1 + sections;
        let rows = [
            Constraint::Length(HEADER_ROWS),
            Constraint::Min(CHARTS * CHART_ROWS),
            Constraint::Length(robot_rows),
            Constraint::Length(EVENTS_MIN + (area.height - ROWS_MIN) / 4),
            Constraint::Length(1),
        ];
        let [header, middle, robot, events, footer] = Layout::vertical(rows).areas(area);
        let [picture, _, charts] = Layout::horizontal([
            Constraint::Percentage(60),
            Constraint::Length(1),
            Constraint::Fill(1),
        ])
        .areas(middle);
        frame.render_widget(Paragraph::new(self.header()), header);
        self.picture(frame, picture);
        self.charts(frame, charts);
        frame.render_widget(Paragraph::new(self.robot()), robot);
        frame.render_widget(Paragraph::new(self.events(events.height)), events);
        frame.render_widget(Paragraph::new(self.footer()), footer);
    }

    /// Mode and loop, misses and surroundings, tip and reference.
    fn header(&self) -> Vec<Line<'static>> {
        let Some(record) = &self.live.record else {
            return vec![Line::from("no record yet")];
        };
        let (mode, reason) = (Mode::text_of(record.mode), Reason::text_of(record.reason));
        let mut first = vec![
            Span::styled(
                format!(" {} ", mode.to_uppercase()),
                mode_style(record.mode),
            ),
            Span::from(format!(" {reason}")),
        ];
        let rate = self.live.rate_hz();
        let mut reported =
            vec![rate.map_or_else(|| "no rate yet".to_owned(), |hz| format!("{hz:.1} Hz"))];
        if let Some(status) = &self.live.status {
            reported.extend(identity(status));
        }
        first.push(Span::from(format!("   {}", reported.join(", "))));
        if let Some(silent) = self.silent {
            let words = silent.lines().next().unwrap_or_default().to_owned();
            first = vec![Span::styled(words, bad())];
        } else if self.is_paused {
            first.push(Span::styled("  PAUSED", bad()));
        }
        vec![
            Line::from(first),
            Line::from(self.misses(record)),
            Line::from(self.surroundings(record)),
            Line::from(Self::tip(record)),
        ]
    }

    fn misses(&self, record: &Telemetry) -> String {
        let (misses, skipped) = (record.deadline_misses_total, record.skipped_periods_total);
        let late = self
            .live
            .last_late
            .map_or_else(String::new, |(when_ns, cause)| {
                let ago_s = record.release_ns.saturating_sub(when_ns) as f64 * 1e-9;
                format!("   last late {ago_s:.0} s ago: {cause}")
            });
        format!("misses {misses}, skipped {skipped}{late}")
    }

    fn surroundings(&self, record: &Telemetry) -> String {
        let feeds = self
            .live
            .status
            .as_ref()
            .map_or("", |status| match status.lease_holder {
                0 => "   no client feeds",
                _ => "   a client feeds",
            });
        format!(
            "clearance {} mm, safe distance {:.1} mm   obstacles {}{feeds}",
            clearance_text(record.clearance_m),
            1e3 * record.settings.safe_distance_m,
            record.obstacle_count,
        )
    }

    fn tip(record: &Telemetry) -> String {
        let mm = |m: [f64; 3]| m.map(|x| format!("{:6.1}", 1e3 * x)).join(" ");
        let tip = mm(record.tip_position_m);
        if record.mode == Mode::Starting.code() {
            return "tip not known yet: control has not begun".to_owned();
        }
        if record.position_error_m.is_finite() {
            let reference = mm(record.reference.position_m);
            let error = four_digits(1e3 * record.position_error_m);
            format!("tip {tip}   reference {reference}   error {error} mm")
        } else {
            format!("tip {tip} mm   no reference")
        }
    }

    fn picture(&self, frame: &mut Frame<'_>, area: Rect) {
        let scene = self.shown.scene();
        let window = self.shown.window(self.zoom);
        let views = [SIDE, FRONT, TOP];
        for (view, place) in views.into_iter().zip(
            Layout::horizontal([Constraint::Fill(1); 3])
                .spacing(1)
                .areas::<3>(area)
                .iter(),
        ) {
            let [title, picture] =
                Layout::vertical([Constraint::Length(1), Constraint::Min(1)]).areas(*place);
            frame.render_widget(Line::styled(view.short, quiet()), title);
            scene.draw(view, &window, self.signs, picture, frame.buffer_mut());
        }
    }

    fn charts(&self, frame: &mut Frame<'_>, area: Rect) {
        let shown = self.shown;
        let us = if self.signs == Signs::Ascii {
            "us"
        } else {
            "µs"
        };
        let deadline = shown.record.as_ref().map_or_else(String::new, |record| {
            format!(", deadline {:.0}", record.deadline_ns as f64 * 1e-3)
        });
        let charts: [(String, &Recent, Color); CHARTS as usize] = [
            ("error mm".to_owned(), &shown.error_mm, Color::Yellow),
            (
                format!("response {us}{deadline}"),
                &shown.response_us,
                Color::Green,
            ),
            (format!("solve {us}"), &shown.solve_us, Color::Cyan),
        ];
        let places = Layout::vertical([Constraint::Fill(1); CHARTS as usize])
            .areas::<{ CHARTS as usize }>(area);
        for ((name, recent, color), place) in charts.into_iter().zip(places) {
            self.chart(frame, place, &name, recent, color);
        }
    }

    fn chart(&self, frame: &mut Frame<'_>, area: Rect, name: &str, recent: &Recent, color: Color) {
        let [title, numbers, bars] = Layout::vertical([
            Constraint::Length(1),
            Constraint::Length(1),
            Constraint::Min(1),
        ])
        .areas(area);
        frame.render_widget(Line::styled(name.to_owned(), quiet()), title);
        let percentiles = recent.percentiles();
        let words = percentiles.map_or_else(
            || "none in 10 s".to_owned(),
            |of| {
                let [p50, p99, max] = [of.p50, of.p99, of.max].map(four_digits);
                format!("p50 {p50} p99 {p99} max {max}")
            },
        );
        frame.render_widget(Line::from(words), numbers);
        // Bars need integers: thousandths of the largest value.
        let most = percentiles.map_or(1.0, |of| of.max.max(f64::MIN_POSITIVE));
        let share = |value: f64| (1000.0 * value / most).round().clamp(0.0, 1000.0) as u64;
        let columns = recent.columns(usize::from(bars.width));
        let columns = columns.into_iter().map(|value| value.map(share));
        let set = if self.signs == Signs::Ascii {
            ASCII_BARS
        } else {
            bar::NINE_LEVELS
        };
        let chart = Sparkline::default()
            .data(columns.collect::<Vec<Option<u64>>>())
            .max(1000)
            .bar_set(set)
            .absent_value_symbol(" ")
            .style(Style::new().fg(color));
        frame.render_widget(chart, bars);
    }

    /// A line per section: bend, cables, following error.
    fn robot(&self) -> Vec<Line<'static>> {
        let Some(record) = &self.shown.record else {
            return Vec::new();
        };
        let [theta, phi] = if self.signs == Signs::Ascii {
            ["theta", "phi"]
        } else {
            ["θ", "φ"]
        };
        let heading = format!(
            "section  {theta:>7} rad  {phi:>7} rad   cables mm{:20}behind mrad",
            ""
        );
        let mut lines = vec![Line::styled(heading, quiet())];
        for (j, bend) in record
            .present_rad
            .chunks(2)
            .take(record.robot.sections as usize)
            .enumerate()
        {
            let (bend_rad, direction_rad) = (bend[0].hypot(bend[1]), bend[1].atan2(bend[0]));
            let cables = &record.command.cable_length_m[3 * j..3 * j + 3];
            let cables: Vec<_> = cables.iter().map(|m| format!("{:8.2}", 1e3 * m)).collect();
            lines.push(Line::from(format!(
                "{:>7}  {bend_rad:>11.4}  {direction_rad:>11.4}   {}{:>16.2}",
                j + 1,
                cables.join(" "),
                1e3 * record.following_error_rad[j]
            )));
        }
        lines
    }

    fn events(&self, rows: u16) -> Vec<Line<'static>> {
        let line = |line: &super::seen::EventLine| {
            let text = format!("{:>8.1} s  {}", line.time_s, line.text);
            if line.is_bad {
                Line::styled(text, Style::new().fg(Color::Red))
            } else {
                Line::from(text)
            }
        };
        let lines = self.live.newest_lines(usize::from(rows));
        lines.into_iter().map(line).collect()
    }

    fn footer(&self) -> Line<'static> {
        let key = |key: &'static str, does: &'static str| {
            [
                Span::styled(key, Style::new().add_modifier(Modifier::BOLD)),
                Span::from(format!(" {does}  ")),
            ]
        };
        let keys = [
            key("s", "STOP"),
            key("h", "hold"),
            key("t", "track"),
            key("p", if self.is_paused { "go on" } else { "pause" }),
            key("+ -", "zoom"),
            key("q", "quit"),
        ];
        let mut spans: Vec<Span<'static>> = keys.into_iter().flatten().collect();
        if !self.asked.is_empty() {
            let asked: Vec<_> = self.asked.iter().map(|kind| kind.text()).collect();
            spans.push(Span::styled(
                format!("asked for: {}", asked.join(", ")),
                bad(),
            ));
        }
        Line::from(spans)
    }
}

fn identity(status: &Status) -> [String; 3] {
    let missing = realtime_missing(status.realtime_missing);
    [
        text(&status.robot_name),
        RobotLink::text_of(status.link).to_owned(),
        if missing.is_empty() {
            "real time".to_owned()
        } else {
            "no real time".to_owned()
        },
    ]
}

fn mode_style(mode: u32) -> Style {
    let color = match Mode::try_from(mode) {
        Ok(Mode::Tracking | Mode::Homing) => Color::Green,
        Ok(Mode::Holding) => Color::Cyan,
        Ok(Mode::Starting) => Color::Yellow,
        _ => Color::Red,
    };
    Style::new()
        .fg(color)
        .add_modifier(Modifier::REVERSED | Modifier::BOLD)
}

fn quiet() -> Style {
    Style::new().add_modifier(Modifier::DIM)
}

fn bad() -> Style {
    Style::new().fg(Color::Red).add_modifier(Modifier::BOLD)
}

/// Formats any magnitude in at most nine characters.
fn four_digits(value: f64) -> String {
    match value.abs() {
        size if size >= 1000.0 => format!("{value:.0}"),
        size if size >= 1.0 => format!("{value:.2}"),
        size if size >= 1e-3 || size == 0.0 => format!("{value:.4}"),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests;
