//! What the rates say, for people and for programs.

use anyhow::Result;
use serde::Serialize;

use super::case::Case;
use super::figures::Figures;
use super::rows::{ShortestRow, StepRow, rate_hz};
use super::trial::Trial;
use super::{Shortest, Step, Tally};
use crate::chart::{BLUE, Curve, DARK, GREEN, ORANGE, Panel, Scale, sheet};
use crate::csv::csv;
use crate::figures::Figure;
use crate::metric::Metric;
use crate::section::{Recording, Section, Sheet};
use crate::table::Table;

const STEP_HEADS: [&str; 20] = [
    "rate",
    "held in rounds",
    "remarks",
    "wake-up p50 µs",
    "p99 µs",
    "solve p50 µs",
    "response p50 µs",
    "p99 µs",
    "p99.9 µs",
    "core %",
    "cut short %",
    "stale %",
    "own misses",
    "late cycles",
    "beyond the period",
    "skipped",
    "of cycles",
    "lost %",
    "followed %",
    "error p99 mm",
];

const SHORTEST_HEADS: [&str; 16] = [
    "solver",
    "what ends it",
    "N",
    "sections",
    "shortest ms",
    "held in trials",
    "response p50 µs",
    "p99 µs",
    "p99.9 µs",
    "core %",
    "cut short %",
    "beyond the period",
    "skipped",
    "of cycles",
    "lost %",
    "error p99 mm",
];

/// How the default does with each of its periods, and the shortest period of each case.
#[derive(Debug)]
pub struct Report {
    /// Whether the daemons had real time.
    pub realtime: bool,
    /// How long they spun before each release \[µs\], at most a quarter of the period.
    pub spin_us: f64,
    pub begin_ns: u64,
    pub steps: Vec<Step>,
    pub shortest: Vec<Shortest>,
    /// All trials of the search, in their order.
    pub trials: Vec<Trial>,
}

#[derive(Serialize)]
struct Document<'a> {
    realtime: bool,
    spin_us: f64,
    default: Vec<StepRow>,
    default_rounds: Vec<&'a Trial>,
    shortest: Vec<ShortestRow<'a>>,
    trials: &'a [Trial],
}

impl Report {
    fn step_rows(&self) -> Vec<StepRow> {
        self.steps.iter().map(Step::row).collect()
    }

    fn shortest_rows(&self) -> Vec<ShortestRow<'_>> {
        self.shortest.iter().map(Shortest::row).collect()
    }

    fn how(&self) -> String {
        let spin = if self.spin_us > 0.0 {
            format!(
                ", spinning {} µs (at most a quarter of the period)",
                self.spin_us
            )
        } else {
            String::new()
        };
        if self.realtime {
            spin
        } else {
            format!("{spin}, without SCHED_FIFO (not granted)")
        }
    }

    fn step_table(&self) -> Table {
        let title = format!(
            "The default ({}) with shorter and shorter periods, medians over rounds{}",
            Case::DEFAULT.name(),
            self.how()
        );
        let cells = |row: &StepRow| {
            let mut cells = vec![
                format!("{} Hz", row.rate_hz.round()),
                format!("{} of {}", row.rounds_held, row.rounds),
                remarks(&row.remarks),
            ];
            let times_us = [
                row.wake_p50_us,
                row.wake_p99_us,
                row.solve_p50_us,
                row.response_p50_us,
                row.response_p99_us,
                row.response_p999_us,
            ];
            cells.extend(times_us.map(us));
            let shares = [row.core_share, row.budget_hit_share, row.stale_input_share];
            cells.extend(shares.map(percent));
            cells.extend(
                [
                    row.own_misses,
                    row.late_cycles,
                    row.deadline_misses,
                    row.skipped_periods,
                ]
                .map(|n| n.to_string()),
            );
            cells.push(row.cycles.to_string());
            cells.push(lost_percent(row.lost_share));
            cells.push(percent(row.tracking_share_least));
            cells.push(error_mm(row.error_p99_mm));
            cells
        };
        Table::new(
            title,
            &STEP_HEADS,
            3,
            self.step_rows().iter().map(cells).collect(),
        )
    }

    fn shortest_table(&self) -> Table {
        let cells = |shortest: &Shortest| {
            let case = shortest.case;
            let figures = shortest
                .held
                .as_ref()
                .and_then(|trial| trial.figures.as_ref());
            let number = |cell: fn(&Figures) -> String| figures.map_or_else(dash, cell);
            vec![
                case.solver.name().to_owned(),
                ended_by(shortest),
                case.horizon_steps.to_string(),
                case.sections.to_string(),
                shortest.period_ms().map_or_else(dash, |ms| ms.to_string()),
                held_in(shortest.held_tally),
                number(|f| us(f.response_us.p50)),
                number(|f| us(f.response_us.p99)),
                number(|f| us(f.response_us.p999)),
                number(|f| percent(f.core_share())),
                number(|f| percent(f.budget_hit_share)),
                number(|f| f.deadline_misses.to_string()),
                number(|f| f.skipped_periods.to_string()),
                number(|f| f.cycles.to_string()),
                number(|f| lost_percent(f.lost_share())),
                number(|f| error_mm(f.error_p99_mm)),
            ]
        };
        Table::new(
            format!("Shortest period that holds{}", self.how()),
            &SHORTEST_HEADS,
            2,
            self.shortest.iter().map(cells).collect(),
        )
    }
}

/// Why the next shorter period failed.
fn ended_by(shortest: &Shortest) -> String {
    match (&shortest.failed, &shortest.held) {
        (Some(failed), _) => format!(
            "{} ms, held in {} trials: {}",
            failed.period_ms,
            held_in(shortest.failed_tally),
            remarks(&failed.remarks)
        ),
        (None, Some(_)) => "nothing: no shorter one was tried".to_owned(),
        (None, None) => dash(),
    }
}

/// How many of the trials held.
fn held_in(tally: Tally) -> String {
    match tally.trials {
        0 => dash(),
        trials => format!("{} of {trials}", tally.held),
    }
}

fn remarks(text: &str) -> String {
    if text.is_empty() {
        dash()
    } else {
        text.to_owned()
    }
}

fn dash() -> String {
    "-".to_owned()
}

fn us(value: f64) -> String {
    finite(value, format!("{value:.1}"))
}

fn percent(share: f64) -> String {
    finite(share, format!("{:.1}", 100.0 * share))
}

/// Next to a limit of 0.1 %.
fn lost_percent(share: f64) -> String {
    finite(share, format!("{:.3}", 100.0 * share))
}

fn error_mm(value: f64) -> String {
    finite(value, format!("{value:.1e}"))
}

/// A value that was not measured is no number.
fn finite(value: f64, text: String) -> String {
    if value.is_finite() { text } else { dash() }
}

impl Section for Report {
    fn name(&self) -> &'static str {
        "rate"
    }

    fn heading(&self) -> &'static str {
        "How fast the loop can go"
    }

    fn explanation(&self) -> &'static str {
        "<p>A period holds when, of a daemon that really tracks the spiral, at most 0.1 % of the releases were lost \
         (no cycle, or a command handed over after the end of the period), and no cycle was late by the \
         daemon's own doing (cause compute or page fault). The figures are the daemon's own statistics of at least \
         2 s and 4000 periods after a warm-up. The periods are 5, 2, 1, 0.5, 0.25, 0.2 and 0.1 ms.</p>\
         <p>A late cycle of the daemon's own doing decides at once. A trial that only lost releases is tried once \
         more; up to twice where the machine lost them (it came late, stood still or ran another task) while the \
         work itself (p99.9 from start to hand-over, and the median wake-up) fits into the period. What still \
         fails then, failed on this machine. Every trial is kept in JSON and CSV.</p>\
         <p>A solve ends with its time, so a period can hold with solves that were cut short. Their share \
         stands beside it, and so does the distance of the tip from its reference: that is what the \
         shorter period costs. Core % is what the cycle and the exchange use together of their core; Linux \
         halts real-time threads beyond 95 %.</p>"
    }

    fn json(&self) -> Result<serde_json::Value> {
        let rounds = self.steps.iter().flat_map(|step| &step.rounds);
        Ok(serde_json::to_value(Document {
            realtime: self.realtime,
            spin_us: self.spin_us,
            default: self.step_rows(),
            default_rounds: rounds.collect(),
            shortest: self.shortest_rows(),
            trials: &self.trials,
        })?)
    }

    fn tables(&self) -> Vec<Table> {
        vec![self.shortest_table(), self.step_table()]
    }

    fn sheets(&self) -> Result<Vec<Sheet>> {
        let rounds = self.steps.iter().flat_map(|step| &step.rounds);
        let all: Vec<&Trial> = rounds.chain(&self.trials).collect();
        let sheet = |name: &str, csv| Sheet {
            name: name.to_owned(),
            csv,
        };
        Ok(vec![
            sheet("rate", csv(&self.shortest_rows())?),
            sheet("rate-default", csv(&self.step_rows())?),
            sheet("rate-trials", csv(&all)?),
        ])
    }

    fn pictures(&self) -> Result<Vec<Figure>> {
        let rows = self.step_rows();
        let line = |label: &str, value: fn(&StepRow) -> f64, colour| {
            let points = rows.iter().map(|row| (row.rate_hz * 1e-3, value(row)));
            Curve::line(label, points.filter(|p| p.1.is_finite()).collect(), colour)
        };
        let times = Panel {
            title: "Response of the default".to_owned(),
            x: "rate [kHz]",
            y: "[µs]",
            scale: Scale::LogLog { floor: 1.0 },
            curves: vec![
                line("period", |row| row.period_ms * 1e3, DARK),
                line("p99.9", |row| row.response_p999_us, ORANGE),
                line("p99", |row| row.response_p99_us, GREEN),
                line("p50", |row| row.response_p50_us, BLUE),
            ],
        };
        let shares = Panel {
            title: "What it costs".to_owned(),
            x: "rate [kHz]",
            y: "[%]",
            scale: Scale::Linear,
            curves: vec![
                line("of the core", |row| 100.0 * row.core_share, BLUE),
                line(
                    "solves cut short",
                    |row| 100.0 * row.budget_hit_share,
                    ORANGE,
                ),
            ],
        };
        Ok(vec![Figure {
            name: "rate",
            caption:
                "The default with shorter and shorter periods. The response is that of the cycles that \
                      ran: releases without a cycle are not in it."
                    .to_owned(),
            svg: sheet(&[times, shares], 2, 620)?,
        }])
    }

    fn metrics(&self) -> Vec<Metric> {
        let mut metrics = Vec::new();
        for step in &self.steps {
            let name =
                |what: &str| format!("rate/default/{}-hz/{what}", rate_hz(step.period_ms).round());
            let mut add = |what: &str, unit: &str, value: fn(&Figures) -> f64| {
                metrics.push(Metric::lower(name(what), unit, step.values(value)));
            };
            add("response_p50", "µs", |f| f.response_us.p50);
            add("response_p99", "µs", |f| f.response_us.p99);
            add("response_p999", "µs", |f| f.response_us.p999);
            add("core", "%", |f| 100.0 * f.core_share());
            add("cut_short", "%", |f| 100.0 * f.budget_hit_share);
            add("own_misses", "", |f| f.causes.own() as f64);
        }
        for shortest in &self.shortest {
            let name = format!("rate/shortest/{}", shortest.case.key());
            metrics.push(Metric::lower(name, "ms", shortest.period_ms()));
        }
        metrics
    }

    fn histograms(&self) -> Vec<Recording<'_>> {
        let rounds = self.steps.iter().flat_map(|step| &step.rounds);
        let measured = rounds.filter_map(|trial| Some((trial, trial.figures.as_ref()?)));
        measured
            .map(|(trial, figures)| Recording {
                tag: &trial.tag,
                start_s: trial.begin_ns.saturating_sub(self.begin_ns) as f64 * 1e-9,
                duration_s: figures.duration_s,
                histogram: &trial.responses,
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(
        clippy::unwrap_used,
        reason = "in a test a panic is the report, in its helpers, too"
    )]

    use super::*;
    use crate::closed_loop::histogram;
    use crate::rate::figures::tests::quiet;

    fn trial(period_ms: f64, holds: bool) -> Trial {
        Trial {
            case: Case::DEFAULT,
            period_ms,
            spin_us: 0.0,
            holds,
            remarks: if holds { "" } else { "too short" }.to_owned(),
            figures: holds.then(quiet),
            tag: "tag".to_owned(),
            responses: histogram().unwrap(),
            begin_ns: 1,
        }
    }

    fn report() -> Report {
        let step = |period_ms, holds| Step {
            period_ms,
            rounds: vec![trial(period_ms, true), trial(period_ms, holds)],
        };
        Report {
            realtime: false,
            spin_us: 0.0,
            begin_ns: 0,
            steps: vec![step(5.0, true), step(0.1, false)],
            shortest: vec![Shortest {
                case: Case::DEFAULT,
                held: Some(trial(0.5, true)),
                held_tally: Tally { held: 1, trials: 2 },
                failed: Some(trial(0.25, false)),
                failed_tally: Tally { held: 0, trials: 3 },
            }],
            trials: vec![trial(0.5, true), trial(0.25, false)],
        }
    }

    #[test]
    fn what_failed_is_told_in_every_form() {
        let report = report();
        let json = report.json().unwrap();
        assert_eq!(json["default"][1]["rounds_held"], 1);
        assert_eq!(json["default"][1]["remarks"], "too short");
        assert_eq!(json["shortest"][0]["shortest_period_ms"], 0.5);
        assert_eq!(json["shortest"][0]["failed_period_ms"], 0.25);
        assert_eq!(json["shortest"][0]["sections"], 3);
        assert_eq!(json["shortest"][0]["trials"], 2);
        assert_eq!(json["shortest"][0]["failed_trials"], 3);
        assert_eq!(json["trials"][1]["holds"], false);
        assert_eq!(json["realtime"], false);
        let text: String = report.tables().iter().map(Table::text).collect();
        assert!(
            text.contains("0.25 ms, held in 0 of 3 trials: too short")
                && text.contains("1 of 2")
                && text.contains("not granted"),
            "{text}"
        );
    }

    #[test]
    fn sheets_have_a_line_for_each_row() {
        let sheets = report().sheets().unwrap();
        let lines: Vec<_> = sheets
            .iter()
            .map(|sheet| sheet.csv.lines().count() - 1)
            .collect();
        assert_eq!(lines, [1, 2, 6]);
        assert!(sheets[0].csv.starts_with("sections,solver,horizon_steps,"));
    }

    #[test]
    fn a_round_without_figures_is_no_value_of_a_metric() {
        let metrics = report().metrics();
        let of = |name: &str| metrics.iter().find(|metric| metric.name == name).unwrap();
        assert_eq!(of("rate/default/200-hz/response_p50").rounds, [30.0, 30.0]);
        assert_eq!(of("rate/default/10000-hz/response_p50").rounds, [30.0]);
        assert_eq!(of("rate/shortest/3-sections/kpso-refined/n2").rounds, [0.5]);
    }

    #[test]
    fn the_picture_is_drawn_and_only_what_was_measured_is_recorded() {
        let report = report();
        assert!(report.pictures().unwrap()[0].svg.contains("p99.9"));
        assert_eq!(report.histograms().len(), 3);
    }
}
