//! What every benchmark hands over, whatever it measured.

use anyhow::Result;
use hdrhistogram::Histogram;

use crate::figures::Figure;
use crate::metric::Metric;
use crate::table::Table;

/// The result of one benchmark: for people, for programs, and for the next run to be compared with.
pub trait Section {
    /// Name of the command, and of the files.
    fn name(&self) -> &'static str;

    fn heading(&self) -> &'static str;

    /// What was done and how to read it: paragraphs of HTML.
    fn explanation(&self) -> &'static str;

    /// The whole result: one JSON object.
    fn json(&self) -> Result<serde_json::Value>;

    /// Tables for people, the most important first.
    fn tables(&self) -> Vec<Table>;

    /// Tables for programs, the most important first.
    fn sheets(&self) -> Result<Vec<Sheet>>;

    fn pictures(&self) -> Result<Vec<Figure>>;

    /// What another run can be compared by.
    fn metrics(&self) -> Vec<Metric>;

    /// All latencies that were measured, so that others can compute other percentiles.
    fn histograms(&self) -> Vec<Recording<'_>> {
        Vec::new()
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sheet {
    /// Name of its file, without an ending.
    pub name: String,
    /// A head, and a line for each row.
    pub csv: String,
}

/// Latencies of one stretch of time.
#[derive(Debug, Clone, Copy)]
pub struct Recording<'a> {
    /// What was measured where: words joined by dots, like `none.daemon.response`.
    pub tag: &'a str,
    /// When it began, after the start of the run \[s\].
    pub start_s: f64,
    pub duration_s: f64,
    pub histogram: &'a Histogram<u64>,
}
