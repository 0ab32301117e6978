use cdcr_shared_types::Obstacle;
use cdcr_shared_types::codes::{LateCause, SolverStatus, timing};
use ratatui::Terminal;
use ratatui::backend::TestBackend;

use super::*;
use crate::dry_run::tests::robot;

/// Two seconds of a robot with three sections that moves along x, with an obstacle at its tip and one late
/// cycle.
fn seen() -> Seen {
    let mut seen = Seen::default();
    for k in 0..400_u64 {
        let mut record = Telemetry {
            cycle: k,
            release_ns: 1_000_000_000 + 5_000_000 * k,
            due_ns: 1_000_000_000 + 5_000_000 * k,
            period_ns: 5_000_000,
            deadline_ns: 4_500_000,
            handed_over_ns: 1_000_300_000 + 5_000_000 * k,
            solve_start_ns: 1_000_100_000,
            solve_end_ns: 1_000_150_000,
            mode: Mode::Tracking.code(),
            position_error_m: 1e-5,
            obstacle_count: 1,
            robot: robot(3),
            ..Telemetry::default()
        };
        record.report.status = SolverStatus::Converged.code();
        record.settings.safe_distance_m = 0.01;
        record.command.cable_length_m[..9].fill(0.3);
        let x = 0.1 * k as f64 / 400.0;
        record.present_rad[0] = x;
        record.tip_position_m = [x, 0.0, 0.9];
        record.reference.position_m = [x, 0.0, 0.9];
        record.obstacles[0] = Obstacle {
            start_m: [0.0, 0.0, 0.8],
            end_m: [0.0, 0.0, 0.8],
            radius_m: 0.05,
            ..Obstacle::default()
        };
        if k == 300 {
            record.timing_flags = timing::DEADLINE_MISS;
            record.scheduling.late_cause = LateCause::Load.code();
            record.handed_over_ns += 7_000_000;
        }
        seen.note(&record, 0);
    }
    seen
}

fn drawn(seen: &Seen, columns: u16, rows: u16, signs: Signs) -> Vec<String> {
    let screen = Screen {
        live: seen,
        shown: seen,
        is_paused: false,
        zoom: 1.0,
        signs,
        asked: &[RequestKind::Hold],
        silent: None,
    };
    let mut terminal = Terminal::new(TestBackend::new(columns, rows)).expect("a terminal");
    terminal.draw(|frame| screen.draw(frame)).expect("it draws");
    let buffer = terminal.backend().buffer();
    let rows = buffer.area.rows();
    let text = |row: Rect| {
        row.positions()
            .map(|place| buffer[place].symbol().to_owned())
    };
    rows.map(|row| text(row).collect::<String>().trim_end().to_owned())
        .collect()
}

#[test]
fn a_terminal_of_80_columns_shows_all_of_it() {
    let lines = drawn(&seen(), COLUMNS_MIN, ROWS_MIN, Signs::Braille);
    let page = lines.join("\n");
    for words in [
        "TRACKING",
        "200.0 Hz",
        "error 0.0100 mm",
        "obstacles 1",
        "last late 0 s ago",
        "side x, z",
        "front y, z",
        "top x, y",
        "deadline 4500",
        "p50 300.00 p99 300.00 max 7300",
        "max 50.00",
        "θ",
        "300.00",
        "deadline missed",
        "s STOP",
        "asked for: hold",
    ] {
        assert!(page.contains(words), "{words}:\n{page}");
    }
    // A bar of the miss in the chart of response times, and dots in the picture.
    assert!(
        page.contains('█') && page.chars().any(|sign| ('⠁'..='⣿').contains(&sign)),
        "{page}"
    );
    assert_eq!(
        lines
            .iter()
            .filter(|line| line.contains("   1    "))
            .count(),
        1,
        "{page}"
    );
}

#[test]
fn a_terminal_without_unicode_gets_ascii_alone() {
    for (columns, rows) in [(80, 24), (200, 60)] {
        let page = drawn(&seen(), columns, rows, Signs::Ascii).join("\n");
        assert!(page.is_ascii(), "{page}");
        assert!(
            page.contains('T') && page.contains('#') && page.contains("theta"),
            "{page}"
        );
    }
}

#[test]
fn a_small_terminal_gets_a_sentence_and_none_a_panic() {
    for (columns, rows) in [(79, 24), (80, 23), (20, 10)] {
        let page = drawn(&seen(), columns, rows, Signs::Braille).join(" ");
        assert!(
            page.contains("needs 80") && page.contains("stops"),
            "{page}"
        );
    }
    for (columns, rows) in [(0, 0), (1, 1), (3, 100)] {
        drawn(&seen(), columns, rows, Signs::Braille);
    }
    drawn(&Seen::default(), 80, 24, Signs::Braille);
}

#[test]
fn a_paused_or_silent_screen_is_marked() {
    let seen = seen();
    let mut screen = Screen {
        live: &seen,
        shown: &seen,
        is_paused: true,
        zoom: 2.0,
        signs: Signs::Braille,
        asked: &[],
        silent: None,
    };
    let words = |screen: &Screen<'_>| screen.header()[0].to_string();
    assert!(words(&screen).contains("PAUSED"));
    screen.silent = Some("no daemon is running\nstart one");
    assert_eq!(words(&screen), "no daemon is running");
}

#[test]
fn numbers_of_every_size_are_short() {
    for (value, text) in [
        (0.0, "0.0000"),
        (1.2e-9, "1.2e-9"),
        (0.012_345, "0.0123"),
        (12.345, "12.35"),
        (123_456.7, "123457"),
    ] {
        assert_eq!(four_digits(value), text);
    }
}

#[test]
fn the_cause_of_a_late_cycle_fits_into_the_narrowest_screen() {
    let mut seen = seen();
    let record = seen.record.as_mut().expect("a record");
    record.deadline_misses_total = 123_456;
    record.skipped_periods_total = 123_456;
    let page = drawn(&seen, COLUMNS_MIN, ROWS_MIN, Signs::Ascii).join("\n");
    assert!(page.contains("another task had the core"), "{page}");
}
