//! How a result leaves: text, JSON or CSV on the standard output, all of it in a folder.

use std::io::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result};
use cdcr_bench::interrupt;
use cdcr_bench::section::Section;
use cdcr_bench::table::Table;
use clap::ValueEnum;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Format {
    /// A table for people.
    Text,
    /// One JSON object.
    Json,
    /// Comma-separated values with a header.
    Csv,
}

/// How to print a result, and where to keep it.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Output {
    /// How to print the result.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Folder for everything that was measured: text, JSON, CSV, a page with plots, raw histograms; made if
    /// it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Output {
    /// To be called before the work: a folder that cannot be made costs no minutes then, and Ctrl-C ends the
    /// measurement in order.
    pub(super) fn prepare(&self) -> Result<()> {
        interrupt::catch()?;
        if let Some(folder) = &self.out {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        }
        Ok(())
    }

    /// Prints the result of one benchmark, and keeps it where that was asked for.
    pub(super) fn deliver(&self, section: &dyn Section) -> Result<()> {
        show(&match self.format {
            Format::Text => {
                let texts: Vec<String> = section.tables().iter().map(Table::text).collect();
                texts.join("\n")
            }
            Format::Json => serde_json::to_string(&section.json()?)? + "\n",
            Format::Csv => match section.sheets()?.into_iter().next() {
                Some(sheet) => sheet.csv,
                None => String::new(),
            },
        })
    }
}

/// Writes to the standard output. A reader that closed it, like `head`, has seen enough.
pub(super) fn show(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

