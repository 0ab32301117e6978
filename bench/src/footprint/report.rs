//! What the footprint says, as rows, plots and single numbers.

use std::fs;

use anyhow::Result;
use serde::Serialize;
use serde_json::{Value, json};

use super::quantity::{MB, QUANTITIES, Quantity, YES_NO};
use super::round::Round;
use crate::chart::{BLUE, Curve, GREY, Panel, Scale, sheet};
use crate::dataset::{Column, Dataset, Plot, Sheet, fixed, shorted, word};
use crate::metric::{Better, Metric, median, range};
use crate::subject::daemon::program;

const EXPLANATION: &str = "<p>Each round starts two daemons with their defaults (200 Hz, three sections): for the first one a client \
         looks from the beginning (times of the start), the second one is measured without any client, then while it \
         tracks a spiral. The share of a core is the time that the kernel counted the thread on a core, by the time \
         that passed; the real-time core is the sum of cdcr-cycle and cdcr-exchange.</p>\
         <p>Resident memory is VmRSS, with all shared memory that the daemon has mapped. \"At the start\" is READY=1, before \
         any client; what the first client adds is the memory of its own ports and has no target. Locked memory is \
         counted by address range and is larger. Whether memory is locked (1: in that round) is what the daemon says.</p>";

const QUANTITY_COLUMNS: [Column; 7] = [
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

/// Names and sizes \[bytes\] of our programs, with their debug information, as they were built.
fn programs() -> Vec<(&'static str, u64)> {
    let length = |name| Some((name, fs::metadata(program(name).ok()?).ok()?.len()));
    let names = ["cdcrd", "cdcrctl", "cdcr-bench"];
    names.into_iter().filter_map(length).collect()
}

/// A thread: medians over the rounds.
#[derive(Serialize)]
struct ThreadRow {
    name: String,
    idle_percent: f64,
    tracking_percent: f64,
    tracking_us_per_cycle: f64,
}

pub(super) fn dataset(rounds: &[Round], realtime: bool) -> Result<Dataset> {
    let how = if realtime {
        ""
    } else {
        ", without SCHED_FIFO and locked memory (not granted)"
    };
    let count = rounds.len();
    let title =
        format!("What a daemon takes at 200 Hz, three sections: medians of {count} daemons{how}");
    let (rows, threads, programs) = (rows(rounds), thread_rows(rounds), programs());
    let program_rows: Vec<Value> = programs
        .iter()
        .map(|(name, bytes)| json!({ "name": name, "bytes": bytes, "mb": *bytes as f64 / MB }))
        .collect();
    let mut dataset = Dataset {
        name: "footprint",
        heading: "What a daemon takes",
        explanation: EXPLANATION,
        sheets: vec![
            Sheet::new(&rows)?
                .key("figures")
                .file("footprint")
                .table(title, &QUANTITY_COLUMNS),
            Sheet::new(&threads)?
                .key("threads")
                .file("footprint-threads")
                .table(
                    format!("Share of a core that each thread uses{how}"),
                    &THREAD_COLUMNS,
                ),
            Sheet::new(&program_rows)?
                .key("programs")
                .file("footprint-programs")
                .table(
                    "Programs, as they were built, with line tables for backtraces",
                    &[word("program", "name"), shorted("MB", "mb")],
                ),
            Sheet::new(rounds)?.key("rounds"),
        ],
        plots: vec![Plot {
            name: "footprint",
            caption: "Share of one core that each thread of the daemon uses at 200 Hz, tracking (blue) and idle \
                      (grey).",
            svg: sheet(&[bars(&threads)], 1, 60 * threads.len() as u32 + 260)?,
        }],
        ..Dataset::default()
    };
    dataset.fact("realtime", realtime);
    for quantity in &QUANTITIES {
        let better = if quantity.unit == YES_NO {
            Better::Higher
        } else {
            Better::Lower
        };
        let (name, values) = (
            format!("footprint/{}", quantity.key),
            values(rounds, quantity.value),
        );
        dataset
            .metrics
            .push(Metric::new(name, quantity.unit, better, values));
    }
    for thread in &threads {
        let shares = values(rounds, |round| share(round, &thread.name).1);
        dataset.lower(
            format!("footprint/thread/{}/tracking", thread.name),
            "%",
            shares,
        );
    }
    for (name, bytes) in &programs {
        let name = format!("footprint/program/{name}");
        dataset.lower(name, "MB", [*bytes as f64 / MB]);
    }
    Ok(dataset)
}

/// One value of each round that measured it.
fn values(rounds: &[Round], value: impl Fn(&Round) -> f64) -> impl Iterator<Item = f64> {
    let values = rounds.iter().map(value);
    values.filter(|value| value.is_finite())
}

fn rows(rounds: &[Round]) -> Vec<Value> {
    let row = |quantity: &Quantity| {
        let middle = median(values(rounds, quantity.value))?;
        let (least, most) = range(values(rounds, quantity.value))?;
        let mut row = json!({
            "what": quantity.what,
            "key": quantity.key,
            "unit": quantity.unit,
            "median": middle,
            "least": least,
            "most": most,
        });
        if let Some(target) = quantity.target {
            row["target"] = target.into();
            row["reached"] = (middle <= target).into();
        }
        Some(row)
    };
    QUANTITIES.iter().filter_map(row).collect()
}

/// Share of a core of the threads of this name, idle and tracking; nothing where there was none.
fn share(round: &Round, name: &str) -> (f64, f64) {
    let thread = round.threads.iter().find(|thread| thread.name == name);
    thread.map_or((0.0, 0.0), |t| (t.idle_percent, t.tracking_percent))
}

fn thread_rows(rounds: &[Round]) -> Vec<ThreadRow> {
    let threads = rounds.first().into_iter().flat_map(|round| &round.threads);
    let row = |name: &String| {
        let middle = |value: fn((f64, f64)) -> f64| {
            median(values(rounds, |round| value(share(round, name)))).unwrap_or(0.0)
        };
        let tracking_percent = middle(|share| share.1);
        ThreadRow {
            name: name.clone(),
            idle_percent: middle(|share| share.0),
            tracking_percent,
            tracking_us_per_cycle: 50.0 * tracking_percent,
        }
    };
    let mut rows: Vec<_> = threads.map(|thread| row(&thread.name)).collect();
    rows.sort_by(|a, b| b.tracking_percent.total_cmp(&a.tracking_percent));
    rows
}

/// One pair of bars for each thread, the busiest on top.
fn bars(threads: &[ThreadRow]) -> Panel {
    let mut curves = Vec::new();
    for (index, row) in threads.iter().enumerate() {
        let bar = |y: f64, percent: f64, label: String, colour| {
            Curve::line(label, vec![(0.0, y), (percent.max(0.0), y)], colour).width(12)
        };
        let y = (threads.len() - index) as f64;
        let (name, tracking, idle) = (&row.name, row.tracking_percent, row.idle_percent);
        let label = format!(
            "{}: {name} {tracking:.3} %, idle {idle:.3} %",
            threads.len() - index
        );
        curves.push(bar(y + 0.15, tracking, label, BLUE));
        curves.push(bar(y - 0.15, idle, String::new(), GREY));
    }
    Panel {
        title: "Share of a core".to_owned(),
        x: "[%]",
        y: "thread",
        scale: Scale::Linear,
        curves,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::footprint::{Files, Memory, Start, ThreadUse};

    fn round(cycle_percent: f64, resident_bytes: u64) -> Round {
        let memory = |resident_bytes| Memory {
            resident_bytes,
            peak_bytes: resident_bytes,
            locked_bytes: 2 * resident_bytes,
            own_bytes: resident_bytes,
            file_bytes: 0,
            shared_bytes: 0,
            minor_faults: 7,
            major_faults: 0,
            descriptors: None,
        };
        let thread = |name: &str, tracking_percent| ThreadUse {
            name: name.to_owned(),
            idle_percent: 0.1,
            tracking_percent,
        };
        Round {
            start: Start {
                first_release_ms: 30.0,
                ready_ms: 40.0,
                first_record_ms: 50.0,
            },
            threads: vec![
                thread("cdcrd", 5.0),
                thread("cdcr-cycle", cycle_percent),
                thread("cdcr-exchange", 0.5),
            ],
            memory_locked: true,
            after_start: memory(resident_bytes - 16_384),
            before_client: memory(resident_bytes - 12_288),
            before_tracking: memory(resident_bytes),
            after_tracking: memory(resident_bytes + 4096),
            shared_memory: Files::default(),
            root: Files::default(),
        }
    }

    fn rounds() -> [Round; 3] {
        [
            round(1.0, 40_000_000),
            round(9.0, 70_000_000),
            round(2.0, 50_000_000),
        ]
    }

    #[test]
    fn the_core_is_the_sum_of_its_two_threads_and_the_median_counts() {
        let mut rounds = rounds();
        rounds[0].memory_locked = false;
        let rows = rows(&rounds);
        let of = |key: &str| rows.iter().find(|row| row["key"] == key).unwrap();
        for (key, median, least, most) in [
            ("core_tracking_percent", 2.5, 1.5, 9.5),
            ("locked", 1.0, 0.0, 1.0),
            ("page_faults", 0.0, 0.0, 0.0),
            ("growth_idle_kb", 4.096, 4.096, 4.096),
            ("growth_by_client_kb", 12.288, 12.288, 12.288),
            ("growth_kb", 4.096, 4.096, 4.096),
        ] {
            let row = of(key);
            for (name, value) in [("median", median), ("least", least), ("most", most)] {
                let found = row[name].as_f64().unwrap();
                assert!((found - value).abs() < 1e-9, "{row}");
            }
        }
        assert_eq!(of("core_tracking_percent")["reached"], true);
        // 4096 bytes came while tracking: that is not none.
        assert_eq!(of("growth_kb")["reached"], false);
        assert_eq!(of("page_faults")["reached"], true);
        assert!(of("growth_by_client_kb").get("target").is_none());
    }
}
