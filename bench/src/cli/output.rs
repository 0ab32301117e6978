//! How a result leaves: text, JSON or CSV on the standard output, all of it in a folder.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::{Context, Result};
use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::dataset::Dataset;
use cdcr_bench::progress::Progress;
use cdcr_bench::report::{Bundle, Start, dataset_bundle, dataset_json};
use cdcr_testbed::interrupt;
use clap::ValueEnum;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// A table for people.
    Text,
    /// The same table for a page on the web.
    Markdown,
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
    /// The machine before the work.
    #[arg(skip)]
    start: OnceLock<Start>,
}

impl Output {
    /// To be called before the work: a folder that cannot be made costs no minutes then, and Ctrl-C ends the
    /// measurement in order.
    fn prepare(&self) -> Result<()> {
        self.start()?;
        interrupt::catch()?;
        self.out.as_deref().map_or(Ok(()), make)
    }

    /// Runs one benchmark with its progress, and delivers its result.
    pub(super) fn measure(&self, asked: impl Benchmark) -> Result<()> {
        self.prepare()?;
        let options = asked.resolved()?;
        let mut progress = Progress::new(options.expected_s());
        let dataset = options.run(&mut progress)?;
        drop(progress);
        self.deliver(&dataset)
    }

    /// Prints the result of one benchmark, and keeps it where that was asked for.
    fn deliver(&self, dataset: &Dataset) -> Result<()> {
        let start = self.start()?;
        // Kept before it is printed: whoever reads may close the pipe.
        if let Some(folder) = &self.out {
            keep(&dataset_bundle(start, dataset)?, folder)?;
        }
        let machine = start.environment.line();
        show(&match self.format {
            Format::Text => format!("{}\n{machine}\n", dataset.text()),
            Format::Markdown => format!("{}\n{machine}\n", dataset.markdown()),
            Format::Json => dataset_json(start, dataset)?,
            Format::Csv => {
                let mut sheets = dataset.csv();
                let own = sheets.find(|(name, _)| *name == dataset.name);
                own.map_or_else(|| Ok(String::new()), |(_, csv)| csv)?
            }
        })
    }

    /// The machine at the first call.
    fn start(&self) -> Result<&Start> {
        if let Some(start) = self.start.get() {
            return Ok(start);
        }
        let start = Start::now()?;
        Ok(self.start.get_or_init(|| start))
    }
}

/// Makes a folder.
pub(super) fn make(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))
}

/// Writes all files, and tells which, beside the result and not in it.
pub(super) fn keep(bundle: &Bundle, folder: &Path) -> Result<()> {
    bundle.write(folder)?;
    let mut stderr = std::io::stderr();
    writeln!(
        stderr,
        "written into {}: {}",
        folder.display(),
        bundle.words()
    )?;
    Ok(())
}

/// Writes to the standard output. A reader that closed it, like `head`, has seen enough.
pub(super) fn show(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}
