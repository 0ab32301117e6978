use clap::Args;

use super::Format;

#[derive(Debug, Args)]
pub(crate) struct StatusOptions {
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
    /// Update every second, until interrupted
    #[arg(long)]
    pub(crate) watch: bool,
    /// Fail where the robot cannot be moved: it is stopped, faulted, or not measured yet
    #[arg(long, conflicts_with = "watch")]
    pub(crate) check: bool,
    /// Reset the statistics, print nothing; a stopped robot stays stopped (see cdcrctl reset)
    #[arg(long, conflicts_with_all = ["watch", "format", "check"])]
    pub(crate) reset_statistics: bool,
}
