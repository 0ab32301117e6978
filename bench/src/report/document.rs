//! Results as JSON: the machine, what each benchmark found, and the single numbers to compare by.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{Extent, Report, Start, Target};
use crate::environment::{Environment, Options};
use crate::metric::Metric;
use crate::section::Section;

/// Keys of a document beside those of its results.
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

#[derive(Serialize)]
struct One<'a> {
    environment: &'a Environment,
    options: &'a Options,
    #[serde(flatten)]
    result: Map<String, Value>,
    metrics: Vec<Metric>,
}

#[derive(Serialize)]
struct All<'a> {
    environment: &'a Environment,
    options: &'a Options,
    extent: Extent,
    targets: Vec<Target>,
    #[serde(skip_serializing_if = "Option::is_none")]
    targets_not_judged: Option<&'static str>,
    failed: Vec<&'static str>,
    took_s: BTreeMap<&'static str, f64>,
    #[serde(flatten)]
    results: Map<String, Value>,
    metrics: Vec<Metric>,
}

/// One result: the machine, its own keys, and its single numbers.
pub(super) fn of_section(start: &Start, section: &dyn Section) -> Result<String> {
    line(&One {
        environment: &start.environment,
        options: &start.options,
        result: object(section)?,
        metrics: section.metrics(),
    })
}

/// All results, each under its name; of one that failed the key `error`.
pub(super) fn of_report(report: &Report) -> Result<String> {
    let took = report.parts.iter().map(|part| (part.name, part.took_s));
    line(&All {
        environment: &report.start.environment,
        options: &report.start.options,
        extent: report.extent,
        targets: report.targets()?,
        targets_not_judged: report.not_judged(),
        failed: report.failures().map(|(name, _)| name).collect(),
        took_s: took.collect(),
        results: results(report)?,
        metrics: report.metrics(),
    })
}

/// What each benchmark found, under its name.
pub(super) fn results(report: &Report) -> Result<Map<String, Value>> {
    let result = |part: &super::Part| {
        let value = match &part.result {
            Ok(section) => Value::Object(object(&**section)?),
            Err(cause) => json!({ "error": cause }),
        };
        Ok((part.name.to_owned(), value))
    };
    report.parts.iter().map(result).collect()
}

/// The benchmarks that an older report has a result of.
pub(super) fn measured_in(older: &str) -> Vec<String> {
    let Ok(Value::Object(older)) = serde_json::from_str(older) else {
        return Vec::new();
    };
    let is_result = |key: &str, value: &Value| {
        !OUR_KEYS.contains(&key) && value.is_object() && value.get("error").is_none()
    };
    let results = older
        .into_iter()
        .filter(|(key, value)| is_result(key, value));
    results.map(|(key, _)| key).collect()
}

fn object(section: &dyn Section) -> Result<Map<String, Value>> {
    let name = section.name();
    let value = section.json().with_context(|| format!("{name} as JSON"))?;
    let Value::Object(object) = value else {
        bail!("{name} as JSON is no object");
    };
    for key in ["environment", "metrics", "options"] {
        ensure!(
            !object.contains_key(key),
            "{name} has a key {key:?} of its own, which stands for something else beside it"
        );
    }
    Ok(object)
}

fn line(document: &impl Serialize) -> Result<String> {
    Ok(serde_json::to_string(document)? + "\n")
}
