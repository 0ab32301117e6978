//! Resources of a daemon: cores, memory, files, start-up time.

mod daemon;

use std::time::Duration;

use anyhow::Result;
use cdcr_process::program;
use cdcr_shared_types::duration_in;
use serde_json::{Value, json};

use crate::benchmark::Benchmark;
use crate::chart::{BLUE, Curve, GREY, Panel, Scale};
use crate::dataset::{Dataset, each, filled, joined, number, together};
use crate::metric::{Better, Metric, median, range};
use crate::progress::Progress;
use crate::subject::daemon::Launch;
use crate::system::cores::Cores;
use crate::system::thread::may_be_realtime;
use daemon::MB;

/// Duration of the measurement without a client, as a share of that with tracking.
const IDLE_SHARE: f64 = 0.4;
/// Approximate time for start, begin of tracking, warm-up and end \[s\].
const AROUND_S: f64 = 2.3;

const YES_NO: &str = "yes/no";

#[derive(Debug, Clone, Copy, PartialEq, clap::Args)]
pub struct FootprintOptions {
    /// Number of daemons, measured one after the other, 1 to 100.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Tracking time per daemon, 100ms to 1h; without a client it is measured for 2/5 of that.
    // Shorter, the counts of the kernel have no meaning.
    #[arg(long, default_value = "10s", value_parser = duration_in(0.1..=3600.0))]
    duration: Duration,
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

    fn expected_s(&self) -> f64 {
        f64::from(self.rounds) * self.round_s()
    }

    fn run(&self, progress: &mut Progress) -> Result<Dataset> {
        let cores = Cores::find()?;
        cores.stay_off();
        let realtime = may_be_realtime();
        let launch = Launch::stall_tolerant(None).placed(&cores, realtime);
        let durations = [self.duration.mul_f64(IDLE_SHARE), self.duration];
        let mut rounds = Vec::new();
        for round in 1..=self.rounds {
            progress.begin(&format!("daemon {round} of {}", self.rounds));
            let start = daemon::start_times(&launch, &cores)?;
            let usage = daemon::usage(&launch, &cores, durations)?;
            rounds.push(joined([start, usage]));
            progress.advance(self.round_s());
        }
        dataset(rounds, realtime)
    }
}

fn dataset(rounds: Vec<Value>, realtime: bool) -> Result<Dataset> {
    let refused = ", without SCHED_FIFO and locked memory (not granted)";
    let how = if realtime { "" } else { refused };
    let mut dataset = Dataset::new("footprint", include_str!("footprint.toml"));
    dataset.fact("realtime", realtime);
    let mut quantities = Vec::new();
    for (what, unit, key) in dataset.table("quantities").metrics.clone() {
        quantities.extend(quantity(&mut dataset, [&what, &key, &unit], &rounds));
    }
    let (threads, programs) = (threads(&rounds), programs());
    for thread in &threads {
        let name = filled("threads_{name}_tracking_percent", thread);
        let values = each(&rounds, &name);
        let name = filled("footprint/thread/{name}/tracking", thread);
        dataset.lower(name, "%", values);
    }
    for program in &programs {
        let name = filled("footprint/program/{name}", program);
        dataset.lower(name, "MB", number(program, "mb"));
    }
    dataset.plot("footprint", &[bars(&threads)])?;
    let count = rounds.len().to_string();
    dataset.add_titled("quantities", &[&count, how], quantities);
    dataset.add_titled("threads", &[how], threads);
    dataset.add("programs", programs);
    dataset.add("rounds", rounds);
    Ok(dataset)
}

fn quantity(
    dataset: &mut Dataset,
    [what, key, unit]: [&str; 3],
    rounds: &[Value],
) -> Option<Value> {
    let (middle, (least, most)) = (median(each(rounds, key))?, range(each(rounds, key))?);
    let metric = format!("footprint/{key}");
    let mut targets = dataset.declaration.targets.iter();
    let limit = targets.find(|target| target.metric == metric);
    let limit = limit.map(|target| target.most);
    if unit == YES_NO {
        // In every round.
        let words = ["memory is locked (1: in every round)", "1", ""];
        let found = (least, json!([least, most]), String::new());
        dataset.target(words, Some(found), 1.0..=1.0);
        dataset.add_metric(Metric::new(metric, unit, Better::Higher, each(rounds, key)));
    } else {
        dataset.lower(metric, unit, each(rounds, key));
    }
    Some(json!({
        "what": what,
        "key": key,
        "unit": unit,
        "median": middle,
        "least": least,
        "most": most,
        "target": limit,
        "reached": limit.map(|limit| middle <= limit),
    }))
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
    let threads = all["threads"].as_object().into_iter().flatten();
    let mut threads: Vec<Value> = threads.map(row).collect();
    let percent = |row: &Value| number(row, "tracking_percent").unwrap_or(0.0);
    threads.sort_by(|one, other| percent(other).total_cmp(&percent(one)));
    threads
}

fn programs() -> Vec<Value> {
    let row = |name| {
        let bytes = std::fs::metadata(program(name).ok()?).ok()?.len();
        Some(json!({ "name": name, "bytes": bytes, "mb": bytes as f64 / MB }))
    };
    let programs = ["cdcrd", "cdcrctl", "cdcr-bench"].into_iter();
    programs.filter_map(row).collect()
}

/// One pair of bars for each thread, the busiest on top.
fn bars(threads: &[Value]) -> Panel {
    let mut curves = Vec::new();
    for (row, line) in threads.iter().zip((1..=threads.len()).rev()) {
        let percent = |key| number(row, key).unwrap_or(0.0);
        let (tracking, idle) = (percent("tracking_percent"), percent("idle_percent"));
        let name = row["name"].as_str().unwrap_or_default();
        let label = format!("{line}: {name} {tracking:.3} %, idle {idle:.3} %");
        let mut bar = |label, percent: f64, above, colour| {
            let ends = [0.0, percent.max(0.0)].map(|x| (x, line as f64 + above));
            curves.push(Curve::line(label, ends.into(), colour).width(12));
        };
        bar(label, tracking, 0.15, BLUE);
        bar(String::new(), idle, -0.15, GREY);
    }
    let axes = ["share of a core [%]", "thread"];
    Panel::new("Share of a core", axes, Scale::Linear, curves)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_of_the_rounds_is_what_a_target_is_for() {
        let rounds = [1.5, 9.5, 2.5].map(|core| {
            let threads = json!({ "a": { "tracking_percent": core, "idle_percent": 0.1 }, "b": { "tracking_percent": 2.0 } });
            json!({ "core_tracking_percent": core, "growth_kb": 4.096, "page_faults": 0.0, "peak_mb": 1.0, "threads": threads })
        });
        let found = dataset(rounds.into(), true).unwrap();
        // 4096 bytes were added while tracking: the target is zero. What was not measured has no row.
        let of = |rows: &[Value], keys: &[&str]| {
            let row = |row: &Value| keys.iter().map(|key| row[*key].clone()).collect();
            json!(rows.iter().map(row).collect::<Vec<Vec<_>>>())
        };
        let keys = ["median", "least", "most", "reached"];
        let quantities = of(found.rows("quantities"), &keys);
        let expected =
            "[[2.5,1.5,9.5,true],[4.096,4.096,4.096,false],[0.0,0.0,0.0,true],[1.0,1.0,1.0,null]]";
        assert_eq!(quantities.to_string(), expected);
        let reached = of(&found.all_targets(), &["reached"]);
        assert_eq!(reached, json!([[true], [false], [true]]));
        let threads = of(found.rows("threads"), &["name", "tracking_us_per_cycle"]);
        assert_eq!(threads[0], json!(["a", 125.0]));
    }
}
