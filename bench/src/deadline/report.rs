//! What `deadline` found, as rows, plots and single numbers.

use anyhow::Result;
use hdrhistogram::Histogram;
use serde_json::{Value, json, to_value};

use super::case::{Case, Cases, Key};
use super::ratio::{per_million, ratios};
use super::segment::Subject;
use super::tally::{COMMAND, RESPONSE, TIME_NAMES, WAKE};
use super::{Counts, DeadlineOptions, Run, Setup};
use crate::chart::{BLUE, Curve, GREEN, GREY, ORANGE, Panel, Point, Scale, sheet};
use crate::dataset::{
    Column, Dataset, Plot, Recording, Sheet, fixed, joined, percent, plain, signed, word,
};
use crate::load::Load;
use crate::quantiles::Quantiles;

/// The wake-ups of a plot begin here \[µs\].
const SHORTEST_US: f64 = 0.1;

const EXPLANATION: &str = "<p>Each round runs, under each load, a bare loop (the daemon's own thread with nothing to do), the daemon \
         while its robot tracks a spiral, and cyclictest where it is installed, one after the other. All times \
         count from the release on the grid. What the machine itself does, it does to all of them: the ratio to \
         the bare loop of the same round is what can be believed, and a miss of the daemon is its own only when \
         its computation took too long or a page was missing. Misses by chance: the probability that as many \
         misses fall to the daemon when both miss alike.</p>\n";

const RATIOS: [Column; 11] = [
    word("load", "load"),
    word("set-up", "set_up"),
    fixed("wake-up p50", "wake_p50", 2),
    fixed("rounds", "wake_p50_range", 2),
    fixed("wake-up p99", "wake_p99", 2),
    fixed("rounds", "wake_p99_range", 2),
    fixed(
        "command less wake-up p50 µs",
        "command_beyond_wake_p50_us",
        1,
    ),
    fixed("response p99 to no load", "response_p99_to_unloaded", 2),
    plain("own misses", "own_misses"),
    signed("misses beyond bare per 10⁶", "misses_beyond_bare"),
    fixed("by chance", "misses_p_value", 2),
];

const COUNTS: [Column; 18] = [
    word("load", "load"),
    word("set-up", "set_up"),
    word("subject", "subject"),
    plain("cycles", "cycles"),
    plain("late starts", "late_starts"),
    plain("misses", "deadline_misses"),
    plain("skipped", "skipped_periods"),
    plain("platform", "causes_platform"),
    plain("load", "causes_load"),
    plain("compute", "causes_compute"),
    plain("fault", "causes_fault"),
    plain("other", "causes_other"),
    fixed("steal ms", "steal_ms", 0),
    fixed("waited ms", "run_delay_ms", 1),
    plain("lost records", "lost_records"),
    plain("lost commands", "lost_commands"),
    percent("tracking %", "tracking_share", 1),
    plain("cut short", "budget_hits"),
];

const TIMES: [Column; 9] = [
    word("load", "load"),
    word("set-up", "set_up"),
    word("subject", "subject"),
    word("from the release to", "to"),
    fixed("min", "min", 1),
    fixed("p50", "p50", 1),
    fixed("p99", "p99", 1),
    fixed("p99.9", "p999", 1),
    fixed("max", "max", 1),
];

pub(super) fn dataset(run: Run<'_>, options: &DeadlineOptions) -> Result<Dataset> {
    let cases = run.cases;
    let ratios = ratios(&cases);
    let ratio_rows: Vec<&Value> = ratios.iter().map(|ratio| &ratio.row).collect();
    let title = format!(
        "The daemon over the bare loop: medians of {} rounds, and their range",
        options.rounds
    );
    let rows: Vec<Value> = cases.values().map(Case::row).collect::<Result<_>>()?;
    let each: Vec<Vec<Value>> = cases
        .values()
        .map(Case::round_rows)
        .collect::<Result<_>>()?;
    let times: Vec<Vec<Value>> = cases.values().map(time_rows).collect::<Result<_>>()?;
    let mut dataset = Dataset {
        name: "deadline",
        heading: "Deadline misses and latencies, beside a bare loop",
        explanation: EXPLANATION,
        sheets: vec![
            Sheet::new(&ratio_rows)?.key("ratios").table(title, &RATIOS),
            Sheet::new(&rows)?.key("cases").table(
                "Cycles that were late, and why (causes of late starts, misses and skipped periods)",
                &COUNTS,
            ),
            Sheet::new(&times.concat())?.table("Latencies of all rounds together, µs", &TIMES),
            Sheet::new(&each.concat())?.file("deadline").order(&COUNTS),
        ],
        plots: plots(&cases)?,
        ..Dataset::default()
    };
    dataset.fact("period_ms", run.runner.period().as_secs_f64() * 1e3);
    dataset.fact("realtime_granted", run.is_realtime);
    dataset.fact("measured_again", run.failures);
    dataset.fact("rounds", options.rounds);
    dataset.fact("segment_s", options.segment().as_secs_f64());
    for (name, unit, rounds) in ratios.into_iter().flat_map(|ratio| ratio.metrics) {
        dataset.lower(name, unit, rounds);
    }
    for case in cases.values() {
        case_metrics(&mut dataset, case);
    }
    dataset.metrics.retain(|metric| !metric.rounds.is_empty());
    dataset.recordings = recordings(cases, options);
    Ok(dataset)
}

fn time_rows(case: &Case) -> Result<Vec<Value>> {
    const TO: [&str; 4] = [
        "start (wake-up)",
        "hand-over, from the start (compute)",
        "hand-over (response)",
        "the client (command)",
    ];
    let (key, times) = (case.key, case.total.quantiles());
    let measured = TO.into_iter().zip(times);
    let measured = measured.filter_map(|(to, quantiles)| Some((to, quantiles?)));
    let row = |(to, quantiles): (&str, Quantiles)| {
        let of = json!({ "load": key.load, "set_up": key.setup, "subject": key.subject, "to": to });
        joined([of, to_value(quantiles)?])
    };
    measured.map(row).collect()
}

fn case_metrics(dataset: &mut Dataset, case: &Case) {
    let name = |what: &str| format!("deadline/{}/{what}", path(&case.key).join("/"));
    if case.key.subject == Subject::Daemon {
        let counts = |count: fn(&Counts) -> f64| {
            let rounds = case.rounds.iter();
            rounds.map(move |round| count(&round.segment.tally.counts))
        };
        dataset.lower(name("own_misses"), "", counts(|c| c.own_misses as f64));
        dataset.lower(name("misses"), "per million", counts(per_million));
    }
    for time in [WAKE, RESPONSE, COMMAND] {
        for (quantile, value) in [
            ("p50", (|q| q.p50) as fn(Quantiles) -> f64),
            ("p99", |q| q.p99),
        ] {
            let rounds = case.each(|t| Some(value(t[time]?)));
            dataset.lower(
                name(&format!("{}_{quantile}", TIME_NAMES[time])),
                "µs",
                rounds,
            );
        }
    }
}

fn recordings(cases: Cases, options: &DeadlineOptions) -> Vec<Recording> {
    let mut all = Vec::new();
    for case in cases.into_values() {
        let path = path(&case.key).join(".");
        for round in case.rounds {
            let times = round.segment.tally.times;
            let named = TIME_NAMES.iter().zip(&times);
            let measured = named.filter(|(_, histogram_ns)| !histogram_ns.is_empty());
            all.extend(measured.map(|(name, histogram_ns)| Recording {
                tag: format!("{path}.{name}"),
                start_s: round.start_s,
                duration_s: options.segment().as_secs_f64(),
                histogram_ns: histogram_ns.clone(),
            }));
        }
    }
    all
}

fn path(key: &Key) -> [&'static str; 3] {
    [key.load.name(), key.setup.name(), key.subject.name()]
}

fn plots(cases: &Cases) -> Result<Vec<Plot>> {
    let all = [
        (
            Setup::Realtime,
            "deadline-realtime",
            "With real time: share of the cycles that started later than so much after their release, and of \
             the commands that came later to the client. Both axes are logarithmic.",
        ),
        (
            Setup::Ordinary,
            "deadline-ordinary",
            "The same without real time.",
        ),
    ];
    let drawn = all.into_iter().filter_map(|(setup, name, caption)| {
        let panels = panels(cases, setup);
        (!panels.is_empty()).then(|| {
            let svg = sheet(&panels, 2, 520)?;
            Ok(Plot { name, caption, svg })
        })
    });
    drawn.collect()
}

/// Of each load: how many wake-ups, or commands in the client's hands, were later than so much.
fn panels(cases: &Cases, setup: Setup) -> Vec<Panel> {
    let keys = cases.keys().filter(|key| key.setup == setup);
    let mut loads: Vec<Load> = keys.map(|key| key.load).collect();
    loads.dedup();
    let panel = |load: Load| {
        let curve = |(subject, label, colour)| {
            let key = Key {
                setup,
                load,
                subject,
            };
            let times = &cases.get(&key)?.total.times;
            let times = if colour == GREY {
                &times[COMMAND]
            } else {
                &times[WAKE]
            };
            Some(Curve::line(label, survival(times), colour))
        };
        let curves = [
            (Subject::Daemon, "command at the client", GREY),
            (Subject::Cyclictest, "cyclictest", ORANGE),
            (Subject::Daemon, "daemon", BLUE),
            (Subject::Bare, "bare loop", GREEN),
        ];
        Panel {
            title: format!("Load {}", load.name()),
            x: "later than, µs after the release",
            y: "share of the cycles",
            scale: Scale::LogLog { floor: 1e-5 },
            curves: curves.into_iter().filter_map(curve).collect(),
        }
    };
    loads.into_iter().map(panel).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantiles::histogram;

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
