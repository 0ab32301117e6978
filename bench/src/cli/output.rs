//! How a result leaves: text, JSON or CSV on the standard output, all of it in a folder.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::{Context, Result};
use cdcr_bench::interrupt;
use cdcr_bench::progress::Progress;
use cdcr_bench::report::{Bundle, Start, section_bundle, section_json, section_text};
use cdcr_bench::section::Section;
use clap::ValueEnum;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
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
    /// The machine before the work.
    #[arg(skip)]
    start: OnceLock<Start>,
}

impl Output {
    /// To be called before the work: a folder that cannot be made costs no minutes then, and Ctrl-C ends the
    /// measurement in order.
    pub(super) fn prepare(&self) -> Result<()> {
        self.start()?;
        interrupt::catch()?;
        self.out.as_deref().map_or(Ok(()), make)
    }

    /// Runs one benchmark with its progress, and delivers its result.
    pub(super) fn measure<O, S: Section>(
        &self,
        options: &O,
        expected_s: fn(&O) -> f64,
        run: fn(&O, &mut Progress) -> Result<S>,
    ) -> Result<()> {
        let mut progress = Progress::new(expected_s(options));
        let section = run(options, &mut progress)?;
        drop(progress);
        self.deliver(&section)
    }

    /// Prints the result of one benchmark, and keeps it where that was asked for.
    fn deliver(&self, section: &dyn Section) -> Result<()> {
        let start = self.start()?;
        // Kept before it is printed: whoever reads may close the pipe.
        if let Some(folder) = &self.out {
            keep(&section_bundle(start, section)?, folder)?;
        }
        show(&match self.format {
            Format::Text => format!("{}\n{}\n", section_text(section), start.environment.line()),
            Format::Json => section_json(start, section)?,
            Format::Csv => match section.sheets()?.into_iter().next() {
                Some(sheet) => sheet.csv,
                None => String::new(),
            },
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
