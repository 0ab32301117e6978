//! What the footprint says, for people and for programs.

use std::fs;

use anyhow::Result;
use serde::Serialize;

use super::bars::{Bar, svg};
use super::quantity::{MB, QUANTITIES, Quantity, YES_NO};
use super::round::Round;
use crate::csv::csv;
use crate::figures::Figure;
use crate::metric::{Metric, median, range};
use crate::section::{Section, Sheet};
use crate::subject::daemon::program;
use crate::table::Table;

/// What the daemons of some rounds took.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    pub realtime: bool,
    pub rounds: Vec<Round>,
    /// The programs as they lie there.
    pub programs: Vec<Program>,
}

/// A program, with its debug information, as it was built.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Program {
    pub name: &'static str,
    pub bytes: u64,
}

impl Program {
    /// Those that lie beside this one.
    pub fn all() -> Vec<Self> {
        let names = ["cdcrd", "cdcrctl", "cdcr-bench"].into_iter();
        names
            .filter_map(|name| {
                let bytes = fs::metadata(program(name).ok()?).ok()?.len();
                Some(Self { name, bytes })
            })
            .collect()
    }
}

/// A number with its spread, as a row of JSON and CSV.
#[derive(Serialize)]
struct Row {
    #[serde(skip)]
    what: &'static str,
    key: &'static str,
    unit: &'static str,
    median: f64,
    least: f64,
    most: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    target: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reached: Option<bool>,
}

/// A thread: medians over the rounds.
#[derive(Serialize)]
struct ThreadRow {
    name: String,
    idle_percent: f64,
    tracking_percent: f64,
}

#[derive(Serialize)]
struct Document<'a> {
    realtime: bool,
    figures: Vec<Row>,
    threads: Vec<ThreadRow>,
    programs: &'a [Program],
    rounds: &'a [Round],
}

impl Report {
    /// One value of each round that measured it.
    fn values(&self, value: impl Fn(&Round) -> f64) -> Vec<f64> {
        let values = self.rounds.iter().map(value);
        values.filter(|value| value.is_finite()).collect()
    }

    fn rows(&self) -> Vec<Row> {
        let row = |quantity: &Quantity| {
            let values = self.values(quantity.value);
            let middle = median(&values)?;
            let (least, most) = range(&values)?;
            Some(Row {
                what: quantity.what,
                key: quantity.key,
                unit: quantity.unit,
                median: middle,
                least,
                most,
                target: quantity.target,
                reached: quantity.target.map(|target| middle <= target),
            })
        };
        QUANTITIES.iter().filter_map(row).collect()
    }

    /// Share of a core of the threads of this name in each round; nothing where there was none.
    fn share(round: &Round, name: &str) -> (f64, f64) {
        let thread = round.threads.iter().find(|thread| thread.name == name);
        thread.map_or((0.0, 0.0), |t| (t.idle_percent, t.tracking_percent))
    }

    fn thread_rows(&self) -> Vec<ThreadRow> {
        let Some(first) = self.rounds.first() else {
            return Vec::new();
        };
        let row = |name: &String| ThreadRow {
            name: name.clone(),
            idle_percent: median(&self.values(|round| Self::share(round, name).0)).unwrap_or(0.0),
            tracking_percent: median(&self.values(|round| Self::share(round, name).1))
                .unwrap_or(0.0),
        };
        let mut rows: Vec<_> = first
            .threads
            .iter()
            .map(|thread| row(&thread.name))
            .collect();
        rows.sort_by(|a, b| b.tracking_percent.total_cmp(&a.tracking_percent));
        rows
    }

    fn how(&self) -> &'static str {
        if self.realtime {
            ""
        } else {
            ", without SCHED_FIFO and locked memory (not granted)"
        }
    }

    fn figure_table(&self) -> Table {
        let title = format!(
            "What a daemon takes at 200 Hz, three sections: medians of {} daemons{}",
            self.rounds.len(),
            self.how()
        );
        let cells = |row: &Row| {
            let reached = match row.reached {
                Some(true) => "yes",
                Some(false) => "no",
                None => "",
            };
            let target = row
                .target
                .map_or_else(String::new, |target| format!("≤ {target}"));
            let number = |value| {
                if row.unit == YES_NO {
                    yes_no(value)
                } else {
                    short(value)
                }
            };
            vec![
                row.what.to_owned(),
                row.unit.to_owned(),
                number(row.median),
                number(row.least),
                number(row.most),
                target,
                reached.to_owned(),
            ]
        };
        let cells = self.rows().iter().map(cells).collect();
        let heads = [
            "what", "unit", "median", "least", "most", "target", "reached",
        ];
        Table::new(title, &heads, 2, cells)
    }

    fn thread_table(&self) -> Table {
        let cells = |row: &ThreadRow| {
            let us_per_cycle = row.tracking_percent * 50.0;
            vec![
                row.name.clone(),
                format!("{:.3}", row.idle_percent),
                format!("{:.3}", row.tracking_percent),
                format!("{us_per_cycle:.1}"),
            ]
        };
        Table::new(
            format!("Share of a core that each thread uses{}", self.how()),
            &[
                "thread",
                "idle %",
                "tracking %",
                "µs for each cycle of 5 ms, tracking",
            ],
            1,
            self.thread_rows().iter().map(cells).collect(),
        )
    }

    fn program_table(&self) -> Table {
        let cells =
            |program: &Program| vec![program.name.to_owned(), short(program.bytes as f64 / MB)];
        Table::new(
            "Programs, as they were built, with line tables for backtraces",
            &["program", "MB"],
            1,
            self.programs.iter().map(cells).collect(),
        )
    }
}

/// What was so in only some of the rounds is no yes.
fn yes_no(value: f64) -> String {
    let word = if value >= 1.0 { "yes" } else { "no" };
    word.to_owned()
}

/// Three digits behind the point of what is small, none of what is whole.
fn short(value: f64) -> String {
    if value.fract() == 0.0 {
        format!("{value}")
    } else if value.abs() < 10.0 {
        format!("{value:.3}")
    } else {
        format!("{value:.1}")
    }
}

impl Section for Report {
    fn name(&self) -> &'static str {
        "footprint"
    }

    fn heading(&self) -> &'static str {
        "What a daemon takes"
    }

    fn explanation(&self) -> &'static str {
        "<p>Each round starts two daemons with their defaults (200 Hz, three sections), one after the other. For \
         the first one a client looks from the beginning: from it come the times of the start. The second one is \
         measured without any client, then while it tracks the spiral that a client feeds. The share of a core is \
         the time that the kernel counted the thread on a core, by the time that passed; interrupts that came \
         meanwhile are part of it. The real-time core is the sum of the threads cdcr-cycle and cdcr-exchange.</p>\
         <p>Resident memory is VmRSS. It holds all shared memory that the daemon has mapped, because locked \
         memory is always there. \"At the start\" is when the daemon says READY=1, before any client \
         connects. What the first client adds is the memory of its own ports, which the daemon maps when it \
         connects; it has no target. Locked memory is counted by address range and is larger: ranges without \
         access (guard pages) count, too. Whether memory is locked is what the daemon says itself.</p>"
    }

    fn json(&self) -> Result<serde_json::Value> {
        Ok(serde_json::to_value(Document {
            realtime: self.realtime,
            figures: self.rows(),
            threads: self.thread_rows(),
            programs: &self.programs,
            rounds: &self.rounds,
        })?)
    }

    fn tables(&self) -> Vec<Table> {
        vec![
            self.figure_table(),
            self.thread_table(),
            self.program_table(),
        ]
    }

    fn sheets(&self) -> Result<Vec<Sheet>> {
        let sheet = |name: &str, csv| Sheet {
            name: name.to_owned(),
            csv,
        };
        Ok(vec![
            sheet("footprint", csv(&self.rows())?),
            sheet("footprint-threads", csv(&self.thread_rows())?),
            sheet("footprint-programs", csv(&self.programs)?),
        ])
    }

    fn pictures(&self) -> Result<Vec<Figure>> {
        let bar = |row: ThreadRow| Bar {
            label: row.name,
            idle_percent: row.idle_percent,
            tracking_percent: row.tracking_percent,
        };
        let bars: Vec<_> = self.thread_rows().into_iter().map(bar).collect();
        Ok(vec![Figure {
            name: "footprint",
            caption: "Share of one core that each thread of the daemon uses at 200 Hz.".to_owned(),
            svg: svg(&bars),
        }])
    }

    fn metrics(&self) -> Vec<Metric> {
        let quantities = QUANTITIES.iter().map(|quantity| {
            let name = format!("footprint/{}", quantity.key);
            let metric = if quantity.unit == YES_NO {
                Metric::higher
            } else {
                Metric::lower
            };
            metric(name, quantity.unit, self.values(quantity.value))
        });
        let threads = self.thread_rows();
        let threads = threads.iter().map(|row| {
            let name = format!("footprint/thread/{}/tracking", row.name);
            Metric::lower(
                name,
                "%",
                self.values(|round| Self::share(round, &row.name).1),
            )
        });
        let programs = self.programs.iter().map(|program| {
            let name = format!("footprint/program/{}", program.name);
            Metric::lower(name, "MB", [program.bytes as f64 / MB])
        });
        quantities.chain(threads).chain(programs).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(
        clippy::unwrap_used,
        reason = "in a test a panic is the report, in its helpers, too"
    )]

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

    fn report() -> Report {
        Report {
            realtime: true,
            rounds: vec![
                round(1.0, 40_000_000),
                round(9.0, 70_000_000),
                round(2.0, 50_000_000),
            ],
            programs: vec![Program {
                name: "cdcrd",
                bytes: 5_000_000,
            }],
        }
    }

    #[test]
    fn the_core_is_the_sum_of_its_two_threads_and_the_median_counts() {
        let report = report();
        let rows = report.rows();
        assert!((rows[0].median - 2.5).abs() < 1e-9 && rows[0].reached == Some(true));
        assert!((rows[0].least - 1.5).abs() < 1e-9 && (rows[0].most - 9.5).abs() < 1e-9);
        // 4096 bytes came while tracking: that is not none.
        assert_eq!((rows[2].key, rows[2].reached), ("growth_kb", Some(false)));
        assert_eq!((rows[3].key, rows[3].reached), ("page_faults", Some(true)));
    }

    #[test]
    fn memory_is_told_where_it_came() {
        let rows = report().rows();
        let of = |key: &str| rows.iter().find(|row| row.key == key).unwrap();
        assert!((of("resident_start_mb").median - 49.983_616).abs() < 1e-9);
        for (key, kb) in [
            ("growth_idle_kb", 4.096),
            ("growth_by_client_kb", 12.288),
            ("growth_kb", 4.096),
        ] {
            assert!((of(key).median - kb).abs() < 1e-9, "{key}");
        }
        assert!(of("growth_by_client_kb").target.is_none());
    }

    #[test]
    fn memory_is_locked_only_when_it_was_in_every_round() {
        let mut report = report();
        let locked = |report: &Report| {
            let text = report.figure_table().text();
            let mut lines = text.lines();
            let line = lines.find(|line| line.contains("memory locked")).unwrap();
            line.split_ascii_whitespace()
                .filter(|word| ["yes", "no"].contains(word))
                .map(str::to_owned)
                .collect::<Vec<_>>()
        };
        assert_eq!(locked(&report), ["yes", "yes", "yes"]);
        report.rounds[0].memory_locked = false;
        assert_eq!(locked(&report), ["yes", "no", "yes"]);
    }

    #[test]
    fn what_the_kernel_does_not_count_reaches_no_target() {
        let mut report = report();
        for round in &mut report.rounds {
            round.threads.clear();
        }
        let rows = report.rows();
        assert!(rows.iter().all(|row| row.unit != "%"));
        let text = report.figure_table().text();
        let resident = text
            .lines()
            .find(|line| line.contains("resident memory  "))
            .unwrap();
        assert!(resident.contains("≤ 64"), "{text}");
    }

    #[test]
    fn keys_are_unique_and_every_metric_has_a_value_of_each_round() {
        let report = report();
        let metrics = report.metrics();
        let mut names: Vec<_> = metrics.iter().map(|metric| &metric.name).collect();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), metrics.len());
        let per_round = metrics.iter().filter(|metric| metric.rounds.len() == 3);
        assert_eq!(per_round.count(), QUANTITIES.len() + 3);
    }

    #[test]
    fn every_form_has_every_figure() {
        let report = report();
        let json = report.json().unwrap();
        assert_eq!(json["figures"].as_array().unwrap().len(), QUANTITIES.len());
        assert_eq!(json["threads"][0]["name"], "cdcrd");
        let text: String = report.tables().iter().map(Table::text).collect();
        for quantity in &QUANTITIES {
            assert!(text.contains(quantity.what), "{text}");
        }
        let sheets = report.sheets().unwrap();
        assert_eq!(sheets[0].csv.lines().count(), QUANTITIES.len() + 1);
        assert!(report.pictures().unwrap()[0].svg.contains("cdcr-cycle"));
    }
}
