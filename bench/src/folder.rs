//! What `--out` writes.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

use crate::csv::csv;
use crate::figures::figures;
use crate::page::paper::page;
use crate::simulation::{Outcome, Simulation};

/// The result as one JSON object.
#[derive(Serialize)]
pub struct Document<'a> {
    simulations: Vec<&'a Simulation>,
}

impl<'a> Document<'a> {
    /// Of all rows.
    pub fn of(outcomes: &'a [Outcome]) -> Self {
        Self {
            simulations: outcomes.iter().map(|outcome| &outcome.row).collect(),
        }
    }

    /// As JSON, with a line feed at the end.
    ///
    /// # Errors
    /// Never with rows of numbers.
    pub fn json(&self) -> Result<String> {
        Ok(serde_json::to_string(self)? + "\n")
    }

    /// As CSV.
    ///
    /// # Errors
    /// Never with rows of numbers.
    pub fn csv(&self) -> Result<String> {
        csv(&self.simulations)
    }
}

/// Writes the figures as SVG, `paper.html`, `paper.json` and `paper.csv` into the folder, which is made
/// if it does not exist; tells what was written.
///
/// # Errors
/// When a file cannot be written.
pub fn write(folder: &Path, outcomes: &[Outcome]) -> Result<Vec<PathBuf>> {
    fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let figures = figures(outcomes)?;
    let document = Document::of(outcomes);
    let mut written = Vec::new();
    let mut put = |name: &str, text: &str| {
        let file = folder.join(name);
        fs::write(&file, text).with_context(|| format!("cannot write {}", file.display()))?;
        written.push(file);
        anyhow::Ok(())
    };
    put("paper.html", &page(outcomes, &figures))?;
    put("paper.json", &document.json()?)?;
    put("paper.csv", &document.csv()?)?;
    for figure in figures.iter().flatten() {
        put(&format!("{}.svg", figure.name), &figure.svg)?;
    }
    Ok(written)
}
