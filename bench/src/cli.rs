//! The command line of the benchmarks.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use cdcr_bench::benchmark::Benchmark;
use cdcr_bench::budget::BudgetOptions;
use cdcr_bench::compare::{ChangeClass, Comparison, Input};
use cdcr_bench::deadline::DeadlineOptions;
use cdcr_bench::footprint::FootprintOptions;
use cdcr_bench::latency::LatencyOptions;
use cdcr_bench::paper::Effort;
use cdcr_bench::progress::Progress;
use cdcr_bench::quality::QualityOptions;
use cdcr_bench::rate::RateOptions;
use cdcr_bench::report::{self, BenchReport, Extent, Files, Plan, Start};
use cdcr_bench::robustness::RobustnessOptions;
use cdcr_bench::run_options::RunOptions;
use cdcr_bench::solver::SolverOptions;
use cdcr_process::output_folder;
use cdcr_testbed::interrupt;
use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand, ValueEnum};

const DEADLINE_HELP: &str = "Example: cdcr-bench deadline --duration 60s --rounds 6 --out deadline\n\n\
    Real-time threads need a privilege (docs/realtime.md); without it, only the ordinary set-up is measured.";
const LATENCY_HELP: &str = "Example: cdcr-bench latency --rounds 5 --out latency\n\n\
    Real-time threads need a privilege (docs/realtime.md); without it, ordinary threads are measured.";

/// Benchmarks of cdcr: real time, control quality, solver.
#[derive(Debug, Parser)]
#[command(
    name = "cdcr-bench",
    version,
    about,
    after_help = "Example: cdcr-bench paper --seeds 10"
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: BenchCommand,
}

#[derive(Debug, Subcommand)]
enum BenchCommand {
    /// Run all benchmarks and write one report with a description of the machine: text, JSON, CSV, plots, raw histograms,
    /// and a self-contained HTML page.
    #[command(after_help = "Example: cdcr-bench all --out report --quick")]
    All(AllArguments),
    #[command(flatten)]
    One(One),
    /// Compare two runs and list changes beyond the noise of their rounds.
    #[command(after_help = "Example: cdcr-bench compare before/report.json after/report.json")]
    Compare(CompareArguments),
}

/// Declares the benchmarks: description, name, options, and the text after the help.
macro_rules! benchmarks {
    ($($(#[doc = $doc:literal])+ $variant:ident = $name:literal: $options:ty, $help:expr;)+) => {
        #[derive(Debug, Subcommand)]
        enum One {
            $($(#[doc = $doc])+ #[command(after_help = $help)] $variant(Measure<$options>),)+
        }

        /// A benchmark of a report.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
        enum Name {
            $($(#[doc = $doc])+ $variant,)+
        }

        impl One {
            fn run(self, start: &Start) -> Result<()> {
                match self {
                    $(Self::$variant(asked) => asked.output.measure(asked.options, start),)+
                }
            }
        }

        impl Name {
            fn plan(self, asked: &AllArguments) -> Plan {
                match self {
                    $(Self::$variant => Plan::new::<$options>($name, asked.extent, asked.config.as_ref()),)+
                }
            }
        }
    };
}

// In the order of execution: real-time benchmarks first, while the machine is quiet.
benchmarks! {
    /// Measure deadline misses and latencies of the daemon under named loads, next to a bare loop in the same run.
    Deadline = "deadline": DeadlineOptions, DEADLINE_HELP;
    /// Measure message latencies: reference, obstacle, measurement, request and stop, next to iceoryx2 alone.
    Latency = "latency": LatencyOptions, LATENCY_HELP;
    /// Measure the shortest period that a daemon holds with 1, 2 and 3 sections, every solver and two
    /// horizons, and what limits it.
    Rate = "rate": RateOptions, "Example: cdcr-bench rate --rounds 5 --out rate";
    /// Measure resource use of a daemon at 200 Hz: core share per thread, memory, files, start time.
    Footprint = "footprint": FootprintOptions,
        "Example: cdcr-bench footprint --duration 30s --format json > footprint.json";
    /// Measure error, clearance and cost over the time budget, the swarm and the horizon, on the paper's and on
    /// harder scenes, and how often a solver gets stuck.
    Quality = "quality": QualityOptions, "Example: cdcr-bench quality --rounds 5 --out quality";
    /// Measure the true tip error of robots that differ from their model (lag, noise, play, geometry, load), and the effect of each
    /// part of the controller.
    Robustness = "robustness": RobustnessOptions, "Example: cdcr-bench robustness --seeds 20 --out robustness";
    /// Run the paper's three simulations (spiral, line with orientation, circle with an obstacle) with every
    /// solver, next to the paper's results.
    Paper = "paper": Effort, "Example: cdcr-bench paper --seeds 3 --out paper";
    /// Measure solve times on every SIMD path of this processor, over sections, steps, particles,
    /// iterations and obstacles.
    Solver = "solver": SolverOptions, "Example: cdcr-bench solver --format csv > solver.csv";
    /// Measure by how much a solve exceeds time budgets from 0 to 1 ms, and check that its plan is never
    /// worse than the warm start.
    Budget = "budget": BudgetOptions, "Example: cdcr-bench budget --format json > budget.json";
}

#[derive(Debug, clap::Args)]
struct Measure<B: Benchmark> {
    #[command(flatten)]
    options: B,
    #[command(flatten)]
    output: OutputOptions,
}

/// Options that set the extent of a benchmark, which `--quick` sets, too.
const EXTENT: [&str; 5] = ["duration", "rounds", "samples", "seeds", "solves"];

/// Whether to measure at all, how to print a result, and where to keep it.
#[derive(Debug, Clone, clap::Args)]
struct OutputOptions {
    /// Run a small part in some seconds, to see that everything runs; not a measurement.
    #[arg(long)]
    quick: bool,
    /// Output format.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
    /// Output folder for text, JSON, CSV, an HTML page with plots and raw histograms; created if
    /// missing.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Text table.
    Text,
    /// Markdown table.
    Markdown,
    /// One JSON object.
    Json,
    /// Comma-separated values with a header.
    Csv,
}

#[derive(Debug, clap::Args)]
struct AllArguments {
    /// Output folder for report.html, report.txt, report.json, a CSV per table, SVG plots and raw
    /// histograms; created if missing, written only at the end.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    extent: Extent,
    /// Run only these benchmarks, comma-separated.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "NAME")]
    only: Vec<Name>,
    /// Configuration of the daemon in deadline and latency [default: three sections]. The other
    /// benchmarks use their own. With this option no targets are evaluated.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ComparisonFormat {
    /// Changes, as text.
    Text,
    /// One JSON object with every number.
    Json,
}

#[derive(Debug, clap::Args)]
struct CompareArguments {
    /// JSON of the first run: report.json or the JSON of one benchmark.
    #[arg(value_name = "A.json")]
    before: PathBuf,
    /// JSON of the second run.
    #[arg(value_name = "B.json")]
    after: PathBuf,
    /// Output format.
    #[arg(long, value_enum, default_value_t = ComparisonFormat::Text)]
    format: ComparisonFormat,
    /// Exit with status 1 when more numbers changed for the worse than chance explains: more than half of the changes
    /// expected by chance, rounded up, plus two. Numbers with only one value per run are
    /// ignored.
    #[arg(long)]
    fail_on_worse: bool,
}

pub(crate) fn run() -> Result<()> {
    let (command, matches) = (Cli::command(), Cli::command().get_matches());
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    let start = || Start::now(RunOptions::from_matches(&command, &matches));
    match cli.command {
        BenchCommand::All(asked) => asked.run(start()?),
        BenchCommand::One(one) => one.run(&start()?),
        BenchCommand::Compare(asked) => asked.run(),
    }
}

impl OutputOptions {
    /// Runs one benchmark with its progress and writes its result. The folder is checked before the
    /// measurement, and Ctrl-C ends the measurement in order.
    fn measure(&self, mut options: impl Benchmark, start: &Start) -> Result<()> {
        interrupt::catch()?;
        self.out.as_deref().map_or(Ok(()), output_folder)?;
        options.check()?;
        if self.quick {
            let given = EXTENT.iter().find(|name| start.options.has(name));
            let given = given.copied().unwrap_or_default();
            ensure!(given.is_empty(), "--quick cannot be used with --{given}");
            options.quicken();
        }
        let mut progress = Progress::new(options.expected_s());
        let mut dataset = options.run(&mut progress)?;
        drop(progress);
        if self.quick {
            let note = format!("{} {}", report::QUICK, dataset.note);
            (dataset.note, dataset.warns) = (note.trim_end().to_owned(), true);
        }
        // Written before printing, because the reader may close the pipe.
        if let Some(folder) = &self.out {
            keep(&start.files_of(&dataset)?, folder)?;
        }
        let machine = start.environment.line();
        show(&match self.format {
            Format::Text => format!("{}\n{machine}\n", dataset.text()),
            Format::Markdown => format!("{}\n{machine}\n", dataset.markdown()),
            Format::Json => start.json_of(&dataset)?,
            Format::Csv => {
                let own = dataset.csv().find(|(name, _)| *name == dataset.name);
                own.map_or(Ok(String::new()), |(_, csv)| csv)?
            }
        })
    }
}

impl AllArguments {
    fn run(self, start: Start) -> Result<()> {
        interrupt::catch()?;
        if let Some(config) = &self.config {
            ensure!(config.is_file(), "there is no file {}", config.display());
        }
        output_folder(&self.out)?;
        let is_asked = |name: &&Name| self.only.is_empty() || self.only.contains(name);
        let asked = Name::value_variants().iter().filter(is_asked);
        let plans: Vec<Plan> = asked.map(|name| name.plan(&self)).collect();
        let mut progress = Progress::new(plans.iter().map(|plan| plan.expected_s).sum());
        let report = BenchReport {
            start,
            extent: self.extent,
            default_config: self.config.is_none(),
            parts: report::run(plans, &mut progress)?,
        };
        drop(progress);
        keep(&report.files()?, &self.folder(&report)?)?;
        show(&report.summary())?;
        let failed = report.failed();
        let (count, all, names) = (failed.len(), report.parts.len(), failed.join(", "));
        ensure!(
            count == 0,
            "{count} of {all} benchmarks failed: {names}; see the report, which includes the others"
        );
        Ok(())
    }

    /// The output folder itself, unless it holds a report with results that this one lacks.
    fn folder(&self, report: &BenchReport) -> Result<PathBuf> {
        let older = fs::read_to_string(self.out.join("report.json")).unwrap_or_default();
        let lost = report.would_lose(&older);
        if lost.is_empty() {
            return Ok(self.out.clone());
        }
        let (aside, lost) = (self.out.join("partial"), Vec::from_iter(lost).join(", "));
        let [here, there] = [&self.out, &aside].map(|folder| folder.display());
        let words = format!("{here} contains an older report with {lost}, which is missing here");
        let what = "it is kept, and this report is written to";
        writeln!(std::io::stderr(), "{words}: {what} {there}")?;
        Ok(aside)
    }
}

impl CompareArguments {
    fn run(&self) -> Result<()> {
        let comparison = Comparison::new(&Input::read(&self.before)?, &Input::read(&self.after)?);
        show(&match self.format {
            ComparisonFormat::Text => comparison.text(),
            ComparisonFormat::Json => serde_json::to_string(&comparison)? + "\n",
        })?;
        let worse = comparison.count(ChangeClass::Worse);
        let by_chance = comparison.worse_by_chance();
        ensure!(
            !self.fail_on_worse || worse <= by_chance,
            "{worse} numbers are worse than before, beyond noise; chance explains at most {by_chance}"
        );
        Ok(())
    }
}

fn keep(files: &Files, folder: &Path) -> Result<()> {
    report::write(files, folder)?;
    let (count, folder) = (files.len(), folder.display());
    writeln!(std::io::stderr(), "{count} files written to {folder}")?;
    Ok(())
}

/// Writes to standard output. A reader that closes the pipe, like `head`, is not an error.
fn show(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_manual_matches_the_command_line() {
        cdcr_packaging::check(&Cli::command(), "1", None).expect("up to date");
    }
}
