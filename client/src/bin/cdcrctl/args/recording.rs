use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::Format;
use crate::setting::Change;
use crate::trigger::Trigger;
use crate::value;

#[derive(Debug, Args)]
pub(crate) struct RecordingOptions {
    /// File to make [default: ROBOT-DATE-TIME.mcap, in UTC]
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    /// End after this long
    #[arg(long, value_name = "TIME", value_parser = value::duration_in(value::WAIT_S))]
    pub(crate) duration: Option<Duration>,
    /// Record only what is around the first time that this happens: incident, fault, mode, error>5mm, clearance<5mm or
    /// response>800us. What was before is kept in memory until then, 64 MB at most
    #[arg(long, value_name = "TRIGGER", value_parser = Trigger::parse)]
    pub(crate) around: Option<Trigger>,
    /// With --around: how much of what was before, 0 to 60 s
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = value::duration_in(value::AROUND_S), requires = "around")]
    pub(crate) before: Duration,
    /// With --around: how much of what comes after, 0 to 60 s
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = value::duration_in(value::AROUND_S), requires = "around")]
    pub(crate) after: Duration,
}

#[derive(Debug, Args)]
pub(crate) struct ScopeOptions {
    /// What to wait for: incident, fault, mode, error>5mm, clearance<5mm, response>800us
    #[arg(long, value_name = "TRIGGER", value_parser = Trigger::parse)]
    pub(crate) trigger: Trigger,
    /// How much of what was before, 0 to 60 s
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = value::duration_in(value::AROUND_S))]
    pub(crate) before: Duration,
    /// How much of what comes after, 0 to 60 s
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = value::duration_in(value::AROUND_S))]
    pub(crate) after: Duration,
    /// Give up after this long
    #[arg(long, value_name = "TIME", value_parser = value::duration_in(value::WAIT_S))]
    pub(crate) duration: Option<Duration>,
    /// File to make [default: ROBOT-DATE-TIME.mcap, in UTC]
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct InfoOptions {
    /// The recording
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Save what a cut recording has, with an index, beside it as NAME-repaired.mcap
    #[arg(long)]
    pub(crate) repair: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ReplayOptions {
    /// The recording
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Compute every cycle again, offline, and compare modes, plans, commands and clearances bit for bit
    #[arg(long)]
    pub(crate) verify: bool,
    /// Compute what other settings would have commanded from the same inputs, cycle by cycle, without a limit of time
    #[arg(long, value_name = "KEY=VALUE,...", value_delimiter = ',', value_parser = Change::parse, conflicts_with = "verify")]
    pub(crate) with: Vec<Change>,
    /// How many times as fast as it was the recording is fed to the daemon, 0.1 to 4
    #[arg(long, value_name = "TIMES", value_parser = value::number_in(0.1..=4.0), default_value = "1", conflicts_with_all = ["verify", "with"], allow_negative_numbers = true)]
    pub(crate) speed: f64,
    /// How to print what was computed
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}

#[derive(Debug, Args)]
pub(crate) struct ConvertOptions {
    /// The recording
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Folder for telemetry.csv, events.csv, reference.csv, obstacles.csv, status.csv and incidents.csv; made where it is missing
    #[arg(long, value_name = "DIR", required = true)]
    pub(crate) csv: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct ReportOptions {
    /// The recording
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// The page to make; one that is there is replaced [default: beside the recording, as NAME.html]
    #[arg(short, long, value_name = "FILE.html")]
    pub(crate) output: Option<PathBuf>,
}
