use std::path::PathBuf;

use clap::{Args, Subcommand, ValueHint};
use clap_complete::ArgValueCompleter;

use super::{Format, complete};
use crate::setting::Change;

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
    /// Show them with their ranges, as the newest cycle used them
    #[command(after_help = "Example:\n  cdcrctl settings show --format json")]
    Show(SettingsShow),
    /// Change some of them, all at once or not at all, until the daemon ends
    #[command(
        after_help = "Examples:\n  cdcrctl settings set position_weight=2 rate_weight=1e-6\n  \
        cdcrctl settings set budget_ms=2      a solve may take 2 ms; 0: all the time that is left\n\n\
        The keys are those of the table [controller] of the configuration, where they stay as they are, and \
        budget_ms."
    )]
    Set {
        /// What to change
        #[arg(required = true, value_name = "KEY=VALUE", value_parser = Change::parse,
            add = ArgValueCompleter::new(complete::changes))]
        changes: Vec<Change>,
    },
    /// Write the settings that are in force into a configuration, which keeps its comments and all other keys
    #[command(
        after_help = "Examples:\n  cdcrctl settings save                 print them as a configuration\n  \
        cdcrctl settings save robot.toml      change the keys in this file that differ, or make it\n\n\
        A key that the file lacks is added where the setting is not the default. The file is replaced as a \
        whole or not at all; links are followed, and its owner, group and mode stay. It has to be named, because \
        a daemon does not tell which files it was started with."
    )]
    Save {
        /// The configuration file
        #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
        file: Option<PathBuf>,
    },
}

/// How to show the settings.
#[derive(Debug, Args)]
pub(crate) struct SettingsShow {
    /// How to print
    #[arg(long, value_enum, default_value = "text")]
    pub(crate) format: Format,
}
