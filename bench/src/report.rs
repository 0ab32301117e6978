//! Results of one or all benchmarks as documents: text, JSON, CSV, plots, a page and raw histograms.

mod page;

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Instant, SystemTime};

use anyhow::{Context, Result, anyhow};
use cdcr_process::fill_folder;
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::benchmark::Benchmark;
use crate::dataset::Dataset;
use crate::environment::Environment;
use crate::hlog;
use crate::interrupt;
use crate::metric::Metric;
use crate::progress::Progress;
use crate::run_options::RunOptions;

pub const QUICK: &str =
    "This was a short run (--quick): it shows that everything runs, and is not a measurement.";

/// The benchmarks whose targets need real time and the default configuration.
const TARGETED: [&str; 4] = ["deadline", "latency", "rate", "footprint"];

/// Key of the cause in the result of a failed benchmark.
const ERROR: &str = "error";

pub type Files = BTreeMap<String, String>;

/// Start time, machine and options of a run.
#[derive(Debug, Clone)]
pub struct Start {
    pub time: SystemTime,
    pub environment: Environment,
    pub options: RunOptions,
}

impl Start {
    /// The present state. Call it before any thread of this process is pinned.
    pub fn now(options: RunOptions) -> Result<Self> {
        Ok(Self {
            time: SystemTime::now(),
            environment: Environment::find()?,
            options,
        })
    }

    fn machine(&self) -> Dataset {
        let mut machine = Dataset::new("environment", include_str!("report/environment.toml"));
        machine.add("machine", self.environment.rows());
        machine
    }

    fn json(&self, mut keys: Map<String, Value>, metrics: &[Metric]) -> Result<String> {
        keys.insert("environment".to_owned(), json!(self.environment));
        keys.insert("options".to_owned(), json!(self.options));
        keys.insert("metrics".to_owned(), json!(metrics));
        Ok(serde_json::to_string(&keys)? + "\n")
    }

    pub fn json_of(&self, dataset: &Dataset) -> Result<String> {
        let mut keys = dataset.json();
        keys.insert("tables".to_owned(), dataset.shown());
        self.json(keys, &dataset.metrics)
    }

    pub fn files_of(&self, dataset: &Dataset) -> Result<Files> {
        let all = [dataset, &self.machine()];
        let (name, json) = (dataset.name, self.json_of(dataset)?);
        let mut files = documents(name, &format!("cdcr-bench {name}"), "", &all, json);
        add_data(&mut files, self.time, dataset)?;
        Ok(files)
    }
}

fn documents(name: &str, title: &str, introduction: &str, all: &[&Dataset], json: String) -> Files {
    let texts: Vec<String> = all.iter().map(|dataset| dataset.text()).collect();
    Files::from([
        (format!("{name}.json"), json),
        (format!("{name}.txt"), texts.join("\n")),
        (format!("{name}.html"), page::page(title, introduction, all)),
    ])
}

fn add_data(files: &mut Files, started: SystemTime, dataset: &Dataset) -> Result<()> {
    for (file, csv) in dataset.csv() {
        files.insert(format!("{file}.csv"), csv?);
    }
    for plot in dataset.plots() {
        files.insert(format!("{}.svg", plot.name), plot.svg.clone());
    }
    if let Some(log) = hlog::log(started, &dataset.recordings)? {
        files.insert(format!("histograms/{}.hlog", dataset.name), log);
    }
    Ok(())
}

pub fn write(files: &Files, folder: &Path) -> Result<()> {
    fill_folder(folder, |fresh| {
        for (name, text) in files {
            let file = fresh.join(name);
            let made = fs::create_dir_all(file.parent().unwrap_or(fresh));
            let written = made.and_then(|()| fs::write(&file, text));
            written.with_context(|| format!("cannot write {name}"))?;
        }
        Ok(())
    })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::Args)]
pub struct Extent {
    /// Run all benchmarks in a few minutes; not a measurement.
    #[arg(long)]
    pub quick: bool,
    /// Rounds per benchmark, 1 to 100 [default: that of each benchmark]; compare needs at least 3.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: Option<u32>,
}

type Run = dyn FnOnce(&mut Progress) -> Result<Dataset> + Send;

pub struct Plan {
    name: &'static str,
    pub expected_s: f64,
    run: Box<Run>,
}

impl Plan {
    pub fn new<B: Benchmark>(name: &'static str, extent: Extent, config: Option<&PathBuf>) -> Self {
        let rounds = extent.rounds.map(|rounds| format!("--rounds={rounds}"));
        let mut given = Vec::from_iter(rounds.map(OsString::from));
        if let Some(config) = config.filter(|_| B::HAS_CONFIG) {
            given.extend(["--config".into(), config.into()]);
        }
        let options = B::of_report(extent.quick, &given);
        Self {
            name,
            expected_s: options.expected_s(),
            run: Box::new(move |progress| options.run(progress)),
        }
    }

    /// Runs in a separate thread, whose core and priority settings end with it. The result of a benchmark that
    /// fails is its cause.
    fn carry_out(self, progress: &mut Progress) -> ReportPart {
        let (started, begin) = (SystemTime::now(), Instant::now());
        let Self { name, run, .. } = self;
        let result = thread::scope(|scope| scope.spawn(|| run(progress)).join());
        let panicked = "the benchmark panicked; its message is on the standard error";
        let result = result.unwrap_or_else(|_| Err(anyhow!(panicked)));
        let failed = |cause: anyhow::Error| {
            let mut dataset = Dataset::new(name, "heading = ''\nexplanation = ''");
            name.clone_into(&mut dataset.declaration.heading);
            dataset.note = format!("{name} failed. There is no result: {cause:#}");
            dataset.warns = true;
            dataset.fact(ERROR, format!("{cause:#}"));
            dataset
        };
        ReportPart {
            dataset: result.unwrap_or_else(failed),
            started,
            took_s: begin.elapsed().as_secs_f64(),
        }
    }
}

pub fn run(plans: Vec<Plan>, progress: &mut Progress) -> Result<Vec<ReportPart>> {
    let mut left_s: f64 = plans.iter().map(|plan| plan.expected_s).sum();
    let mut parts = Vec::new();
    for plan in plans {
        interrupt::check()?;
        progress.begin_part(plan.name, left_s);
        left_s -= plan.expected_s;
        parts.push(plan.carry_out(progress));
    }
    interrupt::check()?;
    Ok(parts)
}

pub struct ReportPart {
    pub dataset: Dataset,
    started: SystemTime,
    took_s: f64,
}

impl ReportPart {
    pub fn has_failed(&self) -> bool {
        self.dataset.facts.contains_key(ERROR)
    }
}

pub struct BenchReport {
    pub start: Start,
    pub extent: Extent,
    pub default_config: bool,
    pub parts: Vec<ReportPart>,
}

impl BenchReport {
    pub fn failed(&self) -> Vec<&'static str> {
        let failed = self.parts.iter().filter(|part| part.has_failed());
        failed.map(|part| part.dataset.name).collect()
    }

    fn datasets(&self) -> impl Iterator<Item = &Dataset> {
        self.parts.iter().map(|part| &part.dataset)
    }

    /// The project's targets and the measured values. Without rows if none was measured; with a note if the
    /// conditions of the targets were not met.
    fn targets(&self) -> Dataset {
        let mut dataset = Dataset::new("targets", include_str!("report/targets.toml"));
        let has_any = self.datasets().any(|of| TARGETED.contains(&of.name));
        let realtime = self.start.environment.is_realtime();
        let mut rows = Vec::new();
        if !has_any || (realtime && self.default_config) {
            rows.extend(self.datasets().flat_map(Dataset::all_targets));
        } else {
            let why = if realtime {
                "they are for the default configuration, and --config named another"
            } else {
                "they are for real time, which this user is not granted"
            };
            dataset.note = format!("The targets were not evaluated: {why}.");
        }
        dataset.add("targets", rows);
        dataset
    }

    fn front(&self) -> Vec<Dataset> {
        let mut front = vec![self.start.machine(), self.targets()];
        front.retain(|dataset| dataset.tables().next().is_some() || !dataset.note.is_empty());
        if self.extent.quick {
            (front[0].note, front[0].warns) = (QUICK.to_owned(), true);
        }
        front
    }

    pub fn summary(&self) -> String {
        let failed = self.parts.iter().filter(|part| part.has_failed());
        let failed = failed.map(|part| part.dataset.text());
        let front = self.front();
        let texts: Vec<String> = front.iter().map(Dataset::text).chain(failed).collect();
        texts.join("\n")
    }

    fn json(&self) -> Result<String> {
        let targets = self.targets();
        let mut all = targets.json();
        let (mut tables, mut took_s) = (json!({ "targets": targets.shown() }), json!({}));
        for part in &self.parts {
            let name = part.dataset.name;
            all.insert(name.to_owned(), part.dataset.json().into());
            (tables[name], took_s[name]) = (part.dataset.shown(), part.took_s.into());
        }
        let (extent, failed) = (self.extent, self.failed());
        let own = json!({ "tables": tables, "extent": extent, "failed": failed, "took_s": took_s });
        all.extend(own.as_object().cloned().unwrap_or_default());
        if !targets.note.is_empty() {
            all.insert("targets_not_evaluated".to_owned(), targets.note.into());
        }
        let metrics = self.datasets().map(|dataset| &dataset.metrics[..]);
        self.start.json(all, &metrics.collect::<Vec<_>>().concat())
    }

    pub fn files(&self) -> Result<Files> {
        let front = self.front();
        let all: Vec<&Dataset> = front.iter().chain(self.datasets()).collect();
        let title = "What cdcr reaches, measured";
        let mut files = documents("report", title, page::INTRODUCTION, &all, self.json()?);
        for part in &self.parts {
            add_data(&mut files, part.started, &part.dataset)?;
        }
        Ok(files)
    }

    /// Names of benchmarks with a result in an older `report.json` and none in this one, including benchmarks
    /// that no longer exist.
    pub fn would_lose(&self, older: &str) -> BTreeSet<String> {
        let older: Value = serde_json::from_str(older).unwrap_or_default();
        let has = |name: &str| {
            let mut parts = self.parts.iter();
            parts.any(|it| it.dataset.name == name && !it.has_failed())
        };
        let ran = older["took_s"].as_object().into_iter().flat_map(Map::keys);
        let lost = ran.filter(|name| older[*name].get(ERROR).is_none() && !has(name));
        lost.cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_benchmark_that_panics_is_a_part_without_a_result() {
        let plan = Plan {
            name: "budget",
            expected_s: 1.0,
            run: Box::new(|_| panic!("a test of a panic")),
        };
        let part = plan.carry_out(&mut Progress::silent());
        assert!(part.has_failed() && part.dataset.note.contains("panicked"));
    }
}
