//! What `deadline` found, as tables, plots, CSV and JSON.

use std::time::Duration;

use anyhow::Result;
use hdrhistogram::Histogram;
use serde::Serialize;
use serde_json::{Value, json};

use super::case::{Case, Cases, Key};
use super::ratio::{Ratio, per_million, ratios};
use super::segment::Subject;
use super::{Counts, Options, Run, Setup};
use crate::chart::{BLUE, Curve, GREY, ORANGE, Panel, Point, Scale, sheet};
use crate::csv::csv;
use crate::figures::Figure;
use crate::load::Load;
use crate::metric::Metric;
use crate::quantiles::Quantiles;
use crate::section::{Recording, Section, Sheet};
use crate::table::Table;

const PLOT_HEIGHT: u32 = 520;
/// The wake-ups of a plot begin here \[µs\].
const SHORTEST_US: f64 = 0.1;

#[derive(Debug)]
pub struct Report {
    cases: Cases,
    ratios: Vec<Ratio>,
    period: Duration,
    is_realtime: bool,
    failures: Vec<String>,
    rounds: u32,
    segment: Duration,
    tags: Vec<Tag>,
}

#[derive(Debug)]
struct Tag {
    text: String,
    key: Key,
    name: &'static str,
}

impl Report {
    pub(super) fn new(run: Run<'_>, options: &Options) -> Self {
        let (cases, period) = (run.cases, run.runner.period());
        let ratios = ratios(&cases);
        let names = ["wake", "compute", "response", "command"];
        let all = cases.keys().flat_map(|key| names.map(|name| (*key, name)));
        let tags = all
            .map(|(key, name)| Tag {
                text: format!("{}.{name}", path(&key).join(".")),
                key,
                name,
            })
            .collect();
        Self {
            ratios,
            period,
            is_realtime: run.is_realtime,
            failures: run.failures,
            rounds: options.rounds,
            segment: options.segment(),
            tags,
            cases,
        }
    }

    /// What was measured, case by case.
    pub fn cases(&self) -> &Cases {
        &self.cases
    }

    /// The daemon beside the bare loop.
    pub fn ratios(&self) -> &[Ratio] {
        &self.ratios
    }

    fn ratio_table(&self) -> Table {
        let heads = [
            "load",
            "set-up",
            "wake-up p50",
            "rounds",
            "wake-up p99",
            "rounds",
            "command less wake-up p50 µs",
            "response p99 to no load",
            "own misses",
            "misses beyond bare per 10⁶",
            "by chance",
        ];
        let rows = self.ratios.iter().map(|ratio| {
            vec![
                ratio.load.name().into(),
                setup_word(ratio.realtime).into(),
                digits(ratio.wake_p50, 2),
                between(ratio.wake_p50_range),
                digits(ratio.wake_p99, 2),
                between(ratio.wake_p99_range),
                digits(ratio.command_beyond_wake_p50_us, 1),
                digits(ratio.response_p99_to_unloaded, 2),
                ratio.own_misses.to_string(),
                format!("{:+.0}", ratio.misses_beyond_bare),
                format!("{:.2}", ratio.misses_p_value),
            ]
        });
        let rounds = self.rounds;
        Table::new(
            format!("The daemon over the bare loop: medians of {rounds} rounds, and their range"),
            &heads,
            2,
            rows.collect(),
        )
    }

    fn count_table(&self) -> Table {
        let heads = [
            "load",
            "set-up",
            "subject",
            "cycles",
            "late starts",
            "misses",
            "skipped",
            "platform",
            "load",
            "compute",
            "fault",
            "other",
            "steal ms",
            "waited ms",
            "lost records",
            "lost commands",
            "tracking %",
            "cut short",
        ];
        let rows = self.cases.values().map(|case| {
            let counts = &case.total.counts;
            let causes = &counts.causes;
            let mut cells = names(&case.key);
            cells.extend(
                [
                    counts.cycles,
                    counts.late_starts,
                    counts.deadline_misses,
                    counts.skipped_periods,
                ]
                .map(|count| count.to_string()),
            );
            // cyclictest does not say why.
            let known = case.key.subject != Subject::Cyclictest;
            let word = |count: u64| if known { count.to_string() } else { "-".into() };
            let all = [
                causes.platform,
                causes.load,
                causes.compute,
                causes.fault,
                causes.other,
            ];
            cells.extend(all.map(word));
            cells.push(format!("{:.0}", counts.steal_ms));
            cells.push(if known {
                format!("{:.1}", counts.run_delay_ms)
            } else {
                "-".into()
            });
            let of_client = [counts.lost_records, counts.lost_commands];
            let is_daemon = case.key.subject == Subject::Daemon;
            let told = |count: u64| {
                if is_daemon {
                    count.to_string()
                } else {
                    "-".into()
                }
            };
            cells.extend(of_client.map(told));
            let row = case.row();
            cells.push(digits(row.tracking_share.map(|share| 100.0 * share), 1));
            cells.push(told(row.budget_hits));
            cells
        });
        Table::new(
            "Cycles that were late, and why (causes of late starts, misses and skipped periods)",
            &heads,
            3,
            rows.collect(),
        )
    }

    fn time_table(&self) -> Table {
        let heads = [
            "load",
            "set-up",
            "subject",
            "from the release to",
            "min",
            "p50",
            "p99",
            "p99.9",
            "max",
        ];
        let mut rows = Vec::new();
        for case in self.cases.values() {
            let times = case.total.quantiles();
            let kinds = [
                ("start (wake-up)", times.wake_us),
                ("hand-over, from the start (compute)", times.compute_us),
                ("hand-over (response)", times.response_us),
                ("the client (command)", times.command_us),
            ];
            for (kind, quantiles) in kinds {
                let Some(Quantiles {
                    min,
                    p50,
                    p99,
                    p999,
                    max,
                }) = quantiles
                else {
                    continue;
                };
                let mut cells = names(&case.key);
                cells.push(kind.into());
                cells.extend([min, p50, p99, p999, max].map(|us| format!("{us:.1}")));
                rows.push(cells);
            }
        }
        Table::new("Latencies of all rounds together, µs", &heads, 4, rows)
    }

    /// Of each set-up: how many wake-ups, or commands in the client's hands, were later than so much.
    fn panels(&self, setup: Setup) -> Vec<Panel> {
        let loads: Vec<Load> = {
            let keys = self.cases.keys().filter(|key| key.setup == setup);
            let mut loads: Vec<Load> = keys.map(|key| key.load).collect();
            loads.dedup();
            loads
        };
        let panel = |load: Load| {
            let of = |subject| {
                self.cases.get(&Key {
                    setup,
                    load,
                    subject,
                })
            };
            let wake = |subject, label: &str, colour| {
                of(subject)
                    .map(|case: &Case| Curve::line(label, survival(&case.total.times.wake), colour))
            };
            let command = of(Subject::Daemon).map(|case| {
                let points = survival(&case.total.times.command);
                Curve::line("command at the client", points, GREY)
            });
            let curves = [
                command,
                wake(Subject::Cyclictest, "cyclictest", ORANGE),
                wake(Subject::Daemon, "daemon", BLUE),
                wake(Subject::Bare, "bare loop", crate::chart::GREEN),
            ];
            Panel {
                title: format!("Load {}", load.name()),
                x: "later than, µs after the release",
                y: "share of the cycles",
                scale: Scale::LogLog { floor: 1e-5 },
                curves: curves.into_iter().flatten().collect(),
            }
        };
        loads.into_iter().map(panel).collect()
    }
}

/// For each latency the share of the cycles that were later: a step for each bucket of the histogram.
fn survival(times_ns: &Histogram<u64>) -> Vec<Point> {
    let total = times_ns.len();
    let mut later = total;
    let mut points = Vec::new();
    for value in times_ns.iter_recorded() {
        let us = (value.value_iterated_to() as f64 * 1e-3).max(SHORTEST_US);
        points.push((us, later as f64 / total as f64));
        later -= value.count_since_last_iteration();
    }
    points
}

impl Section for Report {
    fn name(&self) -> &'static str {
        "deadline"
    }

    fn heading(&self) -> &'static str {
        "Deadline misses and latencies, beside a bare loop"
    }

    fn explanation(&self) -> &'static str {
        "<p>Each round runs, under each load, a bare loop (the daemon's own thread with nothing to do), the daemon \
         while its robot tracks a spiral, and cyclictest where it is installed, one after the other. All times \
         count from the release on the grid. What the machine itself does, it does to all of them: the ratio to \
         the bare loop of the same round is what can be believed, and a miss of the daemon is its own only when \
         its computation took too long or a page was missing. Misses by chance: the probability that as many \
         misses fall to the daemon when both miss alike.</p>\n"
    }

    fn json(&self) -> Result<Value> {
        let rows = self.cases.values().map(|case| {
            let mut row = serde_json::to_value(case.row())?;
            if case.key.subject == Subject::Cyclictest {
                forget_what_it_does_not_tell(&mut row);
            }
            Ok(row)
        });
        let cases = rows.collect::<Result<Vec<Value>>>()?;
        Ok(json!({
            "period_ms": self.period.as_secs_f64() * 1e3,
            "realtime_granted": self.is_realtime,
            "measured_again": self.failures,
            "rounds": self.rounds,
            "segment_s": self.segment.as_secs_f64(),
            "cases": cases,
            "ratios": self.ratios,
        }))
    }

    fn tables(&self) -> Vec<Table> {
        vec![self.ratio_table(), self.count_table(), self.time_table()]
    }

    fn sheets(&self) -> Result<Vec<Sheet>> {
        let rows = self.cases.values().flat_map(|case| {
            let rounds = case.rounds.iter().enumerate();
            rounds.map(|(index, round)| SheetRow {
                load: case.key.load,
                subject: case.key.subject,
                realtime: case.key.setup == Setup::Realtime,
                round: index + 1,
                counts: round.segment.tally.counts,
                times: round.segment.tally.quantiles(),
            })
        });
        let rows: Vec<_> = rows.collect();
        Ok(vec![Sheet {
            name: "deadline".to_owned(),
            csv: csv(&rows)?,
        }])
    }

    fn pictures(&self) -> Result<Vec<Figure>> {
        let mut figures = Vec::new();
        for (setup, name, words) in [
            (Setup::Realtime, "deadline-realtime", "With real time"),
            (Setup::Ordinary, "deadline-ordinary", "Without real time"),
        ] {
            let panels = self.panels(setup);
            if panels.is_empty() {
                continue;
            }
            figures.push(Figure {
                name,
                caption: format!(
                    "{words}: share of the cycles that started later than so much after their release, and of \
                     the commands that came later to the client. Both axes are logarithmic."
                ),
                svg: sheet(&panels, 2, PLOT_HEIGHT)?,
            });
        }
        Ok(figures)
    }

    fn metrics(&self) -> Vec<Metric> {
        let mut metrics = Vec::new();
        for ratio in &self.ratios {
            let setup = setup_word(ratio.realtime);
            let name = |what: &str| format!("deadline/{}/{setup}/{what}", ratio.load.name());
            let rounds = &ratio.rounds;
            metrics.extend([
                Metric::lower(name("wake_p50_to_bare"), "", rounds.wake_p50.clone()),
                Metric::lower(name("wake_p99_to_bare"), "", rounds.wake_p99.clone()),
                Metric::lower(
                    name("command_beyond_wake_p50"),
                    "µs",
                    rounds.command_beyond_wake.clone(),
                ),
                Metric::lower(
                    name("response_p99_to_unloaded"),
                    "",
                    rounds.response_p99_to_unloaded.clone(),
                ),
            ]);
        }
        for case in self.cases.values() {
            let name = |what: &str| format!("deadline/{}/{what}", path(&case.key).join("/"));
            let wake = |q: fn(Quantiles) -> f64| case.each(move |t| t.wake_us.map(q));
            let response = |q: fn(Quantiles) -> f64| case.each(move |t| t.response_us.map(q));
            let command = |q: fn(Quantiles) -> f64| case.each(move |t| t.command_us.map(q));
            let all = [
                ("wake_p50", wake(|q| q.p50)),
                ("wake_p99", wake(|q| q.p99)),
                ("response_p50", response(|q| q.p50)),
                ("response_p99", response(|q| q.p99)),
                ("command_p50", command(|q| q.p50)),
                ("command_p99", command(|q| q.p99)),
            ];
            if case.key.subject == Subject::Daemon {
                let counts = |count: fn(&Counts) -> f64| {
                    let rounds = case.rounds.iter();
                    rounds.map(move |round| count(&round.segment.tally.counts))
                };
                metrics.extend([
                    Metric::lower(name("own_misses"), "", counts(|c| c.own_misses as f64)),
                    Metric::lower(name("misses"), "per million", counts(per_million)),
                ]);
            }
            let known = all.into_iter().filter(|(_, rounds)| !rounds.is_empty());
            metrics.extend(known.map(|(what, rounds)| Metric::lower(name(what), "µs", rounds)));
        }
        metrics.retain(|metric| !metric.rounds.is_empty());
        metrics
    }

    fn histograms(&self) -> Vec<Recording<'_>> {
        let mut all = Vec::new();
        for tag in &self.tags {
            for round in &self.cases[&tag.key].rounds {
                let named = round.segment.tally.times.named();
                let found = named.into_iter().find(|(name, _)| *name == tag.name);
                let Some((_, histogram)) = found.filter(|(_, histogram)| !histogram.is_empty())
                else {
                    continue;
                };
                all.push(Recording {
                    tag: &tag.text,
                    start_s: round.start_s,
                    duration_s: self.segment.as_secs_f64(),
                    histogram,
                });
            }
        }
        all.sort_by(|one, other| one.start_s.total_cmp(&other.start_s));
        all
    }
}

#[derive(Serialize)]
struct SheetRow {
    load: Load,
    subject: Subject,
    realtime: bool,
    round: usize,
    #[serde(flatten)]
    counts: Counts,
    #[serde(flatten)]
    times: super::tally::TimeQuantiles,
}

/// cyclictest tells neither why it was late nor how long it waited for its core.
fn forget_what_it_does_not_tell(row: &mut Value) {
    let rounds = row["rounds"].as_array_mut();
    for round in rounds.into_iter().flatten() {
        forget_what_it_does_not_tell(round);
    }
    for key in ["causes", "own_misses", "run_delay_ms"] {
        row[key] = Value::Null;
    }
}

fn path(key: &Key) -> [&'static str; 3] {
    [key.load.name(), key.setup.name(), key.subject.name()]
}

fn names(key: &Key) -> Vec<String> {
    path(key).map(str::to_owned).to_vec()
}

fn setup_word(realtime: bool) -> &'static str {
    if realtime {
        Setup::Realtime.name()
    } else {
        Setup::Ordinary.name()
    }
}

fn digits(value: Option<f64>, count: usize) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{value:.count$}"))
}

fn between(range: Option<(f64, f64)>) -> String {
    range.map_or_else(
        || "-".into(),
        |(low, high)| format!("{low:.2} to {high:.2}"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closed_loop::histogram;

    #[test]
    fn all_are_later_than_the_first_and_none_than_the_last() {
        let mut times = histogram().expect("bounds");
        for us in [10, 20, 20, 40] {
            times.record(us * 1000).expect("within the bounds");
        }
        let shares: Vec<f64> = survival(&times).iter().map(|point| point.1).collect();
        assert_eq!(shares, [1.0, 0.75, 0.25]);
    }
}
