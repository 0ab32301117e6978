//! The loop without work: `cdcrd bare` as a real process.

use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

use cdcr_shared_types::BARE_COLUMNS;
use cdcr_shared_types::codes::LateCause;
use cdcr_tests::threads::find_thread;
use cdcr_tests::{Place, Program, text, wait_until};
use rustix::process::Signal;

const PERIOD_NS: u64 = 5_000_000;

fn bare(place: &Place, arguments: &[&str]) -> Command {
    let mut command = place.command("cdcrd");
    command.arg("bare").args(arguments);
    command
}

/// One line of CSV.
struct CycleRow {
    cycle: u64,
    due_ns: u64,
    start_ns: u64,
    handed_over_ns: u64,
    skipped_periods: u64,
    late_start: bool,
    deadline_miss: bool,
    cause: u32,
}

fn lines(csv: &str) -> Vec<CycleRow> {
    let mut lines = csv.lines();
    assert_eq!(lines.next(), Some(BARE_COLUMNS));
    lines.map(line).collect()
}

fn line(line: &str) -> CycleRow {
    let columns: Vec<&str> = line.split(',').collect();
    assert_eq!(columns.len(), BARE_COLUMNS.split(',').count(), "{line}");
    let number = |index: usize| columns[index].parse::<u64>().unwrap();
    let flag = |index: usize| match columns[index] {
        "0" => false,
        "1" => true,
        other => panic!("{other} is not a flag: {line}"),
    };
    // Both are present, or neither where the kernel does not count them.
    assert_eq!(columns[7].is_empty(), columns[8].is_empty(), "{line}");
    for count in [columns[7], columns[8]] {
        assert!(count.is_empty() || count.parse::<u64>().is_ok(), "{line}");
    }
    CycleRow {
        cycle: number(0),
        due_ns: number(1),
        start_ns: number(2),
        handed_over_ns: number(3),
        skipped_periods: number(4),
        late_start: flag(5),
        deadline_miss: flag(6),
        cause: number(9) as u32,
    }
}

#[test]
fn every_cycle_lies_on_the_grid_and_nothing_in_shared_memory() {
    let place = Place::new();
    let mut program = Program::start(&mut bare(
        &place,
        &["--duration", "0.5s", "--format", "csv"],
    ));
    while program.runs() {
        assert_eq!(place.memory_files(), Vec::<PathBuf>::new());
        std::thread::sleep(Duration::from_millis(10));
    }
    let output = program.output();
    assert!(output.status.success(), "{}", text(&output));
    assert!(!place.location().root().exists(), "a root folder was made");
    let lines = lines(&String::from_utf8(output.stdout).unwrap());
    let (first, last) = (lines.first().unwrap(), lines.last().unwrap());
    assert!(last.cycle >= 100, "100 periods are half a second");
    let skipped: u64 = lines.iter().map(|line| line.skipped_periods).sum();
    assert_eq!(lines.len() as u64 + skipped, last.cycle);
    for line in &lines {
        assert!((line.due_ns - first.due_ns).is_multiple_of(PERIOD_NS));
        assert!(line.due_ns <= line.start_ns && line.start_ns <= line.handed_over_ns);
        assert_eq!(line.late_start, line.start_ns - line.due_ns > 1_000_000);
        let response_ns = line.handed_over_ns - line.due_ns;
        assert_eq!(line.deadline_miss, response_ns > PERIOD_NS);
        let is_bad = line.late_start || line.deadline_miss || line.skipped_periods > 0;
        assert_eq!(line.cause != LateCause::None.code(), is_bad);
    }
    for pair in lines.windows(2) {
        let [before, after] = pair else { continue };
        assert_eq!(after.cycle, before.cycle + 1 + after.skipped_periods);
        assert!(before.handed_over_ns < after.due_ns);
    }
}

#[test]
fn a_signal_ends_it_early_with_what_there_is() {
    for signal in [Signal::TERM, Signal::INT] {
        let place = Place::new();
        let mut program = Program::start(&mut bare(&place, &["--duration", "1h"]));
        // It handles signals before it starts its thread.
        wait_until("its thread", || {
            find_thread(program.id(), "cdcr-cycle").is_some()
        });
        program.signal(signal);
        let output = program.output();
        assert!(output.status.success(), "{}", text(&output));
        let table = String::from_utf8(output.stdout).unwrap();
        for part in ["cycles", "skipped periods", "wake-up", "p99.9", "real time"] {
            assert!(table.contains(part), "{part}: {table}");
        }
    }
}

#[test]
fn what_cannot_be_granted_or_recorded_is_refused() {
    let place = Place::new();
    let refused = |arguments: &[&str]| {
        let output = bare(&place, arguments).output().unwrap();
        assert!(output.stdout.is_empty(), "{}", text(&output));
        (output.status.code(), text(&output))
    };
    let require = ["--set", "realtime.mode=require", "--set"];
    // No test machine has a core 1000.
    let (status, message) = refused(&[&require[..], &["realtime.core=1000"]].concat());
    assert_eq!(status, Some(77), "{message}");
    assert!(message.contains("core pinning is missing"), "{message}");
    let (status, message) = refused(&["--duration", "15h"]);
    assert_eq!(status, Some(2), "{message}");
    assert!(message.contains("10 million"), "{message}");
    let (status, message) = refused(&["--duration", "1ms"]);
    assert_eq!(status, Some(2), "{message}");
    assert!(message.contains("shorter than one period"), "{message}");
    let (status, message) = refused(&["--duration", "soon"]);
    assert_eq!(status, Some(2), "{message}");
}
