//! Resources of a daemon: cores, memory, files, start-up time.
//!
//! Each round starts a daemon with its defaults (200 Hz, three sections) for the start-up times, and a second
//! one for the usage. Memory of the second is read at `READY=1`, before any client connects. Then the daemon
//! is measured without a client, then while it tracks. All counts are the kernel's: core time from
//! `/proc/PID/task/TID/schedstat`, memory from `/proc/PID/status`.

mod daemon;

use std::time::Duration;

use anyhow::{Result, ensure};
use cdcr_process::program;
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::chart::{BLUE, Curve, GREY, Panel, Scale, plot};
use crate::dataset::{
    Column, Dataset, Sheet, each, fixed, joined, number, shorted, together, word,
};
use crate::metric::{median, range};
use crate::progress::Progress;
use crate::subject::daemon::Launch;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use daemon::MB;

/// Duration of the measurement without a client, as a share of that with tracking.
const IDLE_SHARE: f64 = 0.4;
/// Approximate time for start, begin of tracking, warm-up and end \[s\].
const AROUND_S: f64 = 2.3;
/// Shortest duration for meaningful kernel counts.
const LEAST: Duration = Duration::from_millis(100);
const MOST: Duration = Duration::from_secs(3600);

const YES_NO: &str = "yes/no";

const EXPLANATION: &str = include_str!("footprint.html");

/// All quantities: description, key ending in the unit, unit, and upper limit. Those with a target come
/// first.
#[rustfmt::skip]
const QUANTITIES: [(&str, &str, &str, Option<f64>); 22] = [
    ("real-time core, tracking", "core_tracking_percent", "%", Some(3.0)),
    ("resident memory", "resident_mb", "MB", Some(64.0)),
    ("resident memory added while tracking", "growth_kb", "kB", Some(0.0)),
    ("page faults while tracking", "page_faults", "", Some(0.0)),
    ("resident at the start", "resident_start_mb", "MB", None),
    ("resident memory added without a client", "growth_idle_kb", "kB", None),
    ("resident memory added by the first client", "growth_by_client_kb", "kB", None),
    ("memory locked", "locked", YES_NO, None),
    ("real-time core, idle", "core_idle_percent", "%", None),
    ("all threads, tracking", "all_tracking_percent", "%", None),
    ("all threads, idle", "all_idle_percent", "%", None),
    ("most that ever was resident", "peak_mb", "MB", None),
    ("resident: heap and stacks", "own_mb", "MB", None),
    ("resident: shared memory", "shared_mb", "MB", None),
    ("resident: program and libraries", "file_mb", "MB", None),
    ("locked, by address range", "locked_mb", "MB", None),
    ("files in shared memory", "memory_files", "", None),
    ("shared memory in use", "memory_stored_mb", "MB", None),
    ("files below the root folder", "root_files", "", None),
    ("start to first release", "first_release_ms", "ms", None),
    ("start to first good cycle (READY=1)", "ready_ms", "ms", None),
    ("start to first record at a client", "first_record_ms", "ms", None),
];

const COLUMNS: [Column; 7] = [
    word("what", "what"),
    word("unit", "unit"),
    shorted("median", "median"),
    shorted("least", "least"),
    shorted("most", "most"),
    shorted("target ≤", "target"),
    word("reached", "reached"),
];

const THREAD_COLUMNS: [Column; 4] = [
    word("thread", "name"),
    fixed("idle %", "idle_percent", 3),
    fixed("tracking %", "tracking_percent", 3),
    fixed(
        "µs for each cycle of 5 ms, tracking",
        "tracking_us_per_cycle",
        1,
    ),
];

const PROGRAM_COLUMNS: [Column; 2] = [word("program", "name"), shorted("MB", "mb")];

#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct FootprintOptions {
    /// Number of daemons, measured one after the other, 1 to 100.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Tracking time per daemon, 100ms to 1h; without a client it is measured for 2/5 of that.
    #[arg(long, default_value = "10s", value_parser = humantime::parse_duration)]
    duration: Duration,
    /// Run two daemons for two seconds each; not a measurement.
    #[arg(long, conflicts_with_all = ["rounds", "duration"])]
    quick: bool,
}

impl FootprintOptions {
    fn round_s(&self) -> f64 {
        self.duration.as_secs_f64() * (1.0 + IDLE_SHARE) + AROUND_S
    }
}

impl Benchmark for FootprintOptions {
    fn quicken(&mut self) {
        (self.rounds, self.duration) = (2, Duration::from_secs(2));
    }

    fn is_quick(&self) -> bool {
        self.quick
    }

    fn rounds_mut(&mut self) -> &mut u32 {
        &mut self.rounds
    }

    fn check(&self) -> Result<()> {
        let is_sound = (LEAST..=MOST).contains(&self.duration);
        ensure!(is_sound, "--duration must be 100ms to 1h");
        Ok(())
    }

    fn expected_s(&self) -> f64 {
        f64::from(self.rounds) * self.round_s()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let cores = Cores::find()?;
        cores.stay_off();
        let realtime = may_be_realtime();
        let launch = Launch::patient(None).placed(&cores, realtime);
        let idle = self.duration.mul_f64(IDLE_SHARE);
        let mut rounds = Vec::new();
        for round in 1..=self.rounds {
            progress.begin(&format!("daemon {round} of {}", self.rounds));
            let start = daemon::start_times(&launch, &cores)?;
            let usage = daemon::usage(&launch, &cores, idle, self.duration)?;
            rounds.push(joined([start, usage]));
            progress.advance(self.round_s());
        }
        dataset(rounds, realtime)
    }
}

fn dataset(rounds: Vec<Value>, realtime: bool) -> Result<Dataset> {
    let how = if realtime {
        ""
    } else {
        ", without SCHED_FIFO and locked memory (not granted)"
    };
    let mut dataset = Dataset::new("footprint", "What a daemon takes", EXPLANATION);
    dataset.fact("realtime", realtime);
    for (_, key, unit, _) in QUANTITIES {
        let (name, values) = (format!("footprint/{key}"), each(&rounds, key));
        if unit == YES_NO {
            dataset.higher(name, unit, values);
        } else {
            dataset.lower(name, unit, values);
        }
    }
    let figures = figures(&rounds);
    #[rustfmt::skip]
    let targets = [
        (["CPU of the real-time core at 200 Hz, tracking", "≤ 3 %", "%"], "core_tracking_percent", "median", f64::MIN..=3.0),
        (["resident memory", "≤ 64 MB", "MB"], "resident_mb", "median", f64::MIN..=64.0),
        (["resident memory that tracking adds", "0", "kB"], "growth_kb", "median", f64::MIN..=0.0),
        (["memory is locked (1: in every round)", "1", ""], "locked", "least", 1.0..=1.0),
    ];
    for (words, key, value, reached) in targets {
        let row = figures.iter().find(|row| row["key"] == key);
        let found = row.and_then(|row| {
            Some((
                row[value].as_f64()?,
                json!([row["least"], row["most"]]),
                String::new(),
            ))
        });
        dataset.target(words, found, reached);
    }
    let (threads, programs) = (threads(&rounds), programs());
    for name in threads.iter().filter_map(|thread| thread["name"].as_str()) {
        let key = format!("threads_{name}_tracking_percent");
        let values = each(&rounds, &key);
        dataset.lower(format!("footprint/thread/{name}/tracking"), "%", values);
    }
    for program in &programs {
        let name = program["name"].as_str().unwrap_or_default();
        let size = number(program, "mb");
        dataset.lower(format!("footprint/program/{name}"), "MB", size);
    }
    dataset.plots.push(plot(
        "footprint",
        "Share of one core that each thread of the daemon uses at 200 Hz, tracking (blue) and idle (grey).",
        (1, 60 * threads.len() as u32 + 260),
        &[bars(&threads)],
    )?);
    let count = rounds.len();
    let title =
        format!("What a daemon takes at 200 Hz, three sections: medians of {count} daemons{how}");
    let of_threads = format!("Share of a core that each thread uses{how}");
    let of_programs = "Programs, as they were built, with line tables for backtraces";
    dataset.sheets = vec![
        Sheet::of(&title, &COLUMNS, figures)
            .key("figures")
            .file("footprint"),
        Sheet::of(&of_threads, &THREAD_COLUMNS, threads)
            .key("threads")
            .file("footprint-threads"),
        Sheet::of(of_programs, &PROGRAM_COLUMNS, programs)
            .key("programs")
            .file("footprint-programs"),
        Sheet::of("", &[], rounds).key("rounds"),
    ];
    Ok(dataset)
}

fn figures(rounds: &[Value]) -> Vec<Value> {
    let row = |(what, key, unit, target): (&str, &str, &str, Option<f64>)| {
        let (middle, (least, most)) = (median(each(rounds, key))?, range(each(rounds, key))?);
        Some(json!({
            "what": what,
            "key": key,
            "unit": unit,
            "median": middle,
            "least": least,
            "most": most,
            "target": target,
            "reached": target.map(|target| middle <= target),
        }))
    };
    QUANTITIES.into_iter().filter_map(row).collect()
}

fn threads(rounds: &[Value]) -> Vec<Value> {
    let all = together(rounds, &[]);
    let row = |(name, shares): (&String, &Value)| {
        let percent = number(shares, "tracking_percent").unwrap_or(0.0);
        json!({
            "name": name,
            "idle_percent": shares["idle_percent"],
            "tracking_percent": percent,
            "tracking_us_per_cycle": 50.0 * percent,
        })
    };
    let mut threads: Vec<Value> = all["threads"]
        .as_object()
        .into_iter()
        .flatten()
        .map(row)
        .collect();
    let percent = |row: &Value| number(row, "tracking_percent").unwrap_or(0.0);
    threads.sort_by(|one, other| percent(other).total_cmp(&percent(one)));
    threads
}

fn programs() -> Vec<Value> {
    let row = |name| {
        let bytes = std::fs::metadata(program(name).ok()?).ok()?.len();
        Some(json!({ "name": name, "bytes": bytes, "mb": bytes as f64 / MB }))
    };
    ["cdcrd", "cdcrctl", "cdcr-bench"]
        .into_iter()
        .filter_map(row)
        .collect()
}

/// One pair of bars for each thread, the busiest on top.
fn bars(threads: &[Value]) -> Panel {
    let mut curves = Vec::new();
    for (row, line) in threads.iter().zip((1..=threads.len()).rev()) {
        let [tracking, idle] =
            ["tracking_percent", "idle_percent"].map(|key| number(row, key).unwrap_or(0.0));
        let name = row["name"].as_str().unwrap_or_default();
        let label = format!("{line}: {name} {tracking:.3} %, idle {idle:.3} %");
        for (y, percent, label, colour) in [
            (0.15, tracking, label, BLUE),
            (-0.15, idle, String::new(), GREY),
        ] {
            let y = line as f64 + y;
            curves
                .push(Curve::line(label, vec![(0.0, y), (percent.max(0.0), y)], colour).width(12));
        }
    }
    Panel::new(
        "Share of a core",
        ["share of a core [%]", "thread"],
        Scale::Linear,
        curves,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_the_rounds_is_what_a_target_is_for() {
        let rounds = [(1.5, 4.096), (9.5, 4.096), (2.5, 4.096)].map(|(core, growth)| {
            let threads = json!({ "a": { "tracking_percent": core, "idle_percent": 0.1 }, "b": { "tracking_percent": 2.0 } });
            json!({ "core_tracking_percent": core, "growth_kb": growth, "page_faults": 0.0, "peak_mb": 1.0, "threads": threads })
        });
        let rows = figures(&rounds);
        let says = |key: &str, numbers: [f64; 3], reached: Value| {
            let row = rows.iter().find(|row| row["key"] == key).unwrap();
            let found = ["median", "least", "most"].map(|name| row[name].as_f64().unwrap());
            assert_eq!((found, &row["reached"]), (numbers, &reached), "{key}");
        };
        says("core_tracking_percent", [2.5, 1.5, 9.5], json!(true));
        // 4096 bytes were added while tracking: the target is zero.
        says("growth_kb", [4.096; 3], json!(false));
        says("page_faults", [0.0; 3], json!(true));
        says("peak_mb", [1.0; 3], json!(null));
        assert_eq!(rows.len(), 4, "what was not measured has no row");
        let threads = threads(&rounds);
        assert_eq!(threads[0]["name"], "a");
        assert_eq!(threads[0]["tracking_us_per_cycle"], 125.0);
    }
}
