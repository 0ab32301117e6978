//! A result that an earlier run wrote.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

use crate::environment::{Environment, Options};
use crate::metric::Metric;

/// What the comparison needs of a result, of one benchmark or of all.
#[derive(Debug, Clone, Deserialize)]
pub struct Input {
    pub environment: Environment,
    /// What was asked for; none in a file of an older version.
    #[serde(default)]
    pub options: Option<Options>,
    pub metrics: Vec<Metric>,
}

impl Input {
    pub fn read(file: &Path) -> Result<Self> {
        let name = file.display();
        let text = fs::read_to_string(file).with_context(|| format!("cannot read {name}"))?;
        serde_json::from_str(&text).with_context(|| {
            format!(
                "{name} is no result of cdcr-bench: expected is one JSON object with \"environment\" and \
                 \"metrics\", as --format json prints it and --out writes it"
            )
        })
    }
}
