//! Single numbers with the spread of their rounds, for the comparison of two runs.

use serde::{Deserialize, Serialize};
use statrs::statistics::{Data, OrderStatistics as _};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Metric {
    /// Words joined by slashes, like `deadline/none/daemon/response_p99`. The same in every run.
    pub name: String,
    pub unit: String,
    pub better: Better,
    /// The finite value of each round.
    pub rounds: Vec<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Better {
    Lower,
    Higher,
}

impl Metric {
    /// Values that are not finite are left out.
    pub fn new(
        name: impl Into<String>,
        unit: &str,
        better: Better,
        rounds: impl IntoIterator<Item = f64>,
    ) -> Self {
        Self {
            name: name.into(),
            unit: unit.to_owned(),
            better,
            rounds: rounds.into_iter().filter(|v| v.is_finite()).collect(),
        }
    }

    pub fn median(&self) -> Option<f64> {
        median(self.rounds.iter().copied())
    }

    pub fn range(&self) -> Option<(f64, f64)> {
        range(self.rounds.iter().copied())
    }
}

/// Median; of an even count, the mean of the middle two. `None` if empty. The values must be finite.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.into_iter().collect();
    (!values.is_empty()).then(|| Data::new(values).median())
}

/// Smallest and largest value; `None` if empty.
pub fn range(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    let ends = values.into_iter().map(|value| (value, value));
    ends.reduce(|(low, high), (value, _)| (low.min(value), high.max(value)))
}
