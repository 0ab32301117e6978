use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::Format;
use crate::setting::SettingChange;
use crate::trigger::Trigger;
use crate::value;

#[derive(Debug, Args)]
pub(crate) struct RecordingOptions {
    /// Output file [default: ROBOT-DATE-TIME.mcap, in UTC]
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    /// Stop after this time
    #[arg(long, value_name = "TIME", value_parser = value::duration_in(value::WAIT_S))]
    pub(crate) duration: Option<Duration>,
    /// Stop before the file is larger than this: 1MB to 1000TB, for example 20GB
    #[arg(long, value_name = "SIZE", value_parser = value::size_bytes, conflicts_with = "around")]
    pub(crate) max_size: Option<u64>,
    /// Record only around the first trigger: incident, fault, mode, error>5mm, clearance<5mm or
    /// response>800us. The time before it is buffered in memory, 64 MB at most
    #[arg(long, value_name = "TRIGGER", value_parser = Trigger::parse)]
    pub(crate) around: Option<Trigger>,
    /// With --around: time to keep before the trigger, 0 to 60 s
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = value::duration_in(value::AROUND_S), requires = "around")]
    pub(crate) before: Duration,
    /// With --around: time to record after the trigger, 0 to 60 s
    #[arg(long, value_name = "TIME", default_value = "5s", value_parser = value::duration_in(value::AROUND_S), requires = "around")]
    pub(crate) after: Duration,
}

#[derive(Debug, Args)]
pub(crate) struct ScopeOptions {
    /// Trigger: incident, fault, mode, error>5mm, clearance<5mm, response>800us
    #[arg(long, value_name = "TRIGGER", value_parser = Trigger::parse)]
    pub(crate) trigger: Trigger,
    /// Time to keep before the trigger, 0 to 60 s
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = value::duration_in(value::AROUND_S))]
    pub(crate) before: Duration,
    /// Time to record after the trigger, 0 to 60 s
    #[arg(long, value_name = "TIME", default_value = "1s", value_parser = value::duration_in(value::AROUND_S))]
    pub(crate) after: Duration,
    /// Fail without a trigger after this time
    #[arg(long, value_name = "TIME", value_parser = value::duration_in(value::WAIT_S))]
    pub(crate) duration: Option<Duration>,
    /// Output file [default: ROBOT-DATE-TIME.mcap, in UTC]
    #[arg(short, long, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct InfoOptions {
    /// Recording (MCAP)
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Recover all intact data of a truncated or damaged recording, with an index, as NAME-repaired.mcap
    #[arg(long)]
    pub(crate) repair: bool,
}

#[derive(Debug, Args)]
pub(crate) struct ReplayOptions {
    /// Recording (MCAP)
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Recompute every cycle offline and compare modes, plans, commands and clearances bit for bit
    #[arg(long)]
    pub(crate) verify: bool,
    /// Recompute every cycle with other settings from the same inputs, without a time limit
    #[arg(long, value_name = "KEY=VALUE,...", value_delimiter = ',', value_parser = SettingChange::parse, conflicts_with = "verify")]
    pub(crate) with: Vec<SettingChange>,
    /// Speed factor of the replay, 0.1 to 4
    #[arg(long, value_name = "TIMES", value_parser = value::number_in(0.1..=4.0), default_value = "1", conflicts_with_all = ["verify", "with"], allow_negative_numbers = true)]
    pub(crate) speed: f64,
    /// Leave out the recorded obstacles whose ids are in use, instead of refusing the replay
    #[arg(long, conflicts_with_all = ["verify", "with"])]
    pub(crate) keep_live: bool,
    /// Output format of --verify and --with
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}

#[derive(Debug, Args)]
pub(crate) struct ConvertOptions {
    /// Recording (MCAP)
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Folder for telemetry.csv, events.csv, reference.csv, obstacles.csv, status.csv and incidents.csv; created if missing
    #[arg(long, value_name = "DIR", required = true)]
    pub(crate) csv: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct ReportOptions {
    /// Recording (MCAP)
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
    /// Output page; it must not exist yet [default: NAME.html beside the recording]
    #[arg(short, long, value_name = "FILE.html")]
    pub(crate) output: Option<PathBuf>,
}
