//! Results as documents: one benchmark, or all of them, as text, Markdown, JSON, CSV, plots, a page and raw histograms.
//!
//! Invariant: nothing here measures; [`benchmark`] only calls what does.

pub mod benchmark;
mod bundle;
mod page;
mod targets;

use std::collections::BTreeMap;
use std::time::SystemTime;

use anyhow::Result;
pub use bundle::Bundle;
use serde::Serialize;
use serde_json::{Map, Value, json};
pub use targets::{Target, targets};

use crate::dataset::{Dataset, Sheet};
use crate::environment::{Environment, RunOptions};
use crate::hlog;
use crate::metric::Metric;

/// Said of a report of `--quick`.
const QUICK: &str =
    "This was a quick look (--quick): it shows that everything runs, and proves nothing.";

/// Keys of a report beside those of its results.
const OUR_KEYS: [&str; 8] = [
    "environment",
    "extent",
    "failed",
    "metrics",
    "options",
    "targets",
    "targets_not_judged",
    "took_s",
];

/// When a run began, and on what machine.
#[derive(Debug, Clone)]
pub struct Start {
    pub time: SystemTime,
    pub environment: Environment,
    pub options: RunOptions,
}

impl Start {
    /// Now. To be asked before any thread of this process is pinned.
    pub fn now() -> Result<Self> {
        Ok(Self {
            time: SystemTime::now(),
            environment: Environment::find()?,
            options: RunOptions::find(),
        })
    }
}

/// How much of each benchmark is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::Args)]
pub struct Extent {
    /// A look of a few minutes that proves little.
    #[arg(long)]
    pub quick: bool,
    /// Rounds of each benchmark, 1 to 100, instead of the usual number of each; compare needs at least 3.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub rounds: Option<u32>,
}

pub struct Part {
    pub name: &'static str,
    pub started: SystemTime,
    pub took_s: f64,
    /// Its result, or why there is none.
    pub result: Result<Dataset, String>,
}

pub struct BenchReport {
    pub start: Start,
    pub extent: Extent,
    pub default_config: bool,
    /// One for each benchmark that was asked for, in their order.
    pub parts: Vec<Part>,
}

impl BenchReport {
    fn datasets(&self) -> impl Iterator<Item = &Dataset> {
        self.parts
            .iter()
            .filter_map(|part| part.result.as_ref().ok())
    }

    /// Name of each benchmark that failed, and why.
    pub fn failures(&self) -> impl Iterator<Item = (&'static str, &str)> {
        let parts = self.parts.iter();
        parts.filter_map(|part| Some((part.name, part.result.as_ref().err()?.as_str())))
    }

    /// What each benchmark found, under its name; of one that failed the key `error`.
    fn results(&self) -> Map<String, Value> {
        let result = |part: &Part| match &part.result {
            Ok(dataset) => (part.name.to_owned(), dataset.json().into()),
            Err(cause) => (part.name.to_owned(), json!({ "error": cause })),
        };
        self.parts.iter().map(result).collect()
    }

    fn metrics(&self) -> Vec<Metric> {
        self.datasets()
            .flat_map(|dataset| dataset.metrics.clone())
            .collect()
    }

    /// What was asked of the project, and what was found; without rows when nothing of it was measured, or
    /// not under the conditions of the figures.
    fn targets(&self) -> Vec<Target> {
        match self.not_judged() {
            Some(_) => Vec::new(),
            None => targets(&self.metrics(), &self.results()),
        }
    }

    fn target_sheet(&self) -> Result<Option<Sheet>> {
        let targets = self.targets();
        (!targets.is_empty())
            .then(|| targets::sheet(&targets))
            .transpose()
    }

    /// Why the figures to reach were not judged, in a sentence; none when they were, or when no benchmark that
    /// has any was asked for.
    pub fn not_judged(&self) -> Option<&'static str> {
        let mut parts = self.parts.iter();
        let has_any = parts.any(|part| targets::JUDGED.contains(&part.name));
        match (has_any, self.start.environment.is_realtime()) {
            (false, _) => None,
            (true, false) => Some(
                "The figures to reach were not judged: they are for real time, which this user is not granted.",
            ),
            (true, true) => (!self.default_config).then_some(
                "The figures to reach were not judged: they are for the default configuration, and --config \
                 named another.",
            ),
        }
    }

    /// The machine, the targets, and what failed, as text.
    pub fn summary(&self) -> Result<String> {
        let mut texts = vec![self.start.environment.table().text()];
        texts.extend(self.extent.quick.then(|| QUICK.to_owned() + "\n"));
        texts.extend(self.target_sheet()?.map(|sheet| sheet.text()));
        texts.extend(self.not_judged().map(|why| why.to_owned() + "\n"));
        let failures = self.failures();
        texts.extend(failures.map(|(name, cause)| format!("{name} failed: {cause}\n")));
        Ok(texts.join("\n"))
    }

    /// The whole as JSON, with a line feed at the end.
    pub fn json(&self) -> Result<String> {
        let took = self.parts.iter().map(|part| (part.name, part.took_s));
        let failed: Vec<&str> = self.failures().map(|(name, _)| name).collect();
        let mut all = self.results();
        let ours = [
            ("extent", json!(self.extent)),
            ("targets", json!(self.targets())),
            ("failed", json!(failed)),
            ("took_s", json!(took.collect::<BTreeMap<_, _>>())),
        ];
        all.extend(ours.map(|(key, value)| (key.to_owned(), value)));
        let why = self.not_judged();
        all.extend(why.map(|why| ("targets_not_judged".to_owned(), why.into())));
        document(&self.start, all, &self.metrics())
    }

    pub fn bundle(&self) -> Result<Bundle> {
        let mut bundle = Bundle::default();
        let page = page::of_report(self, self.target_sheet()?.as_ref());
        bundle.add("report.html", page)?;
        let mut text = self.summary()?;
        for dataset in self.datasets() {
            text.push('\n');
            text += &dataset.text();
        }
        bundle.add("report.txt", text)?;
        bundle.add("report.json", self.json()?)?;
        for part in &self.parts {
            if let Ok(dataset) = &part.result {
                add_data(&mut bundle, part.started, dataset)?;
            }
        }
        Ok(bundle)
    }

    /// Which of the benchmarks in an older `report.json` this one has no result of. A report that is not
    /// ours has none.
    pub fn would_lose(&self, older: &str) -> Vec<String> {
        let Ok(Value::Object(older)) = serde_json::from_str(older) else {
            return Vec::new();
        };
        let is_result = |key: &str, value: &Value| {
            !OUR_KEYS.contains(&key) && value.is_object() && value.get("error").is_none()
        };
        let has = |name: &str| self.datasets().any(|dataset| dataset.name == name);
        let results = older
            .into_iter()
            .filter(|(key, value)| is_result(key, value));
        results
            .map(|(key, _)| key)
            .filter(|key| !has(key))
            .collect()
    }
}

fn document(start: &Start, mut keys: Map<String, Value>, metrics: &[Metric]) -> Result<String> {
    let ours = [
        ("environment", json!(start.environment)),
        ("options", json!(start.options)),
        ("metrics", json!(metrics)),
    ];
    keys.extend(ours.map(|(key, value)| (key.to_owned(), value)));
    Ok(serde_json::to_string(&keys)? + "\n")
}

/// One result as JSON, with a line feed at the end.
pub fn dataset_json(start: &Start, dataset: &Dataset) -> Result<String> {
    document(start, dataset.json(), &dataset.metrics)
}

pub fn dataset_bundle(start: &Start, dataset: &Dataset) -> Result<Bundle> {
    let (name, mut bundle) = (dataset.name, Bundle::default());
    let machine = start.environment.table();
    bundle.add(format!("{name}.html"), page::of_dataset(start, dataset))?;
    let text = machine.text() + "\n" + &dataset.text();
    bundle.add(format!("{name}.txt"), text)?;
    bundle.add(format!("{name}.json"), dataset_json(start, dataset)?)?;
    add_data(&mut bundle, start.time, dataset)?;
    Ok(bundle)
}

fn add_data(bundle: &mut Bundle, started: SystemTime, dataset: &Dataset) -> Result<()> {
    let name = dataset.name;
    for (file, csv) in dataset.csv() {
        bundle.add(file_name(name, file) + ".csv", csv?)?;
    }
    for plot in &dataset.plots {
        bundle.add(file_name(name, plot.name) + ".svg", plot.svg.clone())?;
    }
    if let Some(log) = hlog::log(started, &dataset.recordings)? {
        bundle.add(format!("histograms/{name}.hlog"), log)?;
    }
    Ok(())
}

/// A name that begins with that of its benchmark, so that no two benchmarks write the same file.
fn file_name(benchmark: &str, name: &str) -> String {
    let rest = name.strip_prefix(benchmark);
    if rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('-')) {
        name.to_owned()
    } else {
        format!("{benchmark}-{name}")
    }
}

#[cfg(test)]
mod tests {
    use super::file_name;

    #[test]
    fn every_name_begins_with_its_benchmark() {
        assert_eq!(file_name("rate", "rate"), "rate");
        assert_eq!(file_name("rate", "rate-sections"), "rate-sections");
        assert_eq!(file_name("rate", "rates"), "rate-rates");
        assert_eq!(file_name("rate", "sections"), "rate-sections");
    }
}
