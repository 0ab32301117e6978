//! What a benchmark declares in the TOML file beside it.

use serde::Deserialize;
use serde_json::Value;

#[derive(Debug, Default, Deserialize)]
pub struct Declaration {
    pub heading: String,
    /// Method and reading guide: paragraphs of HTML.
    pub explanation: String,
    /// In the order in which they are shown.
    #[serde(default)]
    pub tables: Vec<Table>,
    #[serde(default)]
    pub plots: Vec<Plot>,
    #[serde(default)]
    pub targets: Vec<Target>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plot {
    pub name: String,
    /// Panels per row, and their height: see [`cdcr_chart::svg`].
    pub size: (usize, u32),
    pub caption: String,
    /// Empty until it is drawn.
    #[serde(skip)]
    pub svg: String,
}

/// A target of the project for the median of a metric.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    pub what: String,
    #[serde(rename = "target")]
    pub bound: String,
    pub unit: String,
    /// Name of the metric. A star stands for the case; the worst one counts.
    pub metric: String,
    pub most: f64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Table {
    pub name: String,
    /// Braces stand for what is only known after the run. Without a title, the rows are only in JSON and CSV.
    pub title: String,
    pub file: Option<String>,
    /// Whether the rows are in the JSON, under the name of the table.
    pub json: bool,
    pub columns: Vec<Column>,
    /// Keys of counts that are added over the rounds: see [`super::together`].
    pub counts: Vec<String>,
    /// Prefix of the names of a row's metrics: see `super::filled`.
    pub path: String,
    /// Metrics of the rounds of each row: name, unit and key.
    pub metrics: Vec<(String, String, String)>,
    /// The metrics of which more is better.
    pub higher: Vec<String>,
    /// `None` if nothing of it was measured.
    #[serde(skip)]
    pub rows: Option<Vec<Value>>,
}

/// A column: its head, the key of its value in a row, and its format with the number of digits.
#[derive(Debug, Default, Deserialize)]
pub struct Column {
    pub head: String,
    pub key: String,
    format: String,
}

impl Column {
    /// Words are left-aligned, all others right-aligned.
    pub fn is_word(&self) -> bool {
        self.format == "word"
    }

    pub(super) fn cell(&self, value: Option<&Value>) -> String {
        match value {
            Some(Value::String(text)) if !text.is_empty() => text.clone(),
            Some(Value::Bool(true)) => "yes".to_owned(),
            Some(Value::Bool(false)) => "no".to_owned(),
            Some(Value::Array(ends)) => {
                let end = |end: &Value| match end {
                    Value::String(text) => text.clone(),
                    end => end.as_f64().map(|end| self.number(end)).unwrap_or_default(),
                };
                let between = if self.is_word() { ", " } else { " to " };
                ends.iter().map(end).collect::<Vec<_>>().join(between)
            }
            Some(Value::Number(number)) => self.number(number.as_f64().unwrap_or(f64::NAN)),
            _ => "-".to_owned(),
        }
    }

    fn number(&self, value: f64) -> String {
        let (format, digits) = self.format.split_once(' ').unwrap_or((&self.format, "0"));
        let digits: usize = digits.parse().unwrap_or_default();
        match format {
            "short" => short(value),
            "fixed" => format!("{value:.digits$}"),
            "signed" => format!("{value:+.1}"),
            "power" => format!("{value:.1e}"),
            "percent" => format!("{:.digits$}", 100.0 * value),
            _ => value.to_string(),
        }
    }
}

/// Three to four digits without trailing zeros; whole numbers below 10⁶ in full.
fn short(value: f64) -> String {
    let digits = match value.abs() {
        _ if value == value.round() && value.abs() < 1e6 => 0,
        size if size >= 100.0 => 0,
        size if size >= 10.0 => 1,
        size if size >= 1.0 => 2,
        size if size >= 1e-3 => 4,
        _ => return format!("{value:.2e}"),
    };
    let text = format!("{value:.digits$}");
    match text.split_once('.') {
        Some(_) => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        None => text,
    }
}
