use std::path::PathBuf;

use clap::{Args, Subcommand, ValueHint};
use clap_complete::ArgValueCompleter;

use super::{Format, complete};
use crate::setting::SettingChange;

#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(crate) struct SettingsOptions {
    #[command(subcommand)]
    pub(crate) action: Option<SettingsAction>,
    #[command(flatten)]
    pub(crate) show: SettingsShow,
}

/// What to do with the settings.
#[derive(Debug, Subcommand)]
pub(crate) enum SettingsAction {
    /// Show the settings of the newest cycle with their ranges
    #[command(after_help = "Example:\n  cdcrctl settings show --format json")]
    Show(SettingsShow),
    /// Change settings until the daemon ends: all in one cycle or, on an error, none
    #[command(
        after_help = "Examples:\n  cdcrctl settings set position_weight=2 rate_weight=1e-6\n  \
        cdcrctl settings set budget_ms=2      limit a solve to 2 ms; 0: all the remaining time\n\n\
        The keys are those of table [controller] of the configuration, which is not changed, and \
        budget_ms."
    )]
    Set {
        /// Settings to change
        #[arg(required = true, value_name = "KEY=VALUE", value_parser = SettingChange::parse,
            add = ArgValueCompleter::new(complete::changes))]
        changes: Vec<SettingChange>,
    },
    /// Write the current settings into a configuration file, which keeps its comments and all other keys
    #[command(
        after_help = "Examples:\n  cdcrctl settings save                 print them as a configuration\n  \
        cdcrctl settings save robot.toml      update the keys that differ in this file, or create it\n\n\
        Missing keys are added where the setting is not the default. The file is replaced \
        atomically; links are followed; owner, group and mode stay. It must be given, because \
        a daemon does not publish the names of its files."
    )]
    Save {
        /// Configuration file
        #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
        file: Option<PathBuf>,
    },
}

/// How to show the settings.
#[derive(Debug, Args)]
pub(crate) struct SettingsShow {
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}
