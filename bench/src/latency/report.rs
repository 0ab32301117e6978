//! What a run found, for people and for programs.

use anyhow::Result;
use hdrhistogram::Histogram;
use serde::Serialize;
use serde_json::json;

use super::hands::Looks;
use super::leg::Leg;
use super::round::{Round, Unmeasured};
use super::rows::{
    Ratio, RoundRow, Row, Target, VALUES_OF_P99, VALUES_OF_P999, p50_us, pooled, quantile_of, row,
    supported,
};
use crate::chart::sheet;
use crate::csv::csv;
use crate::figures::Figure;
use crate::metric::{Metric, median, range};
use crate::quantiles::Quantiles;
use crate::section::{Recording, Section, Sheet};
use crate::table::Table;

/// What may be added to a period from a stop to zero rates \[µs\].
const STOP_MARGIN_US: f64 = 100.0;
#[derive(Debug, Clone, Serialize)]
pub struct Setting {
    pub rounds: usize,
    /// Samples of each kind in each round.
    pub samples: usize,
    pub stops: usize,
    pub period_us: f64,
    /// How long before a release the daemon gathers, as its records show \[µs\].
    pub gather_lead_us: f64,
    pub realtime: bool,
    pub client_realtime: bool,
    pub realtime_core: usize,
    pub client_core: usize,
    /// How often the client was late itself.
    pub looks: Looks,
}

const RATIOS: [(Leg, Leg); 3] = [
    (Leg::CommandHop, Leg::BareOneWay),
    (Leg::CommandHandover, Leg::BareOneWay),
    (Leg::LeaseMachinery, Leg::BareRequest),
];

#[derive(Debug, Clone)]
pub struct Report {
    pub setting: Setting,
    pub rows: Vec<Row>,
    rounds: Vec<Round>,
}

impl Report {
    pub(super) fn new(setting: Setting, rounds: Vec<Round>) -> Self {
        Self {
            rows: Leg::ALL
                .iter()
                .filter_map(|leg| row(*leg, &rounds))
                .collect(),
            setting,
            rounds,
        }
    }

    /// The legs of the daemon beside those of iceoryx2 alone.
    pub fn ratios(&self) -> Vec<Ratio> {
        let ratio = |(leg, to): (Leg, Leg)| {
            let of = |round: &Round| Some(p50_us(round, leg)? / p50_us(round, to)?);
            let rounds: Vec<f64> = self.rounds.iter().filter_map(of).collect();
            let p50 = median(&rounds)?;
            Some(Ratio {
                leg,
                to,
                p50,
                rounds,
            })
        };
        RATIOS.into_iter().filter_map(ratio).collect()
    }

    /// The bound of a stop, and whether it is kept.
    pub fn targets(&self) -> Vec<Target> {
        let limit_us = self.stop_limit_us();
        let stops = [Leg::StopZeroHandover, Leg::StopZeroCommand];
        let rows = self.rows.iter().filter(|row| stops.contains(&row.leg));
        rows.map(|row| Target {
            leg: row.leg,
            samples: row.samples,
            limit_us,
            p99_us: row.latency_us.p99,
            kept: row.latency_us.p99 <= limit_us,
        })
        .collect()
    }

    pub(super) fn stop_limit_us(&self) -> f64 {
        self.setting.period_us + STOP_MARGIN_US
    }

    /// What could not be measured, of all rounds.
    pub fn unmeasured(&self) -> Unmeasured {
        let mut all = Unmeasured::default();
        for round in &self.rounds {
            all += round.unmeasured;
        }
        all
    }

    /// Values of a leg in the round that has the fewest of them, but for rounds that have none.
    fn fewest_in_a_round(&self, leg: Leg) -> u64 {
        let counts = self
            .rounds
            .iter()
            .map(|round| round.leg(leg).latencies.len());
        counts.filter(|count| *count > 0).min().unwrap_or(0)
    }

    fn round_rows(&self) -> Vec<RoundRow> {
        let all = self.rounds.iter().enumerate();
        let rows = |(index, round): (usize, &Round)| {
            let row = |leg: Leg| {
                let latencies = round.leg(leg).latencies.clone();
                Some(RoundRow {
                    round: index + 1,
                    leg,
                    samples: latencies.len(),
                    latency_us: Quantiles::of(&latencies)?,
                })
            };
            Leg::ALL.into_iter().filter_map(row).collect::<Vec<_>>()
        };
        all.flat_map(rows).collect()
    }

    fn table(&self) -> Table {
        let cells = |row: &Row| self.cells(row);
        let setting = &self.setting;
        let threads = match (setting.realtime, setting.client_realtime) {
            (true, true) => "SCHED_FIFO",
            (true, false) => "SCHED_FIFO for the daemon alone",
            (false, _) => "no real-time threads: not granted",
        };
        let title = format!(
            "Latencies of messages, period {:.1} ms, gather {:.0} µs before the release, {threads}",
            setting.period_us * 1e-3,
            setting.gather_lead_us
        );
        let heads = [
            "way",
            "samples",
            "min µs",
            "p50 µs",
            "p99 µs",
            "p99.9 µs",
            "max µs",
            "median of rounds: p50 µs",
            "p99 µs",
        ];
        Table::new(title, &heads, 1, self.rows.iter().map(cells).collect())
    }

    fn cells(&self, row: &Row) -> Vec<String> {
        let (all, rounds) = (row.latency_us, row.rounds_us);
        let us = |value: f64| format!("{value:.2}");
        let us_of = |value: f64, count: u64, least: u64| supported(us(value), count, least);
        vec![
            row.leg.name().to_owned(),
            row.samples.to_string(),
            us(all.min),
            us(all.p50),
            us_of(all.p99, row.samples, VALUES_OF_P99),
            us_of(all.p999, row.samples, VALUES_OF_P999),
            us(all.max),
            us(rounds.p50),
            us_of(rounds.p99, self.fewest_in_a_round(row.leg), VALUES_OF_P99),
        ]
    }

    fn verdicts(&self) -> Table {
        let ratios = self.ratios().into_iter().map(|ratio| {
            let (low, high) = range(&ratio.rounds).unwrap_or((ratio.p50, ratio.p50));
            vec![
                format!("{} / {}, p50", ratio.leg.name(), ratio.to.name()),
                format!("{:.2}", ratio.p50),
                format!("{low:.2} to {high:.2} in the rounds"),
            ]
        });
        let targets = self.targets();
        let targets = targets.iter().map(Target::cells);
        let rows = ratios.chain(targets).chain(self.counts()).collect();
        Table::new(
            "Beside iceoryx2 alone, and beside what is asked",
            &["what", "found", "beside"],
            1,
            rows,
        )
    }

    /// What did not go as it should.
    fn counts(&self) -> [Vec<String>; 3] {
        let (looks, unmeasured) = (self.setting.looks, self.unmeasured());
        let stops = self.setting.rounds * self.setting.stops;
        let row = |what: &str, count: u64, beside: String| {
            vec![what.to_owned(), count.to_string(), beside]
        };
        [
            row(
                "client awake too late",
                looks.late,
                format!("of {} releases", looks.all),
            ),
            row(
                "spoilt stops",
                unmeasured.spoilt_stops,
                format!("repeated, beside {stops} that count"),
            ),
            row(
                "samples without a received command",
                unmeasured.without_command,
                "left out: the client was away".to_owned(),
            ),
        ]
    }

    fn definitions(&self) -> Table {
        let cells = |row: &Row| {
            vec![
                row.leg.name().to_owned(),
                row.from.to_owned(),
                row.to.to_owned(),
            ]
        };
        Table::new(
            "From which stamp to which",
            &["way", "from", "to"],
            3,
            self.rows.iter().map(cells).collect(),
        )
    }

    pub(super) fn pooled(&self, leg: Leg) -> Option<Histogram<u64>> {
        pooled(leg, &self.rounds)
    }
}

impl Section for Report {
    fn name(&self) -> &'static str {
        "latency"
    }

    fn heading(&self) -> &'static str {
        "Latency: how long messages take"
    }

    fn explanation(&self) -> &'static str {
        "<p>A client on another core sends references, obstacles, measurements, requests and stops at times that \
         are spread evenly over the period, and has every command in its hands as soon as it is there: it wakes \
         up before each release and looks until the command has come.</p>\
         <p>The daemon takes inputs in once in a period, shortly before the release. So most of each way is \
         waiting for the grid, half a period on the average, whatever the machine does. <b>grid</b> is that part, \
         from sending to the start of the gather that takes the message; <b>machinery</b> is the rest: gather, \
         release, computation and hand-over. <b>bare</b> is iceoryx2 between two processes that do nothing else, \
         measured in the same rounds.</p>\
         <p>A stop is told without the ramp, which the configured deceleration makes.</p>"
    }

    fn json(&self) -> Result<serde_json::Value> {
        Ok(json!({
            "setting": self.setting,
            "legs": self.rows,
            "rounds": self.round_rows(),
            "ratios": self.ratios(),
            "targets": self.targets(),
            "unmeasured": self.unmeasured(),
        }))
    }

    fn tables(&self) -> Vec<Table> {
        vec![self.table(), self.verdicts(), self.definitions()]
    }

    fn sheets(&self) -> Result<Vec<Sheet>> {
        let sheet = |name: &str, csv: String| Sheet {
            name: name.to_owned(),
            csv,
        };
        Ok(vec![
            sheet("latency", csv(&self.rows)?),
            sheet("latency-rounds", csv(&self.round_rows())?),
        ])
    }

    fn pictures(&self) -> Result<Vec<Figure>> {
        Ok(vec![Figure {
            name: "latency",
            caption: "How long messages take. The time that one sample in so many exceeds: 100 is the 99th \
                      percentile. Last: the share of stops against the time to zero rates without the ramp."
                .to_owned(),
            svg: sheet(&self.panels(), 1, 700)?,
        }])
    }

    fn metrics(&self) -> Vec<Metric> {
        let legs = Leg::ALL.into_iter().filter(|leg| !leg.is_grid());
        let quantiles = [("p50", 0.5), ("p99", 0.99)];
        let metric = |leg: Leg| {
            quantiles.map(|(word, quantile)| {
                let of = |round: &Round| quantile_of(round, leg, quantile);
                let name = format!("latency/{}_{word}", leg.name().replace('.', "/"));
                Metric::lower(name, "µs", self.rounds.iter().filter_map(of))
            })
        };
        let ratios = self.ratios().into_iter().map(|ratio| {
            let part = |leg: Leg| leg.name().replace('.', "_");
            let name = format!("latency/{}_per_{}_p50", part(ratio.leg), part(ratio.to));
            Metric::lower(name, "", ratio.rounds)
        });
        legs.flat_map(metric).chain(ratios).collect()
    }

    fn histograms(&self) -> Vec<Recording<'_>> {
        let of = |round| {
            Leg::ALL.into_iter().filter_map(move |leg| {
                let sampled = Round::leg(round, leg);
                let (first_ns, last_ns) = sampled.span_ns?;
                Some(Recording {
                    tag: leg.name(),
                    start_s: first_ns as f64 * 1e-9,
                    duration_s: (last_ns - first_ns) as f64 * 1e-9,
                    histogram: &sampled.latencies,
                })
            })
        };
        self.rounds.iter().flat_map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setting() -> Setting {
        Setting {
            rounds: 2,
            samples: 100,
            stops: 20,
            period_us: 5000.0,
            gather_lead_us: 200.0,
            realtime: true,
            client_realtime: true,
            realtime_core: 1,
            client_core: 0,
            looks: Looks { all: 7, late: 1 },
        }
    }

    /// Two rounds in which every leg takes 1 to 100 µs, times the number of the round.
    fn report(stop_us: u64) -> Report {
        let round = |factor: u64| {
            let mut round = Round::new(0).expect("bounds");
            for leg in Leg::ALL {
                let is_stop = [Leg::StopZeroHandover, Leg::StopZeroCommand].contains(&leg);
                for us in 1..=100 {
                    round.record(leg, 1000 * if is_stop { stop_us } else { factor * us });
                }
            }
            round
        };
        Report::new(setting(), vec![round(1), round(2)])
    }

    #[test]
    fn every_leg_has_a_row_of_all_rounds() {
        let report = report(5000);
        assert_eq!(report.rows.len(), Leg::ALL.len());
        let row = &report.rows[Leg::ReferenceCommand as usize];
        assert_eq!((row.leg, row.samples), (Leg::ReferenceCommand, 200));
        let near = |value: f64, expected: f64| (value - expected).abs() <= 2e-3 * expected;
        assert!(near(row.latency_us.max, 200.0), "{row:?}");
        // The medians of the rounds are 50 and 100.
        assert!(near(row.rounds_us.p50, 75.0), "{row:?}");
        for ratio in report.ratios() {
            assert_eq!(ratio.rounds.len(), 2);
            assert!(near(ratio.p50, 1.0), "{ratio:?}");
        }
    }

    #[test]
    fn a_stop_has_a_period_and_a_little_more() {
        let kept = |stop_us| {
            report(stop_us)
                .targets()
                .iter()
                .map(|target| target.kept)
                .collect::<Vec<_>>()
        };
        assert_eq!(kept(5090), [true, true]);
        assert_eq!(kept(5120), [false, false]);
    }

    #[test]
    fn it_can_be_told_in_every_way() {
        let report = report(5000);
        let json = report.json().expect("numbers");
        assert_eq!(json["legs"][0]["leg"], "bare.one_way");
        assert!(json["legs"][0]["latency_us"]["p999"].is_f64());
        assert_eq!(
            json["rounds"].as_array().map(Vec::len),
            Some(2 * Leg::ALL.len())
        );
        let sheets = report.sheets().expect("rows");
        assert_eq!(sheets[0].csv.lines().count(), 1 + Leg::ALL.len());
        assert_eq!(report.histograms().len(), 2 * Leg::ALL.len());
        let svg = &report.pictures().expect("drawn")[0].svg;
        assert!(svg.contains("stop.zero_command") && svg.contains("bare.one_way"));
        let metrics = report.metrics();
        assert!(metrics.iter().all(|metric| metric.rounds.len() == 2));
        assert!(
            metrics
                .iter()
                .any(|metric| metric.name == "latency/stop/zero_command_p99")
        );
        assert!(!metrics.iter().any(|metric| metric.name.contains("grid")));
        assert!(report.tables()[0].text().contains("measurement.machinery"));
    }

    #[test]
    fn a_percentile_of_too_few_values_is_not_printed() {
        let mut round = Round::new(0).expect("bounds");
        for (leg, count) in [
            (Leg::StopCommand, 99),
            (Leg::StopZeroHandover, 99),
            (Leg::LeaseAnswer, 100),
            (Leg::BareOneWay, 1000),
        ] {
            for us in 1..=count {
                round.record(leg, 1000 * us);
            }
        }
        let report = Report::new(setting(), vec![round]);
        let absent = |leg: Leg| {
            let row = report.rows.iter().find(|row| row.leg == leg);
            let cells = report.cells(row.expect("it was measured"));
            [4, 5, 8].map(|column: usize| cells[column] == "-")
        };
        assert_eq!(absent(Leg::StopCommand), [true, true, true]);
        assert_eq!(absent(Leg::LeaseAnswer), [false, true, false]);
        assert_eq!(absent(Leg::BareOneWay), [false, false, false]);
        assert!(report.verdicts().text().contains("too few values"));
        let json = report.json().expect("numbers");
        assert!(json["legs"][0]["latency_us"]["p999"].is_f64());
        assert!(json["targets"][0]["p99_us"].is_f64());
    }

    #[test]
    fn what_could_not_be_measured_is_told() {
        let mut report = report(5000);
        report.rounds[0].unmeasured.spoilt_stops = 2;
        report.rounds[1].unmeasured.spoilt_stops = 1;
        report.rounds[1].unmeasured.without_command = 17;
        let json = report.json().expect("numbers");
        assert_eq!(json["unmeasured"]["spoilt_stops"], 3);
        assert_eq!(json["unmeasured"]["without_command"], 17);
        let text = report.verdicts().text();
        assert!(
            text.contains("spoilt stops") && text.contains("17"),
            "{text}"
        );
    }

    #[test]
    fn what_was_not_measured_has_no_row() {
        let mut round = Round::new(0).expect("bounds");
        round.record(Leg::BareOneWay, 500);
        let report = Report::new(setting(), vec![round]);
        assert_eq!(report.rows.len(), 1);
        assert!(report.ratios().is_empty() && report.targets().is_empty());
        assert!(report.pictures().is_ok());
    }
}
