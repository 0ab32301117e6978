//! Changes between two runs beyond the noise of their rounds.

mod change;

use std::collections::BTreeMap;
use std::fmt::{Display, Write as _};
use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::json;

use change::LEAST_CHANGE_PERCENT;
pub use change::{Change, ChangeClass};

use crate::dataset::Dataset;
use crate::environment::Environment;
use crate::metric::Metric;
use crate::run_options::RunOptions;

/// Numbers that may get worse in addition, because the number of chance changes varies, too.
const WORSE_MARGIN: usize = 2;
const NAMES_MAX: usize = 12;
const NO_RESULT: &str = "is not a result of cdcr-bench: expected one JSON object with \"environment\" and \"metrics\", as \
                         --format json prints it and --out writes it";
const NO_OPTIONS: &str = "does not contain its options: it may have measured something else";
const OTHER_MACHINE: &str = "absolute times of the two runs cannot be compared then; the ratios to the bare loop, which \
                             each run measured itself, can";
const OTHER_OPTIONS: &str = "numbers may differ for this reason alone, ratios too";

#[derive(Debug, Clone, Deserialize)]
pub struct Input {
    pub environment: Environment,
    /// Options of the run; `None` in a file of an older version.
    pub options: Option<RunOptions>,
    pub metrics: Vec<Metric>,
}

impl Input {
    pub fn read(file: &Path) -> Result<Self> {
        let name = file.display();
        let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {name}"))?;
        serde_json::from_str(&text).with_context(|| format!("{name} {NO_RESULT}"))
    }

    fn named(&self) -> Named<'_> {
        let known = self.metrics.iter().filter(|it| !it.rounds.is_empty());
        known.map(|it| ((&*it.name, &*it.unit), it)).collect()
    }
}

/// The measured metrics by name and unit; a number with another unit is another number.
type Named<'a> = BTreeMap<(&'a str, &'a str), &'a Metric>;

#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    pub before: Environment,
    pub after: Environment,
    pub warnings: Vec<String>,
    /// Every number that both runs have: changed ones first, worst on top.
    pub metrics: Vec<Change>,
    /// Expected count of numbers classified as changed if nothing has changed.
    pub changed_by_chance: f64,
    pub only_before: Vec<String>,
    pub only_after: Vec<String>,
}

impl Comparison {
    pub fn new(before: &Input, after: &Input) -> Self {
        let (old, new) = (before.named(), after.named());
        let both = |(key, old): (_, &&Metric)| Change::new(old, new.get(key)?);
        let mut metrics: Vec<Change> = old.iter().filter_map(both).collect();
        // From zero, every change is large.
        let size = |change: &Change| change.percent.map_or(f64::INFINITY, f64::abs);
        // Stable: in the order of the names otherwise.
        metrics.sort_by(|one, other| size(other).total_cmp(&size(one)));
        metrics.sort_by_key(|change| change.class);
        let only = |these: &Named, others: &Named| {
            let missing = these.keys().filter(|key| !others.contains_key(*key));
            missing.map(|(name, _)| (*name).to_owned()).collect()
        };
        Self {
            warnings: warnings(before, after),
            changed_by_chance: metrics.iter().map(|change| change.false_alarm).sum(),
            metrics,
            only_before: only(&old, &new),
            only_after: only(&new, &old),
            before: before.environment.clone(),
            after: after.environment.clone(),
        }
    }

    /// How many numbers may get worse by chance: half of those that change by chance, and a margin.
    pub fn worse_by_chance(&self) -> usize {
        (self.changed_by_chance / 2.0).ceil() as usize + WORSE_MARGIN
    }

    pub fn count(&self, class: ChangeClass) -> usize {
        let classes = self.metrics.iter().map(|change| change.class);
        classes.filter(|found| *found == class).count()
    }

    pub fn text(&self) -> String {
        let is_changed = |change: &&Change| change.class < ChangeClass::WithinNoise;
        let changed: Vec<&Change> = self.metrics.iter().filter(is_changed).collect();
        let summary = match self.count(ChangeClass::TooFewRounds) {
            _ if changed.iter().any(|change| change.chance.is_some()) => "",
            all if all == self.metrics.len() => "Nothing can be compared: too few rounds.\n\n",
            _ => "Nothing changed beyond noise.\n\n",
        };
        let mut table = Dataset::new("compare", include_str!("compare.toml"));
        if !changed.is_empty() {
            let rows = changed.iter().map(|change| json!(change)).collect();
            table.add_titled("changes", &[&LEAST_CHANGE_PERCENT.to_string()], rows);
        }
        let count = |class: ChangeClass| format!("{} {}", self.count(class), class.name());
        table.note = format!(
            "{}.\nWithout any change up to {:.1} of these would be called worse or better, by chance alone; more \
             rounds make it rarer (5 in each run: 1 of 126).",
            ChangeClass::ALL.map(count).join(", "),
            self.changed_by_chance
        );
        let (before, after) = (self.before.run(), self.after.run());
        let mut text = format!("before: {before}\nafter:  {after}\n");
        for warning in &self.warnings {
            let _ = writeln!(text, "warning: {warning}");
        }
        text = text + "\n" + summary + &table.text();
        for (when, names) in [("before", &self.only_before), ("after", &self.only_after)] {
            let shown = names[..names.len().min(NAMES_MAX)].join(", ");
            let _ = writeln!(text, "{} only in the run {when}: {shown}", names.len());
        }
        text
    }
}

fn warnings(before: &Input, after: &Input) -> Vec<String> {
    let machine = before.environment.differing(&after.environment);
    let options = match (&before.options, &after.options) {
        (Some(old), Some(new)) => another("value of ", &old.differing(new), OTHER_OPTIONS),
        (None, None) => Vec::new(),
        (None, _) => vec![format!("the run before {NO_OPTIONS}")],
        (_, None) => vec![format!("the run after {NO_OPTIONS}")],
    };
    [another("", &machine, OTHER_MACHINE), options].concat()
}

fn another<T: Display>(kind: &str, all: &[(&str, T, T)], consequence: &str) -> Vec<String> {
    let one = |(name, old, new): &(&str, T, T)| {
        format!("another {kind}{name}: {old} before, {new} after")
    };
    let consequence = (!all.is_empty()).then(|| consequence.to_owned());
    all.iter().map(one).chain(consequence).collect()
}
