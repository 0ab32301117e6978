//! Results as documents: one benchmark, or all of them, as text, JSON, CSV, pictures, a page and raw
//! histograms.
//!
//! Invariant: nothing here measures; [`offline`] and [`benchmark`] only call what does.

pub mod benchmark;
mod bundle;
mod document;
mod html;
pub mod offline;
mod targets;

use std::time::SystemTime;

use anyhow::Result;
pub use bundle::Bundle;
use serde::Serialize;
pub(crate) use targets::number;
pub use targets::{Target, targets};

use crate::environment::{Environment, Options};
use crate::hlog;
use crate::metric::Metric;
use crate::section::Section;
use crate::table::Table;

/// Said of a report of `--quick`.
const QUICK: &str =
    "This was a quick look (--quick): it shows that everything runs, and proves nothing.";

/// When a run began, and on what machine.
#[derive(Debug, Clone)]
pub struct Start {
    pub time: SystemTime,
    pub environment: Environment,
    pub options: Options,
}

impl Start {
    /// Now. To be asked before any thread of this process is pinned.
    pub fn now() -> Result<Self> {
        Ok(Self {
            time: SystemTime::now(),
            environment: Environment::find()?,
            options: Options::find(),
        })
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Extent {
    pub quick: bool,
    /// Rounds, where another number than the usual one was asked for.
    pub rounds: Option<u32>,
}

pub struct Part {
    pub name: &'static str,
    pub started: SystemTime,
    pub took_s: f64,
    /// Its result, or why there is none.
    pub result: Result<Box<dyn Section + Send>, String>,
}

pub struct Report {
    pub start: Start,
    pub extent: Extent,
    /// The daemon had its default configuration.
    pub default_config: bool,
    /// One for each benchmark that was asked for, in their order.
    pub parts: Vec<Part>,
}

impl Report {
    pub fn sections(&self) -> impl Iterator<Item = &dyn Section> {
        let results = self
            .parts
            .iter()
            .filter_map(|part| part.result.as_ref().ok());
        results.map(|section| &**section as &dyn Section)
    }

    /// Name of each benchmark that failed, and why.
    pub fn failures(&self) -> impl Iterator<Item = (&'static str, &str)> {
        let parts = self.parts.iter();
        parts.filter_map(|part| Some((part.name, part.result.as_ref().err()?.as_str())))
    }

    pub fn metrics(&self) -> Vec<Metric> {
        self.sections().flat_map(Section::metrics).collect()
    }

    /// What was asked of the project, and what was found; without rows when nothing of it was measured, or
    /// not under the conditions of the figures.
    pub fn targets(&self) -> Result<Vec<Target>> {
        if self.not_judged().is_some() {
            return Ok(Vec::new());
        }
        Ok(targets(&self.metrics(), &document::results(self)?))
    }

    /// Why the figures to reach were not judged, in a sentence; none when they were, or when no benchmark that
    /// has any was asked for.
    pub fn not_judged(&self) -> Option<&'static str> {
        let mut parts = self.parts.iter();
        let has_any = parts.any(|part| targets::JUDGED.contains(&part.name));
        match (has_any, self.start.environment.privileges.realtime) {
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

    pub fn text(&self) -> Result<String> {
        let mut texts = vec![self.summary()?];
        for part in &self.parts {
            match &part.result {
                Ok(section) => texts.push(section_text(&**section)),
                Err(cause) => texts.push(format!("{} failed: {cause}\n", part.name)),
            }
        }
        Ok(texts.join("\n"))
    }

    /// The machine, the targets, and what failed, as text.
    pub fn summary(&self) -> Result<String> {
        let mut texts = vec![self.start.environment.table().text()];
        if self.extent.quick {
            texts.push(QUICK.to_owned() + "\n");
        }
        let targets = self.targets()?;
        if !targets.is_empty() {
            texts.push(targets::table(&targets).text());
        }
        texts.extend(self.not_judged().map(|why| why.to_owned() + "\n"));
        for (name, cause) in self.failures() {
            texts.push(format!("{name} failed: {cause}\n"));
        }
        Ok(texts.join("\n"))
    }

    /// The whole as JSON, with a line feed at the end.
    pub fn json(&self) -> Result<String> {
        document::of_report(self)
    }

    pub fn bundle(&self) -> Result<Bundle> {
        let mut bundle = Bundle::default();
        bundle.add("report.html", html::of_report(self)?)?;
        bundle.add("report.txt", self.text()?)?;
        bundle.add("report.json", self.json()?)?;
        for part in &self.parts {
            if let Ok(section) = &part.result {
                add_data(&mut bundle, part.started, &**section)?;
            }
        }
        Ok(bundle)
    }

    /// Which of the benchmarks in an older `report.json` this one has no result of. A report that is not
    /// ours has none.
    pub fn would_lose(&self, older: &str) -> Vec<String> {
        let has = |name: &str| self.sections().any(|section| section.name() == name);
        let mut names = document::measured_in(older);
        names.retain(|name| !has(name));
        names
    }
}

/// One result as JSON, with a line feed at the end.
pub fn section_json(start: &Start, section: &dyn Section) -> Result<String> {
    document::of_section(start, section)
}

/// The tables of one result as text.
pub fn section_text(section: &dyn Section) -> String {
    let tables: Vec<String> = section.tables().iter().map(Table::text).collect();
    tables.join("\n")
}

pub fn section_bundle(start: &Start, section: &dyn Section) -> Result<Bundle> {
    let (name, mut bundle) = (section.name(), Bundle::default());
    let machine = start.environment.table().text();
    bundle.add(format!("{name}.html"), html::of_section(start, section)?)?;
    bundle.add(
        format!("{name}.txt"),
        machine + "\n" + &section_text(section),
    )?;
    bundle.add(format!("{name}.json"), section_json(start, section)?)?;
    add_data(&mut bundle, start.time, section)?;
    Ok(bundle)
}

fn add_data(bundle: &mut Bundle, started: SystemTime, section: &dyn Section) -> Result<()> {
    let name = section.name();
    for sheet in section.sheets()? {
        bundle.add(own_name(name, &sheet.name) + ".csv", sheet.csv)?;
    }
    for picture in section.pictures()? {
        bundle.add(own_name(name, picture.name) + ".svg", picture.svg)?;
    }
    if let Some(log) = hlog::log(started, &section.histograms())? {
        bundle.add(format!("histograms/{name}.hlog"), log)?;
    }
    Ok(())
}

/// A name that begins with that of its benchmark, so that no two benchmarks write the same file.
fn own_name(section: &str, name: &str) -> String {
    let rest = name.strip_prefix(section);
    if rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('-')) {
        name.to_owned()
    } else {
        format!("{section}-{name}")
    }
}

#[cfg(test)]
mod tests {
    use super::own_name;

    #[test]
    fn every_name_begins_with_its_benchmark() {
        assert_eq!(own_name("rate", "rate"), "rate");
        assert_eq!(own_name("rate", "rate-sections"), "rate-sections");
        assert_eq!(own_name("rate", "rates"), "rate-rates");
        assert_eq!(own_name("rate", "sections"), "rate-sections");
    }
}
